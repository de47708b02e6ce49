"""Frequency response of a device from logs of a periodic motion, with its variance from the periods, without a model.

A motion that repeats (a multisine under a controller) gives in every period the same spectra but for noise. Their means
over the periods of positions and torques, of as many logs as there are motors, are C = G T in each bin: the compliance
G. What each period differs by is its noise. Source: Pintelon and Schoukens (2012), System Identification: A Frequency
Domain Approach, 2nd ed., sections 2.7 (periodic measurements) and 2.8 (several inputs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import fft

from haptid._internal.arrays import Array, freeze_fields
from haptid.dynamics.counterparts import with_stiff_springs
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, LogTimeError
from haptid.log import Log
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.uncertainty.distributions import f_quantile

# Periods that are needed, and how many times as much as the median neighbours may differ within a motion that repeats.
_FEWEST, _STRAYS = 3, 9.0
# A bin is excited where the ratio of the mean's power to that of its noise is at least the first number, and above what
# noise alone reaches in any bin with the second as probability; none is beyond this share of the sampling rate.
_EXCITED, _FALSE, _HIGHEST = 30.0, 1e-3, 0.4
# Largest difference of a motion from itself a period later, over its variance, and how far above the least it may be.
_REPEATS, _NEAR = 0.05, 4.0
# Frequencies of a link that a fit begins with, over the range of the bins.
_STARTS = (0.5, 1.0, 2.0, 4.0)
# Fewest bins for a spring, and parameters of one.
_BINS, _PARAMETERS = 6, 6


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Compliance of a device at the frequencies that its logs excite.

    Attributes:
        labels: of the coordinates, (n,).
        f: Hz, (bins,).
        G: position by torque, complex, (bins, n, n), rad/(N m) and so on.
        variance: of each, E|G - true|^2, (bins, n, n).
        dof: degrees of freedom of the noise, from periods and logs.
        period: s.
    """

    labels: tuple[str, ...]
    f: Array
    G: np.ndarray
    variance: Array
    dof: int
    period: float

    def __post_init__(self) -> None:
        freeze_fields(self, "f", "variance")

    @property
    def radius(self) -> Array:
        """Radius of the circle about each G that holds the true value at 95 %, (bins, n, n)."""
        return np.asarray(np.sqrt(self.variance * f_quantile(0.95, 2, 2 * self.dof)))

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


@dataclass(frozen=True)
class Spring:
    """A spring behind a motor, from its frequency response.

    Attributes:
        stiffness, se: N m/rad or N/m.
        damping, link, rotor: of spring, and both inertias.
        misfit: mean square of the error in standard errors: one where the model is right.
    """

    stiffness: float
    se: float
    damping: float
    link: float
    rotor: float
    misfit: float

    @property
    def antiresonance(self) -> float:
        """Frequency of the link on its spring, the motor held, Hz."""
        return float(np.sqrt(self.stiffness / self.link) / (2 * np.pi))


