"""Proposed treatment of a log, and an estimate of the delay of its torque.

May use log, motion, observation and estimation.
"""

from haptid.treatment_choice.delay_estimate import Delay, find_delay
from haptid.treatment_choice.propose import Proposal, propose

__all__ = ["Delay", "Proposal", "find_delay", "propose"]
