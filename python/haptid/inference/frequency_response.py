"""Frequency response of a device from logs of a periodic motion, with its variance from the periods, without a model.

A motion that repeats (a multisine under a controller) gives in every period the same spectra but for noise. Their means
over the periods of positions and torques, of as many logs as there are motors, are C = G T in each bin: the compliance
G. What each period differs by is its noise. Source: Pintelon and Schoukens (2012), System Identification: A Frequency
Domain Approach, 2nd ed., sections 2.7 (periodic measurements) and 2.8 (several inputs).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid._internal.signals import fast_length
from haptid.dynamics.counterparts import with_stiff_springs
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError, IdentifiabilityError, LogTimeError
from haptid.log import Log
from haptid.motion.channels import coordinate_torque, coordinates, position_map
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment
from haptid.uncertainty.distributions import f_quantile, t_quantile

# Periods that are needed, and how many times as much as the nearest neighbours may differ within a motion that repeats.
_FEWEST, _STRAYS = 3, 9.0
# A bin is excited where the ratio of the mean's power to that of its noise is at least the first number, and above what
# noise alone reaches in any bin with the second as probability; none is beyond this share of the sampling rate.
_EXCITED, _FALSE, _HIGHEST = 30.0, 1e-3, 0.4
# Largest difference of a motion from itself a period later, over its variance, and how far above the least it may be.
_REPEATS, _NEAR = 0.05, 4.0
# Variance of a coordinate's steps over its own from which on it is at rest: that of white noise is 2.
_NOISY = 0.5
# Part of a log at either end that may be a soft start or stop.
_ENDS = 6
# Samples at which the first period may begin.
_OFFSETS = 16
# Frequencies of a link that a fit begins with, over the range of the bins.
_STARTS = (0.5, 1.0, 2.0, 4.0)
# Fewest bins for a spring, and parameters of one.
_BINS, _PARAMETERS = 6, 6


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Compliance of a device at the frequencies that its logs excite.

    Attributes:
        device: its name.
        labels, units: of the coordinates, (n,); rad or m.
        f: Hz, (bins,).
        G: position by torque, complex, (bins, n, n), rad/(N m) and so on.
        variance: of each, E|G - true|^2, (bins, n, n).
        dof: degrees of freedom of the noise, from periods and logs.
        period: s.
        periods: of each log, (logs,).
    """

    device: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    f: Array
    G: np.ndarray
    variance: Array
    dof: int
    period: float
    periods: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze_fields(self, "f", "variance")

    @property
    def circle(self) -> float:
        """Square of a radius that holds a true value at 95 %, over the variance."""
        return float(f_quantile(0.95, 2, 2 * self.dof))

    @property
    def radius(self) -> Array:
        """Radius of the circle about each G that holds the true value at 95 %, (bins, n, n)."""
        return np.asarray(np.sqrt(self.variance * self.circle))

    def unit(self, position: int, torque: int) -> str:
        """Unit of G of a position by a torque."""
        return f"{self.units[position]}/{'N' if self.units[torque] == 'm' else '(N m)'}"

    def table(self) -> list[list[object]]:
        """Rows of a CSV file, the first with headers: f, then of each position and torque both parts and the radius."""
        n, radius = len(self.labels), self.radius
        pairs = [(i, j) for i in range(n) for j in range(n)]
        head: list[object] = ["f, Hz"]
        for i, j in pairs:
            name = f"{self.labels[i]} by {self.labels[j]}"
            head += [f"{name}, real, {self.unit(i, j)}", f"{name}, imaginary", f"{name}, radius"]
        rows = [head]
        for k, f in enumerate(self.f):
            cells = (float(x) for i, j in pairs for x in (self.G[k, i, j].real, self.G[k, i, j].imag, radius[k, i, j]))
            rows.append([float(f), *cells])
        return rows

    def summary(self) -> str:
        """A line for each frequency: of every coordinate by its own torque, size, phase and radius of the circle."""
        head = "".join(f"{f'{label}: |G|':>16s}{'phase, deg':>12s}{'radius':>12s}" for label in self.labels)
        lines = [f"{'f, Hz':>8s}{head}"]
        for f, G, radius in zip(self.f, self.G, self.radius, strict=True):
            own = zip(np.diag(G), np.diag(radius), strict=True)
            cells = (f"{abs(g):16.4g}{np.degrees(np.angle(g)):12.1f}{r:12.2g}" for g, r in own)
            lines.append(f"{f:8.4g}{''.join(cells)}")
        return "\n".join(lines)

    def stiffness(self, motor: int = 0) -> tuple[np.ndarray, Array]:
        """Dynamic stiffness of a coordinate, the others held: torque by position, (bins,), and its variance."""
        Z = np.linalg.inv(self.G)
        weight = np.abs(Z[:, motor, :, None] * Z[:, None, :, motor]) ** 2
        return Z[:, motor, motor], np.asarray((weight * self.variance).sum(axis=(1, 2)))

    def spring(self, motor: int = 0) -> Spring:
        """Rotor, spring and link that have the dynamic stiffness of a coordinate.

        Raises:
            IdentifiabilityError: too few bins, or a rigid body explains them as well.
        """
        Z, variance = self.stiffness(motor)
        return _fitted_spring(self.labels[motor], self.f, Z, variance, self.dof)

    @cached_property
    def springs(self) -> tuple[Spring | IdentifiabilityError, ...]:
        """The spring of each motor, or why its frequency response shows none."""
        found: list[Spring | IdentifiabilityError] = []
        for motor in range(len(self.labels)):
            try:
                found.append(self.spring(motor))
            except IdentifiabilityError as error:
                found.append(error)
        return tuple(found)


