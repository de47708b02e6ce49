"""Candidate columns: terms that the model may lack, first-order effects of wrong channels, clocks and lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.recorder import ChannelFault
from haptid.advice.rows import Column
from haptid.advice.torque_channels import TorqueChannels
from haptid.device.loops.from_toml import close_as
from haptid.device.terms.presliding import Presliding
from haptid.device.toml.reader import device_of
from haptid.dynamics.inverse import rigid
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.lack_of_fit import FINEST, FrictionCoordinate
from haptid.observation.augmented import ResidualContext
from haptid.observation.geometry_slopes import (
    SLOPE_STEP,
    Slope,
    compliance_slope,
    home_offset_slope,
    horizontal_axes,
    slope_towards,
    tilted_gravity,
)

# Kind of a change that puts springs between motors and what they move, and the same where a fit does not find them.
ELASTIC, GIVES_WAY = "elastic motors", "motors that give way"
# Stribeck velocities that are tried, as shares of the root mean square speed.
VELOCITIES = (0.1, 0.2, 0.4)
# Presliding distances that are tried, as shares of the range of positions.
DISTANCES = (0.001, 0.01, 0.1)
# Legendre polynomials of position beyond the first degree.
POWERS_OF_POSITION = (2, 3, 4)
# Step by which a length is changed for a derivative, m.
_LENGTH = 1e-3
# Share of the longest length that a correction of any is at most: beyond it rows are not linear in it, and a term that
# the model lacks is more likely.
_BELIEVED = 0.5
# Lengths and angles of a joint's table that may be wrong, by convention.
_GEOMETRY = {
    "modified-dh": {"d": _LENGTH, "r": _LENGTH, "b": _LENGTH},
    "dh": {"a": _LENGTH, "d": _LENGTH},
    "placement": {},
}

# Half waves of a drift's course in the log, at most.
_SLOW = 4


def _slow(share: Array) -> Array:
    """A course that is nothing but slow, by shares of the log's time."""
    return np.asarray(np.cos(np.pi * np.arange(1, _SLOW + 1)[:, None] * share))


# Courses of what gets warm: steadily, and with a time constant of a fifth of the log.
_COURSES: tuple[Callable[[Array], Array], ...] = (lambda share: share[None], lambda share: np.exp(-5 * share)[None])


@dataclass(frozen=True, eq=False)
class Source:
    """A candidate as columns.

    Attributes:
        kind: such as "spring"; actions of one kind on several motors are one.
        place: where, "motor 2"; index of the row or the friction coordinate is `index`.
        alternatives: columns each, of which a fit chooses one.
        settings: of each alternative, for the sentence and the edit.
        looked_at: how many alternatives there were before these were picked by the residual, over their number.
    """

    kind: str
    place: str
    index: int
    alternatives: tuple[Column, ...]
    settings: tuple[Mapping[str, Any], ...] = ({},)
    looked_at: float = 1.0


@dataclass(frozen=True, eq=False)
class Range:
    """Speed and range of a friction coordinate along the log, the scales of velocities and positions."""

    speed: float
    low: float
    high: float


def local_ranges(places: Sequence[FrictionCoordinate], position: Array, velocity: Array) -> list[Range]:
    """Of every place, from the coordinates' positions and velocities, (coordinates, rows)."""
    made = []
    for place in places:
        x, v = place.weights @ position, place.weights @ velocity
        made.append(Range(float(np.sqrt(np.mean(v**2))) or 1.0, float(x.min()), float(x.max())))
    return made


def _scalar(place: FrictionCoordinate, values: Callable[[Array, Array], Array]) -> Column:
    """Columns on one coordinate from its position and velocity."""

    def along(context: ResidualContext) -> Array:
        c, cd, _ = context.motion
        return np.atleast_2d(values(place.weights @ c, place.weights @ cd))

    return Column(along, place.weights)


