"""Priors of a device's parameters: CAD bodies and named values as standard parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.device.geometry import Reader
from haptid.device.parameters import INERTIAL
from haptid.device.parts import Joint, Prior
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import AnyDevice, PriorBodyTable, PriorTable

# Rows and columns of XX XY XZ YY YZ ZZ in a tensor.
TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class PriorBody:
    """A rigid body in the link frame of the file's convention.

    Attributes:
        mass: kg.
        com: centre of mass, (3,), m.
        inertia: tensor about the centre of mass, (3, 3), kg m^2; None if unknown.
    """

    mass: float
    com: Array
    inertia: Array | None

    def __post_init__(self) -> None:
        freeze_fields(self, com=(3,), inertia=(3, 3))


def tensor(entries: Array) -> Array:
    """The symmetric tensor, (3, 3), of entries in the order XX YY ZZ XY XZ YZ, (6,)."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertial_parameters(body: PriorBody, joint: Joint) -> Array:
    """The ten parameters of a body, (10,), in the joint's link frame of the normal form; NaN where unknown.

    The tensor is moved from the centre of mass to the frame's origin (Huygens-Steiner).
    """
    R, p = joint.frame_rotation, joint.frame_translation
    com = R @ body.com + p
    chi = np.full(10, np.nan)
    if body.inertia is not None:
        J = R @ body.inertia @ R.T + body.mass * (com @ com * np.eye(3) - np.outer(com, com))
        chi[:6] = [J[i, k] for i, k in TENSOR]
    chi[6:9] = body.mass * com
    chi[9] = body.mass
    return chi


def body_prior(body: PriorBody, joint: Joint, std_percent: float | None) -> dict[str, Prior]:
    """Priors of a link's ten parameters, without those that are unknown.

    `std_percent` gives standard deviations: of the mass, that share of the mass; of a first moment, that share of the
    greatest first moment, or of mass times radius of gyration; of a tensor entry, that share of the largest entry.
    """
    chi = inertial_parameters(body, joint)
    scale = np.empty(10)
    scale[:6] = np.max(np.abs(chi[:6]))
    gyration = 0.0 if body.inertia is None else np.sqrt(body.mass * np.trace(body.inertia) / 2)
    scale[6:9] = max(float(np.max(np.abs(chi[6:9]))), float(gyration))
    scale[9] = body.mass
    stds = scale * (0.0 if std_percent is None else std_percent / 100)
    return {
        kind + joint.name: Prior(float(value), float(std) if std > 0 else None)
        for kind, value, std in zip(INERTIAL, chi, stds, strict=True)
        if np.isfinite(value)
    }


def combined_prior(device: Device, rows: Array) -> tuple[tuple[float, float | None] | None, ...]:
    """Prior value and standard deviation of combinations of the free standard parameters, (k, p); None if unknown."""
    parameters = device.parameters
    std = [_std(device, members) for members in parameters.members]
    combined: list[tuple[float, float | None] | None] = []
    for row in rows:
        used = np.flatnonzero(row)
        if np.isnan(device.chi_prior[used]).any():
            combined.append(None)
            continue
        known = [std[k] for k in used]
        spread = None if None in known else float(np.hypot.reduce([row[k] * (std[k] or 0.0) for k in used]))
        combined.append((float(row[used] @ device.chi_prior[used]), spread))
    return tuple(combined)


def _std(device: Device, members: tuple[str, ...]) -> float | None:
    """Standard deviation of the mean of the members that have a prior, taken as fully correlated."""
    known = [device.prior[name].std for name in members if name in device.prior]
    given_stds = [std for std in known if std is not None]
    return float(np.mean(given_stds)) if given_stds and len(given_stds) == len(known) else None


def read_priors(
    tables: AnyDevice, joints: Sequence[Joint], raw: tuple[str, ...], reader: Reader, place: Place
) -> dict[str, Prior]:
    """The priors of [[prior.bodies]] and [prior], by raw parameter name; the latter take precedence."""
    priors: dict[str, Prior] = {}
    links = [joint.name for joint in joints]
    for k, body in enumerate(tables.prior.bodies):
        body_place = place.at("prior", "bodies", k)
        if body.link not in links:
            raise body_place.at("link").unknown("link", body.link, links)
        if f"M{body.link}" in priors:
            raise body_place.at("link").taken("prior body of link", body.link, "an earlier one")
        percent = None if body.std_percent is None else reader.number(body.std_percent, body_place.at("std_percent"))
        priors |= body_prior(_body(body, reader, body_place), joints[links.index(body.link)], percent)
    for name, value in tables.prior.parameters.items():
        body_place = place.at("prior", name)
        if name not in raw:
            raise body_place.unknown("parameter", name, raw)
        priors[name] = _named_prior(value, reader, body_place)
    return priors


def _named_prior(value: PriorTable | float | str, reader: Reader, place: Place) -> Prior:
    if not isinstance(value, PriorTable):
        return Prior(reader.number(value, place))
    std = None if value.std is None else reader.positive(value.std, place.at("std"))
    return Prior(reader.number(value.value, place.at("value")), std)


def _body(table: PriorBodyTable, reader: Reader, place: Place) -> PriorBody:
    """A CAD body; its mass and inertia must be those of a rigid body."""
    mass = reader.not_negative(table.mass, place.at("mass"))
    inertia = None
    if table.inertia is not None:
        inertia = tensor(np.array([reader.number(v, place.at("inertia", k)) for k, v in enumerate(table.inertia)]))
        least = float(np.linalg.eigvalsh(inertia)[0])
        if least < -1e-9 * float(np.trace(np.abs(inertia))):
            found = f"the least principal moment is {least:.3g} kg m^2"
            raise place.at("inertia").error(found, "Write XX YY ZZ XY XZ YZ of the tensor about the centre of mass.")
    return PriorBody(mass, np.array(reader.triple(table.com, place.at("com"))), inertia)


def unused_priors(prior: Mapping[str, Prior], index: Mapping[str, int]) -> list[str]:
    """A note on priors of parameters that symmetries or massless links set to zero."""
    lost = [name for name, known in prior.items() if name not in index and known.value]
    return [f"prior of {', '.join(lost)} is not used: these parameters are zero in this device"] if lost else []
