"""Jobs: a check before a run, the numbers of the command line, cancelling, and a server that is killed."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

pytest.importorskip("starlette")

import haptid
from haptid.app.jobs import JobRecord, Jobs, JobState
from haptid.cli import app
from haptid.inference import drift
from small_study import columns
from workbenches import ended, started

STUDY, OUT = "studies/two-links.toml", "results/two-links"
PATIENCE = 120.0


def until(condition, what: str):
    """The value of a condition as soon as it is true."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, f"never: {what}"
        time.sleep(0.02)
    return found


def finished(bench, record):
    """A job when it has ended."""
    return until(
        lambda: (one := bench.ask("GET", f"/api/jobs/{record['id']}")[1])["state"] != JobState.RUNNING and one,
        "a job's end",
    )


def left(folder: Path) -> list[str]:
    """What is in a folder, hidden or not."""
    return sorted(os.listdir(folder)) if folder.is_dir() else []


def test_a_run_needs_a_check_of_exactly_its_inputs(bench):
    run = {"path": STUDY, "out": OUT}
    status, said = bench.ask("POST", "/api/identify", run)
    assert (status, "Check it first" in said["error"]) == (400, True)
    checked = finished(bench, bench.ask("POST", "/api/check", {"path": STUDY})[1])
    assert (checked["state"], checked["outcome"]["check"]["problems"]) == (JobState.DONE, [])
    assert bench.ask("GET", f"/api/study/state?path={STUDY}")[1]["ready"]
    device = bench.folder / "devices" / "two-links.toml"
    text = device.read_text()
    device.write_text(text.replace("-9.81", "-9.80"))
    state = bench.ask("GET", f"/api/study/state?path={STUDY}")[1]
    assert (state["ready"], state["fresh"]) == (False, False)
    assert bench.ask("POST", "/api/identify", run)[0] == 400
    device.write_text(text)
    log = bench.folder / "logs" / "check.csv"
    os.utime(log, ns=(1, 1))
    assert not bench.ask("GET", f"/api/study/state?path={STUDY}")[1]["ready"]
    assert left(bench.folder / "results") == []


def test_a_problem_that_the_check_finds_keeps_the_study_from_running(bench):
    wrong = (bench.folder / STUDY).read_text().replace("check.csv", "gone.csv")
    (bench.folder / "studies" / "wrong.toml").write_text(wrong)
    checked = finished(bench, bench.ask("POST", "/api/check", {"path": "studies/wrong.toml"})[1])
    assert checked["state"] == JobState.DONE
    assert any("gone.csv" in problem for problem in checked["outcome"]["check"]["problems"])
    state = bench.ask("GET", "/api/study/state?path=studies/wrong.toml")[1]
    assert (state["fresh"], state["ready"]) == (True, False)
    assert (
        "found problems" in bench.ask("POST", "/api/identify", {"path": "studies/wrong.toml", "out": OUT})[1]["error"]
    )


@pytest.fixture(scope="module")
def identified(bench):
    """The study, checked and identified by the workbench."""
    assert finished(bench, bench.ask("POST", "/api/check", {"path": STUDY})[1])["state"] == JobState.DONE
    status, begun = bench.ask("POST", "/api/identify", {"path": STUDY, "out": OUT})
    assert status == 200, begun
    second, said = bench.ask("POST", "/api/check", {"path": STUDY})
    assert (second, "one job runs at a time" in said["error"]) == (400, True)
    done = finished(bench, begun)
    assert (done["state"], done["error"]) == (JobState.DONE, "")
    return done


@pytest.mark.usefixtures("small_pictures")
def test_the_numbers_are_those_of_the_command_line(identified, bench, tmp_path, monkeypatch):
    assert identified["command"] == f"haptid identify {STUDY} --out {OUT}"
    shutil.copytree(bench.folder, tmp_path / "lab", ignore=shutil.ignore_patterns("results", ".haptid"))
    (tmp_path / "lab" / "results").mkdir()
    monkeypatch.chdir(tmp_path / "lab")
    assert CliRunner().invoke(app, identified["command"].split()[1:]).exit_code == 0
    mine, typed = bench.folder / OUT, tmp_path / "lab" / OUT
    assert left(mine) == left(typed)
    for name in ("result.json", "parameters.csv", "correlation.csv"):
        assert (mine / name).read_text() == (typed / name).read_text()
    with np.load(mine / "clusters.npz") as one, np.load(typed / "clusters.npz") as other:
        for key in one.files:
            np.testing.assert_array_equal(one[key], other[key])


