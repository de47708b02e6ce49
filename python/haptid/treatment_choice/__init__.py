"""Proposed treatment of a log, and an estimate of the delay of its torque.

May use log, motion, observation and estimation.
"""

from haptid.treatment_choice.calibration import Calibration, CalibrationPrior, find_calibration
from haptid.treatment_choice.delay_estimate import Delays, find_delays
from haptid.treatment_choice.propose import Proposal, propose
from haptid.treatment_choice.uncertainty import with_treatment_uncertainty

__all__ = [
    "Calibration",
    "CalibrationPrior",
    "Delays",
    "Proposal",
    "find_calibration",
    "find_delays",
    "propose",
    "with_treatment_uncertainty",
]
