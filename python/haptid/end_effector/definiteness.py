"""Whether the mass matrix is positive definite all over a workspace, and where and how it fails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from haptid._internal.arrays import Array, expect, read_only
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.workspace import Workspace
from haptid.errors import DifferentModelError
from haptid.estimation import Estimate
from haptid.estimation.feasibility.feasible import checked

# The smallest eigenvalue is refined from so many of the grid's lowest poses.
STARTS = 20
# Those poses are this far from each other in some joint, as a share of its range.
APART = 0.2
# A pose counts as inside where it is out by less than this, rad or m: the optimiser ends on limits.
AT_LIMIT = 1e-6
# One coordinate makes up the failing direction alone where its component is at least this.
ALONE = 0.99


@dataclass(frozen=True, eq=False)
class Definiteness:
    """The smallest eigenvalue of the mass matrix over a workspace.

    The sign of an eigenvalue does not depend on units. Its size does where some coordinates turn and others slide.

    Attributes:
        workspace: the poses.
        smallest: eigenvalue, kg m^2, kg, or in mixed units.
        se: its deviation from the estimate's covariance; None for parameters without one.
        at: the pose, (active,), rad or m.
        direction: its eigenvector over the coordinates that torque rows belong to, (active,).
        share: of the workspace's poses, those at which M is not positive definite, 0 to 1.
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
        for name in ("at", "direction"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, (len(self.workspace.model.device.active),))

    @property
    def positive(self) -> bool:
        """Whether M is positive definite at every pose that was looked at."""
        return self.smallest > 0

    def summary(self) -> str:
        """What was found, in sentences."""
        model = self.workspace.model
        joints = [model.device.joints[j] for j in model.device.active]
        pose = ", ".join(
            f"{joint.name} {x:.4g} m" if joint.prismatic else f"{joint.name} {np.degrees(x):.4g} deg"
            for joint, x in zip(joints, self.at, strict=True)
        )
        se = "" if self.se is None else f" (standard deviation {self.se:.2g})"
        least = f"smallest eigenvalue {self.smallest:.4g} {self.unit}{se} at {pose}"
        if self.positive:
            shown = f"{self.poses} poses of the workspace, and descents from the lowest of them, show"
            text = f"The mass matrix is positive definite as far as {shown}: {least}."
        else:
            text = (
                f"The mass matrix is not positive definite in {100 * self.share:.3g} % of the workspace: {least}. "
                f"The direction that fails is {self._failing()}."
            )
        return " ".join([text, *self._caveats()])

    def _failing(self) -> str:
        labels = self.workspace.model.device.row_labels
        worst = int(np.argmax(np.abs(self.direction)))
        if abs(self.direction[worst]) >= ALONE:
            return labels[worst]
        parts = zip(self.direction, labels, strict=True)
        return " ".join(f"{x:+.2g} {label}" for x, label in parts if abs(x) > 1 - ALONE)

    def _caveats(self) -> list[str]:
        model, made = self.workspace.model, []
        if len(set(model.device.coordinate_units)) > 1:
            made.append("Some coordinates turn, others slide: the eigenvalue's sign has a meaning, its size has not.")
        blind = [
            label for label, known in zip(model.device.row_labels, model.device.measured, strict=True) if not known
        ]
        if blind:
            made.append(f"Torque is not measured on {', '.join(blind)}: the matrix is of the other coordinates.")
        return made


