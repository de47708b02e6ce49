"""`haptid identify` of a long log interrupted, resumed, shared, and with a process killed in the middle: one result."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose
from pyarrow import parquet

import haptid
from haptid.observation.cache import RFactorCache
from haptid.study import read_study
from haptid.study.identify import identify
from small_study import DEVICE, STUDY, columns

psutil = pytest.importorskip("psutil")
pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals, no SIGKILL"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]
# The command line with many small parts, each stored after a pause, so that there is a middle to hit; it says how many
# it made itself.
PROGRAM = """
import signal
import time
signal.signal(signal.SIGINT, signal.default_int_handler)  # what was started in the background may not listen
from haptid.observation import plan as planning
from haptid.observation import batch
from haptid.observation.cache import RFactorCache
planning.SEGMENT = 1024
RFactorCache.__init__.__defaults__ = (0,)  # this log is shorter than those whose parts are worth a file
made, plain, write = [], batch.Reducer.__call__, RFactorCache.write
RFactorCache.write = lambda *given: (time.sleep(0.03), write(*given))[1]
batch.Reducer.__call__ = lambda self, part: (made.append(part), plain(self, part))[1]
from haptid.cli import main
try:
    main()
finally:
    print("made", len(made))
"""
MANY = 3
SAMPLES = 2**15
PATIENCE = 300.0


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one log of some sixty parts."""
    folder = tmp_path_factory.mktemp("long")
    (folder / "device.toml").write_text(DEVICE)
    logs = '[[logs]]\npath = "log.parquet"\n[treatment]\ntorque_delay_s = 0.0\nreversal_speed = 0.0'
    head, _, tail = STUDY.partition('[[logs]]\npath = "log.csv"')
    (folder / "study.toml").write_text(head + logs + tail[tail.index("[treatment]") + len("[treatment]") :])
    parquet.write_table(pa.table(columns(1, SAMPLES * 2e-3)), folder / "log.parquet")
    return folder / "study.toml"


@pytest.fixture(scope="module")
def wanted(study: Path) -> np.ndarray:
    """Values and deviations of a run in memory, in this process."""
    return np.array([[p.value, p.se, *p.conf_int()] for p in identify(read_study(study)).estimate.parameters])


def start(study: Path, out: Path, *more: str, err: int = subprocess.PIPE) -> subprocess.Popen[str]:
    """The command in a process group of its own, as a terminal starts it."""
    call = [sys.executable, "-c", PROGRAM, "identify", str(study), "--out", str(out), "--no-report", *more]
    size = {"TERM": "xterm", "COLUMNS": "120"}
    return subprocess.Popen(
        call, stdout=subprocess.PIPE, stderr=err, text=True, start_new_session=True, env={**os.environ, **size}
    )


def parts(out: Path) -> int:
    return len(list(out.with_name(f".{out.name}.partial").glob("*.npz")))


def await_parts(run: subprocess.Popen[str], out: Path, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Until some parts are there; other things may be done meanwhile."""
    end = time.monotonic() + PATIENCE
    while parts(out) < MANY:
        assert run.poll() is None
        assert time.monotonic() < end
        meanwhile()
        time.sleep(2e-3)


def check(out: Path, wanted: np.ndarray) -> None:
    """The result is that of the run in memory, and nothing of the way to it is left."""
    said = json.loads((out / "result.json").read_text())["estimate"]["parameters"]
    found = np.array([[p["value"], p["se"], *p["conf_int"]] for p in said])
    assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_ctrl_c_and_the_same_command_again(study: Path, wanted: np.ndarray, tmp_path: Path) -> None:
    import pty

    out, (ours, theirs) = tmp_path / "out", pty.openpty()
    os.set_blocking(ours, False)
    shown = bytearray()

    def listen() -> None:
        try:
            shown.extend(os.read(ours, 1 << 16))
        except OSError:  # nothing to read, or nobody writes any more
            return

    run = start(study, out, "--workers", "2", err=theirs)
    os.close(theirs)
    await_parts(run, out, listen)
    os.killpg(run.pid, signal.SIGINT)  # as Ctrl-C does: to the workers too
    while run.poll() is None:
        listen()
    for _ in range(9):
        listen()
    os.close(ours)
    run.communicate(timeout=PATIENCE)
    text = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown.decode())  # without colours and cursor
    assert run.returncode == 130
    assert re.search(r"observing log.parquet: [\d.e+]+ samples/s", text)  # how fast,
    assert re.search(r"\d+% \d:\d\d:\d\d (\d:\d\d:\d\d|-:--:--)", text)  # how much, since when, how long yet
    there = parts(out)
    assert there >= MANY
    assert f"interrupted: {there} parts are stored in" in " ".join(text.split())
    assert "Traceback" not in text
    assert not out.exists()

    again = start(study, out)
    printed, said = again.communicate(timeout=PATIENCE)
    assert again.returncode == 0, said
    assert f"Resuming an interrupted run: {there} parts" in " ".join(said.split())
    made = int(printed.split()[-1])
    assert made > 0
    assert there + made == sum(1 for _ in segments(study))
    check(out, wanted)


def segments(study: Path) -> Iterator[tuple[int, int]]:
    """The parts of the log as PROGRAM has them."""
    from haptid.observation import plan as planning

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "SEGMENT", 1024)
        made = identify(read_study(study))
        log = made.runs[0].motion.log
        for treatment in (made.proposal.treatment, made.proposal.reference):
            yield from planning.Plan.of(made.model, haptid.treat(log, treatment)).segments()


def test_an_interruption_is_none_of_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may come when a part has just its name: it stays an interruption, and the part is kept."""
    replace = os.replace

    def interrupted(source: str, place: Path) -> None:
        replace(source, place)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    kept = RFactorCache(tmp_path / "parts")
    with pytest.raises(KeyboardInterrupt):
        kept.put(kept.folder / "one.npz", b"content")
    assert [path.name for path in kept.folder.iterdir()] == ["one.npz"]
    assert (kept.folder / "one.npz").read_bytes() == b"content"


def test_a_part_is_closed_before_it_is_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows renames no open file."""
    replace = os.replace

    def closed(source: str, place: Path) -> None:
        assert source not in {file.path for file in psutil.Process().open_files()}
        replace(source, place)

    monkeypatch.setattr(os, "replace", closed)
    kept = RFactorCache(tmp_path / "parts")
    kept.put(kept.folder / "one.npz", b"content")
    assert (kept.folder / "one.npz").read_bytes() == b"content"


def test_another_run_that_is_complete_ends_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It deletes the folder of both while this one writes a part."""
    replace, kept = os.replace, RFactorCache(tmp_path / "parts")

    def deleted(source: str, place: Path) -> None:
        kept.forget()
        replace(source, place)

    monkeypatch.setattr(os, "replace", deleted)
    kept.put(kept.folder / "one.npz", b"content")
    assert not kept.folder.exists()


def test_a_killed_process_costs_its_part_alone(study: Path, wanted: np.ndarray, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = start(study, out, "--workers", "2", "--quiet")
    await_parts(run, out)
    crew = [child for child in psutil.Process(run.pid).children() if "spawn_main" in " ".join(child.cmdline())]
    assert len(crew) == 2
    crew[0].kill()
    _, said = run.communicate(timeout=PATIENCE)
    assert (run.returncode, said) == (0, "")
    check(out, wanted)