@pytest.mark.usefixtures("identified")
def test_the_index_knows_what_was_made_of_what(bench):
    lists = bench.ask("GET", "/api/workspace")[1]["lists"]
    (result,) = lists["result"]
    assert (result["path"], result["title"]) == (OUT, "two links")
    assert result["logs"] == ["logs/check.csv", "logs/sweep.csv"]
    assert all(log["results"] == [OUT] for log in lists["log"])
    stored = json.loads((bench.folder / OUT / "result.json").read_text())
    errors = [e["relative_error_percent"] for e in stored["validation"] if e["rows"] != "fit" and e["motor"] == "all"]
    assert result["about"]["error_percent"] in errors
    assert bench.ask("GET", "/api/workspace?words=two-links+nothing")[1]["lists"]["result"] == []


@pytest.mark.usefixtures("identified")
def test_the_result_page_has_the_sections_of_the_report(bench):
    from haptid.report import read_report

    found = bench.ask("GET", f"/api/result?path={OUT}")[1]
    report = read_report(bench.folder / OUT)
    assert [section["key"] for section in found["sections"]] == list(report.sections)
    assert found["sections"][0]["html"] in report.html()


@pytest.mark.usefixtures("identified")
def test_an_export_is_shown_and_then_written(bench):
    assert bench.ask("GET", "/api/formats")[1][0] == "c"
    shown = bench.ask("GET", f"/api/export?path={OUT}&to=json")[1]
    assert not (bench.folder / "exports").exists()
    # The study has no criterion that could fail; what is written is what was shown.
    status, made = bench.ask("POST", "/api/export", {"path": OUT, "to": ["json"]})
    assert (status, made["folders"]) == (200, ["exports/two-links/json"])
    for file in shown["files"]:
        assert (bench.folder / "exports/two-links/json" / file["name"]).read_text() == file["text"]
    assert bench.ask("GET", f"/api/export?path={OUT}&to=nothing")[0] == 400


@pytest.mark.usefixtures("identified")
def test_results_are_compared_and_drift_is_refused_for_shared_rows(bench):
    other = bench.folder / "results" / "other"
    shutil.copytree(bench.folder / OUT, other)
    status, found = bench.ask("GET", f"/api/compare?paths={OUT},results/other")
    assert (status, found["sections"][0]["key"]) == (200, "comparison")
    status, said = bench.ask("GET", f"/api/compare?paths={OUT},results/other&times=2026-03-02,2026-03-09")
    assert (status, "rows" in said["error"]) == (400, True)
    assert bench.ask("GET", f"/api/compare?paths={OUT}")[0] == 400
    shutil.rmtree(other)


@pytest.fixture
def second_day(bench, monkeypatch):
    """A result of a second day with a heavier forearm; the folder is as before afterwards."""
    made = [bench.folder / "logs" / "sweep-2.csv", bench.folder / "logs" / "check-2.csv"]
    for seed, path in zip((3, 4), made, strict=True):
        day = columns(seed)
        day["tau2"] = 1.05 * day["tau2"]
        pyarrow.csv.write_csv(pa.table(day), path)
    text = (bench.folder / STUDY).read_text().replace("sweep.csv", "sweep-2.csv").replace("check.csv", "check-2.csv")
    study, result = bench.folder / "studies" / "second.toml", "results/second"
    study.write_text(text)
    monkeypatch.chdir(bench.folder)
    assert CliRunner().invoke(app, ["identify", "studies/second.toml", "--out", result]).exit_code == 0
    yield result
    shutil.rmtree(bench.folder / result)
    for path in (*made, study):
        path.unlink()


@pytest.mark.usefixtures("identified", "small_pictures")
def test_drift_over_dates_is_that_of_the_library(bench, second_day):
    """Parameters of a heavier forearm drift, by the slopes that the library computes."""
    paths = f"{OUT},{second_day}"
    status, found = bench.ask("GET", f"/api/compare?paths={paths}&times=2026-03-02,2026-03-09")
    assert (status, [part["key"] for part in found["sections"]]) == (200, ["comparison", "drift"])
    assert found["command"] == f"haptid compare {OUT} {second_day} --times 2026-03-02,2026-03-09"
    results = [haptid.Result.load(bench.folder / path) for path in paths.split(",")]
    lines = drift(haptid.compare(*results, labels=["1", "2"]), [0.0, 7.0])
    assert lines.drifts
    html = found["sections"][1]["html"]
    for name, slope in zip(lines.names, lines.slope, strict=True):
        assert re.search(rf"<td>{name}</td><td class=\"number\">{slope:.3g}</td>", html)
    assert html.count("<td>yes</td>") == len(lines.drifts)
    assert len([key for key in found["drawings"] if key.startswith("drift-")]) == len(lines.names)
    assert bench.ask("GET", f"/api/compare?paths={paths}&times=monday,tuesday")[0] == 400