def definiteness(identified: Estimate | ArrayLike, workspace: Workspace) -> Definiteness:
    """The smallest eigenvalue of M over a workspace: on a grid, then refined from the grid's lowest poses.

    Args:
        identified: an estimate, or base parameters in SI of the workspace's device, (p,).
        workspace: the poses.

    Raises:
        DifferentModelError: the estimate is of another device.
        EmptyWorkspaceError: no pose is inside the workspace.
        ShapeError: the parameters do not fit the device.
        ParameterValueError: one of them is not a finite number.
    """
    model = workspace.model
    estimate = identified if isinstance(identified, Estimate) else None
    if estimate is not None and not estimate.model.is_same_as(model):
        raise DifferentModelError(estimate.model.device.name, model.device.name)
    form = _Form(workspace, identified.beta if isinstance(identified, Estimate) else checked(model, identified))
    poses = workspace.grid()
    values, _ = form.lowest(poses)
    starts = poses[:, _lowest_apart(poses, values, workspace.limits)]
    ends = np.column_stack([starts, *(form.descend(start) for start in starts.T)])
    ends = ends[:, (workspace.slack(ends) >= -AT_LIMIT).all(axis=0)]
    found, vectors = form.lowest(ends)
    best = int(np.argmin(found))
    at, direction = ends[:, best], np.zeros(len(model.device.active))
    direction[form.known] = vectors[best]
    units = {unit for unit, known in zip(model.device.coordinate_units, model.device.measured, strict=True) if known}
    return Definiteness(
        workspace=workspace,
        smallest=float(found[best]),
        se=None if estimate is None else _deviation(estimate, at, direction),
        at=at,
        direction=direction,
        share=float(np.mean(values <= 0)),
        poses=poses.shape[1],
        unit="in mixed units" if len(units) > 1 else "kg" if units == {"m"} else "kg m^2",
    )


@dataclass(frozen=True, eq=False)
class _Form:
    """The smallest eigenvalue of M as a function of the pose."""

    workspace: Workspace
    beta: Array

    @property
    def known(self) -> list[int]:
        """Coordinates whose torque is measured: the others' own entries of M are not identified."""
        return [k for k, measured in enumerate(self.workspace.model.device.measured) if measured]

    def matrices(self, qa: Array) -> Array:
        return mass_matrix(self.workspace.model, self.beta, qa)[:, self.known][:, :, self.known]

    def lowest(self, qa: Array) -> tuple[Array, Array]:
        """Smallest eigenvalues (samples,) and their vectors (samples, known)."""
        values, vectors = np.linalg.eigh(self.matrices(qa))
        return values[:, 0], vectors[:, :, 0]

    def descend(self, start: Array) -> Array:
        """The pose of the local minimum, (active,)."""
        limits = self.workspace.limits
        width = limits[:, 1] - limits[:, 0]
        scale = float(np.abs(self.lowest(start[:, None])[0][0])) or 1.0

        def pose(x: Array) -> Array:
            return np.asarray((limits[:, 0] + width * x)[:, None])

        step = 1e-6 * np.eye(len(width))

        def slope(x: Array) -> Array:
            """v' dM v: the derivative of a single eigenvalue."""
            _, v = self.lowest(pose(x))
            around = np.column_stack([pose(x + side * e) for side in (1, -1) for e in step])
            quadratic = np.einsum("i,sij,j->s", v[0], self.matrices(around), v[0])
            ahead, behind = np.split(quadratic, 2)
            return np.asarray((ahead - behind) / 2e-6 / scale)

        found = optimize.minimize(
            lambda x: float(self.lowest(pose(x))[0][0]) / scale,
            (start - limits[:, 0]) / width,
            jac=slope,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(width),
            constraints={"type": "ineq", "fun": lambda x: self.workspace.slack(pose(x))[:, 0] - AT_LIMIT / 2},
            options={"maxiter": 200, "ftol": 1e-12},
        )
        return np.asarray(pose(np.clip(found.x, 0.0, 1.0))[:, 0])


def _lowest_apart(poses: Array, values: Array, limits: Array) -> list[int]:
    """The lowest pose, then the lowest of those far from it, and so on."""
    place = (poses - limits[:, :1]) / (limits[:, 1:] - limits[:, :1])
    left, chosen = np.arange(len(values)), list[int]()
    while len(left) and len(chosen) < STARTS:
        lowest = int(left[np.argmin(values[left])])
        chosen.append(lowest)
        left = left[np.abs(place[:, left] - place[:, [lowest]]).max(axis=0) > APART]
    return chosen


def _deviation(estimate: Estimate, at: Array, direction: Array) -> float:
    """Of the eigenvalue: v' M v is linear in the parameters, and the eigenvalue's slope is that of v' M v."""
    if estimate.single_block:
        return float("inf")
    model, p = estimate.model, len(estimate.beta)
    slope = [direction @ mass_matrix(model, unit, at[:, None])[0] @ direction for unit in np.eye(p)]
    return float(np.sqrt(slope @ estimate.covariance @ slope))
