"""Error bounds of code in single precision, as lines of the header's heading."""

from __future__ import annotations

import math
from collections.abc import Mapping

from haptid.export.expressions.functions_in_intervals import ULPS, ULPS_OF_WAVES
from haptid.export.expressions.rounding import error_bounds
from haptid.export.model.functions import Code
from haptid.export.model.ranges import Ranges
from haptid.export.output import CCode
from haptid.export.provenance import Provenance

# OutputBounds of each function, by the names of its outputs.
OutputBounds = Mapping[str, Mapping[str, tuple[float, ...]]]

_HEAD = "Single precision. For positions, rates and accelerations within"
_CLAIM = (
    "and the base parameters below, outputs of these functions differ from those of the code in double precision, for",
    "the same inputs, by at most (of outputs that are no torques the largest entry; in the output's unit):",
)
_TAIL = (
    "Interval analysis of the rounding of every operation and parameter, with compilers that do not reorder them (no",
    f"-ffast-math); sinf and cosf are taken to be within {ULPS_OF_WAVES} unit in the last place, others within {ULPS}.",
)


def single_precision_bounds(source: Provenance, code: Code, settings: CCode) -> OutputBounds:
    """Largest differences of outputs from those in double precision; infinite where no bound is known."""
    inputs = Ranges.of(source.model, code.passive, settings).inputs
    parameters = {f"p[{k}]": float(value) for k, value in enumerate(source.beta)}
    return {
        function.name: {
            name: tuple(error_bounds(code.graph, values, inputs, parameters)) for name, values in function.outputs
        }
        for function in code.functions
    }


def single_precision_lines(source: Provenance, code: Code, settings: CCode, bounds: OutputBounds) -> list[str]:
    """What is claimed, for which ranges, and the bounds of every function."""
    ranges, units = Ranges.of(source.model, code.passive, settings), source.model.device.coordinate_units
    lines = [_HEAD]
    for k, ((low, high), unit) in enumerate(zip(ranges.position, units, strict=True)):
        rate, acceleration = ranges.rate[k], ranges.acceleration[k]
        position = f"q[{k}] {low:.6g} .. {high:.6g} {unit}"
        lines.append(f"  {position}; |qd[{k}]| {rate:.6g} {unit}/s; |qdd[{k}]| {acceleration:.6g} {unit}/s^2")
    lines += _CLAIM
    unknown = []
    for function, outputs in bounds.items():
        if not all(math.isfinite(bound) for values in outputs.values() for bound in values):
            unknown.append(function)
            continue
        for name, values in outputs.items():
            shown = values if name == "tau" else (max(values, default=0.0),)
            lines.append(f"  {function}, {name}: {' '.join(map(_rounded_up, shown))}")
    lines += _TAIL
    if unknown:
        lines.append(
            f"No bound is known of {', '.join(unknown)}: these divide by what can be small, or read other inputs."
        )
    return lines


def _rounded_up(bound: float) -> str:
    """Two digits that are not below it."""
    text = f"{bound:.1e}"
    return text if float(text) >= bound else f"{bound * 1.05:.1e}"
