"""Lack of fit: tests of candidate terms that the model may lack, on each motor or joint, and of periodic torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import AddedVariableTest, AugmentedRows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, SMALL_SHARE, Finding, graded, joined_names
from haptid.inference.diagnosis.residuals import Residuals
from haptid.observation.augmented import CandidateColumns, ResidualContext
from haptid.uncertainty.multiple_testing import holm_adjusted

# Stribeck velocities tried, as shares of the root mean square speed.
STRIBECK = (0.1, 0.3)
# Legendre polynomials of position, from the first degree on.
DEGREES = 4
# Ripple periods: from the range of the rows down to this share of it, and their number.
FINEST, _PERIODS = 1 / 60, 120
# Draws of the wild bootstrap, and its seed.
DRAWS, SEED = 999, 0


@dataclass(frozen=True, eq=False)
class FrictionCoordinate:
    """A coordinate on which friction acts: a motor's or a joint's own.

    Attributes:
        label: "motor 2".
        weights: as a combination of the device's coordinates, (active,).
    """

    label: str
    weights: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "weights")


def friction_coordinates(model: DynamicModel, rows: Sequence[int]) -> tuple[FrictionCoordinate, ...]:
    """Coordinates with declared dry friction, and those of rows without any.

    A joint whose rate depends on the pose has no coordinate of its own: that of its row is used.
    """
    coordinates: list[FrictionCoordinate] = []
    for row in rows:
        declared = [(term.on, term.weights) for term in model.coulomb_terms(row) if term.joint is None]
        for label, weights in declared or [(model.device.row_labels[row], np.eye(len(model.device.active))[row])]:
            if not any(np.array_equal(np.abs(weights), np.abs(known.weights)) for known in coordinates):
                coordinates.append(FrictionCoordinate(label, weights))
    return tuple(coordinates)


def coupled_coordinates(
    model: DynamicModel, rows: Sequence[int], known: Sequence[FrictionCoordinate]
) -> tuple[FrictionCoordinate, ...]:
    """Joints and motors that move as none of the known coordinates do, of devices whose motors are coupled.

    Friction acts in bearings of joints as well as in motors. Joints whose rates vary with the pose are left out.
    """
    device = model.device
    joints = [
        (f"joint {joint.name}", rate)
        for joint, rate, varies in zip(device.joints, device.rates, device.varying, strict=True)
        if not varies.any()
    ]
    motors = [
        (f"motor {drive.name}", rate)
        for drive, rate, varies in zip(device.drives, device.drive_rates, device.drive_varies, strict=True)
        if drive.motorised and not drive.sensor and not varies.any()
    ]
    coordinates = list(known)
    for label, weights in [*motors, *joints]:
        if weights[list(rows)].any() and not any(_parallel(weights, coordinate.weights) for coordinate in coordinates):
            coordinates.append(FrictionCoordinate(label, weights))
    return tuple(coordinates[len(known) :])


def _parallel(a: Array, b: Array) -> bool:
    """Whether one combination is a multiple of the other."""
    return bool(abs(a @ b) > (1 - 1e-9) * np.linalg.norm(a) * np.linalg.norm(b))


@dataclass(frozen=True, eq=False)
class LocalMotion:
    """Motion of a friction coordinate.

    Attributes:
        v: velocity in units of its root mean square, (samples,).
        x: position, -1 to 1 over the range of the rows, (samples,).
        load: magnitude of the model's torque, (samples,).
    """

    v: Array
    x: Array
    load: Array


@dataclass(frozen=True)
class CandidateTerm:
    """A term that a model may lack.

    Attributes:
        name: of the finding.
        columns: one or more alternatives, each giving (k, samples).
        meaning: for "the residual of motor 2 shows ...".
    """

    name: str
    columns: tuple[Callable[[LocalMotion], Array], ...]
    meaning: str


def stribeck(share: float) -> Callable[[LocalMotion], Array]:
    """sgn(v) exp(-|v| / v_s), (1, samples)."""
    return lambda at: (np.sign(at.v) * np.exp(-np.abs(at.v) / share))[None]


def polynomials(motion: LocalMotion) -> Array:
    """Legendre polynomials of position, (DEGREES, samples); constant beyond the range."""
    x = np.clip(motion.x, -1.0, 1.0)
    return np.asarray(np.polynomial.legendre.legvander(x, DEGREES).T[1:], dtype=np.float64)


CANDIDATES = (
    CandidateTerm(
        "friction near standstill",
        tuple(stribeck(share) for share in STRIBECK),
        "dry friction that changes towards standstill (Stribeck)",
    ),
    CandidateTerm(
        "friction by direction",
        (lambda at: np.ones((1, len(at.v))),),
        "a constant torque: direction-dependent dry friction, or an offset of the amplifier",
    ),
    CandidateTerm(
        "viscosity by direction",
        (lambda at: np.abs(at.v)[None],),
        "direction-dependent viscous friction",
    ),
    CandidateTerm(
        "bent viscosity",
        (lambda at: (at.v * np.abs(at.v))[None],),
        "friction that is not linear in velocity",
    ),
    CandidateTerm(
        "torque by position",
        (polynomials,),
        "a position-dependent torque: a spring, a cable, or gravity of a link that the model lacks",
    ),
    CandidateTerm(
        "friction by load",
        (lambda at: (at.load * np.sign(at.v))[None],),
        "load-dependent dry friction, as gears and cables have",
    ),
)


def columns_at(term: CandidateTerm, place: FrictionCoordinate, left: Residuals) -> tuple[CandidateColumns, ...]:
    """A term's alternatives at a friction coordinate.

    Args:
        term: which.
        place: where.
        left: rows that give the typical speed and the range of positions.
    """
    v, x = place.weights @ left.velocity, place.weights @ left.position
    speed = float(np.sqrt(np.nanmean(v**2))) or 1.0
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    row = int(np.argmax(np.abs(place.weights)))

    def local(context: ResidualContext) -> LocalMotion:
        c, cd, _ = context.motion
        position = (2 * (place.weights @ c) - low - high) / (high - low or 1.0)
        return LocalMotion(place.weights @ cd / speed, position, np.abs(context.predicted[row]))

    def values(columns: Callable[[LocalMotion], Array]) -> Callable[[ResidualContext], Array]:
        return lambda context: columns(local(context))

    count = DEGREES if term.columns == (polynomials,) else 1
    return tuple(CandidateColumns(place.weights, count, values(columns)) for columns in term.columns)


@dataclass(frozen=True)
class TermTest:
    """Test of one candidate term at one friction coordinate.

    Attributes:
        p: p-value over the alternatives together (Bonferroni).
        explained: share of the residual power explained, of the motor that gains most.
        candidate: the better alternative, -1 where all are collinear with the model.
        fit: its test.
        redundant_to: name of another term there, given which this one is not significant.
    """

    p: float
    explained: float
    candidate: int = -1
    fit: AddedVariableTest | None = None
    redundant_to: str = ""


# Tests of a diagnosis by term and friction coordinate, as long as the estimate is kept: comparisons need them again.
_TESTED: WeakKeyDictionary[Estimate, Mapping[tuple[str, int], TermTest]] = WeakKeyDictionary()


def term_tests(
    augmented: AugmentedRows, candidates_of: Mapping[tuple[str, int], Sequence[int]]
) -> Mapping[tuple[str, int], TermTest]:
    """The most significant alternative of each term at each friction coordinate.

    Args:
        augmented: the rows of an estimate with the candidates.
        candidates_of: candidates of a term, by name, at a friction coordinate.
    """
    tests = {name: best_alternative(augmented, own) for name, own in candidates_of.items()}
    _TESTED[augmented.estimate] = tests
    return tests


def known_term_tests(estimate: Estimate) -> Mapping[tuple[str, int], TermTest] | None:
    """Those of the last diagnosis of an estimate; None without one."""
    return _TESTED.get(estimate)


def best_alternative(augmented: AugmentedRows, candidates: Sequence[int]) -> TermTest:
    """The most significant of some alternatives."""
    tried = [(e, test) for e in candidates if (test := augmented.test([e])) is not None]
    if not tried:
        return TermTest(1.0, 0.0)
    candidate, best = min(tried, key=lambda each: each[1].p)
    return TermTest(min(1.0, best.p * len(tried)), float(best.explained.max()), candidate, best)


def mark_redundant(augmented: AugmentedRows, tests: Mapping[str, TermTest]) -> dict[str, TermTest]:
    """The tests at one coordinate, by term; those not significant given the most significant term are marked."""
    significant = {name: test for name, test in tests.items() if test.p < SIGNIFICANCE}
    marked = dict(tests)
    first = min(significant, key=lambda name: significant[name].p, default="")
    for name in significant:
        if name != first:
            leading = tests[first].candidate
            joint = augmented.test([leading, tests[name].candidate])
            count = augmented.candidates[leading].count
            if joint is None or joint.last(len(joint.values) - count).p >= SIGNIFICANCE:
                marked[name] = replace(tests[name], redundant_to=first)
    return marked


def missing_term(term: CandidateTerm, places: Sequence[FrictionCoordinate], tests: Sequence[TermTest]) -> Finding:
    """The tests of one term at all friction coordinates, with Holm's correction."""
    p = holm_adjusted(np.array([test.p for test in tests]))
    candidates = [k for k, test in enumerate(tests) if not test.redundant_to]
    first = min(candidates or range(len(tests)), key=lambda k: p[k])
    status = graded(float(p[first]), tests[first].explained) if candidates else "ok"
    figures = {"p": float(p[first]), "explained": tests[first].explained}
    for place, test in zip(places, tests, strict=True):
        figures |= {f"p {place.label}": test.p, f"explained {place.label}": test.explained}
        if test.fit is not None and len(test.fit.values) == 1:
            figures |= {f"size {place.label}": test.fit.values[0], f"se {place.label}": test.fit.se[0]}
    if status == "ok" and candidates and p[first] < SIGNIFICANCE:
        text = (
            f"{term.meaning[0].upper()}{term.meaning[1:]} is significant in the residual of {places[first].label} "
            f"(p = {p[first]:.1e}, limit {SIGNIFICANCE:g}) but negligible: it explains "
            f"{100 * tests[first].explained:.1f} % of the residual power (limit {100 * SMALL_SHARE:g} %)."
        )
        return Finding(term.name, status, figures, text)
    if status == "ok":
        text = f"No sign of {term.meaning} (p = {p[first]:.2g}, limit {SIGNIFICANCE:g})."
        if others := sorted({test.redundant_to for test in tests if test.redundant_to}):
            text = f"No sign of {term.meaning} in addition to {joined_names(others)}."
        return Finding(term.name, status, figures, text)
    labels = joined_names([places[k].label for k in candidates if p[k] < SIGNIFICANCE])
    text = (
        f"The residual of {labels} shows {term.meaning}: it explains {100 * tests[first].explained:.1f} % of the "
        f"residual power of {places[first].label} (p = {p[first]:.1e}, limit {SIGNIFICANCE:g})."
    )
    return Finding(term.name, status, figures, text)


