"""`haptid pool`: many log files of one device identified together, in a folder or under a URL."""

import csv
import json
import os
import signal
import sys
import warnings
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

import haptid
from haptid._internal.atomic_folder import publishing
from haptid.cli import app
from haptid.errors import LogFileError, MissingDependencyError, StudyFileError
from haptid.executors import DaskExecutor, ProcessExecutor, SerialExecutor
from haptid.log.data_set import data_files
from haptid.observation.observation import concatenated
from haptid.study import pool, read_study
from haptid.study.pool import identify_pool, in_fewer_blocks
from json_outputs import valid
from small_study import STUDY, columns, write_study

FILES = 6


@dataclass
class Runs:
    """A study, and a data set of the same device."""

    study: Path
    folder: Path

    def pooled(self, **changes):
        return identify_pool(read_study(self.study), str(self.folder), **changes)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    study = write_study(folder)
    for k in range(FILES):
        path = folder / "set" / f"day={k % 2}" / f"part-{k}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.table(columns(20 + k)), path)
    (folder / "set" / "_SUCCESS.csv").write_text("no log\n", encoding="utf-8")
    return Runs(study, folder / "set")


@pytest.fixture(scope="module")
def found(runs):
    return runs.pooled()


def same(one, other):
    """Whether two estimates are equal to rounding."""
    np.testing.assert_allclose(one.beta, other.beta, rtol=0, atol=1e-10 * np.abs(one.beta).max())
    np.testing.assert_allclose(one.se, other.se, rtol=1e-6)


def test_the_estimate_is_that_of_all_logs_observed_together(runs, found):
    study, model = read_study(runs.study), haptid.DynamicModel(haptid.read_device(runs.folder.parent / "device.toml"))
    logs = [haptid.read_log(file.place, study.logs[0].channels) for file in data_files(str(runs.folder))]
    rows = concatenated(haptid.observe(model, haptid.treat(log, found.treatment)) for log in logs)
    together = haptid.estimate(rows, study.method)
    np.testing.assert_allclose(found.estimate.beta, together.beta, rtol=0, atol=1e-10 * np.abs(together.beta).max())
    np.testing.assert_allclose(found.estimate.fit.solution.rest, together.fit.solution.rest, rtol=1e-9)
    assert (found.estimate.se >= together.se * (1 - 1e-9)).all()  # with what the delay leaves uncertain
    assert 0 < found.unseen.relative < 10


def test_what_the_delay_leaves_uncertain_does_not_become_less_with_more_files(runs, found):
    study = read_study(runs.study)
    alone, made = haptid.identify(study).estimate, dict(found.estimate.nuisances)
    by_rows, moved = made.pop("estimated nuisances"), alone.fit.moved
    np.testing.assert_allclose(by_rows.T @ by_rows, moved.T @ moved, rtol=1e-6, atol=1e-15)
    assert "torque delay" in made
    assert made.keys() == alone.nuisances.keys()
    for name, shifts in alone.nuisances.items():
        np.testing.assert_allclose(made[name], shifts, rtol=1e-6, atol=1e-12)


def test_work_and_bytes_of_every_file_are_recorded(runs, found):
    assert [one.name for one in found.files] == [
        f"day={k}/part-{j}.parquet" for k in (0, 1) for j in range(k, FILES, 2)
    ]
    for one in found.files:
        assert one.fetched == (runs.folder / one.name).stat().st_size
        assert one.samples == len(columns(0)["t"])
        assert one.rows > 0
        assert one.returned > 1000
        assert min(one.reading, one.reducing, one.processor) > 0
    assert f"{FILES} of {FILES} files" in found.sentences[0]


def test_processes_give_the_same_also_where_one_is_killed_in_the_middle(runs, found, tmp_path):
    plan = replace(read_study(runs.study), name=str(tmp_path))
    other = identify_pool(plan, str(runs.folder), workers=_KilledOnce(ProcessExecutor(2)))
    assert (tmp_path / "killed").exists()
    same(found.estimate, other.estimate)
    assert [one.name for one in other.files] == [one.name for one in found.files]


