"""Design of exciting motions: parametrised families, limits, optimality criteria, and the constrained search."""

from haptid.experiment.excitation.criteria import (
    Criterion,
    Information,
    LargestDeviation,
    Quality,
    RawCondition,
    ScaledCondition,
    Scaling,
    observed,
    quality,
)
from haptid.experiment.excitation.families import Family, FourierSeries, TrianglesWithSines
from haptid.experiment.excitation.gradients import Slopes
from haptid.experiment.excitation.limits import Bounds, Coupling, Limits
from haptid.experiment.excitation.search import Excitation, Search, design
from haptid.experiment.excitation.writing import write_experiment

__all__ = [
    "Bounds",
    "Coupling",
    "Criterion",
    "Excitation",
    "Family",
    "FourierSeries",
    "Information",
    "LargestDeviation",
    "Limits",
    "Quality",
    "RawCondition",
    "ScaledCondition",
    "Scaling",
    "Search",
    "Slopes",
    "TrianglesWithSines",
    "design",
    "observed",
    "quality",
    "write_experiment",
]
