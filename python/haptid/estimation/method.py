"""What every method of estimation can do, and what some can do besides."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import MethodSettingError
from haptid.estimation.fit import Fit
from haptid.estimation.knowledge import Knowledge
from haptid.observation.observation import Observation


class Method(Protocol):
    """How rows are weighted: a small frozen type, its settings its fields."""

    @property
    def name(self) -> str:
        """Short name, as in tables and the result file."""

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""

    def weights(self, observation: Observation) -> Array:
        """Weight of each motor's rows, (motors,)."""


@runtime_checkable
class ByRows(Method, Protocol):
    """A method that changes single rows before they are folded, such as `GLS` and `IRLS`."""

    def rows(self, observation: Observation) -> Observation:
        """The rows as least squares is to see them; `weights` is asked of these."""


@runtime_checkable
class Reduced(Method, Protocol):
    """A method that holds some base parameters at zero, such as `FixedAtZero`."""

    def zero(self, observation: Observation) -> tuple[int, ...]:
        """Their indices."""


@runtime_checkable
class Knowing(Method, Protocol):
    """A method that knows combinations of parameters beside the rows, such as `EqualityConstraints` and `Ridge`."""

    def knowledge(self, observation: Observation) -> Knowledge:
        """What it knows."""


@runtime_checkable
class Fitting(Method, Protocol):
    """A method whose solution is not that of least squares on triangles, such as `TLS`."""

    def fit(self, observation: Observation) -> Fit:
        """Its solution, and what each block adds to it."""


def rows_of(method: Method, observation: Observation) -> Observation:
    """The rows as least squares is to see them."""
    return method.rows(observation) if isinstance(method, ByRows) else observation


class _Weighting(Protocol):
    @property
    def weighting(self) -> Method: ...


class Around:
    """What a method around another takes from it: how rows are seen and weighed. The other is its field `weighting`."""

    @property
    def unit_residual(self: _Weighting) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""
        return self.weighting.unit_residual

    def rows(self: _Weighting, observation: Observation) -> Observation:
        """As the other method sees them."""
        return rows_of(self.weighting, observation)

    def weights(self: _Weighting, observation: Observation) -> Array:
        """Those of the other method, (motors,)."""
        return self.weighting.weights(observation)


class UnitRows:
    """What methods have in common whose rows come in units of their own deviation."""

    @property
    def unit_residual(self) -> bool:
        """The weighted residual has unit variance."""
        return True

    def weights(self, observation: Observation) -> Array:
        """Rows have their unit already, (motors,)."""
        return np.ones(len(observation.motors))


def only_weighs(method: Method) -> bool:
    """Whether a method does no more than weigh rows: it does not reduce, hold or know parameters."""
    return not (isinstance(method, Reduced | Knowing | Fitting) or hasattr(method, "hold"))


def expect_weighting(owner: str, method: Method) -> None:
    """Raise MethodSettingError unless a method does no more than weigh rows.

    Raises:
        MethodSettingError: it reduces, holds or knows parameters, which the method around it would not hear of.
    """
    if not only_weighs(method):
        wanted = "a method that only weighs rows: OLS, WLS, SUR, GLS, IRLS or Heteroscedastic"
        raise MethodSettingError(owner, "weighting", method.name, wanted)