@dataclass(frozen=True)
class _KilledOnce:
    """An executor whose process is killed with the third file, once."""

    executor: object

    def map(self, function, items):
        return self.executor.map(_Killing(function, Path(function.study.name)), items)


@dataclass(frozen=True)
class _Killing:
    function: object
    folder: Path

    def __call__(self, file):
        if file.name.endswith("part-4.parquet") and not (self.folder / "killed").exists():
            (self.folder / "killed").touch()
            os.kill(os.getpid(), signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)
        return self.function(file)


def test_files_under_a_url_give_the_same(runs, found):
    fsspec = pytest.importorskip("fsspec")
    system = fsspec.filesystem("memory")
    system.put(str(runs.folder), "/robot/set", recursive=True)
    try:
        other = identify_pool(read_study(runs.study), "memory://robot/set")
    finally:
        system.rm("/robot", recursive=True)
    same(found.estimate, other.estimate)
    assert [(one.name, one.fetched) for one in other.files] == [(one.name, one.fetched) for one in found.files]
    assert all(one.fetching > 0 for one in other.files)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning")
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_cluster_gives_the_same_also_where_a_worker_is_killed(runs, found, tmp_path):
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            plan = replace(read_study(runs.study), name=str(tmp_path))
            workers = _KilledOnce(DaskExecutor(cluster.scheduler_address))
            other = identify_pool(plan, f"file://{runs.folder}", workers=workers)
    assert (tmp_path / "killed").exists()
    same(found.estimate, other.estimate)


def test_more_files_than_blocks_are_joined_by_neighbours(runs, found, monkeypatch):
    monkeypatch.setattr(pool, "MOST_BLOCKS", 3)
    few = runs.pooled()
    assert len(few.estimate.observation.blocks) == 3
    assert few.estimate.observation.rows == found.estimate.observation.rows
    np.testing.assert_allclose(few.estimate.fit.solution.rest, found.estimate.fit.solution.rest, rtol=1e-9)
    np.testing.assert_allclose(few.estimate.beta, found.estimate.beta, rtol=0, atol=1e-9)


def test_merged_blocks_have_the_rows_of_all(runs):
    study, model = read_study(runs.study), haptid.DynamicModel(haptid.read_device(runs.folder.parent / "device.toml"))
    log = haptid.read_log(data_files(str(runs.folder))[0].place, study.logs[0].channels)
    rows = haptid.observe(model, haptid.treat(log))
    for most in (1, 3, 1000):
        few = in_fewer_blocks(rows, most)
        assert len(few.blocks) == min(most, len(rows.blocks))
        assert few.rows == rows.rows
        assert (few.blocks[0].start, few.blocks[-1].stop) == (rows.blocks[0].start, rows.blocks[-1].stop)
        for a, b in zip(few.motors, rows.motors, strict=True):
            np.testing.assert_allclose(a.whole.T @ a.whole, b.whole.T @ b.whole, rtol=1e-9, atol=1e-9)


def test_a_broken_file_is_listed_and_stops_nothing(runs, found, tmp_path):
    for file in data_files(str(runs.folder)):
        (tmp_path / Path(file.name).name).write_bytes(Path(file.place).read_bytes())
    (tmp_path / "part-9.parquet").write_bytes(b"PAR1 and no more PAR1")
    other = identify_pool(read_study(runs.study), str(tmp_path))
    (failed,) = other.failed
    assert failed.name == "part-9.parquet"
    assert any(line.startswith("part-9.parquet: ") for line in other.sentences)
    same(found.estimate, other.estimate)
    for file in tmp_path.glob("part-[0-8]*"):
        file.unlink()
    with pytest.raises(LogFileError, match=r"none of 1 files gives rows; the first, part-9\.parquet"):
        identify_pool(read_study(runs.study), str(tmp_path))


@pytest.fixture
def one_good_of_three(tmp_path, monkeypatch):
    """A data set whose rows are in one time block."""
    monkeypatch.setattr(pool, "MOST_BLOCKS", 3)
    folder = tmp_path / "set"
    folder.mkdir()
    parquet.write_table(pa.table(columns(20)), folder / "part-2.parquet")
    for k in (10, 1):
        (folder / f"part-{k}.parquet").write_bytes(b"PAR1 and no more PAR1")
    return folder


