"""Targets: linear maps of an estimate, refused where no motion shows them, in SI and per unit of command."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import haptid
from haptid import errors
from haptid.device.expressions import combination
from haptid.device.parameters import Combination
from haptid.device.toml.errors_at import Place
from haptid.estimation.methods.constrained import PhysicallyConsistent
from haptid.inference.targets import target_map, targets
from mechanisms import mechanisms
from motions import motion, truth
from random_devices import as_device
from sampling import FAR

HERE = Place("arm.toml", "targets.a")
# Two pendulums one on the other, their motors in volts, of different gains.
ARM = """
schema = 1
name = "two links"
gravity = [0.0, -9.81, 0.0]
[lengths]
L = 0.3
[[joints]]
name = "1"
[[joints]]
name = "2"
d = "L"
[[motors]]
name = "1"
gear_ratio = -20
torque_constant = 0.05
command_unit = "V"
[[motors]]
name = "2"
gear_ratio = 10
torque_constant = 0.05
command_unit = "V"
[[terms]]
kind = "viscous"
motors = "all"
prefix = "FV"
"""
FILE = (
    ARM
    + """
[targets]
inertia = "ZZ1 + L*L*M2"
tip = "ZZ2"
weight = "g*(MX1 + L*M2)"
moment = "MX2"
damping = "FV2"
share = { expression = "0.5*FV1", unit = "half a unit" }
"""
)
PRIOR = "\n[prior]\nZZ2 = 0.01\nZZ1 = { value = 0.02, std = 0.003 }\nM2 = { value = 0.5, std = 0.1 }\n"


def written(tmp_path, text):
    (tmp_path / "arm.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(tmp_path / "arm.toml"))


def with_targets(model, rows):
    names = [f"t{k}" for k in range(len(rows))]
    wanted = tuple(Combination(n, n, "1", row) for n, row in zip(names, rows, strict=True))
    return haptid.DynamicModel(replace(model.device, targets=wanted), model.terms)


def fitted(model, seconds=10.0, **settings):
    made = motion(model, truth(model), seconds=seconds, noise=0.1, phi=0.9, **settings)
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


@pytest.fixture(scope="module")
def phantom():
    return fitted(haptid.DynamicModel(haptid.read_device("phantom_premium_15")))


@given(st.lists(st.floats(-9, 9).map(lambda x: round(x, 3)), min_size=3, max_size=3))
def test_combinations_are_linear_in_their_parameters(factors):
    a, b, c = factors
    text = f"({a!r})*MX1 - (M2*L*{b!r} + 2*M2)/4 + g*({c!r}*M3)"
    found = combination(text, ["MX1", "M2", "M3"], {"L": 0.5, "g": 9.81}, HERE)
    wanted = {"MX1": a, "M2": -(0.5 * b + 2) / 4, "M3": 9.81 * c}
    for name, factor in wanted.items():
        assert found.get(name, 0.0) == pytest.approx(factor, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("ZZ1 + L*L*M2", "kg m^2"),
        ("MX1 + L*M2", "kg m"),
        ("g*(MX1 + L*M2)", "N m"),
        ("g*M2/2", "N"),
        ("M2*L*L*L", "kg m^3"),
        ("FV1 - 2*FV2", "N m s/rad"),
        ("FV1/L", "kg m s^-1 rad^-1"),
    ],
)
def test_units_follow_from_the_expression(tmp_path, text, unit):
    model = written(tmp_path, ARM + f'[targets]\na = "{text}"')
    assert model.device.targets[0].unit == unit


@pytest.mark.parametrize("text", ["MX1 + 0.3*M2", "(L + 0.1)*M2", "g*MX1 + L*M2"])
def test_a_unit_that_cannot_be_inferred_must_be_given(tmp_path, text):
    with pytest.raises(errors.DeviceFileError, match="common unit"):
        written(tmp_path, ARM + f'[targets]\na = "{text}"')
    model = written(tmp_path, ARM + f'[targets]\na = {{ expression = "{text}", unit = "kg m" }}')
    assert model.device.targets[0].unit == "kg m"


def test_a_parameter_declared_equal_to_another_stands_for_both(tmp_path):
    equal = '[[symmetry]]\nreason = "one drawing"\nequal = [["MX1", "MX2"]]\nzero = ["MY1"]\n'
    model = written(tmp_path, ARM + equal + '[targets]\na = "MX1 + MX2 + MY1"')
    assert model.device.targets[0].row[model.device.parameters.index["MX1"]] == 2.0
    assert np.count_nonzero(model.device.targets[0].row) == 1


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(mechanisms(most=4), st.integers(0, 2**32 - 1))
def test_what_base_parameters_combine_to_is_identifiable_and_nothing_else(mechanism, seed):
    model, rng = as_device(mechanism), np.random.default_rng(seed)
    base = model.base
    wanted = rng.normal(size=(3, len(base)))
    rows = wanted @ base.regrouping
    np.testing.assert_allclose(target_map(with_targets(model, rows)), wanted, atol=1e-12)
    hidden = [k for k in range(len(base.standard)) if k not in base.independent_columns]
    if hidden:
        rows[1, rng.choice(hidden)] += 1e-3
        with pytest.raises(errors.IdentifiabilityError, match="target t1 is not identifiable"):
            target_map(with_targets(model, rows))


def test_a_target_that_no_motion_shows_is_named_with_the_part_that_is_hidden(phantom):
    index, size = phantom.model.device.parameters.index, len(phantom.model.device.parameters)
    row = np.zeros(size)
    row[[index["MXbe"], index["MXc"]]] = 1.0
    with pytest.raises(errors.IdentifiabilityError) as caught:
        target_map(with_targets(phantom.model, [row]))
    sentence = str(caught.value)
    assert "no torque of this device depends on -0.215 Ma by itself" in sentence
    assert "What it shows is MXbe + 0.215 Ma + MXc." in sentence
    row = np.zeros(size)
    row[index["Ma"]] = 1.0
    with pytest.raises(errors.IdentifiabilityError, match=r"identifiable only within .*; ZZbeR = ZZbe \+ 0\.046225"):
        target_map(with_targets(phantom.model, [row]))
    row = np.zeros(size)
    row[index["Mbe"]] = 1.0
    with pytest.raises(errors.IdentifiabilityError, match=r"depends on Mbe by itself\. Write") as caught:
        target_map(with_targets(phantom.model, [row]))
    assert caught.value.where == "t0"


def test_a_device_without_targets_names_the_table_to_write():
    with pytest.raises(errors.IncompleteDeviceError):
        target_map(haptid.DynamicModel(haptid.read_device("emps")))


def test_value_and_covariance_are_those_of_the_linear_map(phantom):
    found = targets(phantom)
    C = target_map(phantom.model)
    np.testing.assert_allclose(found.value, C @ phantom.beta, rtol=1e-14)
    np.testing.assert_allclose(found.covariance, C @ phantom.covariance @ C.T, rtol=1e-12)
    np.testing.assert_allclose(found.classical_covariance, C @ phantom.classical_covariance @ C.T, rtol=1e-12)
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)
    assert np.abs(found.correlation).max() <= 1 + 1e-12
    draws = np.random.default_rng(0).multivariate_normal(phantom.beta, phantom.covariance, 20_000)
    np.testing.assert_allclose(np.corrcoef((draws @ C.T).T), found.correlation, atol=FAR / np.sqrt(20_000))


def test_a_base_parameter_as_target_has_its_interval_and_scale_does_not_matter(phantom):
    rows = [factor * row for row in phantom.base.regrouping for factor in (1.0, -1e3)]
    found = targets(_again(phantom, rows))
    np.testing.assert_allclose(found.value[::2], phantom.beta, rtol=1e-12)
    np.testing.assert_allclose(found.conf_int()[::2], phantom.conf_int(), rtol=1e-9)
    np.testing.assert_allclose(found.dof[1::2], found.dof[::2], rtol=1e-9)
    np.testing.assert_allclose(found.se[1::2], 1e3 * found.se[::2], rtol=1e-9)


def _again(made, rows):
    """The estimate as if its device had those targets."""
    model = with_targets(made.model, rows)
    return replace(made, observation=replace(made.observation, model=model))


def test_targets_are_frozen_and_found_by_name(phantom):
    found = targets(phantom)
    for array in (found.value, found.covariance, found.se, found.conf_int(), found.correlation, found.C):
        assert not array.flags.writeable
    assert len(found) == 14
    assert found["pi_7"].unit == "N m"
    assert found["pi_7"].grouping == "g*(MXbe + MXc + L1*Ma)"
    assert found["pi_7"].prior[0] == pytest.approx(-0.016298, abs=1e-6)
    assert found["pi_9"].prior is None


def test_prior_of_a_target_has_a_deviation_where_all_its_members_have_one(tmp_path):
    found = targets(fitted(written(tmp_path, FILE + PRIOR)))
    assert found["inertia"].prior == pytest.approx((0.02 + 0.09 * 0.5, np.hypot(0.003, 0.09 * 0.1)))
    assert found["tip"].prior == (0.01, None)
    assert found["weight"].prior is None


def test_command_view_divides_by_torque_per_command(phantom):
    found = targets(phantom)
    command = found.in_command()
    assert command.names == found.names
    assert not command.notes
    np.testing.assert_allclose(command.value, 2.73 * found.value, rtol=1e-12)
    np.testing.assert_allclose(command.covariance, 2.73**2 * found.covariance, rtol=1e-12)
    np.testing.assert_allclose(command.conf_int(), 2.73 * found.conf_int(), rtol=1e-12)
    np.testing.assert_allclose(command.correlation, found.correlation, rtol=1e-9)
    assert command["pi_8"].unit == "N m of command"
    assert command["pi_8"].prior[0] == pytest.approx(2.73 * found["pi_8"].prior[0])


def test_targets_that_motors_of_different_gains_show_have_no_unit_of_command(tmp_path):
    found = targets(fitted(written(tmp_path, FILE)))
    command = found.in_command()
    # ZZ1 + L L M2 and the weight are in row 1 alone; ZZ2 and MX2 are in both rows.
    assert command.names == ("inertia", "weight", "damping", "share")
    np.testing.assert_allclose(command.value, found.value[[0, 2, 4, 5]] * [-1.0, -1.0, 2.0, -1.0], rtol=1e-12)
    assert command.conf_int()[0, 0] < command.value[0] < command.conf_int()[0, 1]
    assert command.units == ("kg m^2 V/(N m)", "V", "N m s/rad V/(N m)", "half a unit V/(N m)")
    assert command.notes[-1].endswith("coupled motors: tip, moment.")
    assert "tip, moment" in command.summary()


def test_a_target_that_one_block_alone_determines_has_an_infinite_interval(phantom):
    single_block = replace(targets(phantom), single_block=(3,))
    assert np.isinf(single_block.se[3])
    assert np.isinf(single_block.conf_int()[3]).all()
    assert np.isfinite(np.delete(single_block.se, 3)).all()
    assert single_block.in_command().single_block == (3,)


def test_targets_of_a_constrained_estimate_take_the_free_fits_interval_widened_to_the_value():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    beta[model.base.names.index("FV1")] = -2e-3  # no damping can be below zero
    observation = haptid.observe(model, motion(model, beta, noise=0.05))
    free, held = (targets(haptid.estimate(observation, m)) for m in (haptid.WLS(), PhysicallyConsistent()))
    assert free["pi_9"].value < 0
    assert held["pi_9"].value == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(held.free, free.value)
    np.testing.assert_array_equal(held.covariance, free.covariance)
    wide = np.column_stack(
        [np.minimum(free.conf_int()[:, 0], held.value), np.maximum(free.conf_int()[:, 1], held.value)]
    )
    np.testing.assert_allclose(held.conf_int(), wide)


def test_tables_show_every_target(phantom):
    found = targets(phantom)
    lines = found.summary().splitlines()
    assert len(lines) == 15
    assert lines[7].split()[0] == "pi_7"


def test_gravity_of_another_mounting_changes_gravity_alone(phantom):
    model = phantom.model
    other = model.with_gravity([0.0, 9.81, 0.0])
    assert other.device.targets == model.device.targets
    assert model.device.gravity[1] == -9.81
    zero, at = np.zeros((3, 5)), np.random.default_rng(0).uniform(-1, 1, (3, 5))
    upright, upside_down = (haptid.inverse_dynamics(d, phantom.beta, at, zero, zero) for d in (model, other))
    assert np.abs(upright).max() > 1e-3
    np.testing.assert_allclose(upside_down, -upright, atol=1e-15)
    with pytest.raises(errors.ShapeError):
        model.with_gravity([9.81])
