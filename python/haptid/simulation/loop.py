"""The feedback that a log was recorded under, as far as noise goes around it: torque by positions above the motion.

Noise moves the motors: that of the torque through the mechanism, and that of the encoders through the controller. So
columns that are made of measured positions hold what is in the torque's error as well, and least squares takes it for
information on the parameters (Söderström and Stoica 1989, System Identification, section 10.5, the direct approach).
Above the motion a controller has nothing to follow, and its torque is that of the positions alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import kaiser_window
from haptid.dynamics.model import DynamicModel
from haptid.log.spectrum import bandwidth
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.motion import Motion
from haptid.motion.streaming import filtered
from haptid.simulation.driven import unloaded_joints

# The band from which the feedback is estimated: its lower limit over the bandwidth of the motion (the upper one is the
# cut-off of the position filter), and the fewest frequencies in it. Highest derivative of the position in the feedback.
_ABOVE, _FEWEST, _ORDER = 2.0, 50, 2
# Shape of the Kaiser window, whose side lobes keep the motion, a million times as large, out of that band.
_SHAPE = 14.0
# Share of the torque's square there that positions leave at most: noise that is read with the torque hides a feedback.
_LEFT = 0.5


@dataclass(frozen=True, eq=False)
class Loop:
    """Feedback of the motors' torque by their positions.

    Attributes:
        gains: torque by position, velocity and acceleration of the joints that are not simulated, with opposite sign,
            (3, motors, motors), N m/rad and N m s^k/rad, or N/m.
        rest: density of the torque that these do not explain, (motors,), (N m)^2/Hz: as it was read, it moves nothing.
    """

    gains: Array
    rest: Array

    def at(self, s: np.ndarray) -> np.ndarray:
        """At complex frequencies, (k,), 1/s: (k, motors, motors)."""
        return np.asarray(np.tensordot(s[:, None] ** np.arange(len(self.gains)), self.gains, (1, 0)))


def loop_of(model: DynamicModel, motion: Motion) -> Loop | None:
    """The feedback above the motion of a log; None where it is not seen, or does not damp the motors.

    Args:
        model: the dynamic model, each of whose motors moves one joint that is not simulated.
        motion: of a log.
    """
    device, log = model.device, motion.log
    rows = [device.row_names.index(drive.name) for drive in device.drives if drive.motorised]
    known = np.delete(np.arange(len(device.active)), unloaded_joints(model))
    if log is None or motion.treatment.cutoff_hz is None or len(known) != len(rows):
        return None
    dt = float(motion.dt)
    q = (np.linalg.inv(device.row_map) @ position_map(device, motion)(np.ascontiguousarray(motion.q[:].T)))[known]
    torque = behind_position_filter(motion, coordinate_torque(device, motion, 0, len(motion)))[rows]
    f = np.fft.rfftfreq(len(motion), dt)
    band = (f > _ABOVE * bandwidth(log)) & (f < np.min(motion.treatment.cutoff_hz))
    if band.sum() < _FEWEST:
        return None
    window = kaiser_window(len(motion), _SHAPE)
    Q, U = (np.fft.rfft((x - x.mean(axis=1, keepdims=True)) * window, axis=1)[:, band] for x in (q, torque))
    s = 2j * np.pi * f[band]
    columns, wanted = np.concatenate([Q * s**k for k in range(_ORDER + 1)]).T, U.T
    columns, wanted = (np.concatenate([x.real, x.imag]) for x in (columns, wanted))
    size = np.linalg.norm(columns, axis=0)
    if not (size > 0).all():
        return None
    found = np.linalg.lstsq(columns / size, wanted, rcond=None)[0]
    left = np.sum((wanted - columns / size @ found) ** 2, axis=0)
    if not (left < _LEFT * np.sum(wanted**2, axis=0)).all():
        return None
    gains = -(found / size[:, None]).reshape(_ORDER + 1, len(known), len(rows)).transpose(0, 2, 1)
    made = Loop(gains, 2 * dt * left / (band.sum() * np.sum(window**2)))
    inside = np.linspace(0.0, float(f[band][-1]), _FEWEST)[1:]
    damping = np.diagonal(made.at(2j * np.pi * inside), axis1=1, axis2=2).imag
    return made if (damping > 0).all() else None


def behind_position_filter(motion: Motion, torque: Array) -> Array:
    """Torque, (n, samples), behind the filter that the positions of a motion passed.

    What it removes of the motion would be missing in the simulated torque alone: with a cut-off at 1.2 times the
    highest frequency a damping came out a sixth too small.
    """
    if motion.log is None or motion.treatment.cutoff_hz is None:
        return torque
    widest = replace(motion.treatment, cutoff_hz=float(np.max(motion.treatment.cutoff_hz)))
    sections = widest.position_filter(float(motion.dt))
    assert sections is not None
    return np.ascontiguousarray(filtered(np.ascontiguousarray(torque.T), sections, motion.log.segments).T)