def test_one_block_has_an_estimate_and_no_errors_on_unseen_ones(runs, one_good_of_three, tmp_path):
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["pool", str(runs.study), str(one_good_of_three), "--out", str(out)])
    assert done.exit_code == 0, done.output
    values = valid("pool", (out / "pool.json").read_text())
    assert values["unseen_error_percent"] is None
    assert any(line.startswith("Nothing says how uncertain the parameters are") for line in values["sentences"])
    assert "unknown" in done.stdout
    assert "inf " not in done.stdout
    assert [one["value"] for one in values["parameters"]] == pytest.approx([0.1] * 8 + [0.12] * 2, rel=0.02)
    assert all(one["se"] is None for one in values["parameters"])
    with (out / "files.csv").open() as file:
        assert [bool(row["problem"]) for row in csv.DictReader(file)] == [True, False, True]


def test_halves_that_do_not_determine_the_parameters_give_no_errors(runs, one_good_of_three, monkeypatch):
    def of_all_rows(rows, *args):
        if len(rows.blocks) < 2:
            raise haptid.errors.NoRowsError("too few.", advice="Record more.")
        return haptid.estimate(rows, *args)

    (one_good_of_three / "part-1.parquet").unlink()
    parquet.write_table(pa.table(columns(21)), one_good_of_three / "part-1.parquet")
    monkeypatch.setattr(pool, "estimate", of_all_rows)
    found = identify_pool(read_study(runs.study), str(one_good_of_three))
    assert found.unseen is None
    assert found.sentences[-2].endswith("2 time blocks, and every other one alone is too little: too few.")


@pytest.mark.parametrize("good", [True, False])
def test_files_csv_is_written_where_the_rows_give_no_estimate(runs, one_good_of_three, tmp_path, monkeypatch, good):
    if good:

        def fails(*_):
            raise haptid.errors.IdentifiabilityError("collinear.")

        monkeypatch.setattr(pool, "estimate", fails)
    else:
        (one_good_of_three / "part-2.parquet").write_bytes(b"PAR1 nor this PAR1")
    out = tmp_path / "out"
    out.mkdir()
    (out / "pool.json").write_text("an earlier result")
    done = CliRunner().invoke(app, ["pool", str(runs.study), str(one_good_of_three), "--out", str(out)])
    assert done.exit_code == 2
    assert "files.csv" in done.output
    assert [path.name for path in out.iterdir()] == ["pool.json"]
    with (tmp_path / "out-failed" / "files.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["part-1.parquet", "part-2.parquet", "part-10.parquet"]
    assert [not row["problem"] for row in rows] == [False, good, False]


def test_a_defect_that_one_file_shows_is_listed_first_and_stops_nothing(runs, tmp_path, monkeypatch):
    for k in range(2):
        parquet.write_table(pa.table(columns(20 + k)), tmp_path / f"b-{k}.parquet")
    for k in range(6):
        (tmp_path / f"a-{k}.parquet").write_bytes(b"PAR1 and no more PAR1")
    read = pool.read_entry

    def broken(entry, *args):
        if entry.path.endswith("b-1.parquet"):
            raise IndexError("index 7\nis out of bounds")
        return read(entry, *args)

    monkeypatch.setattr(pool, "read_entry", broken)
    found = identify_pool(read_study(runs.study), str(tmp_path))
    problem = found.files[-1].problem
    assert problem.startswith("defect of haptid, please report it with the file: IndexError in test_pool.py:")
    assert problem.endswith(": index 7 is out of bounds")
    assert found.sentences[1] == f"b-1.parquet: {problem}"
    assert [one.name for one in found.files if not one.problem] == ["b-0.parquet"]


def test_what_of_the_study_does_not_count_is_said(runs, found):
    assert not found.notes
    path = runs.study.with_name("parts.toml")
    text = STUDY.replace('path = "log.csv"', 'path = "log.csv"\ntime_range = [0.5, 5.5]\nexclude = [[2.0, 2.5]]')
    path.write_text(f'{text}[estimate]\nuse = "free"\n[criteria]\nrelative_error_percent = 5\n', encoding="utf-8")
    parts = identify_pool(read_study(path), str(runs.folder))
    assert [one.samples for one in parts.files] == [one.samples for one in found.files]
    said = "\n".join(parts.sentences)
    for what in ("`time_range`, `exclude` of the study's own logs", '`use = "free"`', "at most 5 % on unseen rows"):
        assert what in said


@pytest.mark.parametrize("workers", [SerialExecutor(), ProcessExecutor(2)])
def test_a_copy_of_a_file_is_left_out_and_said(runs, tmp_path, workers):
    for k in (20, 21):
        parquet.write_table(pa.table(columns(k)), tmp_path / f"{k}.parquet")
    once = identify_pool(read_study(runs.study), str(tmp_path))
    (tmp_path / "20 (1).parquet").write_bytes((tmp_path / "20.parquet").read_bytes())
    twice = identify_pool(read_study(runs.study), str(tmp_path), workers=workers)
    (copy,) = twice.failed
    other = {"20.parquet": "20 (1).parquet", "20 (1).parquet": "20.parquet"}[copy.name]
    assert f"{copy.name}: left out, as it has the content of {other}" in twice.sentences[1]
    same(once.estimate, twice.estimate)


def test_methods_that_need_the_samples_are_refused(runs):
    text = f'{STUDY}[estimate]\nmethod = "irls"\n'
    path = runs.study.with_name("irls.toml")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(StudyFileError, match=r"`estimate.method`: is IRLS, Tukey, which needs the samples again"):
        identify_pool(read_study(path), str(runs.folder))


def test_sources_without_logs_are_errors(tmp_path, monkeypatch):
    with pytest.raises(LogFileError, match="has no log files"):
        data_files(str(tmp_path))
    with pytest.raises(LogFileError, match=r"runs does not exist\. Give a folder"):
        data_files(str(tmp_path / "runs"))
    (tmp_path / "log.csv").write_text("t,q\n", encoding="utf-8")
    with pytest.raises(LogFileError, match=r"log\.csv is a file, not a folder .* `haptid identify`"):
        data_files(str(tmp_path / "log.csv"))
    pytest.importorskip("fsspec")
    with pytest.raises(LogFileError, match=r"nowhere://a cannot be read: ValueError"):
        data_files("nowhere://a")
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingDependencyError, match=r"haptid\[remote\]"):
        data_files("memory://a")


