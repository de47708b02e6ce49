"""Elastic motors: the rotor of a motor behind a spring is a joint of its own, so that the model stays linear.

Source: Spong (1987), J. Dyn. Sys. Meas. Control 109(4), (17)-(18): rotors have inertia about their own axes only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.device.loops.formula import AnyClosure
from haptid.device.parts import Joint, Motor
from haptid.device.toml.errors_at import Place
from haptid.device.toml.terms import AnyTerm, ElasticTerm, PlainTerm

# Prefix of the name of a rotor's joint, of that of a drive that only springs move, and of a torque sensor's.
ROTOR, LINK, SENSOR = "rotor_", "link_", "sensor_"
# Prefix of the name of the joint that stands for the torsion where a sensor measures the torque of the spring.
TORSION = "torsion_"


@dataclass(frozen=True)
class Behind:
    """An elastic motor in a device file: the place of its term, and whether the torque of its spring is measured."""

    place: Place
    sensor: bool


def elastic_motors(terms: Sequence[AnyTerm], drives: Sequence[Motor], place: Place) -> Mapping[str, Behind]:
    """The motors behind a spring, by name.

    Raises:
        DeviceFileError: a term names no motor, an unknown one, or one that has a spring already, or a motor behind a
            spring has no rotor inertia of its own.
    """
    names, made = [drive.name for drive in drives if drive.motorised], dict[str, Behind]()
    for k, term in enumerate(terms):
        if isinstance(term, ElasticTerm):
            here = place.at(k)
            if term.joints is not None or term.motors is None:
                raise here.error("an elastic term acts on motors", 'Write motors = "all" or motors = ["1"].')
            for i, name in enumerate(_motors(term, names)):
                if name not in names:
                    raise here.at("motors", i).unknown("motor", name, names)
                if name in made:
                    raise here.at("motors", i).taken("motor", name, str(made[name].place))
                made[name] = Behind(here, term.sensor)
    inert = {n for t in terms if isinstance(t, PlainTerm) and t.kind == "rotor-inertia" for n in _motors(t, names)}
    for name, behind in made.items():
        if name not in inert:
            raise behind.place.error(
                f"motor {name} is elastic, and its rotor has no inertia",
                f'Add [[terms]] kind = "rotor-inertia", motors = ["{name}"].',
            )
    return made


def _motors(term: AnyTerm, names: Sequence[str]) -> Sequence[str]:
    return names if term.motors == "all" else term.motors or ()


def with_rotors(
    joints: Sequence[Joint], drives: Sequence[Motor], elastic: Mapping[str, Behind]
) -> tuple[tuple[Joint, ...], tuple[Motor, ...]]:
    """The joints with those of the elastic motors' rotors, and the motors, of which elastic ones turn their rotors.

    A rotor turns about z of the base: it has inertia about its own axis only, so that its place does not matter. Where
    the torque of a spring is measured, its torsion is a joint of its own as well, without inertia, and the sensor is a
    drive of load side less rotor plus torsion, which is zero. By virtual work it exerts the torque that it measures on
    the load side and on the spring, and takes it from the rotor: three rows with a measured torque each.

    Raises:
        DeviceFileError: a joint has the name of a rotor or of a torsion.
    """
    names = [joint.name for joint in joints]
    sensed = [drive for drive in drives if drive.name in elastic and elastic[drive.name].sensor]
    own = [(ROTOR, drive) for drive in drives if drive.name in elastic] + [(TORSION, drive) for drive in sensed]
    for prefix, drive in own:
        if f"{prefix}{drive.name}" in names:
            what = f"the {prefix.strip('_')} of motor {drive.name}"
            raise elastic[drive.name].place.taken("joint", f"{prefix}{drive.name}", what)
    added = [_massless(f"{prefix}{drive.name}", joints[drive.first].prismatic) for prefix, drive in own]
    units = dict(zip((joint.name for joint in added), np.eye(len(joints) + len(added))[len(joints) :], strict=True))
    made, sensors = [], []
    for drive in drives:
        row = np.pad(drive.row, (0, len(added)))
        if drive.name not in elastic:
            made.append(replace(drive, row=row))
            continue
        rotor, torsion = units[f"{ROTOR}{drive.name}"], units.get(f"{TORSION}{drive.name}")
        made.append(replace(drive, row=rotor, load_side=row, sensed=torsion))
        if torsion is not None:
            unit = "N" if joints[drive.first].prismatic else "N m"
            sensors.append(Motor(f"{SENSOR}{drive.name}", 1.0, 1.0, unit, row - rotor + torsion, sensor=True))
    return (*joints, *added), (*made, *sensors)


def _massless(name: str, prismatic: bool) -> Joint:
    """A joint of the base without body."""
    unit, zero = np.eye(3), np.zeros(3)
    return Joint(name, -1, prismatic, unit, zero, False, None, None, None, unit, zero)


def with_link_drives(
    joints: Sequence[Joint],
    active: Sequence[int],
    drives: Sequence[Motor],
    closure: AnyClosure,
    elastic: Mapping[str, Behind],
) -> tuple[Motor, ...]:
    """The drives and one for every active joint that only springs move: its torque is known to be zero.

    Raises:
        DeviceFileError: the link side of an elastic motor is a combination of joints that varies with the pose.
    """
    for drive in drives:
        if drive.load_side is not None and closure.varying[drive.load_side != 0].any():
            raise elastic[drive.name].place.error(
                f"motor {drive.name} moves a joint whose rates vary with the pose, and cannot be elastic",
                "Choose the active joints of the loop among those that elastic motors move.",
            )
    random = np.where(closure.varying, np.random.default_rng(0).uniform(0.5, 1.5, closure.varying.shape), 0.0)
    G = closure.constant + random
    made, rows = list(drives), np.array([drive.row for drive in drives]) @ G
    for k in active:
        own = np.eye(len(joints))[k]
        more = np.concatenate([rows, [own @ G]])
        if np.linalg.matrix_rank(more) > np.linalg.matrix_rank(rows):
            unit = "N" if joints[k].prismatic else "N m"
            made.append(Motor(f"{LINK}{joints[k].name}", 1.0, 1.0, unit, own, motorised=False, unloaded=True))
            rows = more
    return tuple(made)


def row_map(drives: Sequence[Motor], active: Sequence[int], closure: AnyClosure, joint_rows: bool) -> Array:
    """B: coordinates of the torque rows are c = B qa, (active, active).

    The drives' Jacobian if rows are the motors', the identity if they are the joints'. The coordinate of an elastic
    motor is its torsion, the rotor's position less the link side's: all rows then contain a measured torque. With a
    torque sensor they do as they are.
    """
    G = closure.constant
    made = np.eye(len(active)) if joint_rows else np.array([drive.row for drive in drives]) @ G
    for k, drive in enumerate(drives):
        if drive.load_side is not None and drive.sensed is None:
            row = list(active).index(drive.first) if joint_rows else k
            made[row] = drive.torsion @ G
    return made


def rotors(device: Device) -> list[int]:
    """Indices of the elastic motors' rotors in the active joints."""
    return [device.active.index(drive.first) for drive in device.elastic]


def without_torsion(device: Device, links: Array, position: bool) -> Array:
    """Motion of all active joints without torsion, (n, active), from that of those that are no rotors, (n, links).

    Args:
        device: the device.
        links: positions or rates.
        position: whether they are positions.
    """
    own, made = rotors(device), np.zeros((len(links), len(device.active)))
    made[:, np.delete(np.arange(len(device.active)), own)] = links
    for k, drive in zip(own, device.elastic, strict=True):
        behind = drive.row - drive.torsion
        offset = float(behind @ device.closure.offset) if position else 0.0
        made[:, k] = made @ (behind @ device.closure.constant) + offset
    return made


def torsion_places(device: Device) -> list[int]:
    """Indices of the torque rows' coordinates that are torsions of elastic motors."""
    if device.torque_rows == "joint":
        return rotors(device)
    return [k for k, drive in enumerate(device.drives) if drive.load_side is not None]
