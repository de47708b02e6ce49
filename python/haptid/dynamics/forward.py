"""Forward dynamics: accelerations from torques, for many states and several parameter sets at once.

Load-dependent friction depends on the accelerations that it changes: the torque of the bodies on a coordinate is
M cdd + h, and friction is its magnitude times a factor, so linear in cdd for a given sign of that torque.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid._internal.late import dataclass
from haptid.device.terms.friction import LoadDependentFriction
from haptid.dynamics.inverse import core_mass, core_torque
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import CoreChannels, check_columns, check_linear, external, regressor_columns
from haptid.errors import SimulationError


@dataclass(frozen=True, eq=False)
class JointLoad:
    """Load of one coordinate at some states, and the friction proportional to it.

    Attributes:
        weights: how the friction acts on the coordinates, (n,).
        friction: per unit of the load's magnitude, with the velocity's sign, (states,).
        inertia: row of the bodies' mass matrix, (states, n).
        bias: torque of the bodies without acceleration, (states,), N m or N.
    """

    weights: Array
    friction: Array
    inertia: Array
    bias: Array

    def load(self, cdd: Array) -> Array:
        """Torque of the bodies, (states,), at accelerations (states, n)."""
        return np.asarray((self.inertia * cdd).sum(axis=1) + self.bias)

    def sign(self, cdd: Array) -> Array:
        """Sign of the load, (states,)."""
        return np.sign(self.load(cdd))


def joint_loads(model: DynamicModel, chi: Array, c: Array, cd: Array) -> list[JointLoad]:
    """Load of every term of load-dependent friction.

    Args:
        model: the dynamic model, its load-dependent friction scaled by bodies.
        chi: parameters of the core's columns at each state, (states, r), SI.
        c, cd: positions and velocities of the torque rows' coordinates, (n, states).
    """
    rigid, bodies = model.bodies
    M = core_mass(rigid, bodies, c)
    h = core_torque(rigid, bodies, c, cd, np.zeros_like(c))
    first = 10 * len(model.device.joints)
    return [
        JointLoad(term.weights, chi[:, first + k] * term.shape.side(cd), M[:, term.shape.row], h[term.shape.row])
        for k, term in enumerate(model.terms)
        if isinstance(term.shape, LoadDependentFriction)
    ]


def load_friction_parts(loads: Sequence[JointLoad], cdd: Array) -> tuple[Array, Array]:
    """What load-dependent friction adds to M, (states, n, n), and to h, (states, n), with the signs at cdd.

    The friction without acceleration is in h already.

    Args:
        loads: of every term.
        cdd: accelerations, (states, n).
    """
    states, n = cdd.shape
    M, h = np.zeros((states, n, n)), np.zeros((states, n))
    for load in loads:
        signed = load.friction * load.sign(cdd)
        M += load.weights[:, None] * (signed[:, None] * load.inertia)[:, None]
        h += load.weights * (signed * load.bias - load.friction * np.abs(load.bias))[:, None]
    return M, h


# Least ratio of smallest to largest eigenvalue of a mass matrix that is inverted.
INVERTIBLE = 1e-12
# Smoothed dry friction is saturated this many widths from standstill: 1 - tanh is 1e-5 there.
SATURATED = 6.0
# Passes in which the signs of the joint loads are found: two or three where friction is less than the load itself.
_PASSES = 8


@dataclass(frozen=True, eq=False)
class ForwardDynamics:
    """Forward dynamics M(c) cdd = tau - h(c, cd), with friction, springs and user-defined columns in h.

    The core computes M by composite bodies (CRBA) and h by inverse dynamics without acceleration, and solves for all
    states and sets in one call, trees and loops alike (Walker and Orin 1982, J. Dyn. Sys. Meas. Control 104, method 3).
    Load-dependent friction enters h at zero acceleration; its change with cdd is solved together with cdd.

    Attributes:
        model: the dynamic model, its dry friction smoothed.
        chi: sets of parameters of the core's columns, (sets, r), SI.

    Raises:
        MissingAccelerationError: a user-defined column reads accelerations.
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
            c, cd: positions and velocities of the torque rows' coordinates, (n, states).
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
            SimulationError: a mass matrix is not positive definite.
        """
        c, cd, tau = np.ascontiguousarray(c), np.ascontiguousarray(cd), np.ascontiguousarray(tau)
        still = np.zeros_like(c) if self.model.externals else None
        own, loops = external(self.model, c, cd, still), self.model.loops(c, cd)
        cdd, failed = self.model.mechanism.acceleration(c, cd, tau, own, self.chi, loops)
        if failed is not None:
            row = failed * len(self.chi) // c.shape[1]
            raise self.massless(core_mass(self.model, self.chi[row], c[:, [failed]]))
        loads = self._loads(c, cd)
        return self._loaded(loads, self.mass(c), cdd.T) if loads else np.asarray(cdd)

    def _loaded(self, loads: list[JointLoad], M: Array, cdd: Array) -> Array:
        """cdd with load-dependent friction, (n, states), from cdd with the friction at zero acceleration, (states, n).

        Friction is linear in cdd for given signs of the loads: a few passes find the signs.
        """
        force = (M @ cdd[:, :, None])[:, :, 0]
        for _ in range(_PASSES):
            added, rest = load_friction_parts(loads, cdd)
            before, cdd = cdd, self._solved(M + added, force - rest)
            if not any((load.sign(before) != load.sign(cdd)).any() for load in loads):
                break
        return np.ascontiguousarray(cdd.T)

    def inertia(self, c: Array, cd: Array, cdd: Array) -> Array:
        """Derivative of inverse dynamics by accelerations, (states, n, n): M plus the part of load-dependent friction.

        Args:
            c, cd, cdd: of the coordinates, (n, states).
        """
        M, loads = self.mass(c), self._loads(c, cd)
        return M + load_friction_parts(loads, cdd.T)[0] if loads else M

    def _loads(self, c: Array, cd: Array) -> list[JointLoad]:
        """Loads of load-dependent friction, of all sets."""
        if not self.model.has_loads:
            return []
        return joint_loads(self.model, np.repeat(self.chi, c.shape[1] // len(self.chi), axis=0), c, cd)

    def _solved(self, M: Array, force: Array) -> Array:
        """M^-1 force, (states, n).

        Raises:
            SimulationError: a mass matrix cannot be inverted.
        """
        try:
            return np.asarray(np.linalg.solve(M, force[:, :, None])[:, :, 0])
        except np.linalg.LinAlgError:
            raise self.massless(M) from None

    def massless(self, M: Array) -> SimulationError:
        """The error for mass matrices of which one cannot be inverted."""
        values, vectors = np.linalg.eigh(M)
        ratio = values[:, 0] / np.maximum(values[:, -1], np.finfo(float).tiny)
        worst = int(np.argmin(ratio))
        label = self.model.device.row_labels[int(np.argmax(np.abs(vectors[worst, :, 0])))]
        return SimulationError(
            f"these parameters give {label} no inertia: the smallest eigenvalue of the mass matrix is "
            f"{float(ratio[worst]):.1e} of the largest (limit {INVERTIBLE:.1e}), so its acceleration is undefined.",
            where=label,
            found=float(ratio[worst]),
            limit=INVERTIBLE,
            advice="Start from physically consistent parameters, such as those of PhysicallyConsistent().",
        )

    def check(self, c: Array) -> None:
        """Raise SimulationError unless the mass matrix is positive definite at these positions, (n, states)."""
        M = self.mass(np.tile(c, len(self.chi)))
        if not (np.linalg.eigvalsh(M)[:, 0] > INVERTIBLE * np.abs(M).max(axis=(1, 2))).all():
            raise self.massless(M)

    def gradients(self, c: Array, cd: Array, cdd: Array) -> tuple[Array, Array]:
        """Derivatives of the first set's inverse dynamics by position and by velocity, each (states, n, n).

        Column k is the derivative by coordinate k.
        """
        by_c, by_cd, _ = np.moveaxis(self.slopes(c, cd, cdd), (1, 3), (0, 1))
        return by_c, by_cd

    def slopes(self, c: Array, cd: Array, cdd: Array) -> Array:
        """Derivatives of the first set's inverse dynamics by the motion's parts, (n, 3, n, states)."""
        return CoreChannels.of(self.model, np.array([c, cd, cdd])).torque_slopes(self.chi[0])

    def stiffness(self, c: Array) -> float:
        """Largest damping rate of friction at rest, 1/s, over positions (n, states), for the first set.

        The largest eigenvalue of M^-1 dh/dcd at zero velocity, where smoothed dry friction is steepest.
        """
        still = np.zeros_like(c)
        M = core_mass(self.model, self.chi[0], c)
        _, damping = self.gradients(c, still, still)
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
        """At which states dry friction may reverse within a period, in any of the sets, (states,).

        Args:
            c, cd, cdd: of the coordinates, (n, states).
            period: s.
        """
        turns = turning(self.model, c, cd, cdd, period)
        return np.tile(turns.reshape(len(self.chi), -1).any(axis=0), len(self.chi))


def turning(model: DynamicModel, c: Array, cd: Array, cdd: Array, period: float) -> np.ndarray:
    """At which states dry friction may reverse within a period, s, from positions and rates (n, states): (states,)."""
    dry, widths = model.dry_terms
    if not dry:
        return np.zeros(c.shape[1], dtype=bool)
    if all(term.joint is None for term in dry):
        constant = np.array([term.weights for term in dry])
        speed, change = np.abs(constant @ cd), np.abs(constant @ cdd)
    else:
        shares = np.array([np.broadcast_to(model.shares(term, c, cd), c.shape) for term in dry])
        speed, change = (np.abs((shares * x).sum(axis=1)) for x in (cd, cdd))
    return np.asarray((speed < SATURATED * widths + period * change).any(axis=0))


def sets_of(model: DynamicModel, beta: Array) -> Array:
    """Parameters of the core's columns, (sets, r), from sets of base parameters, (sets, p)."""
    S = model.device.parameters.S[:, list(model.base.independent_columns)]
    return freeze(np.atleast_2d(beta) @ S.T)


