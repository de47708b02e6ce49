"""The force of the hand on the device, from the motors' torques and the model.

Source: Tahmasebi et al. (2005), eq. (14), with two slips mended: the Jacobian's angular rows are transposed, and the
hand's moment is a physical one, which the amplifiers' gain has nothing to do with.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, positive, read_only
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.wrench import Lever, lever
from haptid.errors import ForceSettingError
from haptid.estimation import Estimate
from haptid.motion.treatment import Motion
from haptid.observation.reversals import doubt, softened
from haptid.observation.rows import chunks
from haptid.validation.validation import Validation, direct

# Below this speed the sign of a velocity is smoothed, rad/s or m/s.
REVERSAL_SPEED = 0.01
# A pose is left out where the Jacobian's condition number is above this.
WORST_CONDITION = 30.0
NORMAL95 = 1.959963984540054
COMPONENTS = ("force x", "force y", "force z", "moment x", "moment y", "moment z")


@dataclass(frozen=True, eq=False)
class HandleForce:
    """The wrench of the hand on the device at the handle's origin, in the base frame, along a motion.

    The device's model is: torque of the model = torque of the motors + J' wrench, with the wrench that the hand exerts
    on the device. What the device exerts on the hand is its opposite: `on_hand`.

    Attributes:
        model: the dynamic model.
        t: (rows,), s.
        wrench: force, N, and moment, N m, of the hand on the device, (rows, 6); NaN at poses that are not usable.
        bare: the same without the dynamic model, as if motors balanced the hand alone, (rows, 6).
        se: deviation of `wrench`, from the estimate's covariance, the residual's level and the doubt of dry friction at
            reversals, (rows, 6); NaN for a moment that was given or taken as zero.
        external: torque of the hand on the measured torque rows, (motors, rows), N m or N.
        lever: poses, condition numbers, and what torques can tell of a wrench.
        usable: whether the wrench of each row was computed, or its pose was too near a singular one, (rows,).
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
        for name in ("t", "wrench", "bare", "sd", "external"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("wrench", "bare", "sd"):
            expect(name, getattr(self, name).shape, (len(self.t), 6))
        expect("external", self.external.shape, (None, len(self.t)))

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

    @cached_property
    def interval95(self) -> Array:
        """95 % intervals of `force`, (rows, 3, 2), N."""
        half = NORMAL95 * self.se[:, :3]
        return freeze(np.stack([self.force - half, self.force + half], axis=2))

    def summary(self) -> str:
        """Size of the force, its deviation, the poses, and what cannot be known, as text."""
        used = self.usable
        lines = [f"Force of the hand on {self.model.device.name}: {used.sum()} of {len(used)} rows"]
        if used.any():
            rms, bare, se = (np.sqrt((x[used, :3] ** 2).mean(axis=0)) for x in (self.wrench, self.bare, self.se))
            for k, axis in enumerate("xyz"):
                lines.append(
                    f"  {axis}: RMS {rms[k]:.4g} N, deviation {se[k]:.2g} N, without the model {bare[k]:.4g} N"
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
    """Force of the hand on the device: F = J_p^-T (tau_model - tau_motors - J_o' moment), treated as in `predict`.

    Args:
        estimate: the model.
        motion: with torques, while the hand pushes.
        validation: on unseen rows without a hand, treated alike: its residual is the noise of the torque rows; without
            it the residual of the fit is taken.
        moment: of the hand on the device about the handle's origin, in the handle's axes, at the motion's samples,
            (n, 3), N m, from a force sensor; None where it is not known. Six measured torque rows or more then tell it;
            with fewer it is taken as zero, as a gimbal or a thimble leaves it.
        reversal_speed: below it the sign of a velocity is smoothed and friction is in doubt, rad/s or m/s.
        worst_condition: condition number of the Jacobian beyond which a pose is left out.

    Raises:
        HandleMissingError: the device has no handle.
        ForceSettingError: a setting that means nothing, or a moment that is not a finite number.
        ChannelCountError, MotionTooShortError: as for `predict`.
        ShapeError: the moment does not fit the motion, or the validation the device.
    """
    model = estimate.model
    handle_of(model)
    check_settings(reversal_speed, worst_condition)
    if moment is not None:
        moment = np.asarray(moment, dtype=float)
        expect("moment", moment.shape, (len(motion), 3))
        check_finite("moment", moment)
    pieces = list(_pieces(estimate, motion, moment, reversal_speed))
    torques, noise = Torques.joined(pieces), noise_of(estimate, validation)
    found = lever_of(estimate, torques.qa, noise, moment is not None, worst_condition)
    covariance = torques.covariance + np.diag(noise**2)[:, :, None]
    told = Told(
        t=torques.t,
        external=torques.external,
        wrench=found.wrench(torques.external),
        bare=found.wrench(-torques.motors),
        variance=np.einsum("num,mkn,nuk->un", found.inverse, covariance, found.inverse, optimize=True),
        usable=found.usable,
        moment=torques.moment,
    )
    return handle_force(estimate, found, told, noted(validation))


UNVALIDATED = "No validation was given: the noise is the residual of the fit, which is smaller than on unseen rows."


def noted(validation: Validation | None) -> tuple[str, ...]:
    """What to say of the noise."""
    return () if validation is not None else (UNVALIDATED,)


def check_settings(reversal_speed: float, worst_condition: float) -> None:
    """Raise ForceSettingError for a setting that means nothing."""
    if not (reversal_speed == 0 or positive(reversal_speed)):
        raise ForceSettingError("reversal_speed", reversal_speed, "a finite speed, 0 or more")
    if not (positive(worst_condition) and worst_condition > 1):
        raise ForceSettingError("worst_condition", worst_condition, "a finite number above 1")


def check_finite(name: str, array: ArrayLike) -> None:
    """Raise ForceSettingError for the first entry that is not a finite number."""
    values = np.asarray(array, dtype=float)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        first = tuple(int(k) for k in bad[0])
        raise ForceSettingError(f"{name}[{', '.join(map(str, first))}]", float(values[first]), "a finite number")


def noise_of(estimate: Estimate, validation: Validation | None) -> Array:
    """Residual of each measured torque row, (rows,), N m or N."""
    errors = (validation or direct(estimate)).motors
    expect("validation.motors", (len(errors),), (sum(estimate.model.device.measured),))
    return np.array([error.rmse for error in errors])


@dataclass(frozen=True, eq=False)
class Told:
    """What the torques tell of the wrench, in the base frame.

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
    """Torques of some rows, all treated alike.

    Attributes:
        t: (rows,), s.
        qa: positions of the active joints, (active, rows), rad or m.
        motors: of the motors, and of the hand's moment where it is given, (measured, rows), N m or N.
        external: of the model less those of the motors, (measured, rows).
        covariance: of `external`, from that of the estimate and the doubt of dry friction, (measured, measured, rows).
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
        """One after the other."""
        return Torques(*(np.concatenate([getattr(p, f.name) for p in parts], axis=-1) for f in fields(Torques)))


def _pieces(estimate: Estimate, motion: Motion, moment: Array | None, speed: float) -> Iterator[Torques]:
    """Torques of the motion's rows, stretch by stretch."""
    model = estimate.model
    soft, chi = softened(model, speed), raw_parameters(model, estimate.beta)
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
        parts = (s.torque(raw_parameters(model, column)) for column in spread_columns(estimate).T)
        yield Torques(
            t=s.t,
            qa=to_joints @ s.centres(s.c),
            motors=motors,
            external=s.torque(chi) - motors,
            covariance=spread(parts, s.sizes(doubt(soft, chi, s.c, s.cd, speed))),
            moment=shown,
        )


def spread_columns(estimate: Estimate) -> Array:
    """Columns whose outer products sum to the covariance, (p, p)."""
    values, vectors = np.linalg.eigh(estimate.covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def spread(parts: Iterable[Array], doubts: Array) -> Array:
    """Covariance of torques whose contributions are `parts`, each (rows, samples), and independent `doubts`."""
    covariance = np.eye(len(doubts))[:, :, None] * doubts**2
    for part in parts:
        covariance += part[:, None] * part[None]
    return covariance


def lever_of(estimate: Estimate, qa: Array, noise: Array, given: bool, worst: float) -> Lever:
    """From torques to wrenches at these poses; whether the moment is given decides how much is unknown."""
    rows = [k for k, known in enumerate(estimate.model.device.measured) if known]
    return lever(handle_motion(estimate.model, qa), rows, noise, 6 if len(rows) >= 6 and not given else 3, worst)


def handle_force(estimate: Estimate, found: Lever, told: Told, notes: tuple[str, ...]) -> HandleForce:
    """The value, with zero or the given moment where it is not estimated, and what cannot be known."""
    known = 6 - found.unknown
    moment = "given" if len(told.moment) else "taken as zero" if known else "estimated"
    rest = told.moment if len(told.moment) else np.zeros((known, len(told.t)))
    deviation = np.full_like(told.variance, np.inf) if estimate.single_block else np.sqrt(told.variance)
    lacking = np.full((known, len(told.t)), np.nan)
    wrench, bare, se = (
        np.where(told.usable, np.concatenate(halves), np.nan).T
        for halves in ((told.wrench, rest), (told.bare, rest), (deviation, lacking))
    )
    notes = (*notes, *_doubts(estimate, found, told.usable, moment))
    return HandleForce(estimate.model, told.t, wrench, bare, se, told.external, found, told.usable, moment, notes)


def _doubts(estimate: Estimate, found: Lever, usable: np.ndarray, moment: str) -> Iterator[str]:
    """What cannot be known from these torques, in sentences."""
    if not usable.any():
        yield (
            f"No pose is usable: all {len(usable)} are too near a singular one (condition number of the Jacobian "
            f"{found.condition.min():.3g} at best). Move elsewhere, or raise `worst_condition`."
        )
        return
    rows = sum(estimate.model.device.measured)
    if moment == "taken as zero":
        known = [name for name, told in zip(COMPONENTS, found.determined, strict=True) if told]
        yield (
            f"{rows} torques cannot tell the six components of a wrench. The force is right where the hand applies no "
            f"moment; a moment of 1 N m that it does apply is taken for a force of up to {found.leak:.3g} N. Known "
            f"whatever the moment: {counted(found.sure)} of force at each pose, and in the handle's own axes "
            f"{', '.join(known) or 'no component'} at all poses."
        )
    if rows < 3:
        yield (
            f"The torques tell the force along {counted(rows)} of the handle's own motion; what lies across is not "
            f"known and is shown as zero."
        )
    if not usable.all():
        yield (
            f"{int((~usable).sum())} of {len(usable)} rows are left out: their poses are too near a "
            f"singular one (condition number of the Jacobian up to {found.condition.max():.3g})."
        )
    if estimate.single_block:
        names = ", ".join(estimate.base.names[k] for k in estimate.single_block)
        yield f"The estimate cannot say how far to trust {names}, so the force's interval is infinite."
    if len(set(estimate.model.device.coordinate_units)) > 1:
        yield "Some coordinates turn and others slide: condition numbers depend on the units."


def counted(directions: int) -> str:
    """1 direction, 2 directions."""
    return f"{directions} direction{'s' * (directions != 1)}"
