"""Rows of the regressor in floating point with loops closed by Newton's method, at many sets of lengths at once.

The symbolic mechanism with its loops opened is evaluated at numbers; the cuts left open are closed at each set, and the
rows are projected on the motion that they leave. Inertia is taken at rest: a relation of columns that holds at all
velocities holds in every power of them by itself, and what is left at rest, mass matrix and gravity, implies the
centrifugal and Coriolis part. The rows of some of the active joints alone do not: their centrifugal part has
derivatives of the others' rows of the mass matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from haptid import _core
from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import NewtonClosure
from haptid.device.expressions import number
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic.arithmetic import Points, Reals
from haptid.dynamics.symbolic.chain import States, SymbolicChain
from haptid.dynamics.symbolic.geometry import SymbolicFrame, joint_placements, placement_residues
from haptid.dynamics.symbolic.regressor import Columns, rows_at
from haptid.dynamics.symbolic.symbols import CHECKED

# Fewest random states at each set, and fewest rows for each column of a relation.
_STATES, _TIMES = 6, 4
# Active joints are drawn within this distance of the start pose, rad or mechanism sizes, and nearer: of twice as many
# states as are needed, those furthest away at which the loops close are taken.
_ABOUT = (1.0, 0.25)
# Gauss-Newton steps, the length of the last one, and the gap of a closed loop as a share of the mechanism's size.
_STEPS, _TOLERANCE, _CLOSED = 20, 1e-12, 1e-12
# Least singular value of the Jacobian by the passive joints, its columns of unit length.
_ROOMY = 0.1


# Rows at one set of lengths, and the length of the longest column of all.
RowsAtLengths = tuple[Array, float]


@dataclass(frozen=True, eq=False)
class ClosedRows:
    """A mechanism whose opened loops are closed at numbers.

    Attributes:
        model: of the device.
        closure: of its loops.
        chain: with the loops opened.
        members: signs of the raw columns in each standard parameter's, (raw, standard).
        rates: of all joints by those active with the loops opened, (joints, opened).
        passive: which of these the cuts determine, (opened,).
    """

    model: DynamicModel
    closure: NewtonClosure
    chain: SymbolicChain
    members: Array
    rates: Array
    passive: np.ndarray

    @staticmethod
    def of(model: DynamicModel, columns: Columns) -> ClosedRows:
        """Of a device and the columns with its loops opened."""
        closure, joints = model.device.closure, len(columns.chain.joints)
        assert isinstance(closure, NewtonClosure)
        members = np.zeros((10 * joints + len(columns.chain.columns), len(columns.members)))
        for k, raw in enumerate(columns.members):
            for j, sign in raw:
                members[j, k] = sign
        opened = sorted({*model.device.active, *closure.unknown})
        passive = np.isin(opened, closure.unknown)
        rates = np.zeros((joints, len(opened)))
        rates[:, ~passive] = closure.constant
        rates[np.array(opened)[passive], np.flatnonzero(passive)] = 1.0
        return ClosedRows(model, closure, columns.chain, members, rates, passive)

    def at(
        self, rng: np.random.Generator, lengths: Sequence[Mapping[str, float]], columns: Sequence[int], most: int
    ) -> list[RowsAtLengths | None]:
        """Rows of the torques of all active joints at each set; None where loops do not close.

        Args:
            rng: random generator.
            lengths: named lengths of each set, m.
            columns: those of the standard parameters wanted.
            most: columns in a relation.
        """
        states = max(_STATES, -(-_TIMES * most // len(self.model.device.active)))
        points = self._points(lengths)
        closed = self._closed(rng, points, states)
        good = [k for k, pose in enumerate(closed) if pose is not None]
        found: list[RowsAtLengths | None] = [None] * len(lengths)
        if good:
            q, B = (np.concatenate([pose[part] for pose in closed if pose is not None]) for part in (0, 1))
            raw = rows_at(self.chain, self._states(rng, q, B), points.at(np.array(good)), states, rng)
            rows = (np.swapaxes(B, 1, 2) @ raw).reshape(len(good), -1, raw.shape[2])
            sizes = np.linalg.norm(rows, axis=1).max(axis=1)
            for k, W, size in zip(good, rows @ self.members[:, list(columns)], sizes.tolist(), strict=True):
                found[k] = W, size
        return found

    def _points(self, lengths: Sequence[Mapping[str, float]]) -> Points:
        """Values of all symbols at sets of named lengths; lengths that are written as formulas follow."""
        device, sets = self.model.device, []
        named = device.tables.lengths
        formulas = {n: text for n, text in named.items() if isinstance(text, str) and any(m in text for m in named)}
        for moved in lengths:
            full = {**device.lengths, **moved}
            for name, written in formulas.items():
                full[name] = number(written, full, CHECKED)
            sets.append(full)
        symbols = (*self.chain.symbols, *self.chain.beyond)
        values = {s.name: np.array([s.at(full, device.lengths) for full in sets]) for s in symbols}
        return Points(cast(Any, Reals()), values, len(lengths))

    def _closed(self, rng: np.random.Generator, points: Points, states: int) -> list[tuple[Array, Array] | None]:
        """Closed poses at each set, (states, joints), and rates of the opened active joints, (states, opened, active).

        None where too few of those drawn close away from singular ones.
        """
        closure, active = self.closure, list(self.model.device.active)
        units, unknown = closure.units[active], list(closure.unknown)
        about = np.linspace(*_ABOUT, 2 * states)[:, None]
        qa = closure.at + about * units * rng.uniform(-1, 1, (2 * states, len(units)))
        start = qa @ closure.constant.T + closure.offset
        start[:, unknown] = closure.start[unknown]
        q, gaps, jacobian = self._solved(points, start)
        by_opened = np.nan_to_num(jacobian) @ self.rates
        A = by_opened[..., self.passive]
        scale = np.maximum(np.linalg.norm(A, axis=2, keepdims=True), 1e-300)
        U, sizes, V = np.linalg.svd(A / scale, full_matrices=False)
        usable = np.abs(gaps).max(axis=2) < _CLOSED * closure.chain.size
        usable &= sizes[..., -1] > closure.least_conditioning(_ROOMY)
        drive = np.swapaxes(U, 2, 3) @ by_opened[..., ~self.passive] / np.maximum(sizes, 1e-300)[..., None]
        G = -np.swapaxes(V, 2, 3) @ drive / np.swapaxes(scale, 2, 3)
        found: list[tuple[Array, Array] | None] = [None] * len(usable)
        for k in np.flatnonzero(usable.sum(axis=1) >= states).tolist():
            B = np.zeros((states, len(self.passive), len(units)))
            B[:, ~self.passive] = np.eye(len(units))
            B[:, self.passive] = G[k, usable[k]][:states]
            found[k] = q[k, usable[k]][:states], B
        return found

    def _solved(self, points: Points, start: Array) -> tuple[Array, Array, Array]:
        """Poses by Newton's method from the same ones at each set, their gaps, and the Jacobian of these by joint."""
        joints, size = self.chain.joints, self.closure.chain.size
        placed: Any = np.stack(joint_placements(joints, points))
        frames = [(self._frame(cut.frame_a, points), self._frame(cut.frame_b, points)) for cut in self.chain.opened]
        parents, slides = [joint.parent for joint in joints], [joint.prismatic for joint in joints]
        made = []
        for k in range(points.count):
            cuts = [(cut.kind, a(k), b(k)) for cut, (a, b) in zip(self.chain.opened, frames, strict=True)]
            rotation, translation = (np.ascontiguousarray(placed[:, k, :3, part]) for part in (slice(3), 3))
            loops = _core.Loops(parents, rotation, translation, slides, cuts, size)
            q = loops.close(start, list(self.closure.unknown), _STEPS, _TOLERANCE)
            made.append((q, *loops.gaps(q)))
        q, gaps, jacobian = (np.stack(part) for part in zip(*made, strict=True))
        return q, gaps, jacobian

    def _frame(self, frame: SymbolicFrame, points: Points) -> Callable[[int], tuple[int, list[float], list[float]]]:
        """A cut's frame at each set, as the core has it."""
        pose: Any = placement_residues(frame.placement, points)
        return lambda k: (frame.link, pose[k, :3, :3].ravel().tolist(), pose[k, :3, 3].tolist())

    def _states(self, rng: np.random.Generator, q: Array, B: Array) -> States:
        """Closed states: inertia at rest, other columns at random velocities."""
        slides = np.array([joint.prismatic for joint in self.chain.joints])
        velocity, acceleration = np.einsum("noa,kna->kon", B, rng.uniform(-1, 1, (2, len(q), B.shape[2])))
        opened = np.linalg.pinv(self.rates) @ (q - self.closure.offset).T
        G: Any = np.broadcast_to(self.rates[:, None], (len(slides), len(q), self.rates.shape[1]))
        turn = np.where(slides[:, None], 0.0, q.T)
        return States(
            np.cos(turn),
            np.sin(turn),
            np.where(slides[:, None], q.T, 0.0),
            np.ascontiguousarray(q.T),
            self.rates @ velocity,
            self.rates @ acceleration,
            G,
            np.stack([opened, velocity, acceleration]),
        )
