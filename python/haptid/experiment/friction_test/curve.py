"""Friction curves (friction torque against velocity) from motion at constant velocities in both directions.

Pose-dependent torque (gravity, springs, offsets) is removed by passing the same positions in both directions, or with a
model. The friction of a torque row is that of all joints moving with its coordinate, passive ones included.

Source: Janot et al. (2007), section 4, "constant-velocity runs".
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array, freeze_fields, positive
from haptid._internal.late import dataclass
from haptid._internal.signals import running_maximum, running_mean
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.errors import NoRowsError, index_of, setting_error
from haptid.estimation import Estimate
from haptid.motion.channels import coordinate_torque, coordinates
from haptid.motion.motion import Motion
from haptid.uncertainty.quantities import half_width

# Position bins of a joint; torque is averaged within each.
_BINS = 24
# Share of a bin that a pass must cover to count in it, and least number of bins of a pass.
COVERED = 0.7
_LEAST_BINS = 4
# Two poses of the other joints are equal within this tolerance, rad or m.
SAME_POSE = 0.02


@dataclass(frozen=True)
class ConstantVelocity:
    """Criteria of motion at a constant velocity.

    Attributes:
        tolerance: relative variation of the velocity that is allowed.
        shortest: minimum duration, s, and width of the moving average of the velocity.
        slowest: minimum speed, rad/s or m/s.
        still: maximum speed of the other joints, relative to that of the joint.
    """

    tolerance: float = 0.05
    shortest: float = 0.1
    slowest: float = 0.01
    still: float = 0.05

    def __post_init__(self) -> None:
        for name in ("tolerance", "shortest", "slowest", "still"):
            if not positive(getattr(self, name)):
                raise setting_error(name, getattr(self, name), "a finite number above zero", "ConstantVelocity")


@dataclass(frozen=True, eq=False)
class JointFriction:
    """Friction torque of a joint against velocity, one point for each pass at a constant velocity.

    Attributes:
        name, label: of the torque row, "1" and "motor 1".
        unit: of its torque, N m or N.
        velocity: ascending, (n,), rad/s or m/s.
        torque: mean over the positions, (n,).
        se: its standard error, by the jackknife over position bins, (n,).
        dof: degrees of freedom, the number of position bins less one, (n,).
    """

    name: str
    label: str
    unit: str
    velocity: Array
    torque: Array
    se: Array
    dof: Array

    def __post_init__(self) -> None:
        each = np.shape(self.velocity)
        freeze_fields(self, velocity=each, torque=each, se=each, dof=each)

    def conf_int(self, level: float = 0.95) -> Array:
        """Confidence intervals of the torque, (n, 2)."""
        half = half_width(self.se, self.dof, level)
        return np.column_stack([self.torque - half, self.torque + half])


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction curves of the tested joints.

    Attributes:
        joints: curves by torque row.
        notes: warnings, as sentences.
    """

    model: DynamicModel
    joints: tuple[JointFriction, ...]
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> JointFriction:
        return self.joints[index_of(name, [joint.name for joint in self.joints], "joint")]

    def summary(self) -> str:
        """A text table: velocity, torque, its 95 % interval."""
        lines = []
        for joint in self.joints:
            lines.append(f"{joint.label}: velocity, friction torque in {joint.unit}, 95 % interval")
            for v, tau, (low, high) in zip(joint.velocity, joint.torque, joint.conf_int(), strict=True):
                lines.append(f"  {v:9.4f} {tau:10.5f}   {low:.5f} .. {high:.5f}")
        return "\n".join([*lines, *self.notes])


