"""Poses and the handle's Jacobian against Pinocchio, against differences, and against the published closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

import haptid
from haptid import errors
from haptid.dynamics.kinematics import handle_motion, link_poses
from mechanisms import mechanisms, states
from random_devices import as_device


@settings(max_examples=40, deadline=None)
@given(mechanisms(most=8))
def test_poses_and_jacobian_are_pinocchios(mechanism):
    pin = pytest.importorskip("pinocchio", reason="Pinocchio (package `pin`) has no wheel for this platform")
    model = as_device(mechanism)
    qa, _, _ = states(mechanism, 3)
    motion, at = handle_motion(model, qa), link_poses(model, qa)
    pin_model = pin.Model()
    for i, parent in enumerate(mechanism.parent):
        joint = pin.JointModelPZ() if mechanism.prismatic[i] else pin.JointModelRZ()
        pin_model.addJoint(parent + 1, joint, pin.SE3(mechanism.rotation[i], mechanism.translation[i]), f"joint{i}")
    placement = pin.SE3(model.device.handle.rotation, model.device.handle.translation)
    frame = pin_model.addFrame(pin.Frame("handle", len(mechanism.parent), 0, placement, pin.FrameType.OP_FRAME))
    data = pin_model.createData()
    for k in range(3):
        q = mechanism.rates @ qa[:, k] + mechanism.offset
        pin.computeJointJacobians(pin_model, data, q)
        pin.updateFramePlacements(pin_model, data)
        for j in range(len(mechanism.parent)):
            np.testing.assert_allclose(at[k, j], data.oMi[j + 1].homogeneous, atol=1e-12)
        np.testing.assert_allclose(motion.position[k], data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(motion.rotation[k], data.oMf[frame].rotation, atol=1e-12)
        for kind, got in (
            (pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, motion.jacobian),
            (pin.ReferenceFrame.LOCAL, motion.jacobian_in_handle),
        ):
            tree = pin.getFrameJacobian(pin_model, data, frame, kind)
            np.testing.assert_allclose(got[k], tree.reshape(6, -1) @ mechanism.rates, atol=1e-11)


@settings(max_examples=40, deadline=None)
@given(mechanisms(most=8))
def test_jacobian_is_the_derivative_of_the_pose(mechanism):
    model = as_device(mechanism)
    qa, step = states(mechanism, 4)[0], 1e-6
    here = handle_motion(model, qa)
    for k, e in enumerate(np.eye(mechanism.coordinates)):
        ahead, behind = (handle_motion(model, qa + side * step * e[:, None]) for side in (1, -1))
        linear = (ahead.position - behind.position) / (2 * step)
        turned = Rotation.from_matrix(ahead.rotation @ behind.rotation.mT).as_rotvec() / (2 * step)
        scale = 1e-8 * (1 + np.abs(here.jacobian).max()) * (1 + np.abs(mechanism.rates).sum()) ** 2
        np.testing.assert_allclose(here.jacobian[:, :3, k], linear, atol=scale)
        np.testing.assert_allclose(here.jacobian[:, 3:, k], turned, atol=scale)


def test_phantom_jacobian_is_the_published_one():
    """Eq. (15) of Tahmasebi et al. (2005), in the end-point frame, which turns with theta1 and theta3."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    qa = np.column_stack([[0.3, 0.4, 0.5], np.random.default_rng(0).uniform(-1, 1, (3, 20))])
    motion, (q1, q2, q3) = handle_motion(model, qa), qa
    l1, l2, zero, one = 0.215, 0.17, 0 * q1, 1 + 0 * q1
    reach, c23, s23 = l1 * np.cos(q2) + l2 * np.sin(q3), np.cos(q2 - q3), np.sin(q2 - q3)
    wanted = np.array(
        [
            [reach, zero, zero],
            [zero, l1 * c23, zero],
            [zero, -l1 * s23, l2 * one],
            [zero, zero, -one],
            [np.cos(q3), zero, zero],
            [np.sin(q3), zero, zero],
        ]
    ).transpose(2, 0, 1)
    # The handle's frame has x along the forearm, outwards, and z along the joint axis, which is -x of the paper.
    turn = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    got = np.concatenate([turn @ half for half in np.split(motion.jacobian_in_handle, 2, axis=1)], axis=1)
    np.testing.assert_allclose(got, wanted, atol=1e-14)
    paper = motion.rotation @ turn.T
    expected = Rotation.from_rotvec(q1[:, None] * [0, 1, 0]) * Rotation.from_rotvec(-q3[:, None] * [1, 0, 0])
    np.testing.assert_allclose(paper, expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(got[:, :3]), l1 * l2 * reach * c23, atol=1e-15)
    reference = [got[0, 0, 0], got[0, 1, 1], got[0, 2, 1], got[0, 2, 2]]
    np.testing.assert_allclose(reference, [0.27953046, 0.21392590, 0.02146418, 0.17], atol=5e-9)
    place = np.array([reach * np.sin(q1), l1 * np.sin(q2) - l2 * np.cos(q3), reach * np.cos(q1)]).T
    np.testing.assert_allclose(motion.position, place, atol=1e-15)


def test_row_jacobian_takes_forces_to_coupled_motors():
    """Power at the handle is power at the torque rows."""
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    rng = np.random.default_rng(1)
    qa, rates = rng.uniform(-0.5, 0.5, (2, 3, 5))
    motion, wrench = handle_motion(model, qa), rng.normal(size=(5, 6))
    velocity = np.einsum("nij,jn->ni", motion.jacobian, rates)
    rows = np.einsum("nij,ni->nj", motion.row_jacobian, wrench)
    np.testing.assert_allclose((rows * (model.device.row_map @ rates).T).sum(1), (wrench * velocity).sum(1), atol=1e-14)


def test_a_device_without_handle_has_no_handle_motion():
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        handle_motion(haptid.DynamicModel(haptid.read_device("emps")), np.zeros((1, 2)))
    assert raised.value.where == haptid.read_device("emps").name


def test_positions_that_do_not_fit_are_an_error():
    with pytest.raises(errors.ShapeError, match="qa"):
        link_poses(haptid.DynamicModel(haptid.read_device("phantom_premium_15")), np.zeros((2, 5)))
