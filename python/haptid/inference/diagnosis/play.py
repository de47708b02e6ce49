"""Is there play between a motor and its link? From the motors' side alone: what the torque lacks where links are loose.

The residual's shape is known but for the size of the play and how inertia and friction are divided between motor and
link. So these three are searched, and play is named only where they explain most of the residual, at the size that
mechanics gives it: nothing else that a rigid model lacks is absent exactly between two changes of a torque's sign.
The rows of a fit are too slow for that: links cross the play in a hundredth of a second or few. Rows of their own have
wider filters.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.errors import HaptidError
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding
from haptid.log.spectrum import bandwidth
from haptid.motion.motion import treat
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk
from haptid.simulation.play import LooseLinks
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import half_width

# Length of log that is looked at, s, and its most samples.
_SECONDS, _SAMPLES = 15.0, 20_000
# Filters of positions and torque over the motion's bandwidth, and others, whose effect on the size is in its interval.
_FILTERS, _OTHERS = (20.0, 8.0), (10.0, 5.0)
# Rows in a period of the torque filter's cut-off.
_ROWS = 5.0
# Sizes that are tried, over the range of the positions, with shares of the link in inertia and friction.
_SIZES, _SHARES, _FRICTION = np.geomspace(2e-4, 0.06, 12), (0.4, 0.65, 0.9), 0.65
# Play is named where it explains this share of the residual, with a factor on its torque between these two limits;
# it is searched from half of that on, and at all shares of the link where it explains a quarter at the middle one.
_EXPLAINED, _LEAST, _MOST = 0.5, 0.6, 1.6
# What the model of a loose link errs by, of the logarithm of a size: how friction is divided between motor and link is
# hardly seen, and moves the size (`benchmarks/play.py`).
_MODEL = 0.25
# Clusters of the rows.
_CLUSTERS = 30
# Steps of the search, differences for its slopes (of the logarithm of the size, and of both shares), and its bounds.
_STEPS, _FALL, _DIFFERENCES = 10, 1e-3, np.array([0.04, 0.03, 0.05])
_LOW, _HIGH = np.array([-np.inf, 0.05, 0.0]), np.array([np.inf, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Fit:
    """Play behind one motor that explains its residual best.

    Attributes:
        at: logarithm of its size, shares of the link in inertia and friction, (3,).
        error: the residual, (rows,).
        torque: of the play, (rows,).
        slope: of the torque, (3, rows).
    """

    at: Array
    error: Array
    torque: Array
    slope: Array

    @property
    def misfit(self) -> float:
        """What is left of the residual power."""
        return float(np.sum((self.error - self.torque) ** 2))

    @property
    def explained(self) -> float:
        """Share of the residual power."""
        return 1 - self.misfit / float(self.error @ self.error)

    def named(self, tests: int) -> bool:
        """Whether it explains enough, and is significant, with the torque that mechanics gives it.

        Args:
            tests: number of values that it was chosen from.
        """
        power = float(self.torque @ self.torque)
        times = float(self.torque @ self.error) / power
        score = self._scores(self.torque[None], self.error - times * self.torque)
        p = 2 * float(t_tail(times * power / np.sqrt(np.sum(score**2)), _CLUSTERS - 1))
        return self.explained > _EXPLAINED and _LEAST < times < _MOST and p * tests < SIGNIFICANCE

    def size(self, doubt: float) -> tuple[float, float, float]:
        """Size of the play, and its 95 % interval, rad or m.

        Args:
            doubt: by how much else its logarithm may be off.
        """
        J = self.slope[(self.at > _LOW + 1e-9) & (self.at < _HIGH - 1e-9)]
        bread = np.linalg.pinv(J @ J.T, hermitian=True)
        scores = self._scores(J, self.error - self.torque)
        variance = (bread @ scores @ scores.T @ bread)[0, 0] * _CLUSTERS / (_CLUSTERS - 1)
        half = float(half_width(np.sqrt(variance), _CLUSTERS - 1)) + doubt + _MODEL
        low, middle, high = np.exp(self.at[0] + np.array([-half, 0.0, half])).tolist()
        return middle, low, high

    @staticmethod
    def _scores(columns: Array, left: Array) -> Array:
        """Of each cluster of rows, (columns, clusters)."""
        parts = np.array_split(np.arange(len(left)), _CLUSTERS)
        return np.array([columns[:, own] @ left[own] for own in parts]).T


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one log with filters wide enough for play.

    Attributes:
        chunk: all rows.
        links: of the device's rows.
        error: what the model's columns do not explain, of each motor, (rows,).
        columns: orthonormal ones of the model, (rows, p).
    """

    chunk: Chunk
    links: LooseLinks
    error: list[Array]
    columns: list[Array]

    def changes(self, motor: int, made: Array) -> Array:
        """Changes of torque, (cases, samples), as rows, without what the model's columns explain, (cases, rows)."""
        rows = self.chunk.filtered(made)[:, self.chunk.used[motor]]
        Q = self.columns[motor]
        return np.asarray(rows - (rows @ Q) @ Q.T)


