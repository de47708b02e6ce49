"""Loops that are not linear: which way they close, where they do not, and what their parameters are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import haptid
from closed_devices import NAMES, poses
from haptid import errors
from haptid.device import Closure, NewtonClosure
from haptid.device.toml.reader import checked_tables, device_of
from haptid.dynamics.workspace import workspace


def edited(folder: Path, name: str, *pairs: tuple[str, str]) -> haptid.Device:
    """A shipped device with some of its text replaced."""
    text = (Path(haptid.__file__).parent / "device/library" / f"{name}.toml").read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (folder / "edited.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "edited.toml"))


def test_five_bar_regroups_across_the_cut() -> None:
    base = haptid.DynamicModel(haptid.read_device("five_bar")).base
    groupings = dict(zip(base.names, base.groupings, strict=True))
    L1, L4 = 0.063, 0.075
    assert groupings["ZZ1R"] == f"ZZ1 + {L1**2:.6g} M3 + {L1**2 / L4:.6g} MX4 + IAM1"
    assert groupings["MX1R"] == f"MX1 + {L1:.6g} M3 + {L1 / L4:.6g} MX4"
    assert groupings["ZZ4R"] == f"ZZ4 - {L4:.6g} MX4"


@pytest.mark.parametrize("name", NAMES)
def test_the_rank_is_beyond_doubt_whatever_the_states(name: str) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    found = [haptid.dynamics.base_parameters(model, seed) for seed in range(4)]
    assert all(base.is_clear for base in found)
    assert len({base.names for base in found}) == 1
    for base in found[1:]:
        np.testing.assert_allclose(base.regrouping, found[0].regrouping, atol=1e-9)


def test_the_guess_chooses_the_way_to_close(tmp_path: Path) -> None:
    above = haptid.DynamicModel(haptid.read_device("four_bar"))
    below = edited(tmp_path, "four_bar", ("coupler = -1.3, rocker = 1.2", "rocker = -2.5"))
    qa = np.linspace(-3, 3, 20)[None]
    one, other = (model.device.closure.positions(qa) for model in (above, below))
    assert (np.abs(one - other)[1:].min(axis=1) > 0.3).all()
    with pytest.raises(errors.LoopClosureError) as caught:
        edited(tmp_path, "four_bar", ("guess = { coupler = -1.3, rocker = 1.2 }", "guess = {}"))
    assert (caught.value.found, caught.value.limit) == (2, 1)


def test_a_crank_may_turn_round_and_round() -> None:
    model = haptid.DynamicModel(haptid.read_device("four_bar"))
    turns = np.linspace(0, 6 * np.pi, 700)[None]
    q = model.device.closure.positions(turns)
    assert np.abs(np.diff(q, axis=1)).max() < 0.1
    np.testing.assert_allclose(q[2, [0, 233, 466, 699]], q[2, 0], atol=1e-12)
    np.testing.assert_allclose(q[1, 699], q[1, 0] - 6 * np.pi, atol=1e-12)


def test_a_start_pose_that_cannot_close_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(errors.LoopClosureError) as caught:
        edited(tmp_path, "five_bar", ("at = { 1 = 2.356, 2 = 0.785 }", "at = { 1 = 3.1, 2 = 0.0 }"))
    assert 1e-4 < caught.value.found < 0.1


def test_poses_out_of_reach_say_which_and_how_far() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    qa = np.linspace([2.356, 0.785], [3.14, 0.0], 50).T
    with pytest.raises(errors.LoopClosureError) as caught:
        model.device.closure.positions(qa)
    assert 0 < caught.value.found < 0.1
    assert 40 <= caught.value.where < 50
    closes = model.device.closure.closes(qa)
    assert closes[: caught.value.where].all()
    assert not closes[caught.value.where :].any()


KITE = """
name = "kite"
gravity = [0, -9.81, 0]
[[joints]]
name = "crank"
[[joints]]
name = "coupler"
d = 0.2
[[joints]]
name = "rocker"
parent = "base"
d = 0.2
[[loops]]
passive = ["coupler", "rocker"]
at = { crank = 1.0 }
guess = { rocker = 0.3 }
cut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "rocker", frame_b = { d = 0.3 } }
"""


@pytest.mark.parametrize("samples", [2, 7, 1000])
def test_a_singularity_is_not_crossed_however_coarse_the_motion(tmp_path: Path, samples: int) -> None:
    """With the crank at zero its tip is on the rocker's pivot: coupler and rocker then turn together, freely."""
    (tmp_path / "kite.toml").write_text(KITE)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "kite.toml"))
    model.device.closure.positions(np.linspace(1.0, 0.05, 20)[None])
    with pytest.raises(errors.SingularityError) as caught:
        model.device.closure.positions(np.linspace(1.0, -1.013, samples)[None])
    assert caught.value.found < 0.05
    assert not model.device.closure.closes(np.array([[-1.0]]))[0]


