"""Figures at the handle: their intervals, what is not determined, what is left out, and misuse."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.dynamics.workspace import workspace
from haptid.end_effector.characterisation import GivenParameters, apparent_mass, characterise, line, sweep
from haptid.end_effector.characterisation.plots import SweepCurve, plot_map, plot_sweeps
from mechanisms import draw
from motions import motion
from random_devices import as_device, parameters
from true_parameters import true_parameters


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def estimate(phantom):
    beta = phantom.base.of(true_parameters(phantom))
    made = motion(phantom, beta, seconds=10.0, noise=0.05)
    return haptid.estimate(haptid.observe(phantom, made), haptid.WLS())


POSES = np.array([[0.0, 0.3, -0.2], [0.2, 0.5, 0.1], [0.3, 0.1, 0.4]])


@pytest.fixture(scope="module")
def doubtful(phantom):
    """Parameters with a covariance, and what draws of it are at the handle."""
    beta = phantom.base.of(true_parameters(phantom))
    rng = np.random.default_rng(0)
    L = 0.01 * np.abs(beta)[:, None] * rng.normal(size=(len(beta),) * 2) / np.sqrt(len(beta))
    drawn = beta + rng.normal(size=(400, len(beta))) @ L.T
    draws = [characterise(GivenParameters(phantom, b), POSES) for b in drawn]
    return GivenParameters(phantom, beta, L @ L.T), draws


FIGURES = {
    "masses": lambda c: c.apparent_mass,
    "isotropy": lambda c: c.isotropy,
    "mass along": lambda c: c.mass_along([1.0, 0.2, 0.3]),
    "viscous": lambda c: c.viscous_friction,
    "coulomb": lambda c: c.coulomb_friction([1.0, 0.2, 0.3]),
    "weight": lambda c: c.weight,
    "back-drive": lambda c: c.backdrive_force([0.0, 1.0, 0.3]),
    "neglected": lambda c: c.neglected_force(0.5),
    "force along": lambda c: c.force_along([0.3, 1.0, -0.4], {"1": 0.5, "2": 0.4, "3": 0.3}),
    "greatest force": lambda c: c.greatest_force({"1": 0.5, "2": 0.4, "3": 0.3})[0],
}


@pytest.mark.parametrize("name", FIGURES)
def test_deviations_are_those_of_drawn_parameters(name, doubtful):
    identified, draws = doubtful
    figure, count = FIGURES[name](characterise(identified, POSES)), 60 if name == "neglected" else len(draws)
    values = np.array([FIGURES[name](drawn).values for drawn in draws[:count]])
    spread = values.std(axis=0)
    # A deviation of so many draws is itself known to 1 / sqrt(2 count).
    close = 4.5 / np.sqrt(2 * count) + 0.03
    # Components that vanish by symmetry have rounding for a deviation.
    np.testing.assert_allclose(figure.se, spread, rtol=close, atol=1e-4 * spread.max())
    np.testing.assert_allclose(
        figure.values, values.mean(axis=0), atol=6 * spread.max() / np.sqrt(count) + 0.02 * spread.max()
    )


def test_intervals_of_an_estimate_hold_the_truth(estimate, phantom):
    found = characterise(estimate, POSES)
    true = characterise(GivenParameters(phantom, phantom.base.of(true_parameters(phantom))), POSES)
    for name in ("masses", "weight", "back-drive"):
        got, wanted = FIGURES[name](found), FIGURES[name](true).values
        assert got.dof < 100
        low, high = np.moveaxis(got.conf_int(), -1, 0)
        margin = 1e-9
        assert ((low - margin <= wanted) & (wanted <= high + margin)).mean() > 0.8, name


def test_an_estimate_that_depends_on_one_block_has_infinite_deviations(estimate):
    single_block = replace(estimate, quantities=replace(estimate.quantities, unbounded=(0,)))
    found = characterise(single_block, POSES)
    assert np.isinf(found.apparent_mass.se).all()
    assert "unbounded" in found.summary()


def test_without_covariance_there_are_no_intervals(phantom):
    found = characterise(GivenParameters(phantom, np.ones(len(phantom.base))), POSES)
    assert found.weight.se is None
    assert found.weight.conf_int() is None


def test_singular_poses_are_reported_and_unknown(phantom):
    """At the PHANToM's full reach the arm and forearm are in line."""
    beta = phantom.base.of(true_parameters(phantom))
    qa = line([0.0, 0.2, 0.2], [0.0, 0.2, 0.2 + np.pi / 2], 101)
    found = characterise(GivenParameters(phantom, beta), qa)
    out = ~found.handle.usable
    assert 0 < out.sum() < 101
    assert out[-1]
    for figure in (found.apparent_mass, found.weight, found.viscous_friction, found.neglected_force(0.3)):
        assert np.isnan(figure.values[out]).all()
        assert np.isfinite(figure.values[~out]).all()
    assert f"{out.sum()} of 101 poses" in found.summary()
    np.testing.assert_array_equal(found.masses.usable, found.handle.usable)


