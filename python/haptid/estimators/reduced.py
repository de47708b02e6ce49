"""Least squares with some base parameters held at zero."""

from __future__ import annotations

from dataclasses import dataclass, field

from haptid._values import Array
from haptid.errors import BaseNameError
from haptid.estimators.method import Method, expect_weighting, rows_of
from haptid.estimators.wls import WLS
from haptid.observation import Observation


@dataclass(frozen=True)
class Without:
    """Another method, with some base parameters left out: they are zero, without deviation.

    Weights are those of the fit with all parameters: they stand for the noise, which a smaller model does not change.

    Attributes:
        names: of the base parameters left out.
        weighting: how the motors' rows are weighted.
    """

    names: tuple[str, ...]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("Without", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name} without {len(self.names)}"

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""
        return self.weighting.unit_residual

    def rows(self, observation: Observation) -> Observation:
        """As the other method sees them with all parameters."""
        return rows_of(self.weighting, observation)

    def weights(self, observation: Observation) -> Array:
        """Those of the fit with all parameters, (motors,)."""
        return self.weighting.weights(observation)

    def zero(self, observation: Observation) -> tuple[int, ...]:
        """Indices of the base parameters left out.

        Raises:
            BaseNameError: the device has no base parameter of that name.
        """
        return indices(observation.base.names, self.names)


def indices(known: tuple[str, ...], names: tuple[str, ...]) -> tuple[int, ...]:
    """Places of some base parameters among all, ascending.

    Raises:
        BaseNameError: there is none of that name.
    """
    for name in names:
        if name not in known:
            raise BaseNameError(name, known)
    return tuple(sorted({known.index(name) for name in names}))
