"""Parameters that a log does not tell: no table shows their figures, and result.json keeps them."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from test_partial_estimate import write

import haptid
from haptid.estimation.methods.anchored import reference_torque
from haptid.export import export_latex
from haptid.inference.elimination import eliminate
from haptid.report import ReportSource
from haptid.report.sections.parameters import ParametersSection
from haptid.report.tables import show_identification
from haptid.results.result import Result
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study
from haptid.validation.model_for_use import model_for_use
from motions import motion, multisine, truth

UNKNOWN = {"FV2", "FC2", "OFF2"}
SPRING = """
schema = 1
name = "spring"
gravity = [0.0, 0.0, -9.81]
convention = "modified-dh"
[[joints]]
name = "1"
@joint
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "spring"
joints = "all"
"""
STAGE = 'type = "prismatic"\nalpha = "pi/2"\nlimits = { position = [-0.02, 0.02] }'


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    """Joint 2 turns at constant speed: its friction and offset are one torque, 1.5 N m, told apart by noise alone."""
    return identify(read_study(write(tmp_path_factory.mktemp("steady"), "auto")))


def test_those_that_share_a_direction_are_not_excited_and_the_others_are(found: Identification) -> None:
    assert {p.name for p in found.estimate.parameters if not p.excited} == UNKNOWN
    assert abs(found.estimate["FV2"].value) > 100  # what stood in the tables


def on_a_spring(folder: Path, joint: str, beta: tuple[float, ...], stroke: float) -> haptid.Estimate:
    """Of inertia, friction and a spring, of a joint that moves little, with noise of a third of the torque."""
    (folder / "device.toml").write_text(SPRING.replace("@joint", joint))
    model = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    q, qd, qdd = (2 * stroke * x for x in multisine(1, 8.0, 2e-3, 3))
    tau = haptid.inverse_dynamics(model, np.array(beta), q, qd, qdd)
    tau += 0.3 * tau.std() * np.random.default_rng(0).standard_normal(tau.shape)
    treatment = haptid.Treatment(cutoff_hz=None)
    made = haptid.Motion(2e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T))
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


@pytest.mark.parametrize(
    ("joint", "beta", "stroke"),
    [(STAGE, (0.5, 2.0, 100.0), 0.01), ("alpha = 0", (0.01, 0.05, 40.0), 0.002)],
)
def test_a_spring_that_moves_little_and_is_known_well_keeps_its_figure(
    tmp_path: Path, joint: str, beta: tuple[float, ...], stroke: float
) -> None:
    made = on_a_spring(tmp_path, joint, beta, stroke)
    spring = made["K1"]
    assert spring.relative_se < 1.0
    assert spring.excited
    assert spring.cells.value[0].isdigit()
    low, _, high = spring.cells.interval.partition(" .. ")
    assert float(low) < beta[-1] < float(high)
    use = model_for_use(made)
    assert use.open == ()
    assert float(low) < use.beta[-1] < float(high)  # a weak prior at the poses of a full turn made a tenth of it


def test_the_reference_motion_keeps_a_slide_within_its_limits(tmp_path: Path) -> None:
    """It took it through 3 m both ways; here 20 mm, whose root mean square is a uniform draw's."""
    made = on_a_spring(tmp_path, STAGE, (0.5, 2.0, 100.0), 0.01)
    (motor,) = made.observation.motors
    newton = motor.norm / np.sqrt(motor.rows.sum())
    column = np.linalg.norm(reference_torque(made.observation)[:, made.names.index("K1")])
    assert column * newton == pytest.approx(0.02 / np.sqrt(3), rel=0.15)  # of 200 draws


def test_a_bounded_interval_is_printed_even_of_what_is_not_excited(found: Identification) -> None:
    for p in found.estimate.parameters:
        assert (p.cells.interval == "unbounded") == (not np.isfinite(p.conf_int()).all())
        assert p.excited or p.conf_int()[0] <= 0 <= p.conf_int()[1] or p.se >= abs(p.value)


def test_the_terminal_shows_no_figure_of_them(found: Identification) -> None:
    text = io.StringIO()
    show_identification(Console(file=text, width=160), found)
    lines = {line.split()[0]: line for line in text.getvalue().splitlines() if line.split()}
    for name in UNKNOWN:
        assert lines[name].split()[1:3] == ["not", "excited"]
    assert "unbounded" in lines["FC2"]
    assert " .. " in lines["FV2"]  # its bound
    assert "Not excited: the log does not tell the parameter from zero" in text.getvalue()
    assert lines["FV1"].split()[1][0].isdigit()


def test_the_report_the_notebook_and_a_paper_show_none_either(found: Identification, tmp_path: Path) -> None:
    rows = {row["name"]: row for row in ParametersSection.of(ReportSource(found, "")).rows}
    assert {name for name, row in rows.items() if row["shown"]["value"] == "not excited"} == UNKNOWN
    assert all(rows[name]["uncertain"] and not rows[name]["shown"]["relative"] for name in UNKNOWN)
    assert repr(found.estimate).count("not excited") == len(UNKNOWN)
    export_latex(found, tmp_path, anyway=True)
    tables = "".join(path.read_text() for path in tmp_path.rglob("*_parameters.tex"))
    assert tables.count("& not excited &") == len(UNKNOWN)


def test_the_file_keeps_the_figures_and_says_which_mean_nothing(found: Identification, tmp_path: Path) -> None:
    Result.of(found).save(tmp_path / "result")
    stored = json.loads((tmp_path / "result" / "result.json").read_text())["estimate"]["parameters"]
    assert {p["name"] for p in stored if not p["excited"]} == UNKNOWN
    assert next(p for p in stored if p["name"] == "FV2")["value"] == found.estimate["FV2"].value
    with (tmp_path / "result" / "parameters.csv").open(newline="") as file:
        assert {row["name"] for row in csv.DictReader(file) if row["excited"] == "false"} == UNKNOWN


def test_what_is_excited_but_near_zero_keeps_its_figure() -> None:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    beta[model.base.names.index("FV1")] = 0.0
    made = haptid.estimate(haptid.observe(model, motion(model, beta, seconds=8.0, dt=4e-3, noise=0.05)), haptid.WLS())
    assert made.unexcited == ()
    assert made["FV1"].cells.value != "not excited"


def test_the_table_of_an_elimination_is_aligned_and_prints_the_digits_that_hold() -> None:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    beta[model.base.names.index("FV1")] = 0.0
    made = motion(model, beta, seconds=8.0, dt=4e-3, noise=0.05)
    reduced = eliminate(haptid.estimate(haptid.observe(model, made), haptid.WLS()))
    head, *parts = reduced.summary().split("\n\n")
    assert head.startswith(f"{len(beta)} parameters")
    steps, essential, errors = parts
    assert [line.split()[0] for line in steps.splitlines()[1:]][: len(reduced.steps)] == [s.name for s in reduced.steps]
    heading, *rows = essential.splitlines()
    # A column's cells end where its heading ends.
    for column in ("value", "95 % interval", "unit", "std err %", "change, std errs"):
        end = heading.index(column) + len(column)
        assert all(row[end - 1] != " " and row[end : end + 2].strip() == "" for row in rows)
    for row, name in zip(rows, reduced.essential, strict=True):
        p = reduced.reduced[name]
        assert row.split()[:2] == [name, p.cells.value]
        assert abs(float(p.cells.value) - p.value) <= 0.05 * p.se
        assert len(p.cells.value.partition(".")[2]) == max(0, 1 - int(np.floor(np.log10(p.se))))
    assert [line.split()[0] for line in errors.splitlines()[1:]] == ["rows"]
