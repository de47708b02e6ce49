"""A weak prior on torque, for logs that leave directions of the parameters open: `Anchored`, `AnchoredConsistent`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device import Closure, Device
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import rows
from haptid.estimation.least_squares import Knowledge, Solution, unexcited
from haptid.estimation.method import Method, Wrapper, expect_weighting
from haptid.estimation.methods.constrained import Constrained, PhysicallyConsistent
from haptid.estimation.methods.wls import WLS, weights_without
from haptid.motion.channels import state
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.observation.r_factor import r_factor

# States of the reference motion, and their seed.
_STATES, _SEED = 200, 0
# Relative standard error below which a parameter is known, whatever its torque in the reference motion.
_KNOWN = 0.1
# Samples of a motion from which its speed is taken.
_SAMPLES = 1 << 16


@dataclass(frozen=True)
class Anchored(Wrapper):
    """Another method with a weak prior: torque differs from that of the prior bodies by as much as was measured.

    In a reference motion, all poses at speeds and accelerations as of the fastest coordinate of the log, torque of
    each motor has the prior standard deviation of its root mean square in the log, about that of the device file's
    bodies, or about zero where there are none. A direction of the parameters that the log determines has a thousand
    times this information and is not changed; one that it leaves open, as the friction of a joint that rests, stays
    near the prior, where least squares would magnify noise without limit. It depends neither on units nor on frames.

    Source: Zellner (1986), On assessing prior distributions with g-prior distributions, for a prior covariance in
    proportion to that of a design.

    Attributes:
        weighting: how rows are weighted; its rows must have unit variance.
    """

    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting(type(self).__name__, self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, weak prior on torque"

    def weights(self, observation: Observation) -> Array:
        """Those of the wrapped method, (motors,)."""
        return weights_without(self.weighting, observation, lambda rows: unexcited(rows.stack()[:-1, :-1])[0])

    def knowledge(self, observation: Observation) -> Knowledge:
        """The prior, one row of unit variance for each direction."""
        A = reference_torque(observation)
        prior = [0.0 if known is None else known[0] for known in observation.model.base_prior]
        return Knowledge(A, A @ np.array(prior), np.ones(len(A)))


@dataclass(frozen=True)
class AnchoredConsistent(Anchored):
    """The same, physically consistent: see `PhysicallyConsistent`."""

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, weak prior on torque, physically consistent"

    def constrain(self, observation: Observation, free: Solution) -> Constrained:
        """The nearest feasible parameters to the fit with the prior, as `PhysicallyConsistent.constrain`."""
        return PhysicallyConsistent(self.weighting).constrain(observation, free)


# Of an observation: it is needed for the model for use, and to tell which parameters are not excited.
_REFERENCE: WeakKeyDictionary[Observation, Array] = WeakKeyDictionary()


def reference_torque(observation: Observation) -> Array:
    """R factor of the base parameters' torque in a reference motion, in units of the measured torque, (p, p).

    The norm of its product with a vector of base parameters is the root of the sum over motors of the mean square
    torque that they exert, each in units of the motor's root mean square torque in the log.
    """
    if observation not in _REFERENCE:
        _REFERENCE[observation] = freeze(_reference_torque(observation))
    return _REFERENCE[observation]


def _reference_torque(observation: Observation) -> Array:
    """The same, computed."""
    model, rng = observation.model, np.random.default_rng(_SEED)
    c = model.device.row_map @ _poses(model.device, rng)
    speed, acceleration = _scales(model, observation.motions)
    cd, cdd = speed[:, None] * rng.standard_normal(c.shape), acceleration[:, None] * rng.standard_normal(c.shape)
    columns, selection = model.needed
    Y = rows(model, c, cd, cdd)[list(model.known_rows)][:, list(columns)]
    level = np.array([motor.norm / np.sqrt(max(int(motor.rows.sum()), 1)) for motor in observation.motors])
    level = np.where(level > 0, level, level.max())
    W = (Y / level[:, None, None]).transpose(0, 2, 1).reshape(-1, len(columns)) @ selection / np.sqrt(_STATES)
    return np.asarray(r_factor(np.column_stack([W, np.zeros(len(W))]))[:-1, :-1])


def _poses(device: Device, rng: np.random.Generator) -> Array:
    """Random poses of the active joints, (active, states): prismatic ones, which have no full turn, within limits."""
    qa = device.closure.draw(rng, _STATES)
    if isinstance(device.closure, Closure):  # the others draw within limits, and their loops close at these poses alone
        for own, k in zip(qa, device.active, strict=True):
            joint = device.joints[k]
            if joint.prismatic and joint.position_limits is not None:
                own[:] = np.interp(own, (-np.pi, np.pi), joint.position_limits)
    return qa


def open_parameters(
    observation: Observation, A: Array, *covariances: Array, beta: Array | None = None
) -> tuple[str, ...]:
    """Base parameters that the log leaves open, those with the most torque first.

    There are some where torque of the reference motion has, in a direction, a variance above that of the weak prior:
    the prior is more informative than the log. Of the parameters those are named whose own does. There are none where
    that is the torque of parameters alone that are known well, such as a spring's that moves by a milliradian: the
    reference motion takes it through a full turn, and a prior from there would contradict the log.

    Args:
        A: of `reference_torque`, (p, p).
        covariances: of the base parameters, (p, p) each; the largest variance counts.
        beta: base parameters, (p,), SI; None where none counts as known.
    """
    variance = np.max([np.diag(covariance) for covariance in covariances], axis=0)
    known = np.zeros(len(A), dtype=bool) if beta is None else np.sqrt(variance) < _KNOWN * np.abs(beta)
    if not all(_is_open(B, covariances) for B in (A, np.where(known, 0.0, A))):
        return ()
    own = variance * (A**2).sum(axis=0)
    order = np.argsort(-own)
    names = [observation.base.names[k] for k in order if own[k] > 1]
    return tuple(names or [observation.base.names[order[0]]])


def _is_open(A: Array, covariances: Sequence[Array]) -> bool:
    """Whether a direction's torque has a variance above that of the weak prior."""
    return any(np.linalg.eigvalsh(A @ covariance @ A.T)[-1] > 1 for covariance in covariances)


def _scales(model: DynamicModel, motions: Sequence[Motion]) -> tuple[Array, Array]:
    """Speed and acceleration of the fastest coordinate with the same unit of torque, (coordinates,) each."""
    speed, acceleration = np.zeros(len(model.device.row_names)), np.zeros(len(model.device.row_names))
    for motion in motions:
        parts = [state(model.device, motion, *part)[1] for part in motion.usable_parts(_SAMPLES)]
        cd, cdd = np.hstack(parts), np.hstack([np.gradient(own, motion.dt, axis=1) for own in parts])
        speed = np.maximum(speed, np.sqrt((cd**2).mean(axis=1)))
        acceleration = np.maximum(acceleration, np.sqrt((cdd**2).mean(axis=1)))
    units = np.array(model.device.torque_units)
    for unit in set(model.device.torque_units):
        of_unit = units == unit
        speed[of_unit], acceleration[of_unit] = speed[of_unit].max(), acceleration[of_unit].max()
    return speed, acceleration
