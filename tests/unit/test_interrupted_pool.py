"""`haptid pool` interrupted and given again: what is done is not done twice, unless it has changed."""

import json
import shutil

import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from haptid.cli import app
from haptid.log.data_set import data_files
from haptid.study import pool, read_study
from haptid.study.pool import identify_pool
from haptid.study.pool_parts import PoolParts
from small_study import STUDY, columns, write_study

FILES, DONE = 5, 3


@pytest.fixture
def study(tmp_path):
    (tmp_path / "set").mkdir()
    for k in range(FILES):
        parquet.write_table(pa.table(columns(20 + k)), tmp_path / "set" / f"{k}.parquet")
    return write_study(tmp_path)


@pytest.fixture
def made(monkeypatch):
    """Names of the files that are reduced; an interruption comes with the file after the third one."""
    names, plain = [], pool._Reducer.__call__

    def reduce(self, file):
        if len(names) == DONE and "interrupted" not in names:
            names.append("interrupted")
            raise KeyboardInterrupt
        names.append(file.name)
        return plain(self, file)

    monkeypatch.setattr(pool._Reducer, "__call__", reduce)
    return names


@pytest.fixture
def interrupted(study, made):
    """What an interrupted command keeps, and its output."""
    done = run(study)
    assert done.exit_code == 130
    made.clear()
    made.append("interrupted")
    return PoolParts.beside(study.parent / "out"), " ".join(done.output.split())


def run(study, *more):
    call = ["pool", str(study), str(study.parent / "set"), "--out", str(study.parent / "out"), *more]
    return CliRunner().invoke(app, call)


def values(study):
    return json.loads((study.parent / "out" / "pool.json").read_text())


def test_the_same_command_goes_on_with_the_other_files(study, made, interrupted):
    kept, said = interrupted
    assert f"interrupted: {DONE} files are stored in" in said
    assert kept.count() == DONE
    assert not (study.parent / "out-failed").exists()
    done = run(study)
    assert done.exit_code == 0, done.output
    assert f"Resuming an interrupted run: {DONE} files" in " ".join(done.output.split())
    assert made[1:] == ["3.parquet", "4.parquet"]
    assert not kept.folder.exists()
    first = values(study)
    assert run(study, "--no-resume").exit_code == 0
    again = values(study)
    for key in ("parameters", "unseen_error_percent", "treatment"):
        assert first[key] == again[key]
    own = ("name", "samples", "rows", "returned")
    assert [[file[key] for key in own] for file in first["files"]] == [
        [file[key] for key in own] for file in again["files"]
    ]


def test_no_resume_starts_again(study, made, interrupted):
    kept, _ = interrupted
    assert run(study, "--no-resume").exit_code == 0
    assert made[1:] == [f"{k}.parquet" for k in range(FILES)]
    assert not kept.folder.exists()


def test_what_has_changed_or_is_broken_is_reduced_again(study, made, interrupted):
    kept, _ = interrupted
    parquet.write_table(pa.table(columns(30)), study.parent / "set" / "1.parquet")
    of_the_first_file = min(kept.folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    of_the_first_file.write_bytes(b"PK and no more")
    identify_pool(read_study(study), str(study.parent / "set"), kept=kept)
    assert made[1:] == [f"{k}.parquet" for k in (0, 1, 3, 4)]
    made[1:] = []
    identify_pool(read_study(study), str(study.parent / "set"), kept=kept)
    assert made[1:] == []
    study.write_text(STUDY.replace("cutoff_hz = 30", "cutoff_hz = 25"))
    identify_pool(read_study(study), str(study.parent / "set"), kept=kept)
    assert len(made[1:]) == FILES


def test_files_of_another_folder_are_others(study, made, interrupted):
    """Also where names, sizes and times agree, as of two robots that record together."""
    kept, _ = interrupted
    other = shutil.copytree(study.parent / "set", study.parent / "other")
    for file, of_other in zip(data_files(str(study.parent / "set")), data_files(str(other)), strict=True):
        assert (file.name, file.size, file.version) == (of_other.name, of_other.size, of_other.version)
    identify_pool(read_study(study), str(other), kept=kept)
    assert made[1:] == [f"{k}.parquet" for k in range(FILES)]


def test_files_that_fail_are_tried_again(study, made):
    (study.parent / "set" / "2.parquet").write_bytes(b"PAR1 and no more PAR1")
    kept = PoolParts.beside(study.parent / "out")
    with pytest.raises(KeyboardInterrupt):
        identify_pool(read_study(study), str(study.parent / "set"), kept=kept)
    assert kept.count() == DONE - 1
    made[1:] = ["interrupted"]
    found = identify_pool(read_study(study), str(study.parent / "set"), kept=kept)
    assert [one.name for one in found.failed] == ["2.parquet"]
    assert made[2:] == ["2.parquet", "3.parquet", "4.parquet"]


def test_a_file_of_a_url_has_the_version_that_its_file_system_says():
    fsspec = pytest.importorskip("fsspec")
    system = fsspec.filesystem("memory")

    def version(content):
        with system.open("/robot/set/a.csv", "wb") as file:
            file.write(content)
        (one,) = data_files("memory://robot/set")
        return one.version

    try:
        first = version(b"t,q\n")
        assert data_files("memory://robot/set")[0].version == first
        assert version(b"t,u\n") != first
    finally:
        system.rm("/robot", recursive=True)
