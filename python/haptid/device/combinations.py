"""Targets of a device file: linear combinations of standard parameters, with the unit that follows from them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from haptid.device.device import Combination
from haptid.device.expressions import combination
from haptid.device.geometry import Reader
from haptid.device.parameters import StandardParameters
from haptid.device.toml.place import Place
from haptid.device.toml.schema import AnyDevice, TargetTable
from haptid.errors import DeviceValueError, DuplicateNameError

# Symbol of the size of the device file's gravity in targets, m/s^2.
GRAVITY = "g"
# Powers of kg, m, s and rad in the units of parameters.
POWERS: Mapping[str, tuple[int, int, int, int]] = {
    "kg m^2": (1, 2, 0, 0),
    "kg m": (1, 1, 0, 0),
    "kg": (1, 0, 0, 0),
    "N m s/rad": (1, 2, -1, -1),
    "N s/m": (1, 0, -1, 0),
    "N s": (1, 1, -1, 0),
    "N m": (1, 2, -2, 0),
    "N": (1, 1, -2, 0),
    "N m/rad": (1, 2, -2, -1),
    "N/m": (1, 0, -2, 0),
}
UNITS = {powers: unit for unit, powers in POWERS.items()}
# A power of a length further than this from a whole number is none: a length was added to a plain number.
WHOLE = 1e-6


def read_combinations(
    tables: AnyDevice, parameters: StandardParameters, reader: Reader, place: Place
) -> tuple[Combination, ...]:
    """The targets in the file's order.

    Raises:
        DuplicateNameError: a length has the name of a parameter, or of gravity.
        DeviceValueError: a target is zero in this device, or its unit cannot be told.
    """
    if not tables.targets:
        return ()
    gravity = float(np.linalg.norm(reader.triple(tables.gravity, place.at("gravity"))))
    for name in reader.lengths:
        if name == GRAVITY or name in parameters.raw:
            first = "the size of gravity" if name == GRAVITY else "a standard parameter"
            raise DuplicateNameError(str(place.at("lengths", name)), "name", name, f"{first}, in [targets]")
    constants = {**reader.lengths, GRAVITY: gravity}
    return tuple(
        _read(name, table, parameters, constants, place.at("targets", name)) for name, table in tables.targets.items()
    )


def _read(
    name: str,
    table: TargetTable | str,
    parameters: StandardParameters,
    constants: Mapping[str, float],
    place: Place,
) -> Combination:
    text, unit = (table.expression, table.unit) if isinstance(table, TargetTable) else (table, None)
    factors = combination(text, parameters.raw, constants, place)
    row = np.zeros(len(parameters))
    for raw, factor in factors.items():
        if raw in parameters.index:
            row[parameters.index[raw]] += factor
    if not row.any():
        found = f'"{text}" is zero in this device, whatever the motion'
        raise DeviceValueError(str(place), found, "Name a parameter that symmetry and massless links leave.")
    return Combination(name, text, unit or _unit(text, parameters, constants, factors, place), row)


def _unit(
    text: str,
    parameters: StandardParameters,
    constants: Mapping[str, float],
    factors: Mapping[str, float],
    place: Place,
) -> str:
    """The unit that all parts of a combination share."""
    of = dict(zip(parameters.raw, parameters.raw_units, strict=True))
    longer = {name: value if name == GRAVITY else 2.0 * value for name, value in constants.items()}
    heavier = {**constants, GRAVITY: 2.0 * constants[GRAVITY]}
    lengths, gravities = (combination(text, parameters.raw, scaled, place) for scaled in (longer, heavier))
    found = {_product(of[n], lengths.get(n, 0.0) / f, gravities.get(n, 0.0) / f) for n, f in factors.items()}
    if len(found) > 1 or None in found:
        shown = ", ".join(sorted(unit for unit in found if unit)) or "no unit known here"
        what = f'the parts of "{text}" have not one unit ({shown}{" and others" if None in found else ""})'
        instead = 'Correct it, or say the unit: { expression = "...", unit = "kg m^2" }.'
        raise DeviceValueError(str(place), what, instead)
    return str(found.pop())


def _product(unit: str, longer: float, heavier: float) -> str | None:
    """A parameter's unit times the powers of length and gravity in its factor, None where they are not whole.

    Args:
        unit: of the parameter.
        longer: how much the factor grows when every length doubles.
        heavier: how much it grows when gravity doubles.
    """
    if not (longer > 0 and heavier > 0):
        return None
    powers = np.log2([longer, heavier])
    metres, gravities = (round(power) for power in powers)
    if np.abs(powers - [metres, gravities]).max() > WHOLE:
        return None
    if not metres and not gravities:
        return unit
    if unit not in POWERS:
        return None
    kg, m, s, rad = POWERS[unit]
    made = (kg, m + metres + gravities, s - 2 * gravities, rad)
    return UNITS.get(made) or _written(made)


def _written(powers: tuple[int, int, int, int]) -> str:
    """A unit that has no name of its own, such as `kg m^3`."""
    named = zip(("kg", "m", "s", "rad"), powers, strict=True)
    return " ".join(f"{base}^{power}" if power != 1 else base for base, power in named if power)
