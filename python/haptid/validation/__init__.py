"""Prediction errors of an estimate on rows that were not fitted, and cross-validation.

May use observation and estimation.
"""

from haptid.validation.model_for_use import ModelForUse, UseCandidate, model_for_use
from haptid.validation.prediction import Prediction, predict
from haptid.validation.validation import MotorError, Validation, fit_errors, validate

__all__ = [
    "ModelForUse",
    "MotorError",
    "Prediction",
    "UseCandidate",
    "Validation",
    "fit_errors",
    "model_for_use",
    "predict",
    "validate",
]
