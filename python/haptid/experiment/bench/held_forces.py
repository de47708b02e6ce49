"""Friction and other terms that the simulator lacks, as forces that are held for one of its steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import TermColumn
from haptid.device.expressions import CustomColumn
from haptid.device.terms.presliding import Presliding
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.warming import Warming
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.experiment.bench.bodies import has_counterpart, joint_shares


@dataclass(frozen=True, eq=False)
class _Held:
    """One term: its parameter and its coordinate as a combination of the joints, (joints,)."""

    term: TermColumn
    value: float
    shares: Array


class HeldForces:
    """Forces of all terms without counterpart in MuJoCo.

    During a step they are those of its middle, to which positions are extrapolated, so that holding adds no delay.

    Args:
        chi: its true free standard parameters, (p,), SI.
        step: of the simulator, s.

    Raises:
        ExportError: a term that depends on accelerations, or one whose sign jumps.
    """

    def __init__(self, model: DynamicModel, chi: Array, step: float) -> None:
        raw = (model.device.parameters.S @ chi)[10 * len(model.device.joints) :]
        self._names, self._step = model.device.joint_names, step
        self._held = [
            _Held(_checked(term, model), float(value), joint_shares(model, term))
            for term, value in zip(model.terms, raw, strict=True)
            if value and not has_counterpart(term)
        ]
        self._history = np.zeros(len(self._held))
        self._last: Array | None = None

    def __bool__(self) -> bool:
        return bool(self._held)

    def __call__(self, t: float, q: Array, qd: Array, share: float) -> Array:
        """Force on every joint, (joints,), N m or N, from time and state of the joints, a share of a step later."""
        ahead = q + share * self._step * qd
        force = np.zeros(len(q))
        for k, held in enumerate(self._held):
            force -= held.value * self._column(k, held, t, q, qd, ahead) * held.shares
        self._last = q.copy()
        return force

    def _column(self, k: int, held: _Held, t: float, q: Array, qd: Array, ahead: Array) -> float:
        shape, v = held.term.shape, float(held.shares @ qd)
        if isinstance(shape, Presliding):
            if self._last is not None:
                self._history[k] = shape.after(self._history[k], float(held.shares @ (q - self._last)), v)
            return shape.after(self._history[k], float(held.shares @ (ahead - q)), v)
        if isinstance(shape, Warming):
            return float(shape.along(np.array([t]), np.array([v]))[0])
        if isinstance(shape, Counterbalance):
            return float(shape.values(ahead[:, None])[0])
        if isinstance(shape, CustomColumn):
            named = {
                f"{letter}_{name}": np.array([x])
                for letter, values in (("q", ahead), ("v", qd))
                for name, x in zip(self._names, values.tolist(), strict=True)
            }
            return float(shape.values(named, 1)[0])
        return float(held.term.sliding(np.array([v]))[0])


def _checked(term: TermColumn, model: DynamicModel) -> TermColumn:
    """The term, if it can be held.

    Raises:
        ExportError: it cannot.
    """
    accelerations = {f"a_{name}" for name in model.device.joint_names}
    if isinstance(term.shape, CustomColumn):
        reads = term.shape.reads(accelerations)
    else:
        reads = term.kind == "external" and not isinstance(term.shape, Presliding | Warming | Counterbalance)
    if reads:
        raise ExportError(
            f"term {term.name} depends on accelerations, which the bench cannot apply as a force.",
            where=term.name,
            advice=f"Set {term.name} to 0 in the parameters, or take a device without this term.",
        )
    if term.kind != "external" and term.constant("width") == 0:
        raise ExportError(
            f"term {term.name} is of kind {term.kind!r} and its sign jumps, which the bench cannot apply as a force.",
            where=term.name,
            found=0.0,
            advice="Give the term a width, or write lugre friction, whose force is continuous.",
        )
    return term
