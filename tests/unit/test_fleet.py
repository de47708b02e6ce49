"""`haptid fleet`: logs of many devices, each identified by itself, their drift and their differences."""

import csv
import json
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.errors import LogFileError, StudyFileError
from haptid.executors import ProcessExecutor
from haptid.log.file_format import sha256_of
from haptid.study import read_study
from haptid.study.fleet import _OneLog, identify_fleet
from haptid.study.fleet_logs import day_in, fleet_logs
from haptid.study.fleet_results import FleetResults
from json_outputs import valid
from motions import multisine
from small_study import DEVICE, HEAD
from true_parameters import true_parameters

DAYS = (1, 3, 8, 15, 20)
# Viscous friction of joint 1 that one device gains in a day; centre of mass of link 2 that another has more.
DRIFT, HEAVIER = 0.004, 1.2


@dataclass
class Arms:
    """A folder with a study and the logs of five devices."""

    folder: Path
    model: haptid.DynamicModel

    @property
    def study(self):
        return read_study(self.folder / "study.toml")


def written(path, model, chi, seed):
    """A log of eight seconds with noisy torque."""
    rng, dt = np.random.default_rng(seed), 4e-3
    q, qd, qdd = multisine(2, 8.0, dt, seed)
    tau = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
    tau = tau + 0.03 * tau.std(axis=1, keepdims=True) * rng.standard_normal(tau.shape)
    names = ["t", "q1", "q2", "tau1", "tau2"]
    table = pa.table(dict(zip(names, [dt * np.arange(q.shape[1]), *q, *tau], strict=True)))
    path.parent.mkdir(parents=True, exist_ok=True)
    pyarrow.csv.write_csv(table, path)


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    (folder / "device.toml").write_text(DEVICE, encoding="utf-8")
    (folder / "study.toml").write_text(f'{HEAD}[[logs]]\npath = "own.csv"\n', encoding="utf-8")
    model = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    chi = true_parameters(model, FV=0.3, FC=0.2)
    written(folder / "own.csv", model, chi, 99)
    kinds, rng = list(model.device.parameters.kinds), np.random.default_rng(7)
    viscous, mass = kinds.index("FV"), 10 + kinds[:10].index("MX")
    for device in range(5):
        for day in DAYS:
            one = chi.copy()
            one[viscous] *= 1 + 0.01 * rng.standard_normal()  # from day to day
            if device == 1:
                one[viscous] += DRIFT * day
            one[mass] *= HEAVIER if device == 3 else 1 + 0.005 * rng.standard_normal()
            written(folder / "fleet" / f"arm {device}" / f"2026-03-{day:02d}.csv", model, one, 100 * device + day)
    broken = folder / "fleet" / "arm 2" / "2026-03-25.csv"
    broken.write_text("t,q1,q2,tau1\n0,0,0,0\n", encoding="utf-8")
    return Arms(folder, model)


@pytest.fixture(scope="module")
def fleet(arms):
    return identify_fleet(arms.study, arms.folder / "fleet")


def test_what_drifts_and_what_is_unusual_is_found_and_nothing_else(fleet):
    drifting = np.argwhere(fleet.drift_p < 0.05)
    assert [(fleet.trends[d].device, fleet.names[k]) for d, k in drifting] == [("arm 1", "FV1")]
    slope = fleet.trends[1].slope[fleet.names.index("FV1")]
    assert abs(slope.values[1] - DRIFT) < 4 * slope.se[1]
    # The friction that drifts has an unusual mean too.
    unusual = {fleet.trends[d].device for d, k in np.argwhere(np.abs(fleet.distance) > 3.5) if fleet.names[k] != "FV1"}
    assert unusual == {"arm 3"}
    assert any(line.startswith("arm 1: FV1 drifts by 0.00") for line in fleet.sentences)
    assert any(line.startswith("arm 3 is unusual") for line in fleet.sentences)


def test_a_mean_is_no_further_than_its_own_error_says(fleet):
    """Means of few devices that agree by chance made another one unusual, at three of its standard errors."""
    k, entries = fleet.names.index("FC2"), []
    for one in fleet.entries:
        if one.error:
            continue
        day = DAYS.index(int(one.log.path.stem[-2:]))
        values = one.values.copy()
        values[k] = 0.2 + 0.01 * (day - 2) + 0.022 * (one.log.device == "arm 4")  # a scatter of 0.0158 in each device
        entries.append(replace(one, values=values, se=np.full(len(values), 1e-4), dof=np.full(len(values), 20.0)))
    made = replace(fleet, entries=tuple(entries))
    away = np.array([trend.of_mean("values")[k] for trend in made.trends])
    assert np.ptp(away[:4]) < 1e-9
    assert abs(made.distance[4, k]) < 3.5
    other = [replace(one, values=one.values + 0.2 * (np.arange(len(one.values)) == k)) for one in entries[-5:]]
    assert abs(replace(fleet, entries=(*entries[:-5], *other)).distance[4, k]) > 3.5