@dataclass(frozen=True)
class Spring:
    """A spring behind a motor, from its frequency response.

    Attributes:
        stiffness, se, dof: N m/rad or N/m, its standard error and the degrees of freedom of that.
        damping, link, rotor: of spring, and both inertias.
        link_friction, rotor_friction: viscous.
        misfit: mean square of the error in standard errors: one where the model is right.
        error: root mean square of the error over the dynamic stiffness.
    """

    stiffness: float
    se: float
    dof: int
    damping: float
    link: float
    rotor: float
    link_friction: float
    rotor_friction: float
    misfit: float
    error: float

    def conf_int(self, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of the stiffness."""
        half = float(t_quantile(0.5 + 0.5 * level, self.dof)) * self.se
        return self.stiffness - half, self.stiffness + half

    def dynamic_stiffness(self, f: Array) -> np.ndarray:
        """Torque by position of the rotor at frequencies in Hz, complex, (n,)."""
        s = 2j * np.pi * np.asarray(f)
        return _two_inertias(
            s, self.link, self.stiffness, self.rotor, self.damping, self.rotor_friction, self.link_friction
        )

    @property
    def antiresonance(self) -> float:
        """Frequency of the link on its spring, the motor held, Hz."""
        return float(np.sqrt(self.stiffness / self.link) / (2 * np.pi))


def multisine_response(
    model: DynamicModel,
    logs: Log | Sequence[Log],
    period_s: float | None = None,
    torque_delay_s: float | Sequence[float] | None = None,
) -> FrequencyResponse:
    """Frequency response at the motors' side from logs of a periodic motion; as many logs as motors, or more.

    Args:
        model: the dynamic model; elastic motors count as rigid.
        logs: recordings, each of another motion with the same period.
        period_s: period of the motion; found where None.
        torque_delay_s: of the torque, or of each motor's; half a sampling period, as of a command that is held, where
            None.

    Raises:
        LogTimeError: no period, or too few.
        IdentifiabilityError: fewer logs than motors, or no frequency is excited in all of them.
    """
    recordings = [logs] if isinstance(logs, Log) else list(logs)
    rigid = with_stiff_springs(model)
    labels = tuple(rigid.device.row_labels)
    if len(recordings) < len(labels):
        raise IdentifiabilityError(
            f"a frequency response of {len(labels)} motors needs as many logs, each of another motion with the same "
            f"period; found {len(recordings)}.",
            where=recordings[0].path.name,
            found=len(recordings),
            limit=len(labels),
            advice="Record the multisine again with other phases for each motor.",
        )
    dt = float(recordings[0].dt)
    signals = [_signals(rigid, log) for log in recordings]
    length = round(period_s / dt) if period_s else _period(signals[0][0], recordings[0])
    parts = [_periods(C, T, length, log) for (C, T), log in zip(signals, recordings, strict=True)]
    f = np.arange(1, int(_HIGHEST * length)) / (length * dt)
    delay = np.broadcast_to(0.5 * dt if torque_delay_s is None else torque_delay_s, len(labels))
    late = np.exp(-2j * np.pi * f * delay[:, None])[:, None]  # the same in every period
    spectra = [(_spectra(C, len(f)), _spectra(T, len(f)) * late) for C, T in parts]
    excited = np.all([_excited(C) for C, _ in spectra], axis=0)
    if not excited.any():
        raise IdentifiabilityError(
            "no frequency of the motion is above its noise in every log.",
            where=recordings[0].path.name,
            found=0.0,
            limit=_EXCITED,
            advice="Give the period with period_s, move more, or record more periods.",
        )
    G, variance, dof = _estimated([(C[..., excited], T[..., excited]) for C, T in spectra])
    periods = tuple(C.shape[1] for C, _ in spectra)
    units = rigid.device.coordinate_units
    return FrequencyResponse(rigid.device.name, labels, units, f[excited], G, variance, dof, length * dt, periods)


def response_of_motors(
    model: DynamicModel, logs: Sequence[Log], torque_delay_s: float | Sequence[float] | None = None
) -> FrequencyResponse | None:
    """The frequency response of the motors, in their order; None where the logs do not repeat, or are too few."""
    rigid = with_stiff_springs(model).device
    if rigid.row_names != tuple(motor.name for motor in model.device.motors):
        return None
    try:
        return multisine_response(model, logs, torque_delay_s=torque_delay_s)
    except HaptidError:
        return None


def modelled_compliance(model: DynamicModel, beta: Array, motion: Motion, f: Array) -> np.ndarray:
    """Position of each motor by the torque of each at the mean pose of a motion, (bins, motors, motors), complex.

    Of small motion, without dry friction.

    Args:
        beta: base parameters, (p,).
        f: frequencies, Hz, (bins,).
    """
    device = model.device
    c = coordinates(device, motion, *motion.usable)[0].mean(axis=1, keepdims=True)
    forward = ForwardDynamics(model, raw_parameters(model, beta)).without_dry()
    still, s = np.zeros_like(c), 2j * np.pi * np.asarray(f)[:, None, None]
    stiffness, damping = forward.gradients(c, still, still)
    B, motors = np.asarray(device.row_map), [k for k, drive in enumerate(device.drives) if drive.motorised]
    N = np.asarray(device.coupling)[motors]
    return np.asarray(N @ np.linalg.solve(B.T @ (stiffness + s * damping + s**2 * forward.mass(c)) @ B, N.T + 0j))


def _signals(model: DynamicModel, log: Log) -> tuple[Array, Array]:
    """Position and torque of the coordinates, each (n, samples)."""
    motion = treat(log, Treatment(cutoff_hz=None))
    c = position_map(model.device, motion)(np.ascontiguousarray(np.asarray(motion.q[:]).T))
    return c, coordinate_torque(model.device, motion, 0, len(motion))


def _period(C: Array, log: Log) -> int:
    """Samples after which a motion repeats; a soft start and stop count only where the motion repeats with them."""
    C, n = C[_moves(C)], C.shape[1]
    most, ends = n // _FEWEST, n // _ENDS
    length, error = _repetition(C, most)
    if error > _REPEATS:
        length, error = _repetition(C[:, ends : n - ends], most)
    if error > _REPEATS:
        raise LogTimeError(
            f"{log.path.name} has no motion that repeats {_FEWEST} times: it differs from itself by "
            f"{100 * error:.0f} % of its variance at least (limit {100 * _REPEATS:.0f} %).",
            where=log.path.name,
            found=error,
            limit=_REPEATS,
            advice=f"Record a multisine whose frequencies are multiples of one, for {_FEWEST} periods or more.",
        )
    return length


def _moves(C: Array) -> np.ndarray:
    """Coordinates that move more than by noise: their steps are small; all where none does, (n,)."""
    moves = np.asarray(np.diff(C, axis=1).var(axis=1) < _NOISY * C.var(axis=1))
    return moves if moves.any() else np.ones(len(C), dtype=bool)


def _repetition(C: Array, most: int) -> tuple[int, float]:
    """Lag of the best repetition, in samples, and the mean square of the motion's difference from itself there.

    Args:
        C: positions, (n, samples).
        most: largest lag.

    Returns:
        The mean square is relative to twice the variance; lag 0 and 1 where the motion never leaves its beginning.
    """
    x = C - C.mean(axis=1, keepdims=True)
    n, scale = x.shape[1], x.var(axis=1, keepdims=True)
    x = x / np.sqrt(np.where(scale > 0, scale, 1.0))  # it may be 0 in part of a log
    size = fast_length(2 * n)
    products = fft.irfft(np.abs(fft.rfft(x, size)) ** 2, size)[:, :n].sum(axis=0)
    power = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=0))])
    lag = np.arange(n)
    apart = (power[n] - power[lag] + power[n - lag] - 2 * products) / np.maximum(n - lag, 1) / (2 * len(x))
    first = int(np.argmax(apart[:most] > 0.5))  # the motion has left its beginning
    found = apart[first:most]
    if not first or not len(found):
        return 0, 1.0
    near = np.flatnonzero(found < _NEAR * found.min() + 1e-6)
    group = near[: int(np.argmax(np.append(np.diff(near), 2) > 1)) + 1]  # of neighbouring lags, the first
    return first + int(group[np.argmin(found[group])]), float(found.min())


def _periods(C: Array, T: Array, length: int, log: Log) -> tuple[Array, Array]:
    """The longest run of periods that repeat, each (n, periods, samples): of those that begin at different samples the
    middle one, which is the farthest from a soft start and stop."""
    count, rest = divmod(C.shape[1], length)
    offsets = np.unique(np.linspace(0, length - 1 if count > _FEWEST else rest, _OFFSETS).astype(int))
    runs = [(offset, *_longest_run(C[:, offset:], length)) for offset in offsets.tolist()]
    most = max((stop - start for _, start, stop in runs), default=0)
    if most < _FEWEST:
        raise LogTimeError(
            f"{log.path.name} has {most} periods of {length * log.dt:.4g} s that repeat (at least {_FEWEST}).",
            where=log.path.name,
            found=float(most),
            limit=float(_FEWEST),
            advice="Record longer, or give the period with period_s.",
        )
    begins = sorted(offset + length * start for offset, start, stop in runs if stop - start == most)
    begin = begins[len(begins) // 2]
    c, tau = (x[:, begin : begin + most * length].reshape(len(x), most, length) for x in (C, T))
    moving = c[_moves(C)]
    apart = float(np.mean(np.diff(moving, axis=1).var(axis=(1, 2)) / (2 * moving.var(axis=(1, 2)))))
    if apart > _REPEATS:
        raise LogTimeError(
            f"{log.path.name} does not repeat after {length * log.dt:.4g} s: its periods differ by "
            f"{100 * apart:.0f} % of its variance (limit {100 * _REPEATS:.0f} %).",
            where=log.path.name,
            found=apart,
            limit=_REPEATS,
            advice="Leave the period out, and it is found in the first log; all logs need the same one.",
        )
    return c, tau


def _longest_run(C: Array, length: int) -> tuple[int, int]:
    """First of the periods of the longest run that repeats, and the one after its last."""
    count = C.shape[1] // length
    if count < 2:
        return 0, count
    c = C[:, : count * length].reshape(len(C), count, length)
    steps = (np.diff(c, axis=1) ** 2).sum(axis=(0, 2))
    edges = [0, *(int(k) + 1 for k in np.flatnonzero(steps > _STRAYS * steps.min())), count]
    return max(pairwise(edges), key=lambda run: run[1] - run[0])


def _spectra(x: Array, bins: int) -> np.ndarray:
    """Of each period, without the mean, (n, periods, bins)."""
    return np.asarray(fft.rfft(x, axis=2)[:, :, 1 : bins + 1] / x.shape[2])


def _excited(C: np.ndarray) -> np.ndarray:
    """Whether any coordinate moves more than its noise, (bins,)."""
    periods, bins = C.shape[1:]
    mean, noise = np.abs(C.mean(axis=1)) ** 2, C.var(axis=1, ddof=1) / periods
    limit = max(_EXCITED, 1 / float(f_quantile(_FALSE / bins, 2 * (periods - 1), 2)))
    return np.asarray((mean > limit * noise + 1e-20 * mean.max()).any(axis=0))


def _estimated(spectra: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, Array, int]:
    """G = C T^+ of the means, its variance from what single periods differ by, and the degrees of freedom of that.

    Args:
        spectra: of positions and torques of each log, (n, periods, bins).
    """
    means = [np.array([part[k].mean(axis=1).T for part in spectra]).transpose(1, 2, 0) for k in (0, 1)]
    C, T = means  # (bins, n, logs)
    G = C @ np.linalg.pinv(T)
    dof = sum(c.shape[1] - 1 for c, _ in spectra)
    noise = np.zeros(C.shape[:2])
    for c, tau in spectra:
        v = (c - c.mean(axis=1, keepdims=True)) - np.einsum("bij,jpb->ipb", G, tau - tau.mean(axis=1, keepdims=True))
        noise += (np.abs(v) ** 2).sum(axis=1).T
    periods = np.array([c.shape[1] for c, _ in spectra])
    back = np.linalg.pinv(T)  # (bins, logs, n): noise of a log's mean reaches G by it
    spread = np.einsum("bej,e->bj", np.abs(back) ** 2, 1 / periods)
    return G, (noise / dof)[:, :, None] * spread[:, None, :], dof


def _two_inertias(
    s: np.ndarray, link: float, stiffness: float, rotor: float, damping: float, motor: float, joint: float
) -> np.ndarray:
    """Dynamic stiffness of a rotor with a link behind a spring and damper; friction of motor and joint is viscous."""
    load, bend = link * s**2 + joint * s, stiffness + damping * s
    return np.asarray(rotor * s**2 + motor * s + load * bend / (load + bend))


def _fitted_spring(label: str, f: Array, Z: np.ndarray, variance: Array, dof: int) -> Spring:
    """Weighted least squares of the dynamic stiffness, from several frequencies of the link.

    Weights are of estimated variances: their mean is dof / (dof - 1) times that of the true ones.
    """
    from scipy import optimize  # slow to import, and few logs are of a multisine

    s, sigma = 2j * np.pi * f, np.sqrt(0.5 * variance)
    if len(f) < _BINS:
        raise _hidden(label, f, f"{len(f)} frequencies are excited (at least {_BINS})")
    inertia = float(np.median(np.abs(Z) / np.abs(s) ** 2))

    def error(p: Array) -> Array:
        e = (_two_inertias(s, *np.exp(p[:3]), *p[3:]) - Z) / sigma
        return np.concatenate([e.real, e.imag])

    fits = []
    for times in _STARTS:
        w = 2 * np.pi * times * float(f[-1])
        link = 0.5 * inertia
        start = [np.log(link), np.log(link * w**2), np.log(link), 0.06 * link * w, 0.1 * link * w, 0.1 * link * w]
        fits.append(optimize.least_squares(error, start, x_scale="jac", max_nfev=400))
    best = min(fits, key=lambda fit: fit.cost)
    left = 2 * len(f) - _PARAMETERS
    misfit, weights = 2 * best.cost / left, dof / (dof - 1)
    covariance = np.linalg.pinv(best.jac.T @ best.jac, hermitian=True) * max(misfit, weights)
    link, stiffness, rotor = np.exp(best.x[:3])
    se = float(stiffness * np.sqrt(covariance[1, 1]))
    if not se < 0.5 * stiffness:
        raise _hidden(label, f, f"the stiffness would be {stiffness:.3g} with a standard error of {se:.2g}")
    damping, rotor_friction, link_friction = (float(x) for x in best.x[3:])
    relative = error(best.x) * np.tile(sigma / np.abs(Z), 2)
    return Spring(
        float(stiffness),
        se,
        left,
        damping,
        link=float(link),
        rotor=float(rotor),
        link_friction=link_friction,
        rotor_friction=rotor_friction,
        misfit=float(misfit / weights),
        error=float(np.sqrt(2 * np.mean(relative**2))),
    )


def _hidden(label: str, f: Array, why: str) -> IdentifiabilityError:
    """The error of a frequency response that shows no spring."""
    highest = float(f[-1]) if len(f) else 0.0
    return IdentifiabilityError(
        f"the frequency response of {label} up to {highest:.3g} Hz shows no spring: {why}.",
        where=label,
        found=highest,
        advice=f"Excite up to {2 * highest:.3g} Hz; if that shows nothing either, the motor is rigid for it.",
    )
