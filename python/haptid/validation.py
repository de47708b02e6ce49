"""How well an estimate predicts torque, always on rows that the fit has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid.errors import DifferentModelError, SeenRowsError
from haptid.estimators import Estimate
from haptid.observation import Observation, observe
from haptid.treatment import Motion


@dataclass(frozen=True)
class MotorError:
    """The error of one motor's predicted torque.

    Attributes:
        motor, unit: N m or N.
        relative: 100 norm(y - y_hat) / norm(y) of the treated torque, per cent.
        rmse: in the motor's unit, at the joint side.
        rows: compared.
    """

    motor: str
    unit: str
    relative: float
    rmse: float
    rows: int


@dataclass(frozen=True, eq=False)
class Validation:
    """Predicted against measured torque on one observation.

    Attributes:
        estimate: what predicts.
        observation: what was measured.
        seen: whether these are the rows of the fit (a direct comparison) or unseen ones (a cross validation).
        motors: errors by motor.
        relative: of all motors' rows together, per cent.
    """

    estimate: Estimate
    observation: Observation
    seen: bool
    motors: tuple[MotorError, ...]
    relative: float

    def summary(self) -> str:
        """A table as text: motor, relative error, RMSE, rows."""
        kind = "rows of the fit" if self.seen else "unseen rows"
        lines = [f"{self.relative:.2f} % relative error over all motors, on {kind}"]
        for m in self.motors:
            lines.append(f"  motor {m.motor}: {m.relative:6.2f} %, RMSE {m.rmse:.4g} {m.unit}, {m.rows} rows")
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
        unseen = observe(estimate.device, unseen)
    shared = unseen.shares_rows_with(estimate.observation)
    if shared is not None:
        raise SeenRowsError(shared.log, shared.start, shared.stop)
    return compare(estimate, unseen, seen=False)


def direct(estimate: Estimate, observation: Observation | None = None) -> Validation:
    """Direct comparison, on the rows of the fit or some of them. It bounds nothing; `validate` does."""
    return compare(estimate, observation or estimate.observation, seen=True)


def compare(estimate: Estimate, observation: Observation, seen: bool) -> Validation:
    """Errors by motor, from the triangles alone."""
    if observation.device is not estimate.device:
        raise DifferentModelError(estimate.device.name, observation.device.name)
    errors, residual, measured = [], 0.0, 0.0
    for motor in observation.motors:
        rest, norm, rows = motor.residual(estimate.beta), motor.norm, int(motor.rows.sum())
        residual, measured = np.hypot(residual, rest), np.hypot(measured, norm)
        relative = percent(rest, norm)
        errors.append(MotorError(motor.name, motor.unit, relative, rest / np.sqrt(max(rows, 1)), rows))
    return Validation(estimate, observation, seen, tuple(errors), percent(residual, measured))


def percent(part: float, whole: float) -> float:
    """100 part / whole; nothing measured and nothing left is no error."""
    if whole > 0:
        return 100 * float(part) / float(whole)
    return float("inf") if part > 0 else 0.0
