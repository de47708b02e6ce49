"""Motions that excite a device's parameters well: families, limits, criteria, and the search."""

from haptid.excitation.criteria import (
    Criterion,
    Information,
    LargestDeviation,
    RawCondition,
    ScaledCondition,
    Scaling,
)
from haptid.excitation.families import Family, FourierSeries, TrianglesWithSines
from haptid.excitation.limits import Bounds, Coupling, Limits
from haptid.excitation.quality import Quality, observed, quality
from haptid.excitation.search import Excitation, Search, design
from haptid.excitation.slopes import Slopes
from haptid.excitation.writing import write_experiment

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