def test_a_singular_start_pose_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "kite.toml").write_text(KITE.replace("crank = 1.0", "crank = 0.0"))
    with pytest.raises(errors.LoopClosureError):
        haptid.DynamicModel(haptid.read_device(tmp_path / "kite.toml"))


def test_a_motion_may_go_round_what_the_straight_way_runs_into() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    corner, goal = np.array([3.2457, -1.4401]), np.array([3.3315, -1.4534])
    assert not model.device.closure.closes(goal[:, None])[0]
    way = np.concatenate([np.linspace(model.device.closure.at, corner, 300), np.linspace(corner, goal, 20)]).T
    q = model.device.closure.positions(way)
    assert np.abs(model.device.closure.chain.residual(q.T)[0]).max() < 1e-12
    assert np.abs(np.diff(q, axis=1)).max() < 0.2


def test_no_samples_are_no_trouble() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    none = np.zeros((2, 0))
    assert model.device.closure.positions(none).shape == (4, 0)
    assert haptid.inverse_dynamics(model, np.ones(len(model.base)), none, none, none).shape == (2, 0)
    assert haptid.dynamics.mass_matrix(model, np.ones(len(model.base)), none).shape == (0, 2, 2)


MIXED = """
name = "a parallelogram and a four-bar on one turntable"
gravity = [0, 0, -9.81]
[[joints]]
name = "yaw"
[[joints]]
name = "arm"
alpha = "pi/2"
[[joints]]
name = "lever"
parent = "yaw"
alpha = "pi/2"
[[joints]]
name = "forearm"
parent = "arm"
d = 0.3
[[joints]]
name = "coupler"
parent = "lever"
d = 0.1
[[joints]]
name = "crank"
parent = "yaw"
alpha = "pi/2"
b = 0.1
[[joints]]
name = "rod"
parent = "crank"
d = 0.1
[[joints]]
name = "rocker"
parent = "yaw"
alpha = "pi/2"
b = 0.1
d = 0.22
[[loops]]
passive = ["forearm", "coupler"]
cut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "forearm", frame_b = { d = 0.1 } }
[[loops]]
passive = ["rod", "rocker"]
cut = { body_a = "rod", frame_a = { d = 0.25 }, body_b = "rocker", frame_b = { d = 0.2 } }
at = { crank = 1.57 }
guess = { rod = -1.3, rocker = 1.2 }
"""


def test_linear_loops_stay_linear_next_to_others(tmp_path: Path) -> None:
    (tmp_path / "mixed.toml").write_text(MIXED)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "mixed.toml"))
    closure = model.device.closure
    assert isinstance(closure, NewtonClosure)
    assert closure.unknown == (6, 7)
    assert closure.relations[:2] == ("qforearm = -qarm + qlever", "qcoupler = qarm - qlever")
    assert closure.relations[2:] == ("qrod by closing, from qcrank", "qrocker by closing, from qcrank")
    assert np.argwhere(closure.varying).tolist() == [[6, 3], [7, 3]]
    reached = model.mechanism.reach(list(range(80)))
    assert not any(reached[1][50:])
    assert not any(reached[3][:50])
    alone = haptid.DynamicModel(haptid.read_device("four_bar")).device.closure
    crank = np.linspace(0, 3, 9)
    qa = np.array([0.4 + 0 * crank, 0.2 * crank, 1.5 + 0 * crank, crank])
    np.testing.assert_allclose(closure.positions(qa)[[5, 6, 7]], alone.positions(crank[None]), atol=1e-12)
    assert isinstance(haptid.DynamicModel(haptid.read_device("phantom_premium_15")).device.closure, Closure)


def test_a_mechanism_that_is_stuck_in_its_start_pose_is_an_error(tmp_path: Path) -> None:
    """Found by fuzzing: a rocker whose axis is out of the loop's plane."""
    text = """schema = 1
name = "stuck"
gravity = [0, 0, -9.81]
convention = "placement"
joints = [
    { name = "crank", axis = [0, 1, 0] },
    { name = "coupler", xyz = [0.12, 0, 0], axis = [0, 1, 0] },
    { name = "rocker", parent = "base", xyz = [0, 0, 0.2], axis = [2, 1, 0] },
]

[[loops]]
passive = ["coupler", "rocker"]
guess = { coupler = 0.0, rocker = 0.0 }

[loops.cut]
type = "spherical"
body_a = "coupler"
frame_a = { xyz = [0, 0, 0.2] }
body_b = "rocker"
frame_b = { xyz = [0.12, 0, 0] }
"""
    (tmp_path / "stuck.toml").write_text(text)
    with pytest.raises(errors.LoopClosureError, match="at none of"):
        haptid.read_device(tmp_path / "stuck.toml")
    (tmp_path / "stuck.toml").write_text(text.replace("[2, 1, 0]", "[0, 1, 0]"))
    haptid.read_device(tmp_path / "stuck.toml")


