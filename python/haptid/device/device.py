"""Device: a mechanism as data, before any measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, freeze_fields
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.device.parameters import Combination, StandardParameters, Symmetry
from haptid.device.parts import DistributionLaw, Gimbal, Handle, Joint, Motor, Prior
from haptid.device.terms.term import Searched, TermColumn
from haptid.errors import IncompleteDeviceError

if TYPE_CHECKING:
    from haptid.device.collision import CollisionShape
    from haptid.device.loops.cut_joint import CutJoint
    from haptid.device.loops.formula import AnyClosure
    from haptid.device.toml.schema import AnyDevice

Convention = Literal["modified-dh", "dh", "placement"]
TorqueRows = Literal["motor", "joint"]


@displayed
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
        drives: joint-side coordinates: the motors, then active joints without motor; at least as many as active joints.
        torque_rows: whether torque rows are the motors' or the joints'; they differ if motors are coupled. The joints'
            where motors are redundant or drive passive joints.
        terms: regressor columns in addition to link inertia, in the core's order.
        parameters: the standard parameters.
        symmetry: parameters known to be zero or equal.
        lengths: named lengths, m.
        handle: frame at which the hand holds the device, None if unknown.
        prior: by raw parameter name.
        gimbal: unmeasured and passive, at the handle; None where there is none.
        keep: parameters preferred as independent columns.
        base_tolerance: relative residual below which a column counts as a linear combination of others.
        notes: remarks on the file, as sentences.
        tables: the checked tables of the file, with expressions as written.
        targets: linear combinations of parameters to report.
        cut_joints: named cuts, on which terms may act.
        collision: shapes of its links and base, for collision checks.
        distribution: how redundant motors share a torque; None where the file says nothing and their units differ.
    """

    name: str
    description: str
    source: str
    convention: Convention
    gravity: Array
    joints: tuple[Joint, ...]
    active: tuple[int, ...]
    closure: AnyClosure
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
    collision: tuple[CollisionShape, ...] = ()
    gimbal: Gimbal | None = None
    distribution: DistributionLaw | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, gravity=(3,))
        expect("closure.constant", self.closure.constant.shape, (len(self.joints), len(self.active)))
        for drive in self.drives:
            expect(f"drive {drive.name}", drive.row.shape, (len(self.joints),))

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
        """The drives whose torque is measured: those that have a motor, then torque sensors."""
        return tuple(drive for drive in self.drives if drive.motorised)

    @cached_property
    def driven(self) -> np.ndarray:
        """Indices of the drives that have a motor, (motors,)."""
        return np.flatnonzero([drive.motorised for drive in self.drives])

    @cached_property
    def drive_rows(self) -> Array:
        """Drives' coordinates as combinations of all joints' positions, (drives, joints)."""
        return freeze(np.array([drive.row for drive in self.drives], dtype=float))

    @property
    def redundant(self) -> bool:
        """Whether there are more drives than active joints, so that motion does not determine the motors' torques."""
        return len(self.drives) > len(self.active)

    @cached_property
    def coupling(self) -> Array:
        """N: Jacobian of the drives by the active joints, (drives, active); zero where it varies with the pose."""
        passive = [j for j in range(len(self.joints)) if j not in self.active]
        return freeze(self.drive_rows[:, self.active] + self.drive_rows[:, passive] @ self.closure.constant[passive])

    @cached_property
    def active_from_drives(self) -> Array:
        """Active joints' positions from the drives', (active, drives): least squares, without those on passive joints.

        Raises:
            IncompleteDeviceError: the drives on active joints do not determine these.
        """
        own = ~np.delete(self.drive_rows, self.active, axis=1).any(axis=1)
        N, made = self.coupling[own], np.zeros((len(self.active), len(self.drives)))
        rank = int(np.linalg.matrix_rank(N)) if len(N) else 0
        if rank < len(self.active):
            raise IncompleteDeviceError(
                f"the positions of {self.name}'s motors on active joints determine {rank} of its {len(self.active)} "
                "active joints.",
                where="motors",
                found=rank,
                limit=len(self.active),
                advice="Choose the active joints among those that motors drive (the others go to a loop's passive "
                'list), or record the positions of the active joints (side = "joint").',
            )
        made[:, own] = np.linalg.inv(N) if len(N) == rank else np.linalg.pinv(N)
        return freeze(made)

    @cached_property
    def row_map(self) -> Array:
        """B: coordinates of the torque rows are c = B qa, (active, active); see `haptid.device.elastic.row_map`."""
        from haptid.device.elastic import row_map

        return freeze(row_map(self.drives, self.active, self.closure, self.torque_rows == "joint"))

    @cached_property
    def elastic(self) -> tuple[Motor, ...]:
        """The motors behind a spring."""
        return tuple(drive for drive in self.drives if drive.load_side is not None)

    @cached_property
    def sensors(self) -> tuple[Motor, ...]:
        """The joint torque sensors: drives whose torque is measured, and not exerted."""
        return tuple(drive for drive in self.drives if drive.sensor)

    @cached_property
    def unknown_torque(self) -> np.ndarray:
        """Whether the torque of each drive is not measured and not known to be zero, (drives,)."""
        return np.array([not drive.motorised and not drive.unloaded for drive in self.drives])

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
        """N B^-1: Jacobian of the drives by the coordinates, (drives, active); zero where it varies with the pose."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.row_map.T, self.coupling.T).T))

    @cached_property
    def drive_varies(self) -> np.ndarray:
        """Which entries of the Jacobian of the drives vary with the pose, (drives, active)."""
        made = np.asarray((np.abs(self.drive_rows) @ self.varying) > 0)
        made.flags.writeable = False
        return made

    def drive_jacobian(self, c: Array) -> Array:
        """Jacobian of the drives by the coordinates, (drives, active), or (samples, drives, active) where it varies.

        Args:
            c: positions of the torque rows' coordinates, (active, samples), rad or m.

        Raises:
            LoopClosureError, SingularityError: a loop does not close at a pose, or is singular there.
        """
        if not self.drive_varies.any():
            return self.drive_rates
        followed = self.closure.follow(np.asarray(np.linalg.solve(self.row_map, c))).by(self.row_map)
        return np.asarray(np.einsum("dj,sja->sda", self.drive_rows, followed.G))

    def row_torque(self, c: Array, torque: Array) -> Array:
        """Torques of the rows, B' Gamma, (active, samples), N m or N.

        Args:
            c: positions of the torque rows' coordinates, (active, samples), rad or m.
            torque: of the motors' coordinates, (motors, samples), N m or N.
        """
        B = self.drive_jacobian(c)[..., self.driven, :]
        return np.asarray(np.einsum("sda,ds->as", B, torque) if B.ndim == 3 else B.T @ torque)

    def drive_torque(self, c: Array, torque: Array) -> Array:
        """Torques of the motors' coordinates by the distribution law, (motors, samples), N m or N.

        Args:
            c: positions of the torque rows' coordinates, (active, samples), rad or m.
            torque: of the rows, (active, samples), N m or N.

        Raises:
            IncompleteDeviceError: the motors are redundant and the file has no law.
        """
        law, B = self.law, self.drive_jacobian(c)
        made = np.einsum("...dr,r...->d...", law.shares(B), torque) if B.ndim == 3 else law.shares(B) @ torque
        if law.preload.any():
            made = made + np.broadcast_to(law.balanced(B, law.preload), (torque.shape[1], len(law.preload))).T
        return np.asarray(made[self.driven])

    @property
    def law(self) -> DistributionLaw:
        """The distribution law.

        Raises:
            IncompleteDeviceError: the motors are redundant and the file has no law.
        """
        if self.distribution is None:
            units = ", ".join(f"{d.name} ({'N' if self.joints[d.first].prismatic else 'N m'})" for d in self.motors)
            raise IncompleteDeviceError(
                f"{self.name} has {len(self.drives)} drives for {len(self.active)} active joints, and no law says how "
                f"motors in N and in N m share a torque: {units}.",
                where="transmission.weights",
                found=len(self.drives),
                limit=len(self.active),
                advice="Add [transmission] weights = { ... } to the device file, one positive number for each motor.",
            )
        return self.distribution

    @cached_property
    def drive_units(self) -> tuple[str, ...]:
        """Unit of the torque of every drive, N m or N."""
        return tuple("N" if self.joints[drive.first].prismatic else "N m" for drive in self.drives)

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the torque rows: motors, or active joints."""
        if self.torque_rows == "motor":
            return tuple(drive.name for drive in self.drives)
        return tuple(self.joints[j].name for j in self.active)

    @cached_property
    def row_labels(self) -> tuple[str, ...]:
        """Labels of the torque rows: "motor 1", "joint 5"; "link 1" of a joint that springs alone move."""
        if self.torque_rows == "joint":
            return tuple(f"joint {name}" for name in self.row_names)
        return tuple(
            drive.name.replace("_", " ", 1) if drive.unloaded else f"{'joint' if drive.free else 'motor'} {drive.name}"
            for drive in self.drives
        )

    @cached_property
    def measured(self) -> tuple[bool, ...]:
        """Whether the torque of each row is measured: all drives that act on it have a motor."""
        acts = (self.drive_rates != 0) | self.drive_varies
        acts[~self.unknown_torque] = False
        return tuple(bool(known) for known in ~acts.any(axis=0))

    @cached_property
    def free_rows(self) -> tuple[bool, ...]:
        """Whether the torque of each row is zero: only joints act on it that nothing drives, by the file's word."""
        acts = (self.drive_rates != 0) | self.drive_varies
        free = np.array([drive.free for drive in self.drives])
        return tuple(bool(own) for own in acts[free].any(axis=0) & ~acts[~free].any(axis=0))

    @cached_property
    def known(self) -> tuple[bool, ...]:
        """Whether the torque of each row is known: measured, or zero."""
        return tuple(a or b for a, b in zip(self.measured, self.free_rows, strict=True))

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
        prior, sign = self.prior, self.parameters.sign
        known = [[sign[n] * prior[n].value for n in names if n in prior] for names in self.parameters.members]
        return freeze(np.array([np.mean(values) if values else np.nan for values in known], dtype=float))

    def _shown(self) -> Overview:
        rows = [
            [
                joint.name,
                "slides" if joint.prismatic else "turns",
                "active" if k in self.active else "passive",
                "" if joint.position_limits is None else " .. ".join(f"{end:.4g}" for end in joint.position_limits),
                "m" if joint.prismatic else "rad",
            ]
            for k, joint in enumerate(self.joints)
        ]
        count = f"{len(self.joints)} joints, {len(self.motors)} motors, {len(self.parameters.names)} parameters"
        return Overview(f"Device {self.name}: {count}", ("joint", "", "", "limits", "unit"), rows)
