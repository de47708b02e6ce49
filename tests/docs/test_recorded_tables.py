"""Tables of the pages hold the recorded figures of the benchmarks."""

import json
import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
# What the benchmark calls a method that the page writes as code.
CALLED = {
    "Heteroscedastic": "maximum likelihood",
    "OutputErrorMethod": "OutputError",
    "PhysicallyConsistent(OLS())": "consistent OLS",
    "PhysicallyConsistent()": "consistent WLS",
    "PhysicallyConsistent(IRLS())": "consistent IRLS",
    "PhysicallyConsistent(IV(controller))": "consistent IV",
    "PhysicallyConsistent(DIDIM(controller))": "consistent DIDIM",
}
COLUMNS = ("parameters, median, %", "unseen torque, %", "intervals that hold the truth, %")


def test_the_estimator_benchmark_has_the_recorded_figures():
    file = PROJECT / "benchmarks/results/estimator-benchmark.json"
    recorded = json.loads(file.read_text(encoding="utf-8"))["figures"]
    page = (PROJECT / "docs/simulation-based.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|[^|]*\| `(.*?)` \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", page, re.MULTILINE)
    named = {CALLED.get(method, method) for method, *_ in rows}
    assert named == {what.partition(":")[0] for what in recorded}
    for method, *figures in rows:
        for column, figure in zip(COLUMNS, figures, strict=True):
            assert float(figure) == pytest.approx(recorded[f"{CALLED.get(method, method)}: {column}"], rel=0.06)


def test_noise_in_the_columns_biases_as_recorded():
    file = PROJECT / "benchmarks/results/noisy-columns.json"
    recorded = json.loads(file.read_text(encoding="utf-8"))["figures"]
    page = " ".join((PROJECT / "docs/simulation-based.md").read_text(encoding="utf-8").split())
    quoted = re.search(
        r"is ([\d.]+) times smaller with `IV`, (\d+) times with `DIDIM` and (\d+) times with `CLIE`", page
    )
    assert quoted is not None
    for method, figure in zip(("IV", "DIDIM", "CLIE"), quoted.groups(), strict=True):
        assert float(figure) == pytest.approx(recorded[f"{method}: times less biased than OLS"], rel=0.06)
        assert recorded[f"{method}: times less biased than OLS"] > 3


@pytest.mark.parametrize(("page", "prefix"), [("payload", "bench: "), ("poses", "poses: ")])
def test_payload_tables_have_the_recorded_figures(page, prefix):
    file = PROJECT / "benchmarks/results/payloads.json"
    recorded = json.loads(file.read_text(encoding="utf-8"))["figures"]
    text = (PROJECT / f"docs/{page}.md").read_text(encoding="utf-8").partition("## Measured")[2]
    rows = dict(re.findall(r"^\| (.*?) \| ([\d.]+) \|$", text, re.MULTILINE))
    assert {prefix + what for what in rows} == {what for what in recorded if what.startswith(prefix)}
    for what, figure in rows.items():
        assert float(figure) == pytest.approx(recorded[prefix + what], rel=0.01)
