"""Sensitivities of a simulated motion and its torque to the parameters, from the variational equations of motion.

M sdd + (dh/dcd) sd + (d(M cdd + h)/dc) s = d(tau) - Y, for each base parameter its column Y of the inverse model; the
controller, linear below saturation, closes the same loop around s. All segments are integrated in parallel by the
trapezoidal rule, at the cost of about one simulation, whatever the number of parameters.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.motion.motion import Motion
from haptid.simulation.closed_loop import Steps
from haptid.simulation.control import PID, ControllerState, MotorRates

# Steps that are linearised at a time: enough for the core, with little memory.
_CHUNK = 64


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives with respect to the base parameters, and in an open loop to each segment's initial state.

    Attributes:
        c: of the coordinates, (steps, n, varied, segments), SI.
        tau: of the rows' torque, the same; None in an open loop, where torque is given.
    """

    c: Array
    tau: Array | None


@dataclass(frozen=True, eq=False)
class _Linear:
    """Variational equations at some steps: x = (s, sd), x' = F x + b + g d(tau).

    Attributes:
        F: (steps, segments, 2n, 2n).
        b: (steps, segments, n, p), the lower half.
        g: (steps, segments, n, n), the lower half.
    """

    F: Array
    b: Array
    g: Array


def sensitivity(forward: ForwardDynamics, law: PID | None, motion: Motion, steps: Steps, base: Array) -> Sensitivity:
    """Sensitivities of a simulation's first set of parameters to the base parameters.

    Args:
        forward: the simulated model.
        law: its controller; None in an open loop, where the initial states are varied too.
        motion: along which.
        steps: the simulation.
        base: the core's columns from base parameters, (r, p).
    """
    n, count = steps.c.shape[1], steps.segments.count
    p, period = base.shape[1], motion.dt / steps.per
    varied = p if law is not None else p + 2 * n
    x = np.zeros((count, 2 * n, varied))
    running = None
    if law is None:
        x[:, :, p:] = np.eye(2 * n)
    else:
        c, cd = steps.c[0, :, :count], steps.cd[0, :, :count]
        static = regressor_columns(forward.model, c, cd, np.zeros_like(c), base).transpose(0, 2, 1)
        none = np.zeros((len(forward.model.device.motors), count, varied))
        running = ControllerState(law, forward.model, period, none, none)
        running.settle(none, none, MotorRates.at(forward.model, c).torque_in_total(static))  # as `closed_loop` begins
    made_c = np.empty((len(steps.segments.sample), n, varied, count))
    made_tau = None if running is None else np.empty_like(made_c)
    for first in range(0, len(steps.c), _CHUNK):
        part = slice(first, min(first + _CHUNK + 1, len(steps.c)))
        linear = _linearised(forward, steps, part, base)
        ahead = np.asarray(np.linalg.inv(np.eye(2 * n) - 0.5 * period * linear.F))
        driven = None if running is None else _Driven.of(forward.model, steps, part)
        for k in range(first, min(first + _CHUNK, len(steps.c))):
            s, rate = (np.ascontiguousarray(half.transpose(1, 0, 2)) for half in (x[:, :n], x[:, n:]))
            tau = None
            if running is not None and driven is not None:
                tau = driven.torque(running, k - first, s, rate)
            if k % steps.per == 0:
                made_c[k // steps.per] = s.transpose(0, 2, 1)
                if made_tau is not None and tau is not None:
                    made_tau[k // steps.per] = tau.transpose(0, 2, 1)
            if k + 1 < part.stop:
                x = _ahead(linear, ahead, k - first, x, tau, 0.5 * period)
    return Sensitivity(made_c, made_tau)


@dataclass(frozen=True, eq=False)
class _Driven:
    """The motors at some steps of the first set of parameters.

    Attributes:
        model: the dynamic model.
        by: Jacobian B of the motors by the coordinates, (steps, segments, motors, n), or (motors, n).
        changes: its derivatives by the coordinates, (n, steps, segments, motors, n); None where it is constant.
        cd: velocities of the coordinates, (steps, n, segments).
        motors: torque of each motor, (steps, motors, segments).
        free: which were not saturated, (steps, motors, segments).
    """

    model: DynamicModel
    by: Array
    changes: Array | None
    cd: Array
    motors: Array
    free: np.ndarray

    @staticmethod
    def of(model: DynamicModel, steps: Steps, part: slice) -> _Driven:
        count = steps.segments.count
        c = _flat(steps.c[part, :, :count])
        rates = MotorRates.at(model, c)
        by, changes = rates.by, rates.changes(c)
        if changes is not None:
            by = by.reshape(-1, count, *by.shape[1:])
            changes = changes.reshape(len(c), *by.shape)
        own = (x[part, :, :count] for x in (steps.cd, steps.motors, steps.free))
        return _Driven(model, by, changes, *own)

    def torque(self, running: ControllerState, k: int, s: Array, rate: Array) -> Array:
        """Derivatives of the rows' torque, (n, segments, varied), from those of positions and velocities."""
        rates = MotorRates(self.model, self.by if self.changes is None else self.by[k])
        velocity = rates.of_motors(rate)
        if self.changes is not None:
            velocity = velocity + np.einsum("jsmn,ns,jsv->msv", self.changes[:, k], self.cd[k], s)
        command, _ = running.torque(rates.of_motors(s), velocity, None, None, self.free[k, :, :, None])
        tau = rates.of_rows(command)
        if self.changes is not None:
            tau = tau + np.einsum("jsmn,ms,jsv->nsv", self.changes[:, k], self.motors[k], s)
        return np.asarray(tau)


def _ahead(linear: _Linear, ahead: Array, k: int, x: Array, tau: Array | None, half: float) -> Array:
    """One control period of the trapezoidal rule, (segments, 2n, varied); `half` its length."""
    n, p = linear.b.shape[2:]
    right = x + half * (linear.F[k] @ x)
    right[:, n:, :p] += half * (linear.b[k] + linear.b[k + 1])
    if tau is not None:
        right[:, n:] += half * ((linear.g[k] + linear.g[k + 1]) @ tau.transpose(1, 0, 2))
    return np.asarray(ahead[k + 1] @ right)


def _linearised(forward: ForwardDynamics, steps: Steps, part: slice, base: Array) -> _Linear:
    """Variational equations at some steps of the first set of parameters."""
    n, count = steps.c.shape[1], steps.segments.count
    c, cd, cdd = (_flat(x[part, :, :count]) for x in (steps.c, steps.cd, steps.cdd))
    inverse = np.linalg.inv(ForwardDynamics(forward.model, forward.chi[:1]).inertia(c, cd, cdd))
    by_c, by_cd = forward.gradients(c, cd, cdd)
    states = len(inverse)
    F = np.zeros((states, 2 * n, 2 * n))
    F[:, :n, n:] = np.eye(n)
    F[:, n:, :n], F[:, n:, n:] = -inverse @ by_c, -inverse @ by_cd
    b = -inverse @ regressor_columns(forward.model, c, cd, cdd, base).transpose(2, 0, 1)
    F, b, inverse = (np.asarray(x.reshape(-1, count, *x.shape[1:]), dtype=np.float64) for x in (F, b, inverse))
    return _Linear(F, b, inverse)


def _flat(x: Array) -> Array:
    """(steps, n, segments) to (n, steps * segments)."""
    return np.ascontiguousarray(x.transpose(1, 0, 2).reshape(x.shape[1], -1))
