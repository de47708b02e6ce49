"""Simulation of the model along a log: controller, closed loop, sensitivities.

May use device, log, dynamics and motion.
"""

from haptid.simulation.closed_loop import (
    Course,
    Segments,
    Steps,
    closed_loop,
    expect_no_history,
    measured_state,
    open_loop,
    smooth,
)
from haptid.simulation.control import PID
from haptid.simulation.sensitivity import Sensitivity, sensitivity

__all__ = [
    "PID",
    "Course",
    "Segments",
    "Sensitivity",
    "Steps",
    "closed_loop",
    "expect_no_history",
    "measured_state",
    "open_loop",
    "sensitivity",
    "smooth",
]
