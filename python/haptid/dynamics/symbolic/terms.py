"""Columns beside link inertia, modulo a prime: sums of parts that are independent unless they are the same."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from haptid.device import Counterbalance, Device, TermColumn
from haptid.dynamics.symbolic.laurent import ZERO, Laurent
from haptid.dynamics.symbolic.motion import States
from haptid.dynamics.symbolic.residues import Field, Residues
from haptid.dynamics.symbolic.symbols import LENGTH, PURE, Symbols, ratio

# Where each of these is found among a coordinate's position, velocity and acceleration.
MOTION = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class Part:
    """A factor times something that varies with the motion.

    Attributes:
        factor: number.
        what: position, velocity, acceleration, one.
        key: of a function that it is multiplied with, of which nothing is known but that functions with the same key
            are the same; None for none.
    """

    factor: Fraction
    what: str
    key: Hashable = None


@dataclass(frozen=True)
class ExactColumn:
    """A column beside link inertia, acting on a joint, or on a cut's or a motor's combination of active joints.

    Attributes:
        joint: index, None for a cut or a motor.
        weights: of a cut or a motor, one for each active joint.
        parts: what the column is at one of its coordinate's states.
        rest: taken off the position.
    """

    joint: int | None
    weights: tuple[Fraction, ...]
    parts: tuple[Part, ...]
    rest: Laurent = ZERO

    def modulo(
        self, field: Field, states: States, values: Mapping[str, Residues], functions: Mapping[Hashable, Residues]
    ) -> Residues:
        """Residues of the active joints' torques, (n, active)."""
        G, motion = self._coordinate(field, states)
        count = G.shape[0]
        total = np.zeros(count, dtype=np.int64)
        for part in self.parts:
            size = np.ones(count, dtype=np.int64) if part.what == "one" else motion[MOTION[part.what]]
            if part.what == "position":
                size = field.reduce(size - self.rest.modulo(field, values, count))
            if part.key is not None:
                size = field.reduce(size * functions[part.key])
            total = field.reduce(total + field.of(part.factor) * size)
        return field.reduce(G * total[:, None])

    def _coordinate(self, field: Field, states: States) -> tuple[Residues, tuple[Residues, ...]]:
        """Rates of the coordinate by active joint, (n, active), and its position, velocity, acceleration."""
        if self.joint is not None:
            each = (states.position, states.velocity, states.acceleration)
            return states.G[self.joint], tuple(quantity[self.joint] for quantity in each)
        weights = np.array([field.of(weight) for weight in self.weights])
        G = np.broadcast_to(weights, (states.active.shape[2], len(weights)))
        moved = field.reduce(field.reduce(states.active * weights[:, None]).sum(axis=1))  # a sum of few stays small
        return G, tuple(moved)


def exact_columns(device: Device, active: Sequence[int], symbols: Symbols) -> tuple[ExactColumn, ...]:
    """All terms of a device, cuts' and motors' by so many of its active joints."""
    names = device.joint_names
    made = []
    for term in device.terms:
        side, _, name = term.on.partition(" ")
        joint = names.index(name) if side == "joint" else None
        weights = tuple(ratio(float(w)) for w in (term.weights @ device.row_map)[list(active)])
        made.append(ExactColumn(joint, weights if joint is None else (), _parts(term), _rest(term, device, symbols)))
    return tuple(made)


def _rest(term: TermColumn, device: Device, symbols: Symbols) -> Laurent:
    """Rest of a spring, counted from where its combination of active joints is zero if it acts on a cut."""
    if term.kind != "spring":
        return Laurent()
    side, _, name = term.on.partition(" ")
    sliding = {f"joint {j.name}" for j in device.joints if j.prismatic}
    sliding |= {f"cut {cut.name}" for cut in device.cut_joints if cut.prismatic}
    slides, rest = term.on in sliding, term.settings[0]
    made = symbols.quantity(rest, f"rest{name}", LENGTH if slides else PURE) if rest else Laurent()
    return made - symbols.position(term.offset, slides, f"q{name}") if side == "cut" else made


def _parts(term: TermColumn) -> tuple[Part, ...]:
    """The parts of a term; friction along one direction, forward or backward, faster or slower, is told apart here."""
    plain = {"rotor": "acceleration", "viscous": "velocity", "offset": "one", "spring": "position"}
    if term.kind in plain:
        return (Part(Fraction(1), plain[term.kind]),)
    if term.kind == "external" and not term.side:
        shape = term.shape
        key = shape if isinstance(shape, Counterbalance) else getattr(shape, "text", "")
        return (Part(Fraction(1), "one", key),)
    if not term.weights.any():  # what it acts on never moves
        return ()
    first = float(term.weights[np.flatnonzero(term.weights)[0]])
    direction = tuple(np.round(term.weights / first, 9).tolist())
    sign, scale = Fraction(1 if first > 0 else -1), abs(first)
    if term.kind == "stribeck":
        velocity, exponent, width = term.settings
        return (Part(sign, "one", ("stribeck", direction, velocity / scale, exponent, width / scale)),)
    width = term.settings[0] / scale
    odd, half = ("coulomb", direction, width), Fraction(term.side, 2)
    if term.kind == "coulomb":
        return (Part(sign, "one", odd),)
    if term.nature == "viscous":
        # max(v, 0) = (v + v sgn v) / 2 and min(v, 0) = (v - v sgn v) / 2.
        return (Part(Fraction(1, 2), "velocity"), Part(sign * half, "velocity", odd))
    # sgn max(v, 0) = (|sgn v| + sgn v) / 2 and sgn min(v, 0) = (sgn v - |sgn v|) / 2, and |sgn v| is one but at rest.
    even = Part(half, "one", ("even", direction, width) if width else None)
    return (Part(sign / 2, "one", odd), even)
