"""The tables of a device file as pydantic models: keys and types of values, before names are resolved."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    WithJsonSchema,
)


def _quantity(value: Any) -> float | str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("write a number, or arithmetic as text")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("write a finite number")
    return number


# A number, or arithmetic over pi and named lengths as text.
_Quantity = Annotated[
    Any,
    BeforeValidator(_quantity),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "examples": ["-pi/2", "d3 + 0.1"]}]}),
]
_Triple = Annotated[list[_Quantity], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$", max_length=40)]
_Signed = Annotated[str, Field(pattern=r"^-?[A-Za-z0-9_]+$", max_length=41)]
Names = Annotated[list[Name], Field(min_length=1)]
Text = Annotated[str, Field(min_length=1, max_length=2000)]
Unit = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[^\x00-\x1f\x7f]+$")]


_Numbers = Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=3, max_length=3)]
_PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Table(BaseModel):
    """A table that allows no other keys.

    One with the defaults alone is `model_construct`ed: checking it would build its validator at import.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, populate_by_name=True, defer_build=True)


class _Limits(_Table):
    """Limits of a joint."""

    position: Annotated[list[_Quantity], Field(min_length=2, max_length=2)] | None = None
    velocity: _Quantity | None = None
    torque: _Quantity | None = None


class JointTable(_Table):
    """Keys of joints of every convention."""

    name: Name
    alias: Text | None = None
    parent: Name | None = None
    type: Literal["revolute", "prismatic"] = "revolute"
    body: bool = True
    active: bool | None = None
    limits: _Limits = _Limits.model_construct()


class ModifiedDHJoint(JointTable):
    """Khalil-Kleinfinger: Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r)."""

    gamma: _Quantity = 0.0
    b: _Quantity = 0.0
    alpha: _Quantity = 0.0
    d: _Quantity = 0.0
    theta: _Quantity = 0.0
    r: _Quantity = 0.0


class StandardDHJoint(JointTable):
    """Standard Denavit-Hartenberg: Rz(theta) Tz(d) Tx(a) Rx(alpha)."""

    theta: _Quantity = 0.0
    d: _Quantity = 0.0
    a: _Quantity = 0.0
    alpha: _Quantity = 0.0


class PlacementJoint(JointTable):
    """A placement as in URDF, and the axis: of a universal or spherical joint, the direction across its first two."""

    type: Literal["revolute", "prismatic", "universal", "spherical"] = "revolute"  # type: ignore[assignment]
    xyz: _Triple = [0.0, 0.0, 0.0]
    rpy: _Triple = [0.0, 0.0, 0.0]
    axis: _Triple = [0.0, 0.0, 1.0]


class FrameTable(_Table):
    """A frame fixed to a link: modified Denavit-Hartenberg keys, or xyz and rpy."""

    gamma: _Quantity | None = None
    b: _Quantity | None = None
    alpha: _Quantity | None = None
    d: _Quantity | None = None
    theta: _Quantity | None = None
    r: _Quantity | None = None
    xyz: _Triple | None = None
    rpy: _Triple | None = None


class CutTable(_Table):
    """The joint at which a loop is cut; terms may act on it if it has a name."""

    name: Name | None = None
    type: Literal["revolute", "prismatic", "spherical"] = "revolute"
    body_a: Name
    frame_a: FrameTable = FrameTable.model_construct()
    body_b: Name
    frame_b: FrameTable = FrameTable.model_construct()


class LoopTable(_Table):
    """A loop: passive joints by relations, by a cut joint, or both."""

    relations: list[Text] = []
    passive: list[Name] = []
    cut: CutTable | None = None
    guess: dict[Name, _Quantity] = {}
    at: dict[Name, _Quantity] = {}


class TransmissionTable(_Table):
    """Whether torque rows are of motors or of joints, and how redundant motors share a torque."""

    torque_rows: Literal["motor", "joint"] | None = None
    weights: dict[Name, _Quantity] | None = None
    preload: dict[Name, _Quantity] = {}


class MotorTable(_Table):
    """A motor and its transmission."""

    name: Name
    drives: dict[Name, _Quantity] | None = None
    gear_ratio: _Quantity = 1.0
    torque_constant: _Quantity = 1.0
    command_unit: Literal["N m", "N", "V", "A", "counts"] = "N m"
    peak_torque: _PositiveNumber | None = None
    continuous_torque: _PositiveNumber | None = None
    torque_step: _PositiveNumber | None = None
    encoder_counts: _PositiveNumber | None = None


