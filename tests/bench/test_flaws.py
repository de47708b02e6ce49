"""Flaws of real devices on the bench: each is one line of the experiment file, and tested against a closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from pyarrow import parquet
from scipy import signal

import haptid
from haptid.device.toml.reader import checked_tables, device_of
from haptid.errors import DeviceFileError, ExperimentError, HaptidError
from haptid.experiment import bench
from haptid.experiment.bench.run import Job, make_log

J, FV = 0.1, 0.05
AXIS = {
    "schema": 1,
    "name": "axis",
    "gravity": [0.0, 0.0, -9.81],
    "joints": [{"name": "1"}],
    "terms": [{"kind": "viscous", "joints": "all"}],
}
EXPERIMENT = """
schema = 1
name = "one axis"
seed = 3
[trajectory]
kind = "multisine"
seconds = {seconds}
centre = 0.0
amplitude = 0.8
frequencies_hz = [0.5, 3.0]
ramp = 0.3
[controller]
kp = 60.0
kd = 2.0
{controller}
[[bodies]]
link = "1"
mass = 1.0
com = [0.0, 0.0, 0.0]
inertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
[parameters]
FV1 = 0.05
{parameters}
{more}
"""


@cache
def axis() -> haptid.DynamicModel:
    """One axis about the vertical, with viscous friction."""
    return haptid.DynamicModel(device_of(*checked_tables(AXIS, "axis.toml")))


def made(tmp_path, more="", controller="", parameters="", seconds=1.5):
    """The set-up of an experiment file and its recording."""
    pytest.importorskip("mujoco")
    path = tmp_path / "experiment.toml"
    text = EXPERIMENT.format(seconds=seconds, more=more, controller=controller, parameters=parameters)
    path.write_text(text, encoding="utf-8")
    experiment = bench.read_experiment(path)
    setup = experiment.setup(axis())
    return setup, bench.perform(experiment, setup, experiment.seed)


def rigid_rest(found):
    """What is left of the torque after that of the link and its viscous friction."""
    return found.torque[:, 0] - J * found.qdd[:, 0] - FV * found.qd[:, 0]


def test_a_clean_axis_is_the_closed_form(tmp_path):
    _, found = made(tmp_path)
    assert np.abs(rigid_rest(found)).max() < 1e-9


def test_bandwidth_is_a_first_order_lag(tmp_path):
    """A command that is held for a period, through the exact step response of the lag."""
    _, found = made(tmp_path, "[amplifiers]\nbandwidth_hz = 40.0")
    keep = np.exp(-2 * np.pi * 40.0 * found.dt)
    u = found.command[:, 0]
    expected = np.concatenate([[u[0]], u[0] + signal.lfilter([1 - keep], [1.0, -keep], u - u[0])[:-1]])
    np.testing.assert_allclose(found.torque[:, 0], expected, atol=1e-9 * np.abs(u).max())
    # Momentum of the simulated axis, against that of the exact lag within the periods.
    w = 2 * np.pi * 40.0
    impulse = u * found.dt + (found.torque[:, 0] - u) * (1 - keep) / w
    gained = J * np.diff(found.qd[:, 0]) + FV * np.diff(found.q[:, 0])
    np.testing.assert_allclose(gained, impulse[:-1], atol=1e-4 * np.abs(impulse).max())


def test_current_has_a_resolution(tmp_path):
    _, found = made(tmp_path, "[amplifiers]\nstep = 0.02")
    counts = found.torque[:, 0] / 0.02
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert np.abs(found.torque - found.command).max() <= 0.01 + 1e-12
    assert len(np.unique(counts)) > 10


def test_jitter_moves_the_time_at_which_a_command_arrives(tmp_path):
    """The gain of momentum in a period tells when its command arrived: a uniform whole number of simulator steps."""
    _, found = made(tmp_path, "[encoders]\ncounts_per_turn = 4000.0\n[amplifiers]\ndelay = 2e-4\njitter = 6e-4")
    u = found.command[:, 0]
    gained = J * np.diff(found.qd[:, 0]) + FV * np.diff(found.q[:, 0])
    change = u[1:-1] - u[:-2]
    clear = np.abs(change) > 0.05 * np.abs(u).max()
    late = ((u[1:-1] * found.dt - gained[1:]) / np.where(clear, change, 1.0))[clear] / 1e-4
    np.testing.assert_allclose(late, np.rint(late), atol=0.02)
    assert set(np.rint(late)) == {2, 3, 4, 5, 6, 7, 8}
    assert np.mean(late) == pytest.approx(5.0, abs=4 * 2.0 / np.sqrt(len(late)))


def test_an_encoder_is_eccentric(tmp_path):
    more = "[encoders]\ncounts_per_turn = 1e9\ngear = 7.0\neccentricity = 2e-3"
    _, found = made(tmp_path, more)
    expected = 2e-3 * np.sin(7.0 * found.q[:, 0])
    np.testing.assert_allclose(found.position[:, 0] - found.q[:, 0], expected, atol=1e-8)


def test_a_cable_slips_over_its_capstan(tmp_path):
    """The encoder jumps by the slip, and the controller moves the joint back by it."""
    _, found = made(tmp_path, "[encoders]\ncounts_per_turn = 1e9\nslip = -0.02\nslip_at = 0.4")
    k = round(0.4 / found.dt)
    ahead = found.position[:, 0] - found.q[:, 0]
    np.testing.assert_allclose(ahead[:k], 0.0, atol=1e-8)
    np.testing.assert_allclose(ahead[k:], -0.02, atol=1e-8)
    assert abs(found.q[k + 300, 0] - found.target[k + 300, 0] - 0.02) < 0.01


def test_a_log_is_slower_than_the_control(tmp_path):
    _, every = made(tmp_path, "[amplifiers]\nnoise = 0.01")
    setup, some = made(tmp_path, "[amplifiers]\nnoise = 0.01", controller="log_every = 4")
    assert some.dt == pytest.approx(4e-3)
    assert setup.dt == pytest.approx(1e-3)
    for name in ("position", "velocity", "command", "target", "q", "qdd", "torque"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[::4])


@pytest.mark.parametrize(
    ("term", "parameters", "column"),
    [
        (
            'kind = "stribeck"\njoints = ["1"]\nvelocity = 0.3\nwidth = 0.01',
            "FS1 = 0.2",
            lambda at: 0.2 * np.tanh(at.qd[:, 0] / 0.01) * np.exp(-((at.qd[:, 0] / 0.3) ** 2)),
        ),
        (
            'kind = "ripple"\njoints = ["1"]\nperiod = 0.3',
            "RS_1 = 0.1\nRC_1 = -0.05",
            lambda at: 0.1 * np.sin(2 * np.pi * at.q[:, 0] / 0.3) - 0.05 * np.cos(2 * np.pi * at.q[:, 0] / 0.3),
        ),
        (
            'kind = "warming"\njoints = ["1"]\ntime = 0.7',
            "FT1 = 0.3",
            lambda at: 0.3 * at.qd[:, 0] * np.exp(-at.t / 0.7),
        ),
    ],
)
def test_friction_and_ripple_are_their_formulas(tmp_path, term, parameters, column):
    _, found = made(tmp_path, f"[[terms]]\n{term}", parameters=parameters)
    expected = column(found)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(rigid_rest(found), expected, atol=2e-3 * np.abs(expected).max())


def test_lugre_friction_is_its_differential_equation(tmp_path):
    """z' = v - |v| z / g(v), integrated with another method along the recorded motion."""
    terms = '[[terms]]\nkind = "lugre"\njoints = ["1"]\ndistance = 0.02\nvelocity = 0.3\nbreakaway = 1.5'
    _, found = made(tmp_path, terms, parameters="FG1 = 0.2")
    q, v, dt, h = found.q[:, 0], found.qd[:, 0], found.dt, np.zeros(len(found))
    level = 1 + 0.5 * np.exp(-((v / 0.3) ** 2))
    for k in range(1, len(h)):
        m = 0.5 * (np.abs(v[k]) / level[k] + np.abs(v[k - 1]) / level[k - 1]) * dt / 0.02
        h[k] = ((1 - m / 2) * h[k - 1] + (q[k] - q[k - 1]) / 0.02) / (1 + m / 2)
    np.testing.assert_allclose(rigid_rest(found), 0.2 * h, atol=0.01 * 0.3)


