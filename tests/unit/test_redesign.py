"""Redesign: counterweights by closed forms and published columns, drives by scaled devices, both by the command."""

import csv
import json
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.dynamics.inverse import inverse_dynamics, mass_matrix
from haptid.dynamics.workspace import workspace
from haptid.end_effector.characterisation import GivenParameters, characterise
from haptid.end_effector.redesign import (
    Counterweight,
    MotorOption,
    WeightPlace,
    Wishes,
    balance,
    balance_front,
    drive_changes,
    least_change,
    pareto,
    places,
    redesigned,
    weighed,
    with_counterweights,
)
from haptid.experiment.bench import read_experiment
from haptid.inference.targets import target_map
from true_parameters import true_parameters

G, ALPHA = 9.81, 2.73
ROTORS = {"1": 1.08e-6 * 13.3**2, "2": 1.08e-6 * 11.2**2, "3": 1.08e-6 * 11.2**2}


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def poses(model):
    return workspace(model, {"be": (-0.7, 0.7), "df": (-0.6, 1.1)}).grid(216)


@pytest.fixture(scope="module")
def normal(model):
    """The published column Normal, SI."""
    with (files("haptid") / "demos/phantom/table1.csv").open() as file:
        rows = list(csv.DictReader(file))
    values = np.array([float(row["normal"] or 0) for row in rows]) / ALPHA
    return GivenParameters(model, np.linalg.solve(target_map(model), values))


def pi(identified):
    return target_map(identified.model) @ identified.beta


def test_weights_null_the_gravity_terms_of_the_published_column(normal, poses):
    """m x = -pi / g on each of both links, by hand; the price is m x^2 in pi_5 and pi_6, half of it in pi_1."""
    made = balance(normal, poses)
    before, after = pi(normal), pi(made.identified)
    np.testing.assert_allclose(after[6:8], 0, atol=2e-6)
    assert made.static_after < 1e-4 * made.static_before
    weights = {w.link: w for w in made.weights}
    for link, gravity, inertia in (("be", 6, 4), ("df", 7, 5)):
        mass, x = weights[link].mass, weights[link].com[0]
        assert mass * x == pytest.approx(-before[gravity] / G, rel=1e-3)
        assert after[inertia] - before[inertia] == pytest.approx(mass * x**2)
    added = sum(w.mass * w.com[0] ** 2 for w in made.weights)
    assert after[0] - before[0] == pytest.approx(added / 2)
    assert made.mass_after > made.mass_before


def test_most_mass_at_the_least_distance_costs_least(normal, poses):
    """Where mass has a price the weights grow to their limit; the front is one."""
    front = balance_front(normal, poses, prices=(0.0, 0.03, 3.0))
    assert len(front) > 1
    assert all(a.static_after < b.static_after and a.mass_after > b.mass_after for a, b in pairwise(front))
    priced = next(one for one in front if one.price == 0.03)
    assert all(w.mass == pytest.approx(0.4, rel=1e-3) for w in priced.weights)
    assert priced.static_after < 0.01 * priced.static_before


def test_weights_are_those_of_the_bench(model, tmp_path):
    """The same point masses, added to the true bodies by an experiment file."""
    text = "\n".join(
        [
            'schema = 1\nname = "weights"',
            '[trajectory]\nkind = "multisine"\nseconds = 2.0\ncentre = [0, 0.2, 0.3]\namplitude = 0.2',
            "[controller]\nkp = 40.0\nkd = 0.5",
            '[[weights]]\nlink = "be"\nmass = 0.3\ncom = [-0.06, 0, 0]',
            '[[weights]]\nlink = "df"\nmass = 0.1\ncom = [0.05, 0, 0]',
        ]
    )
    (tmp_path / "e.toml").write_text(text)
    true = read_experiment(tmp_path / "e.toml").setup(model).chi
    plain = GivenParameters(model, model.prior_beta)
    made = with_counterweights(plain, [Counterweight("be", 0.3, (-0.06, 0, 0)), Counterweight("df", 0.1, (0.05, 0, 0))])
    np.testing.assert_allclose(made.beta, model.base.of(true), atol=1e-12)