def transmission_play(estimate: Estimate) -> Finding | None:
    """The test of all motors; None where the device has springs, or where the log does not permit it."""
    rows = _rows(estimate, *_FILTERS)
    if rows is None:
        return None
    found = {motor: fit for motor, fit in enumerate(_found(rows)) if fit is not None}
    others = _rows(estimate, *_OTHERS) if found else None
    figures, named = dict[str, float](), list[str]()
    for motor, fit in found.items():
        again = _searched(others, motor, fit.at) if others else None
        size, low, high = fit.size(0.0 if again is None else abs(float(again.at[0] - fit.at[0])))
        label = estimate.observation.motors[motor].label
        unit = estimate.model.device.coordinate_units[device_rows(estimate)[motor]]
        figures |= {f"{label}, {name}": value for name, value in (("play", size), ("low", low), ("high", high))}
        figures[f"{label}, explained"] = fit.explained
        named.append(
            f"{label}, {size:.2g} {unit} from end to end ({low:.2g} .. {high:.2g} at 95 %), which explains "
            f"{100 * fit.explained:.0f} % of the fast residual"
        )
    if not named:
        return Finding("play", "ok", figures, "No sign of play between motors and links.")
    text = (
        f"Play (backlash, a loose cable) between motor and link: {'; '.join(named)}. Take it up, or bias the motion so "
        f"that the link's torque keeps its sign; to identify with it, record both sides and add an elastic term with "
        f"`play`."
    )
    return Finding("play", "bad", figures, text)


def _rows(estimate: Estimate, position: float, torque: float) -> _Rows | None:
    """Rows of the busiest part of the first log.

    Args:
        estimate: whose log.
        position, torque: cut-offs of their filters over the motion's bandwidth.
    """
    model, motion = estimate.model, estimate.observation.motions[0]
    if model.device.elastic or motion.log is None:
        return None
    whole = motion.log.busiest(min(_SECONDS, _SAMPLES * motion.dt))
    log = max(whole.parts(), key=lambda part: len(part.t))
    highest = bandwidth(log)
    if not 0 < 2 * position * highest * motion.dt < 1:
        return None
    wide = replace(
        motion.treatment,
        formulation="acceleration",
        cutoff_hz=position * highest,
        parallel_cutoff_hz=torque * highest,
        decimation=max(1, round(1 / (_ROWS * torque * highest * motion.dt))),
    )
    try:
        plan = Plan.of(model, treat(log, wide))
        chunk = Chunk.of(plan, 0, plan.rows)
        used = chunk.used
    except HaptidError:
        return None
    own = device_rows(estimate)
    if own != list(model.known_rows) or used.sum(axis=1).min() < _CLUSTERS:
        return None
    chi = raw_parameters(model, estimate.beta)
    error, columns = [], []
    for k, left in enumerate(chunk.y - chunk.torque(chi) * used):
        W = chunk.W[k][used[k]]
        Q = np.linalg.qr(W[:, W.any(axis=0)])[0]
        e = left[used[k]]
        error.append(e - Q @ (Q.T @ e))
        columns.append(Q)
    return _Rows(chunk, _loose(chunk, chi, own), error, columns)


