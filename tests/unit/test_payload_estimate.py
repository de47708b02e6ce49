"""What was added to a link comes back from two estimates, within its own interval, and no more than torques tell."""

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.inference.payload_estimate import estimate_payload
from motions import motion


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def chi(model):
    """Of the measured bodies, with some friction, (p,)."""
    friction = {"FV": 6e-4, "FC": 0.02}
    kinds = model.device.parameters.kinds
    return np.array(
        [friction.get(kind, x) for kind, x in zip(kinds, np.nan_to_num(model.device.chi_prior), strict=True)]
    )


def estimated(model, chi, seed):
    made = motion(model, model.base.of(chi), seconds=12.0, seed=seed, noise=0.02, phi=0.9)
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


def point(model, link, mass, x):
    """A point mass on a link's own x axis, as standard parameters, (p,)."""
    values = {"M": mass, "MX": mass * x, "YY": mass * x**2, "ZZ": mass * x**2}
    found = np.zeros(len(model.device.parameters))
    for kind, value in values.items():
        found[model.device.parameters.index[kind + link]] = value
    return found


@pytest.fixture(scope="module")
def before(model, chi):
    return estimated(model, chi, seed=1)


def test_a_tool_at_the_handle_is_found(model, chi, before):
    tool = point(model, "a", 0.05, 0.17)
    found = estimate_payload(before, estimated(model, chi + tool, seed=2), "a")
    assert found.names == ("XXa", "YYa", "ZZa", "MXa", "Ma")
    truth = np.array([tool[model.device.parameters.index[name]] for name in found.names])
    low, high = found.conf_int().T
    assert ((low <= truth) & (truth <= high)).all()
    assert found.value[found.names.index("Ma")] == pytest.approx(0.05, rel=0.01)
    assert found.value[found.names.index("MXa")] == pytest.approx(0.0085, rel=0.01)
    assert "Ma: 0.0" in found.summary()


def test_friction_that_changed_meanwhile_does_no_harm(model, chi, before):
    other = chi + point(model, "a", 0.05, 0.17)
    for k, kind in enumerate(model.device.parameters.kinds):
        other[k] *= 1.5 if kind in ("FV", "FC") else 1.0
    found = estimate_payload(before, estimated(model, other, seed=3), "a")
    assert found.value[found.names.index("Ma")] == pytest.approx(0.05, rel=0.01)


def test_nothing_added_is_nothing_found(model, chi, before):
    found = estimate_payload(before, estimated(model, chi, seed=4), "a")
    low, high = found.conf_int().T
    assert ((low <= 0) & (high >= 0)).all()


def test_what_torques_do_not_tell_has_no_value(model, chi, before):
    """Its mass alone, since the link turns about a point that stays where it is."""
    found = estimate_payload(before, estimated(model, chi + point(model, "be", 0.1, -0.05), seed=5), "be")
    unknown = found.names.index("Mbe")
    assert np.isnan(found.value[unknown])
    assert np.isnan(found.se[unknown])
    assert "Mbe: not identifiable" in found.summary()
    assert found.value[found.names.index("MXbe")] == pytest.approx(-0.005, rel=0.02)


def test_a_link_that_is_not_there_is_an_error(before):
    with pytest.raises(errors.UnknownNameError) as raised:
        estimate_payload(before, before, "tip")
    assert (raised.value.where, raised.value.found) == ("link", "tip")


def test_estimates_of_two_devices_are_an_error(before):
    other = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    after = haptid.estimate(haptid.observe(other, motion(other, before.beta, seconds=2.0)), haptid.WLS())
    with pytest.raises(errors.ModelMismatchError):
        estimate_payload(before, after, "a")


def test_one_log_twice_is_an_error(before):
    with pytest.raises(errors.SharedRowsError):
        estimate_payload(before, before, "a")