def test_a_mass_matrix_that_is_not_positive_gives_no_mass(phantom):
    beta = np.array(phantom.base.of(true_parameters(phantom)))
    beta[phantom.base.names.index("ZZdfR")] = -1e-3
    found = characterise(GivenParameters(phantom, beta), POSES)
    assert not found.masses.definite.any()
    assert np.isnan(found.apparent_mass.values).all()
    assert "not positive definite" in found.summary()


def test_a_workspace_is_characterised_on_its_grid(phantom):
    identified = GivenParameters(phantom, phantom.base.of(true_parameters(phantom)))
    found = characterise(identified, workspace(phantom), worst_condition=10.0)
    assert len(found.handle) > 1000
    assert "left out" in found.summary()
    with pytest.raises(errors.ModelMismatchError) as raised:
        characterise(identified, workspace(haptid.DynamicModel(haptid.read_device("cea_medical_branch"))))
    assert raised.value.where[0] == phantom.device.name


def test_spare_joints_leave_friction_open_but_masses_known():
    mechanism = draw(5, joints=5, closed=False, chain=True)
    model = as_device(mechanism)
    qa = np.random.default_rng(0).normal(size=(5, 4))
    found = characterise(GivenParameters(model, model.base.of(parameters(mechanism, model))), qa, worst_condition=1e6)
    assert np.isfinite(found.apparent_mass.values).all()
    with pytest.raises(errors.RedundancyError) as raised:
        _ = found.weight
    assert (raised.value.found, raised.value.limit) == (5, 3)
    assert "not determined" in found.summary()
    limits = {motor.name: 5.0 for motor in model.device.motors}
    assert (found.greatest_force(limits)[0].values >= 0).all()


def test_chosen_rows(phantom):
    identified = GivenParameters(phantom, phantom.base.of(true_parameters(phantom)))
    all_rows, across = apparent_mass(identified, POSES), apparent_mass(identified, POSES, rows=(0,))
    assert across.mass.values.shape == (3, 1)
    # With y and z free to yield, x feels no more than the largest mass and no less than the smallest.
    assert (across.mass.values[:, 0] <= all_rows.mass.values[:, 0] * (1 + 1e-12)).all()
    assert (across.mass.values[:, 0] >= all_rows.mass.values[:, 2] * (1 - 1e-12)).all()