def multisine_response(
    model: DynamicModel,
    logs: Log | Sequence[Log],
    period_s: float | None = None,
    torque_delay_s: float | None = None,
) -> FrequencyResponse:
    """Frequency response at the motors' side from logs of a periodic motion; as many logs as motors, or more.

    Args:
        model: the dynamic model; elastic motors count as rigid.
        logs: recordings, each of another motion with the same period.
        period_s: period of the motion; found where None.
        torque_delay_s: of the torque; half a sampling period, as of a command that is held, where None.

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
    late = np.exp(-2j * np.pi * f * (0.5 * dt if torque_delay_s is None else torque_delay_s))
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
    return _estimated(labels, f[excited], [(C[..., excited], T[..., excited]) for C, T in spectra], length * dt)


def _signals(model: DynamicModel, log: Log) -> tuple[Array, Array]:
    """Position and torque of the coordinates, each (n, samples)."""
    motion = treat(log, Treatment(cutoff_hz=None))
    c = position_map(model.device, motion)(np.ascontiguousarray(np.asarray(motion.q[:]).T))
    return c, coordinate_torque(model.device, motion, 0, len(motion))


def _period(C: Array, log: Log) -> int:
    """Samples after which a motion repeats, from the mean square of its difference from itself."""
    x = C - C.mean(axis=1, keepdims=True)
    n, scale = x.shape[1], x.var(axis=1, keepdims=True)
    x = x / np.sqrt(np.where(scale > 0, scale, 1.0))
    size = fft.next_fast_len(2 * n, real=True)
    products = fft.irfft(np.abs(fft.rfft(x, size)) ** 2, size)[:, :n].sum(axis=0)
    power = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=0))])
    lag = np.arange(n)
    apart = (power[n] - power[lag] + power[n - lag] - 2 * products) / np.maximum(n - lag, 1) / (2 * len(x))
    most = n // _FEWEST
    first = int(np.argmax(apart[:most] > 0.5))  # the motion has left its beginning
    found = apart[first:most]
    if not first or not len(found) or found.min() > _REPEATS:
        raise LogTimeError(
            f"{log.path.name} has no motion that repeats {_FEWEST} times: it differs from itself by "
            f"{100 * found.min(initial=1.0):.0f} % of its variance at least (limit {100 * _REPEATS:.0f} %).",
            where=log.path.name,
            found=float(found.min(initial=1.0)),
            limit=_REPEATS,
            advice=f"Record a multisine whose frequencies are multiples of one, for {_FEWEST} periods or more.",
        )
    near = np.flatnonzero(found < _NEAR * found.min() + 1e-6)
    group = near[: int(np.argmax(np.append(np.diff(near), 2) > 1)) + 1]  # of neighbouring lags, the first
    return first + int(group[np.argmin(found[group])])


def _periods(C: Array, T: Array, length: int, log: Log) -> tuple[Array, Array]:
    """The longest run of periods that repeat, each (n, periods, samples)."""
    count = C.shape[1] // length
    c, tau = (x[:, x.shape[1] - count * length :].reshape(len(x), count, length) for x in (C, T))
    steps = (np.diff(c, axis=1) ** 2).sum(axis=(0, 2)) if count > 1 else np.zeros(0)
    breaks = np.flatnonzero(steps > _STRAYS * np.median(steps)) if len(steps) else np.zeros(0, dtype=int)
    edges = [0, *(int(k) + 1 for k in breaks), count]
    start, stop = max(pairwise(edges), key=lambda run: run[1] - run[0])
    if stop - start < _FEWEST:
        raise LogTimeError(
            f"{log.path.name} has {stop - start} periods of {length * log.dt:.4g} s that repeat (at least {_FEWEST}).",
            where=log.path.name,
            found=float(stop - start),
            limit=float(_FEWEST),
            advice="Record longer, or give the period with period_s.",
        )
    return c[:, start:stop], tau[:, start:stop]


def _spectra(x: Array, bins: int) -> np.ndarray:
    """Of each period, without the mean, (n, periods, bins)."""
    return np.asarray(fft.rfft(x, axis=2)[:, :, 1 : bins + 1] / x.shape[2])


def _excited(C: np.ndarray) -> np.ndarray:
    """Whether any coordinate moves more than its noise, (bins,)."""
    periods, bins = C.shape[1:]
    mean, noise = np.abs(C.mean(axis=1)) ** 2, C.var(axis=1, ddof=1) / periods
    limit = max(_EXCITED, 1 / float(f_quantile(_FALSE / bins, 2 * (periods - 1), 2)))
    return np.asarray((mean > limit * noise + 1e-20 * mean.max()).any(axis=0))


def _estimated(
    labels: tuple[str, ...], f: Array, spectra: Sequence[tuple[np.ndarray, np.ndarray]], period: float
) -> FrequencyResponse:
    """G = C T^+ of the means, and its variance from what single periods differ by.

    Args:
        labels: of the coordinates.
        f: frequencies of the bins, Hz.
        spectra: of positions and torques of each log, (n, periods, bins).
        period: s.
    """
    means = [np.array([part[k].mean(axis=1).T for part in spectra]).transpose(1, 2, 0) for k in (0, 1)]
    C, T = means  # (bins, n, logs)
    G = C @ np.linalg.pinv(T)
    dof = sum(c.shape[1] - 1 for c, _ in spectra)
    noise = np.zeros((len(f), len(labels)))
    for c, tau in spectra:
        v = (c - c.mean(axis=1, keepdims=True)) - np.einsum("bij,jpb->ipb", G, tau - tau.mean(axis=1, keepdims=True))
        noise += (np.abs(v) ** 2).sum(axis=1).T
    periods = np.array([c.shape[1] for c, _ in spectra])
    back = np.linalg.pinv(T)  # (bins, logs, n): noise of a log's mean reaches G by it
    spread = np.einsum("bej,e->bj", np.abs(back) ** 2, 1 / periods)
    return FrequencyResponse(labels, f, G, (noise / dof)[:, :, None] * spread[:, None, :], dof, period)


def _fitted_spring(label: str, f: Array, Z: np.ndarray, variance: Array, dof: int) -> Spring:
    """Weighted least squares of the dynamic stiffness, from several frequencies of the link.

    Weights are of estimated variances: their mean is dof / (dof - 1) times that of the true ones.
    """
    from scipy import optimize  # slow to import, and few logs are of a multisine

    s, sigma = 2j * np.pi * f, np.sqrt(0.5 * variance)
    if len(f) < _BINS:
        raise _hidden(label, f, f"{len(f)} frequencies are excited (at least {_BINS})")
    inertia = float(np.median(np.abs(Z) / np.abs(s) ** 2))

    def parts(p: Array) -> tuple[np.ndarray, np.ndarray]:
        link, stiffness, rotor = np.exp(p[:3])
        damping, motor, joint = p[3:]
        load, bend = link * s**2 + joint * s, stiffness + damping * s
        return rotor * s**2 + motor * s + load * bend / (load + bend), load

    def error(p: Array) -> Array:
        e = (parts(p)[0] - Z) / sigma
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
    return Spring(float(stiffness), se, float(best.x[3]), float(link), float(rotor), float(misfit / weights))


def _hidden(label: str, f: Array, why: str) -> IdentifiabilityError:
    """The error of a frequency response that shows no spring."""
    highest = float(f[-1]) if len(f) else 0.0
    return IdentifiabilityError(
        f"the frequency response of {label} up to {highest:.3g} Hz shows no spring: {why}.",
        where=label,
        found=highest,
        advice=f"Excite up to {2 * highest:.3g} Hz; if that shows nothing either, the motor is rigid for it.",
    )
