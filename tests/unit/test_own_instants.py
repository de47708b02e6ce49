"""Dry friction of motors that differ in delay, at few samples a period: columns are at each motor's own instants."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.device.terms.friction import DRY
from haptid.device.terms.term import Sliding
from haptid.observation.own_instants import own_columns
from haptid.observation.rows import Rows
from haptid.treatment_choice.delay_estimate import find_delays
from motions import multisine, truth

# Fine steps of the motion in a sample of the log, and the delays of three motors in fine steps.
FINE, LATE = 28, (14, 28, 42)


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def log(phantom):
    """Two minutes at 36 Hz of a motion up to 3 Hz: twelve samples in its fastest period."""
    q, qd, qdd = multisine(3, 120.0, 1e-3, 2, 0.2)
    q = q + np.array([0.0, 0.5, 0.8])[:, None]
    tau = haptid.inverse_dynamics(phantom, truth(phantom), q, qd, qdd)
    at = np.arange(0, q.shape[1] - max(LATE), FINE)
    gains = np.array([motor.gear_ratio * motor.torque_constant for motor in phantom.device.motors])
    command = np.stack([row[at + late] for row, late in zip(tau, LATE, strict=True)], axis=1) / gains
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"), haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"), time="t"
    )
    return haptid.Log(Path("made"), "made", 1e-3 * at, q[:, at].T, command, channels)


def treated(late):
    delays = tuple(1e-3 * k for k in late)
    return haptid.Treatment(10.0, parallel_cutoff_hz=6.0, torque_delay_s=delays, reversal_speed=0.02, block_s=5.0)


def test_friction_comes_back_where_motors_differ_in_delay(phantom, log):
    """Dry friction of the motors whose torque is shifted is within 1e-4; with rounded jumps it is 2e-3 off."""
    made = haptid.estimate(haptid.observe(phantom, haptid.treat(log, treated(LATE))), haptid.WLS())
    dry = [k for k, name in enumerate(made.names) if name.startswith("FC")]
    assert len(dry) == 3
    np.testing.assert_allclose(made.beta[dry], truth(phantom)[dry], rtol=2e-4)
    left = Rows(made.observation).residuals(made.beta)  # the rows one by one are those that were reduced
    for motor, e in zip(made.observation.motors, left, strict=True):
        assert np.linalg.norm(e) == pytest.approx(motor.residual(made.beta), rel=1e-6)
        assert motor.residual(made.beta) < 5e-4 * motor.norm


def test_the_delays_are_found(phantom, log):
    found = find_delays(phantom, [log], treated((0, 0, 0)))
    np.testing.assert_allclose(1e3 * found.seconds, LATE, atol=0.005 * FINE)


def test_delays_that_are_alike_need_no_columns_of_their_own(phantom, log):
    assert own_columns(phantom, haptid.treat(log, treated((14, 14, 14)))) == ()
    assert [own.term.name for own in own_columns(phantom, haptid.treat(log, treated(LATE)))] == ["FC1", "FC3"]


@pytest.mark.parametrize("kind", DRY)
@pytest.mark.parametrize("width", [0.0, 0.3])
def test_a_column_in_python_is_the_one_of_the_core(kind, width):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    k = next(k for k, term in enumerate(model.terms) if term.kind == "coulomb")
    settings = (0.5, 1.5, width) if kind == "stribeck" else (width, 0.0, 0.0)
    term = replace(model.terms[k], kind=kind, settings=settings)
    model = model.with_terms([*model.terms[:k], term, *model.terms[k + 1 :]])
    v = np.random.default_rng(0).normal(size=(3, 40))
    v[:, 0] = 0.0
    column = 10 * len(model.device.joints) + k
    made = model.mechanism.regressor(v, v, v, np.zeros((0, 40)), [column], model.loops(v, v))[:, 0]
    row = int(np.flatnonzero(term.weights)[0])
    np.testing.assert_allclose(term.weights[row] * term.sliding(model.speed(term, v, v)), made[row], atol=1e-12)


def test_columns_at_once_are_each_of_its_own_term():
    term = haptid.DynamicModel(haptid.read_device("phantom_premium_15")).terms[0]
    constants = [(kind, width) for kind in DRY for width in (0.0, 0.3)]
    terms = [
        replace(term, kind=kind, settings=(0.5, 1.5, width) if kind == "stribeck" else (width, 0.0, 0.0))
        for kind, width in constants
    ]
    v = np.random.default_rng(0).normal(size=(len(terms), 40))
    v[:, 0] = 0.0
    np.testing.assert_array_equal(Sliding(terms)(v), [term.sliding(x) for term, x in zip(terms, v, strict=True)])
    assert Sliding(())(v[:0]).shape == (0, 40)