def terms(model: DynamicModel, places: Sequence[FrictionCoordinate], ranges: Sequence[Range]) -> Iterator[Source]:
    """Terms that the model may lack, at every friction coordinate."""
    for k, (place, own) in enumerate(zip(places, ranges, strict=True)):
        middle, half = 0.5 * (own.low + own.high), 0.5 * (own.high - own.low) or 1.0

        def source(kind: str, *made: Column, settings: Sequence[Mapping[str, Any]] = ({},)) -> Source:
            return Source(kind, place.label, k, made, tuple(settings))  # noqa: B023 - used at once

        yield source("coulomb", _scalar(place, lambda _, v: np.sign(v)))
        yield source("viscous", _scalar(place, lambda _, v: v))
        yield source("offset", _scalar(place, lambda _, v: np.ones_like(v)))
        yield source("viscosity by direction", _scalar(place, lambda _, v: np.abs(v)))
        yield source("bent viscosity", _scalar(place, lambda _, v: v * np.abs(v)))
        yield source(
            "stribeck",
            *(
                _scalar(place, lambda _, v, s=share * own.speed: np.sign(v) * np.exp(-((v / s) ** 2)))  # type: ignore[misc]
                for share in VELOCITIES
            ),
            settings=[{"velocity": share * own.speed} for share in VELOCITIES],
        )
        distances = [share * (own.high - own.low) or 1.0 for share in DISTANCES]
        yield source(
            "presliding",
            *(Column(_presliding(place, distance), place.weights) for distance in distances),
            settings=[{"distance": distance} for distance in distances],
        )
        if not _has(model, "spring", place):
            # Its rest is anywhere, unless an offset of the model takes that up.
            free = not _has(model, "offset", place)
            yield source(
                "spring",
                _scalar(place, lambda x, _, m=middle, f=free: np.stack([x - m, np.ones_like(x)][: 1 + f])),  # type: ignore[misc]
                settings=[{"middle": middle}],
            )
        yield source(
            "torque by position",
            _scalar(
                place,
                lambda x, _, m=middle, h=half: np.polynomial.legendre.legvander(  # type: ignore[misc]
                    np.clip((x - m) / h, -1, 1), POWERS_OF_POSITION[-1]
                ).T[1:],
            ),
        )
        yield source("load friction", Column(_load(model, place), place.weights))
        driven = place.weights[~np.array(model.device.free_rows)].any()
        if driven and not _has(model, "rotor", place):
            yield source("rotor inertia", Column(_acceleration(place), place.weights))


def _has(model: DynamicModel, kind: str, place: FrictionCoordinate) -> bool:
    """Whether the model has a term of this kind on the coordinate, up to a factor."""
    own = place.weights / np.linalg.norm(place.weights)
    return any(
        abs(abs(own @ term.weights) - np.linalg.norm(term.weights)) <= 1e-9 * np.linalg.norm(term.weights)
        for term in model.terms
        if term.kind == kind
    )


def _presliding(place: FrictionCoordinate, distance: float) -> Callable[[ResidualContext], Array]:
    """Dahl friction minus Coulomb friction of a coordinate, which differ after a reversal."""
    shape = Presliding("dahl", distance)

    def values(context: ResidualContext) -> Array:
        x, v = (place.weights @ signal for signal in context.approach)
        return np.asarray((shape.along(x, v) - shape.sliding(v))[None, context.low - context.high :])

    return values


def _acceleration(place: FrictionCoordinate) -> Callable[[ResidualContext], Array]:
    """Acceleration of a coordinate."""

    def values(context: ResidualContext) -> Array:
        cdd = context.motion[2]
        assert cdd is not None  # as advice requires
        return np.asarray((place.weights @ cdd)[None])

    return values


def _load(model: DynamicModel, place: FrictionCoordinate) -> Callable[[ResidualContext], Array]:
    """Magnitude of the bodies' torque on a coordinate, with the sign of its velocity."""
    row = int(np.argmax(np.abs(place.weights)))

    def values(context: ResidualContext) -> Array:
        load = context.torque(rigid(model, context.chi))[row]
        return np.asarray((np.abs(load) * np.sign(place.weights @ context.motion[1]))[None])

    return values


