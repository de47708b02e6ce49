"""`RecursiveIdentification`: base parameters from blocks of rows as they come, with forgetting, in bounded memory.

The square-root information form: R factors of the blocks, whose weighted sum of squares is the information. A new block
adds its own, and multiplies the information of all before by exp(-seconds / forgetting). Blocks stay apart as clusters,
so that the intervals are those of a batch, robust to serial correlation; when they are too many, neighbours are joined.

Source: Bierman (1977), Factorization Methods for Discrete Sequential Estimation, chapter V (square-root information
filter), with exponential forgetting.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array, freeze, positive
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, setting_error
from haptid.estimation.estimate import Estimate, estimate
from haptid.estimation.intervals.covariance import Intervals
from haptid.estimation.least_squares import solve, unexcited
from haptid.estimation.method import expect_whole
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation
from haptid.observation.plan import LEAST_BLOCKS, Block
from haptid.observation.r_factor import r_factor

# Clusters span this many time constants of the forgetting; what is older counts for less than 1 per cent.
_SPANNED = 5.0
# Passes of the motors' weights, as in `WLS`.
_PASSES = 2


@dataclass(frozen=True, eq=False)
class GivenWeights:
    """Least squares with given weights of the motors' rows, and some parameters left out.

    Attributes:
        given: weights, (motors,).
        left_out: indices of base parameters.
    """

    name: ClassVar[str] = "recursive WLS"
    unit_residual: ClassVar[bool] = True
    given: Array
    left_out: tuple[int, ...]

    def weights(self, observation: Observation) -> Array:
        """As given, (motors,)."""
        del observation
        return self.given

    def zero(self, observation: Observation) -> tuple[int, ...]:
        """Indices of the parameters left out."""
        del observation
        return self.left_out


class RecursiveIdentification:
    """Base parameters of a model from blocks of rows, one after the other.

    Without forgetting, the estimate is that of all blocks at once, and so are its intervals until blocks are joined.
    Directions that no block has excited are left open: parameters in them have unbounded intervals, the others not.

    Args:
        model: the dynamic model.
        forgetting_s: time in which the weight of old information falls by a factor e, s of rows; None for none.
        most: clusters that are kept apart for the intervals.

    Raises:
        SettingError: a setting out of range.
    """

    def __init__(self, model: DynamicModel, forgetting_s: float | None = None, most: int = 64) -> None:
        if forgetting_s is not None and not positive(forgetting_s):
            wanted = "a finite time above zero, s, or None"
            raise setting_error("forgetting_s", forgetting_s, wanted)
        expect_whole("RecursiveIdentification", "most", most, 8)
        self.model, self.forgetting_s, self.most = model, forgetting_s, most
        self._span = 0.0 if forgetting_s is None else _SPANNED * forgetting_s / most
        self._blocks: list[Block] = []
        self._stacks: list[tuple[Array, ...]] = []  # R factors of a cluster, by motor
        self._rows: list[np.ndarray] = []  # of a cluster, by motor
        self._log_weights: list[float] = []  # of a cluster's information
        self._whole: tuple[Array, ...] = ()  # of all clusters with their weights, by motor
        self._like: Observation | None = None

    def __len__(self) -> int:
        """Clusters at present."""
        return len(self._blocks)

    @property
    def seconds(self) -> float:
        """Time of the rows that count, weighted, s."""
        spans = (block.stop - block.start for block in self._blocks)
        return float(sum(np.exp(w) * span for w, span in zip(self._log_weights, spans, strict=True)))

    def add(self, observation: Observation) -> None:
        """Take the blocks of an observation, in order of time.

        Raises:
            ModelMismatchError: they are of another model.
        """
        self.model.require_same(observation.model)
        self._like = self._like or observation
        for k, block in enumerate(observation.blocks):
            fade = 0.0 if self.forgetting_s is None else -(block.stop - block.start) / self.forgetting_s
            new = tuple(motor.r_factors[k] for motor in observation.motors)
            self._log_weights = [weight + fade for weight in self._log_weights]
            old, factor = self._whole or tuple(np.zeros_like(T) for T in new), np.exp(0.5 * fade)
            self._whole = tuple(r_factor(np.concatenate([factor * R, T])) for R, T in zip(old, new, strict=True))
            self._append(block, new, np.array([motor.rows[k] for motor in observation.motors]))

    def _append(self, block: Block, r_factors: tuple[Array, ...], rows: np.ndarray) -> None:
        """A block as a cluster of its own, or into the last one while that is short."""
        last = self._blocks[-1] if self._blocks else None
        self._blocks.append(block)
        self._stacks.append(r_factors)
        self._rows.append(rows)
        self._log_weights.append(0.0)
        after = last is not None and last.log == block.log and last.stop <= block.start + 1e-9 * self._span
        if last is not None and after and block.stop - last.start <= self._span * (1 + 1e-9):
            self._join(len(self._blocks) - 2)
        if len(self._blocks) <= self.most:
            return
        if self.forgetting_s is not None:
            self._join(0)
            return
        self._span = 2 * max(self._span, *(b.stop - b.start for b in self._blocks))
        for k in range(len(self._blocks) // 2):
            self._join(k)

    def _join(self, k: int) -> None:
        """Two neighbouring clusters as one, in the weight of the later."""
        weight = np.exp(0.5 * (self._log_weights[k] - self._log_weights[k + 1]))
        pairs = zip(self._stacks[k], self._stacks[k + 1], strict=True)
        self._stacks[k + 1] = tuple(r_factor(np.concatenate([weight * a, b])) for a, b in pairs)
        self._rows[k + 1] = weight**2 * self._rows[k] + self._rows[k + 1]
        first, second = self._blocks[k], self._blocks[k + 1]
        self._blocks[k + 1] = replace(second, start=first.start if first.log == second.log else second.start)
        for parts in (self._blocks, self._stacks, self._rows, self._log_weights):
            del parts[k]

    def observation(self) -> Observation:
        """The rows as they count now: every cluster with its weight, and as many rows as its weight leaves.

        Raises:
            IdentifiabilityError: there is no row yet.
        """
        if self._like is None:
            raise IdentifiabilityError("no block of rows was added yet.", advice="Move the device for some seconds.")
        weights = np.exp(np.array(self._log_weights))
        counts = np.rint(weights[:, None] * np.array(self._rows)).astype(int).T
        counts = np.maximum(counts, np.array(self._rows).T > 0)
        motors = []
        for m, motor in enumerate(self._like.motors):
            stack = np.sqrt(weights)[:, None, None] * np.array([own[m] for own in self._stacks])
            rows = replace(motor, r_factors=freeze(stack), rows=counts[m], rounding=0.0)
            rows.__dict__["whole"] = freeze(self._whole[m])  # known, and not to be computed again
            motors.append(rows)
        return Observation(self.model, tuple(motors), tuple(self._blocks), ())

    def estimate(self, intervals: Intervals | None = None) -> Estimate:
        """The parameters as they are known now, with intervals.

        Intervals are unbounded in directions that were not excited, and all of them with fewer than eight clusters.

        Args:
            intervals: covariance estimator; `ClusterRobust()` where None.

        Raises:
            IdentifiabilityError: there is no row yet, or a motor's torque was zero throughout.
            NoRowsError: fewer rows than parameters.
        """
        observation = self.observation()
        left_out, unknown = unexcited(observation.stack()[:-1, :-1])
        if len(self) < LEAST_BLOCKS:  # too few to estimate their scatter
            unknown = tuple(range(len(observation.base)))
        weights = np.ones(len(observation.motors))
        for _ in range(_PASSES):
            beta = solve(observation, weights, left_out).beta
            weights = np.array([WLS().weight(m, beta) if m.rows.any() else 0.0 for m in observation.motors])
        fitted = estimate(observation, GivenWeights(weights, left_out), intervals)
        if not unknown:
            return fitted
        own = fitted.quantities
        open_ones = tuple(sorted({*own.unbounded, *unknown}))
        return replace(fitted, quantities=replace(own, unbounded=open_ones), status="ill_conditioned")
