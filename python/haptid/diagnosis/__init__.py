"""Diagnosis of an identification, in sentences a user can act on."""

from haptid.diagnosis.diagnosis import Diagnosis, diagnose
from haptid.diagnosis.finding import Finding
from haptid.diagnosis.verdict import Verdict

__all__ = ["Diagnosis", "Finding", "Verdict", "diagnose"]