def friction_curve(
    model: DynamicModel, motion: Motion, estimate: Estimate | None = None, constant: ConstantVelocity | None = None
) -> FrictionCurve:
    """Friction torque against velocity of every joint that moves at constant velocities.

    Without an estimate, torque other than friction is removed by the difference between both directions at the same
    positions, the other joints at rest. A torque equal in both directions is then not distinguishable from gravity, nor
    direction-dependent Coulomb friction from an offset.

    Args:
        motion: each joint in turn, in both directions, at several constant speeds; with a model, any motion with parts
            at constant velocity.
        estimate: of the device, from another motion: its torque without friction is subtracted, and all joints may
            move.
        constant: criteria of a constant velocity.

    Raises:
        LogMismatchError: the motion has more or fewer channels than the device has coordinates or motors.
        MissingAccelerationError: the motion's treatment has none.
        NoRowsError: no joint moves in both directions at a constant velocity.
    """
    constant, alone = constant or ConstantVelocity(), estimate is None
    c, cd, cdd = coordinates(model.device, motion, *motion.unbroken("the friction test").usable)
    tau = coordinate_torque(model.device, motion, *motion.usable)
    if estimate is not None:
        tau = tau - _without_friction(model, estimate, c, cd, cdd)
    width = max(3, round(constant.shortest / motion.dt))
    smooth = np.array([running_mean(own, width) for own in cd])
    curves, idle = [], []
    for k in [int(k) for k in np.flatnonzero(model.device.measured)]:
        passes = list(_passes(constant, alone, width, k, cd, smooth))
        cells = [cell for poses in _by_pose(k, c, passes, alone) for cell in _cells(poses, c[k], tau[k], cdd[k])]
        found = _points(_usable(cells), alone)
        if found is None:
            idle.append(model.device.row_labels[k])
            continue
        curves.append(
            JointFriction(model.device.row_names[k], model.device.row_labels[k], model.device.torque_units[k], *found)
        )
    if not curves:
        raise NoRowsError(
            "no joint moves alone and in both directions at a velocity that is constant within "
            f"{100 * constant.tolerance:g} % for {constant.shortest:g} s and above {constant.slowest:g} rad/s or m/s.",
            found=0,
            limit=constant.tolerance,
            advice="Record each joint in turn at several constant velocities, or raise `tolerance`.",
        )
    notes = (f"No constant velocity in both directions: {', '.join(idle)}.",) if idle else ()
    return FrictionCurve(model, tuple(curves), notes)


@dataclass(frozen=True, eq=False)
class _Pass:
    """An interval at a constant velocity: samples start..stop, and the mean velocity there."""

    start: int
    stop: int
    velocity: float


@dataclass(frozen=True)
class _Cell:
    """Mean torque of a pass in one position bin.

    Attributes:
        pose: index of the pose of the other joints.
        bin: index of the position bin.
        number: of the pass, over all poses.
        velocity: of the pass.
        torque, acceleration: mean, N m or N, and rad/s^2 or m/s^2.
    """

    pose: int
    bin: int
    number: int
    velocity: float
    torque: float
    acceleration: float


def _without_friction(model: DynamicModel, estimate: Estimate, c: Array, cd: Array, cdd: Array) -> Array:
    """Torque of bodies, rotors, offsets, springs and custom columns, (rows, samples), N m or N."""
    chi = raw_parameters(model, estimate.beta)
    for k, term in enumerate(model.terms, start=10 * len(model.device.joints)):
        if term.resists:
            chi[k] = 0.0
    return core_torque(model, chi, c, cd, cdd, external(model, c, cd, cdd))


def _passes(constant: ConstantVelocity, alone: bool, width: int, k: int, cd: Array, v: Array) -> Iterator[_Pass]:
    """Passes of coordinate k at a constant velocity; `v` are means of the velocities cd over `width` samples."""
    change = running_maximum(v[k], width) + running_maximum(-v[k], width)
    speed = np.abs(v[k])
    good = (speed >= constant.slowest) & (change <= constant.tolerance * speed)
    if alone:
        others = np.delete(np.abs(v), k, axis=0).max(axis=0, initial=0.0)
        good &= running_maximum(others, width) <= constant.still * speed
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        middle = float(np.median(v[k, start:stop]))
        steady = np.abs(v[k, start:stop] - middle).max() <= constant.tolerance * abs(middle)
        if stop - start >= width and steady:
            yield _Pass(int(start), int(stop), float(cd[k, start:stop].mean()))


