"""How well an estimate predicts torque, always on rows that the fit has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid.errors import DifferentModelError, SeenRowsError
from haptid.estimation import Estimate
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation, observe


@dataclass(frozen=True)
class MotorError:
    """The error of one motor's predicted torque.

    Attributes:
        motor, label, unit: "1", "motor 1", N m or N.
        residual, measured: norm(y - y_hat) and norm(y) of the treated torque, at the joint side.
        rows: compared.
    """

    motor: str
    label: str
    unit: str
    residual: float
    measured: float
    rows: int

    @property
    def relative(self) -> float:
        """100 norm(y - y_hat) / norm(y), per cent."""
        return percent(self.residual, self.measured)

    @property
    def rmse(self) -> float:
        """In the motor's unit."""
        return self.residual / float(np.sqrt(max(self.rows, 1)))


@dataclass(frozen=True)
class Validation:
    """Predicted against measured torque.

    Attributes:
        motors: errors by motor.
        seen: whether these are the rows of the fit (a direct comparison) or unseen ones (a cross validation).
    """

    motors: tuple[MotorError, ...]
    seen: bool

    @property
    def relative(self) -> float:
        """Of all motors' rows together, per cent; where units differ, the root mean square of the motors' own."""
        if len({m.unit for m in self.motors}) > 1:
            return float(np.sqrt(np.mean([m.relative**2 for m in self.motors])))
        return percent(
            float(np.linalg.norm([m.residual for m in self.motors])),
            float(np.linalg.norm([m.measured for m in self.motors])),
        )

    def summary(self) -> str:
        """A table as text: motor, relative error, RMSE, rows."""
        kind = "rows of the fit" if self.seen else "unseen rows"
        lines = [f"{self.relative:.2f} % relative error over all motors, on {kind}"]
        for m in self.motors:
            lines.append(f"  {m.label}: {m.relative:6.2f} %, RMSE {m.rmse:.4g} {m.unit}, {m.rows} rows")
        return "\n".join(lines)


def validate(estimate: Estimate, unseen: Motion | Observation) -> Validation:
    """Cross validation: predict rows that the fit has not seen.

    Args:
        estimate: what predicts.
        unseen: a motion of the same device, or an observation of one.

    Raises:
        SeenRowsError: rows of the observation were in the fit.
        DifferentModelError: the observation is of another device.
    """
    if isinstance(unseen, Motion):
        unseen = observe(estimate.model, unseen)
    shared = unseen.shares_rows_with(estimate.observation)
    if shared is not None:
        raise SeenRowsError(shared.log, shared.start, shared.stop)
    return compare(estimate, unseen, seen=False)


def direct(estimate: Estimate, observation: Observation | None = None) -> Validation:
    """Direct comparison, on the rows of the fit or some of them. It bounds nothing; `validate` does."""
    return compare(estimate, observation or estimate.observation, seen=True)


def compare(estimate: Estimate, observation: Observation, seen: bool) -> Validation:
    """Errors by motor, from the triangles alone."""
    if not observation.model.is_same_as(estimate.model):
        raise DifferentModelError(estimate.model.device.name, observation.model.device.name)
    errors = tuple(
        MotorError(
            motor.name, motor.label, motor.unit, motor.residual(estimate.beta), motor.norm, int(motor.rows.sum())
        )
        for motor in observation.motors
    )
    return Validation(errors, seen)


def pooled(*parts: Validation) -> Validation:
    """The errors of several validations together, each row counted once: the folds of a cross validation."""
    motors = tuple(
        MotorError(
            same[0].motor,
            same[0].label,
            same[0].unit,
            float(np.linalg.norm([m.residual for m in same])),
            float(np.linalg.norm([m.measured for m in same])),
            sum(m.rows for m in same),
        )
        for same in zip(*(part.motors for part in parts), strict=True)
    )
    return Validation(motors, any(part.seen for part in parts))


def percent(part: float, whole: float) -> float:
    """100 part / whole; nothing measured and nothing left is no error."""
    if whole > 0:
        return 100 * float(part) / float(whole)
    return float("inf") if part > 0 else 0.0
