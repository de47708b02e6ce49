"""The friction test: each joint to and fro at constant velocities, and the torque that friction takes.

What depends on the pose alone (gravity, springs, offsets) is taken out by passing the same positions in both
directions, or with a model. A torque row sees all friction that moves with its coordinate, passive joints' too.

Source: Janot et al. (2007), section 4, "constant-velocity runs".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage, stats

from haptid._internal.arrays import Array, expect, positive, read_only
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.errors import MethodSettingError, NoStretchesError
from haptid.estimation import Estimate
from haptid.motion.channels import coordinate_torque, coordinates
from haptid.motion.treatment import Motion

# Positions of a joint are told apart in so many bins; torque is averaged within each.
BINS = 24
# A stretch counts in a bin of which it passes this share, and at all with so many bins.
PASSED = 0.7
LEAST_BINS = 4
# Other joints closer than this to where they were are in the same pose, rad or m.
SAME_POSE = 0.02


@dataclass(frozen=True)
class Constant:
    """What counts as moving at a constant velocity.

    Attributes:
        tolerance: share of the velocity by which it may change.
        shortest: duration over which it must not, s; velocities are means over as long.
        slowest: least speed, rad/s or m/s.
        still: share of its speed that another joint may move at.
    """

    tolerance: float = 0.05
    shortest: float = 0.1
    slowest: float = 0.01
    still: float = 0.05

    def __post_init__(self) -> None:
        for name in ("tolerance", "shortest", "slowest", "still"):
            if not positive(getattr(self, name)):
                raise MethodSettingError("Constant", name, getattr(self, name), "a finite number above zero")


class Gravity(Protocol):
    """How what is not friction is taken out of the torque."""

    @property
    def alone(self) -> bool:
        """Whether the other joints must be still."""

    def torque(self, model: DynamicModel, c: Array, cd: Array, cdd: Array) -> Array:
        """What is taken out beforehand, (rows, samples), N m or N."""


@dataclass(frozen=True)
class DirectionPairs:
    """Both directions through the same positions, the other joints still: no model.

    A torque that is the same in both directions is not told from gravity: neither is Coulomb friction that differs by
    direction from an offset.
    """

    @property
    def alone(self) -> bool:
        """Whether the other joints must be still."""
        return True

    def torque(self, model: DynamicModel, c: Array, cd: Array, cdd: Array) -> Array:
        """Nothing, (rows, samples)."""
        del model, cd, cdd
        return np.zeros_like(c)


@dataclass(frozen=True, eq=False)
class ModelSubtraction:
    """An estimate's torque but for its friction; all joints may move.

    Attributes:
        estimate: of the device, from another motion than the test's.
    """

    estimate: Estimate

    @property
    def alone(self) -> bool:
        """Whether the other joints must be still."""
        return False

    def torque(self, model: DynamicModel, c: Array, cd: Array, cdd: Array) -> Array:
        """Of bodies, rotors, offsets, springs and a user's own columns, (rows, samples)."""
        chi = raw_parameters(model, self.estimate.beta)
        for k, term in enumerate(model.terms, start=10 * len(model.device.joints)):
            if term.resists:
                chi[k] = 0.0
        return core_torque(model, chi, c, cd, cdd, external(model, c, cd, cdd))


