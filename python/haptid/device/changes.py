"""How the Jacobian of the cuts' gaps changes while the mechanism moves: what dG/dt of a loop is made of."""

from __future__ import annotations

import numpy as np

from haptid._values import Array
from haptid.device.closing import Chain
from haptid.device.geometry import joint_poses
from haptid.device.model import Cut, Frame

# Links' poses (n, joints, 4, 4), angular velocities and velocities of their origins, each (n, joints, 3).
Motion = tuple[Array, Array, Array]


def change_of_jacobian(chain: Chain, q: Array, qd: Array) -> Array:
    """Rate of change of the Jacobian that `Chain.residual` gives, (n, m, joints).

    Column j of a frame's Jacobian is z x (p - o) and z x R where joint j turns, z and 0 where it slides; the product
    rule is applied to each, with the links' own velocities.

    Args:
        chain: the tree and its cuts.
        q: positions of all joints, (n, joints), rad or m.
        qd: their velocities.
    """
    motion = _velocities(chain, joint_poses(chain.joints, q), qd)
    return np.concatenate([_of_cut(chain, cut, motion) for cut in chain.cuts], axis=1)


def _velocities(chain: Chain, links: Array, qd: Array) -> Motion:
    w, v = np.zeros((2, *qd.shape, 3))
    for j, joint in enumerate(chain.joints):
        if joint.parent >= 0:
            arm = links[:, j, :3, 3] - links[:, joint.parent, :3, 3]
            w[:, j] = w[:, joint.parent]
            v[:, j] = v[:, joint.parent] + np.cross(w[:, joint.parent], arm)
        moved = links[:, j, :3, 2] * qd[:, j, None]
        (v if joint.prismatic else w)[:, j] += moved
    return links, w, v


def _of_cut(chain: Chain, cut: Cut, motion: Motion) -> Array:
    (p, _, pd, _), (o, U, od, Ud) = (_moving(frame, motion) for frame in (cut.frame, cut.twin))
    (dp, _, dpd, dRd), (do, dU, dod, dUd) = (_changes(chain, frame, motion) for frame in (cut.frame, cut.twin))
    apart, rate, apartd, rated = p - o, dp - do, pd - od, dpd - dod
    if not cut.prismatic:
        return np.concatenate([rated, chain.size * (dRd[:, :, 2] - dUd[:, :, 2])], axis=1)
    gap = np.einsum("nik,nij->nkj", Ud[:, :, :2], rate) + np.einsum("nik,nij->nkj", U[:, :, :2], rated)
    gap += np.einsum("nikj,ni->nkj", dUd[:, :, :2], apart) + np.einsum("nikj,ni->nkj", dU[:, :, :2], apartd)
    turning = (dRd - dUd)[:, :, [0, 2]].reshape(len(p), 6, -1)
    return np.concatenate([gap, chain.size * turning], axis=1)


def _moving(frame: Frame, motion: Motion) -> tuple[Array, Array, Array, Array]:
    """A frame's origin (n, 3) and axes (n, 3, 3), and their rates of change with time."""
    links, w, v = motion
    if frame.link < 0:
        n = len(links)
        p, R = np.broadcast_to(frame.translation, (n, 3)), np.broadcast_to(frame.rotation, (n, 3, 3))
        return p, R, np.zeros((n, 3)), np.zeros((n, 3, 3))
    link, spin = links[:, frame.link], w[:, frame.link]
    arm, R = link[:, :3, :3] @ frame.translation, link[:, :3, :3] @ frame.rotation
    return arm + link[:, :3, 3], R, v[:, frame.link] + np.cross(spin, arm), np.cross(spin[:, :, None], R, axis=1)


def _changes(chain: Chain, frame: Frame, motion: Motion) -> tuple[Array, Array, Array, Array]:
    """A frame's Jacobian, (n, 3, joints) and (n, 3, 3, joints), and its rate of change with time."""
    links, w, v = motion
    n, joints = w.shape[:2]
    dp, dpd = np.zeros((2, n, 3, joints))
    dR, dRd = np.zeros((2, n, 3, 3, joints))
    if frame.link < 0:
        return dp, dR, dpd, dRd
    p, R, pd, Rd = _moving(frame, motion)
    for j in np.flatnonzero(chain.above[frame.link]):
        z = links[:, j, :3, 2]
        zd = np.cross(w[:, j], z)
        if chain.joints[j].prismatic:
            dp[:, :, j], dpd[:, :, j] = z, zd
            continue
        arm = p - links[:, j, :3, 3]
        dp[:, :, j] = np.cross(z, arm)
        dpd[:, :, j] = np.cross(zd, arm) + np.cross(z, pd - v[:, j])
        dR[:, :, :, j] = np.cross(z[:, :, None], R, axis=1)
        dRd[:, :, :, j] = np.cross(zd[:, :, None], R, axis=1) + np.cross(z[:, :, None], Rd, axis=1)
    return dp, dR, dpd, dRd
