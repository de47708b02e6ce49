"""Frequency response of periodic logs: against closed forms, coverage of its circles, its spring, its refusals."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from elastic_motors import FV, FVM, IA, TRUTH, D, J, K, axis
from haptid.cli import app
from haptid.device.toml.reader import checked_tables, device_of
from haptid.errors import IdentifiabilityError, LogTimeError
from haptid.estimation.methods.motor_noise import with_noise_uncertainty
from haptid.inference import multisine_response
from haptid.treatment_choice.hidden_joints import complete_logs
from json_outputs import valid

DT, PERIOD = 1e-3, 2.5
HARMONICS = np.arange(1, 41)


def dynamic_stiffness(s):
    """Torque by position of the motor of the elastic axis."""
    load, bend = J * s**2 + FV * s, K + D * s
    return IA * s**2 + FVM * s + load * bend / (load + bend)


def recorded(Z, seed=0, periods=6, noise=0.05, positions=1e-6, extra=300, moving=1.0):
    """A multisine of the positions, and the torque that it takes, (bins, n, n) by harmonic; white noise on both."""
    rng, n = np.random.default_rng(seed), Z.shape[1]
    t = DT * np.arange(round(periods * PERIOD / DT) + extra)
    s = 2j * np.pi * HARMONICS / PERIOD
    C = moving * (0.5 / np.abs(s)[:, None]) * np.exp(1j * rng.uniform(0, 2 * np.pi, (len(s), n)))
    T = np.einsum("bij,bj->bi", Z, C)
    q, tau = ((x.T @ np.exp(s[:, None] * t)).real.T for x in (C, T))
    q, tau = q + positions * rng.standard_normal(q.shape), tau + noise * rng.standard_normal(tau.shape)
    names = [tuple(f"{x}{k}" for k in range(n)) for x in "qu"]
    channels = haptid.Channels(haptid.Signal(names[0], "rad"), haptid.Signal(names[1], "N m", side="motor"), "t")
    return haptid.Log(Path("made"), str(seed), t, np.ascontiguousarray(q), np.ascontiguousarray(tau), channels)


@pytest.fixture(scope="module")
def truth():
    return dynamic_stiffness(2j * np.pi * HARMONICS / PERIOD)


def test_circles_hold_the_closed_form(truth):
    """200 logs: 95 % of the circles of all harmonics, and hardly a frequency that is not excited."""
    inside, strays = [], 0
    for seed in range(200):
        found = multisine_response(axis(), recorded(truth[:, None, None], seed), PERIOD, torque_delay_s=0.0)
        n = len(HARMONICS)
        np.testing.assert_allclose(found.f[:n], HARMONICS / PERIOD)
        inside.append(np.abs(found.G[:n, 0, 0] - 1 / truth) < found.radius[:n, 0, 0])
        strays += len(found.f) - n
    assert 0.93 < np.mean(inside) < 0.97
    assert strays <= 2


def test_the_period_is_found(truth):
    found = multisine_response(axis(), recorded(truth[:, None, None]), torque_delay_s=0.0)
    assert found.period == pytest.approx(PERIOD, rel=1e-12)
    first = found.summary().splitlines()[1].split()
    assert [float(x) for x in first[:2]] == pytest.approx([0.4, abs(found.G[0, 0, 0])], rel=1e-3)


def test_a_held_command_is_late_by_half_a_sample(truth):
    log = recorded(truth[:, None, None], noise=1e-9, positions=0.0)
    late, exact = (multisine_response(axis(), log, PERIOD, torque_delay_s=d) for d in (None, 0.0))
    np.testing.assert_allclose(late.G / exact.G, np.exp(1j * np.pi * exact.f * DT)[:, None, None], rtol=1e-9)


def test_a_motor_at_rest_hides_no_period():
    """Two motors without coupling, of which each log moves one: the other's position is noise of its encoder."""
    joints = [{"name": "1"}, {"name": "2", "parent": "base", "d": 0.3}]
    data = {"schema": 1, "name": "pair", "gravity": [0.0, 0.0, 0.0], "joints": joints}
    model = haptid.DynamicModel(device_of(*checked_tables(data, "pair.toml")))
    s = (2j * np.pi * HARMONICS / PERIOD)[:, None, None]
    Z = np.eye(2) * (0.4 * s**2 + 0.5 * s)
    logs = [recorded(Z, seed, moving=np.eye(2)[seed]) for seed in (0, 1)]
    found = multisine_response(model, logs, torque_delay_s=0.0)
    assert found.period == pytest.approx(PERIOD, rel=1e-12)
    own = found.f < 16.1
    assert np.mean(np.abs(found.G[own, 0, 0] - 1 / Z[: own.sum(), 0, 0]) < found.radius[own, 0, 0]) > 0.85


