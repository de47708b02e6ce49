"""Torque decomposition: inertia, Coriolis and centrifugal torque, gravity, friction and the other terms of the model.

Source: Tahmasebi et al. (2005), section III-E and figures 7 to 11.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.terms.friction import LoadDependentFriction
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import core_torque, raw_parameters, rigid
from haptid.dynamics.model import DynamicModel
from haptid.errors import index_of
from haptid.estimation import Estimate
from haptid.motion.motion import Motion
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk, chunks, gathered

RIGID = ("inertia", "Coriolis and centrifugal", "gravity")
FRICTION = ("viscous", "Coulomb", "Stribeck")
# Names of the parts by kind of term; rotors belong to inertia.
PARTS = {
    "viscous": "viscous",
    "coulomb": "Coulomb",
    "coulomb+": "Coulomb",
    "coulomb-": "Coulomb",
    "stribeck": "Stribeck",
    "offset": "offset",
    "spring": "spring",
}


@dataclass(frozen=True, eq=False)
class TorqueDecomposition:
    """The model's torque in parts, filtered like the measured torque; the parts sum to the model's torque.

    A base parameter counts with the part of the parameter it is named after: where an offset and a weight on a sliding
    joint regroup, so do their parts.

    Attributes:
        motors: label of each row, "motor 1" or "joint 5", (motors,).
        units: N m or N, (motors,).
        t: (rows,), s.
        parts: inertia (with rotors), Coriolis and centrifugal, gravity, then one for each kind of term, (parts,).
        torque: of each part, at the joint side, (parts, motors, rows).
        measured: torque, (motors, rows).
    """

    motors: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    parts: tuple[str, ...]
    torque: Array
    measured: Array

    def __post_init__(self) -> None:
        motors, samples = len(self.motors), len(self.t)
        freeze_fields(self, "t", torque=(len(self.parts), motors, samples), measured=(motors, samples))

    def __getitem__(self, part: str) -> Array:
        """Torque of one part, (motors, rows)."""
        return np.asarray(self.torque[index_of(part, self.parts, "part of the torque")])

    @cached_property
    def total(self) -> Array:
        """Torque of the whole model, (motors, rows)."""
        return freeze(self.torque.sum(axis=0))

    @cached_property
    def friction(self) -> Array:
        """Viscous, Coulomb and Stribeck torque together, (motors, rows)."""
        return freeze(self.torque[[part in FRICTION for part in self.parts]].sum(axis=0))

    @cached_property
    def rms(self) -> Array:
        """Of each part's torque, (parts, motors), N m or N."""
        return freeze(np.sqrt((self.torque**2).mean(axis=2)))

    @cached_property
    def shares(self) -> Array:
        """RMS of each part over that of the model's torque, (parts, motors); NaN where the model has no torque.

        Parts may cancel, so shares need not add to one.
        """
        whole = np.sqrt((self.total**2).mean(axis=1))
        return freeze(self.rms / np.where(whole > 0, whole, np.nan))

    def summary(self) -> str:
        """A table as text: RMS of each part, and its share of the model's."""
        width = max(len(part) for part in self.parts)
        lines = ["RMS torque of each part, and its share of the model's; parts may cancel"]
        for m, (motor, unit) in enumerate(zip(self.motors, self.units, strict=True)):
            lines.append(f"  {motor}")
            for k, part in enumerate(self.parts):
                lines.append(f"    {part:{width}s} {self.rms[k, m]:10.4g} {unit} {100 * self.shares[k, m]:6.1f} %")
        return "\n".join(lines)


def decompose_torque(estimate: Estimate, motion: Motion) -> TorqueDecomposition:
    """The parts of an estimate's torque along a motion, with the filter and decimation of `predict`.

    Args:
        estimate: with parameters.

    Raises:
        LogMismatchError: the motion has more or fewer channels than the device has coordinates or motors.
        MotionTooShortError: not one row fits between the filters' ends.
    """
    model = estimate.model
    chi = raw_parameters(model, estimate.beta)
    terms = {name: _only(model, chi, name) for name in dict.fromkeys(_part(t) for t in model.terms) if name}
    pieces = ((s.t, _torques(s, rigid(model, chi), terms), s.measured()) for s in chunks(model, motion))
    t, torque, measured = gathered(pieces, Plan.of(model, motion).rows)
    return TorqueDecomposition(
        motors=tuple(model.device.row_labels[k] for k in model.known_rows),
        units=tuple(model.device.torque_units[k] for k in model.known_rows),
        t=freeze(t),
        parts=(*RIGID, *terms),
        torque=freeze(torque),
        measured=freeze(measured),
    )


def _part(term: TermColumn) -> str:
    """The part that a term belongs to; none for rotors, which are inertia."""
    if term.kind == "rotor":
        return ""
    if term.nature == "external":
        named = {Counterbalance: "counterbalance", LoadDependentFriction: "friction by load"}
        return named.get(type(term.shape), "own columns")
    return PARTS[term.nature]


def _only(model: DynamicModel, chi: Array, part: str) -> Array:
    """The parameters of one part's terms, the others zero, (r,)."""
    links = 10 * len(model.device.joints)
    kept = [False] * links + [_part(term) == part for term in model.terms]
    return np.where(kept, chi, 0.0)


def _torques(chunk: Chunk, bodies: Array, terms: dict[str, Array]) -> Array:
    """Filtered torque of every part, (parts, motors, rows).

    The bodies' torque is linear in acceleration and, apart from it, quadratic in velocity: Coriolis and centrifugal
    torque is what velocity adds to the torque at rest, and inertia is the rest of the bodies' torque.
    """
    model, still = chunk.model, np.zeros_like(chunk.c)
    static = core_torque(model, bodies, chunk.c, still, still)
    velocity = chunk.treated(core_torque(model, bodies, chunk.c, chunk.cd, still) - static)
    gravity = chunk.treated(static)
    inertia = chunk.torque(bodies) - velocity - gravity
    return np.array([inertia, velocity, gravity, *(chunk.torque(chi) for chi in terms.values())])
