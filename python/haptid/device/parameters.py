"""Standard parameters: which there are, in which order, and which of them are free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, expect, read_only
from haptid.device.terms.term import TermColumn

# The ten inertial parameters of a link, in the order of every array of haptid: inertia tensor about the link
# frame's origin (XY = -integral of xy dm), first moments, mass.
INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
INERTIAL_UNITS = ("kg m^2",) * 6 + ("kg m",) * 3 + ("kg",)


@dataclass(frozen=True)
class Symmetry:
    """What is known beforehand about parameters, and why.

    Attributes:
        reason: sentence.
        zero: names of parameters that vanish.
        equal: groups of names of parameters that have one value.
    """

    reason: str
    zero: tuple[str, ...] = ()
    equal: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, eq=False)
class StandardParameters:
    """The standard parameters chi of a device and their order, of which this is the only owner.

    `raw` is every column of the core: ten per link, massless or not, then one per term. What remains after
    massless links, zeros and equalities are the free parameters: chi_raw = S chi.

    Attributes:
        raw: names of the core's columns, (r,).
        raw_units: of each, (r,).
        names: of the free parameters, (p,). One that stands for several has the first one's name.
        units: of each, (p,).
        kinds: of each, "ZZ" or "FV": its name without what it belongs to, (p,).
        links: index of the joint each belongs to, the number of joints for a cut joint's, -1 for a motor's, (p,).
        S: (r, p), zeros and ones.
        members: the raw names that each stands for, (p,).
        leaving: a sentence for every set of parameters that left.
    """

    raw: tuple[str, ...]
    raw_units: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[str, ...]
    links: tuple[int, ...]
    S: Array
    members: tuple[tuple[str, ...], ...]
    leaving: tuple[str, ...]

    def __post_init__(self) -> None:
        expect("S", self.S.shape, (len(self.raw), len(self.names)))
        object.__setattr__(self, "S", read_only(self.S))

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[str, int]:
        """Index of the free parameter that a raw name belongs to; the names that left are absent."""
        return {name: k for k, members in enumerate(self.members) for name in members}


def raw_names(joints: Sequence[str], terms: Sequence[TermColumn]) -> tuple[str, ...]:
    """Names of all columns of the core, in its order."""
    return (*(kind + joint for joint in joints for kind in INERTIAL), *(term.name for term in terms))


def standard_parameters(
    joints: Sequence[str],
    bodies: Sequence[bool],
    terms: Sequence[TermColumn],
    symmetries: Sequence[Symmetry] = (),
) -> StandardParameters:
    """Free parameters after massless links, zeros and equalities.

    Args:
        joints: names, in order.
        bodies: whether each joint's link has inertia.
        terms: columns beside link inertia.
        symmetries: names in them are raw names.
    """
    raw = raw_names(joints, terms)
    units = (*(INERTIAL_UNITS * len(joints)), *(term.unit for term in terms))
    place = {name: k for k, name in enumerate(raw)}
    first = _classes(len(raw), [[place[n] for n in group] for rule in symmetries for group in rule.equal])
    vanish = {first[10 * j + k] for j, body in enumerate(bodies) if not body for k in range(10)}
    vanish |= {first[place[name]] for rule in symmetries for name in rule.zero}
    free = [k for k in range(len(raw)) if first[k] == k and k not in vanish]
    S = np.zeros((len(raw), len(free)))
    for column, k in enumerate(free):
        S[[row for row, of in enumerate(first) if of == k], column] = 1.0
    owners = [_owner(k, joints, terms) for k in free]
    return StandardParameters(
        raw=raw,
        raw_units=units,
        names=tuple(raw[k] for k in free),
        units=tuple(units[k] for k in free),
        kinds=tuple(kind for kind, _ in owners),
        links=tuple(link for _, link in owners),
        S=S,
        members=tuple(tuple(raw[row] for row in np.flatnonzero(S[:, c])) for c in range(len(free))),
        leaving=tuple(_leaving(joints, bodies, symmetries)),
    )


def _classes(size: int, groups: list[list[int]]) -> list[int]:
    """The first index of each index's class, once the groups have been merged."""
    first = list(range(size))

    def find(k: int) -> int:
        while first[k] != k:
            k = first[k]
        return k

    for group in groups:
        roots = sorted(find(k) for k in group)
        for root in roots[1:]:
            first[root] = roots[0]
    return [find(k) for k in range(size)]


def _owner(raw: int, joints: Sequence[str], terms: Sequence[TermColumn]) -> tuple[str, int]:
    """A parameter's kind and the index of its joint, beyond the last one for a cut, -1 for a motor."""
    if raw < 10 * len(joints):
        return INERTIAL[raw % 10], raw // 10
    term = terms[raw - 10 * len(joints)]
    what, _, name = term.on.partition(" ")
    others = {"cut": len(joints), "motor": -1}
    return term.name.removesuffix(name), joints.index(name) if what == "joint" else others[what]


def _leaving(joints: Sequence[str], bodies: Sequence[bool], symmetries: Sequence[Symmetry]) -> list[str]:
    massless = [joint for joint, body in zip(joints, bodies, strict=True) if not body]
    sentences = [f"link {joint} is massless: its ten inertial parameters are zero" for joint in massless]
    for rule in symmetries:
        parts = [" = ".join([*rule.zero, "0"])] if rule.zero else []
        parts += [" = ".join(group) for group in rule.equal]
        sentences.append(f"symmetry: {', '.join(parts)} ({rule.reason})")
    return sentences
