"""Frames against hostile bytes, the recorder with lost, late and repeated frames, a stream up to its parameters."""

from __future__ import annotations

import socket
import struct
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid.errors import HaptidError, WorkbenchError
from haptid.live import (
    FrameError,
    LiveSettings,
    Receiver,
    Recorder,
    analysed_study,
    pack_frame,
    play,
    read_frame,
    recover,
)
from haptid.live.frames import LARGEST
from haptid.live.recorder import WAIT, SampleFrame
from small_study import columns, write_study

NAMES = ("t", "q1", "q2", "tau1", "tau2")


def samples(numbers) -> tuple[np.ndarray, np.ndarray]:
    """Samples that tell their own number."""
    n = np.asarray(numbers, dtype=float)[:, None]
    return np.hstack([n, n + 0.25]), np.hstack([-n, 2 * n])


def frame(first: int, count: int = 1) -> SampleFrame:
    return read_frame(pack_frame(first, *samples(range(first, first + count))))


def written(path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_a_frame_or_an_error(content):
    for sent in (content, b"HPTF" + content, pack_frame(1, *samples([1, 2]))[: len(content)] + content):
        try:
            made = read_frame(sent)
        except FrameError:
            continue
        assert np.isfinite(made.position).all()
        assert np.isfinite(made.torque).all()


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 79), st.integers(1, 255))
def test_a_changed_byte_of_the_head_or_a_number_harms_nothing(place, change):
    sent = bytearray(pack_frame(7, *samples([7, 8])))
    sent[place] ^= change
    try:
        made = read_frame(bytes(sent))
    except FrameError:
        return
    assert made.position.shape == made.torque.shape == (2, 2)


def test_a_frame_keeps_every_bit():
    rng = np.random.default_rng(1)
    q, tau = rng.standard_normal((5, 7)), rng.standard_normal((5, 3))
    made = read_frame(pack_frame(2**32 + 5, q, tau))
    assert made.number == 5
    np.testing.assert_array_equal(made.position, q)
    np.testing.assert_array_equal(made.torque, tau)


