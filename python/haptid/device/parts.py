"""Parts of a device: joints, frames, cuts, motors, and the law that distributes torque over redundant drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.errors import SingularityError

if TYPE_CHECKING:
    pass

CutKind = Literal["revolute", "prismatic", "spherical"]


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
        freeze_fields(self, rotation=(3, 3), translation=(3,), frame_rotation=(3, 3), frame_translation=(3,))


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
        freeze_fields(self, rotation=(3, 3), translation=(3,))


class Handle(Frame):
    """The frame at which the hand holds the device."""


@dataclass(frozen=True)
class Gimbal:
    """An unmeasured passive gimbal, its axes through the handle's origin.

    Attributes:
        state: "locked" to the link, "hanging" from the handle, or "free".
        mass, com_radius, inertia: kg; distance of the centre of mass from the axes, m; least moment of inertia about
            the handle's origin, kg m^2.
        friction: largest friction torque of all its axes together, N m.
        swing: largest angle from hanging, rad.
        rate: largest angular velocity of a free one, rad/s.
    """

    state: Literal["locked", "hanging", "free"]
    mass: float
    com_radius: float
    inertia: float
    friction: float
    swing: float
    rate: float


@dataclass(frozen=True)
class Cut:
    """A joint at which a loop is cut, so that a tree is left.

    Attributes:
        kind: "revolute": the frames' origins and z axes coincide; "prismatic": z axes one line, orientations equal;
            "spherical": the origins coincide.
        frame_a, frame_b: the two frames that the joint brings together.
        name: of the joint where terms may act on it, else None.
    """

    kind: CutKind
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
        row: the coordinate as a combination of all joints' positions, (joints,).
        motorised: False for an active joint without motor.
        free: whether it is a joint without motor of which the file says that its torque is zero: nothing drives it, and
            no hand holds it.
        load_side: of an elastic motor, the coordinate on the other side of its spring as a combination of all joints'
            positions, (joints,); `row` is its rotor. None for a rigid motor.
        unloaded: whether it is a joint without motor that springs alone move, so that its torque is known to be zero.
        sensed: of an elastic motor whose spring's torque is measured, the joint that stands for its torsion, as a
            combination of all joints' positions, (joints,).
        sensor: whether it is no motor but such a torque sensor; its coordinate is zero whatever the device does.
    """

    name: str
    gear_ratio: float
    torque_constant: float
    command_unit: str
    row: Array
    motorised: bool = True
    load_side: Array | None = None
    unloaded: bool = False
    sensed: Array | None = None
    sensor: bool = False
    free: bool = False

    def __post_init__(self) -> None:
        freeze_fields(self, "row", *(name for name in ("load_side", "sensed") if getattr(self, name) is not None))

    @property
    def torsion(self) -> Array:
        """Rotor less load side of an elastic motor, as a combination of all joints' positions, (joints,)."""
        if self.sensed is not None:
            return self.sensed
        return np.asarray(self.row if self.load_side is None else self.row - self.load_side)

    @property
    def first(self) -> int:
        """Index of the first joint that it drives; its unit is the coordinate's."""
        return int(np.argmax(self.row != 0))


@dataclass(frozen=True, eq=False)
class DistributionLaw:
    """How redundant motors share a torque: least sum of weighted squares, plus what is in balance of a preload.

    Attributes:
        weights: of the squared torque of every drive's coordinate, (drives,), 1/(N m)^2 or 1/N^2.
        preload: torques of the drives' coordinates whose part in balance is added, (drives,), N m or N.
    """

    weights: Array
    preload: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "weights", preload=self.weights.shape)

    @staticmethod
    def even(drives: int) -> DistributionLaw:
        """The minimal norm."""
        return DistributionLaw(np.ones(drives), np.zeros(drives))

    def of(self, drives: np.ndarray) -> DistributionLaw:
        """The law of some drives, by index."""
        return DistributionLaw(self.weights[drives], self.preload[drives])

    def shares(self, rates: Array) -> Array:
        """D of Gamma = D tau, so that B' D = 1 with the least sum of weighted squares, (..., drives, rows).

        The inverse of B' where there are as many drives as rows; where there are more rows, as with elastic motors, the
        least-squares solution of tau = B' Gamma.

        Args:
            rates: B, the Jacobian of the drives by the rows' coordinates, (..., drives, rows).

        Raises:
            SingularityError: there are more drives than rows, and at a pose they cannot move every coordinate.
        """
        if rates.shape[-1] == rates.shape[-2]:
            return np.asarray(np.swapaxes(np.linalg.inv(rates), -1, -2))
        if rates.shape[-1] > rates.shape[-2]:  # several rows contain the torque of one elastic motor
            return np.asarray(np.linalg.pinv(np.swapaxes(rates, -1, -2)))
        root = np.sqrt(self.weights)[:, None]
        Q, R = np.linalg.qr(rates / root)
        if not np.diagonal(R, axis1=-2, axis2=-1).all():
            raise SingularityError(
                "at a pose of the motion the motors cannot move every coordinate, so that no torques of theirs balance "
                "those of the coordinates.",
                advice="Keep the motion away from the pose at which the motors' levers vanish.",
            )
        return np.asarray(Q @ np.swapaxes(np.linalg.inv(R), -1, -2) / root)

    def balanced(self, rates: Array, torque: Array) -> Array:
        """The part of drives' torques that moves nothing, (..., drives): the rest is what the law gives.

        Args:
            rates: as for `shares`.
            torque: of the drives, (..., drives), N m or N.
        """
        moving = np.einsum("...dr,...d->...r", rates, torque)
        return np.asarray(torque - np.einsum("...dr,...r->...d", self.shares(rates), moving))


@dataclass(frozen=True)
class Prior:
    """Prior of a standard parameter: value and standard deviation (None: unknown), SI."""

    value: float
    std: float | None = None
