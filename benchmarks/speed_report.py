"""Tables of the comparison with other packages, from the records; run as a script, it fills in docs/speed.md."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
STUDIES = frozenset({"kernel", "dynamics", "file-to-result", "start-up"})
# Back end with which `kernel` and `dynamics` are recorded too, on a processor that has a wider one.
NARROWER = "avx2"
ALL = ("Pinocchio C++", "Pinocchio Python", "CasADi C", "iDynTree", "MuJoCo", "figaroh")
# Targets of the ratio of a peer's time to that of haptid.
TARGETS = {
    ("regressor in cache", "Pinocchio C++"): 20.0,
    ("regressor in cache", "Pinocchio Python"): 40.0,
    ("regressor in cache", "CasADi C"): 3.5,
    ("regressor and reduction", "NumPy"): 12.0,
    ("regressor and reduction of 8192, 2 threads", "one thread"): 1.7,
    ("400000 samples", "script with Pinocchio and SciPy"): 10.0,
    ("400000 samples", "figaroh's functions"): 10.0,
}
# Target of the start-up time of the help, s.
HELP = 0.3
Records = dict[str, dict[str, float]]


def recorded() -> Records:
    """Figures of the studies that are recorded; ratios with the narrower back end beside the others."""
    made: Records = {}
    for study in sorted(STUDIES):
        for backend in ("", f"-{NARROWER}"):
            file = ROOT / "benchmarks" / "results" / f"{study}{backend}.json"
            found = json.loads(file.read_text(encoding="utf-8"))["figures"] if file.exists() else {}
            if backend:
                found = {
                    f"{name}, {NARROWER}": figure for name, figure in found.items() if name.endswith("over haptid")
                }
            if found:
                made.setdefault(study, {}).update(found)
    return made


def table(records: Records) -> str:
    """All parts, as Markdown."""
    return "\n\n".join(f"{title}\n\n{part}" for title, part in parts(records).items())


def parts(records: Records) -> dict[str, str]:
    """By their titles, of what is recorded."""
    made = {title: part(records[study]) for title, (study, part) in PARTS.items() if study in records}
    missing = [peer for peer in ALL if not any(peer in name for figures in records.values() for name in figures)]
    return made | ({"Left out": ", ".join(missing) or "No peer is left out."} if records else {})


def compared(figures: dict[str, float]) -> str:
    """A line for each task and each peer; the ratio with the narrower back end where it is recorded."""
    lines, narrow = [], any(name.endswith(f", {NARROWER}") for name in figures)
    for name, ratio in figures.items():
        found = re.fullmatch(r"(.*): (.*) over haptid", name)
        if found:
            work, peer = found.groups()
            ours, theirs = time_of(figures, work, "haptid"), ratio * time_of(figures, work, "haptid")
            target = TARGETS.get((work, peer))
            other = figures.get(f"{name}, {NARROWER}")
            more = ("" if other is None else times(other),) if narrow else ()
            lines.append((work, shown(ours), peer, shown(theirs), times(ratio), *more, verdict(ratio, target)))
    heads = (f"ratio, {NARROWER.upper()}",) if narrow else ()
    return markdown(("task", "haptid", "peer", "its time", "ratio", *heads, "target"), ordered(lines))


def ordered(lines: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Lines of the same work one below the other, works in the order of their first."""
    works = list(dict.fromkeys(line[0] for line in lines))
    return sorted(lines, key=lambda line: works.index(line[0]))


def time_of(figures: dict[str, float], work: str, who: str) -> float:
    """Microseconds, or seconds of a whole pipeline."""
    return figures.get(f"{work}: {who}, us", figures.get(f"{work}: {who}, s", float("nan")))


def verdict(ratio: float, target: float | None) -> str:
    """The target, and whether it is reached."""
    if target is None:
        return ""
    return f"{target:g}, {'reached' if ratio >= target else 'not reached'}"


def limits(figures: dict[str, float]) -> str:
    """Operations, bytes, and shares of the machine's limits."""
    if "memory fill, GB/s" not in figures:
        return "Not measured: there is no compiler."
    peak, fill = figures["multiply-add peak, GF/s"], figures["memory fill, GB/s"]
    lines = [("multiply-adds in registers", "", f"{peak:.3g} GF/s", ""), ("memory fill", "", f"{fill:.3g} GB/s", "")]
    counted = figures.get("regressor in cache: operations per sample")
    if counted is not None:
        both = counted + figures["reduction: operations per sample"]
        for work, count in (("regressor in cache", counted), ("regressor and reduction of 8192", both)):
            share = figures[f"{work}: share of the multiply-add peak, %"]
            speed = figures[f"{work}: GF/s"]
            lines.append((work, f"{count:.0f} operations", f"{speed:.3g} GF/s", f"{share:.0f} %"))
    count, speed = figures["regressor, stored: bytes per sample"], figures["regressor, stored: GB/s"]
    share = figures["regressor, stored: share of memory fill, %"]
    lines.append(("regressor of 8192, stored", f"{count:.0f} bytes", f"{speed:.3g} GB/s", f"{share:.0f} %"))
    return markdown(("task", "per sample", "speed", "share of the limit"), lines)


def memory(figures: dict[str, float]) -> str:
    """Time, memory and error of every pipeline from a file to a result."""
    lines = []
    for name, peak in figures.items():
        found = re.fullmatch(r"(.*): (.*), peak memory, GiB", name)
        if found:
            off = figures[f"{found[1]}: {found[2]}, error of torque, %"]
            seconds = figures[f"{found[1]}: {found[2]}, s"]
            lines.append((found[1], found[2], shown(seconds), f"{peak:.2f}", f"{off:.2g}"))
    return markdown(("log", "pipeline", "seconds", "peak memory, GiB", "error of the model's torque, %"), lines)


def start_up(figures: dict[str, float]) -> str:
    """Start-up time of commands and packages."""
    lines = []
    for name, seconds in figures.items():
        what = name.removesuffix(", s")
        held = f"below {HELP}, {'reached' if seconds < HELP else 'not reached'}" if what == "haptid --help" else ""
        lines.append((f"`{what}`" if "without" not in what else what, f"{seconds:.2f}", held))
    return markdown(("what", "seconds", "target"), lines)


def shown(number: float) -> str:
    """Three digits."""
    return f"{number:.0f}" if number >= 100 else f"{number:.3g}"


def times(ratio: float) -> str:
    """A ratio, two digits."""
    return f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}" if ratio >= 1 else f"{ratio:.2f}"


def markdown(heads: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """A table."""
    rows = [heads, ("---",) * len(heads), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


# Every part: its study, and what is made of the figures.
PARTS = {
    "Regressor and reduction, microseconds per sample": ("kernel", compared),
    "The machine's limits": ("kernel", limits),
    "Dynamics, microseconds for each": ("dynamics", compared),
    "From a file to a result, seconds": ("file-to-result", compared),
    "Memory and error": ("file-to-result", memory),
    "Start-up": ("start-up", start_up),
}
