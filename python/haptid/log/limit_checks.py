"""Positions against the limits of a device's joints: wrong units and swapped channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from haptid.errors import LogMismatchError
from haptid.log.units import scale

if TYPE_CHECKING:
    from haptid.log.log import Log

_Range = tuple[float, float]

# A joint without limits that covers more than this is assumed to be in degrees, rad.
MOST_TURNS = 4 * math.pi
# A single joint without limits, a pendulum or a wheel, may turn so far, and so may one whose limits are a whole turn.
MOST_ALONE = 20 * math.pi
# So is one this many times beyond its limits, if the angle read as degrees fits them.
BEYOND = 2.0
# Joints that cover less than this are assumed to be in radians, deg; so small a motion identifies nothing anyway.
LEAST_SPAN_DEG = 3.0
# With limits: joints that cover less than this share of their range, if 57.3 times more still fits.
LEAST_SHARE = 0.02
# Share of its range by which a position may exceed its limits: stops are soft, and zeros are not exact.
SLACK = 0.05


def check_against(
    log: Log, position_ranges: Sequence[_Range | None], prismatic: Sequence[bool], names: Sequence[str]
) -> tuple[str, ...]:
    """Compare positions with the limits of their joints, to find wrong units and swapped channels.

    Only joint-side positions can be compared; a log of the motor side passes.

    Args:
        log: the recording.
        position_ranges: limits of each position channel's joint, rad or m; None where unknown.
        prismatic: whether each joint is prismatic.
        names: of the joints.

    Returns:
        A note for each joint outside its limits for no such cause, and for a single joint that turns.

    Raises:
        LogMismatchError: an angle in radians that is plausible only as degrees, angles in degrees that are plausible
            only as radians, or two channels, each within the other's limits and not its own.
    """
    count = len(log.channels.position.channels)
    if log.channels.position.side != "joint" or not len(position_ranges) == len(prismatic) == len(names) == count:
        return ()
    spans = list(log.spans)
    angles = [k for k in range(count) if not prismatic[k]]
    own = log.channels.position.each_unit
    _check_kinds(own, prismatic, names)
    degrees = [k for k in angles if own[k] == "deg"]
    if degrees:
        _check_radians(degrees, spans, position_ranges, names)
    else:
        usual = float(np.median([spans[k][1] - spans[k][0] for k in angles])) if angles else 0.0
        for k in angles:
            if position_ranges[k] is None and usual < 2 * math.pi:  # one joint turns, the others are no degrees
                continue
            limits = position_ranges[k]
            whole = len(angles) == 1 if limits is None else limits[1] - limits[0] > 2 * math.pi - SLACK
            if whole and spans[k][1] - spans[k][0] < MOST_ALONE:
                continue
            _check_degrees(names[k], log.channels.position.channels[k], spans[k], position_ranges[k])
    _check_swapped(log, spans, position_ranges, prismatic, names)
    turned = tuple(
        f"joint {names[k]} turns {(spans[k][1] - spans[k][0]) / (2 * math.pi):.1f} times; "
        "if it does not, its unit is wrong"
        for k in angles
        if len(angles) == 1 and position_ranges[k] is None and spans[k][1] - spans[k][0] > MOST_TURNS
    )
    return turned + tuple(
        f"joint {name} runs from {low:.4g} to {high:.4g}, outside its limits {limits[0]:.4g} .. {limits[1]:.4g}"
        for name, (low, high), limits in zip(names, spans, position_ranges, strict=True)
        if limits is not None and not _inside((low, high), limits)
    )


def _check_kinds(own: Sequence[str], prismatic: Sequence[bool], names: Sequence[str]) -> None:
    """Refuse an angle in a unit of length, and a length in a unit of angle; SI's own of either are the same figures."""
    fitting = ", ".join('"mm"' if straight else '"deg"' for straight in prismatic)
    for unit, straight, name in zip(own, prismatic, names, strict=True):
        wanted = "m" if straight else "rad"
        si, factor = scale(unit, "position")
        if si not in (wanted, "counts") and factor != 1.0:
            raise LogMismatchError(
                f"the position of joint {name} is in {unit!r}, and the joint is "
                f"{'prismatic' if straight else 'revolute'}.",
                where=name,
                found=unit,
                limit=wanted,
                advice=f"Write one unit for each channel: unit = [{fitting}].",
            )


