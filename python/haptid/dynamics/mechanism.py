"""A device as the arguments of the compiled core."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel


class MechanismArguments(NamedTuple):
    """What `haptid._core.Mechanism` takes, in its order.

    Attributes:
        parent: index of each joint's parent, -1 for the base.
        rotation, translation: placements, (joints, 3, 3) and (joints, 3), m.
        prismatic: whether each joint slides.
        gravity: (3,), m/s^2.
        rates: all joints' rates from the coordinates', (joints, active).
        offset: all joints' positions where the device's coordinates are zero, (joints,).
        terms: (kind, weights, offset, a, b, c) of every column beside link inertia.
        backend: the core's choice.
        given: which rates come with every sample, (joints, active); None for none.
        on: for each term the joint whose motion comes so, None for others.
    """

    parent: list[int]
    rotation: Array
    translation: Array
    prismatic: list[bool]
    gravity: list[float]
    rates: Array
    offset: Array
    terms: list[tuple[str, Array, float, float, float, float]]
    backend: str | None
    given: np.ndarray | None
    on: list[int | None]


def mechanism_arguments(model: DynamicModel) -> MechanismArguments:
    """The arguments that compile a dynamic model in the core."""
    joints = model.device.joints
    return MechanismArguments(
        parent=[joint.parent for joint in joints],
        rotation=np.array([joint.rotation for joint in joints]),
        translation=np.array([joint.translation for joint in joints]),
        prismatic=[joint.prismatic for joint in joints],
        gravity=[float(g) for g in model.device.gravity],
        rates=np.ascontiguousarray(model.device.rates),
        offset=np.ascontiguousarray(model.device.closure.offset),
        terms=[term.for_core for term in model.terms],
        backend=None,
        given=model.device.varying if model.device.varying.any() else None,
        on=[term.joint for term in model.terms],
    )
