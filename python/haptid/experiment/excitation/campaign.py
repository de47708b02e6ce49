"""The motions of a campaign besides the exciting ones: friction test, held poses, reversals; each within the limits.

Held poses are a D-optimal design for the static model (gravity, springs, offsets, Coulomb friction), found by greedy
choice and exchange among random poses (Fedorov 1972, Theory of Optimal Experiments, chapter 3).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.static import static_model
from haptid.errors import SettingError, TrajectoryError
from haptid.experiment.bench.trajectories import (
    QUINTIC_ACCELERATION,
    QUINTIC_SPEED,
    Figures,
    HeldPoses,
    Sweep,
    TrajectoryKind,
    Triangles,
    per_coordinate,
    plan,
)
from haptid.experiment.collision import Clearance, clearance_along
from haptid.experiment.excitation.limits import FLAT_LOOPS, Limits, MotionBounds
from haptid.experiment.excitation.planned import PlannedMotion, phases

# Step at which motions are checked, s.
_STEP = 2e-3
# Speeds of the friction test, shares of the lowest maximum speed; duration of its fastest stroke, s; ramp, s.
_SPEEDS, _STROKE_S, _RAMP = (0.05, 0.09, 0.16, 0.28, 0.5, 0.8), 1.0, 0.3
# Reversals: duration, s; frequencies of the first joint and ratio from one joint to the next, Hz; share of the range.
_REVERSALS_S, _SLOWEST_HZ, _APART, _SMALL = 30.0, 0.2, 1.15, 0.04
# Largest acceleration of a triangle's rounded corner over amplitude times the square of its frequency; of a smooth
# step, acceleration over speed and duration. Share of a limit that these motions take.
_CORNER, _STEPS, _TAKEN = 134.0, 1.875, 0.8
# Held poses: random ones to choose among, rounds of exchange, distance of the approach (share of the range), share of
# the maximum speed at which joints move, hold, s.
_DRAWN, _ROUNDS, _BESIDE, _PACE, _DWELL = 300, 4, 0.04, 0.5, 1.0
# Acceleration of joints without a limit, over their speed, 1/s.
_AT_ONCE = 100.0
# Prior information of a pose's design, relative to that of one row: the first poses do not determine everything.
_RIDGE = 1e-6
# Sizes that are tried where a motion exceeds a limit.
_HALVINGS = 12


def friction_test(
    model: DynamicModel, limits: Limits | None = None, *, rest: Figures | None = None, beta: Array | None = None
) -> PlannedMotion:
    """Constant-velocity strokes of one joint after the other, at six speeds, as `haptid friction` evaluates them.

    Args:
        limits: of the motion; default: those of the device file.
        rest: pose about which each joint moves, rad or m; default: the middle of the ranges.
        beta: base parameters for torques, (p,), SI; default: the prior.

    Raises:
        TrajectoryError: no stroke about this pose is within the limits.
        IncompleteDeviceError: a joint has no limits.
    """
    bounds, centre = _bounds(model, limits, rest, beta)
    speed, acceleration = _TAKEN * bounds.speed, _TAKEN * bounds.acceleration
    fastest = _SPEEDS[-1] * float(bounds.speed.min())
    ramp = max(_RAMP, _STEPS * fastest / float(acceleration.min()))
    reach = np.minimum(0.9 * _room(bounds, centre), fastest * (_STROKE_S + ramp) / 2)
    # The sweep goes to the ends of its strokes by quintic moves of two ramps.
    reach = np.minimum(reach, 2 * ramp * speed / QUINTIC_SPEED)
    reach = np.minimum(reach, (2 * ramp) ** 2 * acceleration / QUINTIC_ACCELERATION)
    speeds = tuple(share * float(bounds.speed.min()) for share in _SPEEDS)

    def at(size: float) -> Sweep:
        slow = size**0.5  # shorter strokes are slower, so that the ramps remain a part of them
        return Sweep(centre, tuple((size * reach).tolist()), tuple(slow * v for v in speeds), ramp)

    return _largest(at, bounds, "a friction test")


def reversals(
    model: DynamicModel, limits: Limits | None = None, *, rest: Figures | None = None, beta: Array | None = None
) -> PlannedMotion:
    """Small slow triangles of all joints: many reversals, for friction with history (presliding) and backlash.

    Arguments and errors: see `friction_test`.
    """
    bounds, centre = _bounds(model, limits, rest, beta)
    joints = len(bounds.names)
    frequency = _SLOWEST_HZ * _APART ** np.arange(joints)
    amplitude = np.minimum(_SMALL * np.ptp(bounds.position, axis=1), 0.9 * _room(bounds, centre))
    amplitude = np.minimum(amplitude, _TAKEN * bounds.speed / (4.6 * frequency))
    amplitude = np.minimum(amplitude, _TAKEN * bounds.acceleration / (_CORNER * frequency**2))

    def at(size: float) -> Triangles:
        return Triangles(_REVERSALS_S, centre, tuple((size * amplitude).tolist()), tuple(frequency.tolist()))

    return _largest(at, bounds, "a motion of reversals")


def held_poses(
    model: DynamicModel,
    limits: Limits | None = None,
    *,
    count: int = 12,
    rest: Figures | None = None,
    beta: Array | None = None,
    seed: int = 0,
) -> PlannedMotion:
    """Held poses, each reached from both sides, that determine gravity, springs and Coulomb friction best.

    For devices that cannot follow fast motion, and as `haptid poses` evaluates them. The way between the poses is short
    and slow.

    Args:
        count: number of poses.
        rest: pose before and after, rad or m; default: the middle of the ranges.
        limits, beta: see `friction_test`.
        seed: of the random poses among which they are chosen.

    Raises:
        SettingError: fewer than two poses.
        TrajectoryError: fewer random poses than `count` are within the limits, or no way between them is.
        IncompleteDeviceError: a joint has no limits.
    """
    if count < 2:
        raise SettingError(f"count is {count!r}; write a whole number, 2 or more.", where="count", found=count)
    bounds, centre = _bounds(model, limits, rest, beta)
    beside = _BESIDE * np.ptp(bounds.position, axis=1)
    drawn = _feasible(bounds, beside, np.random.default_rng(seed), count)
    chosen = [drawn[k] for k in _d_optimal(pose_columns(model, drawn), count)]
    blocked: TrajectoryError | None = None  # the first of those that take out a pose each
    while len(chosen) >= 2:
        made = _visited(np.array(centre), chosen, beside, bounds)
        found, clearance = _exceeded(made, bounds)
        if found is None:
            return PlannedMotion(model, made, 0, bounds, clearance)
        blocked = blocked or found
        dropped = made.poses[_before(made, found.where[1], bounds.names)]
        chosen = [pose for pose in chosen if tuple(pose.tolist()) != dropped]
    assert blocked is not None  # as there were two poses
    raise blocked


def resting_pose(found: PlannedMotion) -> Figures:
    """Pose of each active joint before and after a motion, rad or m."""
    return tuple(found.trajectory(_STEP).q[0].tolist())


def pose_columns(model: DynamicModel, q: Array) -> Array:
    """Static regressor of each pose, from both sides, columns of unit mean square, (n, rows, p).

    Args:
        q: positions of the active joints, (n, active), rad or m.
    """
    static = static_model(model)
    c = static.device.row_map @ q.T
    base, measured = list(static.base.independent_columns), list(model.device.measured)
    sides = [static.columns(c, np.full(c.shape, side))[:, base][measured] for side in (1.0, -1.0)]
    W = np.concatenate(sides).transpose(2, 0, 1)
    size = np.sqrt((W**2).mean(axis=(0, 1)))
    return np.asarray(W / np.where(size > 0, size, 1.0))


def _d_optimal(W: Array, count: int) -> list[int]:
    """HeldPoses with the largest determinant of information: greedy, then exchanged one by one."""
    products = W.transpose(0, 2, 1) @ W
    ridge = _RIDGE * np.eye(W.shape[2])
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(_best(ridge + products[chosen].sum(axis=0), products, chosen))
    for _ in range(_ROUNDS):
        before = list(chosen)
        for k in range(count):
            rest = chosen[:k] + chosen[k + 1 :]
            chosen[k] = _best(ridge + products[rest].sum(axis=0), products, rest)
        if chosen == before:
            break
    return chosen


def _best(information: Array, products: Array, but: list[int]) -> int:
    gains = np.linalg.slogdet(information + products)[1]
    gains[but] = -np.inf
    return int(np.argmax(gains))


def _feasible(bounds: MotionBounds, beside: Array, rng: np.random.Generator, count: int) -> Array:
    """Random poses within the limits at rest, from a little below and above too, (n, active)."""
    low, high = bounds.position.T
    drawn = low + beside + (high - low - 2 * beside) * rng.random((_DRAWN, len(low)))
    within = np.ones(_DRAWN, dtype=bool)
    for side in (-beside, 0.0 * beside, beside):
        q = np.ascontiguousarray((drawn + side).T)
        states = np.array([q, np.zeros_like(q), np.zeros_like(q)])
        for excess, _ in bounds.by_sample(states):
            within &= excess <= 0
        within &= bounds.flatness(q) <= 0
        if bounds.collision is not None:
            near = bounds.collision.near(bounds.model.device.closure.positions(q).T, bounds.limits.clearance)
            within[near.sample[near.distance < bounds.limits.clearance]] = False
    if within.sum() < count:
        raise TrajectoryError(
            f"{int(within.sum())} of {_DRAWN} random poses are within all limits; {count} are to be held.",
            where="poses",
            found=int(within.sum()),
            limit=count,
            advice="Widen the limits, lower the clearance, or hold fewer poses.",
        )
    return np.asarray(drawn[within])


def _visited(rest: Array, chosen: list[Array], beside: Array, bounds: MotionBounds) -> HeldPoses:
    """The poses in an order with a short way, at a pace that speeds and accelerations allow."""
    left, order = list(chosen), [rest]
    while left:
        nearest = min(range(len(left)), key=lambda k: float((np.abs(left[k] - order[-1]) / bounds.speed).max()))
        order.append(left.pop(nearest))
    stops = [*order, rest]
    return HeldPoses(
        tuple(tuple(pose.tolist()) for pose in stops),
        tuple((_PACE * bounds.speed).tolist()),
        tuple((_PACE * np.minimum(bounds.acceleration, _AT_ONCE * bounds.speed)).tolist()),
        _DWELL,
        tuple(beside.tolist()),
    )


def _before(made: HeldPoses, at: float, names: list[str]) -> int:
    """Index of the pose that joints go to, or hold, at a time, s; of the last one on the way back."""
    stops, seconds = made.stops(names)
    ends = np.cumsum([lasts + dwell for lasts, (_, dwell) in zip(seconds, stops[1:], strict=True)])
    return min(1 + int(np.searchsorted(ends, at)) // 4, len(made.poses) - 2)


def _bounds(
    model: DynamicModel, limits: Limits | None, rest: Figures | None, beta: Array | None
) -> tuple[MotionBounds, Figures]:
    """The limits, and the pose of rest of each active joint."""
    beta = model.prior_beta if beta is None else beta
    bounds = MotionBounds.of(model, limits or Limits(), beta)
    middle = tuple(bounds.position.mean(axis=1).tolist())
    return bounds, tuple(per_coordinate("rest", rest or middle, bounds.names).tolist())


def _room(bounds: MotionBounds, centre: Figures) -> Array:
    """Distance from a pose to the nearer end of each joint's range, (active,)."""
    return np.asarray(np.minimum(bounds.position[:, 1] - centre, centre - bounds.position[:, 0]))


