"""Known loads: a body of known mass that a log was recorded with, taken off its torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.device import INERTIAL
from haptid.device.priors import Body, inertial_parameters
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import LoadSymmetryError, UnknownLinkError
from haptid.log import Log, OnDisk, as_array
from haptid.motion.channels import coordinates, torque_map
from haptid.motion.time_shift import delayed, lost
from haptid.motion.treatment import Motion, Treatment, treat


@dataclass(frozen=True, eq=False)
class Payload:
    """A known body fixed to a link.

    Attributes:
        link: name of its joint.
        body: in the link frame of the device file's convention.
    """

    link: str
    body: Body


def payload_torque(model: DynamicModel, link: str, body: Body) -> Array:
    """What a body fixed to a link adds to the base parameters, (p,), SI.

    Args:
        model: the dynamic model.
        link: name of its joint.
        body: in the link frame of the device file's convention; its inertia is taken as a point's where None.

    Raises:
        UnknownLinkError: there is no such link.
        LoadSymmetryError: the device file says that a parameter is zero, or the same as another's, which the load's
            is not.
    """
    if link not in model.device.joint_names:
        raise UnknownLinkError(link, model.device.joint_names)
    joint, free = model.device.joints[model.device.joint_names.index(link)], model.device.parameters
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
    return freeze(model.base.of(chi))


def without_payload(model: DynamicModel, motion: Motion, link: str, body: Body) -> Motion:
    """The motion as it would have been without a load that was fixed to a link while it was recorded.

    The load's torque along the motion is taken off the motion's, so that logs with known loads and logs without serve
    one estimate: their observations add.

    Args:
        model: the dynamic model.
        motion: recorded with the load.
        link, body: as for `payload_torque`.

    Raises:
        UnknownLinkError, LoadSymmetryError: as `payload_torque`.
        NoAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(model, payload_torque(model, link, body))
    channels = np.eye(len(model.device.measured))[list(model.device.measured)]
    if motion.log is not None:
        channels = np.asarray(np.linalg.pinv(torque_map(model.device, motion.log)), dtype=np.float64)
    return replace(motion, tau=Unloaded(model, motion, chi, channels, motion.tau, 0.0).samples())


def log_without_payload(model: DynamicModel, log: Log, treatment: Treatment, load: Payload) -> Log:
    """The log as it would have been without a load that was fixed to a link while it was recorded.

    The load's torque is made of the positions as they are treated, and comes as late as the torque of the treatment
    does. Where the treatment's filters settle, at the ends, the torque stays as it is: no row is made there.

    Args:
        model: the dynamic model.
        log: recorded with the load.
        treatment: of the positions, and how late the torque is.
        load: what was fixed to which link.

    Raises:
        UnknownLinkError, LoadSymmetryError: as `payload_torque`.
        NoAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(model, payload_torque(model, load.link, load.body))
    channels = np.asarray(np.linalg.pinv(torque_map(model.device, log)), dtype=np.float64)
    motion = treat(log, treatment)
    torque = Unloaded(model, motion, chi, channels, log.torque, treatment.torque_delay_s / motion.dt).samples()
    said = f"A load of {load.body.mass:g} kg on link {load.link} is taken off the torque: {_figures(load.body)}."
    return replace(log, torque=torque, notes=(*log.notes, said))


def _figures(body: Body) -> str:
    """Where its mass is, and how it is spread."""
    about = "a point" if body.inertia is None else f"inertia {body.inertia.tolist()} kg m^2 about it"
    return f"centre of mass {body.com.tolist()} m, {about}"


@dataclass(frozen=True, eq=False)
class Unloaded(OnDisk):
    """Torque channels without a load, (n, channels), in their own unit.

    Attributes:
        model: the dynamic model.
        motion: what the load went along.
        chi: raw parameters of the load.
        channels: matrix from the coordinates' torques to the channels', (channels, coordinates).
        torque: the channels with the load, (n, channels).
        late: samples that these are ahead of what acts.
    """

    model: DynamicModel
    motion: Motion
    chi: Array
    channels: Array
    torque: Array
    late: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.torque.shape[0], self.torque.shape[1]

    def samples(self) -> Array:
        """Of channels in memory all of it; of channels on disk what is made as it is sliced."""
        return as_array(self) if isinstance(self.torque, OnDisk) else freeze(self.make(0, len(self))).T

    def make(self, low: int, high: int) -> Array:
        around = lost(self.late)
        start, stop = max(low - around, 0), min(high + around, len(self))
        load = self._load(start, stop)
        if self.late:
            load = delayed(load.T, -self.late)[low - start : high - start].T
        return np.asarray(self.torque[low:high].T - load)

    def _load(self, start: int, stop: int) -> Array:
        """Torque of the load in the channels' unit, (channels, stop - start); zero where filters settle."""
        low, high = (int(np.clip(edge, start, stop)) for edge in self.motion.usable)
        made = np.zeros((self.shape[1], stop - start))
        if low < high:
            torque = core_torque(self.model, self.chi, *coordinates(self.model.device, self.motion, low, high))
            made[:, low - start : high - start] = self.channels @ torque
        return made
