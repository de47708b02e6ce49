"""Nonlinear planar loops with symbolic lengths: dyads (two passive joints and a pin), modulo a prime.

With everything else drawn at random, a dyad's inner pivot is an intersection of two circles, which takes one square
root; half of the draws have none modulo a prime and are drawn again. Rates and accelerations follow by differentiating
the loop closure.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from fractions import Fraction
from functools import partial

import numpy as np

from haptid._internal.late import dataclass
from haptid.device import Closure, Device, NewtonClosure
from haptid.device.loops.from_toml import Loops
from haptid.device.parts import Joint
from haptid.device.toml.reader import device_of, reclosed
from haptid.device.toml.schema import AnyDevice
from haptid.dynamics.symbolic.arithmetic import PRIMES, Laurent, Points, PrimeField, Residues, UnluckyDrawError
from haptid.dynamics.symbolic.chain import States, SymbolicChain, SymbolicMotion, SymbolicRows, assembled
from haptid.dynamics.symbolic.geometry import (
    JointCoordinates,
    SymbolicCut,
    SymbolicFrame,
    SymbolicJoint,
    frame_pose,
    joint_placements,
    symbolic_poses,
)
from haptid.dynamics.symbolic.symbols import LENGTH, Symbol, Symbols, draw
from haptid.errors import RegroupingError

# x and y of a vector in a plane, (n,) each; poses of all links, (n, 4, 4) each.
Plane = tuple[Residues, Residues]
Links = Sequence[Residues]
# Most draws until all states have a square root: half of them do in each draw.
_DRAWS = 200
# States drawn at a time for each: two passes in place of eight for one dyad.
_TRIALS = 4


@dataclass(frozen=True)
class Dyad:
    """Two passive joints and the cut that closes them.

    Attributes:
        first: the joint whose link carries the inner pivot.
        second: the other one.
        near, far: the cut's frame that the second joint carries, and the other one.
        serial: whether the second joint is on the first one's link, so that it is itself the inner pivot.
    """

    first: int
    second: int
    near: SymbolicFrame
    far: SymbolicFrame
    serial: bool


@dataclass(frozen=True)
class DyadMotion:
    """Joint motion with active joints drawn at random and passive ones solved dyad by dyad.

    Attributes:
        joints: of the tree.
        active: indices of the active joints.
        dyads: each after those that it depends on.
    """

    joints: tuple[SymbolicJoint, ...]
    active: tuple[int, ...]
    dyads: tuple[Dyad, ...]

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """See SymbolicMotion."""
        return ()

    def states(self, rng: np.random.Generator, points: Points) -> States:
        """See SymbolicMotion."""
        field, count = points.field, points.count
        moved, links = self._closed(rng, points)
        active = field.draw(rng, 3, len(self.active), count)
        slides = np.array([joint.prismatic for joint in self.joints])
        position = np.where(slides[:, None], moved[2], field.draw(rng, len(self.joints), count))
        active[0] = position[list(self.active)]
        G = np.zeros((len(self.joints), count, len(self.active)), dtype=np.int64)
        acceleration = np.zeros((len(self.joints), count), dtype=np.int64)
        for k, j in enumerate(self.active):
            G[j, :, k], acceleration[j] = 1, active[2, k]
        for dyad in self.dyads:
            self._rates(dyad, links, points, active[1], G, acceleration)
        velocity = _along(field, G, active[1])
        return States(*moved, position, velocity, acceleration, G, active)

    def _closed(self, rng: np.random.Generator, points: Points) -> tuple[JointCoordinates, list[Residues]]:
        """Coordinates of all joints and poses of all links; states without a square root are drawn again."""
        placed = joint_placements(self.joints, points)
        cos, sin, slide = np.zeros((3, len(self.joints), points.count), dtype=np.int64)
        left = np.arange(points.count)
        for _ in range(_DRAWS):
            tried = np.repeat(left, _TRIALS)
            moved = self._drawn(points.field, rng, len(tried))
            good = np.ones(len(tried), dtype=bool)
            for dyad in self.dyads:
                good &= self._solve(dyad, points.at(tried), [placement[tried] for placement in placed], moved)
            closed, first = np.unique(tried[good], return_index=True)
            for joints, values in zip((cos, sin, slide), moved, strict=True):
                joints[:, closed] = values[:, good][:, first]
            left = np.setdiff1d(left, closed)
            if not len(left):
                return (cos, sin, slide), symbolic_poses(self.joints, points.field, placed, (cos, sin, slide))
        raise UnluckyDrawError

    def is_planar(self, symbols: Sequence[Symbol], seed: int) -> bool:
        """Whether the axes of each dyad's joints are parallel; `check_closure` tests that its links lie in a plane."""
        field, rng = PrimeField(PRIMES[0]), np.random.default_rng(seed)
        _, links = self._closed(rng, draw(symbols, field, rng, 1))
        axes = ((links[dyad.first][:, :3, 2], links[dyad.second][:, :3, 2]) for dyad in self.dyads)
        return not any(_cross(field, a, b).any() for a, b in axes)

    def _drawn(self, field: PrimeField, rng: np.random.Generator, count: int) -> JointCoordinates:
        """Active joints at random, passive ones at zero."""
        cos = np.ones((len(self.joints), count), dtype=np.int64)
        sin, slide = np.zeros_like(cos), np.zeros_like(cos)
        for j in self.active:
            if self.joints[j].prismatic:
                slide[j] = field.draw(rng, count)
            else:
                cos[j], sin[j] = field.circle(rng, count)
        return cos, sin, slide

    def _solve(self, dyad: Dyad, points: Points, placed: Sequence[Residues], moved: JointCoordinates) -> np.ndarray:
        """Set cosines and sines of a dyad's joints; returns at which states the circles intersect."""
        field, (cos, sin, _) = points.field, moved
        for j in (dyad.first, dyad.second):
            cos[j], sin[j] = 1, 0
        links = symbolic_poses(self.joints, field, placed, moved)
        near, far = (frame_pose(f, links, points)[:, :3, 3] for f in (dyad.near, dyad.far))
        pivot = links[dyad.second][:, :3, 3]
        inner, other = (pivot, far) if dyad.serial else (far, pivot)
        arm = _in_plane(field, links[dyad.first], inner)
        reach = _in_plane(field, links[dyad.first], other)
        outer = _in_plane(field, links[dyad.second], near)
        good, cos[dyad.first], sin[dyad.first] = _intersection(field, arm, reach, outer)
        links = symbolic_poses(self.joints, field, placed, moved)
        goal = _in_plane(field, links[dyad.second], frame_pose(dyad.far, links, points)[:, :3, 3])
        cos[dyad.second], sin[dyad.second] = _rotation(field, outer, goal)
        return good

    def _rates(
        self, dyad: Dyad, links: Links, points: Points, velocity: Residues, G: Residues, acceleration: Residues
    ) -> None:
        """Set a dyad's rows of G and its accelerations, from the differentiated closure."""
        field, plane = points.field, np.swapaxes(links[dyad.first][:, :3, :2], 1, 2)
        columns_of = self._slopes(dyad, links, points, plane)
        pair = [dyad.first, dyad.second]
        solve = _inverse(field, columns_of[:, :, pair])
        others = [j for j in range(len(self.joints)) if columns_of[:, :, j].any() and j not in pair]
        for k in range(G.shape[2]):
            gap = np.zeros(columns_of.shape[:2], dtype=np.int64)
            for j in others:
                gap = field.reduce(gap + columns_of[:, :, j] * G[j, :, k])
            G[pair, :, k] = _applied(field, solve, field.reduce(-gap))
        rates = _along(field, G, velocity)
        near, far = (self._acceleration(f, links, points, rates, acceleration) for f in (dyad.near, dyad.far))
        drift = field.product(plane, field.reduce(near - far)[:, :, None])[:, :, 0]
        acceleration[pair] = _applied(field, solve, field.reduce(-drift.T))

    def _slopes(self, dyad: Dyad, links: Links, points: Points, plane: Residues) -> Residues:
        """Velocity between the pin's two sides in the dyad's plane per unit rate of each joint, (2, n, joints)."""
        field, columns_of = points.field, np.zeros((2, points.count, len(self.joints)), dtype=np.int64)
        for frame, sign in ((dyad.near, 1), (dyad.far, -1)):
            point = frame_pose(frame, links, points)[:, :3, 3]
            for j in _ancestors(self.joints, frame.link):
                axis = links[j][:, :3, 2]
                velocity = axis if self.joints[j].prismatic else _cross(field, axis, point - links[j][:, :3, 3])
                in_plane = field.product(plane, velocity[:, :, None])[:, :, 0]
                columns_of[:, :, j] = field.reduce(columns_of[:, :, j] + sign * in_plane.T)
        return columns_of

    def _acceleration(
        self, frame: SymbolicFrame, links: Links, points: Points, rates: Residues, acceleration: Residues
    ) -> Residues:
        """Acceleration of a frame's origin in the base frame, (n, 3), from those of the joints."""
        field = points.field
        w = dw = a = origin = np.zeros((points.count, 3), dtype=np.int64)
        for j in reversed(_ancestors(self.joints, frame.link)):
            axis, here = links[j][:, :3, 2], links[j][:, :3, 3]
            a, origin = _point_acceleration(field, a, w, dw, here - origin), here
            rate, gain = (field.reduce(axis * x[j][:, None]) for x in (rates, acceleration))
            swing = _cross(field, w, rate)
            if self.joints[j].prismatic:
                a = field.reduce(a + gain + 2 * swing)
            else:
                w, dw = field.reduce(w + rate), field.reduce(dw + gain + swing)
        point = frame_pose(frame, links, points)[:, :3, 3]
        return _point_acceleration(field, a, w, dw, point - origin)


