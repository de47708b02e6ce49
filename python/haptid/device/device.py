"""The device as a value: what is known of a mechanism before any data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device.parameters import StandardParameters, Symmetry
from haptid.device.terms.term import Searched, TermColumn

if TYPE_CHECKING:
    from haptid.device.loops.cut_joint import CutJoint
    from haptid.device.loops.linear import Closure
    from haptid.device.loops.newton import NewtonClosure
    from haptid.device.toml.schema import AnyDevice

Convention = Literal["modified-dh", "dh", "placement"]
TorqueRows = Literal["motor", "joint"]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and the link it moves, in normal form: it turns about, or slides along, its own z axis.

    Pose of link i = pose of its parent * (rotation, translation) * Rz(q) or Tz(q).

    Attributes:
        name: of the joint and of its link.
        parent: index of the parent's joint, -1 for the base.
        prismatic: whether it slides.
        rotation, translation: its placement in the parent's link frame where q = 0, (3, 3) and (3,), m.
        body: whether its link has inertia.
        position_limits: rad or m, None if unknown.
        velocity_limit: rad/s or m/s, None if unknown.
        torque_limit: N m or N, None if unknown.
        frame_rotation, frame_translation: the link frame of the file's own convention, seen in that of the
            normal form, (3, 3) and (3,), m; the identity for modified-dh.
    """

    name: str
    parent: int
    prismatic: bool
    rotation: Array
    translation: Array
    body: bool
    position_limits: tuple[float, float] | None
    velocity_limit: float | None
    torque_limit: float | None
    frame_rotation: Array
    frame_translation: Array

    def __post_init__(self) -> None:
        for name, shape in (("rotation", (3, 3)), ("frame_rotation", (3, 3))):
            expect(name, getattr(self, name).shape, shape)
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("translation", "frame_translation"):
            expect(name, getattr(self, name).shape, (3,))
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame fixed to a link.

    Attributes:
        link: index of its joint, -1 for the base.
        rotation, translation: in the link frame, (3, 3) and (3,), m.
    """

    link: int
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        expect("rotation", self.rotation.shape, (3, 3))
        expect("translation", self.translation.shape, (3,))
        for name in ("rotation", "translation"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


class Handle(Frame):
    """The frame at which the hand holds the device."""


@dataclass(frozen=True)
class Cut:
    """A joint of a loop that was cut to leave a tree.

    Attributes:
        prismatic: False: the frames' origins and z axes coincide. True: z axes one line, orientations equal.
        frame, twin: the two frames that the joint brings together.
        name: of the joint where terms may act on it, else None.
    """

    prismatic: bool
    frame: Frame
    twin: Frame
    name: str | None = None


@dataclass(frozen=True, eq=False)
class Motor:
    """A motor and the joint-side coordinate it drives.

    Attributes:
        name: of the motor; of the joint where there is none.
        gear: shaft position = gear * coordinate.
        gain: shaft torque per unit of command, N m or N; torque on the coordinate = gear * gain * command.
        unit: of the command: N m, N, V, A or counts.
        row: the coordinate as a combination of the active joints' positions, (active,).
        motorised: False for an active joint without motor.
    """

    name: str
    gear: float
    gain: float
    unit: str
    row: Array
    motorised: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", read_only(self.row))


@dataclass(frozen=True)
class Prior:
    """What is known of a standard parameter beforehand: value and deviation (None: unknown), SI."""

    value: float
    std: float | None = None


@dataclass(frozen=True, eq=False)
class Combination:
    """A linear combination of standard parameters that a user wants to know: a target of the device file.

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
        object.__setattr__(self, "row", read_only(self.row))


