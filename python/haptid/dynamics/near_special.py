"""Base parameters that exist only because the geometry is nearly, but not exactly, special.

An axis at 1.5708 rad to the next is not at a right angle, and a base axis at 3.14159 rad to gravity is not vertical:
each invents parameters whose torque is a millionth of the others'. The columns are independent, so no rank shows it;
the base parameters of the geometry that was meant do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Device
from haptid.device.parts import Joint

# Angles nearer than this to a right angle or to parallel, rad (3.14 is nearer), and distances of axes nearer than this
# share of the mechanism's size to zero, count as meant to be such; below the second value of each they are.
NEAR_ANGLE, EXACT_ANGLE = 2e-3, 1e-10
NEAR_LENGTH, EXACT_LENGTH = 1e-5, 1e-12


def special_geometry(device: Device) -> Device | None:
    """The device with nearly parallel, perpendicular and intersecting axes exactly so; None if it is that already.

    Each joint is compared with the one that carries it, and a first joint with gravity. Mechanisms with loops whose
    rates vary with the pose are left alone: their loops would not close.
    """
    if device.varying.any():
        return None
    size = max((float(np.linalg.norm(joint.translation)) for joint in device.joints), default=0.0)
    weight = float(np.linalg.norm(device.gravity))
    vertical = device.gravity / weight if weight else None
    above: Sequence[Array | None] = [
        np.array([0.0, 0.0, 1.0]) if joint.parent >= 0 else vertical for joint in device.joints
    ]
    geometry = tuple(_special(joint, axis, size) for joint, axis in zip(device.joints, above, strict=True))
    unchanged = all(new is old for new, old in zip(geometry, device.joints, strict=True))
    return None if unchanged else replace(device, joints=geometry)


def _special(joint: Joint, axis: Array | None, size: float) -> Joint:
    if axis is None:
        return joint
    z = np.asarray(joint.rotation)[:, 2]
    cosine = float(z @ axis)
    across = float(np.linalg.norm(z - cosine * axis))
    meant = z
    if EXACT_ANGLE < across < NEAR_ANGLE:
        meant = np.sign(cosine) * axis
    elif EXACT_ANGLE < abs(cosine) < NEAR_ANGLE:
        meant = z - cosine * axis
        meant = meant / np.linalg.norm(meant)
    translation = np.array(joint.translation)
    if joint.parent >= 0:
        translation = _meeting(translation, axis, meant, size)
    if meant is z and np.array_equal(translation, joint.translation):
        return joint
    turn = np.eye(3)
    if meant is not z:
        v = np.cross(z, meant)
        K = np.cross(np.eye(3), v)
        turn += K + K @ K / (1 + float(z @ meant))
    return replace(joint, rotation=turn @ joint.rotation, translation=translation)


def _meeting(translation: Array, axis: Array, other: Array, size: float) -> Array:
    """The translation without a distance between two axes that is nearly zero."""
    normal = np.cross(axis, other)
    length = float(np.linalg.norm(normal))
    if length < EXACT_ANGLE:
        offset = translation - (translation @ axis) * axis
    else:
        normal = normal / length
        offset = (translation @ normal) * normal
    return translation - offset if EXACT_LENGTH * size < np.linalg.norm(offset) < NEAR_LENGTH * size else translation
