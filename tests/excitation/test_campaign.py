"""The other motions of a campaign: within every limit by another check, and what they are for succeeds on the bench."""

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.experiment import bench
from haptid.experiment.collision import CollisionModel, clearance_along
from haptid.experiment.excitation import (
    CAMPAIGN_FAMILIES,
    Limits,
    held_poses,
    pose_columns,
    write_experiment,
)
from haptid.experiment.excitation.writing import plain_experiment
from json_outputs import valid
from motions import truth
from true_parameters import true_parameters

PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
WITHIN = Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,), (30.0,), torque=(0.6,))


@pytest.mark.parametrize("name", CAMPAIGN_FAMILIES)
def test_every_family_keeps_the_limits_and_the_bench_accepts_it(name):
    beta = truth(PHANTOM)
    found = CAMPAIGN_FAMILIES[name].make(PHANTOM, WITHIN, rest=(0.1, 0.0, 0.2), beta=beta)
    made = found.trajectory(1e-3)
    bench.check_trajectory(PHANTOM, made, true_parameters(PHANTOM))
    for x, (low, high) in zip(made.q.T, WITHIN.position, strict=True):
        assert low <= x.min() < x.max() <= high
    assert np.abs(made.qd).max() <= 3.0
    assert np.abs(made.qdd).max() <= 30.0
    tau = haptid.inverse_dynamics(PHANTOM, beta, made.q.T, made.qd.T, made.qdd.T)
    assert np.abs(tau).max() <= 0.6
    np.testing.assert_allclose(made.q[[0, -1]], [[0.1, 0.0, 0.2]] * 2, atol=0.08)
    np.testing.assert_allclose(made.qd[[0, -1]], 0.0, atol=1e-3)  # the last sample is up to a period before the end


def test_chosen_poses_determine_more_than_a_grid_and_than_random_ones():
    """D-optimality: the determinant of as many grid poses, or of any of fifty random draws, is smaller."""
    low, high = np.array(WITHIN.position).T
    found = np.array(held_poses(PHANTOM, WITHIN, count=8).kind.poses)[1:-1]
    corners = np.array(np.meshgrid(*zip(low * 0.8, high * 0.8, strict=True))).reshape(3, -1).T
    rng = np.random.default_rng(1)
    others = [corners, *(low + (high - low) * rng.random((8, 3)) for _ in range(50))]
    W = pose_columns(PHANTOM, np.concatenate([found, *others]))  # one scale of the columns for all
    volumes = [np.linalg.slogdet(np.einsum("nrp,nrk->pk", *[W[8 * k : 8 * k + 8]] * 2))[1] for k in range(52)]
    assert volumes[0] > max(volumes[1:])


def test_an_experiment_file_keeps_the_poses(tmp_path):
    found = held_poses(PHANTOM, WITHIN, count=8)
    made = bench.read_experiment(write_experiment(tmp_path / "poses.toml", found, plain_experiment(found)))
    assert made.kind == found.kind
    q = found.trajectory(1e-3).q
    still = (np.diff(q, axis=0) == 0).all(axis=1)
    assert still.sum() >= 16 * 1000  # eight poses of a second, from both sides