@dataclass(frozen=True, eq=False)
class ParametricForwardDynamics:
    """Forward dynamics with its own base parameters at every state, for filters of states and parameters.

    Attributes:
        model: the dynamic model, its dry friction smoothed.
        base: maps base parameters to parameters of the core's columns, (r, p).

    Raises:
        MissingAccelerationError: a column reads accelerations.
    """

    model: DynamicModel
    base: Array

    def __post_init__(self) -> None:
        check_linear(self.model)

    def acceleration(self, c: Array, cd: Array, tau: Array, beta: Array) -> Array:
        """cdd, (n, states), at parameters (p,) or (states, p).

        Args:
            c, cd: positions and velocities of the coordinates, (n, states).
            tau: torque of every row, (n, states), N m or N.
            beta: base parameters.

        Raises:
            SimulationError: a mass matrix is not positive definite.
        """
        return ForwardDynamics(self.model, beta @ self.base.T).acceleration(c, cd, tau)

    def turning(self, c: Array, cd: Array, cdd: Array, period: float) -> bool:
        """Whether dry friction may reverse within a period, s, at one state; c, cd and cdd are (n,)."""
        return bool(turning(self.model, c[:, None], cd[:, None], cdd[:, None], period)[0])

    def linearised(self, c: Array, cd: Array, tau: Array, beta: Array) -> tuple[Array, Array, Array, Array]:
        """At one state: cdd (n,), its derivatives by (c, cd) (n, 2n) and by beta (n, p), and M^-1 (n, n).

        Args:
            c, cd, tau: (n,).
            beta: (p,).
        """
        forward, column = ForwardDynamics(self.model, self.base @ beta), (c[:, None], cd[:, None])
        cdd = forward.acceleration(*column, tau[:, None])
        inverse = np.linalg.inv(forward.mass(column[0])[0])
        by_state = -inverse @ np.concatenate(forward.gradients(*column, cdd), axis=2)[0]
        Y = regressor_columns(self.model, *column, cdd, self.base)[:, :, 0]
        return cdd[:, 0], by_state, -inverse @ Y, inverse