@dataclass(frozen=True, eq=False)
class JointFriction:
    """Friction torque against velocity, one point for each stretch at a constant velocity.

    Attributes:
        name, label: of the torque row, "1" and "motor 1".
        unit: of its torque, N m or N.
        velocity: ascending, (n,), rad/s or m/s.
        torque: mean over the positions passed, (n,).
        se: its deviation, by leaving out positions, (n,).
        dof: positions passed less one, (n,).
    """

    name: str
    label: str
    unit: str
    velocity: Array
    torque: Array
    se: Array
    dof: Array

    def __post_init__(self) -> None:
        for name in ("velocity", "torque", "sd", "freedom"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, self.velocity.shape)

    @property
    def interval95(self) -> Array:
        """Of the torque, (n, 2)."""
        half = stats.t.ppf(0.975, self.dof) * self.se
        return np.column_stack([self.torque - half, self.torque + half])


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction of the joints that a motion tests.

    Attributes:
        model: the dynamic model.
        joints: curves by torque row.
        notes: sentences a user should read.
    """

    model: DynamicModel
    joints: tuple[JointFriction, ...]
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> JointFriction:
        return self.joints[[joint.name for joint in self.joints].index(name)]

    def summary(self) -> str:
        """A table as text: velocity, torque, its 95 % interval."""
        lines = []
        for joint in self.joints:
            lines.append(f"{joint.label}: velocity, friction torque in {joint.unit}, 95 % interval")
            for v, tau, (low, high) in zip(joint.velocity, joint.torque, joint.interval95, strict=True):
                lines.append(f"  {v:9.4f} {tau:10.5f}   {low:.5f} .. {high:.5f}")
        return "\n".join([*lines, *self.notes])


def friction_curve(
    model: DynamicModel, motion: Motion, gravity: Gravity | None = None, constant: Constant | None = None
) -> FrictionCurve:
    """Friction torque against velocity of every joint that moves at constant velocities.

    Args:
        model: the dynamic model.
        motion: each joint in turn, to and fro, at several constant speeds; with a model, any with such stretches.
        gravity: `DirectionPairs()` or `ModelSubtraction(estimate)`; pairs where left out.
        constant: what counts as a constant velocity.

    Raises:
        ChannelCountError: the motion has more or fewer channels than the device has coordinates or motors.
        NoAccelerationError: the motion's treatment has none.
        NoStretchesError: no joint moves to and fro at a constant velocity.
    """
    gravity, constant = gravity or DirectionPairs(), constant or Constant()
    c, cd, cdd = coordinates(model.device, motion, *motion.usable)
    tau = coordinate_torque(model.device, motion, *motion.usable) - gravity.torque(model, c, cd, cdd)
    width = max(3, round(constant.shortest / motion.dt))
    curves, idle = [], []
    for k in [int(k) for k in np.flatnonzero(model.device.measured)]:
        passes = list(_passes(constant, gravity.alone, width, k, cd))
        cells = [
            cell for poses in _by_pose(k, c, passes, gravity.alone) for cell in _cells(poses, c[k], tau[k], cdd[k])
        ]
        found = _points(_usable(cells), gravity.alone)
        if found is None:
            idle.append(model.device.row_labels[k])
            continue
        curves.append(
            JointFriction(model.device.row_names[k], model.device.row_labels[k], model.device.torque_units[k], *found)
        )
    if not curves:
        raise NoStretchesError(constant.tolerance, constant.shortest, constant.slowest)
    notes = (f"No pair of stretches at a constant velocity: {', '.join(idle)}.",) if idle else ()
    return FrictionCurve(model, tuple(curves), notes)


@dataclass(frozen=True, eq=False)
class Pass:
    """A stretch at a constant velocity: samples start..stop, and the mean velocity there."""

    start: int
    stop: int
    velocity: float


@dataclass(frozen=True)
class Cell:
    """Mean torque of a stretch in one bin of positions.

    Attributes:
        pose: of the other joints.
        place: bin of the positions.
        stretch: number of it, over all poses.
        velocity: of the stretch.
        torque, acceleration: mean, N m or N, and rad/s^2 or m/s^2.
    """

    pose: int
    place: int
    stretch: int
    velocity: float
    torque: float
    acceleration: float


def _passes(constant: Constant, alone: bool, width: int, k: int, cd: Array) -> Iterator[Pass]:
    """Stretches of coordinate k at a constant velocity."""
    v = ndimage.uniform_filter1d(cd, width, axis=1)
    change = ndimage.maximum_filter1d(v[k], width) - ndimage.minimum_filter1d(v[k], width)
    speed = np.abs(v[k])
    good = (speed >= constant.slowest) & (change <= constant.tolerance * speed)
    if alone:
        others = np.delete(np.abs(v), k, axis=0).max(axis=0, initial=0.0)
        good &= ndimage.maximum_filter1d(others, width) <= constant.still * speed
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        middle = float(np.median(v[k, start:stop]))
        steady = np.abs(v[k, start:stop] - middle).max() <= constant.tolerance * abs(middle)
        if stop - start >= width and steady:
            yield Pass(int(start), int(stop), float(cd[k, start:stop].mean()))


def _by_pose(k: int, c: Array, passes: list[Pass], alone: bool) -> Iterator[tuple[int, list[tuple[int, Pass]]]]:
    """Stretches by the pose of the other joints; with a model all are of one."""
    poses: list[Array] = []
    members: list[list[tuple[int, Pass]]] = []
    for number, one in enumerate(passes):
        others = np.delete(c[:, one.start : one.stop].mean(axis=1), k) if alone else np.zeros(0)
        known = [i for i, pose in enumerate(poses) if np.abs(pose - others).max(initial=0.0) < SAME_POSE]
        if not known:
            poses.append(others)
            members.append([])
            known = [len(poses) - 1]
        members[known[0]].append((number, one))
    yield from enumerate(members)


def _cells(pose: tuple[int, list[tuple[int, Pass]]], q: Array, tau: Array, qdd: Array) -> Iterator[Cell]:
    """Mean torque by stretch and bin of positions."""
    number, members = pose
    low = min(float(q[one.start : one.stop].min()) for _, one in members)
    high = max(float(q[one.start : one.stop].max()) for _, one in members)
    width = (high - low) / BINS
    for stretch, one in members:
        at, torque, rate = (x[one.start : one.stop] for x in (q, tau, qdd))
        places = np.clip(((at - low) / width).astype(int), 0, BINS - 1)
        for place in np.unique(places):
            here = places == place
            if np.ptp(at[here]) >= PASSED * width:
                yield Cell(
                    number, int(place), stretch, one.velocity, float(torque[here].mean()), float(rate[here].mean())
                )


def _usable(cells: list[Cell]) -> list[Cell]:
    """Cells of stretches that pass enough bins."""
    count = np.bincount([cell.stretch for cell in cells]) if cells else np.zeros(0)
    return [cell for cell in cells if count[cell.stretch] >= LEAST_BINS]


def _points(cells: list[Cell], alone: bool) -> tuple[Array, Array, Array, Array] | None:
    """Velocity, torque, deviation and freedom of every stretch; None without any, or without both directions."""
    if alone:
        ways = {
            pose: {np.sign(cell.velocity) for cell in cells if cell.pose == pose} for pose in {c.pose for c in cells}
        }
        cells = [cell for cell in cells if len(ways[cell.pose]) == 2]
    if not cells:
        return None
    whole = _levels(cells, alone)
    places = sorted({cell.place for cell in cells})
    parts = np.array([_levels(cells, alone, place) for place in places])
    se = np.sqrt((len(places) - 1) / len(places) * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    stretches = sorted({cell.stretch for cell in cells})
    velocity = np.array([next(cell.velocity for cell in cells if cell.stretch == s) for s in stretches])
    dof = np.array([sum(cell.stretch == s for cell in cells) - 1.0 for s in stretches])
    order = np.argsort(velocity)
    return velocity[order], whole[order], se[order], dof[order]


def _levels(cells: list[Cell], alone: bool, without: int | None = None) -> Array:
    """Friction torque of every stretch, (stretches,), the bins of one place left out.

    By least squares torque = G[pose, bin] + J[pose] acceleration + f[stretch]: G is what depends on the pose alone, J
    the inertia that what is left of acceleration takes; with a model neither is sought. A constant is free between G
    and f: the mean of the forward f is opposite to that of the backward ones.
    """
    stretches = sorted({cell.stretch for cell in cells})
    used = [cell for cell in cells if cell.place != without]
    poses = sorted({cell.pose for cell in cells}) if alone else []
    places = sorted({(cell.pose, cell.place) for cell in used}) if alone else []
    A = np.zeros((len(used), len(stretches) + len(poses) + len(places)))
    for row, cell in zip(A, used, strict=True):
        row[stretches.index(cell.stretch)] = 1.0
        if alone:
            row[len(stretches) + poses.index(cell.pose)] = cell.acceleration
            row[len(stretches) + len(poses) + places.index((cell.pose, cell.place))] = 1.0
    f = np.linalg.lstsq(A, np.array([cell.torque for cell in used]), rcond=None)[0][: len(stretches)]
    if not alone:
        return np.asarray(f)
    of = {cell.stretch: (cell.pose, cell.velocity) for cell in cells}
    for pose in poses:
        mine = np.array([of[s][0] == pose for s in stretches])
        forward = np.array([of[s][1] > 0 for s in stretches])
        f[mine] -= 0.5 * (f[mine & forward].mean() + f[mine & ~forward].mean())
    return np.asarray(f)
