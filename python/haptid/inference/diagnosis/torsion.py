"""Play and slip between motors and links that are both measured: dead zones and steps of the torsion.

A spring's torque is its stiffness times the torsion. Within the play of the transmission the torsion has no torque;
where a cable slips over its capstan, the torsion of no torque is another one from then on. Both are searched in what
the springs' columns leave of the motors' torque, with all columns fitted again beside them.

Sources: Nordin and Gutman (2002), Automatica 38(10), section 3.1, of play; Andrews (1993), Econometrica 61(4), of
changes at an unknown time.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import HaptidError
from haptid.estimation import Estimate, MotorSide
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, shown_time
from haptid.motion.motion import treat
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import half_width

# Length of log that is looked at, s; clusters of its rows, and the share of rows before the first slip and behind the
# last that tells it from an outlier.
_SECONDS, _CLUSTERS, _END = 120.0, 30, 0.03
# Share of a log's length above which it counts as looked at as a whole.
_MOST_OF = 0.9
# A slip or play is named where it explains this share of the residual; the most slips of one motor.
_SLIP, _PLAY, _MOST = 0.2, 0.5, 6
# Rows on either side of a slip that count neither for its size nor for other slips.
_NEAR = 12
# Least slip that is told, over the range of the torsion: steps of an encoder make some that are real and of no use.
_SMALL = 3e-3
# Step of the links' torque, over that of the motor's, from which on it is the zero of the torque that changed.
_ELSEWHERE = 0.5
# Sizes of play that are tried, and middles, over the range of the torsion; passes of the fit from the best of them.
_SIZES, _MIDDLES, _PASSES = np.geomspace(0.02, 0.9, 10), np.linspace(-0.3, 0.3, 9), 12
# The torque that play takes away, over that of the spring, within which it is play.
_LEAST, _LARGEST = 0.6, 1.6


@dataclass(frozen=True, eq=False)
class _Torsion:
    """Rows of one elastic motor, and of the joints that springs move.

    Attributes:
        label, unit: of the motor, and of its torsion.
        t: (rows,), s.
        X, y: columns with a constant one, (rows, p), and torque, (rows,).
        spring: place of the stiffness in the columns.
        x: torsion, (samples,), rad or m.
        chunk, used: all rows, and which of them are used.
        links: columns and torque of the rows of other coordinates where both are used, and which of these rows.
    """

    label: str
    unit: str
    t: Array
    X: Array
    y: Array
    spring: int
    x: Array
    chunk: Chunk
    used: np.ndarray
    links: list[tuple[Array, Array, np.ndarray]]

    def filtered(self, made: Array) -> Array:
        """A signal of the torsion as rows, (rows,)."""
        return np.asarray(self.chunk.filtered(made[None])[0, self.used])


def torsion_findings(estimate: Estimate) -> tuple[Finding, ...]:
    """The tests of all elastic motors; none where links are not measured, or the log does not permit them."""
    motors = list(_torsions(estimate))
    if not motors:
        return ()
    log = estimate.observation.motions[0].log
    return _slip(motors, 0.0 if log is None else len(log.t) * float(log.dt)), _play(estimate, motors)


def _torsions(estimate: Estimate) -> Iterator[_Torsion]:
    """Rows of the busiest part of the first log."""
    model, motion = estimate.model, estimate.observation.motions[0]
    if not model.device.elastic or isinstance(estimate.method, MotorSide) or motion.log is None:
        return
    try:
        log = max(motion.log.busiest(_SECONDS).parts(), key=lambda part: len(part.t))
        plan = Plan.of(model, treat(log, motion.treatment))
        chunk = Chunk.of(plan, 0, plan.rows)
        used, W, y = chunk.used, chunk.W, chunk.y
    except HaptidError:
        return
    rows, names = device_rows(estimate), {name.removesuffix("R"): k for k, name in enumerate(model.base.names)}
    places = {f"elastic {drive.name}": model.device.row_names.index(drive.name) for drive in model.device.elastic}
    for term in model.terms:
        row = places.get(term.on)
        if term.nature != "spring" or row not in rows or row not in chunk.coordinates or term.name not in names:
            continue
        k, own = chunk.coordinates.index(row), names[term.name]
        if used[k].sum() < max(_CLUSTERS, 2 * W.shape[2]):
            continue
        others = [j for j, c in enumerate(chunk.coordinates) if c not in places.values()]
        links = [(_with_one(W[j][used[k] & used[j]]), y[j][used[k] & used[j]], used[j][used[k]]) for j in others]
        X = _with_one(W[k][used[k]], own)
        label = estimate.observation.motors[rows.index(row)].label
        unit = model.device.coordinate_units[row]
        yield _Torsion(
            label, unit, chunk.t[used[k]], X, y[k][used[k]], X.shape[1] - 1, chunk.c[row], chunk, used[k], links
        )


def _with_one(W: Array, last: int | None = None) -> Array:
    """The columns that are not zero and a constant one, which is the zero of an encoder; one of them last."""
    some = [k for k in np.flatnonzero(W.any(axis=0)).tolist() if k != last]
    return np.column_stack([np.ones(len(W)), W[:, some], *([] if last is None else [W[:, last]])])


def between_slips(estimate: Estimate) -> tuple[tuple[str, ...], tuple[float, float]] | None:
    """Motors whose transmission slips, and the longest part of the first log without a slip, s; None without slips.

    A part that begins or ends with what was looked at does so with the log, if that was most of it.
    """
    motors = list(_torsions(estimate))
    found = [(motor, motor.t[k]) for motor in motors for k, _, _ in _slips(motor)]
    log = estimate.observation.motions[0].log
    if not found or log is None:
        return None
    t, at = motors[0].t, sorted(float(time) for _, time in found)
    low, high = _longest(t, at)
    if t[-1] - t[0] > _MOST_OF * len(log.t) * float(log.dt):
        low = low if low > at[0] else float(log.t[0])
        high = high if high < at[-1] else float(log.t[-1])
    return tuple(dict.fromkeys(motor.label for motor, _ in found)), (low, high)


def _slips(motor: _Torsion) -> list[tuple[int, float, float]]:
    """Row behind each slip that is worth telling, its size, and half its 95 % interval, rad or m."""
    at = sorted(_steps(motor))
    value, half_widths = _slip_sizes(motor, at)
    large = np.abs(value) > _SMALL * np.ptp(motor.x)
    return [one for one, counts in zip(zip(at, value, half_widths, strict=True), large, strict=True) if counts]


def _slip(motors: list[_Torsion], whole: float) -> Finding:
    """Steps of the torsion.

    Args:
        whole: length of the log, s.
    """
    figures, named = dict[str, float](), list[str]()
    begin, end = float(motors[0].t[0]), float(motors[0].t[-1])
    of = f" Looked for from {shown_time(begin)} to {shown_time(end)} s only, where most moves."
    of = of if end - begin < _MOST_OF * whole else ""
    for motor in motors:
        for n, (k, size, half) in enumerate(_slips(motor), 1):
            figures |= {
                f"{motor.label}, slip {n}, {what}": float(value)
                for what, value in (("at", motor.t[k]), ("size", size), ("low", size - half), ("high", size + half))
            }
            named.append(
                f"{motor.label} at {shown_time(motor.t[k])} s by {size:.3g} {motor.unit} "
                f"({size - half:.3g} .. {size + half:.3g} by the noise alone)"
            )
    if not named:
        return Finding("slip", "ok", figures, "No sign of a cable or coupling that slips." + of)
    low, high = _longest(motors[0].t, sorted(v for name, v in figures.items() if name.endswith(", at")))
    text = (
        f"The transmission slips: {'; '.join(named)}. Tighten it; to identify from this log, leave out what is not "
        f"between two slips: time_range = [{shown_time(low)}, {shown_time(high)}] in its [[logs]] is the longest "
        f"part.{of}"
    )
    return Finding("slip", "bad", figures, text)


def _longest(t: Array, at: list[float]) -> tuple[float, float]:
    """The longest time without a slip, s, clear of what the filters smear."""
    edges, near = [float(t[0]), *at, float(t[-1])], _NEAR * float(np.diff(t).min())
    k = int(np.argmax(np.diff(edges)))
    return edges[k] + near, edges[k + 1] - near


def _steps(motor: _Torsion) -> list[int]:
    """First row behind each slip, the largest first; a few rows off where the filters smear it."""
    found, rows, X = list[int](), np.arange(len(motor.y)), motor.X
    margin = max(2, int(_END * len(rows)))
    for _ in range(_MOST):
        own = _clear(rows, found)
        Q = np.linalg.qr(X[own])[0]
        e = motor.y[own] - Q @ (Q.T @ motor.y[own])
        after, columns = np.cumsum(e[::-1])[::-1], np.cumsum(Q[::-1], axis=0)[::-1]
        left = np.arange(len(own), 0, -1) - (columns**2).sum(axis=1)  # of a step's power, what no column explains
        explained = np.where(left > margin / 4, after**2 / np.maximum(left, 1.0), 0.0)
        explained[:margin] = explained[-margin:] = 0.0
        best = int(np.argmax(explained))
        step = (np.arange(len(own)) >= best).astype(float)
        column = step - Q @ (Q.T @ step)
        if explained[best] <= _SLIP * float(e @ e) or not _significant(column, e, len(rows)):
            break
        if _of_the_torque(motor, int(own[best]), float(column @ e / (column @ column))):
            break
        found.append(int(own[best]))
        X = np.column_stack([rows >= found[-1], X])
    return found


def _clear(rows: np.ndarray, at: list[int]) -> np.ndarray:
    """Rows that are not near slips: there the filters take slip for acceleration."""
    clear: np.ndarray = rows[(np.abs(rows[:, None] - np.array(at, dtype=int)) > _NEAR).all(axis=1)]
    return clear


def _significant(column: Array, e: Array, tests: int) -> bool:
    """Whether a column, which the others do not explain, is in the residual beyond its clusters' scatter."""
    power = float(column @ column)
    times = float(column @ e) / power
    scores = [float(column[own] @ (e - times * column)[own]) for own in np.array_split(np.arange(len(e)), _CLUSTERS)]
    spread = np.sqrt(np.sum(np.square(scores))) / power
    return bool(2 * float(t_tail(abs(times) / spread, _CLUSTERS - 1)) * tests < SIGNIFICANCE)


