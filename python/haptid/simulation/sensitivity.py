"""How a simulated motion and its torque depend on the parameters: the equations of motion, varied.

M sdd + (dh/dcd) sd + (d(M cdd + h)/dc) s = d(tau) - Y, for each base parameter its column Y of the inverse model; the
controller, which is linear below its limits, closes the same loop around s. All stretches go side by side, at the cost
of about one simulation, whatever the number of parameters. Within a control period the trapezoidal rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.regressor import columns
from haptid.motion.treatment import Motion
from haptid.simulation.closed_loop import Steps
from haptid.simulation.control import PID, Running, Start

# Steps that are linearised at a time: enough for the core, little memory.
CHUNK = 64


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives by what is varied: the base parameters, then in an open loop each stretch's first state.

    Attributes:
        c: of the coordinates, (steps, n, varied, stretches), SI.
        tau: of the rows' torque, the same; None in an open loop, where torque is given.
    """

    c: Array
    tau: Array | None


@dataclass(frozen=True, eq=False)
class _Linear:
    """The varied equations at some steps: x = (s, sd), x' = F x + b + g d(tau).

    Attributes:
        F: (steps, stretches, 2n, 2n).
        b: (steps, stretches, n, p), the lower half.
        g: (steps, stretches, n, n), the lower half.
    """

    F: Array
    b: Array
    g: Array


def sensitivity(forward: ForwardDynamics, law: PID | None, motion: Motion, steps: Steps, base: Array) -> Sensitivity:
    """Of the first set of parameters, by base parameters.

    Args:
        forward: what was simulated.
        law: its controller; None in an open loop, where the first states are varied too.
        motion: along which.
        steps: the simulation.
        base: the core's columns from base parameters, (r, p).
    """
    n, count = steps.c.shape[1], steps.stretches.count
    p, period = base.shape[1], motion.dt / steps.per
    varied = p if law is not None else p + 2 * n
    x = np.zeros((count, 2 * n, varied))
    running = None
    if law is None:
        x[:, :, p:] = np.eye(2 * n)
    else:
        c, cd = steps.c[0, :, :count], steps.cd[0, :, :count]
        held = columns(forward.model, c, cd, np.zeros_like(c), base).transpose(0, 2, 1)  # as `closed_loop` begins
        none = np.zeros((n, count, varied))
        running = Running(law, forward.model, period, Start(none, none, none, none, held))
    made_c = np.empty((len(steps.stretches.sample), n, varied, count))
    made_tau = None if running is None else np.empty_like(made_c)
    for first in range(0, len(steps.c), CHUNK):
        part = slice(first, min(first + CHUNK + 1, len(steps.c)))
        linear = _linearised(forward, steps, part, base)
        ahead = np.asarray(np.linalg.inv(np.eye(2 * n) - 0.5 * period * linear.F))
        for k in range(first, min(first + CHUNK, len(steps.c))):
            s, se = (np.ascontiguousarray(half.transpose(1, 0, 2)) for half in (x[:, :n], x[:, n:]))
            tau = None
            if running is not None:
                tau, _ = running.torque(s, se, None, None, steps.free[k, :, :count, None])
            if k % steps.per == 0:
                made_c[k // steps.per] = s.transpose(0, 2, 1)
                if made_tau is not None and tau is not None:
                    made_tau[k // steps.per] = tau.transpose(0, 2, 1)
            if k + 1 < part.stop:
                x = _ahead(linear, ahead, k - first, x, tau, 0.5 * period)
    return Sensitivity(made_c, made_tau)


def _ahead(linear: _Linear, ahead: Array, k: int, x: Array, tau: Array | None, half: float) -> Array:
    """From one control period to the next, (stretches, 2n, varied); `half` of its length."""
    n, p = linear.b.shape[2:]
    right = x + half * (linear.F[k] @ x)
    right[:, n:, :p] += half * (linear.b[k] + linear.b[k + 1])
    if tau is not None:
        right[:, n:] += half * ((linear.g[k] + linear.g[k + 1]) @ tau.transpose(1, 0, 2))
    return np.asarray(ahead[k + 1] @ right)


def _linearised(forward: ForwardDynamics, steps: Steps, part: slice, base: Array) -> _Linear:
    """The varied equations at some steps of the first set of parameters."""
    n, count = steps.c.shape[1], steps.stretches.count
    c, cd, cdd = (_flat(x[part, :, :count]) for x in (steps.c, steps.cd, steps.cdd))
    inverse = np.linalg.inv(ForwardDynamics(forward.model, forward.chi[:1]).inertia(c, cd, cdd))
    by_c, by_cd = forward.slopes(c, cd, cdd)
    states = len(inverse)
    F = np.zeros((states, 2 * n, 2 * n))
    F[:, :n, n:] = np.eye(n)
    F[:, n:, :n], F[:, n:, n:] = -inverse @ by_c, -inverse @ by_cd
    b = -inverse @ columns(forward.model, c, cd, cdd, base).transpose(2, 0, 1)
    F, b, inverse = (np.asarray(x.reshape(-1, count, *x.shape[1:]), dtype=np.float64) for x in (F, b, inverse))
    return _Linear(F, b, inverse)


def _flat(x: Array) -> Array:
    """(steps, n, stretches) to (n, steps * stretches)."""
    return np.ascontiguousarray(x.transpose(1, 0, 2).reshape(x.shape[1], -1))