def _by_pose(k: int, c: Array, passes: list[_Pass], alone: bool) -> Iterator[tuple[int, list[tuple[int, _Pass]]]]:
    """Passes by the pose of the other joints; with a model all count as one pose."""
    poses: list[Array] = []
    members: list[list[tuple[int, _Pass]]] = []
    for number, one in enumerate(passes):
        others = np.delete(c[:, one.start : one.stop].mean(axis=1), k) if alone else np.zeros(0)
        known = [i for i, pose in enumerate(poses) if np.abs(pose - others).max(initial=0.0) < SAME_POSE]
        if not known:
            poses.append(others)
            members.append([])
            known = [len(poses) - 1]
        members[known[0]].append((number, one))
    yield from enumerate(members)


def _cells(pose: tuple[int, list[tuple[int, _Pass]]], q: Array, tau: Array, qdd: Array) -> Iterator[_Cell]:
    """Mean torque by pass and position bin."""
    index, members = pose
    low = min(float(q[one.start : one.stop].min()) for _, one in members)
    high = max(float(q[one.start : one.stop].max()) for _, one in members)
    width = (high - low) / _BINS
    for number, one in members:
        at, torque, rate = (x[one.start : one.stop] for x in (q, tau, qdd))
        bins = np.clip(((at - low) / width).astype(int), 0, _BINS - 1)
        for k in np.unique(bins):
            here = bins == k
            if np.ptp(at[here]) >= COVERED * width:
                means = float(torque[here].mean()), float(rate[here].mean())
                yield _Cell(index, int(k), number, one.velocity, *means)


def _usable(cells: list[_Cell]) -> list[_Cell]:
    """Cells of passes with enough bins."""
    count = np.bincount([cell.number for cell in cells]) if cells else np.zeros(0)
    return [cell for cell in cells if count[cell.number] >= _LEAST_BINS]


def _points(cells: list[_Cell], alone: bool) -> tuple[Array, Array, Array, Array] | None:
    """Velocity, torque, standard error and degrees of freedom of every pass; None without both directions."""
    if alone:
        signs = {(cell.pose, np.sign(cell.velocity)) for cell in cells}
        cells = [cell for cell in cells if {(cell.pose, -1.0), (cell.pose, 1.0)} <= signs]
    if not cells:
        return None
    whole = _levels(cells, alone)
    bins = sorted({cell.bin for cell in cells})
    parts = np.array([_levels(cells, alone, k) for k in bins])
    se = np.sqrt((len(bins) - 1) / len(bins) * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    passes = sorted({cell.number for cell in cells})
    velocity = np.array([next(cell.velocity for cell in cells if cell.number == s) for s in passes])
    dof = np.array([sum(cell.number == s for cell in cells) - 1.0 for s in passes])
    order = np.argsort(velocity)
    return velocity[order], whole[order], se[order], dof[order]


def _levels(cells: list[_Cell], alone: bool, without: int | None = None) -> Array:
    """Friction torque of every pass, (passes,), with one position bin left out.

    Least squares of torque = G[pose, bin] + J[pose] acceleration + f[pass]: G is the pose-dependent torque, J the
    inertia for the remaining acceleration; with a model both are left out. A constant is arbitrary between G and f: the
    mean of the forward f is set opposite to that of the backward f.
    """
    passes = sorted({cell.number for cell in cells})
    used = [cell for cell in cells if cell.bin != without]
    poses = sorted({cell.pose for cell in cells}) if alone else []
    bins = sorted({(cell.pose, cell.bin) for cell in used}) if alone else []
    A = np.zeros((len(used), len(passes) + len(poses) + len(bins)))
    for row, cell in zip(A, used, strict=True):
        row[passes.index(cell.number)] = 1.0
        if alone:
            row[len(passes) + poses.index(cell.pose)] = cell.acceleration
            row[len(passes) + len(poses) + bins.index((cell.pose, cell.bin))] = 1.0
    f = np.linalg.lstsq(A, np.array([cell.torque for cell in used]), rcond=None)[0][: len(passes)]
    if not alone:
        return np.asarray(f)
    of = {cell.number: (cell.pose, cell.velocity) for cell in cells}
    for pose in poses:
        mine = np.array([of[s][0] == pose for s in passes])
        forward = np.array([of[s][1] > 0 for s in passes])
        f[mine] -= 0.5 * (f[mine & forward].mean() + f[mine & ~forward].mean())
    return np.asarray(f)
