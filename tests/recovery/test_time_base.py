"""Known parameters come back, within their intervals, from logs as recorders write them: read, treated, estimated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.log import Channels, Log, Signal, read_log
from motions import truth

RATE, SECONDS = 500.0, 40.0
CHANNELS = Channels(Signal(("q1", "q2", "q3"), "rad"), Signal(("tau1", "tau2", "tau3"), "N m"), time="t")
TREATMENT = haptid.Treatment(cutoff_hz=25.0, parallel_cutoff_hz=8.0, decimation=5, reversal_speed=0.05)


@dataclass(frozen=True)
class Recorder:
    """Faults of a recorder.

    Attributes:
        jitter: standard deviation of sampling times, steps.
        stamps: whether the stamps tell the jitter, or are themselves all that jitters.
        stale: share of rows that repeat the one before.
        lost: share of rows that are missing.
        pauses: in the recording, s.
        bits: of the encoders, one turn.
    """

    jitter: float = 0.0
    stamps: bool = True
    stale: float = 0.0
    lost: float = 0.0
    pauses: tuple[float, ...] = ()
    bits: int = 16


def written(path: Path, model: haptid.DynamicModel, beta: np.ndarray, recorder: Recorder, seed: int = 0) -> Path:
    """A log of a multisine motion below 2 Hz, with 1 % of noise on the torques."""
    rng, n = np.random.default_rng(seed), round(RATE * SECONDS)
    nominal = np.arange(n) / RATE
    for k, pause in enumerate(recorder.pauses, 1):
        nominal[k * n // (len(recorder.pauses) + 1) :] += pause
    t = np.sort(nominal + recorder.jitter / RATE * rng.normal(size=n))
    taken = t if recorder.stamps else nominal
    omega, angle = 2 * np.pi * rng.uniform(0.2, 2.0, (3, 5, 1)), rng.uniform(0, 2 * np.pi, (3, 5, 1))
    size = 0.12 / (omega / 6) ** 0.7
    q, qd, qdd = (np.sum(size * omega**k * np.sin(omega * taken + angle + 0.5 * np.pi * k), axis=1) for k in (0, 1, 2))
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau += 0.01 * tau.std(axis=1, keepdims=True) * rng.normal(size=tau.shape)
    step = 2 * np.pi / 2**recorder.bits
    q = step * np.round(q / step)
    row = np.maximum.accumulate(np.where(rng.random(n) < recorder.stale, 0, np.arange(n)))
    kept = rng.random(n) >= recorder.lost
    columns = {f"q{k + 1}": q[k, row][kept] for k in range(3)} | {f"tau{k + 1}": tau[k, row][kept] for k in range(3)}
    np.savez(path, t=t[kept], **columns)
    return path


@pytest.fixture(scope="module")
def arm() -> tuple[haptid.DynamicModel, np.ndarray]:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return model, truth(model)


FAULTS = {
    "none": Recorder(),
    "jitter": Recorder(jitter=0.3),
    "much jitter": Recorder(jitter=1.5),
    "jitter of the stamps alone": Recorder(jitter=0.3, stamps=False),
    "much jitter of the stamps alone": Recorder(jitter=1.5, stamps=False),
    "few stale rows": Recorder(stale=0.03, bits=20),
    "stale rows": Recorder(stale=0.13),
    "stale rows of a coarse encoder": Recorder(stale=0.13, bits=14),
    "stale rows and jitter": Recorder(stale=0.13, jitter=0.3, bits=18),
    "lost rows": Recorder(lost=0.1),
    "pauses": Recorder(pauses=(0.5, 3.0, 60.0, 0.2)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_parameters_from_a_faulty_recorder(
    tmp_path: Path, arm: tuple[haptid.DynamicModel, np.ndarray], name: str
) -> None:
    model, beta = arm
    recorder = FAULTS[name]
    log = read_log(written(tmp_path / "log.npz", model, beta, recorder), CHANNELS)
    report = log.time_base
    assert report is not None
    if not recorder.jitter:
        assert report.method == "regular"
    else:
        assert report.method == ("stamps" if recorder.stamps else "line")
    for share in (report.stale_position, report.stale_torque):
        assert share == pytest.approx(recorder.stale, rel=0.2)
    assert len(report.gaps) == len(recorder.pauses)
    assert (log.usable_bandwidth_hz is None) == (not (recorder.stale or recorder.lost or report.method == "stamps"))
    assert bool(report.sentences) == (name != "none")
    estimate = haptid.estimate(haptid.observe(model, haptid.treat(log, TREATMENT)), haptid.WLS())
    far = np.abs(estimate.beta - beta) / estimate.se
    assert (far < 2.0).mean() >= 0.7  # clean logs: 0.89, as those with faults, over many seeds
    assert far.max() < 4.5


def observed(model: haptid.DynamicModel, log: Log) -> haptid.Observation:
    return haptid.observe(model, haptid.treat(log, replace(TREATMENT, reversal_speed=0.0)))


def test_segments_are_treated_by_themselves(tmp_path: Path, arm: tuple[haptid.DynamicModel, np.ndarray]) -> None:
    """Rows of a log with a pause are those of its two parts."""
    model, beta = arm
    path = written(tmp_path / "log.npz", model, beta, Recorder(pauses=(2.0,)))
    log = read_log(path, CHANNELS)
    whole = observed(model, log)
    parts = [observed(model, log.between(*segment)) for segment in log.segments]
    rows = [sum(int(part.motors[k].rows.sum()) for part in parts) for k in range(3)]
    for motor, expected in zip(whole.motors, rows, strict=True):
        assert abs(int(motor.rows.sum()) - expected) <= 1  # rows are every fifth sample, in phase with the first
    first = parts[0].motors[0].rows.sum()
    index = [k for k, block in enumerate(whole.blocks) if block.stop <= parts[0].blocks[-1].stop]
    assert 0 < whole.motors[0].rows[index].sum() <= first
    starts = np.array([block.start for block in whole.blocks])
    assert (np.diff(starts) > 0).all()
    gap = log.t[log.segments[1][0] - 1 : log.segments[1][0] + 1]
    assert not any(gap[0] < t < gap[1] for motion in whole.motions for t in motion.t)


def test_the_default_path_says_what_was_done(tmp_path: Path, arm: tuple[haptid.DynamicModel, np.ndarray]) -> None:
    model, beta = arm
    log = read_log(written(tmp_path / "log.npz", model, beta, Recorder(stale=0.13, pauses=(1.0,))), CHANNELS)
    proposal = haptid.propose(model, log, cutoff_hz=25.0, torque_delay_s=0.0)
    estimate = haptid.estimate(haptid.observe(model, haptid.treat(log, proposal.treatment)), haptid.WLS())
    assert log.time_base is not None
    assert set(log.time_base.sentences) <= set(estimate.notes)
    assert (np.abs(estimate.beta - beta) / estimate.se < 2.0).mean() >= 0.8


def test_a_choice_of_the_user_is_kept(tmp_path: Path, arm: tuple[haptid.DynamicModel, np.ndarray]) -> None:
    model, beta = arm
    path = written(tmp_path / "log.npz", model, beta, Recorder(jitter=0.3, stamps=False, stale=0.13))
    log = read_log(path, replace(CHANNELS, sampling="stamps", stale="keep"))
    assert log.time_base is not None
    assert (log.time_base.method, log.time_base.stale_position, log.time_base.slope) == ("stamps", 0.0, None)
    log = read_log(path, replace(CHANNELS, sampling="regular", stale="keep"))
    with np.load(path) as file:
        np.testing.assert_array_equal(log.position[:, 0], file["q1"])
