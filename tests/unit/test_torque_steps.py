"""Steps of torque channels: a residual below a channel's rounding is no accuracy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from diagnosed import log, phantom
from haptid.motion.channels import motor_torque
from haptid.observation.plan import Plan
from haptid.observation.torque_steps import rounding_of, steps_of

TREATMENT = haptid.Treatment(cutoff_hz=60.0, parallel_cutoff_hz=30.0, torque_delay_s=0.0)


def with_torque(channel: int, values) -> haptid.Log:
    """A clean log in which one torque channel has other values."""
    made = log(3, noise=0.0)
    torque = np.array(made.torque)
    torque[:, channel] = values(torque[:, channel])
    return replace(made, torque=torque)


def test_steps_are_those_of_the_values():
    step, changes = steps_of(with_torque(0, lambda tau: 0.25 * np.round(1e4 * tau)))
    assert step[0] == pytest.approx(0.25)
    assert 0 < changes[0] <= 1
    still, none = steps_of(with_torque(1, lambda tau: np.full_like(tau, -0.3)))
    assert (still[1], none[1]) == (0.3, 0.0)  # it may be anything between nothing and twice its value
    assert steps_of(with_torque(2, np.zeros_like))[0][2] == 0.0


def test_what_the_filter_leaves_of_the_rounding_is_what_it_leaves_of_the_error():
    """White where a channel steps at every sample; whole where it never does."""
    rng = np.random.default_rng(1)
    made = with_torque(0, lambda tau: np.round(rng.normal(0, 40, len(tau))))
    plan = Plan.of(phantom(), haptid.treat(made, TREATMENT))
    scale = rounding_of(Plan.of(phantom(), haptid.treat(with_torque(0, np.ones_like), TREATMENT)))[0]
    white = np.convolve(rng.uniform(-0.5, 0.5, 200_000), plan.taps, "valid").std()
    assert rounding_of(plan)[0] == pytest.approx(white * scale * np.sqrt(12), rel=0.05)


def test_a_channel_of_two_values_that_fits_exactly_has_the_accuracy_of_its_step():
    """Coulomb friction explains it to the last digit, which says nothing of the torque between its values."""
    model, t = haptid.DynamicModel(haptid.read_device("emps")), 1e-3 * np.arange(20_000)
    channels = haptid.Channels(haptid.Signal(("q",), "m"), haptid.Signal(("u",), "V", side="motor"), time="t")
    torque = 0.01 * np.sign(np.cos(3 * t + 1))
    made = haptid.Log(Path("made"), "two values", t, 0.2 * np.sin(3 * t + 1)[:, None], torque[:, None], channels)
    found = haptid.estimate(haptid.observe(model, haptid.treat(made, TREATMENT)), haptid.WLS())
    force = abs(float(motor_torque(model.device, made, np.array([[0.01]]))[0, 0]))
    assert found.observation.motors[0].residual(found.beta) < 1e-9 * found.observation.motors[0].norm
    assert 1 / found.weights[0] == pytest.approx(2 * force / np.sqrt(12))
