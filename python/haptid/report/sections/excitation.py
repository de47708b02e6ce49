"""Information on each parameter by motor, log and time.

The information on parameter k given all others is 1 / (H^-1)_kk, with H the sum of all weighted W'W. With
u = H^-1 e_k / (H^-1)_kk it is u' H u, a sum over motors and blocks of rows (Frisch and Waugh 1933, Econometrica 1(4)).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.inference.diagnosis.excitation import advice
from haptid.inference.diagnosis.verdict import QUOTABLE
from haptid.report.chart import COLOURS, Chart, packed
from haptid.report.section import Section
from haptid.report.source import ReportSource
from haptid.uncertainty.figures import per_cent

# Columns of the map over time; more blocks are merged.
COLUMNS = 120


@dataclass(frozen=True)
class ExcitationSection(Section):
    """Distribution of the information.

    Attributes:
        weakest: of the parameters with the largest relative standard errors: name, relative standard error, advice.
    """

    key: ClassVar[str] = "excitation"
    title: ClassVar[str] = "Excitation"
    weakest: list[dict[str, str]]

    @classmethod
    def of(cls, source: ReportSource) -> ExcitationSection:
        estimate = source.estimate
        by_motor, by_block = information(estimate)
        names = [estimate.base.names[k] for k in estimate.free_parameters]
        motors = [motor.label for motor in estimate.observation.motors]
        charts = [_bars("motor", names, motors, by_motor)] if len(motors) > 1 else []
        runs = [run for run in source.identification.runs if run.fit_errors is not None]
        logs = [run.entry.path for run in runs]
        log_of = _log_of(estimate, [run.observation.blocks for run in runs])
        if len(logs) > 1:
            by_log = np.array([by_block[:, log_of == k].sum(axis=1) for k in range(len(logs))]).T
            charts.append(_bars("log", names, logs, by_log))
        charts += [
            _map(estimate, names, by_block[:, log_of == k], log, k, np.flatnonzero(log_of == k))
            for k, log in enumerate(logs)
        ]
        return cls(charts=tuple(charts), weakest=_weakest(estimate))


def information(estimate: Estimate) -> tuple[Array, Array]:
    """Shares of each free parameter's information by motor, (kept, motors), and by block, (kept, blocks)."""
    free = list(estimate.free_parameters)
    R = estimate.observation.stack(estimate.weights)[:-1, free]
    inverse = np.linalg.inv(R.T @ R)
    U = np.zeros((len(estimate.beta), len(free)))
    U[free] = inverse / np.diag(inverse)
    parts = []
    for weight, motor in zip(estimate.weights, estimate.observation.motors, strict=True):
        carried = motor.r_factors[:, :, :-1] @ U[motor.columns]
        parts.append(weight**2 * (carried**2).sum(axis=1))
    information = np.array(parts)  # (motors, blocks, kept)
    information /= information.sum(axis=(0, 1))
    return information.sum(axis=1).T, information.sum(axis=0).T


def _log_of(estimate: Estimate, blocks: list[Any]) -> np.ndarray:
    """Index of the log that each of the estimate's blocks is from, (blocks,)."""
    log_index = {block: k for k, some in enumerate(blocks) for block in some}
    return np.array([log_index[block] for block in estimate.observation.blocks])


def _bars(title: str, names: list[str], sources: list[str], shares: Array) -> Chart:
    """One bar for each parameter, stacked by source."""
    largest = int(np.argmax(shares.max(axis=1)))
    only = [name for name, row in zip(names, shares, strict=True) if row.max() > 0.99]
    caption = (
        f"{len(only)} of {len(names)} parameters have over 99 % of their information from one {title}. "
        f"{names[largest]} depends most on one: {100 * float(shares[largest].max()):.0f} % from "
        f"{sources[int(np.argmax(shares[largest]))]}."
    )
    drawing = {
        "kind": "bars",
        "rows": names,
        "parts": [{"name": name, "colour": COLOURS[1:][k % (len(COLOURS) - 1)]} for k, name in enumerate(sources)],
        "values": packed(100 * shares),
        "unit": "%",
    }
    alt = f"Share of each parameter's information by {title}, a bar for each parameter."
    return Chart(f"information-{title}", f"By {title}", alt, caption, drawing)


def _map(estimate: Estimate, names: list[str], shares: Array, log: str, k: int, members: np.ndarray) -> Chart:
    """Information over the time of one log, relative to an even distribution."""
    blocks = [estimate.observation.blocks[int(b)] for b in members]
    width = -(-len(blocks) // COLUMNS)
    starts = np.arange(0, len(blocks), width)
    even = np.diff(np.append(starts, len(blocks))) / len(blocks)
    totals = shares.sum(axis=1, keepdims=True)
    density = np.add.reduceat(shares, starts, axis=1) / np.where(totals > 0, totals, 1.0) / even
    row, column = np.unravel_index(int(np.argmax(density)), density.shape)
    high = float(density.max())
    caption = (
        f"1: evenly distributed over the log. Information on {names[int(row)]} is the most unevenly distributed: "
        f"{high:.1f} times the average between "
        f"{blocks[int(starts[column])].start:.1f} and {_end(blocks, starts, int(column)):.1f} s."
    )
    drawing = {
        "kind": "heat",
        "rows": names,
        "columns": [f"{blocks[int(s)].start:.1f}" for s in starts],
        "ramp": "sequential",
        "low": 0,
        "high": high,
        "unit": "",
        "x": "time, s",
        "layers": [{"name": "information", "values": packed(density), "marks": []}],
    }
    alt = f"Map of the information on each parameter over the time of {log}."
    return Chart(f"information-time-{k}", f"Over time: {log}", alt, caption, drawing)


def _end(blocks: list[Any], starts: np.ndarray, column: int) -> float:
    last = int(starts[column + 1]) - 1 if column + 1 < len(starts) else len(blocks) - 1
    return float(blocks[last].stop)


def _weakest(estimate: Estimate) -> list[dict[str, str]]:
    """Up to five parameters whose standard errors are too large to quote, and motions that would excite them better."""
    relative = [(estimate.parameters[k].relative_se, k) for k in estimate.free_parameters]
    ranked = sorted((pair for pair in relative if pair[0] >= QUOTABLE), reverse=True)[:5]
    return [
        {"name": estimate.base.names[k], "deviation": per_cent(value), "advice": advice(estimate, k)}
        for value, k in ranked
    ]