ELASTIC = """
[[terms]]
kind = "elastic"
motors = "all"
{play}
[[terms]]
kind = "rotor-inertia"
motors = "all"
"""


@pytest.mark.parametrize("play", [0.0, 0.02])
def test_a_spring_and_its_play_are_behind_the_motor(tmp_path, play):
    """Each side alone is a body under the torque of the spring, which has none within the play."""
    more = ELASTIC.format(play=f"play = {play}" if play else "")
    _, found = made(tmp_path, more, parameters="KE1 = 600.0\nDE1 = 0.2\nIAM1 = 0.04")
    torsion = found.q[:, 1] - found.q[:, 0]
    spring = 600.0 * (torsion - np.clip(torsion, -play / 2, play / 2)) + 0.2 * (found.qd[:, 1] - found.qd[:, 0])
    scale = np.abs(found.torque).max()
    np.testing.assert_allclose(0.04 * found.qdd[:, 1] + spring, found.torque[:, 0], atol=1e-3 * scale)
    np.testing.assert_allclose(J * found.qdd[:, 0] + FV * found.qd[:, 0], spring, atol=1e-3 * scale)
    if play:
        assert np.mean(np.abs(torsion) < play / 2) > 0.02


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ("KE1 = 6e8\nDE1 = 0.2\nIAM1 = 0.04", "too fast for the simulator's step"),
        ("KE1 = 600.0\nDE1 = -2.0\nIAM1 = 0.04", "simulation is unstable"),
        ("KE1 = -600.0\nDE1 = 2.0\nIAM1 = 0.04", "requires a positive one"),
        ("KE1 = 600.0\nDE1 = 2.0\nIAM1 = 0.0", "neither mass nor rotor inertia"),
    ],
)
def test_springs_that_cannot_be_simulated_are_clear_errors(tmp_path, parameters, sentence):
    with pytest.raises(HaptidError, match=sentence):
        made(tmp_path, ELASTIC.format(play="play = 0.01"), parameters=parameters)


