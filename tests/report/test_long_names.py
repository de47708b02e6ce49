"""Names of forty letters of thirteen joints: tables, formulas and charts hold them."""

import io
from types import SimpleNamespace

from rich.console import Console

from browser import LAPTOP, needs_browser
from haptid.report.mathml import parameter
from haptid.report.tables import error_table
from reported import made

LONG = [f"the_{k}_joint_of_the_left_manipulator_arm" for k in range(13)]


def test_long_names_of_many_motors_have_numbers_in_the_table_of_errors():
    """They were broken into columns of seven letters, and their figures could not be read."""
    for names, numbered in ((LONG, True), (["1", "2", "3"], False)):
        motors = [SimpleNamespace(label=f"motor {name}", name=name, free=True, rows=9, relative=1.25) for name in names]
        errors = SimpleNamespace(motors=motors, relative=1.25, seen=True, reference=None)
        entry, observation = SimpleNamespace(path="log.csv"), SimpleNamespace(motors=motors)
        run = SimpleNamespace(entry=entry, fit_errors=errors, unseen=(), observation=observation)
        console = Console(file=io.StringIO(), width=100)
        console.print(error_table((run,), "joint"))
        text = console.file.getvalue()
        assert (f"; {len(names)} is motor {names[-1]}" in " ".join(text.split())) is numbered
        row = next(line for line in text.splitlines() if line.startswith("log.csv"))
        assert row.count("1.25") == len(names) + 1


def test_names_with_underscores_are_subscripts_of_their_kind():
    assert parameter("ZZthe_left_1R") == "<math><msub><mi>ZZ</mi><mi>the_left_1R</mi></msub></math>"
    assert parameter("pi_1") == "<math><msub><mi>&#x3c0;</mi><mi>1</mi></msub></math>"


@needs_browser
def test_long_names_beside_a_chart_fit_and_are_whole_in_their_title(tab, folder):
    made().write(folder)
    page, name = folder / "report.html", "ZZ" + LONG[0] + LONG[1] + "R"
    text = page.read_text(encoding="utf-8")
    assert '"ZZbaR"' in text
    page.write_text(text.replace('"ZZbaR"', f'"{name}"'), encoding="utf-8")
    tab.open(page, LAPTOP)
    texts = "[...document.querySelectorAll('#parameters svg.drawing text')]"
    shown = tab.ask(
        f"{texts}.filter((t) => t.querySelector('title')).map((t) => [t.firstChild.data,"
        " t.querySelector('title').textContent,"
        " t.getBoundingClientRect().left - t.closest('svg').getBoundingClientRect().left])"
    )
    assert shown
    for short, whole, left in shown:
        assert whole == name
        assert "…" in short
        assert short.endswith("armR")
        assert left >= 0
