"""dVRK export, `export_dvrk(model, folder)`: gravity compensation of a Master Tool Manipulator of the da Vinci Kit.

Its controller has a fixed law: ten gravity terms over joints 2 to 6, and a polynomial of fourth order of each joint's
position, once for positive and once for negative velocities. Whatever device is identified, its torque at rest is
fitted by that law over random poses; what the law lacks, such as the weight of the gripper about joint 7, is stated,
and a device that it does not describe is refused.

Source: sawIntuitiveResearchKit, robGravityCompensationMTM, version 2 of the file; Lin et al., "A Reliable Gravity
Compensation Control Strategy for dVRK Robotic Arms With Nonlinear Disturbance Forces", RA-L 2019.
"""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.escaping import json_text
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, about, provenance

# Joints of the arm; those with terms; terms of gravity; gravity in the law, m/s^2.
_JOINTS, _WITH_TERMS, _TERMS, _GRAVITY = 7, 6, 10, 9.81
# Coefficients of a joint's polynomial, from order 0.
_ORDERS = 5
# Relative difference of torque at rest from the law's, above which a device is no such arm: that of another arm with
# seven joints is above a half, that of the weight of a gripper about joint 7 some per cent.
LAW_ERROR = 0.05
# Velocity, rad/s, whose friction is dry friction.
_CREEP = 1e-9
# Velocities between which the share of friction rises, rad/s, and that share: as `friction_compensation` in C begins.
_DEAD_BAND, _SATURATION, _SHARE = 0.01, 0.1, 0.5
_POSES = 400


def export_dvrk(identified: ExportSource, folder: str | Path, **criterion: Unpack[ExportCriterion]) -> Export:
    """Write gravity compensation of a Master Tool Manipulator for the dVRK console.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of gc-NAME.json.

    Raises:
        UnvalidatedModelError, OutputFolderError: as in `export_c`.
        ExportError: the device is no such arm, or a torque limit of its joints is not known.
    """
    source = provenance(identified, **criterion)
    name = f"gc-{default_name(source.model.device.name)}.json"
    return write(folder, {name: json_text(_values(source))}, source.verdict)


def law(q: Array) -> Array:
    """Regressor of the controller's law, torque per dynamic parameter, (7, 40, samples); q is (7, samples), rad.

    The gravity terms are derivatives of ten heights by the positions of the joints.
    """
    made = np.zeros((_JOINTS, _TERMS + _ORDERS * _WITH_TERMS, q.shape[1]))
    for joint in range(1, _WITH_TERMS):
        # Heights are sums of products of sines and cosines of one multiple: a quarter turn on is the derivative.
        ahead, behind = (_heights(q + sign * 0.5 * np.pi * np.eye(_JOINTS)[:, [joint]]) for sign in (1, -1))
        made[joint, :_TERMS] = 0.5 * _GRAVITY * (ahead - behind)
    for joint in range(_WITH_TERMS):
        first = _TERMS + _ORDERS * joint
        made[joint, first : first + _ORDERS] = q[joint] ** np.arange(_ORDERS)[:, None]
    return made


def _heights(q: Array) -> Array:
    """Ten heights whose combinations are the height of every body of the arm, (10, samples)."""
    s2, c2 = np.sin(q[1]), np.cos(q[1])
    s23, c23 = np.sin(q[1] + q[2]), np.cos(q[1] + q[2])
    (s4, s5, s6), (c4, c5, c6) = np.sin(q[3:6]), np.cos(q[3:6])
    along, across = c23 * c5 - s23 * c4 * s5, c23 * s5 + s23 * c4 * c5
    side = s23 * s4
    return np.stack(
        [-c2, s2, s23, c23, s23 * c4, -side, along, across, side * s6 - across * c6, side * c6 + across * s6]
    )


def _values(source: Provenance) -> dict[str, object]:
    """Content of the file."""
    model = source.model
    joints = [model.device.joints[j] for j in model.device.active]
    if len(joints) != _JOINTS or len(model.device.row_map) != _JOINTS or any(joint.prismatic for joint in joints):
        raise _no_arm(model, f"it has {len(joints)} active joints, and the arm has {_JOINTS} that turn")
    upper = [joint.torque_limit for joint in joints]
    if any(limit is None for limit in upper):
        unknown = [joint.name for joint, limit in zip(joints, upper, strict=True) if limit is None]
        raise ExportError(
            f"the controller limits every torque, and the limits of {', '.join(unknown)} are not known.",
            where=model.device.name,
            found=unknown,
            advice="Give these joints `limits = { torque = ... }` in the device file.",
        )
    most = [float(limit) for limit in upper if limit is not None]
    (positive, missed), (negative, _) = (_fitted(model, source.beta, sign) for sign in (1.0, -1.0))
    lacking = f"The law of the controller lacks {100 * missed:.2g} % of the torque at rest of this model."
    return {
        "version": "2.0",
        "about": [*(line for line in about(source) if line), lacking],
        "GC_controller": {
            "gc_dynamic_params_pos": positive.tolist(),
            "gc_dynamic_params_neg": negative.tolist(),
            "safe_upper_torque_limit": most,
            "safe_lower_torque_limit": [-limit for limit in most],
            "db_vel_vec": [_DEAD_BAND] * _JOINTS,
            "sat_vec_vec": [_SATURATION] * _JOINTS,
            "fric_comp_ratio_vec": [_SHARE] * _JOINTS,
        },
    }


def _fitted(model: DynamicModel, beta: Array, sign: float) -> tuple[Array, float]:
    """Parameters of the law, (40,), for torque at rest and dry friction of one direction; what is missed, relative."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_JOINTS, _POSES))
    torque = inverse_dynamics(model, beta, q, np.full_like(q, sign * _CREEP), np.zeros_like(q))
    W = law(q).transpose(0, 2, 1).reshape(_JOINTS * _POSES, -1)
    found = np.asarray(np.linalg.lstsq(W, torque.reshape(-1), rcond=None)[0], dtype=np.float64)
    missed = float(np.linalg.norm(torque.reshape(-1) - W @ found) / np.linalg.norm(torque))
    if not missed < LAW_ERROR:
        raise _no_arm(model, f"{100 * missed:.2g} % of its torque at rest is not in the law of that arm's controller")
    return found, missed


def _no_arm(model: DynamicModel, what: str) -> ExportError:
    return ExportError(
        f"{model.device.name} is no Master Tool Manipulator of the dVRK: {what}.",
        where=model.device.name,
        advice="The format has the gravity terms of that arm alone, and none of joint 7; export to c or ros2-control.",
    )
