"""Inverse dynamics of a neutral tree, link by link as the source has them: what an import is checked against.

It shares nothing with the device file and the core: no merged bodies, no normal form of joint axes, no base parameters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from haptid._internal.arrays import Array
from haptid.robot_files.moving_tree import MovingTree


def source_link_poses(of: MovingTree, q: Mapping[str, Array], samples: int) -> dict[str, tuple[Array, Array]]:
    """Rotation (n, 3, 3) and origin (n, 3) of every link in the base frame.

    Args:
        of: the tree.
        q: position of every moving joint by name, (n,).
        samples: n.
    """
    return {name: state[:2] for name, state in _states(of, q, q, q, samples)[0].items()}


def tree_torque(
    of: MovingTree, q: Mapping[str, Array], qd: Mapping[str, Array], qdd: Mapping[str, Array], friction: bool = True
) -> Array:
    """Torque of every moving joint, (moving, n), N m or N: bodies, armature, springs, tendons, damping and friction.

    Source: Luh, Walker and Paul (1980), in the base frame.

    Args:
        of: the tree.
        q, qd, qdd: motion of every moving joint by name, each (n,).
        friction: whether damping and friction are included.
    """
    samples = len(next(iter(q.values())))
    states, axes = _states(of, q, qd, qdd, samples)
    gravity = of.base[:3, :3].T @ of.tree.gravity
    force = {name: np.zeros((samples, 3)) for name in states}
    moment = {name: np.zeros((samples, 3)) for name in states}
    moving = {one.joint.name: k for k, one in enumerate(of.moving)}
    made = np.zeros((len(of.moving), samples))
    for joint in reversed(of.tree.joints):
        link = joint.child
        if link not in states or joint.parent not in states:
            continue
        R, p, w, wd, a = states[link]
        inertial = of.tree.links[link].inertial
        if inertial is not None:
            arm = np.einsum("nij,j->ni", R, inertial.com)
            J = R @ inertial.inertia @ R.transpose(0, 2, 1)
            accelerated = a - gravity + np.cross(wd, arm) + np.cross(w, np.cross(w, arm))
            own = inertial.mass * accelerated
            Jw = np.einsum("nij,nj->ni", J, w)
            force[link] += own
            moment[link] += np.einsum("nij,nj->ni", J, wd) + np.cross(w, Jw) + np.cross(arm, own)
        force[joint.parent] += force[link]
        moment[joint.parent] += moment[link] + np.cross(p - states[joint.parent][1], force[link])
        if joint.name in moving:
            carried = force[link] if joint.kind == "prismatic" else moment[link]
            v = qd[joint.name]
            made[moving[joint.name]] = (
                (axes[joint.name] * carried).sum(axis=1)
                + joint.armature * qdd[joint.name]
                + friction * (joint.damping * v + joint.friction * np.sign(v))
                + joint.stiffness * (q[joint.name] - joint.rest)
            )
    for tendon in of.tendons:
        c = np.array(list(tendon.factors.values()))
        x, v, a = (c @ np.array([values[name] for name in tendon.factors]) for values in (q, qd, qdd))
        force = tendon.stiffness * (x - tendon.rest) + tendon.armature * a
        force = force + friction * (tendon.damping * v + tendon.friction * np.sign(v))
        for name, factor in tendon.factors.items():
            made[moving[name]] += factor * force
    return made


_State = tuple[Array, Array, Array, Array, Array]


def _states(
    of: MovingTree, q: Mapping[str, Array], qd: Mapping[str, Array], qdd: Mapping[str, Array], samples: int
) -> tuple[dict[str, _State], dict[str, Array]]:
    """Rotation, origin, angular velocity and acceleration, acceleration of the origin of all links; joint axes."""
    still = np.zeros((samples, 3))
    states: dict[str, _State] = {of.root: (np.tile(np.eye(3), (samples, 1, 1)), still, still, still, still)}
    axes: dict[str, Array] = {}
    for joint in of.tree.joints:
        if joint.child not in of.frames or joint.child == of.root:
            continue
        R, p, w, wd, a = states[joint.parent]
        arm = np.einsum("nij,j->ni", R, joint.placement[:3, 3])
        R = R @ joint.placement[:3, :3]
        axis = np.einsum("nij,j->ni", R, joint.axis)
        axes[joint.name] = axis
        if joint.name in of.held:
            x, v, g = np.full(samples, of.held[joint.name]), np.zeros(samples), np.zeros(samples)
        else:
            x, v, g = (values[joint.name] for values in (q, qd, qdd))
        along = np.zeros((samples, 3))
        slide = still
        if joint.kind == "prismatic":
            arm = arm + x[:, None] * axis
            along, slide = g[:, None] * axis, 2 * np.cross(w, v[:, None] * axis)
        a = a + np.cross(wd, arm) + np.cross(w, np.cross(w, arm)) + along + slide
        p = p + arm
        if joint.kind == "revolute":
            K = np.cross(np.eye(3), joint.axis)
            turn = np.eye(3) + np.sin(x)[:, None, None] * K + (1 - np.cos(x))[:, None, None] * (K @ K)
            R = R @ turn
            wd = wd + g[:, None] * axis + np.cross(w, v[:, None] * axis)
            w = w + v[:, None] * axis
        states[joint.child] = (R, p, w, wd, a)
    return states, axes
