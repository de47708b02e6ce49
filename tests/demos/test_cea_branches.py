"""The demonstration with branches: its plan, a small run of one branch, and its results."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.demos import kind_of, read_demo
from haptid.demos.cea_branches.results import interface_of
from haptid.demos.cea_branches.sections import _interface
from haptid.demos.recordings import record
from haptid.demos.run import write_results
from haptid.end_effector.characterisation import GivenParameters
from haptid.estimation import feasible_parameters
from haptid.experiment.bench import read_experiment
from json_outputs import valid

# One filter and three shares are searched, and one frequency is tried.
SMALL = {
    "velocity_cutoffs_hz": (200.0,),
    "momentum_cutoffs_hz": (60.0,),
    "shares": (0.2, 0.35, 0.5),
    "frequencies_hz": (4.0,),
    "seconds": 1.0,
}
TABLES = {"upper": "table1.csv", "lower": "table2.csv"}


@pytest.fixture(scope="module")
def demo():
    return read_demo("medical")


@pytest.fixture(scope="module")
def model(demo):
    return haptid.DynamicModel(haptid.read_device(demo.device))


def test_every_file_of_the_plan_is_there_and_its_names_fit(demo, model, tmp_path):
    for branch in demo.branches:
        for name in (branch.key, branch.unseen, branch.friction):
            assert read_experiment(demo.write_experiment(name, tmp_path)).setup(model).model is model
        assert set(demo.tables[branch.key].rows) < set(model.base.names)
        assert branch.table == TABLES[branch.key]
    keys = {branch.key for branch in demo.branches}
    assert {drawn.branch for drawn in demo.drawn} <= keys
    assert {drawn.motor for drawn in demo.drawn} <= set(model.device.row_names)
    assert {said.sweep for said in demo.statements} <= {sweep.key for sweep in demo.sweeps}
    assert demo.compensation.branch in keys


@pytest.mark.parametrize("branch", TABLES)
def test_what_is_true_is_what_is_published_and_zero_for_the_rest(demo, model, branch, tmp_path):
    """And bodies can have it; the three experiments of a branch differ by the motion alone."""
    plan, table = demo.branch(branch), demo.tables[branch]
    names = (plan.key, plan.unseen, plan.friction)
    setups = [read_experiment(demo.write_experiment(name, tmp_path)) for name in names]
    beta = model.base.of(setups[0].setup(model).chi)
    wanted = [table.figures.get((name, "identified"), 0.0) for name in model.base.names]
    np.testing.assert_allclose(beta, wanted, atol=2e-9)
    assert feasible_parameters(model, np.array(wanted)).ok
    first, *others = (experiment.table.model_dump() for experiment in setups)
    for other in others:
        assert {key for key in other if other[key] != first[key]} == {"name", "seed", "trajectory"}


def test_published_tables_are_those_of_the_paper(demo):
    upper, lower = demo.tables["upper"], demo.tables["lower"]
    assert upper.rows == lower.rows
    assert len(upper.rows) == 15
    assert upper.figures["OFF2", "relative"] == 1.0
    assert lower.figures["MX1R", "relative"] == 11.0
    assert upper.figures["MY1R", "identified"] * lower.figures["MY1R", "identified"] < 0


@pytest.fixture(scope="module")
def found(demo, tmp_path_factory):
    """One branch, short logs, compensation at one pose: everything is found and written."""
    short = demo.stretch.model_copy(update={"identify": (2.0, 14.0), "unseen": (2.0, 8.0)})
    small = demo.model_copy(
        update={
            "stretch": short,
            "branches": demo.branches[:1],
            "drawn": demo.drawn[1:],
            "interface": None,
            "flawed": None,  # tests/demos/test_flaws_section.py
            "compensation": demo.compensation.model_copy(update={**SMALL, "degrees": (60.0,)}),
        }
    )
    folder, kind, told = tmp_path_factory.mktemp("branches"), kind_of(demo), []
    for take in kind.takes(small, folder):
        record(shorter(take))
    found = kind.find(small, folder, lambda what, share: told.append((what, share)))
    write_results(small, found, folder)
    assert {what for what, _ in told} == {"identifying", "compensating"}
    return folder, found


def shorter(take):
    """The same take with a motion of few seconds, simulated in coarse steps."""
    text = take.experiment.read_text(encoding="utf-8")
    text = text.replace("seconds = 59.3", "seconds = 16.0").replace("seconds = 30.0", "seconds = 10.0")
    text = text.replace("[0.2, 0.3, 0.45, 0.7, 1.0, 1.4]", "[0.8, 1.2]")
    take.experiment.write_text(text, encoding="utf-8")
    return replace(take, step=5e-4)


def test_everything_is_written(found):
    folder, results = found
    names = ["paper.html", "demo.json"]
    names += [f"{name}.{kind}" for name in ("table1", "friction", "sweeps", "posture") for kind in ("txt", "csv")]
    for name in names:
        assert (folder / name).stat().st_size > 0, name
    page = (folder / "paper.html").read_text(encoding="utf-8")
    charts = ("friction-upper-0", "torque-0-0", "sweep-arm-upper", "compensation")
    for wanted in (*(claim.check for claim in results.demo.claims), *(f'id="{chart}"' for chart in charts)):
        assert wanted in page
    values = valid("demo", (folder / "demo.json").read_text(encoding="utf-8"))
    assert set(values["branches"]) == {"upper"}
    assert values["branches"]["upper"]["essential"] == list(results.found["upper"].reduction.essential)


def test_a_small_log_finds_the_branch(found):
    """Errors on unseen motion, most intervals, and the largest masses within 2 % of the truth."""
    _, results = found
    one = results.found["upper"]
    assert one.cross.relative < 3
    assert np.mean([one.inside(name) for name in one.reduction.essential]) > 0.7
    assert not one.missing
    true = GivenParameters(results.model, one.beta)
    for sweep in results.demo.sweeps:
        felt = haptid.end_effector.apparent_mass(true, sweep.along(results.model)).mass.values
        np.testing.assert_allclose(results.handles["upper"].sweeps[sweep.key].mass.values, felt, rtol=0.02)


def test_friction_test_finds_coulomb_friction(found):
    _, results = found
    test = results.friction["upper"]
    for joint in test.choice.joints:
        value, _ = test.coulomb(joint.label)
        assert value == pytest.approx({"motor 1": 0.12}.get(joint.label, 0.11), rel=0.02)


def test_compensation_is_felt_as_promised_and_feeds_no_hand(found):
    """A point with the wanted reduction, measured on the bench with friction and encoders."""
    _, results = found
    made, plan = results.compensated, results.demo.compensation
    assert made.chosen is not None
    assert made.chosen.reduction >= plan.reduction
    assert made.chosen.stable
    assert made.chosen.quiet
    for name, law in made.laws.items():
        (felt,), ((mass, damping),) = made.felt[name], made.promised[name]
        np.testing.assert_allclose(felt.mass, mass, rtol=0.05)
        np.testing.assert_allclose(felt.damping, damping, atol=0.15 + 0.05 * abs(damping))
        if law.share == 0:
            np.testing.assert_allclose(mass, made.estimated[0], rtol=1e-3)
    assert made.felt["chosen"][0].mass < 0.7 * 1.03 * made.felt["weight only"][0].mass
    assert all(trial.power < 0 and trial.predicted < 1 for trial in made.trials if trial.law == "chosen")
    assert max(trial.unrest for trial in made.trials if trial.law == "chosen") < 5e-3
    assert not made.design.front("passive")  # the branch has no viscous friction


def test_other_laws_are_felt_as_they_promise(found):
    """Friction falls by its share; computed torque is a spring and a damper."""
    _, results = found
    weight, rubbed, planned = results.others
    assert [one.judged.passive for one in results.others] == [False, False, False]
    assert planned.judged.stable
    assert planned.judged.quiet
    assert planned.stiff.predicted < 1 < rubbed.stiff.predicted
    assert all(one.stiff.power < 0 for one in results.others)
    assert max(one.stiff.unrest for one in results.others) < 5e-3
    assert rubbed.felt.friction == pytest.approx(0.3 * weight.felt.friction, rel=0.3)
    w = 2 * np.pi * 5.0
    assert planned.felt.stiffness == pytest.approx(w**2 * weight.felt.mass, rel=0.1)
    assert planned.felt.damping == pytest.approx(2 * w * weight.felt.mass, rel=0.1)
    assert planned.tracking < 5e-4
    assert weight.tracking is None


@pytest.fixture(scope="module")
def interface(demo, tmp_path_factory):
    """Both branches on one handle, from logs of a few seconds at a lower control rate."""
    folder = tmp_path_factory.mktemp("interface")
    plan = demo.interface.model_copy(update={"identify": (1.5, 6.5), "validate_": (1.5, 4.5), "map_poses": 200})
    for take in kind_of(demo).takes(demo, folder)[:2]:
        text = take.experiment.read_text(encoding="utf-8")
        text = text.replace("seconds = 20.0", "seconds = 8.0").replace("seconds = 12.0", "seconds = 6.0")
        take.experiment.write_text(text, encoding="utf-8")
        record(take)
    return interface_of(plan, folder, lambda _what, _share: None)


def test_the_whole_interface_is_identified(interface):
    """Unseen motion to 0.5 %, most intervals with the true value, and what the hand feels to 2 %."""
    assert (len(interface.model.device.motors), len(interface.model.device.active)) == (7, 6)
    assert interface.cross.relative < 0.5
    assert len(interface.inside) > 0.8 * len(interface.model.base)
    for name in ("linear", "angular"):
        found, true = (handles[name].apparent_mass.values for handles in (interface.at_posture, interface.truly))
        np.testing.assert_allclose(found[:, :2], true[:, :2], rtol=0.02)
    section = _interface(interface)
    assert [len(row) for row in section.tables[0].cells] == [len(section.tables[0].cells[0])] * 3
    assert "83 base parameters of 237" in section.text[1]
    assert len(section.tables[1].cells) == 15
