"""Known loads: a body of known mass that a log was recorded with, taken off its torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptid._values import Array, freeze
from haptid.device import INERTIAL, Device
from haptid.device.prior import Body, inertial_parameters
from haptid.dynamics import core_torque, raw_parameters
from haptid.errors import LoadSymmetryError, UnknownLinkError
from haptid.late import delayed, lost
from haptid.log import Log, OnDisk
from haptid.signals import coordinates, torque_map
from haptid.treatment import Motion, Treatment, treat


@dataclass(frozen=True, eq=False)
class Load:
    """A known body fixed to a link.

    Attributes:
        link: name of its joint.
        body: in the link frame of the device file's convention.
    """

    link: str
    body: Body


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


def log_without_load(device: Device, log: Log, treatment: Treatment, load: Load) -> Log:
    """The log as it would have been without a load that was fixed to a link while it was recorded.

    The load's torque is made of the positions as they are treated, and comes as late as the torque of the treatment
    does. Where the treatment's filters settle, at the ends, the torque stays as it is: no row is made there.

    Args:
        device: the mechanism.
        log: recorded with the load.
        treatment: of the positions, and how late the torque is.
        load: what was fixed to which link.

    Raises:
        UnknownLinkError, LoadSymmetryError: as `load_shift`.
        NoAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(device, load_shift(device, load.link, load.body))
    channels = np.asarray(np.linalg.pinv(torque_map(device, log)), dtype=np.float64)
    unloaded = Unloaded(device, treat(log, treatment), chi, channels)
    torque = unloaded if isinstance(log.torque, OnDisk) else unloaded.make(0, len(log.t)).T
    said = f"A load of {load.body.mass:g} kg on link {load.link} is taken off the torque: {_figures(load.body)}."
    return replace(log, torque=torque, notes=(*log.notes, said))


def _figures(body: Body) -> str:
    """Where its mass is, and how it is spread."""
    about = "a point" if body.inertia is None else f"inertia {body.inertia.tolist()} kg m^2 about it"
    return f"centre of mass {body.com.tolist()} m, {about}"


@dataclass(frozen=True, eq=False)
class Unloaded(OnDisk):
    """Torque channels of a log without a load, (n, channels), in the log's unit.

    Attributes:
        device: the mechanism.
        motion: the log, treated.
        chi: raw parameters of the load.
        channels: matrix from the coordinates' torques to the channels', (channels, coordinates).
    """

    device: Device
    motion: Motion
    chi: Array
    channels: Array

    @property
    def shape(self) -> tuple[int, int]:
        return self._recorded.torque.shape[0], self._recorded.torque.shape[1]

    @property
    def _recorded(self) -> Log:
        assert self.motion.log is not None  # it was made from one
        return self.motion.log

    def make(self, low: int, high: int) -> Array:
        early = -self.motion.treatment.torque_delay / self.motion.dt
        around = lost(early)
        start, stop = max(low - around, 0), min(high + around, len(self))
        load = delayed(self._load(start, stop).T, early)[low - start : high - start].T
        return np.asarray(self._recorded.torque[low:high].T - load)

    def _load(self, start: int, stop: int) -> Array:
        """Torque of the load in the log's unit, (channels, stop - start); zero where filters settle."""
        low, high = (int(np.clip(edge, start, stop)) for edge in self.motion.usable)
        made = np.zeros((self.shape[1], stop - start))
        if low < high:
            torque = core_torque(self.device, self.chi, *coordinates(self.device, self.motion, low, high))
            made[:, low - start : high - start] = self.channels @ torque
        return made