def test_two_motors_from_two_logs():
    """A matrix of masses, dampers and springs; each log has other phases."""
    joints = [{"name": "1"}, {"name": "2", "d": 0.3}]
    terms = [{"kind": "viscous", "joints": "all"}]
    data = {"schema": 1, "name": "arm", "gravity": [0.0, 0.0, 0.0], "joints": joints, "terms": terms}
    model = haptid.DynamicModel(device_of(*checked_tables(data, "arm.toml")))
    s = (2j * np.pi * HARMONICS / PERIOD)[:, None, None]
    Z = np.array([[0.4, 0.1], [0.1, 0.1]]) * s**2 + np.array([[0.5, -0.1], [-0.1, 0.3]]) * s + np.diag([20.0, 5.0])
    logs = [recorded(Z, seed) for seed in (1, 2)]
    found = multisine_response(model, logs, torque_delay_s=(0.0, 0.0))
    assert np.mean(np.abs(found.G - np.linalg.inv(Z)) < found.radius) > 0.9
    own, variance = found.stiffness(1)
    assert np.mean(np.abs(own - Z[:, 1, 1]) < np.sqrt(3.3 * variance)) > 0.9
    with pytest.raises(IdentifiabilityError, match="needs as many logs"):
        multisine_response(model, logs[0])


def test_its_spring_is_that_of_the_global_method(truth):
    log = recorded(truth[:, None, None], noise=0.02, periods=5)
    spring = multisine_response(axis(), log, torque_delay_s=0.0).spring()
    assert abs(spring.stiffness - K) < 3 * spring.se < 0.1 * K
    assert spring.antiresonance == pytest.approx(np.sqrt(K / J) / (2 * np.pi), rel=0.03)
    _, found = complete_logs(axis(), [log], [True], torque_delay_s=0.0)
    found = with_noise_uncertainty(found)
    se = float(found.se[found.names.index("KE1")])
    assert abs(found["KE1"].value - spring.stiffness) < 3 * np.hypot(se, spring.se)
    assert TRUTH["KE1"] == K


def test_intervals_of_the_spring_hold_it(truth):
    made = [multisine_response(axis(), recorded(truth[:, None, None], k), PERIOD, 0.0).spring() for k in range(60)]
    assert np.mean([abs(one.stiffness - K) < 2 * one.se for one in made]) >= 0.88
    assert np.std([one.stiffness for one in made]) == pytest.approx(np.mean([one.se for one in made]), rel=0.3)


def test_what_does_not_repeat_or_shows_no_spring_is_refused(truth):
    rigid = (0.15 * (2j * np.pi * HARMONICS / PERIOD) ** 2)[:, None, None]
    with pytest.raises(IdentifiabilityError, match="shows no spring"):
        multisine_response(axis(), recorded(rigid), PERIOD, 0.0).spring()
    with pytest.raises(LogTimeError, match="no motion that repeats"):
        multisine_response(axis(), recorded(truth[:, None, None], periods=2))
    with pytest.raises(LogTimeError, match="2 periods"):
        multisine_response(axis(), recorded(truth[:, None, None], periods=2), PERIOD)
    with pytest.raises(LogTimeError, match=r"does not repeat after 1\.7 s"):
        multisine_response(axis(), recorded(truth[:, None, None]), 1.7)


