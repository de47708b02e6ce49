"""Constants in which the torque is nonlinear are recovered with all other parameters, inside their intervals."""

import numpy as np
import pytest
from scipy import optimize, stats

import haptid
from haptid import errors
from haptid.estimation.nonlinear import variable_projection
from motions import motion

DEVICE = """
schema = 1
name = "two links with friction that fades"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
[[terms]]
kind = "stribeck"
joints = "all"
velocity = { start = 0.5, low = 0.02, high = 5 }
"""
TRUTH = {"FS1.velocity": 0.2, "FS2.velocity": 0.35}
BETA = {"FV": 0.4, "FC": 0.5, "FS": 0.8}
DT = 2e-3


def device_of(folder, text=DEVICE):
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


def motion_of(model, constants, seed, noise=0.03, seconds=20.0):
    """A motion of a device with these constants, with white noise of a share of the torque; and the true parameters."""
    beta = np.array([BETA.get(name[:2], 0.3) for name in model.base.names])
    made = motion(model.at_constants(constants), beta, seconds=seconds, dt=DT, seed=seed, noise=noise)
    return made, beta


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return device_of(tmp_path_factory.mktemp("device"))


def test_a_device_file_says_where_to_search(model):
    assert [constant.name for _, constant in model.device.searched] == ["velocity", "velocity"]
    assert [model.terms[k].constant("velocity") for k, _ in model.device.searched] == [0.5, 0.5]
    assert [(c.low, c.high, c.unit) for _, c in model.device.searched] == [(0.02, 5.0, "rad/s")] * 2
    changed = model.at_constants((0.1, 0.2))
    assert [changed.terms[k].constant("velocity") for k, _ in changed.device.searched] == [0.1, 0.2]


def test_without_noise_constants_are_exact(model):
    moved, beta = motion_of(model, tuple(TRUTH.values()), 1, noise=0.0)
    found = variable_projection(model, [moved], haptid.OLS())
    for name, value in TRUTH.items():
        assert found[name].value == pytest.approx(value, rel=1e-6)
    estimate = haptid.estimate(haptid.observe(found.model, moved), haptid.OLS(), found.intervals)
    np.testing.assert_allclose(estimate.beta, beta, rtol=1e-5)


def test_truth_is_inside_the_intervals(model):
    inside, wider = [], []
    for seed in range(10):
        moved, beta = motion_of(model, tuple(TRUTH.values()), seed)
        found = variable_projection(model, [moved])
        observation = haptid.observe(found.model, moved)
        joint = haptid.estimate(observation, haptid.WLS(), found.intervals)
        held = haptid.estimate(observation, haptid.WLS())
        low, high = joint.conf_int().T
        inside += ((low < beta) & (beta < high)).tolist()
        inside += [found[n].conf_int()[0] < value < found[n].conf_int()[1] for n, value in TRUTH.items()]
        wider.append(joint["FS1"].se / held["FS1"].se)
    assert np.mean(inside) >= 0.9
    assert np.median(wider) > 1.0  # what is not known of the constants is in the parameters' deviations


def test_intervals_of_constants_at_other_levels(model):
    """A noise this small leaves the profile near a parabola: widths are those of Student's t."""
    moved, _ = motion_of(model, tuple(TRUTH.values()), 3, noise=0.01)
    found = variable_projection(model, [moved])
    for constant in found.constants:
        assert constant.conf_int() == constant.conf_int(0.95)
        widths = [float(np.diff(np.log(constant.conf_int(level)))[0]) for level in (0.8, 0.95, 0.99)]
        t = stats.t.ppf([0.9, 0.975, 0.995], constant.profile.dof)
        np.testing.assert_allclose(widths, widths[1] * t / t[1], rtol=0.02)
        with pytest.raises(errors.SettingError) as raised:
            constant.conf_int(1 - 1e-12)
        assert raised.value.where == "level"


def test_least_squares_in_everything_finds_the_same(model):
    moved, beta = motion_of(model, tuple(TRUTH.values()), 3)

    def residual(x):
        trial = model.at_constants(np.exp(x[:2]))
        qd, qdd = moved.rates
        torque = haptid.inverse_dynamics(trial, x[2:], moved.q.T, qd.T, qdd.T)
        return (moved.tau - torque.T).ravel()

    start = np.concatenate([np.log([0.3, 0.3]), beta * 1.2])
    oracle = optimize.least_squares(residual, start, xtol=1e-12, ftol=1e-14)
    found = variable_projection(model, [moved], haptid.OLS())
    np.testing.assert_allclose([c.value for c in found.constants], np.exp(oracle.x[:2]), rtol=2e-3)


def test_constants_of_an_own_expression(tmp_path):
    text = (
        DEVICE.split('[[terms]]\nkind = "stribeck"')[0]
        + """
[[terms]]
kind = "custom"
joints = ["1"]
name = "COG1"
unit = "N m"
expression = "sin(n*q_1)"
constants = { n = { start = 6, low = 3, high = 12 } }
"""
    )
    model = device_of(tmp_path, text)
    moved, _ = motion_of(model, (7.0,), 3, noise=0.01)
    found = variable_projection(model, [moved])
    assert found["COG1.n"].value == pytest.approx(7.0, rel=1e-2)
    low, high = found["COG1.n"].conf_int()
    assert low < 7.0 < high


def test_a_log_that_does_not_bound_a_constant_says_so(model):
    moved, _ = motion_of(model, tuple(TRUTH.values()), 4, noise=3.0, seconds=8.0)
    found = variable_projection(model, [moved])
    assert any("poorly identifiable" in note or "end of its range" in note for note in found.notes)


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("start = 0.5, low = 0.02, high = 5", "start = 9, low = 0.02, high = 5", errors.DeviceFileError),
        ("start = 0.5, low = 0.02, high = 5", "start = 0.5, low = -1, high = 5", errors.DeviceFileError),
        ("start = 0.5, low = 0.02, high = 5", "start = -0.5", errors.DeviceFileError),
        ("start = 0.5, low = 0.02", "start = 0.5, lowest = 0.02", errors.DeviceFileError),
        ("{ start = 0.5, low = 0.02, high = 5 }", "true", errors.DeviceFileError),
    ],
)
def test_a_range_out_of_range_is_rejected(tmp_path, old, new, error):
    with pytest.raises(error):
        device_of(tmp_path, DEVICE.replace(old, new))


def test_what_cannot_be_searched_is_rejected(tmp_path, model):
    moved, _ = motion_of(model, tuple(TRUTH.values()), 5, seconds=4.0)
    known = device_of(tmp_path, DEVICE.replace("{ start = 0.5, low = 0.02, high = 5 }", "0.5"))
    with pytest.raises(errors.EstimationError, match="no term"):
        variable_projection(known, [moved])
    equal = device_of(tmp_path, DEVICE + '[[symmetry]]\nreason = "alike"\nequal = [["FS1", "FS2"]]\n')
    with pytest.raises(errors.EstimationError, match="one parameter with"):
        variable_projection(equal, [moved])
