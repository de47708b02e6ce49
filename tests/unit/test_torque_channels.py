"""Torque channels by motor: behind a joint that nothing drives, in another order, and in rows that mix them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import haptid
from haptid.advice.edits import edits_of, gain_edits
from haptid.advice.search import Proven, Trials, search_of
from haptid.advice.torque_channels import channels_of_motors
from haptid.advice.validation_logs import of_validation_logs
from haptid.log import Channels, Signal, read_log
from haptid.motion.motion import Motion
from haptid.validation.validation import MotorError, Validation

ARM = """
schema = 1
name = "arm"
convention = "placement"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "a"
axis = [0, 0, 1]
torque = "zero"
[[joints]]
name = "b"
axis = [0, 0, 1]
xyz = [0.3, 0, 0]
[[joints]]
name = "c"
axis = [0, 0, 1]
xyz = [0.25, 0, 0]
"""
MOTORS = '[[motors]]\nname = "c"\ndrives = {{ c = {c} }}\n[[motors]]\nname = "b"\ndrives = {{ b = 1{more} }}\n'
ROWS = '[transmission]\ntorque_rows = "joint"\n'


def motion(folder: Path, device: str, gain: float = 1.0) -> tuple[haptid.DynamicModel, Motion]:
    """A device, and its motion whose log has the torques of the motors c and b, that of b times a gain."""
    (folder / "device.toml").write_text(ARM + device + ROWS)
    model, t = haptid.DynamicModel(haptid.read_device(folder / "device.toml")), np.arange(4000) / 250
    rng = np.random.default_rng(1)
    w, p = rng.uniform(1, 9, (3, 4)), rng.uniform(0, 6, (3, 4))
    q = 0.2 * np.sin(w[:, :, None] * t + p[:, :, None]).sum(axis=1)
    qd, qdd = np.gradient(q, t, axis=1), np.gradient(np.gradient(q, t, axis=1), t, axis=1)
    chi = rng.uniform(0.1, 1, len(model.device.parameters.names))
    row = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)[1:]  # of joint b and c
    tau = np.linalg.solve(model.device.drive_rates[model.device.driven][:, 1:].T, row) + 0.01 * rng.normal(
        size=row.shape
    )
    np.savez(folder / "log.npz", t=t, q=q.T, tau=tau.T * np.array([1.0, gain]))
    position = Signal(("q[1]", "q[2]", "q[3]"), "rad")
    channels = Channels(position, Signal(("tau[1]", "tau[2]"), "N m", side="motor"), time="t")
    treatment = haptid.Treatment(cutoff_hz=20.0, parallel_cutoff_hz=10.0, decimation=4, block_s=0.5)
    return model, haptid.treat(read_log(folder / "log.npz", channels), treatment)


def searched(folder: Path, device: str, gain: float = 1.0) -> Trials:
    model, made = motion(folder, device, gain)
    beta = haptid.estimate(haptid.observe(model, made), haptid.OLS()).beta
    return search_of(model, (made,), beta)


def test_channels_are_found_behind_a_joint_that_nothing_drives_in_any_order(tmp_path: Path) -> None:
    found = channels_of_motors(
        *(x if k == 0 else (x,) for k, x in enumerate(motion(tmp_path, MOTORS.format(c=2, more=""))))
    )
    assert found.measured == (1, 2)
    assert [found.of(k) for k in range(3)] == [None, 1, 0]
    assert [found.motors(k) for k in range(2)] == [(2,), (1,)]
    np.testing.assert_allclose(found.scales, [1.0, 1.0, 2.0])


def test_a_row_that_mixes_channels_has_none_of_its_own(tmp_path: Path) -> None:
    search = searched(tmp_path, MOTORS.format(c=1, more=", c = 1"))
    found = search.torques
    assert found.scales is None
    assert found.motors(1) == (1, 2)
    assert [found.of(k) for k in range(3)] == [None, None, None]
    kinds = {one.kind for one in search.candidates}
    assert kinds.isdisjoint({"gain", "torque swap", "time shift"})
    assert "drift" in kinds


def test_gains_exchanges_and_shifts_are_tried_and_written_for_the_channel_of_the_motor(tmp_path: Path) -> None:
    search = searched(tmp_path, MOTORS.format(c=1, more=""), gain=1.5)
    tried = {(one.kind, one.places): one for one in search.candidates}
    one = tried["gain", ("joint b",)]
    made = search.bench.run(one.setting)
    assert made.whole.factors[one.indices[0]] == pytest.approx(1.5, rel=0.02)
    proven = Proven(one, made, SimpleNamespace())
    (edit,) = edits_of(search, proven, search.motions[0].treatment)
    assert (edit.path[-1], edit.index) == ("gain", 1)
    assert edit.value == pytest.approx(1 / 1.5, rel=0.02)
    swap = tried["torque swap", ("joint b", "joint c")]
    (edit,) = edits_of(search, Proven(swap, made, SimpleNamespace()), search.motions[0].treatment)
    assert sorted(edit.value) == [0, 1]
    shift = tried["time shift", ("joint c",)]
    late = Proven(shift, made, SimpleNamespace(), values=(np.array([0.01]),))
    (edit,) = edits_of(search, late, search.motions[0].treatment)
    assert edit.value == [0.01, 0.0]
    assert not any("joint a" in place for kind, places in tried for place in places if kind in ("gain", "torque swap"))
    assert not list(gain_edits(search, 0, -1.0))


def of_interface(folder: Path, side: str, model: haptid.DynamicModel, gain: float) -> Motion:
    """Motion of the CEA interface: torques of its motors or joints, that of H times a gain."""
    t, rng = np.arange(1500) / 250, np.random.default_rng(1)
    w, p = rng.uniform(1, 9, (6, 4)), rng.uniform(0, 6, (6, 4))
    q = 0.04 * np.sin(w[:, :, None] * t + p[:, :, None]).sum(axis=1)
    q += np.array([0.0, -1.0, 4.0, 0.0, -1.0, 4.0])[:, None]
    qd, qdd = np.gradient(q, t, axis=1), np.gradient(np.gradient(q, t, axis=1), t, axis=1)
    chi = rng.uniform(0.1, 1, len(model.device.parameters.names))
    tau = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
    names = model.device.row_names
    if side == "motor":
        tau, names = model.device.drive_torque(q, tau), tuple(motor.name for motor in model.device.motors)
    tau = tau + 0.01 * rng.normal(size=tau.shape)
    tau[names.index("H")] *= gain
    np.savez(folder / "log.npz", t=t, q=q.T, tau=tau.T)
    position = Signal(tuple(f"q[{k}]" for k in range(1, 7)), "rad")
    torque = Signal(tuple(f"tau[{k}]" for k in range(1, len(tau) + 1)), "N m", side=side)
    treatment = haptid.Treatment(cutoff_hz=20.0, parallel_cutoff_hz=10.0, decimation=4, block_s=0.5)
    return haptid.treat(read_log(folder / "log.npz", Channels(position, torque, time="t")), treatment)


@pytest.mark.parametrize("side", ["motor", "joint"])
def test_channels_of_drives_that_vary_with_the_pose_are_those_of_their_rows(tmp_path: Path, side: str) -> None:
    """A gain of joint H, row 4 of 6, was written for L1, channel 4 of its 7 motors, whose torque is in five rows."""
    model = haptid.DynamicModel(haptid.read_device("cea_medical_interface"))
    made = of_interface(tmp_path, side, model, 1.5)
    search = search_of(model, (made,), haptid.estimate(haptid.observe(model, made), haptid.OLS()).beta, columns=False)
    found, gains = search.torques, {one.places: one for one in search.candidates if one.kind == "gain"}
    if side == "motor":
        assert [found.of(k) for k in range(6)] == [None, None, None, 6, None, None]
        assert [found.motors(k) for k in range(7)] == [(0,), (1,), (2,), (0, 1, 2, 4, 5), (4,), (5,), (3,)]
        assert found.scales is None
        assert {one.places for one in search.candidates} == {("joint H",)}
        assert not list(gain_edits(search, 4, 2.0))
    else:
        assert [found.of(k) for k in range(6)] == list(range(6))
        np.testing.assert_array_equal(found.scales, np.ones(6))
        assert len(gains) == 6
    one = gains["joint H",]
    trial = search.bench.run(one.setting)
    assert trial.whole.factors[one.indices[0]] == pytest.approx(1.5, rel=0.02)
    (edit,) = edits_of(search, Proven(one, trial, SimpleNamespace()), made.treatment)
    assert (edit.path[-1], edit.index) == ("gain", 6 if side == "motor" else 3)


@pytest.mark.parametrize("joint", ["b", "c"])
def test_the_error_of_a_validation_log_is_without_the_motor_of_noise_behind_a_free_joint(
    tmp_path: Path, joint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the number of its channel it was that of another motor whose error did not count."""
    monkeypatch.setattr("haptid.motion.noise_torques.noise_alone", lambda _: np.array([True, False]))  # of c, and b
    model, made = motion(tmp_path, MOTORS.format(c=1, more=""))
    errors = {"a": 1.0, "b": 1.0, "c": 1.0} | {joint: 90.0}
    motors = (MotorError(name, f"joint {name}", "N m", size, 100.0, 10) for name, size in errors.items())
    run = SimpleNamespace(
        entry=SimpleNamespace(role="validate", path="log.npz"),
        motion=made,
        observation=SimpleNamespace(motors=()),
        unseen=(Validation(tuple(motors), False),),
    )
    fit = SimpleNamespace(observation=SimpleNamespace(motions=()), beta=np.zeros(0))
    said = list(of_validation_logs(SimpleNamespace(model=model, estimate=fit, runs=(run,)), 1.0))
    assert "torque of joint c shows no part that follows the motion" in said[0]
    assert any("on unseen blocks of the fit" in one for one in said[1:]) == (joint == "b")
