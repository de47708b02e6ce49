"""Drive gains from two logs of the bench: one of the bare arm, one with a weight at its handle."""

from pathlib import Path

import numpy as np
import pytest

import haptid
from bench_identification import CASES, ENDS, truth_of
from haptid.device.priors import PriorBody
from haptid.experiment import bench

pytest.importorskip("mujoco")
CASE, SECONDS, WEIGHT = CASES["open arm, 3 joints"], 12.0, 1.0
# Torque that the motors give for what the copy of the device file says: its gain of motor 2 is 20 % too high.
TRUE = np.array([1.0, 1 / 1.2, 1.0])


@pytest.fixture(scope="module")
def arm():
    return haptid.DynamicModel(haptid.read_device("arm3"))


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    """A copy of the device file with a gain that is off."""
    text = (Path(haptid.__file__).parent / "device/library" / "arm3.toml").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("device") / "arm3.toml"
    path.write_text(text.replace("drives = { 2 = 1 }", "drives = { 2 = 1 }\ngain = 1.2"), encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))


def observed(arm, model, seed, payload=None):
    """Rows of `device` from a log of `arm` under its controller, through encoders."""
    encoders = bench.Encoders((4000.0,), CASE.gear)
    controller, physics = bench.Controller(CASE.kp, CASE.kd), bench.Physics(5e-4)
    setup = bench.Setup(arm, truth_of(CASE), controller, encoders=encoders, payload=payload, physics=physics)
    kind = bench.Multisine(SECONDS, CASE.centre, CASE.amplitude, speed=CASE.speed)
    trajectory = bench.plan(kind, arm, setup.dt, np.random.default_rng(seed))
    made, inner = bench.simulate(setup, trajectory, np.random.default_rng(seed)), slice(ENDS, -ENDS)
    names = tuple(tuple(f"{what}{k}" for k in "123") for what in ("q", "command"))
    channels = haptid.Channels(haptid.Signal(names[0], "rad"), haptid.Signal(names[1], "N m", side="motor"), "t")
    log = haptid.Log(
        Path(f"bench {seed}"), f"{seed}", made.t[inner], made.position[inner], made.command[inner], channels
    )
    return haptid.observe(model, haptid.treat(log, haptid.propose(model, log).treatment))


def test_a_gain_that_is_off_is_found(arm, wrong):
    com = np.array([arm.device.lengths["L2"], 0.0, 0.0])
    bare, loaded = observed(arm, wrong, 1), observed(arm, wrong, 2, bench.SimulatedPayload(WEIGHT))
    found = haptid.drive_gains(bare, loaded, "3", PriorBody(WEIGHT, com, None))
    np.testing.assert_allclose(found.factor, TRUE, rtol=0.003)
    assert found.conf_int()[1, 1] < 0.84
    beta = arm.base.of(truth_of(CASE))
    heavy = np.abs(beta) > 0.1
    np.testing.assert_allclose(found.beta[heavy], beta[heavy], rtol=0.02)
