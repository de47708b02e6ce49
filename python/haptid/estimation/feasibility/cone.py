"""The cone of physically consistent standard parameters: semidefinite pseudo-inertias, non-negative terms."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze
from haptid._internal.late import dataclass
from haptid.device import INERTIAL
from haptid.device.priors import TENSOR
from haptid.dynamics.model import DynamicModel
from haptid.estimation.feasibility.scaling import Scale

# Kinds of terms whose parameter is never negative because they are passive, and its name.
NEVER_NEGATIVE = {
    "rotor": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "coulomb+": "forward Coulomb friction",
    "coulomb-": "backward Coulomb friction",
}
# Parameters of a link that are positive for every body.
_POSITIVE = ("XX", "YY", "ZZ", "M")
# Upper triangle, column by column: the order of a semidefinite cone's entries.
UPPER = tuple((i, k) for k in range(4) for i in range(k + 1))


def pseudo_inertia(chi: Array) -> Array:
    """The pseudo-inertia of a link, (4, 4): positive semidefinite if and only if a rigid body has these parameters.

    Source: Wensing, Kim and Slotine (2018), IEEE Robotics and Automation Letters 3(1).

    Args:
        chi: XX XY XZ YY YZ ZZ MX MY MZ M, (10,), SI.
    """
    expect("chi", np.shape(chi), (10,))
    J = np.zeros((3, 3))
    for value, (i, k) in zip(chi[:6], TENSOR, strict=True):
        J[i, k] = J[k, i] = value
    second = np.trace(J) / 2 * np.eye(3) - J
    return np.block([[second, chi[6:9, None]], [chi[None, 6:9], chi[9]]])


def _entries(matrix: Array) -> Array:
    """Upper triangle of a symmetric (4, 4) matrix as a vector with the same inner products, (10,)."""
    return np.array([matrix[i, k] * (1.0 if i == k else np.sqrt(2)) for i, k in UPPER])


# The pseudo-inertia as a linear map of the ten parameters, (10, 10).
PSEUDO = freeze(np.column_stack([_entries(pseudo_inertia(unit)) for unit in np.eye(10)]))


def _unfold() -> Array:
    """Map from such a vector to the matrix, (10, 4, 4)."""
    basis = np.zeros((len(UPPER), 4, 4))
    for row, (i, k) in enumerate(UPPER):
        basis[row, i, k] = basis[row, k, i] = 1.0 if i == k else np.sqrt(0.5)
    return freeze(basis)


_UNFOLD, _NUMBER = _unfold(), freeze(np.ones((1, 1, 1)))


@dataclass(frozen=True, eq=False)
class ConeBlock:
    """One condition: G x in a cone, x the scaled standard parameters.

    Attributes:
        label: "link 3", or "viscous friction of motor 1".
        is_link: whether the cone is that of positive semidefinite matrices, or of non-negative numbers.
        G: the scaled pseudo-inertia's entries, (10, n), or one number, (1, n), from x.
    """

    label: str
    is_link: bool
    G: Array

    @property
    def inside(self) -> Array:
        """The central direction of the cone: the identity matrix, or one, (rows,)."""
        return _entries(np.eye(4)) if self.is_link else np.ones(1)

    @property
    def unfold(self) -> Array:
        """Basis that maps the cone's entries to the matrix, (rows, size, size)."""
        return _UNFOLD if self.is_link else _NUMBER

    def matrix(self, x: Array) -> Array:
        """The scaled pseudo-inertia, or the scaled term, at x, (4, 4) or (1, 1)."""
        return np.asarray(np.tensordot(self.G @ x, self.unfold, 1))

    def matrices(self, directions: Array) -> Array:
        """Along every column of directions, (n, k): (k, 4, 4) or (k, 1, 1)."""
        return np.asarray(np.tensordot((self.G @ directions).T, self.unfold, 1))

    def margin(self, x: Array) -> float:
        """The least eigenvalue at x: negative where no body, or no passive term, has these parameters."""
        return float(np.linalg.eigvalsh(self.matrix(x))[0])

    def reference(self, centre: Array, ball: Array) -> Array:
        """The centre where it is inside, else the ball."""
        return centre if self.margin(centre) > 1e-3 * self.margin(ball) else ball


