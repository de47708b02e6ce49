"""Results are whole or absent: every file-system call of a publish fails in turn, and the process dies at each."""

import errno
import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from faults import died, fault, full_disk
from haptid._internal import atomic_folder
from haptid._internal.atomic_folder import MANIFEST, publishing, publishing_files, verified, write_file
from haptid.errors import OutputFolderError, ResultFileError

OLD, NEW = (
    {"result.json": "old", "report.html": "old page", "torque-1.png": "old", "sub/deep.txt": "old"},
    {
        "result.json": "new",
        "report.html": "new page",
        "torque-2.png": "new",
        "sub/deep.txt": "new",
    },
)
FOREIGN = {"notes.txt": "mine", "sub/own.txt": "mine too"}
HERE = Path(__file__).parent
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")


def apart(case: str, *values: object) -> None:
    """A function of this file in a small process of its own, as each of its many copies costs what it has loaded."""
    program = f"import test_atomic_folder as here; here.{case}(*{values!r})"
    path = os.pathsep.join([str(HERE), str(HERE.parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def write(out: Path, texts: dict[str, str], updating: bool = False) -> None:
    with publishing(out, updating=updating) as folder:
        for name, text in texts.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)


def content(out: Path) -> dict[str, str]:
    files = (path for path in out.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(out).as_posix(): path.read_text() for path in files}


def prepared(folder: Path) -> Path:
    """A folder with an earlier result and files of the user."""
    folder.mkdir(exist_ok=True)
    out = folder / "out"
    write(out, OLD)
    for name, text in FOREIGN.items():
        (out / name).write_text(text)
    return out


def leftovers(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


def assert_whole(out: Path, may_be_absent: bool = False) -> None:
    """All files of one result, beside those of the user."""
    if may_be_absent and not out.exists():
        return
    assert content(out) in ({**OLD, **FOREIGN}, {**NEW, **FOREIGN})
    for path in out.glob("*.*"):
        verified(path, path.read_bytes())


def test_a_result_replaces_the_one_before_and_keeps_what_is_not_its_own(tmp_path):
    out = prepared(tmp_path)
    (out / "link").symlink_to("notes.txt")
    write(out, {"figures.csv": "of another command"})
    write(out, NEW)
    assert content(out) == {**NEW, **FOREIGN, "figures.csv": "of another command", "link": "mine"}
    assert (out / "link").is_symlink()
    write(out, {"report.html": "again"}, updating=True)
    write(out, {"result.json": "third"})
    assert content(out) == {"result.json": "third", **FOREIGN, "figures.csv": "of another command", "link": "mine"}
    assert not leftovers(tmp_path)


def test_folders_with_manifests_of_their_own_are_replaced_one_by_one(tmp_path):
    for name in ("c", "mjcf"):
        with publishing(tmp_path / "out") as folder:
            write(folder / name, {f"model.{name}": name})
    with publishing(tmp_path / "out") as folder:
        write(folder / "c", {"model.c": "second", "model.h": "second"})
    assert content(tmp_path / "out") == {"c/model.c": "second", "c/model.h": "second", "mjcf/model.mjcf": "mjcf"}


@pytest.mark.parametrize("exchange", [True, False])
def test_a_call_that_fails_leaves_the_result_before(tmp_path, exchange):
    at, failed = 0, 1
    while failed:
        at += 1
        folder = tmp_path / str(at)
        out = prepared(folder)
        with fault(at, full_disk, exchange) as count, suppress(OutputFolderError):
            write(out, NEW)
        failed = count.calls >= at
        assert_whole(out)
        write(out, NEW)
        assert content(out) == {**NEW, **FOREIGN}
        assert not leftovers(folder)
    assert at > 20


@needs_fork
@pytest.mark.parametrize("exchange", [True, False])
def test_a_process_that_dies_leaves_a_whole_result_and_the_next_run_sweeps(tmp_path, exchange):
    apart("dies_and_is_swept", str(tmp_path), exchange)


def dies_and_is_swept(tmp_path, exchange):
    at, dead = 0, True
    while dead:
        at += 1
        folder = Path(tmp_path) / str(at)
        out = prepared(folder)
        dead = died(lambda out=out: write(out, NEW), at, exchange)
        assert_whole(out, may_be_absent=not exchange)
        with pytest.raises(KeyboardInterrupt), publishing(out):
            raise KeyboardInterrupt
        assert_whole(out)
        assert not leftovers(folder)
    assert at > 20


@needs_fork
def test_readers_refuse_a_folder_that_cannot_be_exchanged_until_it_is_whole(tmp_path):
    apart("dies_and_is_refused", str(tmp_path))


def dies_and_is_refused(tmp_path):
    at, dead, refused = 0, True, 0
    while dead:
        at += 1
        folder = Path(tmp_path) / str(at)
        out = prepared(folder)
        os.chdir(out)  # the current folder stays what it is
        dead = died(lambda: write(Path("."), NEW), at)
        found = {}
        for name in ("result.json", "report.html"):
            try:
                found[name] = verified(out / name, (out / name).read_bytes()).decode().split()[0]
            except ResultFileError:
                refused += 1
        assert len(set(found.values())) <= 1
        assert {name: text for name, text in content(out).items() if name in FOREIGN} == FOREIGN
        write(Path("."), NEW)
        assert content(out) == {**NEW, **FOREIGN}
        assert not leftovers(folder)
    assert refused > 3


@needs_fork
def test_companions_are_never_beside_the_main_file_of_another_run(tmp_path):
    apart("dies_between_companions", str(tmp_path))


def dies_between_companions(folder):
    tmp_path = Path(folder)
    log, truth = tmp_path / "log.parquet", tmp_path / "log.truth.json"

    def run(text: str) -> None:
        with publishing_files(log, truth) as folder:
            (folder / log.name).write_text(text)
            (folder / truth.name).write_text(text)

    run("old")
    at = 1
    while died(lambda: run("new"), at):
        assert not truth.exists() or truth.read_text() == log.read_text()
        run("old")
        assert sorted(path.name for path in tmp_path.iterdir()) == ["log.parquet", "log.truth.json"]
        at += 1
    assert log.read_text() == truth.read_text() == "new"


def test_single_files_are_replaced_in_one_step_or_not_at_all(tmp_path):
    page = tmp_path / "page.html"
    write_file(page, "old")
    page.chmod(0o640)
    at, failed = 0, True
    while failed:
        at += 1
        with fault(at, full_disk) as count, suppress(OutputFolderError):
            write_file(page, "new")
        failed = count.calls >= at
        assert page.read_text() in ("old", "new")
        write_file(page, "old")
        assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert page.stat().st_mode & 0o777 == 0o640


def test_a_folder_that_cannot_be_renamed_is_replaced_file_by_file(tmp_path, monkeypatch):
    out = prepared(tmp_path)
    rename = os.rename

    def refused(source, place):
        if Path(source) == out:
            raise OSError(errno.EXDEV, "in a lower layer of the container")
        rename(source, place)

    monkeypatch.setattr(atomic_folder, "_exchange", lambda *_: False)
    monkeypatch.setattr(os, "rename", refused)
    write(out, NEW)
    assert content(out) == {**NEW, **FOREIGN}
    assert not leftovers(tmp_path)


def test_writers_at_the_same_time_leave_one_result(tmp_path):
    out = prepared(tmp_path)
    sets = [dict.fromkeys(NEW, f"{k}") for k in range(8)]
    threads = [threading.Thread(target=lambda one=one: [write(out, one) for _ in range(2)]) for one in sets]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert any(content(out) == {**one, **FOREIGN} for one in sets)
    assert not leftovers(tmp_path)


def test_a_live_run_is_not_swept(tmp_path):
    with publishing(tmp_path / "out") as folder:
        write(tmp_path / "out", OLD)
        (folder / "result.json").write_text("later")
    assert content(tmp_path / "out")["result.json"] == "later"


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_names_that_no_folder_can_have(tmp_path, name):
    with pytest.raises(OutputFolderError), publishing(tmp_path / name):
        pass


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputFolderError, match="not a regular file"):
        write_file(tmp_path / "pipe", "text")
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    with pytest.raises(OutputFolderError, match="is a folder"):
        write(tmp_path / "out", NEW)


@pytest.mark.parametrize("manifest", ["", "[]", '{"sets": 3}', '{"sets": [[]]}', "[" * 10_000])
def test_a_manifest_that_cannot_be_read_is_written_again(tmp_path, manifest):
    out = prepared(tmp_path)
    (out / MANIFEST).write_text(manifest)
    write(out, NEW)
    assert content(out) == {**OLD, **NEW, **FOREIGN}
    assert len(json.loads((out / MANIFEST).read_text())["sets"]) == 1
