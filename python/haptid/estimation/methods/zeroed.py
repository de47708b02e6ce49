"""Least squares with some base parameters held at zero."""

from __future__ import annotations

from dataclasses import dataclass, field

from haptid.errors import BaseNameError
from haptid.estimation.method import Around, Method, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation


@dataclass(frozen=True)
class FixedAtZero(Around):
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
