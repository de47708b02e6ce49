"""Known payloads: the torque of a body of known inertia is subtracted from the torque of a log recorded with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device import INERTIAL, Device
from haptid.device.priors import PriorBody, inertial_parameters
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import DeviceError, unknown_name
from haptid.log import Log, OnDisk, as_array
from haptid.motion.channels import channel_shares, channel_torque, coordinates, motor_torque
from haptid.motion.motion import Motion, treat
from haptid.motion.streaming import delayed, lost
from haptid.motion.treatment import Treatment


@dataclass(frozen=True, eq=False)
class Payload:
    """Payload: a known body fixed to a link.

    Attributes:
        link: name of its joint.
        body: in the link frame of the device file's convention.
    """

    link: str
    body: PriorBody


def payload_torque(model: DynamicModel, link: str, body: PriorBody) -> Array:
    """Increment of the base parameters by a body fixed to a link, (p,), SI.

    Args:
        link: name of its joint.
        body: in the link frame of the device file's convention; a point mass where its inertia is None.

    Raises:
        UnknownNameError: there is no such link.
        DeviceError: the device file sets a parameter to zero, or equal to another, and the payload does not
            comply.
    """
    if link not in model.device.joint_names:
        message = f"no link {link!r} with free inertial parameters."
        raise unknown_name(message, link, model.device.joint_names, "link")
    joint, free = model.device.joints[model.device.joint_names.index(link)], model.device.parameters
    solid = body if body.inertia is not None else replace(body, inertia=np.zeros((3, 3)))
    values = dict(zip((kind + link for kind in INERTIAL), inertial_parameters(solid, joint), strict=True))
    size = max(abs(value) for value in values.values())
    nonzero = {name: value for name, value in values.items() if abs(value) > np.finfo(float).eps * size}
    shared = [name for name in nonzero if name not in free.index or len(free.members[free.index[name]]) > 1]
    if shared:
        raise DeviceError(
            f"a payload on link {link} has {', '.join(shared)}, which the device file sets to zero or equal to another "
            "parameter.",
            where=link,
            found=tuple(shared),
            advice="Remove these symmetries from the file, or fix the payload so that they hold.",
        )
    chi = np.zeros(len(free.names))
    for name, value in nonzero.items():
        chi[free.index[name]] = value
    return freeze(model.base.of(chi))


def without_payload(model: DynamicModel, motion: Motion, link: str, body: PriorBody) -> Motion:
    """Motion with the torque of a payload subtracted, that was fixed to a link during the recording.

    Logs with known payloads and logs without then serve one estimate: their observations add.

    Args:
        motion: recorded with the payload.
        link, body: as for `payload_torque`.

    Raises:
        UnknownNameError, DeviceError: as `payload_torque`.
        MissingAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(model, payload_torque(model, link, body))
    known = partial(core_torque, model, chi)
    return replace(motion, tau=TorqueWithout(model.device, motion, known, motion.tau, (0.0,)).samples())


def log_without_payload(model: DynamicModel, log: Log, treatment: Treatment, load: Payload) -> Log:
    """Log with the torque of a payload subtracted, that was fixed to a link during the recording.

    The payload's torque is computed from the treated positions and delayed by the treatment's torque delay. At the
    ends, within the transients of the filters, the torque is unchanged: no rows are computed there.

    Args:
        log: recorded with the payload.
        treatment: of the positions, and the torque delay.
        load: the payload.

    Raises:
        UnknownNameError, DeviceError: as `payload_torque`.
        MissingAccelerationError: velocity is by a causal differentiator.
    """
    chi = raw_parameters(model, payload_torque(model, load.link, load.body))
    motion = treat(log, treatment)
    late = tuple(np.atleast_1d(treatment.torque_shift_s) / motion.dt)
    torque = TorqueWithout(model.device, motion, partial(core_torque, model, chi), log.torque, late).samples()
    note = f"A payload of {load.body.mass:g} kg on link {load.link} is subtracted from the torque: {_data(load.body)}."
    return replace(log, torque=torque, notes=(*log.notes, note))


def _data(body: PriorBody) -> str:
    """Centre of mass and inertia as text."""
    about = "a point" if body.inertia is None else f"inertia {body.inertia.tolist()} kg m^2 about it"
    return f"centre of mass {body.com.tolist()} m, {about}"


@dataclass(frozen=True, eq=False)
class TorqueWithout(OnDisk):
    """Torque channels with a known part subtracted, such as a payload's torque, (n, channels), in their own unit.

    Attributes:
        device: whose coordinates the motion has.
        motion: along which the part is computed.
        part: torque of the coordinates from their positions, velocities and accelerations, (coordinates, samples).
            Redundant motors share it by the distribution law.
        torque: the channels as recorded, (n, channels).
        late: samples by which the channels lead the torque at the motion's times, one for all or one for each.
    """

    device: Device
    motion: Motion
    part: Callable[[Array, Array, Array], Array]
    torque: Array
    late: tuple[float, ...]

    @property
    def shape(self) -> tuple[int, int]:
        return self.torque.shape[0], self.torque.shape[1]

    def samples(self) -> Array:
        """All samples where the channels are in memory; on disk where they are, computed when sliced."""
        return as_array(self) if isinstance(self.torque, OnDisk) else freeze(self.make(0, len(self))).T

    def make(self, low: int, high: int) -> Array:
        around = lost(self.late)
        start, stop = max(low - around, 0), min(high + around, len(self))
        load = self._load(start, stop)
        if any(self.late):
            load = delayed(load.T, tuple(-late for late in self.late))[low - start : high - start].T
        return np.asarray(self.torque[low:high].T - load)

    def _load(self, start: int, stop: int) -> Array:
        """The known part in the channels' unit, (channels, stop - start); zero in transients."""
        low, high = (int(np.clip(edge, start, stop)) for edge in self.motion.usable)
        torque = np.zeros((self.shape[1], stop - start))
        if low < high:
            device, c, *rates = self.device, *coordinates(self.device, self.motion, low, high)
            load = channel_torque(device, channel_shares(device, self.motion, c), self.part(c, *rates))
            log = self.motion.log
            if log is not None and log.channels.torque.side == "motor":
                load = load / motor_torque(device, log, np.ones((len(load), 1)))
            torque[:, low - start : high - start] = load
        return torque
