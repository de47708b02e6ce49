"""Added-variable test: is a candidate regressor significant, using cluster-robust standard errors?

The test for a missing column is a fit that includes it (Breusch and Pagan 1980, Review of Economic Studies 47): the
column passes the same filter and decimation as torque and W, its parameter is estimated jointly with all others, and
its standard error is the default one, clustered by time blocks. So neither serially correlated residuals nor the
parameters already fitted are mistaken for structure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.estimation.intervals.added_columns import Bordered
from haptid.inference.diagnosis.subsample import log_name, row_ranges
from haptid.motion.motion import Motion
from haptid.observation.augmented import CandidateColumns, augmented_plan, reduced
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Block
from haptid.observation.r_factor import r_factor
from haptid.uncertainty.distributions import f_tail

# Blocks are merged down to this many: enough clusters for a standard error, and fast on long logs.
ENOUGH_BLOCKS = 60
# A column is collinear with the model's where a smaller share of its length is outside their range.
INDEPENDENT = 1e-4


@dataclass(frozen=True, eq=False)
class AddedVariableTest:
    """A fit that includes candidate columns.

    Attributes:
        values: their parameters, (k,), SI.
        covariance: cluster-robust, (k, k).
        dof: degrees of freedom, the least of the columns'.
        explained: share of the residual power that they explain, by motor, (motors,).
        shift: by how much they change the parameters of the other columns in the fit, in their order, SI.
    """

    values: Array
    covariance: Array
    dof: float
    explained: Array
    shift: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "values", "covariance", "explained", "shift")

    @property
    def se(self) -> Array:
        """Standard errors, (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def last(self, k: int) -> AddedVariableTest:
        """The same for the last k columns only, given the others."""
        return replace(self, values=self.values[-k:], covariance=self.covariance[-k:, -k:])

    @property
    def p(self) -> float:
        """p-value of the Wald test that all parameters are zero: Hotelling's T^2, Student's t for one column."""
        k = len(self.values)
        dof = self.dof - k + 1
        if dof < 1:
            return 1.0
        T2 = float(self.values @ np.linalg.pinv(self.covariance, hermitian=True) @ self.values)
        return float(f_tail(T2 * dof / (self.dof * k), k, dof))


@dataclass(frozen=True, eq=False)
class AugmentedRows:
    """The rows of an estimate with candidate columns after those of its base parameters.

    Attributes:
        estimate: whose rows.
        observation: the same rows; `columns` beyond the base parameters are the candidates'.
        first: first column of each candidate.
        candidates: what was added.
    """

    estimate: Estimate
    observation: Observation
    first: tuple[int, ...]
    candidates: tuple[CandidateColumns, ...]
    _shared: dict[tuple[frozenset[int], int | None], Bordered | None] = field(
        default_factory=dict, init=False, repr=False
    )

    def test(
        self, candidates: Sequence[int], excluded: Sequence[int] = (), motor: int | None = None
    ) -> AddedVariableTest | None:
        """A fit that includes some candidates; None where their columns are collinear with the model's.

        Args:
            candidates: indices of the candidates.
            excluded: base parameters that are left out of the fit.
            motor: the one whose rows are fitted; all where None.
        """
        chosen = slice(None) if motor is None else slice(motor, motor + 1)
        bordered = self._bordered(frozenset({*excluded, *self.estimate.zero}), motor)
        new = [self.first[e] + j for e in candidates for j in range(self.candidates[e].count)]
        found = bordered.fit(new, INDEPENDENT) if bordered else None
        if found is None:
            return None
        before = [own.residual(self.estimate.beta) for own in self.estimate.observation.motors[chosen]]
        after = [own.residual(found.beta) for own in self.observation.motors[chosen]]
        explained = 1.0 - np.square(after) / np.where(np.array(before) > 0, np.square(before), 1.0)
        return AddedVariableTest(found.values, found.covariance, float(found.dof.min()), explained, found.shift)

    def each(self, candidates: Sequence[int], labels: Sequence[str]) -> list[tuple[str, AddedVariableTest]]:
        """Tests of single candidates, one of each motor, with its label; without those that are collinear."""
        tests = [(label, self.test([e])) for label, e in zip(labels, candidates, strict=True)]
        return [(label, test) for label, test in tests if test is not None]

    def _bordered(self, left_out: frozenset[int], motor: int | None) -> Bordered | None:
        """What all fits have in common that leave out the same base parameters, of one motor or of all."""
        key = (left_out, motor)
        if key not in self._shared:
            chosen = slice(None) if motor is None else slice(motor, motor + 1)
            rows, base = self.observation.motors[chosen], len(self.estimate.beta)
            reached = np.unique(np.concatenate([own.columns for own in rows]))
            kept = np.array([k for k in reached if k < base and k not in left_out], dtype=int)
            others = base + np.arange(sum(one.count for one in self.candidates))
            self._shared[key] = Bordered.of(rows, self.estimate.weights[chosen], kept, others)
        return self._shared[key]


def augment(estimate: Estimate, candidates: Sequence[CandidateColumns]) -> AugmentedRows:
    """Compute the rows of an estimate again, with candidate columns.

    Args:
        estimate: whose observation holds the motions.
        candidates: all columns that will be tested.
    """
    first = len(estimate.beta) + np.cumsum([0, *(candidate.count for candidate in candidates)])
    parts = [_observed(estimate, motion, candidates) for motion in estimate.observation.motions]
    blocks = tuple(block for part, _ in parts for block in part)
    groups = _groups(len(blocks))
    motors = tuple(_merged([motors[m] for _, motors in parts], groups) for m in range(len(parts[0][1])))
    ends = tuple(replace(blocks[group[0]], stop=blocks[group[-1]].stop) for group in groups)
    observation = replace(estimate.observation, motors=motors, blocks=ends)
    return AugmentedRows(estimate, observation, tuple(int(k) for k in first[:-1]), tuple(candidates))


def device_rows(estimate: Estimate) -> list[int]:
    """The device's row of each motor of an estimate's observation."""
    return [estimate.model.device.row_names.index(motor.name) for motor in estimate.observation.motors]


def _observed(
    estimate: Estimate, motion: Motion, candidates: Sequence[CandidateColumns]
) -> tuple[tuple[Block, ...], tuple[MotorRows, ...]]:
    """Blocks of one motion that the estimate was made from, and every motor's rows."""
    wide = augmented_plan(estimate.model, motion, raw_parameters(estimate.model, estimate.beta), candidates)
    blocks, ranges = wide.blocks(log_name(motion)), list(row_ranges(wide, estimate.observation.blocks))
    some = [block for start, stop in ranges for block in blocks[start // wide.block : -(-stop // wide.block)]]
    return tuple(some), reduced(wide, device_rows(estimate), ranges)


def _groups(blocks: int) -> list[np.ndarray]:
    """Indices of blocks, grouped with their neighbours into at most ENOUGH_BLOCKS groups."""
    index, size = np.arange(blocks), -(-blocks // ENOUGH_BLOCKS)
    return [index[k : k + size] for k in range(0, blocks, size)]


def _merged(parts: Sequence[MotorRows], groups: Sequence[np.ndarray]) -> MotorRows:
    """One motor's rows of all motions, group by group."""
    T = np.concatenate([part.r_factors for part in parts])
    counts = np.concatenate([part.rows for part in parts])
    size = T.shape[-1]
    r_factors = np.stack([r_factor(T[group].reshape(-1, size)) for group in groups])
    return replace(parts[0], r_factors=r_factors, rows=np.array([counts[group].sum() for group in groups]))
