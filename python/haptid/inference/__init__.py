"""Statistical inference from estimates: targets, comparison, drift, elimination, drive gains, payloads, diagnosis.

May import estimation, validation and all before them; it reads no files and imports no study.
"""

from haptid.inference.alarm import Alarm, ModelAlarm
from haptid.inference.comparison import Comparison, Series, compare
from haptid.inference.diagnosis import Diagnosis, Finding, Verdict, diagnose
from haptid.inference.drift import Drift, drift
from haptid.inference.elimination import (
    BackwardElimination,
    Elimination,
    GautierRatio,
    MaxRelativeStd,
    eliminate,
    eliminate_by_motor,
)
from haptid.inference.frequency_response import FrequencyResponse, Spring, multisine_response
from haptid.inference.payloads import AttachedBody, identify_payloads
from haptid.inference.static_poses import FrictionAtRest, GravityVerdict, StaticIdentification, identify_poses
from haptid.inference.targets import Targets, target_map, targets

__all__ = [
    "Alarm",
    "AttachedBody",
    "BackwardElimination",
    "Comparison",
    "Diagnosis",
    "Drift",
    "Elimination",
    "Finding",
    "FrequencyResponse",
    "FrictionAtRest",
    "GautierRatio",
    "GravityVerdict",
    "MaxRelativeStd",
    "ModelAlarm",
    "Series",
    "Spring",
    "StaticIdentification",
    "Targets",
    "Verdict",
    "compare",
    "diagnose",
    "drift",
    "eliminate",
    "eliminate_by_motor",
    "identify_payloads",
    "identify_poses",
    "multisine_response",
    "target_map",
    "targets",
]
