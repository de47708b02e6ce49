"""Standard parameters of a device, those that are free after symmetries, and targets: linear combinations of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.expressions import combination
from haptid.device.terms.term import TermColumn
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import AnyDevice, TargetTable

if TYPE_CHECKING:
    from haptid.device.geometry import Reader

# The ten inertial parameters of a link, in the order of every array of haptid: inertia tensor about the link
# frame's origin (XY = -integral of xy dm), first moments, mass.
INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
INERTIAL_UNITS = ("kg m^2",) * 6 + ("kg m",) * 3 + ("kg",)
# Symbol of the magnitude of the device file's gravity in targets, m/s^2.
_GRAVITY = "g"
# Powers of kg, m, s and rad in the units of parameters.
POWERS: Mapping[str, tuple[int, int, int, int]] = {
    "kg m^2": (1, 2, 0, 0),
    "kg m": (1, 1, 0, 0),
    "kg": (1, 0, 0, 0),
    "N m s/rad": (1, 2, -1, -1),
    "N s/m": (1, 0, -1, 0),
    "N s": (1, 1, -1, 0),
    "N m": (1, 2, -2, 0),
    "N": (1, 1, -2, 0),
    "N m/rad": (1, 2, -2, -1),
    "N/m": (1, 0, -2, 0),
}
_UNITS = {powers: unit for unit, powers in POWERS.items()}
# Largest distance of a power of length from an integer: beyond it, a length was added to a plain number.
WHOLE = 1e-6


@dataclass(frozen=True)
class Symmetry:
    """Parameters known to be zero or equal, and why.

    Attributes:
        reason: sentence.
        zero: names of parameters that vanish.
        equal: groups of names of parameters that have one value; "-MY2" stands for the value with the other sign.
    """

    reason: str
    zero: tuple[str, ...] = ()
    equal: tuple[tuple[str, ...], ...] = ()

    def among(self, names: Collection[str]) -> Symmetry:
        """The part of it that is about these parameters."""
        groups = (tuple(x for x in group if unsigned(x)[0] in names) for group in self.equal)
        zero = tuple(name for name in self.zero if name in names)
        return Symmetry(self.reason, zero, tuple(group for group in groups if len(group) > 1))


@dataclass(frozen=True, eq=False)
class StandardParameters:
    """The standard parameters chi of a device, and their order everywhere in haptid.

    `raw` are all columns of the core: ten per link, massless or not, then one per term. Massless links, zeros
    and equalities leave the free parameters chi: chi_raw = S chi. In each column of S the first entry is 1.

    Attributes:
        raw: names of the core's columns, (r,).
        raw_units: of each, (r,).
        names: of the free parameters, (p,); one that represents several has the name of the first.
        units: of each, (p,).
        kinds: of each, "ZZ" or "FV": its name without that of its joint or motor, (p,).
        links: index of the joint of each; the number of joints for a cut joint, -1 for a motor, (p,).
        S: (r, p), zeros and ones; -1 where a symmetry mirrors.
        members: the raw names that each represents, (p,).
        leaving: a sentence for every set of parameters that was removed.
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
        freeze_fields(self, S=(len(self.raw), len(self.names)))

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[str, int]:
        """Index of the free parameter of a raw name; removed names are absent."""
        return {name: k for k, members in enumerate(self.members) for name in members}

    @cached_property
    def sign(self) -> dict[str, float]:
        """1 or -1 by raw name: the raw value is this times that of its free parameter; removed names are absent."""
        rows = {name: row for row, name in enumerate(self.raw)}
        return {name: float(self.S[rows[name], k]) for name, k in self.index.items()}


def unsigned(name: str) -> tuple[str, int]:
    """A name of a symmetry without its sign, and the sign."""
    return (name[1:], -1) if name.startswith("-") else (name, 1)


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
        terms: columns in addition to link inertia.
        symmetries: names in them are raw names.
    """
    raw = raw_names(joints, terms)
    units = (*(INERTIAL_UNITS * len(joints)), *(term.unit for term in terms))
    place = {name: k for k, name in enumerate(raw)}
    signed = [[unsigned(name) for name in group] for rule in symmetries for group in rule.equal]
    first, sign, opposite = _classes(len(raw), [[(place[n], s) for n, s in group] for group in signed])
    vanish = opposite | {first[10 * j + k] for j, body in enumerate(bodies) if not body for k in range(10)}
    vanish |= {first[place[name]] for rule in symmetries for name in rule.zero}
    free = [k for k in range(len(raw)) if first[k] == k and k not in vanish]
    S = np.zeros((len(raw), len(free)))
    for column, k in enumerate(free):
        rows = [row for row, of in enumerate(first) if of == k]
        S[rows, column] = [sign[row] for row in rows]
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


def _classes(size: int, groups: list[list[tuple[int, int]]]) -> tuple[list[int], list[int], set[int]]:
    """Classes of indices that groups equate, each index with its sign in the group (union-find).

    Returns the smallest index of each one's class, its sign relative to that one, and the smallest indices of classes
    in which something equals its own opposite.
    """
    first, sign, opposite = list(range(size)), [1] * size, list[int]()

    def find(k: int) -> tuple[int, int]:
        total = 1
        while first[k] != k:
            k, total = first[k], total * sign[k]
        return k, total

    for (base, base_sign), *others in groups:
        for k, given in others:
            (one, one_sign), (other, other_sign) = sorted((find(base), find(k)))
            relative = base_sign * one_sign * given * other_sign
            if one != other:
                first[other], sign[other] = one, relative
            elif relative < 0:
                opposite.append(one)
    found = [find(k) for k in range(size)]
    return [k for k, _ in found], [s for _, s in found], {find(k)[0] for k in opposite}


def _owner(raw: int, joints: Sequence[str], terms: Sequence[TermColumn]) -> tuple[str, int]:
    """A parameter's kind and the index of its joint: the number of joints for a cut or sum, -1 for a motor."""
    if raw < 10 * len(joints):
        return INERTIAL[raw % 10], raw // 10
    term = terms[raw - 10 * len(joints)]
    what, _, name = term.on.partition(" ")
    others = {"cut": len(joints), "coordinate": len(joints), "motor": -1, "elastic": -1, "sensor": -1}
    return term.name.removesuffix(name), joints.index(name) if what == "joint" else others[what]


