"""Prediction errors of an estimate on rows that were not fitted, and cross-validation.

May use observation and estimation.
"""

from haptid.validation.prediction import Prediction, predict
from haptid.validation.validation import MotorError, Validation, fit_errors, validate

__all__ = ["MotorError", "Prediction", "Validation", "fit_errors", "predict", "validate"]