@dataclass(frozen=True, eq=False)
class ConePart:
    """A group of standard parameters that shares no base parameter and no condition with the others.

    Attributes:
        columns: indices of its standard parameters, (k,).
        null: directions of them without effect on the base parameters, orthonormal, (n, null).
        blocks: its conditions.
    """

    columns: np.ndarray
    null: Array
    blocks: tuple[ConeBlock, ...]

    def margin(self, x: Array) -> float:
        """The least eigenvalue of its conditions; infinite without any."""
        return min((block.margin(x) for block in self.blocks), default=float("inf"))


@dataclass(frozen=True, eq=False)
class Cone:
    """The conditions of a device on its scaled standard parameters x = chi / scale.

    Attributes:
        scale: size of every standard parameter, (n,), SI.
        A: base parameters from x, (p, n), SI.
        ball: a homogeneous ball for every link, (n,).
        centre: the prior where one is known, else the ball, (n,).
        parts: the conditions, in independent groups.
    """

    scale: Array
    A: Array
    ball: Array
    centre: Array
    parts: tuple[ConePart, ...]

    @property
    def blocks(self) -> tuple[ConeBlock, ...]:
        """The conditions of all parts."""
        return tuple(block for part in self.parts for block in part.blocks)

    @property
    def null(self) -> Array:
        """Directions of x without effect on the base parameters, orthonormal, (n, null)."""
        return np.column_stack([part.null for part in self.parts])

    @cached_property
    def inverse(self) -> Array:
        """Minimum-norm map from base parameters to x, (n, p)."""
        rows = np.linalg.norm(self.A, axis=1)
        return np.asarray(np.linalg.pinv(self.A / rows[:, None]) / rows)

    def start(self, beta: Array) -> Array:
        """Scaled standard parameters with these base parameters, nearest to the centre, (n,)."""
        return self.centre + self.inverse @ (beta - self.A @ self.centre)

    def margin(self, x: Array) -> float:
        """The least eigenvalue of all conditions."""
        least, (matrices, numbers) = np.inf, self._conditions
        if len(matrices):
            least = float(np.linalg.eigvalsh((matrices @ x).reshape(-1, 4, 4))[:, 0].min())
        return min(least, float((numbers @ x).min(initial=np.inf)))

    @cached_property
    def _conditions(self) -> tuple[Array, Array]:
        """Maps from x to the entries of all matrices, (16 links, n), and to all terms, (terms, n)."""
        n = len(self.scale)
        links = [np.tensordot(b.G.T, b.unfold, 1).reshape(n, 16).T for b in self.blocks if b.is_link]
        terms = [b.G for b in self.blocks if not b.is_link]
        return np.concatenate([np.zeros((0, n)), *links]), np.concatenate([np.zeros((0, n)), *terms])

    @cached_property
    def room(self) -> float:
        """The least eigenvalue at the ball."""
        return self.margin(self.ball)

    def moved_inside(self, x: Array) -> Array:
        """x plus a multiple of the ball that removes a rounding error outside of the cone."""
        return x + max(0.0, -self.margin(x)) / self.room * self.ball


def cone(model: DynamicModel, beta: Array) -> Cone:
    """The cone of a device, scaled for base parameters of about this size.

    Args:
        beta: its base parameters, (p,), SI.
    """
    size = Scale.of(model, beta)
    A = model.base.regrouping * size.chi
    blocks = (*link_blocks(model, size), *term_blocks(model, size))
    shared = np.abs(model.device.parameters.S)
    ball = shared.T @ size.ball / np.maximum(shared.sum(axis=0), 1)
    known = np.isfinite(model.device.chi_prior)
    centre = np.where(known, np.where(known, model.device.chi_prior, 0.0), ball)
    return Cone(size.chi, A, ball / size.chi, centre / size.chi, parts(A, blocks))


