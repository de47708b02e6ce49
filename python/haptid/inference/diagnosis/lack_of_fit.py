"""Structure left in the residual: which term the model lacks, and on which motor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.inference.diagnosis.added_variable import Added, Extra, Widened
from haptid.inference.diagnosis.context import ResidualContext
from haptid.inference.diagnosis.finding import LEVEL, Finding, graded, holm, listed
from haptid.inference.diagnosis.places import Place
from haptid.inference.diagnosis.residual import Residuals

# Decay of the Stribeck shape, as shares of the root mean square speed: the better of the two is taken.
STRIBECK = (0.1, 0.3)
# Legendre polynomials of position, from the first degree on.
DEGREES = 4


@dataclass(frozen=True, eq=False)
class Local:
    """A place's own motion under some rows.

    Attributes:
        v: velocity in units of the typical speed, (samples,).
        x: position, -1 to 1 over the range of the rows, (samples,).
        load: size of the model's torque there in units of the typical one, (samples,).
    """

    v: Array
    x: Array
    load: Array


@dataclass(frozen=True)
class Shape:
    """A term that a model may lack.

    Attributes:
        name: of the finding.
        columns: one or more alternatives, each giving (k, samples).
        found: what it would mean, for "the residual of motor 2 shows ...".
        remedy: what to write.
    """

    name: str
    columns: tuple[Callable[[Local], Array], ...]
    found: str
    remedy: str


def stribeck(share: float) -> Callable[[Local], Array]:
    """sgn(v) exp(-|v| / v_s), (1, samples)."""
    return lambda at: (np.sign(at.v) * np.exp(-np.abs(at.v) / share))[None]


def polynomials(at: Local) -> Array:
    """Legendre polynomials of position, (DEGREES, samples); held beyond the range."""
    x = np.clip(at.x, -1.0, 1.0)
    return np.asarray(np.polynomial.legendre.legvander(x, DEGREES).T[1:], dtype=np.float64)


SHAPES = (
    Shape(
        "friction near standstill",
        tuple(stribeck(share) for share in STRIBECK),
        "dry friction that changes towards standstill (Stribeck)",
        'Add a [[terms]] of kind "stribeck"',
    ),
    Shape(
        "friction by direction",
        (lambda at: np.ones((1, len(at.v))),),
        "a constant torque: friction that differs by direction, or an offset of the amplifier",
        'Add a [[terms]] of kind "offset", or "coulomb-by-direction"',
    ),
    Shape(
        "viscosity by direction",
        (lambda at: np.abs(at.v)[None],),
        "viscous friction that differs by direction",
        'Add a [[terms]] of kind "viscous-by-direction" in place of "viscous"',
    ),
    Shape(
        "bent viscosity",
        (lambda at: (at.v * np.abs(at.v))[None],),
        "friction that does not grow in proportion to velocity",
        "Add a column with velocity times |velocity|",
    ),
    Shape(
        "torque by position",
        (polynomials,),
        "a torque that depends on position: a spring, a cable, or gravity of a link that the model lacks",
        'Add a [[terms]] of kind "spring" or a column of position',
    ),
    Shape(
        "friction by load",
        (lambda at: (at.load * np.sign(at.v))[None],),
        "dry friction that grows with the torque carried, as gears and cables have",
        'Add a [[terms]] of kind "load"',
    ),
)


def extras(shape: Shape, place: Place, left: Residuals) -> tuple[Extra, ...]:
    """The shape's alternatives at a place.

    Args:
        shape: which.
        place: where.
        left: rows that say which speeds and positions are typical.
    """
    v, x = place.weights @ left.velocity, place.weights @ left.position
    speed = float(np.sqrt(np.nanmean(v**2))) or 1.0
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    row = int(np.argmax(np.abs(place.weights)))

    def local(sight: ResidualContext) -> Local:
        c, cd, _ = sight.motion
        at = (2 * (place.weights @ c) - low - high) / (high - low or 1.0)
        return Local(place.weights @ cd / speed, at, np.abs(sight.predicted[row]))

    def values(columns: Callable[[Local], Array]) -> Callable[[ResidualContext], Array]:
        return lambda sight: columns(local(sight))

    count = DEGREES if shape.columns == (polynomials,) else 1
    return tuple(Extra(place.weights, count, values(columns)) for columns in shape.columns)


@dataclass(frozen=True)
class Look:
    """One shape at one place.

    Attributes:
        p: probability of so much by chance, over the alternatives together (Bonferroni).
        explained: share of the residual power of the motor that gains most.
        extra: the better alternative, -1 where the rows tell none from the model.
        added: its fit.
        shadow: name of another shape at the place that leaves nothing of this one, where there is one.
    """

    p: float
    explained: float
    extra: int = -1
    added: Added | None = None
    shadow: str = ""


def look(widened: Widened, which: Sequence[int]) -> Look:
    """The best of some alternatives."""
    tried = [(e, added) for e in which if (added := widened.test([e])) is not None]
    if not tried:
        return Look(1.0, 0.0)
    extra, best = min(tried, key=lambda each: each[1].p)
    return Look(min(1.0, best.p * len(tried)), float(best.explained.max()), extra, best)


def shadowed(widened: Widened, looks: Mapping[str, Look]) -> dict[str, Look]:
    """The looks at one place, by shape; those with nothing left beside the surest shape are marked."""
    seen = {name: one for name, one in looks.items() if one.p < LEVEL}
    if len(seen) < 2:
        return dict(looks)
    first = min(seen, key=lambda name: seen[name].p)
    made = dict(looks)
    for name in seen:
        if name != first:
            both = widened.test([looks[first].extra, looks[name].extra])
            if both is None or both.last(len(both.gamma) - widened.extras[looks[first].extra].many).p >= LEVEL:
                made[name] = replace(looks[name], shadow=first)
    return made


def misfit(shape: Shape, places: Sequence[Place], looks: Sequence[Look]) -> Finding:
    """What a shape says over all places, taken together (Holm)."""
    together = holm([one.p for one in looks])
    open_ones = [k for k, one in enumerate(looks) if not one.shadow]
    first = min(open_ones or range(len(looks)), key=lambda k: together[k])
    status = graded(float(together[first]), looks[first].explained) if open_ones else "ok"
    figures = {"p": float(together[first]), "explained": looks[first].explained}
    for place, one in zip(places, looks, strict=True):
        figures |= {f"p {place.label}": one.p, f"explained {place.label}": one.explained}
        if one.added is not None and len(one.added.gamma) == 1:
            figures |= {f"size {place.label}": one.added.gamma[0], f"sd {place.label}": one.added.se[0]}
    if status == "ok":
        text = f"No sign of {shape.found} (p = {together[first]:.2g}, limit {LEVEL:g})."
        if shadows := sorted({one.shadow for one in looks if one.shadow}):
            text = f"No sign of {shape.found} beside what is found under {listed(shadows)}."
        return Finding(shape.name, status, figures, text)
    where = listed([places[k].label for k in open_ones if together[k] < LEVEL])
    text = (
        f"The residual of {where} shows {shape.found}: {100 * looks[first].explained:.1f} % of its power goes with it "
        f"on {places[first].label} (p = {together[first]:.1e}, limit {LEVEL:g}). {shape.remedy} on {where}."
    )
    return Finding(shape.name, status, figures, text)