@pytest.mark.parametrize(
    "head",
    [
        (b"HPTX", 1, 0, 2, 2, 1, 0),
        (b"HPTF", 2, 0, 2, 2, 1, 0),
        (b"HPTF", 1, 1, 2, 2, 1, 0),
        (b"HPTF", 1, 0, 0, 4, 1, 0),
        (b"HPTF", 1, 0, 4, 0, 1, 0),
        (b"HPTF", 1, 0, 65535, 65535, 65535, 0),
        (b"HPTF", 1, 0, 2, 2, 0, 0),
        (b"HPTF", 1, 0, 2, 2, 2, 0),
    ],
)
def test_heads_that_lie_are_refused(head):
    with pytest.raises(FrameError):
        read_frame(struct.pack("<4sBBHHHI", *head) + 32 * b"\0")
    with pytest.raises(FrameError):
        read_frame(pack_frame(0, [[np.nan, 1.0]], [[0.0, 0.0]]))
    with pytest.raises(FrameError):
        pack_frame(0, np.zeros((1024, 64)), np.zeros((1024, 64)))
    assert len(pack_frame(0, np.zeros((500, 8)), np.zeros((500, 8)))) <= LARGEST


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_what_is_missing_is_counted_exactly(tmp_path_factory, data):
    """Frames are lost, sent twice and delayed by no more than the recorder waits: every other sample is there once."""
    path = tmp_path_factory.mktemp("record") / "log.csv"
    start = data.draw(st.sampled_from([0, 17, 2**32 - 50]))
    sizes = data.draw(st.lists(st.integers(1, 4), min_size=5, max_size=60))
    edges = start + np.concatenate([[0], np.cumsum(sizes)])
    frames = [(int(a), int(b - a)) for a, b in pairwise(edges)]
    kept = [f for f in frames if data.draw(st.integers(0, 9)) > 1] or frames[:1]
    twice = [f for f in kept if data.draw(st.integers(0, 9)) == 0]
    order = sorted([*kept, *twice], key=lambda f: f[0] + data.draw(st.integers(0, WAIT // 3)))
    first = order[0][0]
    recorder = Recorder(path, 100.0, NAMES, 2)
    runs = []
    for number, count in order:
        runs += recorder.take(read_frame(pack_frame(number, *samples(range(number, number + count)))))
    runs += recorder.close()
    there = np.array(sorted({k for a, n in kept for k in range(a, a + n) if k >= first}))
    made = written(path)
    np.testing.assert_array_equal(made[:, 1], there)
    np.testing.assert_allclose(made[:, 0], (there - first) / 100.0, rtol=0, atol=1e-9)
    counts = recorder.counts
    assert counts.written == len(there)
    assert counts.written + counts.lost == there[-1] - first + 1
    assert counts.repeated >= sum(n for a, n in twice if a > first)
    np.testing.assert_array_equal(np.concatenate([run.position[:, 0] for run in runs]), there)
    assert sum(round(100 * run.gap) for run in runs) == counts.lost


def test_too_late_a_sample_is_not_written_and_is_said(tmp_path):
    recorder = Recorder(tmp_path / "log.csv", 100.0, NAMES, 2)
    for number in [0, 1, *range(3, 3 + WAIT + 1), 2, 1]:
        list(recorder.take(frame(number)))
    assert (recorder.counts.lost, recorder.counts.late, recorder.counts.repeated) == (1, 1, 1)
    list(recorder.close())
    assert 2.0 not in written(tmp_path / "log.csv")[:, 1]


def test_a_sender_that_begins_again_makes_a_pause(tmp_path):
    recorder = Recorder(tmp_path / "log.csv", 100.0, NAMES, 2)
    for number in [*range(10_000, 10_010), *range(5)]:
        runs = list(recorder.take(frame(number)))
    assert recorder.counts.restarts == 1
    list(recorder.close())
    made = written(tmp_path / "log.csv")
    assert made[10, 0] == pytest.approx(made[9, 0] + 1.01)
    assert runs[0].gap == 0.0


def test_other_channels_are_refused_and_an_empty_recording_leaves_nothing(tmp_path):
    recorder = Recorder(tmp_path / "log.csv", 100.0, NAMES, 2)
    assert list(recorder.take(read_frame(pack_frame(0, [[1.0]], [[1.0]])))) == []
    assert recorder.counts.refused == 1
    list(recorder.close())
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(HaptidError):
        Recorder(tmp_path / "log.csv", 0.0, NAMES, 2)


def test_what_a_crash_leaves_is_recovered(tmp_path):
    recorder = Recorder(tmp_path / "log.csv", 100.0, NAMES, 2)
    for number in range(30):
        list(recorder.take(frame(number)))
    recorder._file.write("0.3,1")  # the last line was not finished
    recorder._file.close()
    (tmp_path / "log.csv").write_text("another one\n")
    (found,) = recover(tmp_path)
    assert found.name == "log-recovered.csv"
    np.testing.assert_array_equal(written(found)[:, 1], np.arange(30))
    assert recover(tmp_path) == []


def test_a_port_hears_one_sender(tmp_path):
    receiver = Receiver(Recorder(tmp_path / "log.csv", 100.0, NAMES, 2))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as two,
    ):
        at = ("127.0.0.1", receiver.port)
        one.sendto(b"HTTP/1.1 GET /", at)
        one.sendto(pack_frame(0, *samples([0])), at)
        first = receiver.runs.get(timeout=20)
        two.sendto(pack_frame(1, *samples([900])), at)
        one.sendto(pack_frame(1, *samples([1])), at)
        second = receiver.runs.get(timeout=20)
    receiver.close()
    assert [run.position[0, 0] for run in (first, second)] == [0.0, 1.0]
    assert (receiver.broken, receiver.foreign) == (1, 1)
    with pytest.raises(WorkbenchError):
        Receiver(Recorder(tmp_path / "other.csv", 100.0, NAMES, 2), 99_999)


def test_nothing_is_lost_while_the_receiver_computes(tmp_path):
    """Single samples at 1 kHz while this process takes none for a second: more than small buffers hold."""
    receiver = Receiver(Recorder(tmp_path / "log.csv", 1000.0, NAMES, 2))
    q, tau = samples(range(1200))
    with receiver._lock:
        play(q, tau, 1000.0, ("127.0.0.1", receiver.port))
        assert receiver.recorder.counts.written == 0
    receiver.close()
    assert (receiver.recorder.counts.written, receiver.recorder.counts.lost) == (1200, 0)
    np.testing.assert_array_equal(written(tmp_path / "log.csv")[:, 1:3], q)


def test_a_device_is_identified_from_its_stream_as_from_the_record(tmp_path):
    """Sender, port, file and recursion: parameters live, and those of the study on the recorded file."""
    study = haptid.read_study(write_study(tmp_path))
    made = columns(5, 20.0)
    q, tau = (np.column_stack([made[f"{name}{k}"] for k in (1, 2)]) for name in ("q", "tau"))
    analysis = analysed_study(study, LiveSettings(rate_hz=500.0))
    receiver = Receiver(Recorder(tmp_path / "live.csv", 500.0, NAMES, 2))
    sender = threading.Thread(target=play, args=(q, tau, 20_000.0, ("127.0.0.1", receiver.port)), kwargs={"each": 20})
    sender.start()
    end = time.monotonic() + 60
    while receiver.recorder.counts.written < len(q):
        assert time.monotonic() < end, receiver.recorder.counts
        analysis.take(receiver.runs.get(timeout=20))
    sender.join()
    receiver.close()
    while not receiver.runs.empty():
        analysis.take(receiver.runs.get())
    assert receiver.recorder.counts.lost == 0
    np.testing.assert_array_equal(written(tmp_path / "live.csv")[:, 1:3], q)
    estimate, guidance = analysis.known()
    assert guidance.score < 0.1
    rows = analysis.rows_since(0.0)
    assert rows[-1].predicted == pytest.approx(rows[-1].measured, abs=0.5)
    # The record, read and treated as a whole, has the same rows up to its last part block.
    log = haptid.read_log(tmp_path / "live.csv", analysis.channels)
    motion = haptid.treat(log, analysis.stream.treatment)
    for rows_left in analysis.stream.finish():
        analysis.recursion.add(rows_left)
    whole = haptid.estimate(haptid.observe(analysis.model, motion), haptid.WLS())
    np.testing.assert_allclose(analysis.recursion.estimate().beta, whole.beta, rtol=1e-8)
    # Held, it gives an alarm for a push, and none before.
    analysis.hold(True)
    stop = estimate.blocks[-1].stop
    from haptid.live import SampleRun

    analysis.take(SampleRun(40.0, 1.0, q, tau))
    assert not analysis.alarms
    pushed = tau.copy()
    pushed[5000:6000, 1] += 3.0
    analysis.take(SampleRun(80.0, 1.0, q, pushed))
    assert {alarm.motor for alarm in analysis.alarms} == {"motor 2"}
    assert stop < analysis.alarms[0].start
    assert analysis.to_json()["held"] is True