def test_at_names_active_joints_only(tmp_path: Path) -> None:
    with pytest.raises(errors.DeviceFileError, match="at names joint rocker, which a loop moves"):
        edited(tmp_path, "four_bar", ("at = { crank = 1.57 }", "at = { rocker = 1.57 }"))
    with pytest.raises(errors.DeviceFileError, match=r"loops\[0\]\.at\.crink"):
        edited(tmp_path, "four_bar", ("at = { crank = 1.57 }", "at = { crink = 1.57 }"))


def test_the_workspace_ends_where_loops_do() -> None:
    limits = {"1": (0.8, 4.2), "2": (-1.1, 2.4), "3": (-2.9, -0.4)}
    where = workspace(haptid.DynamicModel(haptid.read_device("five_bar")), limits)
    grid = where.grid(400)
    assert 20 < grid.shape[1] < 400
    q = where.model.device.closure.positions(grid)
    assert q[2].min() > -2.9
    assert q[2].max() < -0.4
    assert not where.holds(np.array([[3.14], [0.0]]))[0]


def test_friction_of_a_passive_joint_is_guarded_where_that_joint_is_slow(tmp_path: Path) -> None:
    slow = 'kind = "coulomb"\njoints = '
    model = edited(tmp_path, "four_bar", (slow + '["crank"]', slow + '["rocker"]'))
    (term,) = model.coulomb_terms(0)
    qa, qda, _ = poses(model, 30)
    wanted = model.device.closure.follow(qa, qda).velocity(qda)[2]
    np.testing.assert_allclose(model.speed(term, qa, qda), wanted, atol=1e-14)


def between_frames(name: str) -> haptid.DynamicModel:
    """A device whose spring is a strut between base and last link."""
    page = Path(__file__).parents[2] / "docs" / "device-files.md"
    blocks = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    (text,) = (block for block in blocks if "arm with a balancing spring" in block)
    if name == "space":
        text = SPATIAL_STRUT
    return haptid.DynamicModel(device_of(*checked_tables(tomllib.loads(f"schema = 1\n{text}"), f"{name}.toml")))


SPATIAL_STRUT = """name = "shoulder"
gravity = [0.0, 0.0, -9.81]
joints = [
    { name = "1" },
    { name = "2", alpha = "pi/2" },
    { name = "yaw", parent = "base", d = 0.1, r = 0.3, body = false },
    { name = "pitch", alpha = "pi/2", body = false },
    { name = "slide", type = "prismatic", gamma = "pi/2", alpha = "pi/2", body = false },
]
terms = [{ kind = "spring", joints = ["slide"] }, { kind = "offset", joints = ["slide"], prefix = "PULL" }]

[[loops]]
passive = ["yaw", "pitch", "slide"]
cut = { body_a = "slide", body_b = "2", frame_b = { d = 0.25 }, type = "spherical" }
at = { 1 = 0.3, 2 = 0.2 }
guess = { yaw = 0.5, pitch = -1.0, slide = 0.3 }
"""


def strut(name: str, q: np.ndarray) -> np.ndarray:
    """From the anchor to the end on the last link, (samples, 3), in closed form."""
    a, b = q
    if name == "plane":
        end = np.stack([0.3 * np.cos(a) + 0.2 * np.cos(a + b), 0.3 * np.sin(a) + 0.2 * np.sin(a + b), 0 * a], 1)
        return end - np.array([0.0, 0.25, 0.0])
    end = 0.25 * np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], 1)
    return end - np.array([0.1, 0.0, 0.3])


@pytest.mark.parametrize("name", ["plane", "space"])
def test_a_spring_between_two_frames_is_a_strut_without_mass(name: str) -> None:
    """Torque (K L + P) dL/dq of its length L, by differences, and both parameters from rows with noise."""
    model, rng = between_frames(name), np.random.default_rng(3)
    t = np.linspace(0.0, 4.0, 400)
    q = np.array([0.3 + 0.4 * np.sin(2.1 * t), 0.35 + 0.25 * np.sin(3.3 * t + 1)])

    def length(q: np.ndarray) -> np.ndarray:
        return np.linalg.norm(strut(name, q), axis=1)

    h = 1e-6 * np.eye(2)[:, :, None]
    slope = np.array([(length(q + d) - length(q - d)) / 2e-6 for d in h])
    values, still = {"Kslide": 800.0, "PULLslide": -120.0}, np.zeros((2, len(t)))
    unit = np.eye(len(model.base.names))
    Y = np.array([haptid.inverse_dynamics(model, beta, q, still, still).ravel() for beta in unit]).T
    tau = Y @ [values.get(name, 0.0) for name in model.base.names]
    wanted = (values["Kslide"] * length(q) + values["PULLslide"]) * slope
    np.testing.assert_allclose(tau.reshape(slope.shape), wanted, atol=1e-5)
    found = np.linalg.lstsq(Y, tau + 0.01 * rng.standard_normal(len(tau)), rcond=None)[0]
    se = 0.01 * np.linalg.norm(np.linalg.pinv(Y), axis=1)  # inertias have no column at rest
    for key, value in values.items():
        k = model.base.names.index(key)
        assert abs(found[k] - value) < 4 * se[k] < 0.1 * abs(value)