def _inside(span: _Range, limits: _Range) -> bool:
    slack = SLACK * (limits[1] - limits[0])
    return limits[0] - slack <= span[0] and span[1] <= limits[1] + slack


def _times(span: _Range, factor: float) -> _Range:
    return span[0] * factor, span[1] * factor


def _check_degrees(name: str, channel: str, span: _Range, limits: _Range | None) -> None:
    low, high = span
    if limits is None:
        if high - low > MOST_TURNS:
            raise _degrees(name, channel, low, high, None)
        return
    furthest = max(abs(limits[0]), abs(limits[1]))
    beyond = max(abs(low), abs(high)) > BEYOND * furthest
    if beyond and _inside(_times(span, math.pi / 180), limits):
        raise _degrees(name, channel, low, high, limits)


def _check_radians(
    angles: Sequence[int], spans: Sequence[_Range], ranges: Sequence[_Range | None], names: Sequence[str]
) -> None:
    def small(k: int) -> bool:
        limits, (low, high) = ranges[k], spans[k]
        if limits is None:
            return math.degrees(high - low) < LEAST_SPAN_DEG
        fits = _inside(_times(spans[k], 180 / math.pi), limits)
        return fits and high - low < LEAST_SHARE * (limits[1] - limits[0])

    if angles and all(small(k) for k in angles):
        widest = max(angles, key=lambda k: spans[k][1] - spans[k][0])
        span = math.degrees(spans[widest][1] - spans[widest][0])
        limits = ranges[widest]
        limit = LEAST_SPAN_DEG if limits is None else math.degrees(LEAST_SHARE * (limits[1] - limits[0]))
        raise LogMismatchError(
            f"with unit 'deg' no joint moves more than {span:.3g} deg (joint {names[widest]}), below {limit:g} deg; "
            "as radians the motion would be plausible.",
            where=names[widest],
            found=span,
            limit=limit,
            advice="Give the position signal unit='rad'; if the motion really is this small, unit='rad' with "
            "gain=pi/180.",
        )


def _check_swapped(
    log: Log,
    spans: Sequence[_Range],
    ranges: Sequence[_Range | None],
    prismatic: Sequence[bool],
    names: Sequence[str],
) -> None:
    channels = log.channels.position.channels
    for k, (span, limits) in enumerate(zip(spans, ranges, strict=True)):
        if limits is None or _inside(span, limits):
            continue
        for j, (other, others) in enumerate(zip(spans, ranges, strict=True)):
            if j == k or others is None or prismatic[j] != prismatic[k]:
                continue
            if _inside(other, others):  # one joint alone beyond its limits may have another zero
                continue
            if _inside(other, limits) and _inside(span, others):
                reach = _furthest(span, limits)
                raise LogMismatchError(
                    f"joint {names[k]} (channel {channels[k]!r}) reaches {reach:.4g}, outside its limits "
                    f"{limits[0]:.4g} .. {limits[1]:.4g}, while channel {channels[j]!r} of joint {names[j]} is within "
                    "them, and the other way round.",
                    where=(names[k], names[j]),
                    found=reach,
                    limit=limits,
                    advice="Exchange the two channels, or correct the limits.",
                )


def _furthest(span: _Range, limits: _Range) -> float:
    """The end of a span that is further from the middle of the limits."""
    return max(span, key=lambda end: abs(end - 0.5 * (limits[0] + limits[1])))


def _degrees(name: str, channel: str, low: float, high: float, limits: _Range | None) -> LogMismatchError:
    """Error of an angle in radians that is plausible only as degrees."""
    why = f"{(high - low) / (2 * math.pi):.1f} turns"
    if limits:
        why = f"far beyond its limits {limits[0]:.4g} .. {limits[1]:.4g} rad"
    other = (
        " correct the joint's limits." if limits else ", if it turns so far, give the joint limits in the device file."
    )
    return LogMismatchError(
        f"joint {name} (channel {channel!r}) runs from {low:.4g} to {high:.4g} rad, {why}; divided by 57.3 it would be "
        "plausible.",
        where=name,
        found=(low, high),
        limit=limits,
        advice=f'Give the position signal `unit = "deg"`, or{other}',
    )
