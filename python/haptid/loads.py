"""Known loads: a body of known mass that a log was recorded with, taken off its torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._values import Array, freeze
from haptid.device import INERTIAL, Device
from haptid.device.prior import Body, inertial_parameters
from haptid.dynamics import core_torque, raw_parameters
from haptid.errors import LoadSymmetryError, UnknownLinkError
from haptid.signals import coordinates, torque_map
from haptid.treatment import Motion


def load_shift(device: Device, link: str, body: Body) -> Array:
    """What a body fixed to a link adds to the base parameters, (p,), SI.

    Args:
        device: the mechanism.
        link: name of its joint.
        body: in the link frame of the device file's convention; its inertia is taken as a point's where None.

    Raises:
        UnknownLinkError: there is no such link.
        LoadSymmetryError: the device file says that a parameter is zero, or the same as another's, which the load's
            is not.
    """
    if link not in device.joint_names:
        raise UnknownLinkError(link, device.joint_names)
    joint, free = device.joints[device.joint_names.index(link)], device.parameters
    solid = body if body.inertia is not None else replace(body, inertia=np.zeros((3, 3)))
    values = dict(zip((kind + link for kind in INERTIAL), inertial_parameters(solid, joint), strict=True))
    size = max(abs(value) for value in values.values())
    given = {name: value for name, value in values.items() if abs(value) > np.finfo(float).eps * size}
    shared = [name for name in given if name not in free.index or len(free.members[free.index[name]]) > 1]
    if shared:
        raise LoadSymmetryError(link, shared)
    chi = np.zeros(len(free.names))
    for name, value in given.items():
        chi[free.index[name]] = value
    return freeze(device.base.of(chi))


def without_load(device: Device, motion: Motion, link: str, body: Body) -> Motion:
    """The motion as it would have been without a load that was fixed to a link while it was recorded.

    The load's torque along the motion is taken off the motion's, so that logs with known loads and logs without serve
    one estimate: their observations add.

    Args:
        device: the mechanism.
        motion: recorded with the load.
        link, body: as for `load_shift`.

    Raises:
        UnknownLinkError, LoadSymmetryError: as `load_shift`.
        NoAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(device, load_shift(device, link, body))
    low, high = motion.usable
    torque = core_torque(device, chi, *coordinates(device, motion, low, high))
    tau = np.array(motion.tau[:], dtype=float)
    if motion.log is None:
        tau[low:high] -= torque[list(device.measured)].T
    else:
        channels = np.linalg.pinv(torque_map(device, motion.log))
        tau[low:high] -= (channels @ torque).T
    return replace(motion, tau=tau)