def test_gears_and_lengths_scale_as_rotors_and_bars_do(model, poses):
    """At factor 1 the device itself; rotors alone scale with r^2 / s^2; forces with r / s where nothing is carried."""
    chi = np.nan_to_num(model.device.chi_prior)
    known = GivenParameters(model, model.base.of(chi))
    (same,) = drive_changes(known, poses, ROTORS, ratios=(1.0,), lengths=(1.0,))
    found = characterise(known, poses)
    assert same.mass == pytest.approx(np.median(found.apparent_mass.values[:, 0]))
    limits = {"1": 1.716, "2": 1.445, "3": 1.445}
    assert same.force == pytest.approx(np.median(found.greatest_force(limits)[0].values), rel=2e-3)
    floating = model.with_gravity([0, 0, 0])
    light = GivenParameters(floating, floating.base.of(chi))
    unit, both = drive_changes(light, poses, ROTORS, limits, ratios=(1.0,), lengths=(1.0, 1.3))
    (geared,) = drive_changes(light, poses, ROTORS, limits, ratios=(1.5,), lengths=(1.0,))
    assert geared.force == pytest.approx(1.5 * unit.force)
    assert both.force == pytest.approx(unit.force / 1.3)
    assert geared.mass > unit.mass
    front = pareto(drive_changes(known, poses, ROTORS), most_mass=0.1, least_force=7.0)
    assert front
    assert all(one.mass <= 0.1 and one.force >= 7.0 for one in front)
    assert all(a.mass < b.mass and a.force < b.force for a, b in pairwise(front))


def test_each_gear_and_motor_is_that_of_a_device_with_other_rotors(model, poses):
    """The rotors' part of the mass matrix and the limits, changed by hand motor by motor."""
    chi = np.nan_to_num(model.device.chi_prior)
    known, r = GivenParameters(model, model.base.of(chi)), np.array([1.5, 1.0, 0.5])
    changes = drive_changes(
        known, poses, ROTORS, ratios=(0.5, 1.0, 1.5), lengths=(1.0,), motors=(MotorOption("big", 2.0, 3.0),), each=True
    )
    assert len(changes) == 27
    (one,) = [change for change in changes if change.ratios == tuple(r)]
    found = characterise(known, poses)
    A = mass_matrix(model, known.beta, poses) + np.diag((3 * r**2 - 1) * list(ROTORS.values()))
    J = found.handle.jacobian
    assert one.mass == pytest.approx(np.median(1 / np.linalg.eigvalsh(J @ np.linalg.inv(A) @ J.mT)[:, 0]))
    limits = dict(zip("123", (2 * r * [1.716, 1.445, 1.445]).tolist(), strict=True))
    assert one.force == pytest.approx(np.median(found.greatest_force(limits)[0].values))


def test_the_least_change_that_reaches_a_wish_or_what_is_reached(model, poses):
    known = GivenParameters(model, model.base.of(np.nan_to_num(model.device.chi_prior)))
    changes = drive_changes(known, poses)
    least = least_change(changes, most_mass=0.085, least_force=9.0)
    assert least.mass <= 0.085
    assert least.force >= 9.0
    assert all(one.size >= least.size for one in changes if one.mass <= 0.085 and one.force >= 9.0)
    with pytest.raises(errors.SettingError) as raised:
        least_change(changes, most_mass=0.07, least_force=15.0)
    heavy = min(one.mass for one in changes if one.force >= 15.0)
    weak = max(one.force for one in changes if one.mass <= 0.07)
    assert f"{heavy:.3g} kg" in str(raised.value)
    assert f"{weak:.3g} N" in str(raised.value)