# Ripple: a torque that is periodic in position, with an unknown period.


def fourier_sums(x: Array, e: Array, block: np.ndarray) -> tuple[Array, Array]:
    """Spatial frequencies, (periods,), and each block's sums of e exp(i 2 pi f x), (blocks, periods), complex.

    Args:
        x: position, (rows,), SI.
        e: residual, (rows,).
        block: of each row, (rows,).
    """
    span = float(x.max() - x.min())
    f = np.linspace(2.0, 1 / FINEST, _PERIODS) / span
    # Frequencies at equal steps: each wave is the one before, turned by the same angle.
    waves = np.empty((len(x), len(f)), dtype=complex)
    waves[:, 0], waves[:, 1:] = np.exp(2j * np.pi * f[0] * x), np.exp(2j * np.pi * (f[1] - f[0]) * x)[:, None]
    np.multiply.accumulate(waves, axis=1, out=waves)
    parts = (np.flatnonzero(block == number) for number in np.unique(block))
    return f, np.array([e[part] @ waves[part] for part in parts])


def wild_bootstrap(sums: Array) -> tuple[float, int]:
    """p-value of the strongest wave over all periods, and the index of its period.

    Blocks change sign as wholes, which keeps the serial correlation inside them: the wild cluster bootstrap of Cameron,
    Gelbach and Miller (2008), Review of Economics and Statistics 90, for the maximum over all periods.
    """
    noise = (np.abs(sums) ** 2).sum(axis=0)
    strength = np.abs(sums.sum(axis=0)) ** 2 / noise
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (DRAWS, len(sums)))
    drawn = (np.abs(signs @ sums) ** 2 / noise).max(axis=1)
    return float((1 + (drawn >= strength.max()).sum()) / (DRAWS + 1)), int(np.argmax(strength))


