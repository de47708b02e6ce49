"""Design of exciting motions: parametrised families, limits, optimality criteria, and the constrained search."""

from haptid.experiment.excitation.campaign import (
    CAMPAIGN_FAMILIES,
    friction_test,
    held_poses,
    pose_columns,
    resting_pose,
    reversals,
)
from haptid.experiment.excitation.criteria import (
    CRITERIA,
    AverageVariance,
    Criterion,
    Information,
    LargestDeviation,
    Quality,
    RawCondition,
    ScaledCondition,
    Scaling,
    motion_condition,
    observed_motion,
    quality,
)
from haptid.experiment.excitation.families import Family, FourierSeries, TrianglesWithSines
from haptid.experiment.excitation.gradients import Gradients
from haptid.experiment.excitation.limits import Coupling, Limits, MotionBounds
from haptid.experiment.excitation.planned import Excitation, PlannedMotion
from haptid.experiment.excitation.played import PlayedMotion, compare_with_plan, read_motion
from haptid.experiment.excitation.player import PlayerSettings, write_player
from haptid.experiment.excitation.samples import MotionSamples, write_motion
from haptid.experiment.excitation.search import Search, design_excitation
from haptid.experiment.excitation.sequential import FurtherMotions, LogInformation, next_motions, of_buffer
from haptid.experiment.excitation.writing import plain_experiment, write_experiment

__all__ = [
    "CAMPAIGN_FAMILIES",
    "CRITERIA",
    "AverageVariance",
    "Coupling",
    "Criterion",
    "Excitation",
    "Family",
    "FourierSeries",
    "FurtherMotions",
    "Gradients",
    "Information",
    "LargestDeviation",
    "Limits",
    "LogInformation",
    "MotionBounds",
    "MotionSamples",
    "PlannedMotion",
    "PlayedMotion",
    "PlayerSettings",
    "Quality",
    "RawCondition",
    "ScaledCondition",
    "Scaling",
    "Search",
    "TrianglesWithSines",
    "compare_with_plan",
    "design_excitation",
    "friction_test",
    "held_poses",
    "motion_condition",
    "next_motions",
    "observed_motion",
    "of_buffer",
    "plain_experiment",
    "pose_columns",
    "quality",
    "read_motion",
    "resting_pose",
    "reversals",
    "write_experiment",
    "write_motion",
    "write_player",
]