def test_settings_that_mean_nothing(phantom):
    identified = GivenParameters(phantom, np.ones(len(phantom.base)))
    for wrong in (
        {"rows": ()},
        {"rows": (0, 0)},
        {"rows": (6,)},
        {"worst_condition": 1.0},
        {"worst_condition": np.nan},
    ):
        with pytest.raises(errors.SettingError) as raised:
            characterise(identified, POSES, **wrong)
        assert raised.value.where == next(iter(wrong))
    with pytest.raises(errors.SettingError) as raised:
        apparent_mass(identified, np.full((3, 2), np.nan))
    assert raised.value.where == "qa"
    found = characterise(identified, POSES)
    with pytest.raises(errors.SettingError) as raised:
        found.mass_along([0.0, 0.0, 0.0])
    assert raised.value.where == "direction"
    with pytest.raises(errors.ShapeError):
        found.mass_along([1.0, 0.0])
    with pytest.raises(errors.ShapeError):
        characterise(identified, POSES[:2])
    for limits, kind, motor in (
        (None, errors.IncompleteDeviceError, "1"),
        ({"1": 1, "2": 1, "3": -1}, errors.IncompleteDeviceError, "3"),
        ({"1": 1, "2": 1, "3": 1, "4": 1}, errors.UnknownNameError, "4"),
    ):
        with pytest.raises(kind) as raised:
            found.greatest_force(limits)
        assert raised.value.where == motor
    with pytest.raises(errors.ShapeError):
        found.stiffness([1.0, 2.0])


def test_a_handle_on_the_base_moves_nothing(phantom):
    handle = replace(phantom.device.handle, link=-1)
    fixed = haptid.DynamicModel(replace(phantom.device, handle=handle))
    with pytest.raises(errors.SettingError) as raised:
        apparent_mass(GivenParameters(fixed, np.ones(len(fixed.base))), POSES)
    assert raised.value.where == "handle.link"
    bare = haptid.DynamicModel(replace(phantom.device, handle=None))
    with pytest.raises(errors.IncompleteDeviceError):
        apparent_mass(GivenParameters(bare, np.ones(len(phantom.base))), POSES)


def test_a_table_of_parameters_as_papers_print_it(phantom):
    identified = GivenParameters.of(phantom, {"FV1": 2.0}, {"FV1": 0.5})
    k = phantom.base.names.index("FV1")
    assert identified.beta[k] == 2.0
    assert identified.covariance[k, k] == 0.25
    assert np.count_nonzero(identified.beta) == np.count_nonzero(identified.covariance) == 1
    with pytest.raises(errors.UnknownNameError) as raised:
        GivenParameters.of(phantom, {"FV9": 2.0})
    assert raised.value.where == "FV9"


def test_sweeps_and_lines():
    np.testing.assert_array_equal(sweep([1.0, 2.0], 1, [3.0, 4.0]), [[1, 1], [3, 4]])
    np.testing.assert_array_equal(line([0.0, 1.0], [1.0, 1.0], 3), [[0, 0.5, 1], [1, 1, 1]])


@pytest.mark.usefixtures("full_pictures")
def test_sweeps_and_maps_are_drawn(doubtful, phantom, tmp_path):
    identified, _ = doubtful
    x = np.linspace(0.0, 0.8, 9)
    masses = apparent_mass(identified, sweep([0.0, 0.0, 0.3], 1, x)).mass
    bare = apparent_mass(GivenParameters(phantom, identified.beta), sweep([0.0, 0.0, 0.3], 1, x)).mass
    drawn = SweepCurve("be, rad", x, {"with intervals": masses, "without": bare})
    plot_sweeps([drawn, drawn], "mass, kg", tmp_path / "sweeps.png")
    value = np.outer(np.linspace(1, 2, 5), masses.values[:, 0])
    value[0, 0] = np.nan
    for name, shown in (("map", value), ("empty", np.full_like(value, np.nan))):
        plot_map(x, np.arange(5.0), shown, ("x", "y", "kg"), tmp_path / f"{name}.png")
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())
    with pytest.raises(errors.ShapeError):
        SweepCurve("be, rad", x[:-1], {"": masses})
    with pytest.raises(errors.ShapeError):
        plot_map(x, x, value, ("x", "y", "kg"), tmp_path / "wrong.png")