@dataclass(frozen=True, eq=False)
class Device:
    """A mechanism, its transmission and its terms; see `read_device`.

    Attributes:
        name, description, source: what it is, and where its geometry comes from.
        convention: how the file describes frames.
        gravity: in the base frame, (3,), m/s^2.
        joints: parents before children.
        active: indices of the independent joints, in the file's order.
        closure: how the other joints follow them.
        drives: one joint-side coordinate for each active joint: the motors, then active joints without motor.
        torque_rows: whether rows of torque are the motors' or the joints'; they differ where motors are coupled.
        terms: columns beside link inertia, in the core's order.
        parameters: the standard parameters.
        symmetry: what is known of them beforehand.
        lengths: named lengths, m.
        handle: where the hand holds the device, None if unknown.
        prior: by raw parameter name.
        keep: parameters preferred as base parameters.
        base_tolerance: relative length below which a column counts as a combination of others.
        notes: sentences worth showing.
        tables: the checked file itself, where lengths stand as they were written.
        targets: combinations of parameters that a user wants to know.
        cut_joints: cuts that have a name, on which terms may act.
    """

    name: str
    description: str
    source: str
    convention: Convention
    gravity: Array
    joints: tuple[Joint, ...]
    active: tuple[int, ...]
    closure: Closure | NewtonClosure
    drives: tuple[Motor, ...]
    torque_rows: TorqueRows
    terms: tuple[TermColumn, ...]
    parameters: StandardParameters
    symmetry: tuple[Symmetry, ...]
    lengths: Mapping[str, float]
    handle: Handle | None
    prior: Mapping[str, Prior]
    keep: tuple[str, ...]
    base_tolerance: float
    notes: tuple[str, ...]
    tables: AnyDevice = field(repr=False)
    targets: tuple[Combination, ...] = ()
    cut_joints: tuple[CutJoint, ...] = ()

    def __post_init__(self) -> None:
        expect("gravity", self.gravity.shape, (3,))
        expect("closure.constant", self.closure.constant.shape, (len(self.joints), len(self.active)))
        expect("drives", (len(self.drives),), (len(self.active),))
        object.__setattr__(self, "gravity", read_only(self.gravity))

    def with_gravity(self, gravity: ArrayLike) -> Device:
        """The same mechanism, mounted so that gravity has another direction or size in its base frame.

        Targets keep their factors: g in them stays the size of gravity that the device file has.

        Args:
            gravity: in the base frame, (3,), m/s^2, the direction in which things fall.

        Raises:
            ShapeError: it is not three numbers.
        """
        return replace(self, gravity=np.asarray(gravity, dtype=float))

    @property
    def searched(self) -> tuple[tuple[int, Searched], ...]:
        """Constants of terms that are not known, each with the index of its term."""
        return tuple((k, constant) for k, term in enumerate(self.terms) for constant in term.searched)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The drives that have a motor."""
        return tuple(drive for drive in self.drives if drive.motorised)

    @cached_property
    def coupling(self) -> Array:
        """N in N qa, drives' coordinates from active joints' positions, (active, active)."""
        return freeze(np.array([drive.row for drive in self.drives], dtype=float))

    @cached_property
    def row_map(self) -> Array:
        """B in c = B qa: the coordinates that torque rows belong to, from active joints' positions, (active, active).

        The coupling N where rows are the motors', the identity where they are the joints'.
        """
        return self.coupling if self.torque_rows == "motor" else freeze(np.eye(len(self.active)))

    @cached_property
    def rates(self) -> Array:
        """G B^-1: all joints' rates from the coordinates' rates, (joints, active); zero where they vary."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.row_map.T, self.closure.constant.T).T))

    @cached_property
    def varying(self) -> np.ndarray:
        """Which rates from the coordinates' vary with the pose, (joints, active)."""
        moved = np.linalg.inv(self.row_map) != 0
        made = np.asarray((self.closure.varying.astype(int) @ moved) > 0)
        made.flags.writeable = False
        return made

    @cached_property
    def drive_rates(self) -> Array:
        """N B^-1: all drives' rates from the coordinates' rates, (active, active)."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.row_map.T, self.coupling.T).T))

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the torque rows: motors, or active joints."""
        if self.torque_rows == "motor":
            return tuple(drive.name for drive in self.drives)
        return tuple(self.joints[j].name for j in self.active)

    @cached_property
    def row_labels(self) -> tuple[str, ...]:
        """What to write beside a torque row: "motor 1", "joint 5"."""
        return tuple(f"{self.torque_rows} {name}" for name in self.row_names)

    @cached_property
    def measured(self) -> tuple[bool, ...]:
        """Whether the torque of each row is known: a motor's own; a joint's if all drives that load it have a motor."""
        blind = np.array([not drive.motorised for drive in self.drives])
        return tuple(bool(known) for known in ~(self.drive_rates[blind] != 0).any(axis=0))

    @cached_property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of every coordinate: rad or m, after the first joint in it."""
        first = [self.joints[self.active[int(np.argmax(row != 0))]] for row in self.row_map]
        return tuple("m" if joint.prismatic else "rad" for joint in first)

    @cached_property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of every torque row, at the joint side: N m or N."""
        return tuple("N" if unit == "m" else "N m" for unit in self.coordinate_units)

    @cached_property
    def chi_prior(self) -> Array:
        """Prior value of every free standard parameter, NaN where unknown, (p,), SI.

        Where several raw parameters are one by symmetry, the mean of those that are known.
        """
        known = [[self.prior[n].value for n in names if n in self.prior] for names in self.parameters.members]
        return freeze(np.array([np.mean(values) if values else np.nan for values in known], dtype=float))
