"""Fill the tables of docs/*.md from the records under benchmarks/results: python benchmarks/pages.py

A table stands below a mark, `<!-- TITLE -->`, up to the next empty line. What is below a mark is never written by hand.
Of a demonstration the mark names the record, the section of its page and the part: `<!-- phantom-demo: errors, table 2
-->`, or `text` for the section's sentences.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import speed_report
from speed_report import markdown

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
# Below a new mark there is a heading or another mark, and nothing that the part replaces.
MARK = re.compile(r"<!-- (?P<title>[^\n]*) -->\n\n(?:(?!#|<!--)(?P<old>.*?)(?=\n\n|\n*\Z))?", re.DOTALL)
OF_A_DEMO = re.compile(r"(?P<record>\S+-demo): (?P<section>[\w-]+), (?P<part>text|table (?P<number>\d+))")
NUMBER = re.compile(r"(-?[\d.]+(e[-+]\d+)?)?( .*\d.*)?")
WIDTH = 120
Figures = dict[str, float]

# What the record of the estimator benchmark calls a method, by its name on the page, and the counterpart of BIRDy.
METHODS = {
    "OLS": ("OLS", "IDIM-OLS"),
    "WLS": ("WLS", "IDIM-WLS"),
    "SUR": ("SUR", ""),
    "GLS": ("GLS", ""),
    "IRLS": ("IRLS", "IDIM-IRLS"),
    "TLS": ("TLS", "IDIM-TLS"),
    "Heteroscedastic": ("maximum likelihood", "ML"),
    "IV": ("IV", "IDIM-IV"),
    "DIDIM": ("DIDIM", "DIDIM"),
    "CLIE": ("CLIE", "CLIE"),
    "CLOE": ("CLOE", "CLOE"),
    "OutputErrorMethod": ("OutputError", ""),
    "EKF": ("EKF", "DDIM-NKF"),
    "UKF": ("UKF", ""),
    "PhysicallyConsistent(OLS())": ("consistent OLS", "PC-IDIM-OLS"),
    "PhysicallyConsistent()": ("consistent WLS", "PC-IDIM-WLS"),
    "PhysicallyConsistent(IRLS())": ("consistent IRLS", "PC-IDIM-IRLS"),
    "PhysicallyConsistent(IV(controller))": ("consistent IV", "PC-IDIM-IV"),
    "PhysicallyConsistent(DIDIM(controller))": ("consistent DIDIM", "PC-DIDIM"),
}
# Per cent.
SMALL = 1e-3
SORTS = ("torque", "parameters", "Coulomb", "viscous")
# Figures of one task of a data set.
_OF_A_FILE = (
    "samples of a file",
    "bytes of a file",
    "bytes of its R factors",
    "processor time of a file, s",
    "slowest file over the mean",
    "scheduler, s a task",
)


def main() -> None:
    """Fill every page that has marks."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if "<!-- " in text:
            page.write_text(filled(text, part), encoding="utf-8")


def filled(page: str, part_of: Callable[[str], str]) -> str:
    """The page with every part below its mark."""

    def with_part(found: re.Match[str]) -> str:
        made = f"<!-- {found['title']} -->\n\n{part_of(found['title'])}"
        return f"{made}\n\n" if found["old"] is None else made

    return MARK.sub(with_part, page)


def part(title: str) -> str:
    """What stands below a mark.

    Raises:
        KeyError: no part has this title.
    """
    if found := OF_A_DEMO.fullmatch(title):
        record = recorded(found["record"])["sections"][found["section"]]
        if found["number"]:
            return aligned(record["tables"][int(found["number"]) - 1]["cells"])
        return sentences(record["text"])
    if title in PARTS:
        study, made = PARTS[title]
        return made(recorded(study)["figures"])
    return speed_report.parts(speed_report.recorded())[title]


def recorded(study: str) -> dict[str, Any]:
    """A record as it was written."""
    made: dict[str, Any] = json.loads((RESULTS / f"{study}.json").read_text(encoding="utf-8"))
    return made


def estimators(figures: Figures) -> str:
    """Every method, with its counterpart."""
    columns = ("parameters, median, %", "unseen torque, %", "intervals that hold the truth, %")
    lines = []
    for method, (called, counterpart) in METHODS.items():
        parameters, torque, held = (figures[f"{called}: {column}"] for column in columns)
        lines.append((counterpart, f"`{method}`", f"{parameters:.2g}", f"{torque:.2g}", f"{held:.0f}"))
    lines.append(("AdaNN, HTRNN", "left out", "", "", ""))
    heads = ("BIRDy", "haptid", "parameters, %", "torque, %", "coverage of 95 % intervals, %")
    return aligned([heads, *lines])


