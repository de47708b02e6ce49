"""The direct dynamic model: accelerations from torques, for many states and several sets of parameters at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.inverse import core_mass, core_torque
from haptid.dynamics.load_friction import Carried, carried, pressed
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import CoreChannels, check_columns, external
from haptid.errors import MasslessError

# Of the mass matrix, least eigenvalue over the largest of its scaled form that can still be inverted.
INVERTIBLE = 1e-12
# Smooth dry friction has all but turned over at so many widths from standstill: 1 - tanh is 1e-5 there.
TURNED = 6.0
# Passes in which the signs of what joints carry are found: two or three where friction takes less than all of it.
PASSES = 8


@dataclass(frozen=True, eq=False)
class ForwardDynamics:
    """M(c) cdd = tau - h(c, cd), friction, springs and a user's own columns in h.

    The core makes M from composite bodies and h by the inverse model without acceleration, and solves, for all states
    and sets in one call, trees and loops alike (Walker and Orin 1982, J. Dyn. Sys. Meas. Control 104, method 3).
    Friction by load depends on cdd, too: it is in h as it is without acceleration, and what it changes is found with
    cdd.

    Attributes:
        model: the dynamic model, its dry friction smooth: see `smooth`.
        chi: sets of parameters of the core's columns, (sets, r), SI.

    Raises:
        AccelerationColumnError: a user's own column is made of accelerations.
    """

    model: DynamicModel
    chi: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "chi", read_only(np.atleast_2d(self.chi)))
        expect("chi", self.chi.shape, (None, self.model.mechanism.columns))
        check_columns(self.model)

    def parts(self, c: Array, cd: Array) -> tuple[Array, Array]:
        """M, (states, n, n), and h, (states, n); states are those of the first set, then of the second, ...

        Args:
            c, cd: positions and velocities of the coordinates that torque rows belong to, (n, states).
        """
        return self.mass(c), self.inverse(c, cd, np.zeros_like(c)).T

    def mass(self, c: Array) -> Array:
        """M, (states, n, n), at positions (n, states); sets as in `parts`."""
        return core_mass(self.model, self.chi, c)

    def inverse(self, c: Array, cd: Array, cdd: Array) -> Array:
        """Torque of every row, (n, states), from the coordinates' motion, each (n, states); sets as in `parts`."""
        return core_torque(self.model, self.chi, c, cd, cdd, external(self.model, c, cd, cdd))

    def acceleration(self, c: Array, cd: Array, tau: Array) -> Array:
        """cdd, (n, states), rad/s^2 or m/s^2.

        Args:
            c, cd: as in `parts`.
            tau: torque of every row, (n, states), N m or N.

        Raises:
            MasslessError: a mass matrix is not positive definite.
        """
        c, cd, tau = np.ascontiguousarray(c), np.ascontiguousarray(cd), np.ascontiguousarray(tau)
        own, loops = external(self.model, c, cd, np.zeros_like(c)), self.model.loops(c, cd)
        cdd, failed = self.model.mechanism.acceleration(c, cd, tau, own, self.chi, loops)
        if failed is not None:
            of = failed * len(self.chi) // c.shape[1]
            raise self.massless(core_mass(self.model, self.chi[of], c[:, [failed]]))
        loads = self._loads(c, cd)
        return self._loaded(loads, self.mass(c), cdd.T) if loads else np.asarray(cdd)

    def _loaded(self, loads: list[Carried], M: Array, cdd: Array) -> Array:
        """cdd with friction by load, (n, states), from that with its size as without acceleration, (states, n).

        For given signs of the bodies' torques friction by load is linear in cdd: few passes find the signs.
        """
        force = (M @ cdd[:, :, None])[:, :, 0]
        for _ in range(PASSES):
            more, rest = pressed(loads, cdd)
            before, cdd = cdd, self._solved(M + more, force - rest)
            if not any((one.sign(before) != one.sign(cdd)).any() for one in loads):
                break
        return np.ascontiguousarray(cdd.T)

    def inertia(self, c: Array, cd: Array, cdd: Array) -> Array:
        """Derivative of the inverse model by accelerations, (states, n, n): M, and what friction by load adds to it.

        Args:
            c, cd, cdd: of the coordinates, (n, states).
        """
        M, loads = self.mass(c), self._loads(c, cd)
        return M + pressed(loads, cdd.T)[0] if loads else M

    def _loads(self, c: Array, cd: Array) -> list[Carried]:
        """Friction by load of all sets."""
        if not self.model.has_loads:
            return []
        return carried(self.model, np.repeat(self.chi, c.shape[1] // len(self.chi), axis=0), c, cd)

    def _solved(self, M: Array, force: Array) -> Array:
        """M^-1 force, (states, n).

        Raises:
            MasslessError: a mass matrix cannot be inverted.
        """
        try:
            return np.asarray(np.linalg.solve(M, force[:, :, None])[:, :, 0])
        except np.linalg.LinAlgError:
            raise self.massless(M) from None

    def massless(self, M: Array) -> MasslessError:
        """What to raise of mass matrices that cannot all be inverted."""
        values, vectors = np.linalg.eigh(M)
        ratio = values[:, 0] / np.maximum(values[:, -1], np.finfo(float).tiny)
        worst = int(np.argmin(ratio))
        row = int(np.argmax(np.abs(vectors[worst, :, 0])))
        return MasslessError(self.model.device.row_labels[row], float(ratio[worst]), INVERTIBLE)

    def check(self, c: Array) -> None:
        """Raise MasslessError unless the mass matrix is positive definite at these positions, (n, states)."""
        M = self.mass(np.tile(c, len(self.chi)))
        if not (np.linalg.eigvalsh(M)[:, 0] > INVERTIBLE * np.abs(M).max(axis=(1, 2))).all():
            raise self.massless(M)

    def slopes(self, c: Array, cd: Array, cdd: Array) -> tuple[Array, Array]:
        """Derivatives of the first set's inverse model by position and by velocity, each (states, n, n).

        Column k is the derivative by coordinate k.
        """
        made = CoreChannels.of(self.model, np.array([c, cd, cdd])).torque_slopes(self.chi[0])
        by_c, by_cd, _ = np.moveaxis(made, (1, 3), (0, 1))
        return by_c, by_cd

    def stiffness(self, c: Array) -> float:
        """Greatest rate at which friction brakes a coordinate at rest, 1/s, over positions (n, states).

        Of the first set: the largest eigenvalue of M^-1 dh/dcd, where smooth dry friction is steepest.
        """
        still = np.zeros_like(c)
        M = core_mass(self.model, self.chi[0], c)
        _, damping = self.slopes(c, still, still)
        try:
            return float(np.abs(np.linalg.eigvals(np.linalg.solve(M, damping))).max(initial=0.0))
        except np.linalg.LinAlgError:
            raise self.massless(M) from None

    def without_dry(self) -> ForwardDynamics:
        """The same model without dry friction."""
        chi, first = np.array(self.chi), 10 * len(self.model.device.joints)
        chi[:, [first + k for k, term in enumerate(self.model.terms) if term.dry]] = 0.0
        return ForwardDynamics(self.model, chi)

    def turning(self, c: Array, cd: Array, cdd: Array, period: float) -> np.ndarray:
        """Of which stretches dry friction may turn over within a period, in one of the sets, (states,).

        Args:
            c, cd, cdd: of the coordinates, (n, states).
            period: s.
        """
        found = turning(self.model, c, cd, cdd, period)
        return np.tile(found.reshape(len(self.chi), -1).any(axis=0), len(self.chi))


def turning(model: DynamicModel, c: Array, cd: Array, cdd: Array, period: float) -> np.ndarray:
    """Where dry friction may turn over within a period, s, from positions and rates (n, states): (states,)."""
    dry = [term for term in model.terms if term.dry]
    if not dry:
        return np.zeros(c.shape[1], dtype=bool)
    shares = np.array([np.broadcast_to(model.shares(term, c, cd), c.shape) for term in dry])
    speed, change = (np.abs((shares * x).sum(axis=1)) for x in (cd, cdd))
    widths = np.array([[term.constant("width")] for term in dry])
    return np.asarray((speed < TURNED * widths + period * change).any(axis=0))


def sets_of(model: DynamicModel, beta: Array) -> Array:
    """Parameters of the core's columns, (sets, r), from sets of base parameters, (sets, p)."""
    S = model.device.parameters.S[:, list(model.base.independent_columns)]
    return freeze(np.atleast_2d(beta) @ S.T)
