"""Recursive identification: known parameters inside their intervals, changes followed, what is unknown left open."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

import haptid
from haptid.errors import IdentifiabilityError, NoRowsError, SettingError
from haptid.estimation import RecursiveIdentification
from haptid.experiment.guidance import MotionGuide
from haptid.inference import ModelAlarm
from haptid.observation import RowStream
from motions import multisine, truth
from sampling import FAR, of_share
from small_study import two_links

DT, PHI, NOISE = 5e-3, 0.9, 0.05
MODEL = two_links()
TRUTH = truth(MODEL) + 0.1
CHANNELS = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("t1", "t2"), "N m"), rate_hz=1 / DT)
TREATMENT = haptid.Treatment(decimation=2, block_s=0.5)


def stretch(rng: np.random.Generator, seconds: float, beta: np.ndarray = TRUTH) -> tuple[np.ndarray, np.ndarray]:
    """Positions and torques with correlated noise, each (n, 2)."""
    q, qd, qdd = multisine(2, seconds, DT, int(rng.integers(1 << 30)))
    tau = haptid.inverse_dynamics(MODEL, beta, q, qd, qdd)
    rough = signal.lfilter([np.sqrt(1 - PHI**2)], [1, -PHI], rng.standard_normal(tau.shape))
    return q.T, (tau + NOISE * rough).T


def rows(q: np.ndarray, tau: np.ndarray):
    """Blocks of a stream of these samples."""
    stream = RowStream(MODEL, CHANNELS, DT, TREATMENT)
    return [*stream.push(q, tau), *stream.finish()]


def identified(rng: np.random.Generator, seconds: float = 30.0, **settings) -> RecursiveIdentification:
    made = RecursiveIdentification(MODEL, **settings)
    for part in rows(*stretch(rng, seconds)):
        made.add(part)
    return made


@pytest.mark.parametrize("settings", [{}, {"most": 16}, {"forgetting_s": 8.0}])
def test_known_parameters_are_inside_their_intervals(settings):
    inside = []
    for seed in range(40):
        ends = identified(np.random.default_rng(seed), **settings).estimate().conf_int()
        inside.append((ends[:, 0] <= TRUTH) & (ends[:, 1] >= TRUTH))
    # Parameters of one draw are correlated: the spread is that of the draws.
    share = np.mean(inside, axis=1)
    assert abs(share.mean() - 0.95) < max(FAR * share.std(ddof=1) / np.sqrt(len(share)), of_share(0.95, share.size))


def test_a_change_is_followed_with_forgetting_and_not_without():
    rng = np.random.default_rng(1)
    changed = TRUTH * np.where(np.arange(len(TRUTH)) == len(TRUTH) - 1, 1.5, 1.0)
    stream = RowStream(MODEL, CHANNELS, DT, TREATMENT)
    blocks = [*stream.push(*stretch(rng, 30.0)), *stream.gap(1.0)]
    blocks += [*stream.push(*stretch(rng, 40.0, changed)), *stream.finish()]
    found = {}
    for forgetting in (None, 6.0):
        made = RecursiveIdentification(MODEL, forgetting)
        for part in blocks:
            made.add(part)
        found[forgetting] = made.estimate()
    low, high = found[6.0].conf_int(0.999)[-1]
    assert low < changed[-1] < high
    assert TRUTH[-1] < low
    assert found[None].beta[-1] < low
    # Old information fades: the clusters that are left have the weight of the time constant.
    assert made.seconds == pytest.approx(6.0, rel=0.1)


def test_what_is_not_excited_is_open_and_the_rest_is_not():
    """The second joint is held: what its own motion alone excites has no interval, the first joint's friction has."""
    rng = np.random.default_rng(2)
    t = DT * np.arange(6000)
    q = np.stack([0.8 * np.sin(2 * np.pi * 0.5 * t) + 0.3 * np.sin(2 * np.pi * 1.3 * t), 0.4 + 0 * t])
    qd, qdd = np.gradient(q, DT, axis=1), np.gradient(np.gradient(q, DT, axis=1), DT, axis=1)
    qd[1] = qdd[1] = 0.0
    tau = haptid.inverse_dynamics(MODEL, TRUTH, q, qd, qdd) + NOISE * rng.standard_normal(q.shape)
    made = RecursiveIdentification(MODEL)
    for part in rows(q.T, tau.T):
        made.add(part)
    found = made.estimate()
    names = MODEL.base.names
    open_ones = {names[k] for k in found.quantities.unbounded}
    assert {"FV2", "FC2"} <= open_ones
    for name in ("FV1", "FC1"):
        k = names.index(name)
        low, high = found.conf_int(0.999)[k]
        assert low < TRUTH[k] < high
        assert np.isfinite([low, high]).all()
    # The guide names the joint that was held; its motion closes what is open.
    guide = MotionGuide(MODEL, 1 / (DT * TREATMENT.decimation))
    first = guide.guidance(found)
    assert "2" in first.prompts[0].joints
    for part in rows(*stretch(rng, 20.0)):
        made.add(part)
    later = made.estimate()
    assert later.quantities.unbounded == ()
    assert guide.guidance(later).score < 0.2 * first.score