class CounterweightTable(_Table):
    """Where a counterweight may be put: the most mass, and two corners of a box in the link frame of the file."""

    link: Name
    most: _PositiveNumber
    low: _Numbers
    high: _Numbers


class PublishedTable(_Table):
    """A figure of the device that its maker or a paper states, for its data sheet; nothing is computed from it."""

    name: Text
    value: float | Text
    unit: Unit | None = None
    source: Text


class SearchedTable(_Table):
    """A constant of a term that is estimated: start value and bounds."""

    start: _Quantity
    low: _Quantity | None = None
    high: _Quantity | None = None


def _is_searched(value: Any) -> str:
    return "searched" if isinstance(value, dict | SearchedTable) else "given"


# A constant that is given, or one that is estimated.
_Constant = Annotated[
    Annotated[_Quantity, Tag("given")] | Annotated[SearchedTable, Tag("searched")], Discriminator(_is_searched)
]


class CoordinateTable(_Table):
    """A sum of joints' positions with factors, such as the length of a tendon, on which terms act."""

    name: Name
    joints: Annotated[dict[Name, _Quantity], Field(min_length=1)]


class TermTable(_Table):
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
    width: _Quantity = 0.0


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
    period: _Quantity
    harmonics: Annotated[int, Field(ge=1, le=8)] = 1


class SpringTerm(TermTable):
    """Spring with a rest position."""

    kind: Literal["spring"]
    rest: _Quantity = 0.0


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
    crank: _Quantity
    base: _Quantity
    angle: _Quantity = 0.0
    law: Literal["spring", "gas"]
    stroke: _Quantity | None = None
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


class AboutTable(_Table):
    """A body symmetric about an axis of its link frame."""

    link: Name
    axis: Literal["x", "y", "z"]


class MirrorTable(_Table):
    """A body that is the image of another one: its coordinates x, y, z in its link frame by those of the other."""

    link: Name
    of: Name
    axes: Annotated[list[Literal["x", "y", "z", "-x", "-y", "-z"]], Field(min_length=3, max_length=3)]


class SymmetryTable(_Table):
    """Parameters known to be zero or equal, and why."""

    reason: Text
    zero: list[Name] = []
    equal: list[Annotated[list[_Signed], Field(min_length=2)]] = []
    about: AboutTable | None = None
    identical: list[Name] = []
    mirror: MirrorTable | None = None


class BaseTable(_Table):
    """Placement of the first frame in the frame that gravity is given in."""

    xyz: _Triple = [0.0, 0.0, 0.0]
    rpy: _Triple = [0.0, 0.0, 0.0]


class HandleTable(BaseTable):
    """The frame at which the hand holds the device."""

    link: Name


class _ShapeTable(BaseTable):
    """A convex shape for collision checks, fixed to a link, in its link frame."""

    link: Name = "base"
    name: Name | None = None
    ignore: list[Name] = []


class SphereTable(_ShapeTable):
    """A ball about the origin of its frame."""

    kind: Literal["sphere"]
    radius: _Quantity


class RoundTable(_ShapeTable):
    """A capsule or cylinder about z; the length of a capsule is that of its straight part."""

    kind: Literal["capsule", "cylinder"]
    radius: _Quantity
    length: _Quantity


class BoxTable(_ShapeTable):
    """A box about the origin of its frame, with its edges."""

    kind: Literal["box"]
    size: _Triple


class HullTable(_ShapeTable):
    """The convex hull of points, such as of a mesh."""

    kind: Literal["hull"]
    points: Annotated[list[_Triple], Field(min_length=4, max_length=1000)]


AnyShape = Annotated[SphereTable | RoundTable | BoxTable | HullTable, Field(discriminator="kind")]


class WorldTable(_Table):
    """A world file: what stands about the device, in its base frame."""

    version: Literal[1] = Field(default=1, alias="schema")
    name: str = ""
    lengths: dict[Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], _Quantity] = {}
    collision: Annotated[list[AnyShape], Field(min_length=1, max_length=500)]


