"""Positive definiteness of the mass matrix over a workspace: its smallest eigenvalue, and where and how it fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.workspace import Workspace
from haptid.estimation import Estimate
from haptid.estimation.feasibility.feasible import check_beta

# Number of the grid's lowest poses from which the smallest eigenvalue is refined.
_STARTS = 20
# Least distance between those poses in some joint, as a share of its range.
APART = 0.2
# Tolerance on limits, rad or m: the optimiser ends on them.
_AT_LIMIT = 1e-6
# Least component of an eigenvector for which one coordinate is named alone.
_ALONE = 0.99


@dataclass(frozen=True, eq=False)
class Definiteness:
    """The smallest eigenvalue of the mass matrix over a workspace.

    The sign of an eigenvalue does not depend on units. Its size does where some coordinates turn and others slide.

    Attributes:
        workspace: the poses.
        smallest: eigenvalue, kg m^2, kg, or in mixed units.
        se: its standard error from the estimate's covariance; None for parameters without one.
        at: the pose, (active,), rad or m.
        direction: its eigenvector over the torque rows' coordinates, (active,).
        share: of the workspace's poses at which M is not positive definite, 0 to 1.
        poses: grid poses inside the workspace.
        unit: of the eigenvalue.
    """

    workspace: Workspace
    smallest: float
    se: float | None
    at: Array
    direction: Array
    share: float
    poses: int
    unit: str

    def __post_init__(self) -> None:
        active = (len(self.workspace.model.device.active),)
        freeze_fields(self, at=active, direction=active)

    @property
    def positive(self) -> bool:
        """Whether M is positive definite at every pose evaluated."""
        return self.smallest > 0

    def summary(self) -> str:
        """The result in sentences."""
        model = self.workspace.model
        joints = [model.device.joints[j] for j in model.device.active]
        pose = ", ".join(
            f"{joint.name} {x:.4g} m" if joint.prismatic else f"{joint.name} {np.degrees(x):.4g} deg"
            for joint, x in zip(joints, self.at, strict=True)
        )
        se = "" if self.se is None else f" (standard error {self.se:.2g})"
        least = f"smallest eigenvalue {self.smallest:.4g} {self.unit}{se} at {pose}"
        if self.positive:
            searched = f"{self.poses} poses of the workspace and local minima from the lowest of them"
            text = f"The mass matrix is positive definite at {searched}: {least}."
        else:
            text = (
                f"The mass matrix is not positive definite in {100 * self.share:.3g} % of the workspace: {least}. "
                f"It fails along {self._failing()}."
            )
        return " ".join([text, *self._caveats()])

    def _failing(self) -> str:
        labels = self.workspace.model.device.row_labels
        worst = int(np.argmax(np.abs(self.direction)))
        if abs(self.direction[worst]) >= _ALONE:
            return labels[worst]
        parts = zip(self.direction, labels, strict=True)
        return " ".join(f"{x:+.2g} {label}" for x, label in parts if abs(x) > 1 - _ALONE)

    def _caveats(self) -> list[str]:
        model, notes = self.workspace.model, list[str]()
        if len(set(model.device.coordinate_units)) > 1:
            notes.append("Some coordinates turn, others slide: the eigenvalue's sign is meaningful, its size is not.")
        if labels := ", ".join(model.unmeasured_labels):
            notes.append(f"Torque is not measured on {labels}: the matrix is of the other coordinates.")
        return notes


def definiteness(identified: Estimate | ArrayLike, workspace: Workspace) -> Definiteness:
    """The smallest eigenvalue of M over a workspace: on a grid, then by local minimisation from the lowest poses.

    Args:
        identified: an estimate, or base parameters in SI of the workspace's device, (p,).
        workspace: the poses.

    Raises:
        ModelMismatchError: the estimate is of another device.
        WorkspaceError: no pose is inside the workspace.
        ShapeError: the parameters do not fit the device.
        SettingError: one of them is not a finite number.
    """
    model = workspace.model
    estimate = identified if isinstance(identified, Estimate) else None
    if estimate is not None:
        model.require_same(estimate.model)
    beta = identified.beta if isinstance(identified, Estimate) else check_beta(model, identified)
    mass = _MassEigenvalue(workspace, beta)
    poses = workspace.grid()
    values: Array = np.linalg.eigvalsh(mass.matrices(poses))[:, 0].astype(float, copy=False)
    starts = poses[:, _lowest_apart(poses, values, workspace.limits)]
    ends = np.column_stack([starts, *(mass.descend(start) for start in starts.T)])
    ends = ends[:, (workspace.slack(ends) >= -_AT_LIMIT).all(axis=0)]
    found, vectors = mass.lowest(ends)
    best = int(np.argmin(found))
    at, direction = ends[:, best], np.zeros(len(model.device.active))
    direction[mass.known] = vectors[best]
    units = {model.device.coordinate_units[k] for k in mass.known}
    return Definiteness(
        workspace=workspace,
        smallest=float(found[best]),
        se=None if estimate is None else _standard_error(estimate, at, direction),
        at=at,
        direction=direction,
        share=float(np.mean(values <= 0)),
        poses=poses.shape[1],
        unit="in mixed units" if len(units) > 1 else "kg" if units == {"m"} else "kg m^2",
    )


@dataclass(frozen=True, eq=False)
class _MassEigenvalue:
    """The smallest eigenvalue of M as a function of the pose."""

    workspace: Workspace
    beta: Array

    @property
    def known(self) -> list[int]:
        """Coordinates with measured torque: the others' own entries of M are not identifiable."""
        return list(self.workspace.model.measured_rows)

    def matrices(self, qa: Array) -> Array:
        return mass_matrix(self.workspace.model, self.beta, qa)[:, self.known][:, :, self.known]

    def lowest(self, qa: Array) -> tuple[Array, Array]:
        """Smallest eigenvalues (samples,) and their vectors (samples, known)."""
        values, vectors = np.linalg.eigh(self.matrices(qa))
        return values[:, 0], vectors[:, :, 0]

    def descend(self, start: Array) -> Array:
        """The pose of the local minimum from a start, (active,)."""
        limits = self.workspace.limits
        width = limits[:, 1] - limits[:, 0]
        scale = float(np.abs(self.lowest(start[:, None])[0][0])) or 1.0

        def pose(x: Array) -> Array:
            return np.asarray((limits[:, 0] + width * x)[:, None])

        step = 1e-6 * np.eye(len(width))

        def slope(x: Array) -> Array:
            """v' dM v: the derivative of a simple eigenvalue."""
            _, v = self.lowest(pose(x))
            around = np.column_stack([pose(x + side * e) for side in (1, -1) for e in step])
            quadratic = np.einsum("i,sij,j->s", v[0], self.matrices(around), v[0])
            ahead, behind = np.split(quadratic, 2)
            return np.asarray((ahead - behind) / 2e-6 / scale)

        from scipy import optimize  # slow to import, and few commands search the workspace

        found = optimize.minimize(
            lambda x: float(self.lowest(pose(x))[0][0]) / scale,
            (start - limits[:, 0]) / width,
            jac=slope,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(width),
            constraints={"type": "ineq", "fun": lambda x: self.workspace.slack(pose(x))[:, 0] - _AT_LIMIT / 2},
            options={"maxiter": 200, "ftol": 1e-12},
        )
        return np.asarray(pose(np.clip(found.x, 0.0, 1.0))[:, 0])


def _lowest_apart(poses: Array, values: Array, limits: Array) -> list[int]:
    """Indices of the lowest poses that are far from each other, the lowest first."""
    place = (poses - limits[:, :1]) / (limits[:, 1:] - limits[:, :1])
    left, chosen = values.copy(), list[int]()
    while len(chosen) < _STARTS and np.isfinite(left[lowest := int(np.argmin(left))]):
        chosen.append(lowest)
        near = np.arange(len(values))
        for coordinate in place:
            near = near[np.abs(coordinate[near] - coordinate[lowest]) <= APART]
        left[near] = np.inf
    return chosen


def _standard_error(estimate: Estimate, at: Array, direction: Array) -> float:
    """Of the eigenvalue, to first order: its gradient is that of v' M v, which is linear in the parameters."""
    if estimate.single_block:
        return float("inf")
    model, p = estimate.model, len(estimate.beta)
    slope = [direction @ mass_matrix(model, unit, at[:, None])[0] @ direction for unit in np.eye(p)]
    return float(np.sqrt(slope @ estimate.covariance @ slope))
