"""Statistical inference from estimates: targets, comparison, drift, elimination, drive gains, payloads, diagnosis.

May import estimation, validation and all before them; it reads no files and knows no study.
"""

from haptid.inference.comparison import Comparison, Series, compare
from haptid.inference.diagnosis import Diagnosis, Finding, Verdict, diagnose
from haptid.inference.drift import Drift, drift
from haptid.inference.drive_gains import DriveGains, drive_gains
from haptid.inference.elimination import (
    BackwardElimination,
    Elimination,
    GautierRatio,
    MaxRelativeStd,
    eliminate,
    eliminate_by_motor,
)
from haptid.inference.payload_estimate import PayloadEstimate, estimate_payload
from haptid.inference.targets import Targets, side_by_side, target_map, targets

__all__ = [
    "BackwardElimination",
    "Comparison",
    "Diagnosis",
    "Drift",
    "DriveGains",
    "Elimination",
    "Finding",
    "GautierRatio",
    "MaxRelativeStd",
    "PayloadEstimate",
    "Series",
    "Targets",
    "Verdict",
    "compare",
    "diagnose",
    "drift",
    "drive_gains",
    "eliminate",
    "eliminate_by_motor",
    "estimate_payload",
    "side_by_side",
    "target_map",
    "targets",
]