class GimbalTable(_Table):
    """An unmeasured passive gimbal at the handle, its axes through the handle's origin."""

    state: Literal["locked", "hanging", "free"]
    mass: _Quantity = Field(description="kg")
    com_radius: _Quantity = Field(description="distance of its centre of mass from the axes, m")
    inertia: _Quantity | None = Field(
        None, description="least moment of inertia about the handle's origin, kg m^2; default: mass * com_radius^2"
    )
    friction: _Quantity = Field(0.0, description="largest friction torque of all its axes together, N m")
    swing: _Quantity | None = Field(None, description="hanging: largest angle from hanging, rad; default 0.5")
    rate: _Quantity | None = Field(None, description="free: largest angular velocity, rad/s")


class PriorTable(_Table):
    """Prior value with its standard deviation."""

    value: _Quantity
    std: _Quantity | None = None


class PriorBodyTable(_Table):
    """Prior body, as from CAD: inertia XX YY ZZ XY XZ YZ about its centre of mass."""

    link: Name
    mass: _Quantity
    com: _Triple
    inertia: Annotated[list[_Quantity], Field(min_length=6, max_length=6)] | None = None
    std_percent: _Quantity | None = None


class PriorsTable(_Table):
    """Priors of parameters by name, and `bodies`."""

    model_config = ConfigDict(extra="allow", defer_build=True)
    __pydantic_extra__: dict[str, Annotated[PriorTable | _Quantity, Field(union_mode="left_to_right")]]

    bodies: list[PriorBodyTable] = []

    @property
    def parameters(self) -> dict[str, PriorTable | float | str]:
        """By name of the parameter."""
        return self.__pydantic_extra__


class TargetTable(_Table):
    """A target: linear combination of standard parameters, with its unit."""

    expression: Text
    unit: Unit | None = None


class BaseParametersTable(_Table):
    """Choice of base parameters."""

    keep: list[Name] = []
    tolerance: _Quantity = 1e-9


class DeviceTable(_Table):
    """Keys of device files of every convention."""

    version: Literal[1] = Field(default=1, alias="schema")
    name: Text
    description: str = ""
    serial: str = ""
    source: str = ""
    gravity: _Triple
    base: BaseTable = BaseTable.model_construct()
    lengths: dict[Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], _Quantity] = {}
    loops: list[LoopTable] = []
    transmission: TransmissionTable = TransmissionTable.model_construct()
    motors: list[MotorTable] = []
    coordinates: list[CoordinateTable] = []
    terms: list[AnyTerm] = []
    symmetry: list[SymmetryTable] = []
    handle: HandleTable | None = None
    collision: Annotated[list[AnyShape], Field(max_length=500)] = []
    gimbal: GimbalTable | None = None
    prior: PriorsTable = PriorsTable.model_validate({})
    base_parameters: BaseParametersTable = BaseParametersTable.model_construct()
    targets: dict[Name, Annotated[TargetTable | Text, Field(union_mode="left_to_right")]] = {}
    published: list[PublishedTable] = []
    counterweights: list[CounterweightTable] = []


class ModifiedDHDevice(DeviceTable):
    """A device described by modified Denavit-Hartenberg parameters (Khalil and Kleinfinger)."""

    convention: Literal["modified-dh"] = "modified-dh"
    joints: Annotated[list[ModifiedDHJoint], Field(min_length=1, max_length=120)]


class StandardDHDevice(DeviceTable):
    """A device described by standard Denavit-Hartenberg parameters."""

    convention: Literal["dh"]
    joints: Annotated[list[StandardDHJoint], Field(min_length=1, max_length=120)]


class PlacementDevice(DeviceTable):
    """A device described by placements and axes."""

    convention: Literal["placement"]
    joints: Annotated[list[PlacementJoint], Field(min_length=1, max_length=120)]


AnyDevice = ModifiedDHDevice | StandardDHDevice | PlacementDevice
AnyJoint = ModifiedDHJoint | StandardDHJoint | PlacementJoint
CONVENTIONS: dict[str, type[ModifiedDHDevice] | type[StandardDHDevice] | type[PlacementDevice]] = {
    "modified-dh": ModifiedDHDevice,
    "dh": StandardDHDevice,
    "placement": PlacementDevice,
}


def world_schema() -> dict[str, Any]:
    """JSON Schema of a world file."""
    return WorldTable.model_json_schema(by_alias=True)


def device_schema() -> dict[str, Any]:
    """JSON Schema of a device file, for editors that complete and check TOML."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "haptid device",
        **TypeAdapter(AnyDevice).json_schema(by_alias=True),
    }
