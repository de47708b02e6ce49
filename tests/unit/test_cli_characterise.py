"""`haptid characterise`: from a result folder to figures at the handle."""

import csv
import json
import runpy

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.cli.handle import _several
from haptid.end_effector.characterisation import characterise
from haptid.end_effector.characterisation.table import TableColumn
from haptid.results.result import Result
from haptid.study import read_study
from haptid.study.identify import identify
from haptid.uncertainty.quantities import Field


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, request):
    """The result of the example's study."""
    examples, made = request.config.rootpath / "examples" / "phantom", tmp_path_factory.mktemp("result")
    runpy.run_path(str(examples / "make_logs.py"))["main"](made)
    Result.of(identify(read_study(examples / "study.toml"), made)).save(made)
    return made


def table(path):
    with (path / "figures.csv").open() as file:
        return list(csv.DictReader(file))


def test_help_says_what_goes_in_and_what_comes_out():
    text = call("characterise", "--help").stdout
    for part in ("RESULT", "--at", "--sweep", "--grid", "figures.csv", "masses.png", "Exit status", "Example"):
        assert part in text


def test_a_pose_has_every_figure_with_its_interval(folder, tmp_path):
    limits = [part for name in "123" for part in ("--torque", f"{name}=1.5")]
    asked = ("--along", "0,0,1", "--speed", 0.5, "--stiffness", 300, *limits)
    done = call("characterise", folder, "--at", "0,0.2,0.3", *asked, "--out", tmp_path / "at")
    assert done.exit_code == 0, done.output
    (row,) = table(tmp_path / "at")
    found = characterise(Result.load(folder).identified, np.array([[0.0], [0.2], [0.3]]))
    low, high = found.apparent_mass.conf_int()[0, 0]
    assert float(row["apparent mass 1 [kg]"]) == found.apparent_mass.values[0, 0]
    assert (float(row["apparent mass 1 [kg] ci_low"]), float(row["apparent mass 1 [kg] ci_high"])) == (low, high)
    assert float(row["back-drive force along [N]"]) == found.backdrive_force([0, 0, 1]).values[0]
    assert float(row["stiffness 1 [N/m]"]) == pytest.approx(found.stiffness([300.0] * 3)[0][0, 0])
    assert float(row["greatest force in its worst direction [N]"]) > 0
    for part in ("isotropy", "neglected force at 0.5 m/s", "viscous friction 1", "greatest force along"):
        assert part in done.stdout
    assert not (tmp_path / "at" / "masses.png").exists()


@pytest.mark.usefixtures("full_pictures")
def test_a_sweep_is_drawn_and_starts_and_ends_at_its_poses(folder, tmp_path):
    done = call("characterise", folder, "--sweep", "0,-0.2,0.3", "0,0.8,0.3", "--out", tmp_path / "s", "--quiet")
    assert done.exit_code == 0, done.output
    assert done.stdout == ""
    rows = table(tmp_path / "s")
    names = haptid.DynamicModel(haptid.read_device("phantom_premium_15")).device.joint_names
    assert [[float(row[f"{name} [rad]"]) for name in names[:1]] for row in (rows[0], rows[-1])] == [[0.0], [0.0]]
    assert (tmp_path / "s" / "masses.png").stat().st_size > 10_000


@pytest.mark.usefixtures("full_pictures")
def test_singular_poses_are_reported_and_empty(folder, tmp_path):
    done = call("characterise", folder, "--grid", 3000, "--out", tmp_path / "g")
    assert done.exit_code == 0, done.output
    assert "are left out" in done.stdout
    rows = table(tmp_path / "g")
    lost = [row for row in rows if float(row["condition"] or "inf") > 30]
    assert lost
    assert all(row["apparent mass 1 [kg]"] == "" for row in lost)
    assert (tmp_path / "g" / "masses.png").stat().st_size > 10_000


def test_what_cancels_over_the_poses_is_printed_as_zero():
    """A weight that cancels by symmetry was printed with the digits of rounding: 8.524e-17 N."""
    column = TableColumn("weight x", Field(np.array([-3.0, -8.5e-17, 3.0]), None, np.inf, "N"))
    assert _several(column) == ["0", "-3", "3", ""]
    small = TableColumn("mass", Field(np.array([1e-9, 2e-9, 3e-9]), None, np.inf, "kg"))
    assert _several(small)[:3] == ["2e-09", "1e-09", "3e-09"]


def test_limits_narrow_the_grid(folder, tmp_path):
    done = call("characterise", folder, "--grid", 60, "--limit", "ba=-0.1:0.1", "--out", tmp_path / "n", "--quiet")
    assert done.exit_code == 0, done.output
    assert max(abs(float(row["ba [rad]"])) for row in table(tmp_path / "n")) <= 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--at", "0,1"), "3 numbers"),
        (("--at", "0,1,x"), "3 numbers"),
        (("--at", "0,1,2", "--grid", 3), "one of them"),
        (("--limit", "ba"), "NAME=LOW:HIGH"),
        (("--limit", "bo=0:1"), "one of the joints"),
        (("--at", "0,0,0", "--torque", "1"), "NAME=NUMBER"),
        (("--at", "0,0,0", "--torque", "9=1"), "9"),
        (("--at", "0,0,0", "--along", "0,0,0"), "direction"),
        (("--at", "0,0,0", "--stiffness", "1,2"), "3 numbers"),
    ],
)
def test_what_cannot_be_is_one_line(folder, tmp_path, options, words):
    done = call("characterise", folder, *options, "--out", tmp_path / "none")
    assert done.exit_code == 2
    assert words in done.stderr
    assert done.stderr.strip().startswith("error: ")
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "none").exists()


def test_what_is_no_result_is_one_line(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps({"schema": 1}))
    done = call("characterise", tmp_path, "--at", "0,0,0", "--out", tmp_path / "none")
    assert done.exit_code == 2
    assert "haptid identify" in done.stderr
