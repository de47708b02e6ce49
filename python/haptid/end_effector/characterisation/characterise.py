"""`characterise(model, poses)`: mass, friction, weight and forces at the handle, pose by pose, with standard errors.

Source: Janot et al. (2007), section V, eqs (18) and (19): F = M xdd + B xd + K x + F_c sign + F_d.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import inverse_dynamics, mass_matrix
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Workspace
from haptid.end_effector.characterisation import force_capability, friction, velocity_forces
from haptid.end_effector.characterisation.apparent_mass import ApparentMass, apparent_mass
from haptid.end_effector.characterisation.jacobian import LINEAR, HandleJacobian, handle_jacobian
from haptid.end_effector.characterisation.model import IdentifiedModel, changing, linear
from haptid.end_effector.characterisation.summary import summary
from haptid.end_effector.force import WORST_CONDITION
from haptid.errors import setting_error
from haptid.uncertainty.quantities import Field

# Default number of cells of a workspace's grid.
POSES = 8000


@displayed
@dataclass(frozen=True, eq=False)
class Characterisation:
    """The dynamics at the handle at some poses; see `characterise`.

    Values over poses are NaN at poses that are left out: `handle.usable` marks them, `summary` counts them.

    Attributes:
        identified: the parameters.
        handle: the poses, the handle's position and Jacobian at each.
        masses: principal apparent masses.
    """

    identified: IdentifiedModel
    handle: HandleJacobian
    masses: ApparentMass

    @property
    def model(self) -> DynamicModel:
        """The dynamic model."""
        return self.identified.model

    @cached_property
    def inverse(self) -> Array:
        """Rates of the coordinates from the handle's velocity, (poses, n, m)."""
        return self.handle.inverse("friction, weight or stiffness at the handle")

    @property
    def apparent_mass(self) -> Field:
        """Principal masses, largest first, (poses, r), kg."""
        return self.masses.mass

    @property
    def isotropy(self) -> Field:
        """Smallest over largest principal mass, (poses,)."""
        return self.masses.isotropy

    def mass_along(self, direction: ArrayLike) -> Field:
        """d' J^-T A J^-1 d: force along d per acceleration along d with none across, (poses,), kg."""
        rates = self._rates(self._unit(direction))
        inner = list(self.handle.moving)

        def of(beta: Array) -> Array:
            A = mass_matrix(self.model, beta, self.handle.qa)[:, inner][:, :, inner]
            return np.asarray(np.einsum("pa,pab,pb->p", rates, A, rates))

        return linear(self.identified, of, "kg")

    @cached_property
    def viscous_friction(self) -> Field:
        """Principal values of J^-T Fv J^-1, largest first, (poses, m), N s/m."""
        D = self._viscous(self.identified.beta)
        values, vectors = np.linalg.eigh(np.nan_to_num(D))
        values, vectors = values[:, ::-1], vectors[:, :, ::-1]

        def slope(change: Array) -> Array:
            return np.asarray(np.einsum("pie,pij,pje->pe", vectors, self._viscous(change), vectors))

        values = np.where(self.handle.usable[:, None], values, np.nan)
        return changing(self.identified, values, slope, "N s/m")

    def viscous_along(self, direction: ArrayLike) -> Field:
        """d' J^-T Fv J^-1 d, (poses,), N s/m."""
        d = self._unit(direction)
        return linear(self.identified, lambda beta: np.einsum("i,pij,j->p", d, self._viscous(beta), d), "N s/m")

    def coulomb_friction(self, direction: ArrayLike) -> Field:
        """Coulomb friction force at the handle for slow motion along d: J^-T Fc sign(J^-1 d), (poses, m), N.

        Its component along d is the force lost to dry friction; `backdrive_force` adds the weight.
        """
        rates = self.handle.all_rates(self._rates(self._unit(direction)))
        qa = self.handle.qa
        return linear(
            self.identified, lambda beta: self._at_handle(friction.dry_torque(self.model, beta, qa, rates)), "N"
        )

    @cached_property
    def coulomb_by_axis(self) -> Field:
        """J^-T Fc as printed in eq. (18), (poses, m), N: correct where signs of handle and joint rates agree."""

        def of(beta: Array) -> Array:
            return self._at_handle(friction.coulomb_level(self.model, beta, self.handle.qa))

        return linear(self.identified, of, "N")

    @cached_property
    def weight(self) -> Field:
        """Force of the hand that supports the device, without friction, (poses, m), N."""
        return linear(self.identified, lambda beta: self._at_handle(self._static(beta)), "N")

    def backdrive_force(self, direction: ArrayLike) -> Field:
        """Back-drive force along d: moves the device slowly that way, motors off; friction and weight, (poses,), N."""
        d = self._unit(direction)
        rates = self.handle.all_rates(self._rates(d))

        def of(beta: Array) -> Array:
            dry = friction.dry_torque(self.model, beta, self.handle.qa, rates)
            return np.asarray(self._at_handle(self._static(beta) + dry) @ d)

        return linear(self.identified, of, "N")

    def neglected_force(self, speed: float) -> Field:
        """Largest |F_d| over directions of motion at a handle speed, (poses,), N; see `neglected_force_of`.

        F_d is weight plus a quadratic form of velocity, so it is bounded by its value at the largest speed of a range.
        """
        worst = speed * velocity_forces.worst_directions(self.handle, self.inverse, self.identified.beta, speed)
        force = velocity_forces.neglected_force(self.handle, self.inverse, self.identified.beta, worst)
        size = np.linalg.norm(force, axis=1)
        along = force / np.where(size > 0, size, 1.0)[:, None]

        def slope(change: Array) -> Array:
            force = velocity_forces.neglected_force(self.handle, self.inverse, change, worst)
            return np.asarray(np.einsum("pm,pm->p", along, force))

        return changing(self.identified, size, slope, "N")

    def neglected_force_of(self, velocity: ArrayLike) -> Field:
        """F_d for a velocity of the handle, (m,) or (poses, m), m/s: the force neglected in eq. (18), (poses, m), N."""
        v = np.broadcast_to(np.asarray(velocity, dtype=float), (len(self.handle), len(self.handle.rows)))
        return linear(self.identified, lambda b: velocity_forces.neglected_force(self.handle, self.inverse, b, v), "N")

    def stiffness(self, joint_stiffness: ArrayLike) -> tuple[Array, Array]:
        """Principal values of J^-T K J^-1, largest first, (poses, r), N/m, and their directions, (poses, r, m).

        Args:
            joint_stiffness: K_tot of the coordinates that torque rows belong to, (active, active) or its diagonal.
        """
        K = np.asarray(joint_stiffness, dtype=float)
        K = np.diag(K) if K.ndim == 1 else K
        expect("joint_stiffness", K.shape, (len(self.model.device.active),) * 2)
        inner = list(self.handle.moving)
        values, vectors = np.linalg.eigh(np.nan_to_num(self.inverse.mT @ K[inner][:, inner] @ self.inverse))
        values = np.where(self.handle.usable[:, None], values[:, ::-1], np.nan)
        return freeze(values), freeze(np.ascontiguousarray(vectors[:, :, ::-1].mT))

    def greatest_force(self, limits: Mapping[str, float] | None = None) -> tuple[Field, Array]:
        """Force capability: the force that motors can exert in every direction while they carry the weight.

        Peak force for peak torques, continuous force for continuous ones. Redundant motors share it as is best.

        Args:
            limits: torque of each motor's coordinate by name, N m or N; else those of the device's joints.

        Returns:
            The force in the worst direction, (poses,), N, and that direction, (poses, m).

        Raises:
            IncompleteDeviceError: a motor without a limit.
        """
        bounds = force_capability.torque_bounds(self.handle, limits)
        held = bounds.of(self._static(self.identified.beta))
        force, direction, which = force_capability.least_force(bounds, held)
        at = np.arange(len(force))
        sign, length = np.sign(held[at, which]), np.linalg.norm(bounds.jacobian[at, :, which], axis=1)

        def slope(change: Array) -> Array:
            return np.asarray(-sign * bounds.of(self._static(change))[at, which] / length)

        return changing(self.identified, force, slope, "N"), freeze(direction)

    def force_along(self, direction: ArrayLike, limits: Mapping[str, float] | None = None) -> Field:
        """Largest force of the motors on the hand along d, (poses,), N; arguments as for `greatest_force`."""
        bounds = force_capability.torque_bounds(self.handle, limits)
        held = bounds.of(self._static(self.identified.beta))
        force, load, which = force_capability.force_along(bounds, held, self._unit(direction))
        at = np.arange(len(force))
        # Where no motor is loaded by d, or one has no torque left, the derivative by the weight is zero.
        bound = np.isfinite(force) & (force > 0)
        slopes = np.where(bound, -1 / np.where(bound, load, 1.0), 0.0)

        def slope(change: Array) -> Array:
            return np.asarray(slopes * bounds.of(self._static(change))[at, which])

        return changing(self.identified, force, slope, "N")

    def summary(self) -> str:
        """Median and range of the quantities, and the poses left out, as text."""
        return summary(self)

    def _unit(self, direction: ArrayLike) -> Array:
        d = np.asarray(direction, dtype=float)
        expect("direction", d.shape, (len(self.handle.rows),))
        length = np.linalg.norm(d)
        if not (np.isfinite(length) and length > 0):
            raise setting_error("direction", direction, "finite components, not all zero")
        return np.asarray(d / length)

    def _rates(self, direction: Array) -> Array:
        """Rates of the moving coordinates for unit speed along a direction, (poses, n)."""
        return np.asarray(self.inverse @ direction)

    def _viscous(self, beta: Array) -> Array:
        inner = list(self.handle.moving)
        D = friction.viscous_matrix(self.model, beta, self.handle.qa)[:, inner][:, :, inner]
        return np.asarray(self.inverse.mT @ D @ self.inverse)

    def _at_handle(self, torque: Array) -> Array:
        return friction.force_at_handle(self.handle, self.inverse, torque)

    def _static(self, beta: Array) -> Array:
        """Static torque, (active, poses): gravity, springs, offsets."""
        still = np.zeros_like(self.handle.qa)
        return inverse_dynamics(self.model, beta, self.handle.qa, still, still)

    def _shown(self) -> Overview:
        return Overview.of_text(self.summary())