def _largest(at: Callable[[float], TrajectoryKind], bounds: MotionBounds, what: str) -> PlannedMotion:
    """The largest motion, of sizes halved from 1, that is within all limits.

    Raises:
        TrajectoryError: the smallest is not.
    """
    for k in range(_HALVINGS):
        kind = at(0.5**k)
        found, clearance = _exceeded(kind, bounds)
        if found is None:
            return PlannedMotion(bounds.model, kind, 0, bounds, clearance)
    assert found is not None  # as every size was outside
    raise TrajectoryError(
        f"{what} about this pose is not within the limits: {found.args[0]}",
        where=found.where,
        found=found.found,
        limit=found.limit,
        advice="Give another pose of rest (--start), or widen what is exceeded.",
    )


def _exceeded(kind: TrajectoryKind, bounds: MotionBounds) -> tuple[TrajectoryError | None, Clearance | None]:
    """The limit that a motion exceeds most, None where it keeps all, and its least distance."""
    made = plan(kind, bounds.model, _STEP, phases(0))
    states = np.array([made.q.T, made.qd.T, made.qdd.T])
    found = [*bounds.by_sample(states), *bounds.over_time(states, made.dt), (bounds.flatness(states[0]), FLAT_LOOPS)]
    excess, name = max(found, key=lambda one: float(one[0].max()))
    if excess.max() > 0:
        at, by = float(np.argmax(excess)) * made.dt, float(excess.max())
        return TrajectoryError(
            f"it exceeds {name} by {100 * by:.3g} % at {at:.3f} s.", where=(name, at), found=by
        ), None
    if bounds.collision is None:
        return None, None
    clearance = clearance_along(bounds.collision, made.q, made.dt)
    least = bounds.limits.clearance
    if clearance.bound > 0 and clearance.distance >= least:
        return None, clearance
    return (
        TrajectoryError(
            f"{clearance.pair} come to {1e3 * clearance.distance:.4g} mm at {clearance.time:.3f} s; the limit is "
            f"{1e3 * least:.4g} mm.",
            where=(clearance.pair, clearance.time),
            found=clearance.distance,
            limit=least,
        ),
        None,
    )


@dataclass(frozen=True)
class CampaignFamily:
    """A family of motions of a campaign.

    Attributes:
        make: the motion from model, limits, pose of rest and base parameters.
        what: its log says.
        then: the command that evaluates it.
    """

    make: Callable[..., PlannedMotion]
    what: str
    then: str


# Families by the names that files have.
CAMPAIGN_FAMILIES = {
    "friction": CampaignFamily(friction_test, "friction against velocity", "haptid friction study"),
    "poses": CampaignFamily(held_poses, "gravity, springs and friction at rest", "haptid poses"),
    "reversals": CampaignFamily(reversals, "friction after reversals", "haptid identify"),
}