def ripple_columns(place: FrictionCoordinate, index: int, periods: Sequence[float]) -> Source:
    """Sine and cosine of position with the periods found on each half of the blocks, rad or m."""

    def waves(period: float) -> Column:
        return _scalar(place, lambda x, _: np.stack([np.sin(2 * np.pi * x / period), np.cos(2 * np.pi * x / period)]))

    settings = tuple({"period": p} for p in periods)
    # Waves in the range that are not alike: one for each number of periods.
    return Source("ripple", place.label, index, tuple(map(waves, periods)), settings, 1 / FINEST / len(periods))


def channels(model: DynamicModel, torques: TorqueChannels, middle: float, half: float) -> Iterator[Source]:
    """First-order effects on every row of measured torque: of drift, and of a delay of a channel of its own."""
    for k in torques.measured:
        row = model.known_rows[k]
        label, own = model.device.row_labels[row], np.eye(len(model.device.active))[row]

        def rate(context: ResidualContext, r: int = row) -> Array:
            return np.asarray(np.gradient(context.predicted[r], context.plan.motion.dt)[None])

        if torques.of(k) is not None:
            yield Source("time shift", label, k, (Column(rate, own),))
        courses = [(shape, slice(None)) for shape in _COURSES] + [(_slow, slice(1)), (_slow, slice(1, None))]
        drifts = (_drift(row, shape, parts, middle, half) for shape, parts in courses)
        yield Source("drift", label, k, tuple(Column(values, own) for values in drifts))


def _drift(
    row: int, shape: Callable[[Array], Array], parts: slice, middle: float, half: float
) -> Callable[[ResidualContext], Array]:
    """Some of a row's offset, dry and viscous friction, each with courses in time."""

    def values(context: ResidualContext) -> Array:
        t = context.plan.motion.times(np.arange(context.low, context.high))
        cd, course = context.motion[1][row], shape(0.5 + 0.5 * (t - middle) / half)
        made = np.stack([np.ones_like(cd), np.sign(cd), cd])[parts]
        return np.concatenate([course * one for one in made])

    return values


def springs_of_motors(model: DynamicModel, torques: TorqueChannels) -> Iterator[Source]:
    """First-order effects of springs between the motors and what they move, where the file has none."""
    device = model.device
    if device.elastic or device.sensors:
        return
    for k in torques.measured:
        row = model.known_rows[k]
        if device.row_names[row] in [motor.name for motor in device.motors]:
            yield Source(ELASTIC, device.row_labels[row], k, (_on_all_rows(compliance_slope(model, row)),))


def clipped_channels(model: DynamicModel, torques: TorqueChannels, found: Sequence[ChannelFault]) -> Iterator[Source]:
    """What a clipped extreme adds to the model's torque of a motor; nothing where rows mix channels.

    Args:
        model: of the device.
        torques: whose the channels are.
        found: faults of the channels.
    """
    for fault in found:
        if fault.kind != "clipped torque" or torques.scales is None:
            continue
        (motor,) = torques.motors(fault.channel)
        row, limit = model.known_rows[motor], abs(float(torques.scales[motor])) * fault.size

        def error(context: ResidualContext, r: int = row, most: float = limit) -> Array:
            tau = context.predicted[r]
            return np.asarray((np.clip(tau, -most, most) - tau)[None])

        own = np.eye(len(model.device.active))[row]
        yield Source(fault.kind, model.device.row_labels[row], motor, (Column(error, own),), ({"size": fault.size},))


