"""Z-width: the stiffest virtual wall that a device renders passively, and the stiffest that is stable.

The passive bound of a spring K at the handle is that of Colgate and Schenkel (1997) with a delay d,

    K (T / 2 + d) J' J <= B,   K = b / (T / 2 + d),   b the least damping at the handle;

a quantised wall is passive where besides K <= 2 Fc / D, with dry friction Fc and an encoder step D at the handle
(Abbott and Okamura 2005, IEEE Trans. Robotics 21(5), 952-964). What is stable in a hand is far stiffer (Hulin et al.
2014): it is found by stepping the device along one direction through time with dry friction, encoder steps and hand.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.end_effector.compensation import Feedback, HandModel, SampledLoop

# Bounds of a stiffness, N/m, and halvings of the search (in the logarithm).
_LEAST, _MOST, _HALVINGS = 1e-2, 1e6, 18
# Steps in a control period, seconds of a trial, the push above dry friction, N, and its duration, s.
_STEPS, _SECONDS, PUSH, _PUSHED = 10, 1.0, 1.0, 0.02

# Motion that counts as rest, m. Stiffnesses of a scan, in a decade, and halvings after it; natural frequency of the
# softest one, rad/s: three periods in a trial.
_REST, _DECADE, _AFTER, _SLOWEST = 1e-9, 6, 9, 6 * np.pi


def passive_stiffness(damping: Array, dt: float, delay: float = 0.0) -> float:
    """Stiffest passive virtual spring, N/m.

    Args:
        damping: viscous friction at the handle, (m, m), N s/m.
        dt: control period, s.
        delay: from reading positions to the force, s.
    """
    return float(max(np.linalg.eigvalsh(damping)[0], 0.0) / (dt / 2 + delay))


def stable_stiffness(loop: SampledLoop, hand: HandModel | None = None, shape: Array | None = None) -> float:
    """Stiffest virtual spring at the handle that is stable, linear, without dry friction, N/m; 0 where none is.

    Args:
        loop: the device at a pose; its own feedback stays.
        hand: that holds the handle, None for a free one.
        shape: of the stiffness at the handle, (m, m), as a multiple of the result; the unit matrix where None.
    """
    J = loop.jacobian
    S = J.T @ J if shape is None else J.T @ shape @ J

    def held(K: float) -> bool:
        wall = Feedback(K * S, (1.0,))
        made = SampledLoop(loop.inertia, loop.viscous, loop.stiffness, J, (*loop.feedback, wall), loop.dt, loop.delay)
        return made.spectral_radius(hand) < 1

    return _largest(held)


@dataclass(frozen=True)
class StepDevice:
    """A device along one direction.

    Attributes:
        mass, damping, friction: felt, kg, N s/m, N.
        step: of the measured position, m; 0 for none.
        dt, delay: of the controller, s; the delay in whole periods and tenths of one.
    """

    mass: float
    damping: float
    friction: float
    step: float
    dt: float
    delay: float = 0.0


def stepped_stiffness(device: StepDevice, hand: HandModel | None, near: float | None = None) -> float:
    """Stiffest virtual spring up to which a push dies out, with dry friction, encoder steps and a hand, N/m.

    The handle is pushed for a moment, harder than dry friction, at the wall's surface, which holds it from both sides.
    The spring is stable where in the last third of a second the motion still shrinks, or is within two encoder steps of
    rest while the spring's force changes by no more than the push: a limit cycle of one encoder step is felt at a stiff
    wall. With dry friction a softer spring, which swings further, may be unstable where a stiffer one is not. So they
    are tried in turn, from the passive bound, or from the softest one with some periods in a trial.

    Args:
        device: along one direction.
        hand: that holds the handle, None for a free one.
        near: the result is sought from half of this to twice this, where a bound of a similar device is known.

    Returns:
        The stiffness; the passive bound where none above it is stable.
    """
    passive = device.damping / (device.dt / 2 + device.delay)
    first, last = (max(passive, device.mass * _SLOWEST**2), _MOST) if near is None else (near / 2, near * 2)
    tried = np.linspace(np.log10(first), np.log10(last), max(2, round(np.log10(last / first) * _DECADE) + 1))
    fails = next((k for k, x in enumerate(tried) if not _settles(device, hand, 10**x)), None)
    if fails is None:
        return float("inf")
    if fails == 0:
        return passive if near is None else float(first)
    low, high = tried[fails - 1], tried[fails]
    for _ in range(_AFTER):
        middle = (low + high) / 2
        low, high = (middle, high) if _settles(device, hand, 10**middle) else (low, middle)
    return float(10**low)


def _largest(held: Callable[[float], bool]) -> float:
    low, high = np.log(_LEAST), np.log(_MOST)
    if not held(_LEAST):
        return 0.0
    if held(_MOST):
        return float("inf")
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if held(float(np.exp(middle))) else (low, middle)
    return float(np.exp(low))


def _settles(device: StepDevice, hand: HandModel | None, K: float) -> bool:
    h, periods, late = device.dt / _STEPS, round(_SECONDS / device.dt), round(device.delay / device.dt * _STEPS)
    mass, M = device.mass, np.array([device.mass, hand.mass if hand else 1.0])
    link, arm = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([0.0, 1.0])
    B, S = np.diag([device.damping, 0.0]), np.zeros((2, 2))
    if hand:
        B, S = B + hand.grip_damping * link + hand.damping * arm, hand.grip_stiffness * link + hand.stiffness * arm
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-S / M[:, None], -B / M[:, None]]])
    column = np.array([[0.0], [0.0], [1 / mass], [0.0]])
    made = linalg.expm(np.block([[A, column], [np.zeros((1, 5))]]) * h)
    F, g, slip = made[:4, :4], made[:4, 4], device.friction * h / mass
    x, queue = np.zeros(4), [0.0] * (late + _STEPS + 1)
    size, reads = np.empty(periods), np.empty(periods)
    for k in range(periods):
        read = device.step * np.rint(x[0] / device.step) if device.step else x[0]
        reads[k] = read
        for _ in range(_STEPS):
            queue = [-K * read, *queue[:-1]]
            push = device.friction + PUSH if k * device.dt < _PUSHED else 0.0
            before, x = x, F @ x + g * (queue[late] + push)
            # Dry friction stops the mass within a step where it can, and brakes it where it cannot.
            x[2] = np.sign(x[2]) * max(abs(x[2]) - slip, 0.0)
            if x[2] == before[2] == 0.0:
                x[0] = before[0]
        size[k] = abs(x[0])
        if size[k] > 1.0:
            return False
    third = periods // 3
    middle, end = np.ptp(size[third : 2 * third]), np.ptp(size[2 * third :])
    quiet = end <= 2 * device.step + _REST and K * np.ptp(reads[2 * third :]) <= PUSH
    return bool(quiet or end < 0.98 * middle)
