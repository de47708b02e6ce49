"""Device: a mechanism as data, before any measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device.parameters import Combination, StandardParameters, Symmetry
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
    """A joint and its link, in normal form: the joint axis is z of its own frame.

    Pose of link i = pose of its parent * (rotation, translation) * Rz(q) or Tz(q).

    Attributes:
        name: of the joint and of its link.
        parent: index of the parent's joint, -1 for the base.
        prismatic: whether it is prismatic.
        rotation, translation: its placement in the parent's link frame at q = 0, (3, 3) and (3,), m.
        body: whether its link has inertia.
        position_limits: rad or m, None if unknown.
        velocity_limit: rad/s or m/s, None if unknown.
        torque_limit: N m or N, None if unknown.
        frame_rotation, frame_translation: the link frame of the file's convention in that of the normal form,
            (3, 3) and (3,), m; the identity for modified-dh.
        alias: its name in the robot description that the file was imported from; empty without one.
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
    alias: str = ""

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
    """A joint at which a loop is cut, so that a tree is left.

    Attributes:
        prismatic: False: the frames' origins and z axes coincide. True: z axes one line, orientations equal.
        frame_a, frame_b: the two frames that the joint brings together.
        name: of the joint where terms may act on it, else None.
    """

    prismatic: bool
    frame_a: Frame
    frame_b: Frame
    name: str | None = None


@dataclass(frozen=True, eq=False)
class Motor:
    """A motor and the joint-side coordinate that it drives.

    Attributes:
        name: of the motor, or of the joint without motor.
        gear_ratio: shaft position = gear_ratio * coordinate.
        torque_constant: shaft torque per unit of command, N m or N; torque on the coordinate = gear_ratio *
            torque_constant * command.
        command_unit: N m, N, V, A or counts.
        row: the coordinate as a combination of the active joints' positions, (active,).
        motorised: False for an active joint without motor.
    """

    name: str
    gear_ratio: float
    torque_constant: float
    command_unit: str
    row: Array
    motorised: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", read_only(self.row))


@dataclass(frozen=True)
class Prior:
    """Prior of a standard parameter: value and standard deviation (None: unknown), SI."""

    value: float
    std: float | None = None


@dataclass(frozen=True, eq=False)
class Device:
    """A mechanism, its transmission and its terms, as data; see `read_device`.

    Attributes:
        name, description, source: what it is, and where its geometry comes from.
        convention: how the file describes frames.
        gravity: in the base frame, (3,), m/s^2.
        joints: parents before children.
        active: indices of the independent (active) joints, in the file's order.
        closure: positions and rates of the other joints as functions of these.
        drives: as many joint-side coordinates as active joints: the motors, then active joints without motor.
        torque_rows: whether torque rows are the motors' or the joints'; they differ if motors are coupled.
        terms: regressor columns in addition to link inertia, in the core's order.
        parameters: the standard parameters.
        symmetry: parameters known to be zero or equal.
        lengths: named lengths, m.
        handle: frame at which the hand holds the device, None if unknown.
        prior: by raw parameter name.
        keep: parameters preferred as independent columns.
        base_tolerance: relative residual below which a column counts as a linear combination of others.
        notes: remarks on the file, as sentences.
        tables: the checked tables of the file, with expressions as written.
        targets: linear combinations of parameters to report.
        cut_joints: named cuts, on which terms may act.
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
        """The same mechanism with another gravity in its base frame.

        Targets keep their factors: g in them stays the magnitude in the device file.

        Args:
            gravity: in the base frame, (3,), m/s^2, pointing down.

        Raises:
            ShapeError: it is not three numbers.
        """
        return replace(self, gravity=np.asarray(gravity, dtype=float))

    @property
    def searched(self) -> tuple[tuple[int, Searched], ...]:
        """Constants of terms that are estimated, each with the index of its term."""
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
        """N: drives' coordinates are N qa, (active, active)."""
        return freeze(np.array([drive.row for drive in self.drives], dtype=float))

    @cached_property
    def row_map(self) -> Array:
        """B: coordinates of the torque rows are c = B qa, (active, active).

        The coupling N if rows are the motors', the identity if they are the joints'.
        """
        return self.coupling if self.torque_rows == "motor" else freeze(np.eye(len(self.active)))

    @cached_property
    def rates(self) -> Array:
        """G B^-1: Jacobian of all joints by the coordinates, (joints, active); zero where it varies with the pose."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.row_map.T, self.closure.constant.T).T))

    @cached_property
    def varying(self) -> np.ndarray:
        """Which entries of the Jacobian by the coordinates vary with the pose, (joints, active)."""
        moved = np.linalg.inv(self.row_map) != 0
        made = np.asarray((self.closure.varying.astype(int) @ moved) > 0)
        made.flags.writeable = False
        return made

    @cached_property
    def drive_rates(self) -> Array:
        """N B^-1: Jacobian of the drives by the coordinates, (active, active)."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.row_map.T, self.coupling.T).T))

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the torque rows: motors, or active joints."""
        if self.torque_rows == "motor":
            return tuple(drive.name for drive in self.drives)
        return tuple(self.joints[j].name for j in self.active)

    @cached_property
    def row_labels(self) -> tuple[str, ...]:
        """Labels of the torque rows: "motor 1", "joint 5"."""
        return tuple(f"{self.torque_rows} {name}" for name in self.row_names)

    @cached_property
    def measured(self) -> tuple[bool, ...]:
        """Whether the torque of each row is measured: all drives that act on it have a motor."""
        unmeasured = np.array([not drive.motorised for drive in self.drives])
        return tuple(bool(known) for known in ~(self.drive_rates[unmeasured] != 0).any(axis=0))

    @cached_property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of every coordinate, rad or m: that of its first joint."""
        first = [self.joints[self.active[int(np.argmax(row != 0))]] for row in self.row_map]
        return tuple("m" if joint.prismatic else "rad" for joint in first)

    @cached_property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of every torque row, at the joint side: N m or N."""
        return tuple("N" if unit == "m" else "N m" for unit in self.coordinate_units)

    @cached_property
    def chi_prior(self) -> Array:
        """Prior value of every free standard parameter, NaN if unknown, (p,), SI.

        For raw parameters that are equal by symmetry, the mean of those that are known.
        """
        known = [[self.prior[n].value for n in names if n in self.prior] for names in self.parameters.members]
        return freeze(np.array([np.mean(values) if values else np.nan for values in known], dtype=float))
