"""Loops closed along whole motions: parts and threads do not show, beginnings and ends that are hard to come by."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from closed_devices import NAMES, bodies, path
from haptid import errors
from haptid.cli import app
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.inverse import core_mass, core_torque, rigid
from haptid.dynamics.kinematics import handle_motion


@pytest.mark.parametrize("name", NAMES)
def test_a_motion_in_parts_is_the_same_motion(name: str) -> None:
    closure = haptid.DynamicModel(haptid.read_device(name)).device.closure
    qa, qda, _ = path(haptid.DynamicModel(haptid.read_device(name)), 3.0, 1e-3)
    whole = closure.follow(qa, qda)
    for first, count in ((0, 7), (500, 30), (1021, 600), (2999, 1)):
        here = slice(first, first + count)
        some = closure.follow(qa[:, here], qda[:, here])
        np.testing.assert_allclose(some.q, whole.q[:, here], rtol=0, atol=1e-13)
        np.testing.assert_allclose(some.G, whole.G[here], rtol=0, atol=1e-12)
        np.testing.assert_allclose(some.Gd, whole.Gd[here], rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", NAMES)
def test_velocities_and_accelerations_are_those_of_differences(name: str) -> None:
    model, dt = haptid.DynamicModel(haptid.read_device(name)), 1e-4
    motion = path(model, 0.2, dt)
    q, qd, qdd = model.tree(*motion)
    # A central difference leaves out dt^2 / 6 of the derivative after next; twice that, as it is itself a difference.
    jerk, snap = (np.abs(np.diff(qdd, order)).max() / dt**order for order in (1, 2))
    np.testing.assert_allclose((q[:, 2:] - q[:, :-2]) / (2 * dt), qd[:, 1:-1], rtol=0, atol=dt**2 / 3 * jerk)
    np.testing.assert_allclose((qd[:, 2:] - qd[:, :-2]) / (2 * dt), qdd[:, 1:-1], rtol=0, atol=dt**2 / 3 * snap)


def test_a_motion_may_begin_where_the_start_does_not_lead_straight() -> None:
    """Round a corner of the reach, and the same backwards: its end is led to from the first sample that is reached."""
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    corner, goal = np.array([3.2457, -1.4401]), np.array([3.3315, -1.4534])
    way = np.concatenate([np.linspace(model.device.closure.at, corner, 300), np.linspace(corner, goal, 1500)]).T
    back = np.ascontiguousarray(way[:, ::-1])
    assert not model.device.closure.closes(back[:, :1])[0]
    np.testing.assert_allclose(
        model.device.closure.positions(back)[:, ::-1], model.device.closure.positions(way), atol=1e-12
    )


def test_unreachable_poses_report_the_missing_length() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    outer, inner = model.device.lengths["outer"], model.device.lengths["inner"]
    for samples in (50, 5000):
        qa = np.linspace([2.356, 0.785], [3.14, 0.0], samples).T
        with pytest.raises(errors.LoopClosureError) as caught:
            model.device.closure.positions(qa)
        one, two = qa[:, caught.value.where]
        apart = np.array([model.device.lengths["apart"], 0.0]) + inner * (
            np.array([np.cos(two), np.sin(two)]) - np.array([np.cos(one), np.sin(one)])
        )
        short = np.linalg.norm(apart) - 2 * outer
        assert 0.7 * short < caught.value.found < 1.01 * short


def test_a_motion_that_is_not_a_number_closes_nowhere() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    qa, _, _ = path(model, 1.0, 1e-3)
    qa[1, 700] = np.nan
    with pytest.raises(errors.SingularityError) as caught:
        model.device.closure.positions(qa)
    assert caught.value.where == 700


@pytest.mark.parametrize("rotor", ["crank", "rocker"])
def test_masses_are_the_torques_of_unit_accelerations(rotor: str, tmp_path: Path) -> None:
    text = (Path(haptid.__file__).parent / "device/library" / "four_bar.toml").read_text()
    term = 'kind = "rotor-inertia"\nmotors = "all"'
    assert term in text
    (tmp_path / "four_bar.toml").write_text(text.replace(term, f'kind = "rotor-inertia"\njoints = ["{rotor}"]'))
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "four_bar.toml"))
    chi = rigid(model, model.device.parameters.S @ bodies(model))
    c, still = np.linspace(0.5, 2.5, 9)[None], np.zeros((1, 9))
    tau = [core_torque(model, chi, c, still, still + cdd) for cdd in (1.0, 0.0)]
    M = core_mass(model, chi, c)
    np.testing.assert_allclose(M[:, 0, 0], (tau[0] - tau[1])[0], rtol=1e-12)
    cdd = ForwardDynamics(model, chi).acceleration(c, still, tau[0])
    np.testing.assert_allclose(cdd, 1.0, rtol=1e-10)


def test_a_branch_that_does_not_reach_the_handle_is_named(tmp_path: Path) -> None:
    """By a handle that is too long for both branches, in a command, and by a pose that is too far for one of them."""
    text = (files("haptid") / "device/library/cea_medical_interface.toml").read_text(encoding="utf-8")
    held = 'body_b = "H"\nframe_b = { r = "-apart" }'
    assert held in text
    (tmp_path / "long.toml").write_text(text.replace(held, 'body_b = "H"\nframe_b = { r = -1.4 }'))
    refused = CliRunner().invoke(app, ["model", str(tmp_path / "long.toml")])
    shown = " ".join(refused.stderr.split())
    assert refused.exit_code == 2
    for part in ("link LB does not reach link H", "U2 = -1", " m apart (limit", "Check the lengths"):
        assert part in shown, shown
    model = haptid.DynamicModel(haptid.read_device("cea_medical_interface"))
    near, far = [0.0, -1.0, 4.0, 0.0, -1.0, 4.0], [0.0, -1.4, 3.6, 0.0, -0.6, 4.4]
    with pytest.raises(errors.LoopClosureError) as caught:
        handle_motion(model, np.array([near, far]).T)
    assert caught.value.where == 1
    assert caught.value.found > 1e3 * caught.value.limit
    assert "link LB does not reach link H" in str(caught.value)