def _in_plane(field: PrimeField, pose: Residues, point: Residues) -> Plane:
    """x and y of a point in a frame, (n,) each."""
    offset = field.reduce(point - pose[:, :3, 3])
    local = field.product(np.swapaxes(pose[:, :3, :2], 1, 2), offset[:, :, None])
    return local[:, 0, 0], local[:, 1, 0]


def _dot(field: PrimeField, a: Plane, b: Plane) -> Residues:
    return field.reduce(a[0] * b[0] + a[1] * b[1])


def _rotation(field: PrimeField, start: Plane, goal: Plane) -> Plane:
    """Cosine and sine of the rotation from one vector to another of the same length."""
    scale = field.inverse(_dot(field, start, start))
    across = field.reduce(start[0] * goal[1] - start[1] * goal[0])
    return field.reduce(_dot(field, start, goal) * scale), field.reduce(across * scale)


def _intersection(field: PrimeField, arm: Plane, reach: Plane, outer: Plane) -> tuple[np.ndarray, Residues, Residues]:
    """Where circles intersect: the rotation of `arm` whose end is |outer| from the point `reach`.

    Returns:
        whether there is one, its cosine and its sine, (n,) each.
    """
    arm2, reach2, outer2 = (_dot(field, v, v) for v in (arm, reach, outer))
    abscissa = field.reduce(field.reduce(arm2 + reach2 - outer2) * field.of((field.prime + 1) // 2))
    height, good = field.root(field.reduce(arm2 * reach2 - abscissa * abscissa))
    scale = field.inverse(reach2)
    x = field.reduce(field.reduce(abscissa * reach[0] - height * reach[1]) * scale)
    y = field.reduce(field.reduce(abscissa * reach[1] + height * reach[0]) * scale)
    return good, *_rotation(field, arm, (x, y))


def _cross(field: PrimeField, a: Residues, b: Residues) -> Residues:
    """Cross products of (n, 3)."""
    a, b = field.reduce(a), field.reduce(b)
    left, right = a[:, [1, 2, 0]] * b[:, [2, 0, 1]], a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    return field.reduce(left - right)


def _point_acceleration(field: PrimeField, a: Residues, w: Residues, dw: Residues, lever: Residues) -> Residues:
    """Acceleration of a point of a body from that of another and the vector between them, (n, 3)."""
    return field.reduce(a + _cross(field, dw, lever) + _cross(field, w, _cross(field, w, lever)))


def _along(field: PrimeField, G: Residues, velocity: Residues) -> Residues:
    """Rates of all joints, (joints, n), from G, (joints, n, active), and the active ones', (active, n)."""
    result = np.zeros(G.shape[:2], dtype=np.int64)
    for k, rate in enumerate(velocity):
        result = field.reduce(result + G[:, :, k] * rate)
    return result


def _inverse(field: PrimeField, matrix: Residues) -> Residues:
    """Inverses of (2, n, 2), as (2, n, 2)."""
    (a, b), (c, d) = (np.moveaxis(row, 1, 0) for row in matrix)
    scale = field.inverse(field.reduce(a * d - b * c))
    rows = [[d, -b], [-c, a]]
    return np.array([np.stack([field.reduce(x * scale) for x in row], axis=1) for row in rows])


def _applied(field: PrimeField, matrix: Residues, vector: Residues) -> Residues:
    """Matrices (2, n, 2) times vectors (2, n)."""
    return np.stack([field.reduce(row[:, 0] * vector[0] + row[:, 1] * vector[1]) for row in matrix])


_TURNS = {"revolute": "turning", "prismatic": "sliding", "spherical": "spherical"}


def dyads(
    joints: Sequence[SymbolicJoint], cuts: Sequence[SymbolicCut], passive: Sequence[int]
) -> tuple[Dyad, ...] | str:
    """The dyads of cuts and passive joints, or the reason why there are none."""
    left = list(passive)
    dyads = []
    for cut in cuts:
        sides = [[j for j in _ancestors(joints, f.link) if j in left] for f in (cut.frame_a, cut.frame_b)]
        loop = [j for j in (*sides[0], *sides[1]) if not (j in sides[0] and j in sides[1])]
        if cut.kind != "revolute" or len(loop) != 2 or any(joints[j].prismatic for j in loop):
            return f"a loop has {len(loop)} passive joints and a {_TURNS[cut.kind]} cut"
        serial = any(set(loop) <= set(side) for side in sides)
        second = max(loop) if serial else loop[1]
        near, far = (cut.frame_a, cut.frame_b) if second in sides[0] else (cut.frame_b, cut.frame_a)
        dyads.append(Dyad(next(j for j in loop if j != second), second, near, far, serial))
        left = [j for j in left if j not in loop]
    return f"{len(left)} passive joints are in no loop with a cut" if left else tuple(dyads)


def _ancestors(joints: Sequence[SymbolicJoint], link: int) -> list[int]:
    ancestors = []
    while link >= 0:
        ancestors.append(link)
        link = joints[link].parent
    return ancestors


def opened_tree(
    tables: AnyDevice, file: str, joints_to_find: Set[str] | None = None, device: Device | None = None
) -> Device:
    """A device with loops left open: its spanning tree if all are.

    Args:
        tables: of the device.
        file: its name for errors.
        joints_to_find: passive joints whose loops are left open; None: of all.
        device: whose other loops are linear: how they move is taken from it, and not found again.

    Raises:
        DeviceError: in one of its kinds, what is wrong with the file.
        RegroupingError: an opened loop has relations, or terms may act on its cut.
    """
    opened = [loop for loop in tables.loops if joints_to_find is None or not joints_to_find.isdisjoint(loop.passive)]
    if any(loop.relations for loop in opened):
        raise _no_dyad(file, "a loop has relations")
    if named := [loop.cut.name for loop in opened if loop.cut and loop.cut.name]:
        raise _no_dyad(file, f"cut joint {named[0]} has a name, so that terms may act on it")
    passive = _passive(tables)
    active = [joint.name for joint in tables.joints if joint.name not in passive]
    driven = {name for motor in tables.motors for name in motor.drives or {motor.name: 1.0}}
    order = [joint.name for joint in tables.joints] if tables.motors else active
    words = {"active": active, "motorised": [name for name in order if name in driven or not tables.motors]}
    terms = [
        term.model_copy(update={"joints": words[term.joints]}) if term.joints in ("active", "motorised") else term
        for term in tables.terms
    ]
    joints = [joint.model_copy(update={"active": None}) for joint in tables.joints]
    closed = [loop for loop in tables.loops if loop not in opened]
    tables = tables.model_copy(update={"loops": closed, "terms": terms, "joints": joints})
    return device_of(tables, file) if device is None else reclosed(device, tables, partial(_linear_part, device))


def _linear_part(
    device: Device, joints: Sequence[Joint], active: tuple[int, ...], loops: Loops
) -> tuple[Closure, tuple[str, ...]]:
    """The closure of a device's linear loops, with the joints active that its other loops move."""
    known = device.closure
    assert isinstance(known, NewtonClosure)
    G, offset, place = np.zeros((len(joints), len(active))), np.zeros(len(joints)), {j: k for k, j in enumerate(active)}
    G[list(active), np.arange(len(active))] = 1.0
    for j in loops.passive:
        offset[j] = known.offset[j]
        for k in np.flatnonzero(known.constant[j]).tolist():
            G[j, place[device.active[k]]] = known.constant[j, k]
    return Closure(G, offset, known.error, (), loops.cuts), ()


def dyad_chain(tree: Device, tables: AnyDevice, file: str, seed: int) -> SymbolicChain:
    """The tree's mechanism with its loops closed by dyads.

    Args:
        tree: see `opened_tree`.
        tables: of the device.
        file: its name for errors.
        seed: of random draws; the result does not depend on it.

    Raises:
        RegroupingError: a loop is no planar dyad.
    """
    passive = _passive(tables)
    active = tuple(j for j, name in enumerate(tree.joint_names) if name not in passive)

    def motion(joints: tuple[SymbolicJoint, ...], cuts: tuple[SymbolicCut, ...], symbols: Symbols) -> SymbolicMotion:
        chain_dyads = dyads(joints, cuts, [j for j in range(len(joints)) if j not in active])
        if isinstance(chain_dyads, str):
            raise _no_dyad(file, chain_dyads)
        made = DyadMotion(joints, active, chain_dyads)
        if not made.is_planar(symbols.all, seed):
            raise _no_dyad(file, "the axes of a loop's two passive joints are not parallel")
        return made

    return assembled(tree, tables, active, _rows(tree, active, bool(tables.motors)), motion)


def _passive(tables: AnyDevice) -> set[str]:
    return {name for loop in tables.loops for name in loop.passive}


def _rows(tree: Device, active: tuple[int, ...], motors: bool) -> SymbolicRows:
    """Measured torques: those of active joints with motors; None where all have one or the file names no motors."""
    if not motors:
        return None
    # A motor on a passive joint loads the active joints that this follows: all of a dyad's.
    loads = [row | np.delete(row, active).any() for row in (drive.row != 0 for drive in tree.motors)]
    driven = np.any(loads, axis=0)[list(active)]
    if all(driven):
        return None
    chosen = [k for k, known in enumerate(driven) if known]
    return tuple(tuple(Fraction(int(i == k)) for i in range(len(active))) for k in chosen)


# States at which closure is tested: the odds of closing by chance are a few in a billion.
_STATES = 3


def check_closure(chain: SymbolicChain, names: tuple[str, ...], seed: int) -> None:
    """Raise unless every loop closes for all values of its symbolic lengths, tested at random exact states.

    Args:
        chain: the mechanism.
        names: of its joints, for the error.
        seed: of states and lengths.

    Raises:
        RegroupingError: a cut's frames do not coincide.
    """
    if not chain.cuts:
        return
    field, rng = PrimeField(PRIMES[0]), np.random.default_rng(seed)
    points = draw(chain.symbols, field, rng, _STATES)
    states, placed = chain.motion.states(rng, points), joint_placements(chain.joints, points)
    links = symbolic_poses(chain.joints, field, placed, (states.cos, states.sin, states.slide))
    for cut in chain.cuts:
        frame_a, frame_b = (frame_pose(frame, links, points) for frame in (cut.frame_a, cut.frame_b))
        if _gap(field, frame_a, frame_b, cut.kind).any():
            first, second = (names[frame.link] if frame.link >= 0 else "base" for frame in (cut.frame_a, cut.frame_b))
            lengths = [f"{s.name} = {s.value:.6g}" for s in chain.symbols if s.dimension == LENGTH]
            raise RegroupingError(
                f"with symbolic lengths the loop cut between links {first} and {second} does not close: it closes at "
                f"{', '.join(lengths) or 'its own lengths'} only.",
                where=(first, second),
                advice=(
                    "Where bars must be equal, let them share a name in [lengths], or write one by the other, such "
                    'as d9 = "d3".'
                ),
            )


def _gap(field: PrimeField, frame_a: Residues, frame_b: Residues, kind: str) -> Residues:
    """Closure error: distance of origins, and of z axes; for a sliding joint, of orientations, and across z."""
    difference = field.reduce(frame_a - frame_b)
    if kind != "prismatic":
        return difference[:, :3, 3 if kind == "spherical" else 2 :]
    across = field.product(np.swapaxes(frame_b[:, :3, :2], 1, 2), difference[:, :3, 3:])
    return np.concatenate([difference[:, :3, :3], np.concatenate([across, across[:, :1]], axis=1)], axis=2)


def _no_dyad(file: str, structure: str) -> RegroupingError:
    return RegroupingError(
        f"{file}: these loops are not planar dyads: {structure}.",
        where=file,
        found=structure,
        advice=(
            "Each needs exactly two turning passive joints and a turning cut, and no relations; loops with relations "
            "are read by `read_device`."
        ),
    )