def ripple(places: Sequence[FrictionCoordinate], left: Residuals, device_rows: Sequence[int]) -> Finding:
    """Is any motor's residual torque periodic in position: cogging, gear teeth, an eccentric capstan?

    Args:
        places: motors or joints.
        left: the residuals.
        device_rows: coordinate of every motor's row.
    """
    p, explained, period, names = [], [], [], []
    for place in places:
        m = max(range(len(left.e)), key=lambda k: abs(place.weights[device_rows[k]]))
        used = left.used(m)
        x, e = (place.weights @ left.position)[used], left.e[m, used] - np.nanmean(left.e[m])
        if used.sum() < _PERIODS or x.max() == x.min():
            continue
        f, sums = fourier_sums(x, e, left.block[used])
        by_order, largest = wild_bootstrap(sums)
        p.append(by_order)
        explained.append(float(2 * np.abs(sums[:, largest].sum()) ** 2 / (len(e) * (e @ e))))
        period.append(float(1 / f[largest]))
        names.append(place.label)
    corrected = holm_adjusted(np.array(p)) if p else np.ones(1)
    first = int(np.argmin(corrected))
    if not p or corrected[first] >= SIGNIFICANCE:
        text = f"No torque periodic in position (p = {corrected[first]:.2g}, limit {SIGNIFICANCE:g})."
        return Finding("ripple", "ok", {"p": corrected[first]}, text)
    figures = {"p": corrected[first], "explained": explained[first], "period": period[first]}
    status = graded(float(corrected[first]), explained[first])
    if status == "ok":
        text = (
            f"A torque periodic in the position of {names[first]} is significant (p = {corrected[first]:.1e}, limit "
            f"{SIGNIFICANCE:g}) but negligible: {100 * explained[first]:.1f} % of the residual power (limit "
            f"{100 * SMALL_SHARE:g} %)."
        )
        return Finding("ripple", status, figures, text)
    text = (
        f"The residual of {names[first]} is periodic in position with a period of {period[first]:.3g} (SI): "
        f"{100 * explained[first]:.1f} % of its power (p = {corrected[first]:.1e}, limit {SIGNIFICANCE:g}): cogging, "
        f"gear teeth or an eccentric pulley have such a period."
    )
    return Finding("ripple", status, figures, text)
