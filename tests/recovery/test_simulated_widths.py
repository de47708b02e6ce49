"""Dry friction that turns over smoothly: what a wide band biases, a narrow one does not; steps are cut only there."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid import bench, estimators
from haptid.simulation import DirectModel, Stretches, measured_state, open_loop, sets_of, smooth
from haptid.simulation.parametric import ParametricModel
from small_study import two_links
from true_parameters import true_parameters

DT = 4e-3


def truth(device):
    size = {"FV": 0.05, "FC": 0.2}
    return np.array([size.get(k, x) for k, x in zip(device.parameters.kinds, true_parameters(device), strict=True)])


@cache
def observed(seed):
    """Encoders of 4000 counts behind a gear, noise on the torque."""
    device, encoders = two_links(), bench.Encoders((4000.0,), (10.0,))
    controller = bench.Controller((60.0, 30.0), (4.0, 2.0), rate_hz=1 / DT)
    amplifiers = bench.Amplifiers(noise=(0.02,))
    setup = bench.Setup(device, truth(device), controller, encoders=encoders, amplifiers=amplifiers)
    plan = bench.Multisine(6.0, (0.0, 0.5), (0.9, 0.8), speed=(2.5, 2.5))
    trajectory = bench.plan(plan, device, setup.dt, np.random.default_rng(seed))
    made, inner = bench.simulate(setup, trajectory, np.random.default_rng(seed + 1)), slice(125, -125)
    torque = haptid.Signal(("c1", "c2"), device.motors[0].unit, side="motor")
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), torque, time="t")
    log = haptid.Log(Path("bench"), "", made.t[inner], made.position[inner], made.command[inner], channels)
    treatment = haptid.Treatment(cutoff_hz=25, decimation=5, torque_delay=DT / 2, low_speed=0.05)
    return haptid.observe(device, haptid.treat(log, treatment))


@pytest.mark.parametrize(("kind", "wide"), [(estimators.OutputError, 0.01), (estimators.EKF, 0.02)])
def test_a_narrow_band_takes_the_bias_off_dry_friction(kind, wide):
    rows = observed(3)
    device = rows.device
    beta = device.base.of(truth(device))
    dry = device.base.names.index("FC2")
    wider, own = (
        abs(haptid.estimate(rows, method).beta[dry] / beta[dry] - 1) for method in (kind(friction=wide), kind())
    )
    assert own < 0.5 * wider
    assert own < 0.02


def test_only_where_friction_turns_over_steps_are_cut(monkeypatch):
    """Law: the same motion as with every step cut."""
    rows = observed(3)
    device, motion = rows.device, rows.motions[0]
    model = DirectModel(smooth(device, [motion], 1e-3), sets_of(device, device.base.of(truth(device))))
    stretches = Stretches.of(len(motion), 25, 0)
    treated, cd = measured_state(device, motion)
    start = treated[:, stretches.sample[0]], cd[:, stretches.sample[0]]
    some = open_loop(model, motion, motion.tau.T, start, stretches)
    monkeypatch.setattr(DirectModel, "turning", lambda *args: np.ones(args[1].shape[1], dtype=bool))
    every = open_loop(model, motion, motion.tau.T, start, stretches)
    np.testing.assert_allclose(some.c, every.c, atol=1e-6)


def test_steps_of_the_filter_are_cut_where_friction_turns_over(monkeypatch):
    """With whole steps friction turns over half a step late, which biases it the other way."""
    rows = observed(3)
    beta = rows.device.base.of(truth(rows.device))
    cut = haptid.estimate(rows, estimators.EKF())
    monkeypatch.setattr(ParametricModel, "turning", lambda *_: False)
    whole = haptid.estimate(rows, estimators.EKF())
    assert np.sum(((cut.beta - beta) / cut.sd) ** 2) < np.sum(((whole.beta - beta) / whole.sd) ** 2)
