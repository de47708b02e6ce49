"""The protocols of estimation methods, and `Fit`: what a method makes of rows, with its score block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from haptid._internal.arrays import Array, positive, whole
from haptid._internal.late import dataclass
from haptid.errors import ConvergenceError, SettingError, setting_error
from haptid.estimation.block_moments import BATCH, BlockMoments
from haptid.estimation.least_squares import Knowledge, Solution
from haptid.observation.observation import Observation, stacked

# Weight of a free joint's rows beside those of a motor with the same residual. Their torque is zero at any scale of the
# parameters, and what noise of the positions leaves of it is the less the smaller these are: with full weight, n rows
# pull all parameters towards zero by about n over the squared ratio of signal to noise that the motors' rows have of
# them together. With a tenth of the weight the pull is a hundredth of it, and what no motor's row tells is found alike.
FREE_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution and the rows it was computed from.

    Attributes:
        observation: the rows that least squares was applied to, whitened or weighted one by one as the method does.
        weights: of each motor's rows, (motors,).
        solution: of these rows with these weights.
        unit_residual: whether the weighted residual has unit variance; otherwise its variance is estimated.
        noise: expected W'W of noise in the columns, subtracted from every motor's blocks of [W y]'[W y], each
            (blocks, p + 1, p + 1) over all base parameters; None where columns are exact.
        moved: by how much the errors of each time block move the parameters through nuisances that are estimated from
            the same rows, (blocks, p), SI; None without any.
    """

    observation: Observation
    weights: Array
    solution: Solution
    unit_residual: bool
    noise: Sequence[Array] | None = None
    moved: Array | None = None

    @cached_property
    def moments(self) -> BlockMoments:
        """Of every block of every motor that has rows."""
        blocks, G, s = zip(*self._cells(), strict=True)
        return BlockMoments(np.concatenate(G), np.concatenate(s), np.concatenate(blocks))

    @cached_property
    def pooled_moments(self) -> BlockMoments:
        """Of every block of time, summed over motors, and through the nuisances of the same rows."""
        made, added = self._own_moments, self.moved_scores
        return made if added is None else made.with_scores(made.s + added[made.block])

    @cached_property
    def _own_moments(self) -> BlockMoments:
        """Of every block of time, summed over motors, without nuisances."""
        count, k = len(self.observation.blocks), self.solution.root.shape[1]
        G, s, present = np.zeros((count, k, k)), np.zeros((count, k)), np.zeros(count, dtype=bool)
        for blocks, gram, score in self._cells():
            G[blocks] += gram
            s[blocks] += score
            present[blocks] = True
        return BlockMoments(G[present], s[present], np.flatnonzero(present))

    def with_moved(self, moved: Array | None) -> Fit:
        """The fit with the errors of other nuisances of the same rows, or of none; see `moved`."""
        made = replace(self, moved=moved)
        vars(made)["_own_moments"] = self._own_moments  # which nuisances do not change
        return made

    @cached_property
    def classical_covariance(self) -> Array:
        """Classical (nonrobust) covariance, valid for white residuals, (p, p); rows of free joints count as they do."""
        made = self.solution.classical_covariance(self.unit_residual)
        less = np.array([FREE_SHARE if motor.free else 1.0 for motor in self.observation.motors])
        if not self.unit_residual or (less == 1.0).all():
            return made
        U = stacked(self.observation.motors, self.weights * less, len(self.solution.beta))[:, :-1] @ made
        return np.asarray(U.T @ U)

    @cached_property
    def moved_scores(self) -> Array | None:
        """What nuisances of the same rows add to the score of each time block, (blocks, k); None without any."""
        return None if self.moved is None else self.moved @ np.linalg.pinv(self.solution.root).T

    def _cells(self) -> Iterator[tuple[np.ndarray, Array, Array]]:
        """Indices of some blocks of one motor, and their G and s."""
        solution = self.solution
        for m, (motor, weight) in enumerate(zip(self.observation.motors, self.weights, strict=True)):
            filled = np.flatnonzero(motor.rows > 0)
            for blocks in np.array_split(filled, 1 + len(filled) // BATCH):
                T = motor.r_factors[blocks] * weight
                U = T[:, :, :-1] @ solution.root[motor.columns]
                e = T[:, :, -1] - T[:, :, :-1] @ solution.beta[motor.columns]
                G, s = U.transpose(0, 2, 1) @ U, np.einsum("bij,bi->bj", U, e)
                if self.noise is not None:
                    N = self.noise[m][blocks]
                    G = G - solution.root.T @ N[:, :-1, :-1] @ solution.root
                    s = s - (N[:, :-1, -1] - N[:, :-1, :-1] @ solution.beta) @ solution.root
                yield blocks, G, s

    def combined(self, combinations: Array | None) -> Array:
        """Combinations (q, p) of base parameters in the coordinates of `moments`, (q, k); of each one where None."""
        return self.solution.root if combinations is None else combinations @ self.solution.root


class Method(Protocol):
    """An estimation method: how rows are weighted. A small frozen dataclass whose fields are its settings."""

    @property
    def name(self) -> str:
        """Short name, as in tables and the result file."""

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance; otherwise its variance is estimated."""

    def weights(self, observation: Observation) -> Array:
        """Weight of each motor's rows, (motors,)."""


@runtime_checkable
class ByRows(Method, Protocol):
    """A method that transforms single rows before they are reduced to R factors, such as `GLS` and `IRLS`."""

    def rows(self, observation: Observation) -> Observation:
        """The transformed rows, to which `weights` applies."""


@runtime_checkable
class Reduced(Method, Protocol):
    """A method that fixes some base parameters at zero, such as `FixedAtZero`."""

    def zero(self, observation: Observation) -> tuple[int, ...]:
        """Their indices."""


@runtime_checkable
class Knowing(Method, Protocol):
    """A method with equality constraints or priors, such as `EqualityConstraints` and `Ridge`."""

    def knowledge(self, observation: Observation) -> Knowledge:
        """The constraints and priors."""


@runtime_checkable
class Fitting(Method, Protocol):
    """A method whose solution is not that of least squares on R factors, such as `TLS`."""

    def fit(self, observation: Observation) -> Fit:
        """Its solution and the score of each block."""


@runtime_checkable
class PointEstimate(Method, Protocol):
    """A method whose estimates have no valid intervals, such as `EKF`: its standard errors count as infinite."""

    @property
    def why_no_intervals(self) -> str:
        """A sentence."""


def rows_of(method: Method, observation: Observation) -> Observation:
    """The rows that least squares is applied to."""
    return method.rows(observation) if isinstance(method, ByRows) else observation


class _Weighting(Protocol):
    @property
    def weighting(self) -> Method: ...


class Wrapper:
    """Base of methods that add constraints or penalties to another method, their field `weighting`."""

    @property
    def unit_residual(self: _Weighting) -> bool:
        """As of the wrapped method."""
        return self.weighting.unit_residual

    def rows(self: _Weighting, observation: Observation) -> Observation:
        """As the wrapped method transforms them."""
        return rows_of(self.weighting, observation)

    def weights(self: _Weighting, observation: Observation) -> Array:
        """Those of the wrapped method, (motors,)."""
        return self.weighting.weights(observation)


class UnitVarianceRows:
    """Base of methods whose rows are scaled to unit variance already."""

    unit_residual: ClassVar[bool] = True

    def weights(self, observation: Observation) -> Array:
        """One for each motor, less for a free joint, (motors,)."""
        return np.array([FREE_SHARE if motor.free else 1.0 for motor in observation.motors])


def expect_motors(method: str, observation: Observation) -> None:
    """Raise SettingError where rows are of free joints: `method` takes every row for a measured torque with noise."""
    if free := ", ".join(motor.label for motor in observation.motors if motor.free):
        raise SettingError(
            f"{method} takes the torque of every row as measured, and nothing drives {free}.",
            where="method",
            found=method,
            advice="Use WLS or IRLS.",
        )


def only_weights_rows(method: Method) -> bool:
    """Whether a method does no more than weight rows: no constraints, priors or fixed parameters."""
    return not (isinstance(method, Reduced | Knowing | Fitting) or hasattr(method, "constrain"))


def not_converged(method: str, passes: int, name: str, moved: float, limit: float) -> ConvergenceError:
    """The error for a fixed-point iteration whose last pass moved parameter `name` by `moved` standard errors."""
    return ConvergenceError(
        f"{method} has not converged after {passes} passes: the last one moved {name} by {moved:.2g} standard errors "
        f"(limit {limit:g}).",
        where=name,
        found=moved,
        limit=limit,
        advice="Allow more passes with `most`, or a larger `tolerance`; or begin nearer with another `start`.",
    )


def expect_weighting(owner: str, method: Method) -> None:
    """Check that a method does no more than weight rows.

    Raises:
        SettingError: it constrains or fixes parameters or has a prior, which the wrapping method would ignore.
    """
    if not only_weights_rows(method):
        wanted = "a method that only weights rows: OLS, WLS, SUR, GLS, IRLS or Heteroscedastic"
        raise setting_error("weighting", method.name, wanted, owner)


def expect_whole(owner: str, name: str, value: object, least: int) -> None:
    """Check that a setting is a whole number of at least `least`.

    Raises:
        SettingError: it is not.
    """
    if not (whole(value) and value >= least):  # type: ignore[operator]
        raise setting_error(name, value, f"a whole number, {least} or more", owner)


def expect_positive(owner: str, name: str, value: object, otherwise: str = "") -> None:
    """Check that a setting is a finite number above zero.

    Args:
        owner, name, value: of the setting.
        otherwise: what else is allowed, for the message.

    Raises:
        SettingError: it is not.
    """
    if not positive(value):
        raise setting_error(name, value, f"a finite number above zero{otherwise}", owner)
