"""Friction by load in the direct model: it depends on the accelerations that it changes.

The torque that the bodies put on a coordinate is M cdd + h, and friction its size times a share: linear in cdd for a
given sign of that torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.term import LoadDependentFriction
from haptid.dynamics.inverse import core_mass, core_torque
from haptid.dynamics.model import DynamicModel


@dataclass(frozen=True, eq=False)
class Carried:
    """What one coordinate carries at some states, and the friction in proportion to it.

    Attributes:
        weights: how the friction acts on the coordinates, (n,).
        grip: friction by the size of the load, with the velocity's sign, (states,).
        inertia: row of the bodies' mass matrix, (states, n).
        still: torque of the bodies without acceleration, (states,), N m or N.
    """

    weights: Array
    grip: Array
    inertia: Array
    still: Array

    def load(self, cdd: Array) -> Array:
        """Torque of the bodies, (states,), at accelerations (states, n)."""
        return np.asarray((self.inertia * cdd).sum(axis=1) + self.still)

    def sign(self, cdd: Array) -> Array:
        """Its sign, (states,)."""
        return np.sign(self.load(cdd))


def carried(model: DynamicModel, chi: Array, c: Array, cd: Array) -> list[Carried]:
    """Of every term of friction by load.

    Args:
        model: the dynamic model, its loads settled.
        chi: parameters of the core's columns at each state, (states, r), SI.
        c, cd: positions and velocities of the coordinates that torque rows belong to, (n, states).
    """
    bare, bodies = model.bodies
    M = core_mass(bare, bodies, c)
    h = core_torque(bare, bodies, c, cd, np.zeros_like(c))
    first = 10 * len(model.device.joints)
    return [
        Carried(term.weights, chi[:, first + k] * term.shape.side(cd), M[:, term.shape.row], h[term.shape.row])
        for k, term in enumerate(model.terms)
        if isinstance(term.shape, LoadDependentFriction)
    ]


def pressed(loads: Sequence[Carried], cdd: Array) -> tuple[Array, Array]:
    """What friction by load adds to M, (states, n, n), and to h, (states, n), with the signs at some accelerations.

    h has the friction without acceleration already.

    Args:
        loads: of every term.
        cdd: (states, n).
    """
    states, n = cdd.shape
    M, h = np.zeros((states, n, n)), np.zeros((states, n))
    for one in loads:
        signed = one.grip * one.sign(cdd)
        M += one.weights[:, None] * (signed[:, None] * one.inertia)[:, None]
        h += one.weights * (signed * one.still - one.grip * np.abs(one.still))[:, None]
    return M, h