@pytest.mark.usefixtures("identified")
def test_a_job_is_cancelled_at_once_and_leaves_nothing(bench):
    before = left(bench.folder / "results")
    # No scheduler answers there, so that the job waits for one until it is cancelled.
    run = {"path": STUDY, "out": "results/cancelled", "scheduler": "tcp://127.0.0.1:9"}
    begun = bench.ask("POST", "/api/identify", run)[1]
    assert begun["command"] == f"haptid identify {STUDY} --out results/cancelled --scheduler tcp://127.0.0.1:9"
    until(lambda: bench.ask("GET", f"/api/jobs/{begun['id']}")[1]["steps"], "a first step")
    assert any(name.startswith(".cancelled-") for name in left(bench.folder / "results"))
    at = time.monotonic()
    status, said = bench.ask("POST", f"/api/jobs/{begun['id']}/cancel")
    assert time.monotonic() - at < 10.0  # the job itself would wait for its scheduler three times as long
    assert (status, said["state"]) == (200, JobState.CANCELLED)
    assert left(bench.folder / "results") == before
    assert bench.ask("GET", f"/api/study/state?path={STUDY}")[1]["running"] is None
    again = bench.ask("POST", f"/api/jobs/{begun['id']}/cancel")[1]
    assert again["state"] == JobState.CANCELLED


@pytest.mark.skipif(sys.platform != "linux", reason="the children of a process are read from /proc")
def test_a_job_of_a_server_that_is_killed_is_interrupted(tmp_path, plain):
    folder = tmp_path / "lab"
    shutil.copytree(plain, folder)
    first = started(folder)
    finished(first, first.ask("POST", "/api/check", {"path": STUDY})[1])
    begun = first.ask("POST", "/api/identify", {"path": STUDY, "out": OUT})[1]
    until(lambda: first.ask("GET", f"/api/jobs/{begun['id']}")[1]["steps"], "a first step")
    tasks = Path(f"/proc/{first.process.pid}/task").glob("*/children")
    children = [int(pid) for task in tasks for pid in task.read_text().split()]
    assert children
    first.process.send_signal(signal.SIGKILL)
    first.process.communicate(timeout=20)
    until(lambda: not any(map(alive, children)), "the end of its processes")
    second = started(folder)
    try:
        record = second.ask("GET", f"/api/jobs/{begun['id']}")[1]
        assert (record["state"], "run it again" in record["error"]) == (JobState.INTERRUPTED, True)
        assert left(folder / "results") == []
        assert second.ask("GET", f"/api/study/state?path={STUDY}")[1]["ready"]
    finally:
        ended(second)


def alive(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return "zombie" not in Path(f"/proc/{pid}/status").read_text()
    return False


def test_steps_of_one_name_are_one_line():
    record = JobRecord("a", "check", "A check", "haptid check", {}, begun=time.time())
    for what, share in (("reading a.csv", 0.0), ("observing: 1 samples/s", 0.2), ("observing: 2 samples/s", 1.0)):
        record.progressed(what, share)
    assert [(step["name"], step["share"]) for step in record.steps] == [("reading a.csv", 0.0), ("observing", 1.0)]


def test_a_process_that_dies_is_a_failure(tmp_path):
    jobs = Jobs(tmp_path, tmp_path / ".haptid" / "jobs")
    record = jobs.start("check", "A check", "haptid check", {"study": "studies/absent.toml"})
    until(lambda: record.state != JobState.RUNNING, "its end")
    assert record.state == JobState.FAILED
    assert "absent.toml" in record.error
    assert not record.defect
    broken = jobs.start("check", "A check", "haptid check", {})
    until(lambda: broken.state != JobState.RUNNING, "its end")
    assert "KeyError" in broken.defect
    until(lambda: len(list((tmp_path / ".haptid" / "jobs").glob("*.json"))) == 2, "their records")
    assert {record.state for record in Jobs(tmp_path, tmp_path / ".haptid" / "jobs").recent()} <= {
        JobState.FAILED,
        JobState.INTERRUPTED,
    }
