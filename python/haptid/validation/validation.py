"""Validation: prediction errors of an estimate's torque on rows that were not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.errors import SharedRowsError
from haptid.estimation import Estimate
from haptid.estimation.torque_shares import carrying, shares_of_torque
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation, different_models, observe

# Error, per cent, from which on a small torque does not follow the model: its channel may be dead.
_NOTHING = 100.0


@dataclass(frozen=True)
class MotorError:
    """Prediction error of one motor's torque.

    Attributes:
        motor, label, unit: "1", "motor 1", N m or N.
        residual, measured: norm(y - y_hat) and norm(y) of the treated torque, at the joint side.
        rows: number of rows.
        free: whether it is no motor but a joint that nothing drives: `measured` is then the size of the terms that are
            to cancel, see `MotorRows.size`.
    """

    motor: str
    label: str
    unit: str
    residual: float
    measured: float
    rows: int
    free: bool = False

    @property
    def relative(self) -> float:
        """Relative error 100 norm(y - y_hat) / norm(y), per cent."""
        return percent(self.residual, self.measured)

    @property
    def rmse(self) -> float:
        """Root mean square error, in the motor's unit."""
        return self.residual / float(np.sqrt(max(self.rows, 1)))

    @property
    def rms(self) -> float:
        """Root mean square of the torque, in the motor's unit."""
        return self.measured / float(np.sqrt(max(self.rows, 1)))


@displayed
@dataclass(frozen=True)
class Validation:
    """Prediction errors of all motors' torque.

    Attributes:
        motors: errors by motor.
        seen: whether the rows were fitted (in-sample errors) or not (out-of-sample errors).
        reference: the same errors on all rows behind the reference filter; None where they were not computed.
    """

    motors: tuple[MotorError, ...]
    seen: bool
    reference: Validation | None = None

    @property
    def comparable(self) -> Validation:
        """The errors to compare between treatments: those behind the reference filter where there are any.

        The rows of a treatment lie away from reversals and behind its own filter, and flatter it.
        """
        return self.reference or self

    @property
    def mixed(self) -> bool:
        """Whether the motors' torques have different units."""
        return len({m.unit for m in self.motors if not m.free}) > 1

    @property
    def together(self) -> str:
        """What `relative` is of, as text."""
        return "of all motors (RMS of the errors by unit)" if self.mixed else "over all motors"

    @property
    def relative(self) -> float:
        """Relative error of all motors, per cent, as `of_all_motors` defines it; without free joints."""
        driven = [m for m in self.motors if not m.free]
        residual, measured = (np.array([getattr(m, key) for m in driven]) for key in ("residual", "measured"))
        if not measured.any():
            return percent(float(np.linalg.norm(residual)), 0.0)
        return float(100 * np.sqrt(of_all_motors(measured**2, [m.unit for m in driven]) @ residual**2))

    @property
    def small(self) -> tuple[tuple[MotorError, float], ...]:
        """Motors that carry hardly any of the torque in their unit, with their share of its RMS."""
        driven = [m for m in self.motors if not m.free]
        squares, units = np.array([m.rms**2 for m in driven]), [m.unit for m in driven]
        judged, share = carrying(squares, units), shares_of_torque(squares, units)
        return tuple((m, float(share[k])) for k, m in enumerate(driven) if not judged[k])

    @property
    def silent(self) -> tuple[MotorError, ...]:
        """Those of the small ones whose error is above their torque: channels that may be dead."""
        return tuple(m for m, _ in self.small if m.relative > _NOTHING)

    @property
    def largest(self) -> MotorError:
        """The motor with the largest relative error, of those that carry torque."""
        small = [m for m, _ in self.small]
        return max((m for m in self.motors if m not in small and not m.free), key=lambda motor: motor.relative)

    def summary(self) -> str:
        """Text table: motor, relative error, RMSE, rows."""
        kind = "rows of the fit" if self.seen else "unseen rows"
        lines = (
            f"  {m.label}: {m.relative:6.2f} %, RMSE {m.rmse:.4g} {m.unit}, {m.rows} rows"
            if m.rows
            else f"  {m.label}: no rows"
            for m in self.motors
        )
        text = "\n".join([f"{self.relative:.2f} % relative error {self.together}, on {kind}", *lines])
        if self.reference is None:
            return text
        by_motor = ", ".join(f"{m.label} {m.relative:.2f} %" for m in self.reference.motors if m.rows)
        errors = f"{self.reference.relative:.2f} % ({by_motor})"
        return f"{text}\n  on all rows in motion, behind the reference filter: {errors}"

    def _shown(self) -> Overview:
        kind = "rows of the fit" if self.seen else "unseen rows"
        reference = {m.motor: f"{m.relative:.2f}" for m in self.reference.motors} if self.reference else {}
        rows = [
            [m.label, f"{m.relative:.2f}", reference.get(m.motor, ""), f"{m.rmse:.4g} {m.unit}", str(m.rows)]
            for m in self.motors
        ]
        title = f"Validation: {self.relative:.2f} % relative error {self.together}, on {kind}"
        return Overview(title, ("", "error, %", "in motion, %", "RMSE", "rows"), rows)


