"""Errors in W asked with instruments of the simulated closed loop: who gives the controller, size and power."""

from functools import cache
from pathlib import Path

import numpy as np

import haptid
from haptid import bench, estimators
from haptid.diagnosis import diagnose
from haptid.diagnosis.exogeneity import instruments, known
from haptid.diagnosis.finding import LEVEL
from haptid.simulation import PID
from small_study import two_links
from true_parameters import true_parameters

DT, RUNS = 4e-3, 6
CALM, POOR = (
    haptid.Treatment(cutoff_hz=15, decimation=10, torque_delay=DT / 2, low_speed=0.1),
    haptid.Treatment(cutoff_hz=50, torque_delay=DT / 2, low_speed=0.1),
)


def truth(device):
    size = {"FV": 0.05, "FC": 0.2}
    return np.array([size.get(k, x) for k, x in zip(device.parameters.kinds, true_parameters(device), strict=True)])


@cache
def recorded():
    """Exact positions, what was planned, and commands."""
    device = two_links()
    setup = bench.Setup(device, truth(device), bench.Controller((60.0, 30.0), (4.0, 2.0), rate_hz=1 / DT))
    plan = bench.plan(
        bench.Multisine(9.0, (0.0, 0.5), (0.9, 0.8), speed=(2.5, 2.5)), device, setup.dt, np.random.default_rng(3)
    )
    return bench.simulate(setup, plan, np.random.default_rng(4))


def estimated(seed, counts, treatment, method=None):
    """From a reading with its own noise of the torque, and encoders of so many counts a turn."""
    made, inner, rng = recorded(), slice(125, -125), np.random.default_rng(seed)
    step = 2 * np.pi / counts
    zero = rng.uniform(0, 1, 2)
    position = step * (np.round(made.position[inner] / step + zero) - zero)
    torque = made.command[inner] + 0.02 * rng.standard_normal(position.shape)
    signal = haptid.Signal(("c1", "c2"), two_links().motors[0].unit, side="motor")
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), signal, time="t")
    log = haptid.Log(Path("bench"), "", made.t[inner], position, torque, channels)
    return haptid.estimate(haptid.observe(two_links(), haptid.treat(log, treatment)), method or haptid.WLS())


@cache
def law():
    return PID((60.0, 30.0), (4.0, 2.0), reference=(recorded().target[125:-125],), velocity_cutoff_hz=50)


def test_without_errors_in_the_columns_it_is_silent():
    """Size: chance alone speaks up once in a hundred logs."""
    p = [diagnose(estimated(k, 1e7, CALM), controller=law())["errors in W"].figures["p"] for k in range(RUNS)]
    assert sum(x < LEVEL for x in p) <= 1
    assert max(p) > 0.2


def test_coarse_encoders_are_seen():
    """Power: 2000 counts, differentiated up to 50 Hz without a filter for torque and columns."""
    found = [diagnose(estimated(k, 2000, POOR), controller=law())["errors in W"] for k in range(2)]
    assert all(finding.status != "ok" for finding in found)
    assert all("simulated closed loop" in finding.sentence and "IV" in finding.sentence for finding in found)


def test_an_instrumental_estimate_brings_its_own():
    method = haptid.Consistent(estimators.IV(law()))
    assert known(method) is law()
    assert known(haptid.WLS()) is None
    found = diagnose(estimated(1, 1e7, CALM, method))["errors in W"]
    assert found.status == "ok"
    assert "simulated closed loop" in found.sentence
    assert "narrower filter" in diagnose(estimated(1, 1e7, CALM))["errors in W"].sentence


def test_a_model_that_runs_away_leaves_the_filter():
    made = estimated(1, 1e7, CALM)
    wild = PID((-6e5, -3e5), (4.0, 2.0), reference=law().reference)
    assert "filter" in instruments(made, wild).left
    assert "filter" in instruments(made, PID((1.0, 2.0, 3.0), 1.0)).left