def test_a_log_that_fits_badly_is_named(fleet):
    """A reversed torque of one log moved the means of its device without a word."""
    assert fleet.misfits == ()
    k = next(k for k, one in enumerate(fleet.entries) if not one.error)
    usual = fleet.entries[k].error_percent
    bad = replace(fleet.entries[k], error_percent=6 * usual)
    found = replace(fleet, entries=(*fleet.entries[:k], bad, *fleet.entries[k + 1 :]))
    assert found.misfits == (bad,)
    (line,) = set(found.sentences) - set(fleet.sentences)
    assert line.startswith(f"{bad.log.device}/{bad.log.path.name}: the error of its fit is {6 * usual:.3g} %")


def test_what_few_devices_do_not_tell_is_said(fleet):
    """Three devices had a dash for nothing unusual, though nothing was compared."""
    few = replace(fleet, entries=tuple(one for one in fleet.entries if one.log.device in ("arm 1", "arm 3")))
    assert [line.split()[-1] for line in few.summary().splitlines()[1:3]] == ["?", "?"]
    assert few.sentences[-1].startswith("Whether a device is unusual is not told: 4 devices are needed, and 2 have")
    assert not any("not told" in line for line in fleet.sentences)
    assert "?" not in fleet.summary()


def test_a_log_that_cannot_be_read_is_an_entry_and_stops_nothing(fleet):
    (failed,) = fleet.failed
    assert (failed.log.device, failed.log.path.name) == ("arm 2", "2026-03-25.csv")
    assert "tau2" in failed.error
    assert len(fleet.entries) == 26
    assert fleet.sentences[0].startswith("25 of 26 logs of 5 devices are identified; days by their file names")


def test_an_entry_is_what_identify_gives_with_the_same_treatment(arms, fleet):
    log = replace(arms.study.logs[0], path=str(fleet.entries[0].log.path))
    settings = {field.name: getattr(fleet.treatment, field.name) for field in fields(fleet.treatment)}
    found = haptid.identify(replace(arms.study, logs=(log,), treatment=settings))
    np.testing.assert_allclose(fleet.entries[0].values, found.estimate.unconstrained.values, rtol=1e-9, atol=1e-12)


def test_workers_give_the_same(arms, fleet):
    other = identify_fleet(arms.study, arms.folder / "fleet", workers=ProcessExecutor(2))
    for one, same in zip(fleet.entries, other.entries, strict=True):
        assert one.log == same.log
        np.testing.assert_allclose(one.values, same.values, rtol=1e-9)


