"""Home offsets of the joints and the direction of gravity, estimated with the base parameters from priors.

An encoder's zero is set at a mechanical stop or a mark, and a device stands on a table: both are known to a fraction of
a degree, not exactly. Either changes the torque of every link. Some of these errors show in the torque, others only
rotate a link's own frame and are absorbed by its parameters; with a prior both are distinguished by the data, and what
stays uncertain is in the interval of every parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import core_torque, raw_parameters, rigid
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError
from haptid.estimation import Estimate
from haptid.log import Log, OnDisk
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment
from haptid.observation.geometry_slopes import (
    SLOPE_STEP,
    columns_of,
    home_offset_slope,
    horizontal_axes,
    slope_towards,
    tilted_gravity,
)
from haptid.observation.known_payload import TorqueWithout
from haptid.observation.observation import observe
from haptid.treatment_choice.first_fit import least_squares
from haptid.treatment_choice.nuisance_problem import NuisanceColumn, NuisanceProblem
from haptid.uncertainty.quantities import Quantities

# Gauss-Newton steps, and the change, in standard deviations of the prior, below which they end.
_STEPS, _STILL = 6, 1e-3
# Share of the prior's standard deviation above which a posterior one means that the logs have no information.
_UNKNOWN = 0.9


@dataclass(frozen=True)
class CalibrationPrior:
    """How well the zeros of the positions and the direction of gravity are known: normal, about what is given.

    Attributes:
        home_offset_std: standard deviation of the true position less the logged one, at the joint, rad or m: one for
            all active joints, or one for each; 0 where it is exact.
        each_log: whether every log has offsets of its own, as of incremental encoders that are homed at every start.
        gravity_direction_std: standard deviation of the direction of gravity about each of two level axes, rad; 0 where
            it is exact.
    """

    home_offset_std: float | tuple[float, ...] = 0.0
    each_log: bool = False
    gravity_direction_std: float = 0.0

    def __post_init__(self) -> None:
        stds = np.append(self.home_offset_std, self.gravity_direction_std)
        if not (np.isfinite(stds).all() and (stds >= 0).all() and stds.any()):
            raise SettingError(
                f"the standard deviations are {stds.tolist()}; write finite ones, 0 or more, not all of them 0.",
                where="home_offset_std, gravity_direction_std",
                found=stds.tolist(),
            )


@dataclass(frozen=True, eq=False)
class Calibration:
    """Home offsets and the direction of gravity, as estimated with the base parameters.

    Attributes:
        prior: standard deviations before.
        quantities: true position less logged position by joint (and log), rad or m; rotation of gravity towards two
            level axes, rad; with covariance and degrees of freedom from rows and prior.
        prior_std: of each, (n,).
        joint, log: active joint of each offset and its log; -1 of gravity, and of an offset of all logs, (n,).
        beta: base parameters of the same fit, (p,), SI.
    """

    prior: CalibrationPrior
    quantities: Quantities
    prior_std: Array
    joint: tuple[int, ...]
    log: tuple[int, ...]
    beta: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "prior_std", "beta")

    def offsets(self, joints: int, log: int | None) -> Array:
        """Home offsets in a log, (active,), rad or m; those of all logs where it is None."""
        made = np.zeros(joints)
        for value, joint, own in zip(self.quantities.values, self.joint, self.log, strict=True):
            if joint >= 0 and own in (-1, log):
                made[joint] += value
        return made

    @property
    def rotation(self) -> Array:
        """Rotation of gravity towards the two level axes, (2,), rad."""
        found = [value for value, joint in zip(self.quantities.values, self.joint, strict=True) if joint < 0]
        return np.array(found or [0.0, 0.0])

    def gravity(self, model: DynamicModel) -> Array:
        """Gravity in the base frame as estimated, of the device's magnitude, (3,), m/s^2."""
        turned = _turned(model, self.rotation).device.gravity
        return np.asarray(turned * np.linalg.norm(model.device.gravity) / np.linalg.norm(turned))

    def corrected(self, model: DynamicModel, log: Log, treatment: Treatment, index: int | None) -> Log:
        """A log with true positions, and with the torque that it would have under the device file's gravity.

        Args:
            log: as recorded.
            treatment: of its positions.
            index: which of the logs that were calibrated it is; None where it is none of them.
        """
        _in_memory(log)
        offsets = self.offsets(len(model.device.active), index)
        position = log.position + _channel_offsets(model, log, offsets)
        made = replace(log, position=position)
        if not self.rotation.any():
            return made
        tilted = _turned(model, self.rotation)
        change = tilted.with_gravity(tilted.device.gravity - model.device.gravity)
        chi = rigid(model, _raw(model, self.beta))
        motion = treat(made, treatment)
        late = tuple(np.atleast_1d(treatment.torque_shift_s) / motion.dt)
        known = partial(_at_rest, change, chi)
        return replace(made, torque=TorqueWithout(model.device, motion, known, log.torque, late).samples())

    def with_uncertainty(self, estimate: Estimate) -> Estimate:
        """An estimate from corrected logs whose covariance includes that of the calibration."""
        motions = estimate.observation.motions
        problem = _problem(estimate.model, motions, estimate.free, self.joint, self.log)
        shifts = problem.propagated(estimate, self.quantities.covariance)
        return estimate.with_nuisance("home offsets and direction of gravity", shifts)

    def sentences(self, model: DynamicModel) -> tuple[str, ...]:
        """Sentences: the corrections, quantities that are not identifiable, and the estimated gravity."""
        q = self.quantities
        undetermined = [
            name for name, se, std in zip(q.names, q.se, self.prior_std, strict=True) if se > _UNKNOWN * std
        ]
        made = [f"The logs are corrected for {', '.join(q.names)}; their uncertainty is in every interval."]
        if undetermined:
            made.append(
                f"These logs do not distinguish {', '.join(undetermined)} from the parameters of the links: the "
                "prior's standard deviation is in every interval."
            )
        if self.rotation.any():
            made.append(
                f"The torque is corrected to the gravity of the device file; as estimated it is "
                f"{np.round(self.gravity(model), 4).tolist()} m/s^2. Use that where the model predicts this device."
            )
        return tuple(made)