def test_the_score_falls_as_the_prompts_are_followed():
    """Six motions of five seconds, each the one that was named after the last."""
    rng = np.random.default_rng(3)
    guide = MotionGuide(MODEL, 1 / (DT * TREATMENT.decimation))
    made, scores = RecursiveIdentification(MODEL), []
    t = DT * np.arange(1000)
    joints: tuple[int, ...] = (0,)
    for _ in range(6):
        q = rng.uniform(-0.5, 0.5, 2)[:, None] + np.zeros((2, t.size))
        for j in joints:
            q[j] += 0.5 * np.sin(2 * np.pi * (0.9 + 0.4 * j) * t + j)
        qd = np.gradient(q, DT, axis=1)
        tau = haptid.inverse_dynamics(MODEL, TRUTH, q, qd, np.gradient(qd, DT, axis=1))
        for part in rows(q.T, (tau + NOISE * rng.standard_normal(q.shape)).T):
            made.add(part)
        guidance = guide.guidance(made.estimate())
        scores.append(guidance.score)
        joints = tuple(MODEL.device.joint_names.index(name) for name in guidance.prompts[0].joints)
        assert guidance.prompts[0].sentence.startswith("Move joint")
        assert guidance.prompts[0].score <= guidance.prompts[-1].score
    assert scores[-1] < 0.3 * scores[0]
    assert all(after < 1.05 * before for before, after in pairwise(scores))


def test_the_guide_predicts_the_information_of_the_motion_that_it_names():
    """Oracle: W'W of the rows of a motion without filter is that of the guide's own sum over the same states."""
    guide = MotionGuide(MODEL, 1 / DT)
    q, qd, qdd = multisine(2, 5.0, DT, 5)
    tau = haptid.inverse_dynamics(MODEL, TRUTH, q, qd, qdd)
    motion = haptid.Motion(DT, q.T, tau.T, haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
    for motor, gram in zip(haptid.observe(MODEL, motion).motors, guide._gram(q, qd, qdd), strict=True):
        own = motor.whole[:, :-1].T @ motor.whole[:, :-1]
        part = gram[np.ix_(motor.columns, motor.columns)] * q.shape[1]
        np.testing.assert_allclose(own, part, rtol=0, atol=1e-9 * np.abs(own).max())


def test_false_alarms_are_no_more_often_than_stated():
    """A high rate, so that they can be counted: one of fifty blocks."""
    rng, share, alarms, blocks = np.random.default_rng(4), 0.02, 0, 0
    per_hour = share * 3600 / TREATMENT.block_s
    for _ in range(12):
        watch = ModelAlarm(identified(rng).estimate(), per_hour)
        for part in rows(*stretch(rng, 60.0)):
            alarms, blocks = alarms + len(watch.add(part)), blocks + len(part.blocks)
    assert alarms < blocks * (share + of_share(share, blocks))
    assert alarms > 0.1 * share * blocks  # the limit is near, not far beyond what happens


def test_contact_drift_and_a_cable_are_told_apart():
    rng = np.random.default_rng(5)
    reference = identified(rng).estimate()

    def watched(change) -> list:
        q, tau = stretch(rng, 30.0)
        watch = ModelAlarm(reference, 0.1)
        return [alarm for part in rows(q, change(q, tau)) for alarm in watch.add(part)]

    def contact(_, tau):
        tau[3000:3400, 1] += 0.6
        return tau

    def cable(_, tau):
        tau[3000:, 0] *= 0.01
        return tau

    def drift(q, tau):
        speed = np.gradient(q[:, 1], DT)
        tau[2000:, 1] += 0.10 * np.sign(speed)[2000:]
        return tau

    assert watched(lambda _, tau: tau) == []
    found = watched(contact)
    assert {(a.motor, a.kind) for a in found} == {("motor 2", "sudden")}
    assert all(a.start > 14.4 and a.stop < 17.6 for a in found)
    found = watched(cable)
    assert found[-1].kind == "no torque"
    assert {a.motor for a in found} == {"motor 1"}
    assert found[0].start == pytest.approx(15.0, abs=1.0)
    found = watched(drift)
    assert "lasting" in {a.kind for a in found}
    assert {a.motor for a in found} == {"motor 2"}
    assert all(alarm.sentence.endswith(".") for alarm in found)


def test_bad_settings_are_refused():
    rng = np.random.default_rng(6)
    with pytest.raises(SettingError):
        RecursiveIdentification(MODEL, forgetting_s=0.0)
    with pytest.raises(SettingError):
        RecursiveIdentification(MODEL, most=2)
    with pytest.raises(IdentifiabilityError):
        RecursiveIdentification(MODEL).estimate()
    short = identified(rng, 4.0).estimate()
    with pytest.raises(NoRowsError):
        ModelAlarm(short)
    with pytest.raises(SettingError):
        ModelAlarm(identified(rng).estimate(), 0.0)
    with pytest.raises(SettingError):
        MotionGuide(MODEL, 0.0)
