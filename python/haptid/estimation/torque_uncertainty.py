"""Standard error of the torque in motion that differs from the log's."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import rows
from haptid.estimation.torque_shares import carrying
from haptid.motion.channels import position_map
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation

# States that are looked at, the samples that are read around each few of them, and the seed of their combination.
_STATES, _WINDOW, _EVERY, _SEED = 200, 64, 4, 0


def torque_uncertainty(observation: Observation, covariance: Array, W: Array) -> float:
    """Standard error of the torque in other motion, per cent of the measured torque, root mean square of the motors.

    The other motion has the log's poses, each with velocities and accelerations that the coordinates had at other
    times. A condition number bounds the ratio of the errors of single parameters to those of the torque; this is the
    error of the torque itself, at the log's own noise and length.

    Args:
        observation: the rows of the fit.
        covariance: of the base parameters, (p, p), SI.
        W: of `other_motion`.

    Returns:
        Infinity where a variance is.
    """
    return _uncertainty(W, covariance, len(observation.motors))


def _uncertainty(W: Array, covariance: Array, motors: int) -> float:
    if not np.isfinite(covariance).all():
        return float("inf")
    return 100 * float(np.sqrt(max(np.sum((W @ covariance) * W), 0.0) / motors))


def judged_uncertainty(observation: Observation, covariance: Array) -> float:
    """The same of the motors that carry torque, in the other motion of these rows.

    Of a channel that hardly moves, any uncertainty is a large share.

    Args:
        observation: the rows of the fit.
        covariance: of the base parameters, (p, p), SI.

    Returns:
        Infinity where a variance is; nan where the rows are not of motions, but of poses or of a stream.
    """
    if not observation.motions:
        return float("nan")
    motors = observation.motors
    square = np.array([motor.norm**2 / max(int(motor.rows.sum()), 1) for motor in motors])
    kept = np.flatnonzero(carrying(square, [motor.unit for motor in motors]))
    W = other_motion(observation)
    return _uncertainty(W.reshape(len(motors), -1, W.shape[1])[kept].reshape(-1, W.shape[1]), covariance, len(kept))


# Rows of the other motion of an observation: it is judged again without one parameter after another.
_OTHER: WeakKeyDictionary[Observation, Array] = WeakKeyDictionary()


def other_motion(observation: Observation) -> Array:
    """Rows of the other motion: each motor's mean square is its torque's in units of the measured, (rows, p)."""
    if observation not in _OTHER:
        _OTHER[observation] = freeze(_other_motion(observation))
    return _OTHER[observation]


def _other_motion(observation: Observation) -> Array:
    """The same, computed."""
    model = observation.model
    c, cd, cdd = (np.ascontiguousarray(x) for x in _mixed(*_states(model, observation.motions)))
    columns, selection = model.needed
    own = [model.device.row_names.index(motor.name) for motor in observation.motors]
    Y = rows(model, c, cd, cdd)[own][:, list(columns)]
    level = np.array([motor.norm / np.sqrt(max(int(motor.rows.sum()), 1)) for motor in observation.motors])
    level = np.where(level > 0, level, level.max() or 1.0) * np.sqrt(c.shape[1])
    return np.asarray((Y / level[:, None, None]).transpose(0, 2, 1).reshape(-1, len(columns)) @ selection)


def _states(model: DynamicModel, motions: Sequence[Motion]) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations of the coordinates at times spread over the motions, (rows, states)."""
    states = []
    for motion in motions:
        count = max(1, _STATES * _EVERY // _WINDOW // len(motions))
        change = position_map(model.device, motion)
        for c, cd in (map(change, window) for window in _windows(motion, count)):
            cdd = np.gradient(cd, motion.dt, axis=1) if cd.shape[1] > 1 else np.zeros_like(cd)
            states.append([x[:, ::_EVERY] for x in (c, cd, cdd)])
    c, cd, cdd = (np.concatenate(own, axis=1) for own in zip(*states, strict=True))
    return c, cd, cdd


# Positions and velocities of the channels in some windows of a motion, by their number: every estimate is judged, and
# windows spread over a long log take long to read.
_WINDOWS: WeakKeyDictionary[Motion, dict[int, tuple[tuple[Array, Array], ...]]] = WeakKeyDictionary()


def _windows(motion: Motion, count: int) -> tuple[tuple[Array, Array], ...]:
    """Positions and velocities in a number of windows, evenly spread, each (channels, samples)."""
    kept = _WINDOWS.setdefault(motion, {})
    if count not in kept:
        low, high = motion.usable
        starts = np.linspace(low, max(high - _WINDOW, low), count).astype(int).tolist()
        ends = [stop for _, stop in motion.usable_segments]
        made = []
        for start in starts:
            # Velocities on both sides of a gap have no acceleration between them.
            first, stop = motion.usable_segments[int(np.searchsorted(ends, start, side="right"))]
            start = max(min(start, stop - _WINDOW), first)
            made.append(motion.state(start, min(start + _WINDOW, stop)))
        kept[count] = tuple(made)
    return kept[count]


def _mixed(c: Array, cd: Array, cdd: Array) -> tuple[Array, Array, Array]:
    """The same poses with each coordinate's velocities, and its accelerations, in another order."""
    rng = np.random.default_rng(_SEED)
    return c, rng.permuted(cd, axis=1), rng.permuted(cdd, axis=1)