def find_calibration(
    model: DynamicModel, logs: Sequence[Log], treatment: Treatment, prior: CalibrationPrior
) -> Calibration:
    """Home offsets and the direction of gravity, jointly with the base parameters, by Gauss-Newton steps.

    Args:
        logs: in memory.
        treatment: of the logs; in the acceleration formulation.
        prior: standard deviations.

    Raises:
        SettingError: not one standard deviation for each active joint; a device without gravity; the momentum
            formulation, or a log that is read in chunks.
        HaptidError: as `treat` and `observe`.
    """
    names, units, std, joint, log = _unknowns(model, len(logs), prior)
    if treatment.momentum:
        raise SettingError(
            "home offsets and the direction of gravity are estimated in the acceleration formulation alone.",
            where="formulation",
            found=treatment.formulation,
            advice="Leave out `formulation`, or the calibration.",
        )
    for one in logs:
        _in_memory(one)
    joints, theta = len(model.device.active), np.zeros(len(names))
    motions = [treat(one, treatment) for one in logs]
    beta = least_squares(observe(model, *motions))
    exact = np.array(joint) >= 0  # offsets are applied to the positions; gravity stays a column
    for _ in range(_STEPS):
        quantities = Quantities(names, units, theta, np.diag(std**2), np.full(len(std), np.inf))
        now = Calibration(prior, quantities, std, joint, log, beta)
        moved = [
            _shifted(motion, _channel_offsets(model, one, now.offsets(joints, k)))
            for k, (motion, one) in enumerate(zip(motions, logs, strict=True))
        ]
        applied = np.where(exact, theta, 0.0)
        beta, step, spread = _problem(model, moved, beta, joint, log).solve(-applied, np.diag(std**2))
        change = np.abs(applied + step - theta) / std
        theta = applied + step
        if change.max() < _STILL:
            break
    return Calibration(prior, Quantities(names, units, theta, spread.covariance, spread.dof), std, joint, log, beta)


