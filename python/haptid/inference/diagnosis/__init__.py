"""Diagnosis of an identification, in sentences a user can act on."""

from haptid.inference.diagnosis.diagnosis import Diagnosis, diagnose
from haptid.inference.diagnosis.finding import Finding
from haptid.inference.diagnosis.verdict import Verdict

__all__ = ["Diagnosis", "Finding", "Verdict", "diagnose"]
