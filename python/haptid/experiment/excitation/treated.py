"""Information of a planned motion behind the treatment of earlier logs, under the noise of their residuals.

Rows of W pass the parallel filter and the decimation, and those near reversals are dropped, as those of a log are.

Source: covariance of least squares under serially correlated noise, Hannan (1970), Multiple Time Series, section VII.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import fast_length
from haptid.dynamics.model import DynamicModel
from haptid.errors import MotionTooShortError
from haptid.estimation.estimate import Estimate
from haptid.estimation.intervals.model_based import Autoregression, Sandwich, burg, residual_runs
from haptid.experiment.bench.trajectories import Trajectory
from haptid.motion.motion import Motion
from haptid.motion.treatment import Treatment
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk, Rows

# Relative eigenvalues of the information of white noise below which a combination of parameters has none.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class TreatedNoise:
    """What becomes of planned motions in an identification: a treatment, and the noise that it leaves in the rows.

    Attributes:
        treatment: of the logs so far.
        dt: their sampling period, s.
        models: of the serial correlation of each measured motor's residual, from row to row, N m or N.
        variances: of each residual, (motors,), (N m)^2 or N^2.
        shifts: by how much one standard error of each part of what the treatment leaves uncertain, such as a delay,
            moves the base parameters, (k, p), SI; None where nothing is.
    """

    treatment: Treatment
    dt: float
    models: tuple[Autoregression, ...]
    variances: tuple[float, ...]
    shifts: Array | None = None

    @staticmethod
    def of(*estimates: Estimate) -> TreatedNoise:
        """Treatment and residuals of estimates from one log each, along one motion.

        Variances are corrected for the degrees of freedom of the fits.
        """
        motion = estimates[0].observation.motions[0]
        logs = [residual_runs(Rows(one.observation), one.beta) for one in estimates]
        models, variances = list[Autoregression](), list[float]()
        for motor, parts in zip(estimates[0].observation.motors, zip(*logs, strict=True), strict=True):
            runs = [run for own in parts for run in own]
            found, rows = burg(runs, Sandwich().most_order), sum(map(len, runs))
            per_dof = rows / max(1, rows - len(logs) * len(motor.columns))
            models.append(Autoregression((found.filters[-1],), per_dof * found.powers[-1:]))
            variances.append(per_dof * float(found.powers[0]))
        return TreatedNoise(motion.treatment, motion.dt, tuple(models), tuple(variances))

    def information(self, model: DynamicModel, planned: Callable[[float], Trajectory]) -> Array:
        """Inverse of the covariance of weighted least squares along a motion, (p, p), SI.

        With A = W'W and M = W'SW of rows in units of their noise, S its correlation, the covariance is A^-1 M A^-1;
        its inverse A M^-1 A is zero for what the motion does not excite. All of it is zero of a motion that is too
        short for the filter.

        Args:
            planned: the motion in steps of a period, s.
        """
        try:
            plan = Plan.of(model, self._motion(model, planned(self.dt)))
        except MotionTooShortError:
            return np.zeros((len(model.base),) * 2)
        A, M = np.zeros((2, len(model.base), len(model.base)))
        for start, stop in plan.segments():
            for W, own, variance in zip(Chunk.of(plan, start, stop).W, self.models, self.variances, strict=True):
                length = fast_length(2 * len(W))
                once = np.full(length // 2 + 1, 2.0)
                once[0] = 1.0
                once[-1] -= 1.0 - length % 2  # the Nyquist frequency, which even lengths have, has no counterpart
                X = fft.rfft(W, length, axis=0)
                A += W.T @ W / variance
                M += ((X.conj().T * (own.spectrum(length) * once / length)) @ X).real / variance**2
        found = _sandwiched(A, M)
        return found if self.shifts is None else _less_sure(found, self.shifts)

    def _motion(self, model: DynamicModel, made: Trajectory) -> Motion:
        """As a treated log: exact rates, so that only the filter of the rows and the drop of slow ones remain."""
        treatment = replace(self.treatment, cutoff_hz=None, velocity=None, torque_delay_s=0.0)
        still = np.zeros((len(made), sum(model.device.measured)))
        return Motion(made.dt, made.q, still, treatment, rates=(made.qd, made.qdd))


def _sandwiched(A: Array, M: Array) -> Array:
    """A M^-1 A in the directions that have information, (p, p)."""
    size = np.sqrt(np.diag(A))
    there = size > 0
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=there)
    values, vectors = np.linalg.eigh(A * scale[:, None] * scale)
    kept = vectors[:, values > _ROUNDING * values[-1]] if there.any() else vectors[:, :0]
    Z = scale[:, None] * kept
    right = Z.T @ A
    return np.asarray(right.T @ np.linalg.solve(Z.T @ M @ Z, right))


def _less_sure(information: Array, shifts: Array) -> Array:
    """Information, singular or not, where shifts add their squares to the covariance, (p, p): Woodbury's identity."""
    moved = shifts @ information
    return np.asarray(information - moved.T @ np.linalg.solve(np.eye(len(shifts)) + moved @ shifts.T, moved))