def _of_the_torque(motor: _Torsion, at: int, size: float) -> bool:
    """Whether the links' rows have the same step: it is one of the torque's zero, and no slip."""
    for X, y, own in motor.links:
        step = (np.flatnonzero(own) >= at).astype(float)
        if not 0 < step.sum() < len(step):
            continue
        there = np.linalg.lstsq(np.column_stack([step, X]), y, rcond=None)[0][0]
        if there * size > _ELSEWHERE * size**2:
            return True
    return False


def _slip_sizes(motor: _Torsion, at: list[int]) -> tuple[Array, Array]:
    """Sizes of slips from all columns together, and half their 95 % intervals, each (slips,), rad or m."""
    rows = np.arange(len(motor.y))
    own = _clear(rows, at)
    beta, covariance = _fit(np.column_stack([*(rows >= k for k in at), motor.X])[own], motor.y[own])
    n, K = len(at), beta[-1]
    slope = np.zeros((n, len(beta)))
    slope[:, :n], slope[:, -1] = -np.eye(n) / K, beta[:n] / K**2
    return -beta[:n] / K, _half(slope @ covariance @ slope.T)


def _fit(X: Array, y: Array) -> tuple[Array, Array]:
    """Least squares, and its covariance robust to correlation within clusters of time."""
    size = np.linalg.norm(X, axis=0)
    bread = np.linalg.pinv((X / size).T @ (X / size), hermitian=True) / np.outer(size, size)
    beta = bread @ (X.T @ y)
    e = y - X @ beta
    scores = np.array([X[own].T @ e[own] for own in np.array_split(np.arange(len(y)), _CLUSTERS)])
    return beta, bread @ scores.T @ scores @ bread * _CLUSTERS / (_CLUSTERS - 1)


