"""Data objects of MATLAB's System Identification Toolbox, `iddata`: signals of each experiment by their own names.

Source: MathWorks, System Identification Toolbox, `iddata`: outputs and inputs as cells of one experiment each, a
sampling period (`Ts`, `Tstart`) or instants, and names and units of the signals.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid.log.formats.sniff import RawChannel, numeric

_FIELDS = {"OutputData", "OutputName", "InputData", "InputName", "Ts", "TimeUnit"}
# Units of times as they are called there.
_TIME_UNITS = {"seconds": "s", "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns", "s": "s", "ms": "ms"}


def is_iddata(value: np.ndarray) -> bool:
    """Whether an object has the properties of one."""
    return value.size == 1 and value.dtype.names is not None and set(value.dtype.names) >= _FIELDS


def iddata_leaves(name: str, value: np.ndarray) -> Iterator[tuple[str, RawChannel]]:
    """Times and signals of each experiment, `run.y1`, or `run[2].y1` of several; times in the unit that they have."""
    one = value.flat[0]
    experiments = _cells(one["OutputData"])
    for k, outputs in enumerate(experiments):
        inputs = _at(one["InputData"], k)
        samples = max((len(signals) for signals in (outputs, inputs) if signals is not None), default=0)
        if not samples:
            continue
        own = name if len(experiments) == 1 else f"{name}[{k + 1}]"
        times = _times(one, k, samples)
        if times is not None:
            unit = _TIME_UNITS.get(_text(one["TimeUnit"]), "")
            yield f"{own}.Time [{unit}]" if unit else f"{own}.Time", times
        for signals, side in ((outputs, "Output"), (inputs, "Input")):
            titles, units = (_texts(one[f"{side}{part}"]) for part in ("Name", "Unit"))
            for i, signal in enumerate(() if signals is None else signals.T):
                title = titles[i] if i < len(titles) and titles[i] else f"{side[0].lower()}{i + 1}"
                unit = units[i] if i < len(units) else ""
                yield f"{own}.{title} [{unit}]" if unit else f"{own}.{title}", signal


def _times(one: np.void, k: int, samples: int) -> RawChannel | None:
    instants = _at(one["SamplingInstants"], k) if "SamplingInstants" in (one.dtype.names or ()) else None
    if instants is not None and instants.size == samples:
        return instants.ravel()
    period = _at(one["Ts"], k)
    start = _at(one["Tstart"], k) if "Tstart" in (one.dtype.names or ()) else None
    if period is None or period.size != 1:
        return None
    return (float(start.flat[0]) if start is not None and start.size else 0.0) + float(period.flat[0]) * np.arange(
        samples
    )


def _cells(value: np.ndarray) -> list[RawChannel | None]:
    """Arrays of the experiments, (samples, signals); None for one without."""
    found = list(value.flat) if value.dtype == object else [value]
    kept = [cell if isinstance(cell, np.ndarray) and numeric(cell.dtype) and cell.ndim == 2 else None for cell in found]
    return [None if cell is None or not cell.size else cell for cell in kept]


def _at(value: np.ndarray, k: int) -> RawChannel | None:
    cells = _cells(value)
    return cells[k] if k < len(cells) else None


def _texts(value: np.ndarray) -> list[str]:
    return [_text(cell) for cell in (value.flat if value.dtype == object else [value])]


def _text(value: object) -> str:
    """A text of MATLAB; empty for anything else."""
    return str(value.flat[0]).strip() if type(value) is np.ndarray and value.dtype.kind == "U" and value.size else ""
