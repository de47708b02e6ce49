"""The model simulated along a log: direct dynamics, controller, sensitivities."""

from haptid.simulation.control import PID
from haptid.simulation.closed_loop import Course, Steps, Stretches, closed_loop, measured_state, open_loop
from haptid.dynamics.forward import DirectModel, sets_of, smooth
from haptid.simulation.sensitivity import Sensitivity, columns, sensitivity

__all__ = [
    "PID",
    "Course",
    "DirectModel",
    "Sensitivity",
    "Steps",
    "Stretches",
    "closed_loop",
    "columns",
    "measured_state",
    "open_loop",
    "sensitivity",
    "sets_of",
    "smooth",
]
