"""The tables of terms of a device file as pydantic models, one for each kind of term."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    Tag,
)

from haptid.device.toml.keys import Arithmetic, Name, Names, Table, Text, Unit


class SearchedTable(Table):
    """A constant of a term that is estimated: start value and bounds."""

    start: Arithmetic
    low: Arithmetic | None = None
    high: Arithmetic | None = None


def _is_searched(value: Any) -> str:
    return "searched" if isinstance(value, dict | SearchedTable) else "given"


# A constant that is given, or one that is estimated.
_Constant = Annotated[
    Annotated[Arithmetic, Tag("given")] | Annotated[SearchedTable, Tag("searched")], Discriminator(_is_searched)
]


class CoordinateTable(Table):
    """A sum of joints' positions with factors, such as the length of a tendon, on which terms act."""

    name: Name
    joints: Annotated[dict[Name, Arithmetic], Field(min_length=1)]


class TermTable(Table):
    """Keys of every kind of term."""

    joints: Names | Literal["all", "active", "motorised"] | None = None
    motors: Names | Literal["all"] | None = None
    coordinates: Names | None = None
    prefix: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=20)] | None = None


class PlainTerm(TermTable):
    """A term without settings."""

    kind: Literal["rotor-inertia", "viscous", "viscous-by-direction", "offset"]


class CoulombTerm(TermTable):
    """Coulomb friction; width smooths the sign, rad/s or m/s."""

    kind: Literal["coulomb", "coulomb-by-direction"]
    width: _Constant = 0.0


class LoadFrictionTerm(TermTable):
    """Load-dependent Coulomb friction: sgn(v) |torque of the bodies|."""

    kind: Literal["load-friction"]
    width: Arithmetic = 0.0


class StribeckTerm(TermTable):
    """Stribeck friction: sgn(v) exp(-(|v| / velocity)^exponent)."""

    kind: Literal["stribeck"]
    velocity: _Constant
    exponent: _Constant = 2.0
    width: _Constant = 0.0


class DahlTerm(TermTable):
    """Dahl friction: dry friction that builds up over a distance after a reversal."""

    kind: Literal["dahl"]
    distance: _Constant


class MaxwellSlipTerm(TermTable):
    """Maxwell-slip elements in parallel: each is a spring up to its distance, and then Coulomb friction."""

    kind: Literal["maxwell-slip"]
    distances: Annotated[list[_Constant], Field(min_length=1, max_length=8)]


class LuGreTerm(TermTable):
    """LuGre friction: Dahl friction whose force is `breakaway` times larger before it slides."""

    kind: Literal["lugre"]
    distance: _Constant
    velocity: _Constant
    breakaway: _Constant


class WarmingTerm(TermTable):
    """Viscous friction of a cold device in addition: v exp(-t / time), with t since the start of the log, s."""

    kind: Literal["warming"]
    time: _Constant


class RippleTerm(TermTable):
    """Torque that repeats with the position (cogging, eccentric capstan, gear mesh): its period, rad or m."""

    kind: Literal["ripple"]
    period: Arithmetic
    harmonics: Annotated[int, Field(ge=1, le=8)] = 1


class SpringTerm(TermTable):
    """Spring with a rest position."""

    kind: Literal["spring"]
    rest: Arithmetic = 0.0


class ElasticTerm(TermTable):
    """Spring and damper between a motor's rotor and what it drives; the rotor needs an inertia of its own.

    `play` is the torsion within which the spring has no torque, from end to end, and `rest` its middle, rad or m;
    `sensor` says that the log has the torque of the spring, as by a joint torque sensor.
    """

    kind: Literal["elastic"]
    damping: bool = True
    sensor: bool = False
    play: _Constant = 0.0
    rest: _Constant = 0.0


class CounterbalanceTerm(TermTable):
    """Counterbalance: a strut between link and parent."""

    kind: Literal["counterbalance"]
    crank: Arithmetic
    base: Arithmetic
    angle: Arithmetic = 0.0
    law: Literal["spring", "gas"]
    stroke: Arithmetic | None = None
    sign: Literal[-1, 1] = 1


class CustomTerm(TermTable):
    """Custom column, given as an expression."""

    kind: Literal["custom"]
    name: Name
    unit: Unit
    expression: Text
    constants: dict[Name, _Constant] = {}


class ExtensionTerm(TermTable):
    """Columns of an extension, by its name in the entry points `haptid.terms`."""

    kind: Literal["extension"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$", max_length=60)]
    settings: dict[Name, Any] = {}
    constants: dict[Name, _Constant] = {}


AnyTerm = Annotated[
    PlainTerm
    | CoulombTerm
    | LoadFrictionTerm
    | StribeckTerm
    | DahlTerm
    | MaxwellSlipTerm
    | LuGreTerm
    | WarmingTerm
    | RippleTerm
    | SpringTerm
    | ElasticTerm
    | CounterbalanceTerm
    | CustomTerm
    | ExtensionTerm,
    Field(discriminator="kind"),
]