def less_biased(figures: Figures) -> str:
    """How many times less biased than OLS."""
    methods = ("IV", "DIDIM", "CLIE")
    times = [figures[f"{method}: times less biased than OLS"] for method in methods]
    heads = ("method", *(f"`{method}`" for method in methods))
    return aligned([heads, ("bias of `OLS` over its bias", *(f"{ratio:.2g}" for ratio in times))])


def bench_identification(figures: Figures) -> str:
    """Devices and sorts of data."""
    rows = dict.fromkeys(name.rpartition(": ")[0] for name in figures)
    lines, before = [], ""
    for row in rows:
        device, _, data = row.rpartition(", ")
        errors = (percent(figures[f"{row}: {sort}, %"]) for sort in SORTS)
        lines.append(("" if device == before else device, data, *errors))
        before = device
    return aligned([("device", "data", *SORTS), *lines])


def searches(figures: Figures) -> str:
    """Searches for exciting motions: condition number over processor time, at the end, and of a long search."""
    devices = dict.fromkeys(name.partition(",")[0] for name in figures if "long search" in name)
    lines = []
    for device in devices:
        at = {s: figures.get(f"{device}, condition with unit columns after {s} s") for s in (0.5, 1, 2, 4)}
        ends = [
            figures[f"{device}, {which}"]
            for which in ("condition with unit columns", "worst condition with unit columns")
        ]
        lasted = figures[f"{device}, processor time, s"]
        best = figures[f"{device}, condition with unit columns of a long search"]
        # Beyond it a motion leaves some parameters unexcited, and how much beyond says nothing.
        so_far = ("" if value is None else "> 10000" if value > 1e4 else f"{value:.3g}" for value in at.values())
        tries = f"{figures[f'{device}, evaluations']:.0f}"
        lines.append((device, tries, *so_far, *(f"{end:.3g}" for end in ends), f"{lasted:.2g} s", f"{best:.3g}"))
    columns = ("device", "evaluations", "0.5 s", "1 s", "2 s", "4 s", "end", "worst seed", "time", "ten times as long")
    return aligned([columns, *lines])


def motions(figures: Figures) -> str:
    """Standard errors along other motions over those along the optimal one, medians over the parameters."""
    devices = dict.fromkeys(name.partition(",")[0] for name in figures)
    cells = [
        tuple(
            f"{figures[f'{device}, {other} over optimal, {sort}, median standard error']:.2g}"
            for other in ("random", "hand-made")
            for sort in ("predicted", "identified", "errors")
        )
        for device in devices
    ]
    sorts = ("identified", "errors")
    columns = ("device", "random, predicted", *sorts, "hand-made, predicted", *sorts)
    return aligned([columns, *((device, *row) for device, row in zip(devices, cells, strict=True))])


def percent(error: float) -> str:
    """Two digits; one where an error is so small that another motion would give others."""
    return f"{error:.2g}" if error >= SMALL else f"{error:.0e}"


def mountings(figures: Figures) -> str:
    """Median and worst error with encoders, of each mounting."""
    found = (re.fullmatch(r"encoders, (?!no noise)(.*): torque, median, %", name) for name in figures)
    titles = [each[1] for each in found if each]
    lines = []
    for title in titles:
        pairs = ([figures[f"encoders, {title}: {sort}, {kind}, %"] for kind in ("median", "worst")] for sort in SORTS)
        lines.append((title, *(f"{median:.2g} / {worst:.2g}" for median, worst in pairs)))
    return aligned([("mounting", *SORTS), *lines])


def branches(figures: Figures) -> str:
    """Of each branch: coverage, ratio of standard errors, errors on unseen motion, and what is kept."""
    wanted = {
        "held, mean, %": ("intervals", ".1f"),
        "relative deviation over the published one, worst": ("ratio of standard errors", ".2f"),
        "relative error, unseen motion, median, %": ("error, median", ".2f"),
        "relative error, unseen motion, worst, %": ("error, worst", ".2f"),
        "seeds in which the fifteen alone are kept": ("fifteen alone", ".0f"),
    }
    found = (re.fullmatch(r"([^:]*): held, mean, %", name) for name in figures)
    titles = [each[1] for each in found if each]
    lines = [
        (title, *(format(figures[f"{title}: {what}"], form) for what, (_, form) in wanted.items()))
        for title in titles
        if title != "published parameters"
    ]
    return aligned([("branch", *(head for head, _ in wanted.values())), *lines])


