"""A recorded log against the motion that was planned: time scale, missing parts, tracking and clipped torque."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy import optimize

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device import Device
from haptid.errors import LogFileError
from haptid.experiment.excitation.samples import MotionSamples
from haptid.log import Log
from haptid.motion.channels import position_map
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment

# Time scales that are tried: from a slow rehearsal to a controller that runs too fast.
_SPEEDS = np.unique(np.concatenate([np.geomspace(0.08, 4.0, 160), [0.1, 0.2, 0.25, 0.5, 1.0, 2.0]]))
# Samples of the plan at which paths are compared, and the fewest of a log.
_POINTS, _FEWEST = 400, 20
# Relative difference of the time scale that is a finding: clocks differ by less.
_CLOCK = 2e-3
# Part of the plan that may be missing, or stood still, s: the ramps end at rest.
_SHORT = 0.1
# Share of the log's motion that a plan explains at least, if the log is of it.
_EXPLAINED = 0.75
# Relative to the stroke: largest motion at standstill, and least motion of the plan in a missing part.
_STILL, _ON = 1e-3, 0.02
# Tracking error, relative to the stroke, that is a finding.
_WORTH = 0.02
# Samples in a row at the same extreme torque that are clipped, and the relative rounding of equal samples.
_ROW, _EQUAL = 4, 1e-9


@dataclass(frozen=True, eq=False)
class PlayedMotion:
    """A planned motion as it was recorded: time scale, missing parts, tracking error, clipped torque.

    Attributes:
        joints: names of the active joints.
        speed: of the recording over that of the plan.
        start: time of the log at which the motion begins, s.
        missing: seconds of the plan, at its own speed, before the log begins and after it ends.
        stopped: time of the plan from which the device stands still although the motion goes on, s, or None.
        explained: share of the variance of the log's positions.
        rms, largest: tracking error of each joint, (active,), rad or m.
        worst: time of the plan of the largest error of each joint, (active,), s.
        stroke: range of each joint in the plan, (active,), rad or m.
        clipped: share of the samples of each torque channel that are at its extreme value in a row, (torques,).
        extreme: that value, (torques,), in the log's unit.
        rates: samples per second of plan and log.
    """

    joints: tuple[str, ...]
    speed: float
    start: float
    missing: tuple[float, float]
    stopped: float | None
    explained: float
    rms: Array
    largest: Array
    worst: Array
    stroke: Array
    clipped: Array
    extreme: Array
    rates: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("rms", "largest", "worst", "stroke", "clipped", "extreme"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    @property
    def same_motion(self) -> bool:
        """Whether the log is of this motion at all."""
        return self.explained > _EXPLAINED

    @property
    def sentences(self) -> tuple[str, ...]:
        """Findings, the gravest first; one that the motion was played as planned where there is none."""
        return tuple(self._findings()) or (
            "The log is the planned motion; largest tracking error "
            f"{100 * float((self.largest / self.stroke).max()):.2g} % of a joint's stroke.",
        )

    def _findings(self) -> Iterator[str]:
        if not self.same_motion:
            yield (
                f"The log is not of this motion: at best {max(100 * self.explained, 0.0):.3g} % of the variance of "
                "its positions are explained. Give the plan that was played, or the joints in its order."
            )
            return
        if abs(self.speed - 1) > _CLOCK:
            plan, log = self.rates
            yield (
                f"The motion was played at {self.speed:.4g} times its planned speed. If that was no rehearsal, the "
                f"controller plays {self.speed * plan:.4g} samples a second in place of {plan:.5g}, or the log's times "
                f"are wrong ({log:.4g} rows a second)."
            )
        before, after = self.missing
        if before > _SHORT:
            yield f"The first {before:.3g} s of the motion are missing in the log: begin to record earlier."
        if after > _SHORT:
            yield f"The last {after:.3g} s of the motion are missing in the log: record until the end."
        if self.stopped is not None:
            yield (
                f"The device stands still from {self.stopped:.3g} s of the motion on, although the plan goes on: the "
                "controller stopped it."
            )
        elif float((self.largest / self.stroke).max()) > _WORTH:
            k = int(np.argmax(self.largest / self.stroke))
            share = 100 * self.largest[k] / self.stroke[k]
            yield (
                f"Joint {self.joints[k]} is up to {self.largest[k]:.3g} from its plan ({share:.2g} % of its stroke, at "
                f"{self.worst[k]:.3g} s; {self.rms[k]:.2g} in the mean square): identification takes what was "
                "recorded, but limits were checked on the plan."
            )
        for k in np.flatnonzero(self.clipped > 0).tolist():
            yield (
                f"Torque channel {k + 1} is clipped at +-{self.extreme[k]:.4g} in {100 * self.clipped[k]:.2g} % of the "
                "samples: if it is the command, the motor gave less; plan with a lower torque."
            )


def compare_with_plan(log: Log, plan: MotionSamples, device: Device) -> PlayedMotion:
    """Find a planned motion in a log, and compare the two.

    Time scale and start are those of the least squared distance of the positions, on a grid and then refined; one
    constant offset of each joint is left out, as of an encoder without a home.

    Raises:
        LogMismatchError: the log has more or fewer channels than the device has coordinates.
        LogFileError: nothing moves in the log.
    """
    treated = treat(log, Treatment(cutoff_hz=None))
    rows = position_map(device, treated)(np.asarray(treated.q, dtype=float).T)
    q: Array = np.asarray(np.linalg.solve(device.row_map, rows).T, dtype=np.float64)
    t, stroke = np.asarray(log.t - log.t[0], dtype=float), np.maximum(np.ptp(plan.q, axis=0), np.finfo(float).tiny)
    part = _moving(q, stroke)
    if part.stop - part.start < _FEWEST:
        raise LogFileError(
            f"{log.path}: nothing moves in it.", where=log.path, advice="Give the log in which the motion was played."
        )
    speed, start = _found(t[part], q[part], plan, stroke)
    at, total = speed * (t - start), float(plan.t[-1])
    moved = at[part]
    error = q[part] - _at(plan, moved)
    error = error - np.median(error, axis=0)
    k = np.argmax(np.abs(error), axis=0)
    explained = 1 - float(((error / stroke) ** 2).mean(axis=0).sum() / (q[part] / stroke).var(axis=0).sum())
    # The plan goes on after the last motion of the log: it ends there, or the device stood still.
    rest = plan.q[plan.t >= min(float(moved[-1]), total)]
    goes_on = bool((np.ptp(rest, axis=0) > _ON * stroke).any())
    stood = (float(t[-1]) - float(t[part][-1])) > _SHORT
    before = plan.q[plan.t <= max(float(moved[0]), 0.0)]
    begins_late = bool((np.ptp(before, axis=0) > _ON * stroke).any())
    clipped, extreme = _clipped(np.asarray(log.torque))
    return PlayedMotion(
        plan.joints,
        speed,
        float(start + log.t[0]),
        (float(moved[0]) if begins_late else 0.0, total - float(moved[-1]) if goes_on and not stood else 0.0),
        float(moved[-1]) if goes_on and stood else None,
        explained,
        np.sqrt((error**2).mean(axis=0)),
        np.abs(error).max(axis=0),
        moved[k],
        stroke,
        clipped,
        extreme,
        (plan.rate_hz, (len(t) - 1) / float(t[-1])),
    )


def read_motion(path: str | Path, device: Device) -> MotionSamples:
    """Read the samples that `haptid excite` wrote as CSV.

    Raises:
        LogFileError: it is no such file, or of other joints.
    """
    joints = [device.joints[j] for j in device.active]
    names = tuple(joint.name for joint in joints)
    head = ["t", *(f"{prefix}{name}" for prefix in ("q", "qd", "qdd") for name in names)]
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            found = next(csv.reader(file), [])
            values = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise LogFileError(f"{path}: cannot be read ({error}).", where=str(path)) from error
    if found != head or len(values) < 2 or values.shape[1] != len(head):
        raise LogFileError(
            f"{path}: is not a motion of this device: its columns are {', '.join(found[:12])}.",
            where=str(path),
            found=tuple(found),
            limit=tuple(head),
            advice="Give the CSV that `haptid excite` wrote beside the experiment.",
        )
    t, q, qd, qdd = values[:, 0], *np.split(values[:, 1:], 3, axis=1)
    rate = (len(t) - 1) / float(t[-1] - t[0])
    aliases = tuple(joint.alias or joint.name for joint in joints)
    return MotionSamples(device.name, names, aliases, tuple(j.prismatic for j in joints), rate, q, qd, qdd)


def _found(t: Array, q: Array, plan: MotionSamples, size: Array) -> tuple[float, float]:
    """Time scale and start of the plan in the log, s; before and after the plan rests at its ends."""
    dt = float(plan.t[-1]) / _POINTS
    wanted = np.column_stack([np.interp(dt * np.arange(_POINTS + 1), plan.t, x) for x in plan.q.T]) / size
    best = (np.inf, 1.0, 0.0)
    for speed in _SPEEDS.tolist():
        grid = np.arange(t[0], t[-1], dt / speed)
        if _FEWEST <= len(grid) <= 4 * _POINTS:
            there = np.column_stack([np.interp(grid, t, x) for x in q.T]) / size
            distance, lag = _distance(there, wanted)
            best = min(best, (distance, speed, float(t[0]) - lag * dt / speed))
    stride = max(1, len(t) // 4000)

    def variance(x: Array) -> float:
        return float(((q[::stride] - _at(plan, x[0] * (t[::stride] - x[1]))) / size).var(axis=0).sum())

    begin = np.array([[best[1], best[2]], [best[1] * 1.01, best[2]], [best[1], best[2] + 2 * dt / best[1]]])
    settings = {"initial_simplex": begin, "xatol": 1e-6, "fatol": 1e-12, "maxiter": 300}
    found = optimize.minimize(variance, begin[0], method="Nelder-Mead", options=settings)
    return float(found.x[0]), float(found.x[1])


def _at(plan: MotionSamples, times: Array) -> Array:
    """Positions of the plan, (n, active); at its ends before and after it."""
    return np.column_stack([np.interp(times, plan.t, x) for x in plan.q.T])


def _distance(there: Array, wanted: Array) -> tuple[float, int]:
    """Least variance of the difference over all lags, and the sample of the plan at which the log begins."""
    from scipy import signal  # slow to import, and few commands compare a log with its plan

    n, total = len(there), np.zeros(len(wanted) + len(there) + 1)
    for x, w in zip(there.T, wanted.T, strict=True):
        padded = np.concatenate([np.full(n, w[0]), w, np.full(n, w[-1])])
        products = signal.correlate(padded, x, mode="valid")
        sums, squares = (signal.correlate(one, np.ones(n), mode="valid") for one in (padded, padded**2))
        total += (squares - 2 * products + (x**2).sum()) / n - ((sums - x.sum()) / n) ** 2
    k = int(np.argmin(total))
    return float(total[k]), k - n


def _moving(q: Array, size: Array) -> slice:
    """The log without the standstill before and after."""
    starts = (np.abs(q - q[0]) > _STILL * size).any(axis=1)
    ends = (np.abs(q - q[-1]) > _STILL * size).any(axis=1)
    return slice(int(np.argmax(starts)), len(q) - int(np.argmax(ends[::-1])))


def _clipped(tau: Array) -> tuple[Array, Array]:
    """Share of samples of each channel in rows of equal extreme values, and that value, (torques,) each."""
    shares, extremes = [], []
    for x in tau.T:
        most = float(np.abs(x).max())
        there = np.abs(np.abs(x) - most) <= _EQUAL * most if most else np.zeros(len(x), dtype=bool)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
        lengths = edges[1::2] - edges[::2]
        shares.append(float(lengths[lengths >= _ROW].sum()) / len(x))
        extremes.append(most)
    return np.array(shares), np.array(extremes)
