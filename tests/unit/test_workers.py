"""Work that is shared is the same work; a worker that is lost costs only what it had."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.executors import DaskExecutor, ProcessExecutor, SerialExecutor
from haptid.observation.batch import observe_all
from haptid.observation.cache import RFactorCache
from motions import motion, truth
from work_to_share import always_killed, doubled, killed_once, refused


def test_the_same_is_made_by_whoever_works() -> None:
    wanted = {k: 2 * k for k in range(7)}
    assert dict(SerialExecutor().map(doubled, range(7))) == wanted
    assert dict(ProcessExecutor(2).map(doubled, range(7))) == wanted
    assert dict(ProcessExecutor(2).map(doubled, ())) == {}


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_lost_process_costs_only_its_item(tmp_path: Path) -> None:
    items = [(tmp_path, k) for k in range(6)]
    assert dict(ProcessExecutor(2).map(killed_once, items)) == {k: k for k in range(6)}
    calls = sorted(path.name.split("-")[0] for path in tmp_path.glob("*-*"))
    assert calls == [str(k) for k in range(6)]  # each was finished once


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_an_item_that_loses_every_process_is_an_error() -> None:
    with pytest.raises(errors.ExecutorError) as raised:
        list(ProcessExecutor(2).map(always_killed, range(3)))
    assert (raised.value.where, raised.value.found) == (1, 3)


@pytest.mark.skipif(sys.platform == "win32", reason="no signals are sent to a process there")
def test_an_interruption_does_not_reach_a_process_that_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    start, started = BaseProcess.start, []

    def interrupted(process: BaseProcess) -> None:
        start(process)
        assert process.pid is not None
        os.kill(process.pid, signal.SIGINT)
        started.append(process.pid)

    monkeypatch.setattr(BaseProcess, "start", interrupted)
    assert dict(ProcessExecutor(2).map(doubled, range(3))) == {0: 0, 1: 2, 2: 4}
    assert len(started) == 2  # none was lost, and none started in its place


def test_an_error_comes_back_as_it_is() -> None:
    with pytest.raises(errors.LogMismatchError) as raised:
        list(ProcessExecutor(1).map(refused, [3]))
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("position", 3, 2)
    assert raised.value.__notes__ == ["a note"]
    with pytest.raises(errors.SettingError) as raised:
        ProcessExecutor(0)
    assert (raised.value.where, raised.value.found) == ("count", 0)


def test_every_device_crosses_to_another_process() -> None:
    for name in haptid.shipped_devices():
        model = haptid.DynamicModel(haptid.read_device(name))
        assert model.mechanism.columns == pickle.loads(pickle.dumps(model)).mechanism.columns


@pytest.fixture(scope="module")
def model() -> haptid.Device:
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def motions(model: haptid.Device) -> list[haptid.Motion]:
    """Two of them, of two segments each."""
    treatment = haptid.Treatment(cutoff_hz=None, decimation=10)
    return [motion(model, truth(model), seconds=80.0, seed=k, noise=0.1, treatment=treatment) for k in (1, 2)]


def same(one: haptid.Observation, other: haptid.Observation) -> None:
    assert one.blocks == other.blocks
    for a, b in zip(one.motors, other.motors, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
        np.testing.assert_allclose(a.r_factors, b.r_factors, rtol=0, atol=1e-12 * np.abs(a.r_factors).max())


def test_processes_give_the_observations_of_one(model: haptid.Device, motions: list[haptid.Motion]) -> None:
    plain = [haptid.observe(model, made) for made in motions]
    told = []
    shared = observe_all(model, motions, ProcessExecutor(2), progress=lambda made, share: told.append((made, share)))
    for one, other, made in zip(plain, shared, motions, strict=True):
        assert other.motions == (made,)
        for a, b in zip(one.motors, other.motors, strict=True):
            np.testing.assert_allclose(a.r_factors, b.r_factors, rtol=0, atol=1e-12 * np.abs(a.r_factors).max())
        assert max(share for of, share in told if of is made) == 1.0


class Interrupted(SerialExecutor):
    """Stops after so many items, as a run that is killed."""

    def __init__(self, after: int) -> None:
        object.__setattr__(self, "after", after)

    def map(self, function, items):  # type: ignore[no-untyped-def]
        for k, made in super().map(function, items):
            if k == self.after:
                raise KeyboardInterrupt
            yield k, made


class Counting(SerialExecutor):
    """Remembers how many items it had."""

    had: list[int] = []

    def map(self, function, items):  # type: ignore[no-untyped-def]
        self.had.append(len(items))
        return super().map(function, items)


@pytest.fixture
def from_log(motions: list[haptid.Motion]) -> haptid.Motion:
    """A motion of a log, with exact rates."""
    made = motions[0]
    names = tuple(f"q{k}" for k in range(3)), tuple(f"u{k}" for k in range(3))
    channels = haptid.Channels(haptid.Signal(names[0], "rad", side="motor"), haptid.Signal(names[1], "N m"), time="t")
    log = haptid.Log(Path("made"), "0" * 64, made.t, made.q, made.tau, channels)
    return haptid.Motion(made.dt, made.q, made.tau, made.treatment, log, rates=made.rates)


def test_an_interrupted_run_goes_on(tmp_path: Path, model: haptid.Device, from_log: haptid.Motion) -> None:
    kept = RFactorCache(tmp_path / "partial", least=1)
    with pytest.raises(KeyboardInterrupt):
        observe_all(model, [from_log], Interrupted(1), kept)
    assert kept.count() == 1
    Counting.had.clear()
    again = observe_all(model, [from_log], Counting(), kept)[0]
    assert Counting.had == [1]
    same(again, observe_all(model, [from_log])[0])
    other = model.with_gravity([0.0, 0.0, -1.6])
    observe_all(other, [from_log], Counting(), kept)
    assert Counting.had == [1, 2]  # another device, nothing of it is there


def test_a_torn_file_is_made_again(tmp_path: Path, model: haptid.Device, from_log: haptid.Motion) -> None:
    kept = RFactorCache(tmp_path / "partial", least=1)
    plain = observe_all(model, [from_log], cache=kept)[0]
    torn = next(kept.folder.glob("*.npz"))
    torn.write_bytes(torn.read_bytes()[:1000])
    same(observe_all(model, [from_log], cache=kept)[0], plain)
    kept.forget()
    assert kept.count() == 0
    assert observe_all(model, [from_log], cache=RFactorCache(tmp_path / "short"))  # too short to be kept
    assert not (tmp_path / "short").exists()


def test_a_cluster_that_is_not_there_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(errors.MissingDependencyError, match=r"haptid\[cluster\]"):
        list(DaskExecutor("tcp://127.0.0.1:1").map(doubled, [1]))