def _leaving(joints: Sequence[str], bodies: Sequence[bool], symmetries: Sequence[Symmetry]) -> list[str]:
    massless = [joint for joint, body in zip(joints, bodies, strict=True) if not body]
    sentences = [f"link {joint} is massless: its ten inertial parameters are zero" for joint in massless]
    for rule in symmetries:
        parts = [" = ".join([*rule.zero, "0"])] if rule.zero else []
        parts += [" = ".join(group) for group in rule.equal]
        sentences.append(f"symmetry: {', '.join(parts)} ({rule.reason})")
    return sentences


@dataclass(frozen=True, eq=False)
class Combination:
    """A target of the device file: a linear combination of standard parameters to report.

    Attributes:
        name: such as pi_4.
        text: as written.
        unit: of its value.
        row: factors of the free standard parameters, (p,), SI.
    """

    name: str
    text: str
    unit: str
    row: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "row")


def read_combinations(
    tables: AnyDevice, parameters: StandardParameters, reader: Reader, place: Place
) -> tuple[Combination, ...]:
    """The targets of a device file, in its order.

    Raises:
        DeviceFileError: a length has the name of a parameter, or of gravity; a target is zero in this device, or its
            unit cannot be determined.
    """
    if not tables.targets:
        return ()
    gravity = float(np.linalg.norm(reader.triple(tables.gravity, place.at("gravity"))))
    for name in reader.lengths:
        if name == _GRAVITY or name in parameters.raw:
            first = "the magnitude of gravity" if name == _GRAVITY else "a standard parameter"
            raise place.at("lengths", name).taken("name", name, f"{first}, in [targets]")
    constants = {**reader.lengths, _GRAVITY: gravity}
    return tuple(
        _combination(name, table, parameters, constants, place.at("targets", name))
        for name, table in tables.targets.items()
    )


def _combination(
    name: str,
    table: TargetTable | str,
    parameters: StandardParameters,
    constants: Mapping[str, float],
    place: Place,
) -> Combination:
    text, unit = (table.expression, table.unit) if isinstance(table, TargetTable) else (table, None)
    factors = combination(text, parameters.raw, constants, place)
    row = np.zeros(len(parameters))
    for raw, factor in factors.items():
        if raw in parameters.index:
            row[parameters.index[raw]] += factor * parameters.sign[raw]
    if not row.any():
        found = f'"{text}" is zero in this device'
        raise place.error(found, "Name a parameter that symmetries and massless links do not remove.")
    return Combination(name, text, unit or _unit(text, parameters, constants, factors, place), row)


def _unit(
    text: str,
    parameters: StandardParameters,
    constants: Mapping[str, float],
    factors: Mapping[str, float],
    place: Place,
) -> str:
    """The common unit of all parts of a combination."""
    of = dict(zip(parameters.raw, parameters.raw_units, strict=True))
    longer = {name: value if name == _GRAVITY else 2.0 * value for name, value in constants.items()}
    heavier = {**constants, _GRAVITY: 2.0 * constants[_GRAVITY]}
    lengths, gravities = (combination(text, parameters.raw, scaled, place) for scaled in (longer, heavier))
    found = {_product(of[n], lengths.get(n, 0.0) / f, gravities.get(n, 0.0) / f) for n, f in factors.items()}
    if len(found) > 1 or None in found:
        shown = ", ".join(sorted(unit for unit in found if unit)) or "no unit known here"
        what = f'the parts of "{text}" do not have a common unit ({shown}{" and others" if None in found else ""})'
        instead = 'Correct it, or give the unit: { expression = "...", unit = "kg m^2" }.'
        raise place.error(what, instead)
    return str(found.pop())


def _product(unit: str, longer: float, heavier: float) -> str | None:
    """A parameter's unit times the powers of length and gravity in its factor, None if these are not integers.

    Args:
        unit: of the parameter.
        longer: factor by which its coefficient grows when every length doubles.
        heavier: the same when gravity doubles.
    """
    if not (longer > 0 and heavier > 0):
        return None
    powers = np.log2([longer, heavier])
    metres, gravities = (round(power) for power in powers)
    if np.abs(powers - [metres, gravities]).max() > WHOLE:
        return None
    if not metres and not gravities:
        return unit
    if unit not in POWERS:
        return None
    kg, m, s, rad = POWERS[unit]
    made = (kg, m + metres + gravities, s - 2 * gravities, rad)
    return _UNITS.get(made) or _written(made)


def _written(powers: tuple[int, int, int, int]) -> str:
    """A unit without a name of its own, such as `kg m^3`."""
    named = zip(("kg", "m", "s", "rad"), powers, strict=True)
    return " ".join(f"{base}^{power}" if power != 1 else base for base, power in named if power)
