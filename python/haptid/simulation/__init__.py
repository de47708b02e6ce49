"""The model simulated along a log: controller, closed loop, sensitivities."""

from haptid.simulation.closed_loop import Course, Steps, Stretches, closed_loop, measured_state, open_loop
from haptid.simulation.control import PID
from haptid.simulation.sensitivity import Sensitivity, sensitivity
from haptid.simulation.smoothing import smooth

__all__ = [
    "PID",
    "Course",
    "Sensitivity",
    "Steps",
    "Stretches",
    "closed_loop",
    "measured_state",
    "open_loop",
    "sensitivity",
    "smooth",
]
