"""Friction and other terms that the simulator lacks, as forces that are held for one of its steps."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import TermColumn
from haptid.device.expressions import CustomColumn
from haptid.device.terms.presliding import Presliding
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.term import Sliding
from haptid.device.terms.warming import Warming
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.experiment.bench.bodies import has_counterpart, joint_shares


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
        held = [(t, x) for t, x in zip(model.terms, raw, strict=True) if x and not has_counterpart(t)]
        terms, n = [_checked(term, model) for term, _ in held], len(model.device.joints)
        # Of each term: its coordinate as a combination of the joints, and the force on these where its column is 1.
        self._shares = np.array([joint_shares(model, term) for term in terms]).reshape(-1, n)
        self._forces = -np.array([value for _, value in held]).reshape(-1, 1) * self._shares
        self._names = [f"{letter}_{name}" for letter in "qv" for name in model.device.joint_names]
        self._shaped = [(k, term.shape) for k, term in enumerate(terms) if term.shape is not None]
        self._dry = [k for k, term in enumerate(terms) if term.shape is None]
        self._sliding = Sliding([terms[k] for k in self._dry])
        self._columns, self._history, self._step = np.zeros(len(terms)), np.zeros(len(terms)), step
        self._last: Array | None = None

    def __bool__(self) -> bool:
        return len(self._columns) > 0

    def __call__(self, t: float, q: Array, qd: Array, share: float) -> Array:
        """Force on every joint, (joints,), N m or N, from time and state of the joints, a share of a step later."""
        ahead, v = q + share * self._step * qd, self._shares @ qd
        if self._dry:
            self._columns[self._dry] = self._sliding(v[self._dry])
        named = dict(zip(self._names, [*ahead.tolist(), *qd.tolist()], strict=True))
        for k, shape in self._shaped:
            if isinstance(shape, CustomColumn):
                self._columns[k] = shape.at(named)
            elif isinstance(shape, Warming):
                self._columns[k] = shape.along(np.asarray(t), v[k])
            elif isinstance(shape, Counterbalance):
                self._columns[k] = shape.values(ahead)
            elif isinstance(shape, Presliding):
                self._columns[k] = self._slid(k, shape, q, ahead, float(v[k]))
        self._last = q.copy()
        return np.asarray(self._columns @ self._forces)

    def _slid(self, k: int, shape: Presliding, q: Array, ahead: Array, v: float) -> float:
        """The column of presliding at the position ahead, from its value before."""
        if self._last is not None:
            self._history[k] = shape.after(self._history[k], float(self._shares[k] @ (q - self._last)), v)
        return shape.after(self._history[k], float(self._shares[k] @ (ahead - q)), v)


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