def payload_steps(model: DynamicModel, times: Sequence[float]) -> Iterator[Source]:
    """A point mass on the last link from some time on."""
    link = len(model.device.joints) - 1
    places = [10 * link + k for k in (6, 7, 8, 9)]

    def since(moment: float) -> Column:
        def values(context: ResidualContext) -> Array:
            t = context.plan.motion.times(np.arange(context.low, context.high))
            made = []
            for place in places:
                chi = np.zeros(len(context.chi))
                chi[place] = 1.0
                made.append(context.torque(chi) * (t >= moment))
            return np.stack(made)

        return Column(values)

    if times:
        label = f"link {model.device.joints[link].name}"
        yield Source("payload", label, link, tuple(map(since, times)), tuple({"time": t} for t in times))


@dataclass(frozen=True)
class Geometry:
    """A number of the device's geometry that may be wrong.

    Attributes:
        name: for the sentence, "length d2" or "zero of joint 2".
        key: path of the key in the device file; empty for an offset of a position channel.
        step: of the derivative, m or rad.
        channel: position channel whose offset it is, -1 for none.
        most: largest correction that is believed, m or rad.
    """

    name: str
    key: tuple[str | int, ...] = field(default=())
    step: float = _LENGTH
    channel: int = -1
    most: float = np.inf


def geometry(model: DynamicModel) -> Iterator[tuple[Geometry, Source]]:
    """Slopes of the rows by lengths, zeros of the positions and the direction of gravity."""
    device = model.device
    for k, j in enumerate(device.active):
        yield (
            Geometry(f"zero of joint {device.joints[j].name}", step=SLOPE_STEP, channel=k),
            Source("zero offset", f"joint {device.joints[j].name}", k, (_on_all_rows(home_offset_slope(model, k)),)),
        )
    lengths, plain = dict(_lengths(device.tables)), device.tables.model_copy(update={"targets": {}})
    closing = partial(close_as, device.closure)
    longest = max(map(abs, lengths.values()), default=0.0)
    for what in (replace(one, most=_BELIEVED * longest) for one in lengths):
        try:
            other = DynamicModel(device_of(changed(plain, what.key, what.step), device.name, closing))
        except HaptidError:
            continue
        if other.mechanism is not None and len(other.terms) == len(model.terms):
            moved = other.with_terms(model.terms).with_gravity(device.gravity)
            yield what, Source("length", what.name, 0, (_on_all_rows(slope_towards(moved, what.step, model)),))
    if device.gravity.any():
        for k, (name, axis) in enumerate(horizontal_axes(model)):
            yield (
                Geometry(f"direction of gravity towards {name}", ("gravity",), SLOPE_STEP, -2 - k),
                Source(
                    "gravity direction",
                    "base",
                    k,
                    (_on_all_rows(slope_towards(tilted_gravity(model, axis, SLOPE_STEP), SLOPE_STEP, model)),),
                ),
            )


def _on_all_rows(slope: Slope) -> Column:
    """A slope as one column over all rows."""
    return Column(lambda context: slope(context)[None])


def _lengths(tables: Any) -> Iterator[tuple[Geometry, float]]:
    """Named lengths, and numbers in the joints' tables other than zero, with their values, m."""
    for name, value in tables.lengths.items():
        if isinstance(value, int | float) and value:
            yield Geometry(f"length {name}", ("lengths", name)), value
    for k, joint in enumerate(tables.joints):
        for key in _GEOMETRY[tables.convention]:
            value = getattr(joint, key)
            if isinstance(value, int | float) and value:
                yield Geometry(f"{key} of joint {joint.name}", ("joints", k, key)), value
        for axis, value in enumerate(getattr(joint, "xyz", ())):
            if isinstance(value, int | float) and value:
                yield Geometry(f"{'xyz'[axis]} of joint {joint.name}", ("joints", k, "xyz", axis)), value


def changed(tables: Any, key: Sequence[str | int], step: float) -> Any:
    """The tables of a device file with one number changed by a step."""
    values = tables.model_dump(by_alias=True, exclude_unset=True)
    at = values
    for part in key[:-1]:
        at = at[part]
    at[key[-1]] += step
    return type(tables).model_validate(values)