def _loose(chunk: Chunk, chi: Array, rows: list[int]) -> LooseLinks:
    """What the rigid model says of the motors' motion."""
    model, (c, cd, cdd, own) = chunk.model, chunk.signals
    assert cdd is not None
    links = 10 * len(model.device.joints)
    is_friction = np.array([False] * links + [term.resists for term in model.terms])
    core = chunk.plan.for_core(model)

    def torque(part: Array) -> Array:
        return np.asarray(core_torque(core, part, c, cd, cdd, own)[rows])

    inertia = ForwardDynamics(core, chi).mass(c)[:, rows, rows].T
    motion = c[rows], cd[rows], cdd[rows]
    return LooseLinks.of(chunk.plan.motion.dt, motion, torque(chi), torque(np.where(is_friction, chi, 0.0)), inertia)


def _found(rows: _Rows) -> list[_Fit | None]:
    """The play behind every motor, None where there is no sign of it."""
    cases, ranges = np.array(list(product(_SIZES, _SHARES))), np.ptp(rows.links.x, axis=1)
    # The share of the link changes little of what play explains, and few motors have any.
    first = _made(rows.links, ranges, cases[len(_SHARES) // 2 :: len(_SHARES)])
    found: list[_Fit | None] = []
    for motor in range(len(ranges)):
        fit = None
        if _best(rows, motor, first[motor], 0.25)[1] > 0.25 * _EXPLAINED:
            best, explained = _best(
                rows, motor, _made(rows.links.alone(motor), ranges[motor : motor + 1], cases)[0], 0.5
            )
            if explained > 0.5 * _EXPLAINED:
                size, share = cases[best]
                fit = _searched(rows, motor, np.array([np.log(size * ranges[motor]), share, _FRICTION]))
        found.append(fit if fit and fit.named(len(cases)) else None)
    return found


def _made(links: LooseLinks, ranges: Array, cases: Array) -> Array:
    """Changes of torque, (motors, cases, samples).

    Args:
        links: of the motors.
        ranges: of their positions, (motors,), rad or m.
        cases: size over the range, and share of the link in inertia, (cases, 2).
    """
    size, share = np.multiply.outer(ranges, cases[:, 0]), np.tile(cases[:, 1], (len(ranges), 1))
    return links.change(size, share, np.full_like(share, _FRICTION))


def _best(rows: _Rows, motor: int, made: Array, strict: float) -> tuple[int, float]:
    """The change of torque, of (cases, samples), that explains most of a motor's residual, and the share of its power.

    Args:
        strict: the limits of the factor on its torque are wider by this.
    """
    r, e = rows.changes(motor, made), rows.error[motor]
    along, power = r @ e, (r**2).sum(axis=1)
    explained = along**2 / np.where(power > 0, power, np.inf) / max(float(e @ e), np.finfo(float).tiny)
    plausible = (along > strict * _LEAST * power) & (along < _MOST / strict * power)
    explained = np.where(plausible, explained, 0.0)
    best = int(np.argmax(explained))
    return best, float(explained[best])


def _searched(rows: _Rows, motor: int, at: Array) -> _Fit:
    """The play of least squares behind a motor, from a first value, by Marquardt's steps.

    Args:
        at: logarithm of its size, shares of the link in inertia and friction, (3,).
    """
    best, marquardt = _linearised(rows, motor, at), 1e-2
    for _ in range(_STEPS):
        A, left = best.slope @ best.slope.T, best.error - best.torque
        damped = A + np.diag(marquardt * np.diag(A) + 1e-12 * np.trace(A))
        step = np.clip(np.linalg.solve(damped, best.slope @ left), -0.4, 0.4)
        tried = _linearised(rows, motor, np.clip(best.at + step, _LOW, _HIGH))
        if not tried.misfit < best.misfit:
            marquardt *= 10
            continue
        small, best, marquardt = tried.misfit > (1 - _FALL) * best.misfit, tried, 0.2 * marquardt
        if small:
            break
    return best


def _linearised(rows: _Rows, motor: int, at: Array) -> _Fit:
    """The torque of a play behind a motor and its slopes, by central differences."""
    steps = np.concatenate([np.zeros((1, 3)), np.diag(_DIFFERENCES), -np.diag(_DIFFERENCES)])
    cases = np.clip(at + steps, _LOW, _HIGH)
    change = rows.links.alone(motor).change(np.exp(cases[None, :, 0]), cases[None, :, 1], cases[None, :, 2])
    made = rows.changes(motor, change[0])
    spread = np.diag(cases[1:4] - cases[4:])
    return _Fit(at, rows.error[motor], made[0], (made[1:4] - made[4:]) / spread[:, None])
