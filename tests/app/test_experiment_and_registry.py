"""The pages of experiments and of the registry: a search as a job, playback, drift over dates, and their refusals."""

from __future__ import annotations

import json
import os
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("starlette")

from test_live_page import until

from browser import LAPTOP, needs_browser
from haptid.app.jobs import JobState
from haptid.cli import app
from haptid.device import read_device
from workbenches import pictured

DEVICE = "devices/two-links.toml"
SEARCH = {"device": DEVICE, "name": "motion", "evaluations": "40", "seconds": "6", "speed": "2,2.5"}


def finished(bench, record):
    """A job when it has ended."""
    return until(
        lambda: (one := bench.ask("GET", f"/api/jobs/{record['id']}")[1])["state"] != JobState.RUNNING and one, "an end"
    )


@pytest.fixture(scope="module")
def searched(bench):
    """A motion of the two links, found by a job."""
    status, record = bench.ask("POST", "/api/experiment/search", SEARCH)
    assert status == 200, record
    done = finished(bench, record)
    assert (done["state"], done["error"], done["defect"]) == (JobState.DONE, "", "")
    return done


def test_a_search_is_that_of_the_command(searched, bench, tmp_path, monkeypatch):
    words = searched["command"].split()
    assert words[:2] == ["haptid", "excite"]
    shutil.copytree(bench.folder / "devices", tmp_path / "devices")
    (tmp_path / "experiments").mkdir()
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, words[1:]).exit_code == 0
    for ending in ("toml", "csv"):
        mine, typed = (folder / f"experiments/motion.{ending}" for folder in (bench.folder, tmp_path))
        assert mine.read_text() == typed.read_text()
    before, after = searched["outcome"]["condition"]
    assert after <= before
    assert any("mean standard error" in step["text"] for step in searched["steps"])
    used = {(one["limit"], one["of"]): one["share"] for one in searched["outcome"]["limits"]}
    made = np.loadtxt(bench.folder / "experiments/motion.csv", delimiter=",", skiprows=1)
    for k, most in enumerate((2.0, 2.5)):
        assert used["speed", str(k + 1)] == pytest.approx(np.abs(made[:, 3 + k]).max() / most, rel=1e-2)
    assert max(used.values()) <= 1.0 + 1e-6


@pytest.mark.parametrize(
    "wrong",
    [
        {"device": "devices/none.toml"},
        {"device": "nothing"},
        {"name": "../x"},
        {"name": "motion"},
        {"evaluations": "0"},
        {"seconds": "1e3"},
        {"evaluations": "99999999999"},
    ],
)
def test_a_wrong_search_does_not_begin(searched, bench, wrong):
    assert searched["state"] == JobState.DONE
    before = sorted(os.listdir(bench.folder / "experiments"))
    status, said = bench.ask("POST", "/api/experiment/search", SEARCH | {"name": "other"} | wrong)
    if status == 200:  # a device file that is not there is found by the job
        assert finished(bench, said)["state"] == JobState.FAILED
    else:
        assert (status, bool(said["error"])) == (400, True)
    assert sorted(os.listdir(bench.folder / "experiments")) == before


def test_limits_that_are_no_numbers_are_said(bench):
    record = bench.ask("POST", "/api/experiment/search", SEARCH | {"name": "other", "speed": "1,2,3"})[1]
    done = finished(bench, record)
    assert done["state"] == JobState.FAILED
    assert "write 2 numbers" in done["error"]