def test_a_folder_of_results_is_no_log(tmp_path):
    with publishing(tmp_path / "haptid-pool") as folder:
        (folder / "files.csv").write_text("name\n", encoding="utf-8")
    (tmp_path / "log.csv").write_text("t,q\n", encoding="utf-8")
    assert [file.name for file in data_files(str(tmp_path))] == ["log.csv"]
    with pytest.raises(LogFileError, match="without a name does not exist"):
        data_files("")


def test_files_of_an_archive_under_a_url_are_fetched_from_it(tmp_path):
    """A path alone does not name the archive that it is in, nor a host."""
    pytest.importorskip("fsspec")
    with zipfile.ZipFile(tmp_path / "set.zip", "w") as archive:
        archive.writestr("day/a.csv", "t,q\n")
        archive.writestr("day/b/c.csv", "t,q,tau\n")
    found = data_files(f"zip://day::file://{(tmp_path / 'set.zip').as_posix()}")
    assert [file.name for file in found] == ["a.csv", "b/c.csv"]
    with found[1].here() as path:
        assert path.read_text() == "t,q,tau\n"


def test_the_command(runs, found, tmp_path):
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["pool", str(runs.study), str(runs.folder), "--out", str(out), "--workers", "2"])
    assert done.exit_code == 0, done.output
    values = valid("pool", (out / "pool.json").read_text())
    assert [one["value"] for one in values["parameters"]] == pytest.approx(
        list(found.estimate.beta), rel=1e-8, abs=1e-9
    )
    with (out / "files.csv").open() as file:
        assert [row["name"] for row in csv.DictReader(file)] == [one.name for one in found.files]
    with (out / "parameters.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(found.estimate.beta)
    done = CliRunner().invoke(app, ["pool", str(runs.study), str(runs.folder), "--out", str(out), "--json"])
    assert json.loads(done.stdout)["status"] == found.estimate.status
