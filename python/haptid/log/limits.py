"""What only shows once the device is known: positions in the wrong unit, or of another joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

from haptid.errors import LooksLikeDegreesError, LooksLikeRadiansError, SwappedChannelsError
from haptid.log.log import Log

Range = tuple[float, float]

# A joint without limits that covers more than this is taken for one in degrees, rad.
MOST_TURNS = 4 * math.pi
# A joint this many times beyond its limits is taken for one in degrees, if a radian's worth less fits them.
BEYOND = 2.0
# No joint covers more than this: taken for radians, deg. Motion that small identifies nothing either.
LEAST_SPAN_DEG = 3.0
# With limits: no joint covers this share of its range, and 57.3 times more still fits.
LEAST_SHARE = 0.02
# A position may be this share of the range outside its limits: stops are soft, and zeros are not exact.
SLACK = 0.05


def check_against(
    log: Log, position_ranges: Sequence[Range | None], prismatic: Sequence[bool], names: Sequence[str]
) -> tuple[str, ...]:
    """Compare positions with the joints they are said to be of.

    Only joint-side positions can be compared; for a log of the motor side there is nothing to say.

    Args:
        log: what was recorded.
        position_ranges: limits of each position channel's joint, rad or m; None where unknown.
        prismatic: whether it slides.
        names: of the joints.

    Returns:
        A sentence for each joint that leaves its limits without a plain cause.

    Raises:
        LooksLikeDegreesError: an angle in radians that makes sense as degrees.
        LooksLikeRadiansError: angles in degrees that make sense as radians.
        SwappedChannelsError: two channels, each of which fits the other's limits and not its own.
    """
    count = len(log.channels.position.channels)
    if log.channels.position.side != "joint" or not len(position_ranges) == len(prismatic) == len(names) == count:
        return ()
    spans = list(log.spans)
    angles = [k for k in range(count) if not prismatic[k]]
    if log.channels.position.unit == "deg":
        _check_radians(angles, spans, position_ranges, names)
    else:
        for k in angles:
            _check_degrees(names[k], log.channels.position.channels[k], spans[k], position_ranges[k])
    _check_swapped(log, spans, position_ranges, prismatic, names)
    return tuple(
        f"joint {name} runs from {low:.4g} to {high:.4g}, outside its limits {limits[0]:.4g} .. {limits[1]:.4g}"
        for name, (low, high), limits in zip(names, spans, position_ranges, strict=True)
        if limits is not None and not _inside((low, high), limits)
    )


def _inside(span: Range, limits: Range) -> bool:
    slack = SLACK * (limits[1] - limits[0])
    return limits[0] - slack <= span[0] and span[1] <= limits[1] + slack


def _times(span: Range, factor: float) -> Range:
    return span[0] * factor, span[1] * factor


def _check_degrees(name: str, channel: str, span: Range, limits: Range | None) -> None:
    low, high = span
    if limits is None:
        if high - low > MOST_TURNS:
            raise LooksLikeDegreesError(name, channel, low, high, None)
        return
    furthest = max(abs(limits[0]), abs(limits[1]))
    beyond = max(abs(low), abs(high)) > BEYOND * furthest
    if beyond and _inside(_times(span, math.pi / 180), limits):
        raise LooksLikeDegreesError(name, channel, low, high, limits)


def _check_radians(
    angles: Sequence[int], spans: Sequence[Range], ranges: Sequence[Range | None], names: Sequence[str]
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
        raise LooksLikeRadiansError(names[widest], span, limit)


def _check_swapped(
    log: Log,
    spans: Sequence[Range],
    ranges: Sequence[Range | None],
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
            if _inside(other, limits) and _inside(span, others):
                reach = _furthest(span, limits)
                raise SwappedChannelsError(names[k], names[j], channels[k], channels[j], reach, limits)


def _furthest(span: Range, limits: Range) -> float:
    """The end that is further from the middle of the limits."""
    return max(span, key=lambda end: abs(end - 0.5 * (limits[0] + limits[1])))