def _half(covariance: Array) -> Array:
    """Half widths of 95 % intervals."""
    return np.array([float(half_width(s, _CLUSTERS - 1)) for s in np.sqrt(np.diag(covariance))])


def _play(estimate: Estimate, motors: list[_Torsion]) -> Finding:
    """Dead zones of the torsion."""
    figures, named = dict[str, float](), list[str]()
    given = any(getattr(term, "play", 0.0) != 0.0 for term in estimate.model.device.tables.terms)
    for motor in motors if not given else []:
        found = _dead_zone(motor)
        if found is None:
            continue
        size, half, explained = found
        ends = {"play": size, "low": size - half, "high": size + half, "explained": explained}
        figures |= {f"{motor.label}, {name}": value for name, value in ends.items()}
        named.append(
            f"{motor.label}, {size:.2g} {motor.unit} from end to end ({size - half:.2g} .. {size + half:.2g} at 95 %), "
            f"which explains {100 * explained:.0f} % of the residual"
        )
    if not named:
        return Finding("play", "ok", figures, "No sign of play between motors and links.")
    text = (
        f"Play (backlash, a loose cable) between motor and link: {'; '.join(named)}. Take it up, or estimate it: "
        "`play` and `rest` in the elastic term."
    )
    return Finding("play", "bad", figures, text)


