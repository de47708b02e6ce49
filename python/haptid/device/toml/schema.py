"""The tables of a device file as pydantic models: keys and types of values, before names are resolved."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    TypeAdapter,
)

from haptid.device.toml.keys import Arithmetic, Name, Numbers, PositiveNumber, Signed, Table, Text, Triple, Unit
from haptid.device.toml.terms import AnyTerm, CoordinateTable


class _Limits(Table):
    """Limits of a joint."""

    position: Annotated[list[Arithmetic], Field(min_length=2, max_length=2)] | None = None
    velocity: Arithmetic | None = None
    torque: Arithmetic | None = None


class JointTable(Table):
    """Keys of joints of every convention."""

    name: Name
    alias: Text | None = None
    parent: Name | None = None
    type: Literal["revolute", "prismatic"] = "revolute"
    body: bool = True
    active: bool | None = None
    torque: Literal["zero"] | None = None
    limits: _Limits = _Limits.model_construct()


class ModifiedDHJoint(JointTable):
    """Khalil-Kleinfinger: Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r)."""

    gamma: Arithmetic = 0.0
    b: Arithmetic = 0.0
    alpha: Arithmetic = 0.0
    d: Arithmetic = 0.0
    theta: Arithmetic = 0.0
    r: Arithmetic = 0.0


class StandardDHJoint(JointTable):
    """Standard Denavit-Hartenberg: Rz(theta) Tz(d) Tx(a) Rx(alpha)."""

    theta: Arithmetic = 0.0
    d: Arithmetic = 0.0
    a: Arithmetic = 0.0
    alpha: Arithmetic = 0.0


class PlacementJoint(JointTable):
    """A placement as in URDF, and the axis: of a universal or spherical joint, the direction across its first two."""

    type: Literal["revolute", "prismatic", "universal", "spherical"] = "revolute"  # type: ignore[assignment]
    xyz: Triple = [0.0, 0.0, 0.0]
    rpy: Triple = [0.0, 0.0, 0.0]
    axis: Triple = [0.0, 0.0, 1.0]


class FrameTable(Table):
    """A frame fixed to a link: modified Denavit-Hartenberg keys, or xyz and rpy."""

    gamma: Arithmetic | None = None
    b: Arithmetic | None = None
    alpha: Arithmetic | None = None
    d: Arithmetic | None = None
    theta: Arithmetic | None = None
    r: Arithmetic | None = None
    xyz: Triple | None = None
    rpy: Triple | None = None


class CutTable(Table):
    """The joint at which a loop is cut; terms may act on it if it has a name."""

    name: Name | None = None
    type: Literal["revolute", "prismatic", "spherical"] = "revolute"
    body_a: Name
    frame_a: FrameTable = FrameTable.model_construct()
    body_b: Name
    frame_b: FrameTable = FrameTable.model_construct()


class LoopTable(Table):
    """A loop: passive joints by relations, by a cut joint, or both."""

    relations: list[Text] = []
    passive: list[Name] = []
    cut: CutTable | None = None
    guess: dict[Name, Arithmetic] = {}
    at: dict[Name, Arithmetic] = {}


class TransmissionTable(Table):
    """Whether torque rows are of motors or of joints, and how redundant motors share a torque."""

    torque_rows: Literal["motor", "joint"] | None = None
    weights: dict[Name, Arithmetic] | None = None
    preload: dict[Name, Arithmetic] = {}


class MotorTable(Table):
    """A motor and its transmission."""

    name: Name
    drives: dict[Name, Arithmetic] | None = None
    gear_ratio: Arithmetic = 1.0
    torque_constant: Arithmetic = 1.0
    command_unit: Literal["N m", "N", "V", "A", "counts"] = "N m"
    peak_torque: PositiveNumber | None = None
    continuous_torque: PositiveNumber | None = None
    torque_step: PositiveNumber | None = None
    encoder_counts: PositiveNumber | None = None
    rotor_inertia: PositiveNumber | None = None


class CounterweightTable(Table):
    """Where a counterweight may be put: the most mass, and two corners of a box in the link frame of the file."""

    link: Name
    most: PositiveNumber
    low: Numbers
    high: Numbers


class PublishedTable(Table):
    """A figure of the device that its maker or a paper states, for its data sheet; nothing is computed from it."""

    name: Text
    value: float | Text
    unit: Unit | None = None
    source: Text


class AboutTable(Table):
    """A body symmetric about an axis of its link frame."""

    link: Name
    axis: Literal["x", "y", "z"]


class MirrorTable(Table):
    """A body that is the image of another one: its coordinates x, y, z in its link frame by those of the other."""

    link: Name
    of: Name
    axes: Annotated[list[Literal["x", "y", "z", "-x", "-y", "-z"]], Field(min_length=3, max_length=3)]


class SymmetryTable(Table):
    """Parameters known to be zero or equal, and why."""

    reason: Text
    zero: list[Name] = []
    equal: list[Annotated[list[Signed], Field(min_length=2)]] = []
    about: AboutTable | None = None
    identical: list[Name] = []
    mirror: MirrorTable | None = None


class BaseTable(Table):
    """Placement of the first frame in the frame that gravity is given in."""

    xyz: Triple = [0.0, 0.0, 0.0]
    rpy: Triple = [0.0, 0.0, 0.0]


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
    radius: Arithmetic


class RoundTable(_ShapeTable):
    """A capsule or cylinder about z; the length of a capsule is that of its straight part."""

    kind: Literal["capsule", "cylinder"]
    radius: Arithmetic
    length: Arithmetic


class BoxTable(_ShapeTable):
    """A box about the origin of its frame, with its edges."""

    kind: Literal["box"]
    size: Triple


class HullTable(_ShapeTable):
    """The convex hull of points, such as of a mesh."""

    kind: Literal["hull"]
    points: Annotated[list[Triple], Field(min_length=4, max_length=1000)]


AnyShape = Annotated[SphereTable | RoundTable | BoxTable | HullTable, Field(discriminator="kind")]


class WorldTable(Table):
    """A world file: what stands about the device, in its base frame."""

    version: Literal[1] = Field(default=1, alias="schema")
    name: str = ""
    lengths: dict[Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], Arithmetic] = {}
    collision: Annotated[list[AnyShape], Field(min_length=1, max_length=500)]


class GimbalTable(Table):
    """An unmeasured passive gimbal at the handle, its axes through the handle's origin."""

    state: Literal["locked", "hanging", "free"]
    mass: Arithmetic = Field(description="kg")
    com_radius: Arithmetic = Field(description="distance of its centre of mass from the axes, m")
    inertia: Arithmetic | None = Field(
        None, description="least moment of inertia about the handle's origin, kg m^2; default: mass * com_radius^2"
    )
    friction: Arithmetic = Field(0.0, description="largest friction torque of all its axes together, N m")
    swing: Arithmetic | None = Field(None, description="hanging: largest angle from hanging, rad; default 0.5")
    rate: Arithmetic | None = Field(None, description="free: largest angular velocity, rad/s")


