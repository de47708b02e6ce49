"""Apparent mass (Khatib's effective mass): principal values of the mass matrix at the handle."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from haptid import _core
from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import mass_matrix, raw_parameters
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.end_effector.characterisation.jacobian import LINEAR, check_pose_settings
from haptid.end_effector.characterisation.model import IdentifiedModel, covariance_factor, dof, trusted
from haptid.end_effector.force import WORST_CONDITION
from haptid.uncertainty.quantities import Field

# Number of poses over which the least degrees of freedom are taken.
DOF_POSES = 6
# Poses computed together: rates of loops that are not linear take a kilobyte and more for each.
_TOGETHER = 50_000
# Parts of that many poses at a time, at most: each takes a tenth of a gigabyte.
_AT_ONCE = 4


@dataclass(frozen=True, eq=False)
class ApparentMass:
    """Principal apparent masses at many poses, with all coordinates free to move: M = (J A^-1 J')^-1.

    With as many coordinates as rows that is J^-T A J^-1 (Janot et al. 2007, section V); with more it is the mass that a
    force without moment accelerates (Khatib 1987, eq. 51); with fewer it is of the motion that the handle can have.

    Attributes:
        mass: principal values, largest first, (poses, r), kg, or kg m^2 for angular rows.
        directions: of each, unit vectors over the rows, their largest component positive, (poses, r, m).
        isotropy: smallest over largest principal value, (poses,).
        condition: number of the handle's Jacobian, (poses,).
        worst: condition number beyond which a pose is left out.
    """

    mass: Field
    directions: Array
    isotropy: Field
    condition: Array
    worst: float

    def __post_init__(self) -> None:
        freeze_fields(self, "directions", condition=self.mass.values.shape[:1])

    @property
    def usable(self) -> np.ndarray:
        """Whether the Jacobian of each pose is invertible within the limit, (poses,)."""
        return np.asarray(self.condition <= self.worst)

    @property
    def definite(self) -> np.ndarray:
        """Whether the mass matrix of each usable pose is positive definite, (poses,)."""
        return np.asarray(self.usable & np.isfinite(self.mass.values[:, 0]))


def apparent_mass(
    identified: IdentifiedModel, qa: ArrayLike, rows: tuple[int, ...] = LINEAR, worst_condition: float = WORST_CONDITION
) -> ApparentMass:
    """Principal apparent masses with first-order standard errors.

    The order of masses that are nearly equal may change within their standard errors.

    Args:
        identified: an estimate, or given parameters.
        qa: positions of the active joints, (active, poses), rad or m.
        rows: of the handle's velocity in the base frame: 0 to 2 linear, 3 to 5 angular.
        worst_condition: of the Jacobian, beyond which a pose is left out.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range.
        ShapeError: the poses do not fit the device.
    """
    model, qa = identified.model, np.asarray(qa, dtype=float)
    check_pose_settings(model, qa, rows, worst_condition)
    moving, columns = model.measured_rows, covariance_factor(identified)
    spread = np.zeros((len(model.device.parameters.S), 0)) if columns is None else core_spread(identified, columns)
    settings: dict[str, Any] = {"rows": rows, "moving": moving, "worst": worst_condition, "spread": spread}
    parts = [qa[:, k : k + _TOGETHER] for k in range(0, max(qa.shape[1], 1), _TOGETHER)]

    def of(part: Array) -> tuple[Array, ...]:
        return _core.apparent_mass(*core_arguments(identified, part), **settings)

    condition, mass, directions, C = (
        of(qa) if len(parts) == 1 else (np.concatenate(part) for part in zip(*_together(of, parts), strict=True))
    )
    r = mass.shape[1]
    mass_se, isotropy_se, dof = None, None, float("inf")
    if columns is not None:
        variances = [0, *np.cumsum(np.arange(r, 1, -1))]
        mass_se = trusted(identified, np.sqrt(C[:, variances]))
        isotropy_se = trusted(identified, _isotropy_se(mass, C[:, 0], C[:, -1], C[:, r - 1]))
        dof = _least_dof(identified, qa, rows, moving, mass, directions)
    unit = "kg" if max(rows) < 3 else "kg m^2" if min(rows) > 2 else "in mixed units"
    return ApparentMass(
        mass=Field(freeze(mass), mass_se, dof, unit),
        directions=freeze(directions),
        isotropy=Field(freeze(mass[:, -1] / mass[:, 0]), isotropy_se, dof, "1"),
        condition=freeze(condition),
        worst=worst_condition,
    )


def _together(of: Callable[[Array], tuple[Array, ...]], parts: list[Array]) -> list[tuple[Array, ...]]:
    """A function of each part, by threads: the core has its own, but one follows a loop that is not linear."""
    most = int(os.environ.get("RAYON_NUM_THREADS") or 0) or os.cpu_count() or 1  # zero is the core's default
    workers = min(len(parts), _AT_ONCE, most)
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(of, parts))


def core_arguments(
    identified: IdentifiedModel, qa: Array
) -> tuple[_core.Mechanism, Array, Array | None, int, list[float], Array]:
    """The core's arguments for a model at these poses: mechanism, coordinates, loops, handle, parameters."""
    model, handle, to_rows = identified.model, handle_of(identified.model), identified.model.device.row_map
    varying = model.device.varying.any()
    loops = model.given(model.device.closure.follow(qa).by(to_rows)) if varying else None
    chi = raw_parameters(model, identified.beta)
    return model.mechanism, np.ascontiguousarray(to_rows @ qa), loops, handle.link, handle.translation.tolist(), chi


def core_spread(identified: IdentifiedModel, columns: Array) -> Array:
    """Columns over base parameters, (p, s), as columns over the core's, (r, s)."""
    model = identified.model
    return np.ascontiguousarray(model.device.parameters.S[:, list(model.base.independent_columns)] @ columns)


def _isotropy_se(mass: Array, largest: Array, smallest: Array, both: Array) -> Array:
    """Standard error of smallest over largest, from the variances of each and their covariance, (poses,)."""
    ratio = mass[:, -1] / mass[:, 0]
    return np.asarray(np.sqrt(np.maximum(smallest + ratio**2 * largest - 2 * ratio * both, 0.0)) / mass[:, 0])


def _least_dof(
    identified: IdentifiedModel,
    qa: Array,
    rows: tuple[int, ...],
    moving: tuple[int, ...],
    mass: Array,
    directions: Array,
) -> float:
    """Least degrees of freedom of the masses at some poses."""
    known = np.flatnonzero(np.isfinite(mass[:, 0]))
    few = known[np.linspace(0, len(known) - 1, min(len(known), DOF_POSES)).astype(int)] if len(known) else known
    inner = list(moving)

    def matrices(beta: Array) -> Array:
        return mass_matrix(identified.model, beta, qa[:, few])[:, inner][:, :, inner]

    J = handle_motion(identified.model, qa[:, few]).row_jacobian[:, list(rows)][:, :, inner]
    rates = np.linalg.solve(matrices(identified.beta), J.mT @ directions[few].mT) * mass[few][:, None]
    units = np.eye(len(identified.beta))
    gradients = np.array([np.einsum("pae,pab,pbe->pe", rates, matrices(u), rates).ravel() for u in units])
    return dof(identified, gradients.T)
