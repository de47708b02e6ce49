"""Held-out rows of a device that is to be settled: every fit settles its own, so that it has seen nothing of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from operator import add

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Method, estimate
from haptid.estimation.nonlinear import EveryOther
from haptid.estimation.nonlinear.load_friction import settled
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation, observe
from haptid.validation.validation import Validation, pooled, validate


def each_log(model: DynamicModel, motion: Motion, others: Sequence[Motion], method: Method) -> Validation:
    """A motion predicted by constants, loads and parameters that were found from the others.

    Args:
        model: as its file has it, with searched constants or friction by load.
        motion: that is predicted.
        others: that are fitted.
        method: of estimation.

    Raises:
        HaptidError: as `settled`, `observe` and `estimate`.
    """
    found, _ = settled(model, others, method)
    fit: Observation = reduce(add, [observe(found, other) for other in others])
    return validate(estimate(fit, method), observe(found, motion))


def alternate(model: DynamicModel, motion: Motion, others: Sequence[Motion], method: Method) -> Validation:
    """Every other block of a motion predicted by what was found from the rest of it and the others; both ways round.

    Args and raises as for `each_log`.
    """

    def predicted() -> Iterator[Validation]:
        for parity in (0, 1):
            found, _ = settled(model, [EveryOther(motion, parity), *others], method)
            halves = observe(found, motion).alternate()
            fit: Observation = reduce(add, [observe(found, other) for other in others], halves[parity])
            yield validate(estimate(fit, method), halves[1 - parity])

    return pooled(*predicted())
