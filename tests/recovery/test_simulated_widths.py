"""Dry friction that turns over smoothly: what a wide band biases, a narrow one does not; steps are cut only there."""

from functools import cache

import numpy as np
import pytest

import haptid
from haptid import estimation
from haptid.dynamics.forward import ForwardDynamics, ParametricForwardDynamics, sets_of
from haptid.experiment import bench
from haptid.simulation import Segments, measured_state, open_loop, smooth
from small_study import FRICTION, driven, log_of, two_links
from true_parameters import true_parameters

DT = 4e-3


@cache
def observed(seed):
    """Encoders of 4000 counts behind a gear, noise on the torque."""
    log = log_of(driven(seed, 5.0, 1 / DT, encoders=bench.Encoders((4000.0,), (10.0,))))
    treatment = haptid.Treatment(cutoff_hz=25, decimation=5, torque_delay_s=DT / 2, reversal_speed=0.05)
    return haptid.observe(two_links(), haptid.treat(log, treatment))


@pytest.mark.parametrize(("kind", "wide"), [(estimation.OutputErrorMethod, 0.01), (estimation.EKF, 0.02)])
def test_a_narrow_band_takes_the_bias_off_dry_friction(kind, wide):
    rows = observed(3)
    model = rows.model
    beta = model.base.of(true_parameters(model, **FRICTION))
    dry = model.base.names.index("FC2")
    wider, own = (
        abs(haptid.estimate(rows, method).beta[dry] / beta[dry] - 1) for method in (kind(friction=wide), kind())
    )
    assert own < 0.5 * wider
    assert own < 0.02


def test_only_where_friction_turns_over_steps_are_cut(monkeypatch):
    """Law: the same motion as with every step cut."""
    rows = observed(3)
    model, motion = rows.model, rows.motions[0]
    beta = model.base.of(true_parameters(model, **FRICTION))
    forward = ForwardDynamics(smooth(model, [motion], 1e-3), sets_of(model, beta))
    segments = Segments.of(len(motion), 25, 0)
    treated, cd = measured_state(model, motion)
    start = treated[:, segments.sample[0]], cd[:, segments.sample[0]]
    some = open_loop(forward, motion, motion.tau.T, start, segments)
    monkeypatch.setattr(ForwardDynamics, "turning", lambda *args: np.ones(args[1].shape[1], dtype=bool))
    every = open_loop(forward, motion, motion.tau.T, start, segments)
    np.testing.assert_allclose(some.c, every.c, atol=1e-6)


def test_steps_of_the_filter_are_cut_where_friction_turns_over(monkeypatch):
    """With whole steps friction turns over half a step late, which biases it the other way."""
    rows = observed(3)
    beta = rows.model.base.of(true_parameters(rows.model, **FRICTION))
    cut = haptid.estimate(rows, estimation.EKF())
    monkeypatch.setattr(ParametricForwardDynamics, "turning", lambda *_: False)
    whole = haptid.estimate(rows, estimation.EKF())
    off = [np.sum((one.beta - beta) ** 2 / np.diag(one.covariance)) for one in (cut, whole)]
    assert off[0] < off[1]