def _unknowns(
    model: DynamicModel, logs: int, prior: CalibrationPrior
) -> tuple[tuple[str, ...], tuple[str, ...], Array, tuple[int, ...], tuple[int, ...]]:
    """Names, units, prior standard deviations, joints and logs of the nuisances."""
    device = model.device
    if np.size(prior.home_offset_std) not in (1, len(device.active)):
        raise SettingError(
            f"home_offset_std has {np.size(prior.home_offset_std)} values, and the device {len(device.active)} active "
            "joints; write one value, or one for each.",
            where="home_offset_std",
            found=np.size(prior.home_offset_std),
            limit=len(device.active),
        )
    if prior.gravity_direction_std and not device.gravity.any():
        raise SettingError(
            f"gravity_direction_std is {prior.gravity_direction_std:g}, and {device.name} has no gravity.",
            where="gravity_direction_std",
            found=prior.gravity_direction_std,
            advice="Leave it out, or write the device's `gravity`.",
        )
    made = []
    for own in range(logs) if prior.each_log else [-1]:
        for k, std in enumerate(np.broadcast_to(prior.home_offset_std, len(device.active))):
            moving = device.joints[device.active[k]]
            name = f"home offset of joint {moving.name}" + (f" in log {own + 1}" if own >= 0 else "")
            made.append((name, "m" if moving.prismatic else "rad", float(std), k, own))
    if prior.gravity_direction_std:
        for axis, _ in horizontal_axes(model):
            made.append((f"direction of gravity towards {axis}", "rad", prior.gravity_direction_std, -1, -1))
    names, units, std, joint, log = zip(*(one for one in made if one[2] > 0), strict=True)
    return names, units, np.array(std), joint, log


def _problem(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, joint: Sequence[int], log: Sequence[int]
) -> NuisanceProblem:
    """Offsets and directions as nuisances of the motions of the calibrated logs, in order."""
    rows = len(model.device.active)
    axes = (axis for _, axis in horizontal_axes(model))
    slopes = [
        home_offset_slope(model, k)
        if k >= 0
        else slope_towards(tilted_gravity(model, next(axes), SLOPE_STEP), SLOPE_STEP)
        for k in joint
    ]

    def of_log(j: int) -> list[NuisanceColumn]:
        own = [n for n, one in enumerate(log) if one in (-1, j)]
        return [(n, column) for n in own for column in columns_of(slopes[n], rows)]

    return NuisanceProblem.of(model, motions, beta, _raw(model, beta), [of_log(j) for j in range(len(motions))])


def _raw(model: DynamicModel, beta: Array) -> Array:
    """Parameters of the core's columns with these base parameters, and otherwise as the prior has them, (r,), SI.

    Under another gravity parameters count that have no effect under the device's.
    """
    prior = np.nan_to_num(model.device.chi_prior)
    return np.asarray(model.device.parameters.S @ prior + raw_parameters(model, beta - model.base.of(prior)))


def _turned(model: DynamicModel, rotation: Array) -> DynamicModel:
    gravity = model.device.gravity
    towards = sum(angle * axis for (_, axis), angle in zip(horizontal_axes(model), rotation, strict=True))
    return model.with_gravity(gravity + np.linalg.norm(gravity) * towards)


def _at_rest(model: DynamicModel, chi: Array, c: Array, cd: Array, _cdd: Array) -> Array:
    """Torque at rest, (coordinates, samples)."""
    still = np.zeros_like(cd)
    return core_torque(model, chi, c, still, still)


def _channel_offsets(model: DynamicModel, log: Log, offsets: Array) -> Array:
    """Offsets of the active joints as offsets of the position channels, (channels,)."""
    if log.channels.position.side == "joint":
        return offsets
    return np.array([drive.gear_ratio for drive in model.device.drives]) * (model.device.coupling @ offsets)


def _shifted(motion: Motion, offsets: Array) -> Motion:
    """A motion with offsets added to its positions: low-pass filters and differences leave them as they are."""
    return replace(motion, q=motion.q + offsets)


def _in_memory(log: Log) -> None:
    if isinstance(log.position, OnDisk):
        raise SettingError(
            f"{log.path.name} is read in chunks; home offsets and the direction of gravity are estimated from logs in "
            "memory.",
            where=log.path,
            advice="Give a `time_range` of some minutes.",
        )
