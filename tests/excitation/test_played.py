"""What came back of a planned motion: every way in which a recording goes wrong is found with its figure."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.experiment import bench
from haptid.experiment.excitation import MotionSamples, compare_with_plan, read_motion, write_motion
from small_study import DEVICE, STUDY, two_links

MODEL = two_links()
PLAN_RATE, LOG_RATE, LEAD = 200.0, 500.0, 0.7


def planned(seed=1, seconds=6.0):
    kind = bench.Multisine(seconds, (0.0, 0.5), (0.8, 0.6), speed=(2.0, 2.0))
    made = bench.plan(kind, MODEL, 1 / PLAN_RATE, np.random.default_rng(seed))
    return MotionSamples("two links", ("1", "2"), ("1", "2"), (False, False), PLAN_RATE, made.q, made.qd, made.qdd)


PLAN = planned()


def recorded(speed=1.0, begin=None, end=None, change=None, plan=PLAN, offset=(0.0, 0.0)):
    """A log of the plan at another rate, with rest before and after, from formulas."""
    total = LEAD + plan.t[-1] / speed + 0.5
    t = np.arange(0.0 if begin is None else begin, total if end is None else end, 1 / LOG_RATE)
    at = np.clip(speed * (t - LEAD), 0.0, plan.t[-1])
    q = np.column_stack([np.interp(at, plan.t, x) for x in plan.q.T]) + offset
    q += 1e-5 * np.random.default_rng(0).standard_normal(q.shape)
    tau = np.column_stack([np.sin(2 * t), np.cos(3 * t)])
    if change is not None:
        q, tau = change(at, q, tau)
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("tau1", "tau2"), "N m"), time="t")
    return haptid.Log(Path("log.csv"), "", t - t[0], q, tau, channels)


def compared(plan=PLAN, **how):
    return compare_with_plan(recorded(**how), plan, MODEL.device)


def test_a_log_as_planned():
    found = compared(offset=(0.02, -0.01))
    assert found.start == pytest.approx(LEAD, abs=2e-3)
    assert found.speed == pytest.approx(1.0, abs=5e-4)
    assert found.rates == pytest.approx((PLAN_RATE, LOG_RATE))
    assert found.largest.max() < 1e-3
    (sentence,) = found.sentences
    assert sentence.startswith("The log is the planned motion")


@pytest.mark.parametrize("speed", [0.2, 0.5, 0.97, 1.25, 2.0])
def test_other_time_scale(speed):
    found = compared(speed=speed)
    assert found.speed == pytest.approx(speed, rel=1e-3)
    assert found.start == pytest.approx(LEAD, abs=0.01)
    assert "planned speed" in found.sentences[0]
    assert f"{speed * PLAN_RATE:.3g}"[:3] in found.sentences[0]


def test_missing_ends():
    late = compared(begin=LEAD + 1.5)
    assert late.missing[0] == pytest.approx(1.5, abs=0.01)
    assert "The first 1.5 s" in late.sentences[0]
    early = compared(end=LEAD + 4.0)
    assert early.missing[1] == pytest.approx(2.0, abs=0.01)
    assert "The last 2 s" in early.sentences[0]


def test_a_device_that_was_stopped():
    def stopped(at, q, tau):
        held = at > 3.5
        return np.where(held[:, None], q[np.argmax(held)], q), tau

    found = compared(change=stopped)
    assert found.stopped == pytest.approx(3.5, abs=0.05)
    assert "stands still from 3.5" in " ".join(found.sentences)


def test_tracking_error_has_its_joint_size_and_time():
    def behind(at, q, tau):
        return q + np.column_stack([np.zeros(len(q)), 0.2 * np.exp(-(((at - 2.0) / 0.1) ** 2))]), tau

    found = compared(change=behind)
    assert found.largest[1] == pytest.approx(0.2, rel=0.05)
    assert found.worst[1] == pytest.approx(2.0, abs=0.02)
    assert "Joint 2 is up to" in found.sentences[0]


def test_clipped_torque():
    found = compared(change=lambda _at, q, tau: (q, np.clip(tau, -0.8, [0.8, 2.0])))
    assert found.clipped[0] == pytest.approx((np.abs(np.sin(2 * recorded().t)) > 0.8).mean(), rel=0.05)
    assert found.extreme[0] == pytest.approx(0.8)
    assert any("Torque channel 1 is clipped at +-0.8" in sentence for sentence in found.sentences)


def test_another_motion_is_no_tracking_error():
    other = compare_with_plan(recorded(), planned(9), MODEL.device)
    assert not other.same_motion
    assert "not of this motion" in other.sentences[0]


def test_from_file_to_sentence(tmp_path):
    """The plan as `haptid excite` writes it, the log as a recorder does, and `haptid check --plan`."""
    log = recorded(end=LEAD + 4.0)
    columns = {"t": log.t, "q1": log.position[:, 0], "q2": log.position[:, 1]}
    columns |= {"tau1": log.torque[:, 0], "tau2": log.torque[:, 1]}
    pyarrow.csv.write_csv(pa.table(columns), tmp_path / "log.csv")
    pyarrow.csv.write_csv(pa.table(columns), tmp_path / "check.csv")
    (tmp_path / "device.toml").write_text(DEVICE)
    (tmp_path / "study.toml").write_text(STUDY)
    plan = write_motion(tmp_path / "plan.csv", PLAN)
    back = read_motion(plan, MODEL.device)
    np.testing.assert_allclose(back.qdd, PLAN.qdd, rtol=1e-9, atol=1e-9)
    assert back.rate_hz == pytest.approx(PLAN_RATE)
    done = CliRunner().invoke(app, ["check", str(tmp_path / "study.toml"), "--plan", str(plan)])
    assert done.exit_code == 0, done.output
    assert "The last 2 s of the motion are missing" in done.stdout
    wrong = write_motion(tmp_path / "other.csv", replace(PLAN, joints=("a", "b")))
    with pytest.raises(errors.LogFileError, match="not a motion of this device"):
        read_motion(wrong, MODEL.device)
    with pytest.raises(errors.LogFileError, match="cannot be read"):
        read_motion(tmp_path / "none.csv", MODEL.device)
    done = CliRunner().invoke(app, ["check", str(tmp_path / "study.toml"), *(("--plan", str(plan)) * 3)])
    assert done.exit_code == 2
    assert "3 plans for 2 logs" in done.stderr