def test_the_command(arms, fleet, tmp_path):
    arguments = [str(arms.folder / "study.toml"), str(arms.folder / "fleet"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, ["fleet", *arguments])
    assert done.exit_code == 0, done.output
    values = valid("fleet", (tmp_path / "out" / "fleet.json").read_text())
    assert [device["device"] for device in values["devices"]] == [f"arm {k}" for k in range(5)]
    with (tmp_path / "out" / "logs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["FV1"]) == pytest.approx(fleet.entries[0].values[fleet.names.index("FV1")], rel=1e-6)
    with (tmp_path / "out" / "devices.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 5 * len(fleet.names)
    done = CliRunner().invoke(app, ["fleet", *arguments, "--json"])
    assert json.loads(done.stdout)["sentences"] == list(fleet.sentences)


@pytest.fixture
def interrupted(arms, tmp_path, monkeypatch):
    """What a run keeps that is interrupted at its tenth log, and the logs that runs identify from then on."""
    made, plain = [], _OneLog.__call__

    def call(self, log):
        if len(made) == 9:
            made.clear()
            raise KeyboardInterrupt
        made.append(log.path)
        return plain(self, log)

    monkeypatch.setattr(_OneLog, "__call__", call)
    kept, out = FleetResults.beside(tmp_path / "out"), str(tmp_path / "out")
    done = CliRunner().invoke(app, ["fleet", str(arms.folder / "study.toml"), str(arms.folder / "fleet"), "--out", out])
    assert done.exit_code == 130
    assert "interrupted: 9 logs are stored in" in " ".join(done.stderr.split())
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(_OneLog, "__call__", lambda self, log: (made.append(log.path), plain(self, log))[1])
    assert kept.count() == 9
    return kept, made


def test_an_interrupted_run_goes_on_with_the_logs_that_are_missing(arms, fleet, interrupted):
    kept, made = interrupted
    again = identify_fleet(arms.study, arms.folder / "fleet", kept=kept)
    assert made == [one.log.path for one in fleet.entries[9:]]
    assert kept.count() == 25  # the log that fails is tried again
    for one, same in zip(fleet.entries, again.entries, strict=True):
        assert (one.log, one.names, one.units, one.status) == (same.log, same.names, same.units, same.status)
        for name in ("values", "se", "dof"):
            np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    assert again.summary() == fleet.summary()


def test_what_has_changed_since_an_interruption_is_computed_again(arms, interrupted):
    kept, made = interrupted
    path = arms.folder / "fleet" / "arm 0" / "2026-03-01.csv"
    text = path.read_text(encoding="utf-8")
    changed = sha256_of(path)
    others = [one for one in kept.folder.iterdir() if json.loads(one.read_text(encoding="utf-8"))["sha256"] != changed]
    min(others).write_text('{"names": ["FV1"], "values": 1}', encoding="utf-8")
    try:
        path.write_text(text + text.splitlines()[-1].replace("7.996", "8") + "\n", encoding="utf-8")
        identify_fleet(arms.study, arms.folder / "fleet", kept=kept)
    finally:
        path.write_text(text, encoding="utf-8")
    assert path in made
    assert len(made) == 26 - 9 + 2
    made.clear()
    other = replace(arms.study, method=haptid.OLS())
    assert len(identify_fleet(other, arms.folder / "fleet", kept=kept).entries) == len(made) == 26


def test_a_log_that_cannot_be_read_any_more_has_no_kept_result(tmp_path):
    kept = FleetResults.beside(tmp_path / "out")
    log = tmp_path / "log.csv"
    log.write_text("t\n", encoding="utf-8")
    kept.write("study", sha256_of(log), {"error_percent": 2.0})
    assert kept.read("study", log) == {"error_percent": 2.0}
    assert kept.read("another study", log) is None
    log.unlink()
    assert kept.read("study", log) is None


def test_the_command_resumes_and_leaves_nothing_behind(arms, fleet, tmp_path, interrupted):
    kept, made = interrupted
    arguments = ["fleet", str(arms.folder / "study.toml"), str(arms.folder / "fleet"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "Resuming an interrupted run: 9 logs in" in " ".join(done.stderr.split())
    assert len(made) == 17
    assert not kept.folder.exists()
    assert fleet.sentences[0] in " ".join(done.stdout.split())


def test_devices_that_drift_or_differ_come_first(fleet, monkeypatch):
    """Among thousands of devices nobody reads on to them."""
    names = [fleet.trends[d].device for d in fleet.ranked]
    assert names == ["arm 1", "arm 3", "arm 0", "arm 2", "arm 4"]
    rows = fleet.device_table()[1:]
    assert list(dict.fromkeys(row[0] for row in rows)) == names
    assert len(rows) == 5 * len(fleet.names)
    monkeypatch.setattr("haptid.study.fleet._SHOWN", 2)
    table = fleet.summary().split("\n\n")[0].splitlines()
    assert [line.split("  ")[0] for line in table[1:3]] == names[:2]
    assert table[3:] == ["3 more devices: devices.csv"]


@pytest.mark.parametrize(
    ("name", "day"),
    [
        ("2026-03-02.csv", 20514.0),
        ("arm7_20260302T1200.mcap", 20514.5),
        ("run 2026-03-02 06-00-00 b.npz", 20514.25),
        ("20261302.csv", None),
        ("serial120260302.csv", None),
        ("log17.csv", None),
    ],
)
def test_dates_in_names(name, day):
    assert day_in(name) == day


def test_without_dates_in_all_names_the_times_of_modification_count(tmp_path):
    for name in ("2026-03-02.csv", "b.csv", ".hidden.csv", "notes.txt.bak"):
        (tmp_path / name).write_text("t\n", encoding="utf-8")
    logs, dates = fleet_logs(tmp_path)
    assert dates == "modification times"
    assert {log.device for log in logs} == {tmp_path.name}
    assert len(logs) == 2
    assert all(log.day > 20_000 for log in logs)


def test_a_folder_without_logs_and_a_study_with_payloads_are_refused(arms, tmp_path):
    with pytest.raises(LogFileError, match="has no logs"):
        identify_fleet(arms.study, tmp_path)
    load = '[[logs]]\npath = "fleet/arm 0/2026-03-01.csv"\npayload = { link = "2", mass = 1.0, com = [0, 0, 0] }\n'
    text = (arms.folder / "study.toml").read_text(encoding="utf-8") + load
    (arms.folder / "loaded.toml").write_text(text, encoding="utf-8")
    with pytest.raises(StudyFileError, match="which a fleet does not"):
        identify_fleet(read_study(arms.folder / "loaded.toml"), arms.folder / "fleet")