def test_a_collision_on_the_way_takes_out_the_pose_and_not_the_clearance(tmp_path):
    (tmp_path / "arm.toml").write_text(
        'name = "arm"\ngravity = [0, 0, -9.81]\nconvention = "placement"\n'
        + "".join(
            f'[[joints]]\nname = "{name}"\nxyz = [{x}, 0, {z}]\naxis = {axis}\n'
            "limits = { position = [-2, 2], velocity = 3 }\n"
            for name, x, z, axis in (("1", 0, 0.1, [0, 0, 1]), ("2", 0.3, 0, [0, 1, 0]))
        )
        + '[[collision]]\nlink = "2"\nkind = "capsule"\nradius = 0.02\nlength = 0.3\nxyz = [0.15, 0, 0]\n'
        'rpy = [0, "pi/2", 0]\n'
    )
    (tmp_path / "world.toml").write_text(
        'schema = 1\nname = "post"\n[[collision]]\nname = "post"\nkind = "sphere"\nradius = 0.05\n'
        "xyz = [0.45, 0.3, 0.1]\n"
    )
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "arm.toml"))
    world = haptid.device.read_world(tmp_path / "world.toml")
    free, found = held_poses(model, count=10), held_poses(model, Limits(world=world), count=10)
    collision = CollisionModel.of(model, world)
    assert clearance_along(collision, free.trajectory(1e-3).q, 1e-3).distance < 0.01
    assert clearance_along(collision, found.trajectory(1e-3).q, 1e-3).distance >= 0.0095
    assert found.clearance is not None


def test_what_no_family_can_do_is_said():
    with pytest.raises(errors.TrajectoryError, match=r"friction test .* not within the limits: .*torque"):
        CAMPAIGN_FAMILIES["friction"].make(
            PHANTOM, Limits(WITHIN.position, (3.0,), torque=(1e-4,)), beta=truth(PHANTOM)
        )
    with pytest.raises(errors.TrajectoryError, match="random poses are within all limits; 12 are to be held"):
        held_poses(PHANTOM, Limits(WITHIN.position, (3.0,), torque=(1e-4,)), beta=truth(PHANTOM))
    with pytest.raises(errors.SettingError, match="2 or more"):
        held_poses(PHANTOM, WITHIN, count=1)


def test_the_command_writes_one_plan(tmp_path):
    limits = ["--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3"]
    args = ["excite", "phantom_premium_15", *limits, "--out", str(tmp_path / "s.toml"), "--rate-hz", "100", "--json"]
    plan = ["--friction-test", "--poses", "4", "--reversals"]
    load = ["--payload", "a=0.05@0.17,0,0", "--max-evaluations", "40", "--page", str(tmp_path / "s.html")]
    made = CliRunner().invoke(app, [*args, *plan, *load], catch_exceptions=False)
    assert made.exit_code == 0, made.output
    names = [entry["experiment"].rsplit("/", 1)[1] for entry in valid("excite", made.stdout)["motions"]]
    assert names == ["s.toml", "s-friction.toml", "s-poses.toml", "s-reversals.toml", "s-payload.toml"]
    assert all((tmp_path / name).with_suffix(".csv").exists() for name in names)
    loaded = bench.read_experiment(tmp_path / "s-payload.toml").table.weights
    assert [(one.link, one.mass, one.com) for one in loaded] == [("a", 0.05, [0.17, 0.0, 0.0])]
    page = (tmp_path / "s.html").read_text()
    assert all(f"<h2>{name}" in page for name in ("s", "s-friction", "s-payload"))
    assert "unknown %" not in page  # friction has no prior value, of which there could be per cent
    assert "6 of 14 are unknown." in page
    alone = CliRunner().invoke(app, [*args, "--motions", "0", "--poses", "4"], catch_exceptions=False)
    assert alone.exit_code == 0, alone.output
    assert valid("excite", alone.stdout)["experiment"].endswith("s-poses.toml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--motions", "0"], "--friction-test"),
        (["--motions", "0", "--poses", "4", "--payload", "a=0.05@0,0,0"], "1 or more"),
        (["--payload", "a=0.05"], "LINK=KG@X,Y,Z"),
        (["--payload", "nowhere=0.05@0,0,0"], "LINK=KG@X,Y,Z"),
        (["--payload", "a=-1@0,0,0"], "above 0 kg"),
    ],
)
def test_options_that_do_not_fit(options, words, tmp_path):
    limits = ["--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3"]
    made = CliRunner().invoke(
        app, ["excite", "phantom_premium_15", *limits, "--out", str(tmp_path / "s.toml"), *options]
    )
    assert made.exit_code == 2
    assert words in " ".join(made.output.split())
