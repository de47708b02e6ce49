"""The check of an import: torques of the device against those of the source's own tree, and gaps of its loops."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.device.toml.reader import checked_tables, device_of
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import LoopClosureError, RobotFileError
from haptid.robot_files.loops import gaps_at
from haptid.robot_files.moving_tree import MovingTree
from haptid.robot_files.newton_euler import source_link_poses, tree_torque

# Largest difference of torques relative to the greatest torque, and largest gap of a loop, m. Rounding alone makes 1e-9
# where parameters exist only through the rounding of angles; a wrong import makes a millionth at least.
LARGEST_ERROR, LARGEST_GAP = 1e-8, 1e-9
_STATES = 30


@dataclass(frozen=True)
class Check:
    """How far the device is from its source.

    Attributes:
        states: random states that were compared.
        torque: greatest difference of a torque, relative to the greatest torque.
        gap: greatest gap of a loop of the source at the device's positions, m; 0 without loops.
        others: greatest relative difference from other programs, by their names.
    """

    states: int
    torque: float
    gap: float
    others: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ComparedStates:
    """Random states of a device, its torques there, and the motion of the source's joints.

    Attributes:
        q, qd, qdd: of every joint by its name in the source, each (n,).
        rows: map from torques of the source's joints to the device's rows at every state, (n, rows, joints).
        torque: of the device with its prior values, (rows, n).
    """

    q: Mapping[str, Array]
    qd: Mapping[str, Array]
    qdd: Mapping[str, Array]
    rows: Array
    torque: Array


def device_from(text: str, file: str = "device.toml") -> Device:
    """The device of a text, without a file."""
    return device_of(*checked_tables(tomllib.loads(text), file))


def random_states(device: Device, names: Mapping[str, str], moving: list[str]) -> ComparedStates:
    """Random states and the device's torques there.

    Args:
        device: with prior values.
        names: the device's names of the source's joints.
        moving: the source's joints that the torques are compared for.
    """
    rng = np.random.default_rng(7)
    model = DynamicModel(device)
    qa = device.closure.draw(rng, _STATES)
    qda, qdda = rng.uniform(-2, 2, (2, *qa.shape))
    q, qd, qdd = model.tree(qa, qda, qdda)
    G = np.asarray(device.closure.follow(qa, qda).G)
    G = np.broadcast_to(G, (qa.shape[1], *G.shape[-2:]))
    index = [device.joint_names.index(names[name]) for name in moving]
    torque = inverse_dynamics(model, model.prior_beta, qa, qda, qdda)
    rows = np.einsum("ra,nja->nrj", np.linalg.inv(device.row_map).T, G[:, index])
    by_name = [{name: x[k] for name, k in zip(moving, index, strict=True)} for x in (q, qd, qdd)]
    return ComparedStates(by_name[0], by_name[1], by_name[2], rows, torque)


def difference(states: ComparedStates, joint_torque: Array, without_friction: Array | None = None) -> float:
    """Greatest difference of torques relative to the greatest torque, friction aside, which would hide the rest.

    Args:
        states: of the device.
        joint_torque: of the source's joints, (joints, n).
        without_friction: the same without damping and friction.
    """
    bodies = joint_torque if without_friction is None else without_friction
    wanted, sizes = (np.einsum("nrj,jn->rn", states.rows, x) for x in (joint_torque, bodies))
    size = float(np.abs(sizes).max(initial=0.0)) or float(np.abs(wanted).max(initial=0.0))
    return float(np.abs(states.torque - wanted).max(initial=0.0)) / (size or 1.0)


def check(of: MovingTree, device: Device, names: Mapping[str, str]) -> tuple[Check, ComparedStates]:
    """Compare a device that has its priors with the tree that it was written from.

    Raises:
        RobotFileError: they differ, or a loop does not close.
    """
    moving = [one.joint.name for one in of.moving]
    states = random_states(device, names, moving)
    torques = (tree_torque(of, states.q, states.qd, states.qdd, friction) for friction in (True, False))
    torque = difference(states, *torques)
    gap = float(gaps_at(of, source_link_poses(of, states.q, len(states.rows))).max(initial=0.0))
    if not torque < LARGEST_ERROR:
        raise RobotFileError(
            f"{of.tree.file}: the device's torques differ from the source's by {torque:.1e} of the greatest one (limit "
            f"{LARGEST_ERROR:g}).",
            where=of.tree.file,
            found=torque,
            limit=LARGEST_ERROR,
            advice="Nothing was written. Please report this with the file.",
        )
    if not gap < LARGEST_GAP:
        raise LoopClosureError(
            f"{of.tree.file}: a loop of the source is open by {gap:.1e} m at the device's positions (limit "
            f"{LARGEST_GAP:g} m).",
            where=of.tree.file,
            found=gap,
            limit=LARGEST_GAP,
            advice="Check the lengths of its links.",
        )
    return Check(len(states.rows), torque, gap, {}), states
