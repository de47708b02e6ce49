"""Aggregates of scores over classes of cases, and their printed table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from zoo.case import FAST_HZ, Case

Row = Mapping[str, Any]
FAST = 8.0
CLASSES: dict[str, Callable[[Case], bool]] = {
    "all": lambda _: True,
    "slow": lambda c: c.motion_hz < FAST,
    "fast": lambda c: c.motion_hz >= FAST,
    "fair": lambda c: fair(c),
    "bits<13": lambda c: c.resolution_bits < 13 and c.motion_hz < FAST,
    "bits13-16": lambda c: 13 <= c.resolution_bits < 16 and c.motion_hz < FAST,
    "bits>=16": lambda c: c.resolution_bits >= 16 and c.motion_hz < FAST,
    "coloured": lambda c: c.encoder != "none",
    "stale": lambda c: c.stale > 0,
    "stale13": lambda c: c.stale > 0.1,
    "jitter": lambda c: c.jitter >= 0.3,
    "gaps": lambda c: c.gaps > 0,
    "AR": lambda c: c.noise == "AR",
    "walk": lambda c: c.noise == "walk",
    "delay": lambda c: c.delay > 0,
    "spread": lambda c: c.spread > 0,
    "slow-friction": lambda c: c.motion_hz < 0.3 and c.friction >= 0.5,
    "loop": lambda c: c.loop,
    "open": lambda c: not c.loop,
    "misfit": lambda c: c.misfit != "none",
    "short": lambda c: c.seconds < 15,
    "one-joint": lambda c: c.device in ("axis", "pendulum"),
    "arm7": lambda c: c.device == "arm7",
    "phantom": lambda c: c.device == "phantom",
    "cea": lambda c: c.device == "cea",
}


def fair(case: Case) -> bool:
    """Whether the log can be used as well as by the oracle: motion that is not of mm, a model that fits."""
    return case.motion_hz <= FAST_HZ and case.misfit == "none" and case.jitter <= 0.6


def aggregate(cases: Sequence[Case], rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Figures of every class; NaN where there are no cases that they could be made from."""
    made = {}
    for name, holds in CLASSES.items():
        pairs = [(c, r) for c, r in zip(cases, rows, strict=True) if holds(c)]
        if pairs:
            made[name] = _figures(pairs)
    return made


def _figures(pairs: Sequence[tuple[Case, Row]]) -> dict[str, float]:
    read = [(c, r) for c, r in pairs if "error" in r]
    exact = [(c, r) for c, r in read if c.misfit == "none"]
    good = [r for _, r in exact if r["status"] == "ok"]
    scored = [r for _, r in read if r.get("ratio") is not None]
    delays = [abs(x) for _, r in exact for x in r["delay_error"]]
    figures = {
        "n": float(len(pairs)),
        "refused": float(len(pairs) - len(read)),
        **_spread("error", [r["error"] for _, r in read]),
        **_spread("oracle", [r["oracle"] for _, r in pairs if r["oracle"] is not None]),
        "floor 50": _percentile([r["floor"] for _, r in pairs], 50),
        **_spread("ratio", [r["ratio"] for r in scored]),
        "bad and ok": float(sum(r["ratio"] > 3 and r["status"] == "ok" for r in scored)),
        "bad and fit for torque": float(sum(r["ratio"] > 3 and r.get("verdict") == "ok" for r in scored)),
        "covered": _mean([r["covered"] for _, r in exact], [r["parameters"] for _, r in exact]),
        "covered with status ok": _mean([r["covered"] for r in good], [r["parameters"] for r in good]),
        "error/se 50": _percentile([r["error_over_se"] for _, r in exact], 50),
        "delay 50": _percentile(delays, 50),
        "delay 90": _percentile(delays, 90),
        "seconds": float(np.mean([r["seconds"] for _, r in pairs])),
    }
    doubts = [abs(x) for _, r in exact for x in r.get("delay_error_over_se", ())]
    if doubts:
        figures["delay error within 2 se"] = float(np.mean(np.array(doubts) <= 2))
    return figures


def _spread(name: str, values: Sequence[float]) -> dict[str, float]:
    return {f"{name} {share}": _percentile(values, share) for share in (50, 75, 90)}


def _percentile(values: Sequence[float], share: float) -> float:
    return float(np.percentile(values, share)) if len(values) else float("nan")


def _mean(values: Sequence[float], weights: Sequence[float]) -> float:
    return float(np.average(values, weights=weights)) if len(values) else float("nan")


def table(figures: Mapping[str, Mapping[str, float]], former: Mapping[str, Mapping[str, float]] | None = None) -> str:
    """The printed table: error, oracle and ratio as median / 75 % / 90 %."""
    head = (
        "class",
        "n",
        "refused",
        "error, %",
        "oracle, %",
        "floor",
        "ratio",
        "bad&ok",
        "cover",
        "of ok",
        "|e|/se",
        "delay err",
        "s",
    )
    lines = [head]
    for name, figure in figures.items():
        lines.append(_line(name, figure))
        if former and name in former:
            lines.append(_line("  former", former[name]))
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join("  ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def _line(name: str, f: Mapping[str, float]) -> tuple[str, ...]:
    three = [
        " / ".join(f"{f[f'{what} {share}']:.3g}" for share in (50, 75, 90)) for what in ("error", "oracle", "ratio")
    ]
    delay = f"{f['delay 50']:.2f} / {f['delay 90']:.2f}"
    return (
        *(name, f"{f['n']:.0f}", f"{f['refused']:.0f}", three[0], three[1], f"{f['floor 50']:.2g}", three[2]),
        *(
            f"{f['bad and ok']:.0f}",
            f"{100 * f['covered']:.0f} %",
            f"{100 * f.get('covered with status ok', float('nan')):.0f} %",
            f"{f['error/se 50']:.2f}",
            delay,
            f"{f['seconds']:.2f}",
        ),
    )


def worst(rows: Sequence[Row], count: int) -> str:
    """Lines of the cases with the worst ratios, and how many were refused for which reason."""
    order = sorted((r for r in rows if r.get("ratio") is not None), key=lambda r: -r["ratio"])[:count]
    lines = [f"{r['ratio']:8.2f} x oracle {r['oracle']:.2f} %, {r['status']}: {r['case']}" for r in order]
    why: dict[str, int] = {}
    for row in rows:
        if "refused" in row:
            why[row["refused"]] = why.get(row["refused"], 0) + 1
    return "\n".join([*lines, *(f"refused {count} x {name}" for name, count in sorted(why.items()))])