def test_the_command_has_both_pictures_and_refuses_what_cannot_be(model, tmp_path):
    page, limits = tmp_path / "r.html", ["--limit", "be=-0.7:0.7", "--limit", "df=-0.6:1.1", "--poses", "27"]

    def run(*options, device="phantom_premium_15"):
        return CliRunner().invoke(app, ["redesign", device, *limits, "--out", str(page), *options])

    done = run("--most-mass", "0.085", "--least-force", "9", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["chosen"]["mass"] <= 0.085
    assert len(found["counterweights"]) > 1
    assert "Force against effective mass" in (text := page.read_text(encoding="utf-8"))
    assert "Static torque against effective mass" in text
    assert "reaches it" in run("--most-mass", "0.085", "--least-force", "9").stdout
    one = json.loads(run("--weight", "be=0.3:0.02,0,0", "--json").stdout)["counterweights"]
    known = GivenParameters(model, model.base.of(np.nan_to_num(model.device.chi_prior)))
    where = workspace(model, {"be": (-0.7, 0.7), "df": (-0.6, 1.1)}).grid(27)
    tried = weighed(known, where, [Counterweight("be", 0.3, (0.02, 0, 0))])
    assert [entry["static_after"] for entry in one] == [pytest.approx(tried.static_after)]
    page.unlink()
    for options, what in (
        (["--weight", "be=0.9:0.02,0,0"], "at most 0.4 kg"),
        (["--weight", "be=0.1:0.2,0,0"], "(0.1, 0.0, 0.0)"),
        (["--weight", "a=0.1:0.02,0,0"], "a link that has a place: be, df"),
        (["--weight", "be=0.1"], "LINK=MASS:x,y,z"),
        (["--place", "be=0.4"], "LINK=MOST"),
        (["--motor", "big=2"], "NAME=TORQUE:INERTIA"),
        (["--least-force", "500"], "a force up to"),
        (["--rotor", "1=0.5"], "less than the inertia that was identified"),
        (["--out", "r.txt"], ".html"),
    ):
        refused = run(*options)
        assert refused.exit_code == 2, refused.output
        assert what in " ".join(refused.stderr.split()), refused.stderr
        assert not page.exists()
    assert "Give a result" in run(device="delta").stderr


def test_a_balanced_tree_by_its_static_torques(poses):
    """Another mechanism, true parameters at random: fewer static torques, within the limits."""
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    known = GivenParameters(model, model.base.of(true_parameters(model)))
    names = model.device.joint_names
    limits = [WeightPlace(names[k], 2.0, (-0.3, -0.1, 0.0), (0.3, 0.1, 0.0)) for k in (1, 2)]
    made = balance(known, poses, limits)
    still = np.zeros_like(poses)
    tau = inverse_dynamics(model, made.identified.beta, poses, still, still)
    assert np.sqrt(np.mean(tau**2)) == pytest.approx(made.static_after)
    assert made.static_after < made.static_before
    with_counterweights(known, made.weights, limits)  # each is within


def test_what_cannot_be(model, normal, poses):
    with pytest.raises(errors.SettingError) as raised:
        with_counterweights(normal, [Counterweight("be", 0.5, (0.05, 0, 0))], places(model))
    assert raised.value.where == "counterweight on be"
    with pytest.raises(errors.SettingError) as raised:
        with_counterweights(normal, [Counterweight("be", 0.1, (0.0, 0.05, 0))])
    assert "MYbe" in str(raised.value) or "XYbe" in str(raised.value)
    with pytest.raises(errors.UnknownNameError):
        balance(normal, poses, [WeightPlace("bee", 0.1, (0, 0, 0), (0.1, 0, 0))])
    with pytest.raises(errors.IncompleteDeviceError):
        places(haptid.DynamicModel(haptid.read_device("arm3")))
    arm = haptid.DynamicModel(haptid.read_device("arm3"))
    unknown = GivenParameters(arm, arm.base.of(true_parameters(arm)))
    with pytest.raises(errors.IncompleteDeviceError) as lacks:
        drive_changes(unknown, poses, {"1": 1e-4})
    assert lacks.value.where == arm.device.motors[1].name
    with pytest.raises(errors.IncompleteDeviceError):
        redesigned(unknown, poses)
    with pytest.raises(errors.UnknownNameError):
        drive_changes(normal, poses, {"9": 1e-4})
    for wrong, where in (
        (lambda: WeightPlace("be", 0.0, (0, 0, 0), (1, 0, 0)), "most of be"),
        (lambda: WeightPlace("be", 1.0, (0, 0, 0), (-1, 0, 0)), "place of be"),
        (lambda: balance(normal, poses, price=-1.0), "price"),
        (lambda: drive_changes(normal, poses, dict.fromkeys("123", 1.0)), "rotor_inertia"),
        (lambda: drive_changes(normal, poses, ROTORS, ratios=(0.0,)), "ratios"),
        (lambda: drive_changes(normal, poses, ratios=np.linspace(0.5, 2, 30), each=True), "changes"),
        (lambda: MotorOption("m", torque=-1.0), "torque of motor option m"),
        (lambda: Wishes(most_mass=0.0), "most_mass"),
        (lambda: Wishes(least_force=-1.0), "least_force"),
    ):
        with pytest.raises(errors.SettingError) as raised:
            wrong()
        assert raised.value.where == where