def characterise(
    identified: IdentifiedModel,
    poses: Workspace | ArrayLike,
    rows: tuple[int, ...] = LINEAR,
    worst_condition: float = WORST_CONDITION,
) -> Characterisation:
    """Characterise the dynamics at the handle, at poses or over a workspace.

    Args:
        identified: an estimate, whose covariance gives standard errors, or given parameters.
        poses: positions of the active joints, (active, poses), rad or m, or a workspace, of which a grid is taken.
        rows: components of the handle's velocity in the base frame, 0 to 2 linear, 3 to 5 angular.
        worst_condition: of the handle's Jacobian, beyond which a pose is left out.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range.
        ModelMismatchError: the workspace is of another device.
        WorkspaceError: no pose is inside the workspace.
        ShapeError: the poses do not fit the device.
    """
    if isinstance(poses, Workspace):
        poses.model.require_same(identified.model)
        poses = poses.grid(POSES)
    qa = np.asarray(poses, dtype=float)
    handle = handle_jacobian(identified.model, qa, rows, worst_condition)
    return Characterisation(identified, handle, apparent_mass(identified, qa, rows, worst_condition))


def sweep(start: ArrayLike, joint: int, values: ArrayLike) -> Array:
    """Poses in which one active joint takes values and the others are constant, (active, poses), rad or m.

    Args:
        start: a pose, (active,).
        joint: index among the active joints.
        values: of it, (poses,).
    """
    values = np.asarray(values, dtype=float)
    made = np.repeat(np.asarray(start, dtype=float)[:, None], len(values), axis=1)
    made[joint] = values
    return freeze(made)


def line(start: ArrayLike, end: ArrayLike, poses: int) -> Array:
    """Poses on a straight line in joint space, ends included, (active, poses), rad or m."""
    return freeze(np.linspace(np.asarray(start, dtype=float), np.asarray(end, dtype=float), poses, axis=1))