def validate(
    estimate: Estimate, unseen: Motion | Observation, reference: Motion | Observation | None = None
) -> Validation:
    """Out-of-sample prediction errors, on rows that were not fitted.

    Args:
        estimate: whose torque.
        unseen: a motion of the same device, or an observation of one.
        reference: the same log behind the reference filter with all rows, `treat(log, proposal.reference)`; only the
            rows that are nearer to the blocks of `unseen` than to fitted ones count, and without any there is no
            reference.

    Raises:
        SharedRowsError: rows of the observation were fitted.
        ModelMismatchError: the observation is of another device.
    """
    if isinstance(unseen, Motion):
        unseen = observe(estimate.model, unseen)
    shared = unseen.shares_rows_with(estimate.observation)
    if shared is not None:
        raise SharedRowsError(
            f"the rows from {shared.start:.3f} to {shared.stop:.3f} s of log {shared.log[:12]} were fitted, so their "
            "errors do not validate the model.",
            where=shared.log,
            found=(shared.start, shared.stop),
            advice="Validate on another log, or hold blocks of this one out before the fit.",
        )
    validation = _compare(estimate, unseen, seen=False)
    if reference is None:
        return validation
    if isinstance(reference, Motion):
        reference = observe(estimate.model, reference)
    inside = _within(reference, unseen, estimate.observation)
    return replace(validation, reference=None if inside is None else _compare(estimate, inside, seen=False))


def _within(rows: Observation, unseen: Observation, fitted: Observation) -> Observation | None:
    """The blocks of some rows that are nearer to unseen blocks of their logs than to fitted ones; None without any.

    The filters of a treatment take rows from both ends of a log: those of the reference there count as well, so that
    treatments are compared on the same rows.
    """
    middles = np.array([0.5 * (block.start + block.stop) for block in rows.blocks])
    inside = np.zeros(len(rows.blocks), dtype=bool)
    for name in {block.log for block in unseen.blocks}:
        own = np.array([block.log == name for block in rows.blocks])
        to_unseen, to_fitted = (_distance(middles, name, part) for part in (unseen, fitted))
        inside |= own & (to_unseen <= to_fitted)
    return rows.pick(np.flatnonzero(inside)) if inside.any() else None


def _distance(times: Array, log: str, observation: Observation) -> Array:
    """From each time to the nearest block of a log in an observation, s; infinite without any."""
    distances = np.full(len(times), np.inf)
    for block in observation.blocks:
        if block.log == log:
            distances = np.minimum(distances, np.maximum(np.maximum(block.start - times, times - block.stop), 0.0))
    return distances


def fit_errors(estimate: Estimate, observation: Observation | None = None) -> Validation:
    """In-sample fit errors, on the fitted rows or some of them; they do not bound prediction errors, see `validate`."""
    return _compare(estimate, observation or estimate.observation, seen=True)


def _compare(estimate: Estimate, observation: Observation, seen: bool) -> Validation:
    """Errors by motor, from R factors alone."""
    if not observation.model.is_same_as(estimate.model):
        raise different_models(estimate.model, observation.model)
    errors = (
        MotorError(m.name, m.label, m.unit, m.residual(estimate.beta), m.size(estimate.beta), int(m.rows.sum()), m.free)
        for m in observation.motors
    )
    return Validation(tuple(errors), seen)


def pooled(*parts: Validation) -> Validation:
    """Errors of all folds of a cross-validation together, each row counted once."""
    motors = tuple(
        replace(
            same[0],
            residual=float(np.linalg.norm([m.residual for m in same])),
            measured=float(np.linalg.norm([m.measured for m in same])),
            rows=sum(m.rows for m in same),
        )
        for same in zip(*(part.motors for part in parts), strict=True)
    )
    references = [part.reference for part in parts if part.reference is not None]
    reference = pooled(*references) if len(references) == len(parts) else None
    return Validation(motors, any(part.seen for part in parts), reference)


def of_all_motors(squares: Array, units: Sequence[str]) -> Array:
    """Factors of the motors' squared residuals, (motors,), whose sum is the squared relative error of all motors.

    In each unit the squared residuals of its motors are divided by their squared torques, and the mean of the units is
    taken: a motor with hardly any torque does not decide. A unit without torque is left out.

    Args:
        squares: squared torque of each motor, (motors,), in its unit.
        units: of the motors' torques.
    """
    index = np.unique(np.asarray(units), return_inverse=True)[1]
    total = np.bincount(index, squares)[index]
    count = len(set(index[total > 0].tolist()))
    return np.divide(1.0, count * total, out=np.zeros(len(total)), where=total > 0)


def percent(part: float, whole: float) -> float:
    """100 part / whole, per cent; 0 where both are zero."""
    if whole > 0:
        return 100 * float(part) / float(whole)
    return float("inf") if part > 0 else 0.0