def test_the_fastest_spring_that_is_simulated_is_the_closed_form(tmp_path):
    """Rotor and link of an axis swing against each other at the root of k (1 / J + 1 / I)."""
    with pytest.raises(ExperimentError) as caught:
        made(tmp_path, ELASTIC.format(play=""), parameters="KE1 = 6e8\nDE1 = 0.0\nIAM1 = 0.04")
    assert caught.value.found == pytest.approx(1e-4 * np.sqrt(6e8 * (1 / J + 1 / 0.04)), rel=1e-6)


def test_wrong_flaws_are_clear_errors(tmp_path):
    with pytest.raises(ExperimentError, match="overtake"):
        made(tmp_path, "[amplifiers]\njitter = 2e-3")
    with pytest.raises(ExperimentError, match="whole number of simulator steps"):
        made(tmp_path, "[amplifiers]\njitter = 1.5e-4")
    with pytest.raises(DeviceFileError, match="rotor has no inertia"):
        made(tmp_path, '[[terms]]\nkind = "elastic"\nmotors = "all"')


SENSED_AXIS = """
schema = 1
name = "axis"
gravity = [0.0, 0.0, -9.81]
joints = [{ name = "1" }]
terms = [{ kind = "elastic", motors = "all", sensor = true }, { kind = "rotor-inertia", motors = "all" }]
"""
SENSED_MOTION = """
schema = 1
name = "move"
trajectory = { kind = "multisine", seconds = 2.0, centre = [0.0], amplitude = [0.5], ramp = 0.5 }
controller = { kp = 40.0, kd = 1.5 }
torque_sensors = { offset = 0.3 }
parameters = { XX1 = 0.1, YY1 = 0.1, ZZ1 = 0.1, M1 = 1.0, KE1 = 400.0, DE1 = 0.5, IAM1 = 0.02 }
"""


def test_torque_sensors_measure_springs(tmp_path):
    """Stiffness times torsion and damping times its rate of the true states, plus the sensor's zero."""
    (tmp_path / "axis.toml").write_text(SENSED_AXIS)
    (tmp_path / "move.toml").write_text(SENSED_MOTION)
    out = make_log(Job(tmp_path / "axis.toml", tmp_path / "move.toml", tmp_path / "log.parquet", truth=True))
    log, states = (parquet.read_table(p).to_pydict() for p in (out, tmp_path / "log.truth.parquet"))
    bent, rate = (np.subtract(states[f"{x}_rotor_1"], states[f"{x}_1"]) for x in ("q", "qd"))
    np.testing.assert_allclose(log["sensor_1"], 400.0 * bent + 0.5 * rate + 0.3, atol=1e-9)
    assert np.ptp(bent) > 1e-3
