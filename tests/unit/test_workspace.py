"""Limits of a workspace, its grid, and what definiteness says of mixed and unmeasured coordinates."""

import numpy as np
import pytest
from hypothesis import given, settings

import haptid
from haptid import errors
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.workspace import Box, Workspace, workspace
from haptid.end_effector.definiteness import definiteness
from mechanisms import draw, mechanisms
from motions import motion, truth
from random_devices import as_device, parameters


def two_dof(seed=3, kinds=("rotor",)):
    """A mechanism whose mass matrix is positive definite, with its parameters."""
    mechanism = draw(seed, joints=2, closed=False)
    model = as_device(mechanism, kinds)
    return model, model.base.of(parameters(mechanism, model))


def test_the_files_limits_are_the_default_and_can_be_replaced():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    where = workspace(model)
    np.testing.assert_allclose(np.degrees(where.limits), [[-90, 90], [-124, 119], [-29, 214]])
    assert where.couplings == ("a",)
    assert where.coupled == (3,)
    np.testing.assert_allclose(np.degrees(where.ranges), [[-65, 55]])
    other = workspace(model, {"be": (-0.5, 0.5), "df": None, "a": None})
    np.testing.assert_allclose(other.limits[1:], [[-0.5, 0.5], [-np.pi, np.pi]])
    assert other.couplings == ()


def test_the_grid_is_inside_all_limits():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    where = workspace(model, box=Box((-0.1, -0.2, 0.1), (0.1, 0.0, 0.3)))
    poses = where.grid(5000)
    assert where.holds(poses).all()
    place = handle_motion(model, poses).position
    assert (place >= [-0.1, -0.2, 0.1]).all()
    assert (place <= [0.1, 0.0, 0.3]).all()
    assert not where.holds(np.array([[0.0], [0.0], [np.radians(60)]]))[0]


@settings(max_examples=10, deadline=None)
@given(mechanisms(most=5, closed=False))
def test_no_pose_has_a_smaller_eigenvalue(mechanism):
    model = as_device(mechanism, ("rotor",))
    beta = model.base.of(parameters(mechanism, model))
    where = workspace(model)
    found = definiteness(beta, where)
    rng = np.random.default_rng(0)
    poses = rng.uniform(-1, 1, (mechanism.coordinates, 2000))
    least = np.linalg.eigvalsh(mass_matrix(model, beta, poses)).min()
    assert found.smallest <= least * (1 + 1e-6)
    assert found.positive
    M = mass_matrix(model, beta, found.at[:, None])[0]
    np.testing.assert_allclose(M @ found.direction, found.smallest * found.direction, atol=1e-9 * np.abs(M).max())
    if len({joint.prismatic for joint in model.device.joints}) == 1:
        assert "has a meaning" not in found.summary()


def test_the_figure_does_not_depend_on_the_grid(monkeypatch):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    fine = definiteness(beta, workspace(model)).smallest
    monkeypatch.setattr(Workspace.grid, "__defaults__", (500,))
    assert definiteness(beta, workspace(model)).smallest == pytest.approx(fine, rel=1e-7)


def test_an_estimate_has_a_deviation_and_is_of_one_device():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    observation = haptid.observe(model, motion(model, beta, seconds=6.0, noise=0.05))
    estimate = haptid.estimate(observation, haptid.WLS())
    found, exact = definiteness(estimate, workspace(model)), definiteness(beta, workspace(model))
    assert 0 < found.se < 0.05 * found.smallest
    assert abs(found.smallest - exact.smallest) < 5 * found.se
    assert exact.se is None
    assert "standard error" in found.summary()
    with pytest.raises(errors.ModelMismatchError):
        definiteness(estimate, workspace(haptid.DynamicModel(haptid.read_device("phantom_premium_15"))))


def test_a_negative_rotor_makes_a_direction_that_fails():
    mechanism = draw(3, joints=2, closed=False)
    model = as_device(mechanism, ("rotor",))
    chi = parameters(mechanism, model)
    chi[-1] = -50.0
    found = definiteness(model.base.of(chi), workspace(model))
    assert not found.positive
    assert found.share == 1.0
    assert "100 % of the workspace" in found.summary()
    assert "joint 2" in found.summary()


def test_limits_of_nothing_or_upside_down_are_errors():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    with pytest.raises(errors.WorkspaceError) as raised:
        workspace(model, {"elbow": (0.0, 1.0)})
    assert raised.value.where == "elbow"
    for pair in ((1.0, 0.0), (0.0, np.inf), (0.0,), 3, ("a", "b"), "ab", (0.0, None)):
        with pytest.raises(errors.WorkspaceError) as raised:
            workspace(model, {"be": pair})
        assert raised.value.where == "be"
    with pytest.raises(errors.WorkspaceError) as raised:
        Box((0.0, 1.0, 0.0), (1.0, 0.0, 1.0))
    assert raised.value.where == "box y"
    for corner in ((0, 0), 3.0):
        with pytest.raises(errors.WorkspaceError) as raised:
            Box(corner, (1, 1))
        assert raised.value.where == "box low"


def test_definiteness_of_what_is_no_number_is_an_error():
    model, beta = two_dof()
    with pytest.raises(errors.SettingError):
        definiteness(np.full_like(beta, np.nan), workspace(model))
    with pytest.raises(errors.ShapeError):
        definiteness(beta[1:], workspace(model))


def test_a_sliding_joint_needs_limits():
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        workspace(haptid.DynamicModel(haptid.read_device("emps")), {"1": None})
    assert raised.value.where == "1"


def test_a_workspace_without_poses_is_an_error():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    with pytest.raises(errors.WorkspaceError) as raised:
        workspace(model, box=Box((5.0, 5.0, 5.0), (6.0, 6.0, 6.0))).grid()
    assert raised.value.found > 0


def test_a_box_needs_a_handle():
    with pytest.raises(errors.IncompleteDeviceError):
        workspace(
            haptid.DynamicModel(haptid.read_device("emps")), {"1": (0.0, 0.2)}, Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        )
