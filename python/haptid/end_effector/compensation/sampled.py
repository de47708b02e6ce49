"""Driving-point impedance, passivity and stability of a device with a sampled controller, linear about a pose at rest.

The device is A qdd + B qd + K q = tau + J' F in continuous time, F the force of the hand. The controller reads q every
T seconds and holds tau = - sum_i M_i h_i(z) q until the next reading, a delay later. Then, without aliasing,

    Z(w) = J^-T (j w A + B + K / (j w) + e^(-j w delay) (1 - e^(-j w T)) / (j w T) H(e^(j w T)) / (j w)) J^-1,

and the device is passive if and only if (Colgate and Schenkel 1997, J. Robotic Systems 14(1), 37-47, theorem 1, with
the delay in H; for a matrix its Hermitian part)

    B > T / (2 (1 - cos w T)) Re (1 - e^(-j w T)) e^(-j w delay) H(e^(j w T)),   0 <= w <= pi / T.

For a virtual wall, H = K + D (1 - 1/z) / T, this is b > K T / 2 + |D|.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze, positive, read_only
from haptid._internal.late import dataclass
from haptid.end_effector.compensation.hands import HandModel
from haptid.errors import setting_error

# Frequencies at which passivity is examined, up to the Nyquist frequency.
_FREQUENCIES = 600


@dataclass(frozen=True, eq=False)
class Feedback:
    """One part of a controller: torque = - matrix * numerator(1/z) / denominator(1/z) * position.

    Attributes:
        matrix: (n, n), symmetric.
        numerator, denominator: coefficients of 1, 1/z, 1/z^2, ...
    """

    matrix: Array
    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", read_only(self.matrix))


def filtered_difference(cutoff_hz: float, dt: float) -> tuple[Array, Array]:
    """Filtered difference (1 - p) (1 - 1/z) / (T (1 - p / z)), p = exp(-2 pi cutoff T); none is filtered at infinity.

    Returns:
        Coefficients of numerator and denominator.
    """
    pole = float(np.exp(-2 * np.pi * cutoff_hz * dt))
    return (1 - pole) / dt * np.array([1.0, -1.0]), np.array([1.0, -pole])


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A device at a pose with its controller; see the module.

    Attributes:
        inertia, viscous, stiffness: A, B and K of the coordinates, (n, n), SI.
        jacobian: of the handle's velocity, (m, n).
        feedback: parts of the controller.
        dt: control period T, s.
        delay: from reading the position to the torque, s.
    """

    inertia: Array
    viscous: Array
    stiffness: Array
    jacobian: Array
    feedback: tuple[Feedback, ...]
    dt: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        n = self.inertia.shape[0]
        for name in ("inertia", "viscous", "stiffness"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, (n, n))
        object.__setattr__(self, "jacobian", read_only(self.jacobian))
        expect("jacobian", self.jacobian.shape, (None, n))
        for part in self.feedback:
            expect("feedback", part.matrix.shape, (n, n))
        if not positive(self.dt):
            raise setting_error("dt", self.dt, "a finite number above 0")
        if not 0 <= self.delay < float("inf"):
            raise setting_error("delay", self.delay, "a finite number from 0")

    def response(self, frequency_hz: Array) -> Array:
        """H(e^(j w T)) with the delay, torque that resists per position, (frequencies, n, n)."""
        from scipy import signal  # slow to import, and few programs compensate

        f = np.asarray(frequency_hz, dtype=float)
        late, made = np.exp(-2j * np.pi * f * self.delay), np.zeros((len(f), *self.inertia.shape), dtype=complex)
        for part in self.feedback:
            h = signal.freqz(part.numerator, part.denominator, worN=f, fs=1 / self.dt)[1]
            made += (late * h)[:, None, None] * part.matrix
        return made

    def impedance(self, frequency_hz: Array) -> Array:
        """Z of the handle, force of the hand per velocity with the other coordinates free, (frequencies, m, m)."""
        f = np.asarray(frequency_hz, dtype=float)
        jw = 2j * np.pi * f[:, None, None]
        hold = (1 - np.exp(-jw * self.dt)) / (jw * self.dt)
        own = jw * self.inertia + self.viscous + (self.stiffness + hold * self.response(f)) / jw
        return freeze(np.linalg.inv(self.jacobian @ np.linalg.solve(own, np.swapaxes(self.jacobian, 0, 1)[None])))

    def missing_damping(self, directions: Array | None = None) -> Array:
        """Damping at the handle that lacks for passivity at each frequency, N s/m, at most 0 where none lacks.

        The largest eigenvalue of J^-T (right side - B) J^-1, or the largest value along given directions. It is
        passive where none is above 0.

        Args:
            directions: of the handle, (d, m); None for all.
        """
        return freeze(self._missing(self.frequencies, directions))

    @cached_property
    def frequencies(self) -> Array:
        """At which passivity is examined, (f,), Hz: even in the logarithm, then up to the Nyquist frequency."""
        nyquist = 0.5 / self.dt
        low = np.geomspace(1e-3 * nyquist, 0.2 * nyquist, _FREQUENCIES // 2, endpoint=False)
        return freeze(np.concatenate([low, np.linspace(0.2 * nyquist, nyquist, _FREQUENCIES // 2)]))

    @property
    def passive(self) -> bool:
        """Whether the device with its controller is passive, strictly: it gives no energy to any hand."""
        return bool(self.missing_damping().max() < 0)

    def _missing(self, f: Array, directions: Array | None) -> Array:
        angle = 2 * np.pi * f * self.dt
        part = (1 - np.exp(-1j * angle))[:, None, None] * self.response(f)
        hermitian = (part + np.conj(np.swapaxes(part, 1, 2))) / 2
        lacks = (self.dt / 2 / (1 - np.cos(angle)))[:, None, None] * hermitian - self.viscous
        inverse = np.linalg.pinv(self.jacobian)
        at_handle = inverse.T @ lacks @ inverse
        if directions is not None:
            return np.asarray(np.einsum("di,fij,dj->fd", directions, at_handle, directions).real.max(axis=1))
        return np.asarray(np.linalg.eigvalsh(at_handle)[:, -1])

    def spectral_radius(self, hand: HandModel | None = None) -> float:
        """Largest modulus of the sampled closed loop's eigenvalues while a hand holds the handle; below 1: stable.

        Exact: the plant's motion between readings is a matrix exponential, a delay may be part of a period. Without a
        hand the free device may drift, which has the eigenvalue 1: eigenvalues within 1e-9 of 1 are not counted.
        """
        values = np.linalg.eigvals(self._closed(hand))
        moved = np.abs(values[np.abs(values - 1) > (1e-9 if hand else 1e-6)])
        return float(moved.max(initial=0.0))

    def stable(self, hands: Iterable[HandModel | None]) -> bool:
        """Whether the loop is stable with every one of these hands, None for a free handle."""
        return all(self.spectral_radius(hand) < 1 for hand in hands)

    def _closed(self, hand: HandModel | None) -> Array:
        """State matrix of the sampled closed loop: plant, controller, torques under way."""
        n = len(self.inertia)
        whole, rest = divmod(self.delay / self.dt, 1.0)
        whole, rest = (int(whole) + 1, 0.0) if rest > 1 - 1e-9 else (int(whole), rest if rest > 1e-9 else 0.0)
        # Until the delay's rest is over the torque of the period before acts.
        device = tuple(x.tobytes() for x in (self.inertia, self.viscous, self.stiffness, self.jacobian))
        first_x, first_u = _moved(device, n, hand, rest * self.dt)
        then_x, then_u = _moved(device, n, hand, (1 - rest) * self.dt)
        Ad, old, new, size = then_x @ first_x, then_x @ first_u, then_u, len(first_x)
        Ac, Bc, Cc, Dc = self._controller()
        c, waiting = len(Ac), whole + (rest > 0)
        total = size + c + n * waiting
        made, read = np.zeros((total, total)), np.zeros((n, size))
        read[:, :n] = np.eye(n)
        made[:size, :size], made[size : size + c, size : size + c] = Ad, Ac
        made[size : size + c, :size] = Bc @ read
        torque = np.zeros((n, total))
        torque[:, :size], torque[:, size : size + c] = Dc @ read, Cc
        line = [torque, *(np.eye(total)[size + c + n * k : size + c + n * (k + 1)] for k in range(waiting))]
        made[:size] += new @ line[whole]
        if rest > 0:
            made[:size] += old @ line[whole + 1]
        for k in range(waiting):
            made[size + c + n * k : size + c + n * (k + 1)] = line[k]
        return made

    def _controller(self) -> tuple[Array, Array, Array, Array]:
        """State space of the controller from positions to torques."""
        n = len(self.inertia)
        parts, outs, through = [], [], np.zeros((n, n))
        for part in self.feedback:
            length = max(len(part.numerator), len(part.denominator))
            top, bottom = (np.pad(x, (0, length - len(x))) for x in (part.numerator, part.denominator))
            a, b, c, d = _realised(top, bottom)
            parts.append((np.kron(a, np.eye(n)), np.kron(b, np.eye(n))))
            outs.append(-np.kron(c, part.matrix))
            through -= float(d[0, 0]) * part.matrix
        if not parts:
            return np.zeros((0, 0)), np.zeros((0, n)), np.zeros((n, 0)), through
        return linalg.block_diag(*(a for a, _ in parts)), np.vstack([b for _, b in parts]), np.hstack(outs), through


def _realised(top: Array, bottom: Array) -> tuple[Array, Array, Array, Array]:
    """Controllable canonical form of top(1/z) / bottom(1/z), bottom[0] = 1."""
    k, d = len(top) - 1, top[0]
    a = np.zeros((k, k))
    if k:
        a[0], a[1:, :-1] = -bottom[1:], np.eye(k - 1)
    return a, np.eye(k, 1), (top[1:] - d * bottom[1:])[None], np.array([[d]])


@lru_cache(maxsize=4096)
def _moved(device: tuple[bytes, ...], n: int, hand: HandModel | None, seconds: float) -> tuple[Array, Array]:
    """Motion of device and hand under a constant torque over a time: factors of state and torque.

    The state is positions, then velocities. Kept, because a search evaluates many controllers of one device.
    """
    M, D, K, J = (np.frombuffer(x).reshape(-1, n) for x in device)
    if hand is not None:
        m = len(J)
        own, link = np.eye(m), np.block([J, -np.eye(m)])
        outer = np.zeros((n + m, n + m))
        outer[n:, n:] = own
        M = linalg.block_diag(M, hand.mass * own)
        D = linalg.block_diag(D, 0 * own) + hand.grip_damping * link.T @ link + hand.damping * outer
        K = linalg.block_diag(K, 0 * own) + hand.grip_stiffness * link.T @ link + hand.stiffness * outer
    size = len(M)
    both = np.zeros((2 * size + n, 2 * size + n))
    both[:size, size : 2 * size] = np.eye(size)
    both[size : 2 * size] = np.linalg.solve(M, np.hstack([-K, -D, np.eye(size)[:, :n]]))
    made = linalg.expm(both * seconds) if seconds > 0 else np.eye(len(both))
    return freeze(made[: 2 * size, : 2 * size]), freeze(made[: 2 * size, 2 * size :])