MOTION = """schema = 1
name = "multisine that repeats"
seed = 1

[trajectory]
kind = "multisine"
seconds = 11.0
centre = 0.0
amplitude = 0.3
frequencies_hz = [0.5, 30.0]
count = 24
period = 2.0

[controller]
kp = 600.0
kd = 15.0

[encoders]
counts_per_turn = 4000.0
gear = 50.0

[amplifiers]
noise = 0.02

[parameters]
"""
AXIS = """schema = 1
name = "axis"
gravity = [0.0, 0.0, -9.81]
joints = [{ name = "1" }]
terms = [
    { kind = "elastic", motors = "all" },
    { kind = "rotor-inertia", motors = "all" },
    { kind = "viscous", joints = "all" },
    { kind = "viscous", motors = "all" },
]
"""
STUDY = """schema = 1
name = "response"
device = "axis.toml"

[[logs]]
path = "log.parquet"

[channels]
time = "t"
position = { channels = ["q_rotor1"], unit = "rad" }
torque = { channels = ["command1"], unit = "N m", side = "motor" }
"""


def test_the_command_finds_the_spring_of_the_bench(tmp_path):
    """From a repeating motion of the bench, whose springs MuJoCo simulates, to files."""
    values = {**TRUTH, "FV1": FV, "FVM1": FVM}
    (tmp_path / "motion.toml").write_text(MOTION + "".join(f"{name} = {x}\n" for name, x in values.items()))
    (tmp_path / "axis.toml").write_text(AXIS)
    (tmp_path / "study.toml").write_text(STUDY)

    def called(*arguments):
        done = CliRunner().invoke(app, [str(one) for one in arguments])
        assert done.exit_code == 0, done.output
        return done.stdout

    called("bench", tmp_path / "axis.toml", tmp_path / "motion.toml", "--out", tmp_path / "log.parquet")
    printed = called("response", tmp_path / "study.toml", "--out", tmp_path / "out")
    assert re.search(r"a spring of (600|599\.9|600\.\d)\d* N m/rad \(", printed)
    assert "there is more" not in printed
    found = valid("response", called("response", tmp_path / "study.toml", "--out", tmp_path / "out", "--json"))
    assert found["period"] == pytest.approx(2.0)
    f = np.array(found["f"])
    np.testing.assert_allclose(f * 2.0, np.round(f * 2.0), atol=1e-6)
    assert len(f) >= 24
    (spring,) = found["springs"]
    assert spring["stiffness"] == pytest.approx(K, rel=5e-3)
    assert spring["damping"] == pytest.approx(D, rel=0.05)
    (entry,) = found["responses"]
    with (tmp_path / "out" / "response.csv").open() as file:
        head, first, *_ = csv.reader(file)
    assert head[:2] == ["f, Hz", "motor 1 by motor 1, real, rad/(N m)"]
    assert [float(x) for x in first] == [f[0], *(entry[key][0] for key in ("real", "imaginary", "radius"))]
    assert (tmp_path / "out" / "response.png").read_bytes().startswith(b"\x89PNG")


def test_a_motion_without_a_period_is_refused_by_the_command(tmp_path):
    """The same file without `period`: one sentence, and nothing is written."""
    (tmp_path / "motion.toml").write_text(MOTION.replace("period = 2.0\n", ""))
    (tmp_path / "axis.toml").write_text(AXIS)
    (tmp_path / "study.toml").write_text(STUDY)
    values = "".join(f"{name} = {x}\n" for name, x in {**TRUTH, "FV1": FV, "FVM1": FVM}.items())
    with (tmp_path / "motion.toml").open("a") as file:
        file.write(values)
    log = ["bench", str(tmp_path / "axis.toml"), str(tmp_path / "motion.toml"), "--out", str(tmp_path / "log.parquet")]
    assert CliRunner().invoke(app, log).exit_code == 0
    done = CliRunner().invoke(app, ["response", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "no motion that repeats" in done.stderr
    assert not (tmp_path / "out").exists()
