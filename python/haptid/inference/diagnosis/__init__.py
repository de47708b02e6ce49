"""Regression diagnostics of an estimate: findings with test statistics, and a verdict with recommendations."""

from haptid.inference.diagnosis.diagnosis import Diagnosis, diagnose
from haptid.inference.diagnosis.finding import Finding
from haptid.inference.diagnosis.rigid_range import FrequencyRange
from haptid.inference.diagnosis.verdict import Verdict

__all__ = ["Diagnosis", "Finding", "FrequencyRange", "Verdict", "diagnose"]