def _dead_zone(motor: _Torsion) -> tuple[float, float, float] | None:
    """Size of the play, half its 95 % interval, rad or m, and the share of the residual that it explains."""
    Q = np.linalg.qr(motor.X)[0]
    e = motor.y - Q @ (Q.T @ motor.y)
    wide, centre = float(np.ptp(motor.x)), 0.5 * float(motor.x.min() + motor.x.max())
    cases = [(size * wide, centre + middle * wide) for size, middle in product(_SIZES, _MIDDLES)]

    def explains(case: tuple[float, float]) -> float:
        column = motor.filtered(np.clip(motor.x - case[1], -case[0] / 2, case[0] / 2))
        column = column - Q @ (Q.T @ column)
        along, power = float(column @ e), float(column @ column)
        return along**2 / power if along < 0 < power else 0.0

    best, middle = max(cases, key=explains)
    power = float(e @ e)
    if power <= 0 or explains((best, middle)) < 0.5 * _PLAY * power:
        return None
    return _fitted_zone(motor, best, middle, power, len(cases))


def _fitted_zone(
    motor: _Torsion, play: float, middle: float, power: float, tests: int
) -> tuple[float, float, float] | None:
    """The dead zone of least squares, from a first one; None where it is no play.

    Args:
        power: of the residual without it.
        tests: number of zones that the first was chosen from.
    """
    for _ in range(_PASSES):
        x = motor.x - middle
        zone, inside = np.clip(x, -play / 2, play / 2), np.abs(x) < play / 2
        held = motor.filtered(zone)
        freely = np.column_stack([motor.X, held])
        beta, _ = _fit(freely, motor.y)
        K = float(beta[-2])
        by_play = motor.filtered(np.where(inside, 0.0, -0.5 * np.sign(x)))
        by_middle = motor.filtered(inside.astype(float))
        X = np.column_stack([motor.X[:, :-1], motor.X[:, -1] - held, K * by_play, K * by_middle])
        made, covariance = _fit(X, motor.y)
        change = np.clip(made[-2:], -0.3 * play, 0.3 * play)
        play, middle = max(play + float(change[0]), 0.1 * play), middle + float(change[1])
    zone = motor.filtered(np.clip(motor.x - middle, -play / 2, play / 2))
    Q = np.linalg.qr(motor.X)[0]
    column, e = zone - Q @ (Q.T @ zone), motor.y - Q @ (Q.T @ motor.y)
    beta, _ = _fit(np.column_stack([motor.X, zone]), motor.y)
    explained = float(column @ e) ** 2 / float(column @ column) / power
    is_play = explained > _PLAY and _LEAST < -float(beta[-1] / beta[-2]) < _LARGEST
    if not (is_play and _significant(column, e, tests)):
        return None
    return play, float(_half(covariance)[-2]), explained