class PriorTable(Table):
    """Prior value with its standard deviation."""

    value: Arithmetic
    std: Arithmetic | None = None


class PriorBodyTable(Table):
    """Prior body, as from CAD: inertia XX YY ZZ XY XZ YZ about its centre of mass."""

    link: Name
    mass: Arithmetic
    com: Triple
    inertia: Annotated[list[Arithmetic], Field(min_length=6, max_length=6)] | None = None
    std_percent: Arithmetic | None = None


class PriorsTable(Table):
    """Priors of parameters by name, and `bodies`."""

    model_config = ConfigDict(extra="allow", defer_build=True)
    __pydantic_extra__: dict[str, Annotated[PriorTable | Arithmetic, Field(union_mode="left_to_right")]]

    bodies: list[PriorBodyTable] = []

    @property
    def parameters(self) -> dict[str, PriorTable | float | str]:
        """By name of the parameter."""
        return self.__pydantic_extra__


class TargetTable(Table):
    """A target: linear combination of standard parameters, with its unit."""

    expression: Text
    unit: Unit | None = None


class BaseParametersTable(Table):
    """Choice of base parameters."""

    keep: list[Name] = []
    tolerance: Arithmetic = 1e-9


class DeviceTable(Table):
    """Keys of device files of every convention."""

    version: Literal[1] = Field(default=1, alias="schema")
    name: Text
    description: str = ""
    serial: str = ""
    source: str = ""
    gravity: Triple
    base: BaseTable = BaseTable.model_construct()
    lengths: dict[Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")], Arithmetic] = {}
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
