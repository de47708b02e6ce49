"""Hand force on the device from the motors' torques and the model.

Source: Tahmasebi et al. (2005), eq. (14), with two slips corrected: the Jacobian's angular rows are transposed, and the
hand's moment is a physical one, which the amplifiers' gain does not scale.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, freeze_fields, positive
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.wrench import Lever, acting_rows, lever
from haptid.errors import setting_error
from haptid.estimation import Estimate
from haptid.motion.motion import Motion
from haptid.observation.reversals import friction_uncertainty, smoothed_friction
from haptid.observation.rows import chunks
from haptid.uncertainty.quantities import LEVEL, covariance_root, half_width
from haptid.validation.validation import Validation, fit_errors

# Speed below which the sign of a velocity is smoothed, rad/s or m/s.
REVERSAL_SPEED = 0.01
# Largest condition number of the Jacobian at which a pose is used.
WORST_CONDITION = 30.0
_COMPONENTS = ("force x", "force y", "force z", "moment x", "moment y", "moment z")


@dataclass(frozen=True, eq=False)
class HandleForce:
    """The wrench of the hand on the device at the handle's origin, in the base frame, along a motion.

    Sign convention: torque of the model = torque of the motors + J' wrench, with the wrench that the hand exerts on the
    device. The wrench that the device exerts on the hand is its opposite: `on_hand`.

    Attributes:
        t: (rows,), s.
        wrench: force, N, and moment, N m, of the hand on the device, (rows, 6); NaN at poses that are not usable.
        bare: the same without the dynamic model, as if motors balanced the hand alone, (rows, 6).
        se: standard errors of `wrench`, from the estimate's covariance, the residual's level and the uncertainty of dry
            friction at reversals, (rows, 6); NaN for a moment that was given or taken as zero.
        external: torque of the hand on the measured torque rows, (motors, rows), N m or N.
        lever: poses, condition numbers, and the components of a wrench that torques determine.
        usable: whether each row's pose is far enough from a singular one for its wrench to be computed, (rows,).
        moment: whether the moment was "given", "estimated" or "taken as zero".
        notes: sentences a user should read.
    """

    model: DynamicModel
    t: Array
    wrench: Array
    bare: Array
    se: Array
    external: Array
    lever: Lever
    usable: np.ndarray
    moment: str
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        each = (len(self.t), 6)
        freeze_fields(self, "t", wrench=each, bare=each, se=each, external=(None, len(self.t)))

    @property
    def force(self) -> Array:
        """Of the hand on the device, in the base frame, (rows, 3), N."""
        return self.wrench[:, :3]

    @property
    def on_hand(self) -> Array:
        """Force of the device on the hand, in the base frame, (rows, 3), N."""
        return freeze(-self.force)

    @property
    def in_handle(self) -> Array:
        """Force of the hand on the device, along the handle's own axes, (rows, 3), N."""
        return freeze(np.einsum("nij,ni->nj", self.lever.handle.rotation, self.force))

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals of `force`, (rows, 3, 2), N."""
        half = half_width(self.se[:, :3], np.inf, level)
        return freeze(np.stack([self.force - half, self.force + half], axis=2))

    def summary(self) -> str:
        """RMS and standard error of the force, condition numbers, and what is not determined, as text."""
        used = self.usable
        lines = [f"Force of the hand on {self.model.device.name}: {used.sum()} of {len(used)} rows"]
        if used.any():
            rms, bare, se = (np.sqrt((x[used, :3] ** 2).mean(axis=0)) for x in (self.wrench, self.bare, self.se))
            for k, axis in enumerate("xyz"):
                lines.append(
                    f"  {axis}: RMS {rms[k]:.4g} N, standard error {se[k]:.2g} N, without the model {bare[k]:.4g} N"
                )
        worst, middle = self.lever.condition.max(), np.median(self.lever.condition)
        lines.append(f"  condition number of the Jacobian: {middle:.3g} at the median, {worst:.3g} at worst")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def estimate_force(
    estimate: Estimate,
    motion: Motion,
    *,
    validation: Validation | None = None,
    moment: Array | None = None,
    reversal_speed: float = REVERSAL_SPEED,
    worst_condition: float = WORST_CONDITION,
) -> HandleForce:
    """Force of the hand on the device: F = J_p^-T (tau_model - tau_motors - J_o' moment), filtered as in `predict`.

    Args:
        estimate: the model.
        motion: with torques, while the hand pushes.
        validation: on unseen rows without a hand, same treatment: its residual is the noise of the torque rows; by
            default the residual of the fit.
        moment: of the hand on the device about the handle's origin, in the handle's axes, at the motion's samples,
            (n, 3), N m, from a force sensor; None where it is unknown. It is then estimated if there are six measured
            torque rows or more, and otherwise taken as zero, as for a gimbal or a thimble.
        reversal_speed: below it the sign of a velocity is smoothed and friction is uncertain, rad/s or m/s.
        worst_condition: condition number of the Jacobian beyond which a pose is left out.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range, or a moment that is not a finite number.
        LogMismatchError, MotionTooShortError: as for `predict`.
        ShapeError: the moment does not fit the motion, or the validation the device.
    """
    model = estimate.model
    handle_of(model)
    check_force_settings(reversal_speed, worst_condition)
    if moment is not None:
        moment = np.asarray(moment, dtype=float)
        expect("moment", moment.shape, (len(motion), 3))
        check_finite("moment", moment)
    motion.unbroken("the force of the hand")
    pieces = list(_pieces(estimate, motion, moment, reversal_speed))
    torques, noise = Torques.joined(pieces), noise_of(estimate, validation)
    found = lever_of(estimate, torques.qa, noise, moment is not None, worst_condition)
    covariance = torques.covariance + np.diag(noise**2)[:, :, None]
    made = WrenchEstimate(
        t=torques.t,
        external=torques.external,
        wrench=found.wrench(torques.external),
        bare=found.wrench(-torques.motors),
        variance=np.einsum("num,mkn,nuk->un", found.inverse, covariance, found.inverse, optimize=True),
        usable=found.usable,
        moment=torques.moment,
    )
    return handle_force(estimate, found, made, noted(validation))


UNVALIDATED = "No validation was given: the noise is taken from the fit's residual, smaller than on unseen rows."


def noted(validation: Validation | None) -> tuple[str, ...]:
    """Notes on the source of the noise level."""
    return () if validation is not None else (UNVALIDATED,)


def check_force_settings(reversal_speed: float, worst_condition: float) -> None:
    """Raise SettingError for a setting out of range."""
    if not (reversal_speed == 0 or positive(reversal_speed)):
        raise setting_error("reversal_speed", reversal_speed, "a finite speed, 0 or more")
    if not (positive(worst_condition) and worst_condition > 1):
        raise setting_error("worst_condition", worst_condition, "a finite number above 1")


def check_finite(name: str, array: ArrayLike) -> None:
    """Raise SettingError for the first entry that is not a finite number."""
    values = np.asarray(array, dtype=float)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        first = tuple(int(k) for k in bad[0])
        raise setting_error(f"{name}[{', '.join(map(str, first))}]", float(values[first]), "a finite number")


def noise_of(estimate: Estimate, validation: Validation | None) -> Array:
    """Residual RMS of each known torque row, (rows,), N m or N."""
    errors = (validation or fit_errors(estimate)).motors
    expect("validation.motors", (len(errors),), (sum(estimate.model.device.known),))
    return np.array([error.rmse for error in errors])


@dataclass(frozen=True, eq=False)
class WrenchEstimate:
    """The wrench estimated from the torques, in the base frame.

    Attributes:
        t: (rows,), s.
        external: torque of the hand, (measured, rows), N m or N.
        wrench, bare: the unknown components, with the model and without, (unknown, rows), N and N m.
        variance: of `wrench`, (unknown, rows).
        usable: whether a row is far enough from singular poses, (rows,).
        moment: of the hand where it is given, (3, rows), N m; (0, rows) where it is not.
    """

    t: Array
    external: Array
    wrench: Array
    bare: Array
    variance: Array
    usable: np.ndarray
    moment: Array


@dataclass(frozen=True, eq=False)
class Torques:
    """Torques of some rows, all filtered alike.

    Attributes:
        t: (rows,), s.
        qa: positions of the active joints, (active, rows), rad or m.
        motors: of the motors, and of the hand's moment where it is given, (measured, rows), N m or N.
        external: of the model less those of the motors, (measured, rows).
        covariance: of `external`, from the estimate's covariance and the uncertainty of dry friction,
            (measured, measured, rows).
        moment: of the hand where it is given, in the base frame, (3, rows), N m; (0, rows) where it is not.
    """

    t: Array
    qa: Array
    motors: Array
    external: Array
    covariance: Array
    moment: Array

    @staticmethod
    def joined(parts: Sequence[Torques]) -> Torques:
        """Concatenated."""
        return Torques(*(np.concatenate([getattr(p, f.name) for p in parts], axis=-1) for f in fields(Torques)))


def _pieces(estimate: Estimate, motion: Motion, moment: Array | None, speed: float) -> Iterator[Torques]:
    """Torques of the motion's rows, chunk by chunk."""
    model = estimate.model
    soft, chi = smoothed_friction(model, speed), raw_parameters(model, estimate.beta)
    to_joints = np.linalg.inv(model.device.row_map)
    for hard in chunks(model, motion):
        s = replace(hard, model=soft)
        motors, shown = s.measured(), np.zeros((0, s.stop - s.start))
        if moment is not None:
            low, high = s.plan.window(s.start, s.stop)
            handle = handle_motion(model, to_joints @ s.c)
            turned = np.einsum("nij,nj->ni", handle.rotation, moment[low:high])
            motors = motors + s.treated(np.einsum("nij,ni->jn", handle.row_jacobian[:, 3:], turned))
            shown = s.filtered(np.ascontiguousarray(turned.T))
        parts = (s.torque(raw_parameters(model, column)) for column in covariance_root(estimate.covariance).T)
        yield Torques(
            t=s.t,
            qa=to_joints @ s.centres(s.c),
            motors=motors,
            external=s.torque(chi) - motors,
            covariance=_spread(parts, s.sizes(friction_uncertainty(soft, chi, s.c, s.cd, speed))),
            moment=shown,
        )


def _spread(parts: Iterable[Array], errors: Array) -> Array:
    """Covariance of torques from parameter contributions and independent errors, each (rows, samples)."""
    covariance = np.eye(len(errors))[:, :, None] * errors**2
    for part in parts:
        covariance += part[:, None] * part[None]
    return covariance


def lever_of(estimate: Estimate, qa: Array, noise: Array, given: bool, worst: float) -> Lever:
    """Map from torques to wrenches at these poses; the moment is unknown if not given and rows are six or more."""
    rows, handle = list(estimate.model.known_rows), handle_motion(estimate.model, qa)
    unknown = 6 if len(acting_rows(handle, rows)) >= 6 and not given else 3
    return lever(handle, rows, noise, unknown, worst)


def handle_force(estimate: Estimate, found: Lever, made: WrenchEstimate, notes: tuple[str, ...]) -> HandleForce:
    """The result, with zero or the given moment where it is not estimated, and notes on what is not determined."""
    known = 6 - found.unknown
    moment = "given" if len(made.moment) else "taken as zero" if known else "estimated"
    rest = made.moment if len(made.moment) else np.zeros((known, len(made.t)))
    se = np.full_like(made.variance, np.inf) if estimate.single_block else np.sqrt(made.variance)
    unknown = np.full((known, len(made.t)), np.nan)
    wrench, bare, se = (
        np.where(made.usable, np.concatenate(halves), np.nan).T
        for halves in ((made.wrench, rest), (made.bare, rest), (se, unknown))
    )
    notes = (*notes, *_limits(estimate, found, made.usable, moment))
    return HandleForce(estimate.model, made.t, wrench, bare, se, made.external, found, made.usable, moment, notes)


def _limits(estimate: Estimate, found: Lever, usable: np.ndarray, moment: str) -> Iterator[str]:
    """What these torques do not determine, in sentences."""
    if not usable.any():
        yield (
            f"No pose is usable: all {len(usable)} are too close to a singularity (condition number of the Jacobian "
            f"{found.condition.min():.3g} at best). Use other poses, or raise `worst_condition`."
        )
        return
    rows = found.acting
    if moment == "taken as zero":
        known = [name for name, wrench in zip(_COMPONENTS, found.determined, strict=True) if wrench]
        yield (
            f"{rows} torques do not determine the six components of a wrench. The force is correct where the hand "
            f"applies no moment; a moment of 1 N m causes a force error of up to {found.leak:.3g} N. Determined "
            f"whatever the moment: {counted(found.sure)} of force at each pose, and in the handle's own axes "
            f"{', '.join(known) or 'no component'} at all poses."
        )
    if rows < 3:
        yield (
            f"The torques determine the force along {counted(rows)} of the handle's own motion; components across are "
            f"unknown and shown as zero."
        )
    if not usable.all():
        yield (
            f"{int((~usable).sum())} of {len(usable)} rows are left out: their poses are too close to a "
            f"singularity (condition number of the Jacobian up to {found.condition.max():.3g})."
        )
    if estimate.single_block:
        names = ", ".join(estimate.base.names[k] for k in estimate.single_block)
        yield f"The standard errors of {names} cannot be estimated, so the force's interval is unbounded."
    if len(set(estimate.model.device.coordinate_units)) > 1:
        yield "Some coordinates turn and others slide: condition numbers depend on the units."


def counted(directions: int) -> str:
    """1 direction, 2 directions."""
    return f"{directions} direction{'s' * (directions != 1)}"