@needs_browser
def test_a_motion_is_played_on_the_drawing(searched, bench, tab, tmp_path):
    tab.go(f"{bench.origin}/experiment?path={searched['outcome']['experiment']}", LAPTOP)
    tab.wait("document.querySelectorAll('#scene input[data-joint]').length === 2")
    assert tab.ask("document.querySelectorAll('.plot').length") == 3
    assert tab.ask("document.querySelectorAll('#limits tbody tr').length") == len(searched["outcome"]["limits"])
    made = np.loadtxt(bench.folder / "experiments/motion.csv", delimiter=",", skiprows=1)
    for share in (0.25, 0.7):
        k = round(share * (len(made) - 1))
        tab.write("#time", str(made[k, 0]))
        shown = tab.ask("[...document.querySelectorAll('#scene input[data-joint]')].map((s) => s.valueAsNumber)")
        np.testing.assert_allclose(shown, made[k, 1:3], atol=5e-3)
    assert tab.accessibility() == []
    pictured(tab, "experiment", tmp_path)
    before = tab.ask("document.getElementById('time').valueAsNumber")
    tab.ask("[...document.querySelectorAll('button')].find((b) => b.textContent === 'Play').click()")
    tab.wait(f"document.getElementById('time').valueAsNumber !== {before}")
    assert tab.ask("document.querySelector('.overlay')?.textContent ?? ''") == ""


def results_of_two_days(bench):
    """Two results of a device with a serial number, on two dates: of the command line."""
    path = bench.folder / DEVICE
    path.write_text(path.read_text().replace('name = "two links"', 'name = "two links"\nserial = "TL-0007"'))
    text = (bench.folder / "studies/two-links.toml").read_text()
    swapped = text.replace("sweep.csv", "@").replace("check.csv", "sweep.csv").replace("@", "check.csv")
    (bench.folder / "studies/swapped.toml").write_text(swapped)
    (bench.folder / "results").mkdir(exist_ok=True)
    for name, study in (("first", "two-links"), ("second", "swapped")):
        record = bench.folder / f"results/{name}"
        run = CliRunner().invoke(app, ["identify", str(bench.folder / f"studies/{study}.toml"), "--out", str(record)])
        assert run.exit_code == 0, run.output


@pytest.mark.usefixtures("small_pictures")
@needs_browser
def test_devices_are_listed_by_serial_number_and_removed_things_are_kept(bench, tab, tmp_path):
    results_of_two_days(bench)
    tab.go(f"{bench.origin}/registry", LAPTOP)
    tab.wait("document.querySelector('main').textContent.includes('TL-0007')")
    assert (
        tab.ask("[...document.querySelectorAll('button')].find((b) => b.textContent === 'Show the drift').disabled")
        is False
    )
    assert tab.accessibility() == []
    pictured(tab, "registry", tmp_path)
    (device,) = (d for d in bench.ask("GET", "/api/registry")[1]["devices"] if d["serial"] == "TL-0007")
    assert device["files"] == [DEVICE]
    assert {one["path"] for one in device["results"]} == {"results/first", "results/second"}
    assert device["command"].startswith("haptid compare results/")
    assert read_device(bench.folder / DEVICE).name == "two links"
    stored = json.loads((bench.folder / "results/first/result.json").read_text())
    assert stored["device_file"]["serial"] == "TL-0007"
    # A renamed log still belongs to its results.
    (bench.folder / "logs/sweep.csv").rename(bench.folder / "logs/monday.csv")
    (device,) = (d for d in bench.ask("GET", "/api/registry")[1]["devices"] if d["serial"] == "TL-0007")
    assert all("logs/monday.csv" in one["logs"] for one in device["results"])
    (bench.folder / "logs/monday.csv").rename(bench.folder / "logs/sweep.csv")
    for path in (
        "devices/two-links.toml",
        "results",
        "results/first/result.json",
        "logs/none.csv",
        "logs/../results/x",
    ):
        assert bench.ask("POST", "/api/registry/remove", {"path": path})[0] == 400
    status, said = bench.ask("POST", "/api/registry/remove", {"path": "results/second"})
    assert (status, said["path"]) == (200, ".haptid/trash/second")
    assert (bench.folder / ".haptid/trash/second/result.json").is_file()
    assert not (bench.folder / "results/second").exists()
    (device,) = (d for d in bench.ask("GET", "/api/registry")[1]["devices"] if d["serial"] == "TL-0007")
    assert [one["path"] for one in device["results"]] == ["results/first"]
