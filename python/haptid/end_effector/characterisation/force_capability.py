"""Force capability: the largest force at the handle with limited motor torques, minus the torques for the weight.

The torques tau = B' Gamma that limited motors can exert are a zonotope: |n' tau| <= sum of limit_k |n' b_k| for the
normals n of its facets, each of which is across all but one (of redundant motors, all but several) of the motors. So
the least force over all directions is the least over the facets, and no search is needed.

Source: Bouchard, Gosselin and Moore (2010), ASME J. Mechanisms Robotics 2(1), 011010, section 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.parts import Motor
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.jacobian import HandleJacobian
from haptid.errors import IncompleteDeviceError, RedundancyError, unknown_name

# Most facets of the set of torques.
_MOST_FACETS = 2000


def torque_limits(model: DynamicModel, given: Mapping[str, float] | None) -> Array:
    """Torque limit of each motor's coordinate, (motors,), N m or N: those given, else the joint's in the device.

    Raises:
        IncompleteDeviceError: a motor without a limit, or a limit that is not positive.
        UnknownNameError: a limit of an unknown motor.
    """
    known = given or {}
    made = [known.get(drive.name, limit_of_joint(model, drive)) for drive in model.device.motors]
    for drive, limit in zip(model.device.motors, made, strict=True):
        if limit is None or not (np.isfinite(limit) and limit > 0):
            raise IncompleteDeviceError(
                f"the torque limit of motor {drive.name} is {limit!r}.",
                where=drive.name,
                found=limit,
                advice="Give a finite torque of its coordinate above zero, N m or N, or limits of its joint.",
            )
    names = [drive.name for drive in model.device.motors]
    for name in known:
        if name not in names:
            raise unknown_name(f"a torque limit is given for {name!r}, which is no motor.", name, names)
    return np.array(made, dtype=float)


def limit_of_joint(model: DynamicModel, drive: Motor) -> float | None:
    """Limit of the one joint that a motor drives, at the motor; None where it drives several."""
    limit = model.device.joints[drive.first].torque_limit if np.count_nonzero(drive.row) == 1 else None
    return None if limit is None else limit / abs(float(drive.row[drive.first]))


@dataclass(frozen=True, eq=False)
class TorqueBounds:
    """Facets of the set of torques that limited motors can exert: |normal . torque| <= limit.

    With one motor for each coordinate, the facets are the motors and the products their torques.

    Attributes:
        normals: (poses, facets, active), zero for coordinates whose torque is not measured.
        limits: (poses, facets).
        jacobian: velocity of the handle by the facets' torques, (poses, m, facets).
    """

    normals: Array
    limits: Array
    jacobian: Array

    def of(self, torque: Array) -> Array:
        """Products of the normals with torques of the rows, (active, poses), (poses, facets)."""
        return np.asarray(np.einsum("pfa,ap->pf", self.normals, torque))


def torque_bounds(handle: HandleJacobian, limits: Mapping[str, float] | None) -> TorqueBounds:
    """The facets at every pose, from the motors' limits; arguments as for `torque_limits`.

    Raises:
        RedundancyError: the motors are so redundant that there are more facets than 2000.
    """
    device, most = handle.model.device, torque_limits(handle.model, limits)
    measured = np.flatnonzero(device.measured)
    B = device.drive_jacobian(device.row_map @ handle.qa)
    B = np.broadcast_to(B if B.ndim == 3 else B[None], (len(handle), *B.shape[-2:]))
    if not device.redundant:
        normals = np.swapaxes(np.linalg.inv(B), 1, 2)[:, device.driven]
        size = np.broadcast_to(most, normals.shape[:2])
    else:
        B, n = B[:, device.driven][:, :, measured] * most[:, None], len(measured)
        across = list(combinations(range(B.shape[1]), n - 1))
        if len(across) > _MOST_FACETS:
            raise RedundancyError(
                f"the torques of {B.shape[1]} motors on {n} coordinates are a set of {len(across)} facets.",
                found=len(across),
                limit=_MOST_FACETS,
                advice="Give the limits of fewer motors.",
            )
        normals = np.zeros((len(handle), len(across), len(device.active)))
        normals[:, :, measured] = np.linalg.svd(B[:, np.array(across, dtype=int).reshape(len(across), n - 1)])[2][
            :, :, -1
        ]
        size = np.abs(np.einsum("pfa,pda->pfd", normals[:, :, measured], B)).sum(axis=2)
    moving = normals[:, :, list(handle.moving)]
    return TorqueBounds(normals, size, np.einsum("pma,pfa->pmf", handle.jacobian, moving))


def least_force(bounds: TorqueBounds, held: Array) -> tuple[Array, Array, np.ndarray]:
    """Force in the direction in which it is least, that direction, and the limiting facet.

    A facet is loaded most by a force along its own column of the Jacobian, so the least force over all directions is
    the least of (limit - |held|) / |column|.

    Args:
        bounds: at every pose.
        held: `bounds.of` the torque that carries the device, (poses, facets).
    """
    jacobian = bounds.jacobian
    lengths = np.linalg.norm(jacobian, axis=1)
    available = np.maximum(bounds.limits - np.abs(held), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        force = np.where(lengths > 0, available / lengths, np.inf)
    which = np.argmin(force, axis=1)
    at = np.arange(len(force))
    # The sign for which the force loads the facet like the weight.
    column = jacobian[at, :, which] * np.where(held[at, which] < 0, -1.0, 1.0)[:, None]
    return force[at, which], column / np.linalg.norm(column, axis=1, keepdims=True), which


def force_along(bounds: TorqueBounds, held: Array, direction: Array) -> tuple[Array, Array, np.ndarray]:
    """Largest force along one direction, the limiting facet's load per force, and that facet, (poses,) each.

    The force is infinite where no motor is loaded by it. Motors carry the weight and push: |held + n' J' f d| <= limit.
    """
    load = np.einsum("pmk,m->pk", bounds.jacobian, direction)
    available = np.maximum(bounds.limits - np.sign(load) * held, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        force = np.where(np.abs(load) > 0, available / np.abs(load), np.inf)
    which, at = np.argmin(force, axis=1), np.arange(len(force))
    return force[at, which], load[at, which], which
