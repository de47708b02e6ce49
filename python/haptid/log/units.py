"""Units of a log's channels: scale to SI, and suggestions for unknown ones."""

from __future__ import annotations

import difflib
import math
from typing import Literal

from haptid.errors import LogChannelError

_Quantity = Literal["position", "velocity", "torque", "time"]

# unit -> (SI unit, factor); counts keep their name, and the gain is per count.
_POSITION = {
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "turn": ("rad", 2 * math.pi),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "counts": ("counts", 1.0),
}
_VELOCITY = {
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "turn/s": ("rad/s", 2 * math.pi),
    "rpm": ("rad/s", 2 * math.pi / 60),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
}
_TORQUE = {
    "N m": ("N m", 1.0),
    "mN m": ("N m", 1e-3),
    "kN m": ("N m", 1e3),
    "MN m": ("N m", 1e6),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "MN": ("N", 1e6),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "counts": ("counts", 1.0),
}
_TIME = {"s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9)}
TABLES: dict[_Quantity, dict[str, tuple[str, float]]] = {
    "position": _POSITION,
    "velocity": _VELOCITY,
    "torque": _TORQUE,
    "time": _TIME,
}

# Period of a wrapped channel, in its own unit; counters wrap at a power of two.
PERIODS = {"rad": 2 * math.pi, "deg": 360.0, "turn": 1.0}

SPELLINGS = {
    "rad": ("radian", "radians", "rads"),
    "deg": ("degree", "degrees", "degs", "°"),
    "turn": ("turns", "rev", "revs", "revolution", "revolutions"),
    "m": ("meter", "metre", "meters", "metres"),
    "mm": ("millimeter", "millimetre", "millimeters", "millimetres"),
    "um": ("µm", "μm", "micron", "microns", "micrometer", "micrometre"),
    "counts": ("count", "pulse", "pulses", "tick", "ticks", "inc", "increments", "lsb", "raw"),
    "rad/s": ("rad/sec", "radps", "radian/s", "radians/s"),
    "deg/s": ("°/s", "deg/sec", "degps"),
    "turn/s": ("rev/s", "rps"),
    "rpm": ("1/min", "min-1", "u/min", "rev/min"),
    "m/s": ("m/sec", "metre/s", "meter/s"),
    "mm/s": ("mm/sec",),
    "N m": ("nm", "n.m", "n-m", "n*m", "n·m", "newtonmeter", "newton meter", "newton metre"),
    "mN m": ("mnm", "mn.m", "mn-m", "mn*m", "mn·m", "nmm", "n.mm", "n-mm", "n*mm", "n·mm"),
    "kN m": ("knm", "kn.m", "kn*m", "kn·m"),
    "MN m": ("mnm", "mn.m", "mn*m", "mn·m"),
    "N": ("newton", "newtons"),
    "mN": ("millinewton", "millinewtons"),
    "kN": ("kilonewton", "kilonewtons"),
    "MN": ("meganewton", "meganewtons"),
    "V": ("volt", "volts"),
    "mV": ("millivolt", "millivolts"),
    "A": ("amp", "amps", "ampere", "amperes"),
    "mA": ("milliamp", "milliamps", "milliampere"),
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millisecond", "milliseconds"),
    "us": ("µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("nsec", "nanosecond", "nanoseconds"),
}


def readings(unit: str, quantity: _Quantity) -> list[str]:
    """The known units of a quantity that a spelling may mean, the likely one first; empty where it is not known.

    Milli and mega are told by case, `mNm` and `MNm`; small letters are milli, other capitals may be either, `MNM`.
    """
    compact = "".join(unit.split()).replace("⋅", "·")
    found = [
        name
        for name in TABLES[quantity]
        if compact.lower() in ("".join(word.split()).lower() for word in (name, *SPELLINGS[name]))
    ]
    told = compact[:1] == "m" or compact == "MN" + compact[2:].lower()
    return [name for name in found if name[0] == compact[0]] if told and len(found) > 1 else found


def closest_unit(unit: str, quantity: _Quantity) -> str | None:
    """The known unit of a quantity nearest to an unknown one; None where none is close."""
    close = readings(unit, quantity) or difflib.get_close_matches(unit, TABLES[quantity], n=1, cutoff=0.6)
    return close[0] if close else None


def known_unit(unit: str) -> tuple[_Quantity, str] | None:
    """Quantity and name of a unit in any usual spelling; None where it is not known."""
    return next(((quantity, found[0]) for quantity in TABLES if (found := readings(unit, quantity))), None)


def scale(unit: str, quantity: _Quantity) -> tuple[str, float]:
    """SI unit and the factor to it.

    Raises:
        LogChannelError: the unit is not known, or of another quantity.
    """
    if unit in TABLES[quantity]:
        return TABLES[quantity][unit]
    known = tuple(TABLES[quantity])
    for other, table in TABLES.items():
        if unit in table:
            raise LogChannelError(
                f"unit {unit!r} of the {quantity} is a unit of {other}.",
                where=quantity,
                found=unit,
                limit=known,
                advice=f"Units of {quantity}: {', '.join(known)}. Check that the two signals are not exchanged.",
            )
    close = readings(unit, quantity) or list(filter(None, [closest_unit(unit, quantity)]))
    raise LogChannelError(
        f"unit {unit!r} of the {quantity} is not known.",
        where=quantity,
        found=unit,
        limit=known,
        advice=(f"Write {' or '.join(map(repr, close))}. " if close else "") + f"Known: {', '.join(known)}.",
    )