def link_blocks(model: DynamicModel, size: Scale) -> list[ConeBlock]:
    """The pseudo-inertia of every link with inertia, in its own mass and length."""
    blocks = []
    for j, joint in enumerate(model.device.joints):
        raw = model.device.parameters.S[10 * j : 10 * j + 10] * size.chi
        root = np.array([size.length[j]] * 3 + [1.0]) * np.sqrt(size.mass[j])
        G = PSEUDO @ raw / np.array([root[i] * root[k] for i, k in UPPER])[:, None]
        for i in range(3):  # no extent along an axis, as of a thin rod: the other rows are the condition
            own = [row for row, entry in enumerate(UPPER) if i in entry]
            if not G[own].any():
                G[UPPER.index((i, i))] = G[UPPER.index((3, 3))]
        if joint.body and G.any():
            blocks.append(ConeBlock(f"link {joint.name}", True, G))
    return blocks


def term_blocks(model: DynamicModel, size: Scale) -> list[ConeBlock]:
    """Non-negative terms: each by itself, and Stribeck friction plus the Coulomb friction that it is added to.

    sgn(v) (FC + FS exp(..)) is dissipative at every speed if FC >= 0 and FC + FS >= 0.
    """
    rows = model.device.parameters.S[10 * len(model.device.joints) :]
    dry: dict[str, list[Array]] = {}
    blocks = []
    for term, row in zip(model.terms, rows, strict=True):
        if term.nature in NEVER_NEGATIVE and row.any():
            blocks.append(ConeBlock(f"{NEVER_NEGATIVE[term.nature]} of {term.on}", False, unit_row(row * size.chi)))
        if term.kind.startswith("coulomb"):
            dry.setdefault(term.on, []).append(row)
    for term, row in zip(model.terms, rows, strict=True):
        if term.kind == "stribeck" and row.any():
            for other in dry.get(term.on, [np.zeros_like(row)]):
                blocks.append(ConeBlock(f"friction at rest of {term.on}", False, unit_row((row + other) * size.chi)))
    return blocks


def unit_row(row: Array) -> Array:
    """A row scaled to a largest entry of one, (1, n)."""
    return np.asarray(row[None] / np.abs(row).max())


def _connected(used: np.ndarray) -> np.ndarray:
    """Number of the group of each column, (columns,), from 0; those with an entry in one row belong together."""
    label = np.arange(used.shape[1])
    for row in used:
        together = label[row]
        if len(together) > 1:
            joined = np.zeros(len(label), dtype=bool)
            joined[together] = True
            label[joined[label]] = together.min()
    return np.unique(label, return_inverse=True)[1]


def parts(A: Array, blocks: tuple[ConeBlock, ...]) -> tuple[ConePart, ...]:
    """Split parameters and conditions into independent groups."""
    n = A.shape[1]
    used = np.vstack([A != 0, *((block.G != 0).any(axis=0)[None] for block in blocks)])
    label = _connected(used)
    groups = []
    for group in range(label.max(initial=-1) + 1):
        columns = np.flatnonzero(label == group)
        rows = A[(A[:, columns] != 0).any(axis=1)][:, columns]
        if not len(rows):
            inner = np.eye(len(columns))
        elif len(columns) == 1:  # most parts are a friction coefficient, whose rows are not zero
            inner = np.zeros((1, 0))
        else:
            inner = linalg.null_space(rows / np.linalg.norm(rows, axis=1, keepdims=True))
        null = np.zeros((n, inner.shape[1]))
        null[columns] = inner
        own = tuple(block for block in blocks if block.G[:, columns].any())
        groups.append(ConePart(columns, null, own))
    return tuple(groups)


def never_negative(model: DynamicModel) -> np.ndarray:
    """Whether each base parameter is a sum of quantities that are never negative, (p,), bool."""
    raw = [kind in _POSITIVE for _ in model.device.joints for kind in INERTIAL]
    raw += [term.nature in NEVER_NEGATIVE for term in model.terms]
    S = model.device.parameters.S
    positive = S[np.array(raw)].sum(axis=0) == np.abs(S).sum(axis=0)
    rows = model.base.regrouping
    return np.asarray(((rows >= 0) & ((rows == 0) | positive)).all(axis=1))
