"""Kinematics: poses of links and handle, and the handle's Jacobian with respect to the active joints."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, cross_product, expect, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.device import Handle, poses
from haptid.dynamics.model import DynamicModel
from haptid.errors import IncompleteDeviceError


@dataclass(frozen=True, eq=False)
class HandleMotion:
    """Pose and Jacobian of the handle at some positions; linear rows first, angular rows after.

    The Jacobian maps rates of the active joints to the velocity of the handle's origin and the angular velocity of
    its frame. Its transpose maps a wrench at the handle's origin to torques of the active joints.

    Attributes:
        qa: positions of the active joints, (active, samples), rad or m.
        position: of the handle's origin in the base frame, (samples, 3), m.
        rotation: of its frame in the base frame, (samples, 3, 3).
        jacobian: in the base frame, (samples, 6, active), m/rad or 1, and rad/rad or rad/m.
    """

    model: DynamicModel
    qa: Array
    position: Array
    rotation: Array
    jacobian: Array

    def __post_init__(self) -> None:
        samples, active = self.qa.shape[1], len(self.model.device.active)
        freeze_fields(self, "qa", position=(samples, 3), rotation=(samples, 3, 3), jacobian=(samples, 6, active))

    @cached_property
    def jacobian_in_handle(self) -> Array:
        """The Jacobian with components along the handle's own axes, (samples, 6, active)."""
        return freeze(np.concatenate([self.rotation.mT @ half for half in np.split(self.jacobian, 2, axis=1)], axis=1))

    @cached_property
    def row_jacobian(self) -> Array:
        """The Jacobian with respect to the torque rows' coordinates, in the base frame, (samples, 6, active).

        Its transpose maps a wrench to the torque rows; equal to `jacobian` where rows are the active joints'.
        """
        return freeze(self.jacobian @ np.linalg.inv(self.model.device.row_map))


def link_poses(model: DynamicModel, qa: ArrayLike) -> Array:
    """Poses of all links' frames (normal form, z along the joint axis) in the base frame, (samples, joints, 4, 4), m.

    Args:
        qa: positions of the active joints, (active, samples), rad or m.

    Raises:
        ShapeError: the array does not fit the device.
    """
    return freeze(poses(model.device, tree_positions(model, qa).T))


def handle_motion(model: DynamicModel, qa: ArrayLike) -> HandleMotion:
    """Pose and Jacobian of the handle.

    Column j of a tree's Jacobian is z x (p - o), z for a turning joint and z, 0 for a sliding one (Siciliano et al.
    2009, eq. 3.30), where joint j carries the handle; the loop constraints then project it: J = J_tree G.

    Args:
        qa: positions of the active joints, (active, samples), rad or m.

    Raises:
        IncompleteDeviceError: the device has no handle.
        ShapeError: the array does not fit the device.
    """
    qa, handle = np.asarray(qa, dtype=float), handle_of(model)
    expect("qa", qa.shape, (len(model.device.active), None))
    followed = model.device.closure.follow(qa)
    pose = poses(model.device, followed.q.T)
    link_pose = np.broadcast_to(np.eye(4), (qa.shape[1], 4, 4)) if handle.link < 0 else pose[:, handle.link]
    position = link_pose[:, :3, :3] @ handle.translation + link_pose[:, :3, 3]
    tree = np.zeros((qa.shape[1], 6, len(model.device.joints)))
    link = handle.link
    while link >= 0:
        axis, joint = pose[:, link, :3, 2], model.device.joints[link]
        if joint.prismatic:
            tree[:, :3, link] = axis
        else:
            tree[:, :3, link] = cross_product(axis, position - pose[:, link, :3, 3])
            tree[:, 3:, link] = axis
        link = joint.parent
    return HandleMotion(model, qa, position, link_pose[:, :3, :3] @ handle.rotation, tree @ followed.G)


def handle_of(model: DynamicModel) -> Handle:
    """The device's handle.

    Raises:
        IncompleteDeviceError: it has none.
    """
    if model.device.handle is None:
        raise IncompleteDeviceError(
            f"{model.device.name} has no handle.",
            where=model.device.name,
            advice="Add [handle] with its link and xyz to the device file.",
        )
    return model.device.handle


def tree_positions(model: DynamicModel, qa: ArrayLike) -> Array:
    """Positions of all joints, (joints, samples), from the active ones', (active, samples), rad or m."""
    qa = np.asarray(qa, dtype=float)
    expect("qa", qa.shape, (len(model.device.active), None))
    return model.device.closure.positions(qa)