def workbench_figures(figures: Figures) -> str:
    """Every figure with its unit."""

    def cells(name: str, figure: float) -> tuple[str, str, str]:
        what, _, unit = name.rpartition(", ")
        return what, f"{figure:.2g}" if abs(figure) < 10 else f"{figure:.0f}", unit

    return aligned([("", "figure", "unit"), *(cells(*item) for item in figures.items())])


def beside_nicegui(figures: Figures) -> str:
    """A line for each figure: ours, theirs, and theirs where curves are thinned in Python."""

    def cell(name: str) -> str:
        figure = figures.get(name)
        shown = "" if figure is None else "not in a minute" if figure != figure else f"{figure:.2g}"
        return shown if figure is None or not abs(figure) >= 100 else f"{figure:.0f}"

    names = [name.partition(": ")[2] for name in figures if name.startswith("haptid: ")]

    def thinned(name: str) -> str:
        what, _, unit = name.rpartition(", ")
        return f"NiceGUI: {what}, thinned, {unit}"

    cells = [(name, *map(cell, (f"haptid: {name}", f"NiceGUI: {name}", thinned(name)))) for name in names]
    return aligned([("", "haptid", "NiceGUI", "NiceGUI, thinned"), *cells])


def aligned(cells: Any) -> str:
    """A table; columns of numbers are flush right."""
    heads, *lines = ([str(cell).replace("|", "\\|") for cell in line] for line in cells)
    rule = ["---:" if all(NUMBER.fullmatch(cell) for cell in column) else "---" for column in zip(*lines, strict=True)]
    made = markdown(tuple(heads), [tuple(line) for line in lines]).splitlines()
    made[1] = "| " + " | ".join(rule) + " |"
    return "\n".join(made)


def sentences(paragraphs: list[str]) -> str:
    """A list of paragraphs."""
    return "\n".join(_bullets(paragraphs))


def _bullets(paragraphs: list[str]) -> Iterator[str]:
    for paragraph in paragraphs:
        yield textwrap.fill(
            f"- {paragraph}", WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )


def by_size(figures: Figures) -> str:
    """A line for each size of a data set that was identified on one machine."""
    heads = {
        "files": ("files", ".0f"),
        "processor time, s": ("command, processor time, s", ".3g"),
        "of the files, s": ("its files, s", ".3g"),
        "peak memory, GiB": ("peak memory, GiB", ".2f"),
    }
    sizes = [name.partition(" samples: ")[0] for name in figures if name.endswith("samples: files")]
    lines = []
    for size in sizes:
        own = {what: figures[f"{size} samples: {what}"] for what in heads}
        each = f"{1e6 * own['of the files, s'] / float(size):.2g}"
        lines.append((size, *(format(own[what], form) for what, (_, form) in heads.items()), each))
    return aligned([("samples", *(head for head, _ in heads.values()), "of a sample, us"), *lines])


def on_workers(figures: Figures) -> str:
    """What was measured on a cluster of this machine, with the model's times beside those of the clock."""
    lines = [
        (name, f"{figures[name]:.3g}")
        for name in figures
        if ("worker" in name and "samples on" not in name and "assumed" not in name) or name in _OF_A_FILE
    ]
    return aligned([("measured", "figure"), *lines])


def of_more_samples(figures: Figures) -> str:
    """What 10^9 samples cost by the model: a line for each part, a column for each number of workers."""
    found = [name.partition(": ") for name in figures if " samples on " in name]
    columns = list(dict.fromkeys(of for of, _, _ in found))
    parts = list(dict.fromkeys(what for _, _, what in found))
    lines = [(what, *(f"{figures[f'{of}: {what}']:.3g}" for of in columns)) for what in parts]
    return aligned([("extrapolated", *columns), *lines])


# By their titles: the study and what is made of its figures.
PARTS: dict[str, tuple[str, Callable[[Figures], str]]] = {
    "Every estimator on one arm": ("estimator-benchmark", estimators),
    "Bias where the columns are noisy": ("noisy-columns", less_biased),
    "Identification from the bench": ("bench-identification", bench_identification),
    "Searches for exciting motions": ("exciting-motion", searches),
    "Motions on the bench": ("motion-quality", motions),
    "Twenty seeds of each mounting": ("phantom-study", mountings),
    "Twenty seeds of each branch": ("medical-study", branches),
    "Workbench": ("workbench", workbench_figures),
    "Live": ("live", workbench_figures),
    "Beside NiceGUI": ("beside-nicegui", beside_nicegui),
    "Data sets by size": ("past-one-machine", by_size),
    "Two workers of one machine": ("past-one-machine", on_workers),
    "A thousand million samples": ("past-one-machine", of_more_samples),
}

if __name__ == "__main__":
    main()
