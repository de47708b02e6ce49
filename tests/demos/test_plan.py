"""Demonstrations are data: plans can be read, tables are those published, experiments differ by the mounting alone."""

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.demos import demo_names, read_demo
from haptid.demos.phantom_configurations.fits import without_terms
from haptid.demos.phantom_configurations.results import published_beta
from haptid.demos.phantom_configurations.tables import layout
from haptid.demos.recordings import as_in_file
from haptid.dynamics.inverse import inverse_dynamics
from haptid.experiment.bench import read_experiment
from haptid.inference.targets import target_map, targets
from motions import motion, multisine, truth


@pytest.fixture(scope="module")
def demo():
    return read_demo("phantom")


@pytest.fixture(scope="module")
def model(demo):
    return haptid.DynamicModel(haptid.read_device(demo.device))


def test_the_command_lists_demos():
    done = CliRunner().invoke(app, ["demo"])
    assert done.exit_code == 0
    assert [line.split()[0] for line in done.stdout.splitlines() if line.strip()] == list(demo_names())


def test_a_demo_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(errors.UnknownNameError, match='Did you mean "phantom"') as raised:
        read_demo("phantm")
    assert raised.value.found == "phantm"
    done = CliRunner().invoke(app, ["demo", "phantm", "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_every_file_of_a_plan_is_there_and_its_names_fit(demo, model, tmp_path):
    keys = set(demo.mountings)
    for key in (*demo.mountings, demo.hand.experiment, demo.tool.experiment):
        setup = read_experiment(demo.write_experiment(key, tmp_path)).setup(model)
        assert setup.model.device.name == model.device.name
    assert demo.parameters.rows == tuple(target.name for target in model.device.targets)
    assert demo.errors.rows == model.device.row_names
    assert set(demo.errors.columns) == keys == set(demo.parameters.columns) - {"bodies"}
    assert {demo.hand.mounting, demo.tool.mounting} <= keys
    assert {key for pair in demo.comparisons for key in (pair.first, pair.second)} <= keys
    assert demo.stretch.fit[1] == demo.stretch.unseen[0]


def test_experiments_differ_by_the_mounting_alone(demo, tmp_path):
    def table_of(key):
        return read_experiment(demo.write_experiment(key, tmp_path)).table.model_dump()

    tables = [table_of(key) for key in demo.mountings]
    for table in tables:
        assert {key for key in table if table[key] != tables[0][key]} <= {"name", "seed", "gravity", "weights"}
    tool = table_of(demo.tool.experiment)
    assert {key for key in tool if tool[key] != tables[0][key]} == {"name", "seed", "payload"}


def test_claims_name_tests_that_are_there(demo, request):
    text = (request.config.rootpath / "tests/golden/test_phantom_paper_errors.py").read_text(encoding="utf-8")
    assert [claim.name for claim in demo.claims] == [f"T{k}" for k in range(1, 11)]
    for claim in demo.claims:
        assert f"def {claim.check}(" in text


def test_without_terms_the_links_are_the_same(model):
    """The torque of the links is the same, and base parameters and targets are those that are no friction."""
    bare = without_terms(model)
    beta = truth(model)
    q, qd, qdd = multisine(3, 0.5, 1e-2, seed=1)
    of_links = np.where([name[:2] in ("FV", "FC") for name in model.base.names], 0.0, beta)
    assert bare.base.names == model.base.names[:8]
    wanted = inverse_dynamics(model, of_links, q, qd, qdd)
    np.testing.assert_allclose(inverse_dynamics(bare, beta[:8], q, qd, qdd), wanted, atol=1e-14)
    np.testing.assert_allclose(target_map(bare), target_map(model)[:8, :8], atol=1e-15)
    assert not bare.terms


def test_a_device_turned_over_has_its_weights_with_the_other_sign(model):
    """In the targets of the file as it is, pi_7 and pi_8 alone change."""
    beta, C = truth(model), target_map(model)
    seen = as_in_file(model, model.with_gravity(-model.device.gravity), beta)
    wanted = (C @ beta) * np.where(np.isin([t.name for t in model.device.targets], ["pi_7", "pi_8"]), -1, 1)
    np.testing.assert_allclose(C @ seen, wanted, rtol=1e-9)


def test_a_mounting_on_its_side_is_no_set_of_parameters_of_the_file(model):
    side = model.with_gravity([9.81, 0.0, 0.0])
    with pytest.raises(errors.IdentifiabilityError) as raised:
        as_in_file(model, side, truth(side))
    assert raised.value.found > raised.value.limit


def test_published_columns_are_read_in_units_of_command(demo, model):
    estimate = haptid.estimate(haptid.observe(model, motion(model, truth(model), seconds=3.0)), haptid.OLS())
    beta = published_beta(demo, targets(estimate), "gc")
    np.testing.assert_allclose(2.73 * target_map(model) @ beta, demo.parameters.column("gc"), rtol=1e-9)


def test_tables_leave_missing_figures_blank():
    cells = layout({"a": "a", "b": "b"}, {"x": "X", "y": "Y"}, {"x": {"a": 1.23456}, "y": {"b": 2.0}}, 2)
    assert cells == [["", "X", "Y"], ["a", "1.23", ""], ["b", "", "2.00"]]
