"""The static model of a device: gravity, springs, offsets and Coulomb friction, the torque of a pose that is held.

Its base parameters are those of the static regressor, which has no inertia and no viscous friction: first moments and
masses regroup further than in motion. They are found like those of motion, by ordered elimination of its columns.

Source: the static tests of Khalil and Dombre (2002), Modeling, Identification and Control of Robots, section 12.4.
"""

from __future__ import annotations

from functools import cached_property
from typing import Self

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import INERTIAL
from haptid.dynamics.base_parameters import BaseParameters, base_parameters_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external, rows

# Kinds of terms with a torque at rest. Stribeck friction is part of the Coulomb friction there.
_HELD = ("offset", "spring", "external")
COULOMB = ("coulomb", "coulomb+", "coulomb-")
# Speed at which the sign of an approach is evaluated, rad/s or m/s: smoothed signs are saturated.
_APPROACH_SPEED = 1e3
# Least independent length of a column at the poses of a recording, relative to the whole column.
TOLD_BY_POSES = 1e-3


class StaticModel(DynamicModel):
    """The model of held poses; its base parameters are those of the static regressor.

    With `poses` they are those that these poses determine, and regroup as they do there.
    """

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters of the static regressor, at random poses."""
        device = self.device
        rng = np.random.default_rng(0)
        poses = 4 + -(-4 * len(device.parameters) // max(sum(device.measured), 1))
        c = device.row_map @ device.closure.draw(rng, poses)
        return self.base_at(c, rng.choice([-1.0, 1.0], c.shape), device.base_tolerance)

    def base_at(self, c: Array, approach: Array, tolerance: float) -> BaseParameters:
        """Base parameters that poses determine.

        Args:
            c, approach: as for `columns`.
            tolerance: relative length below which a column counts as a combination of those before it.
        """
        Y = self.columns(c, approach) * self.used_rows(approach)[:, None]
        Y = Y[list(self.device.measured)]
        return base_parameters_of(self, Y.transpose(0, 2, 1).reshape(-1, Y.shape[1]), tolerance)

    def used_rows(self, approach: Array) -> np.ndarray:
        """Which rows of torque are of use: not where a coordinate with Coulomb friction has not moved (NaN), bool."""
        used = np.ones(approach.shape, dtype=bool)
        for row in range(len(used)):
            if any(term.kind in COULOMB for term in self.coulomb_terms(row)):
                used[row] = np.isfinite(approach[row])
        return used

    def determined_by(self, c: Array, approach: Array) -> Self:
        """The model with the base parameters that these poses determine."""
        reduced = self.with_terms(self.terms)
        reduced.__dict__["base"] = self.base_at(c, approach, TOLD_BY_POSES)
        return reduced

    def columns(self, c: Array, approach: Array) -> Array:
        """Static regressor of the standard parameters, (coordinates, standard parameters, poses).

        Args:
            c: positions of the torque rows' coordinates, (coordinates, poses), rad or m.
            approach: direction in which each coordinate moved last, 1 or -1; 0 where not known: its Coulomb friction is
                then left to the residual; NaN where it has not moved since the pose before, (coordinates, poses).
        """
        c, still = np.ascontiguousarray(c), np.zeros(c.shape)
        Y = rows(self, c, still, still)
        moving = np.ascontiguousarray(_APPROACH_SPEED * np.sign(np.nan_to_num(approach)))
        mechanism, links = self.mechanism, 10 * len(self.device.joints)
        dry = [links + k for k, term in enumerate(self.terms) if term.kind in COULOMB]
        if dry:
            own = external(self, c, moving, still)
            Y[:, dry] = mechanism.regressor(c, moving, still, own, dry, self.loops(c, moving))
        held = [(term.kind in _HELD and not term.resists) or term.kind in COULOMB for term in self.terms]
        Y[:, links:][:, ~np.array(held, dtype=bool)] = 0.0
        Y[:, [k for k in range(links) if INERTIAL[k % 10] not in ("MX", "MY", "MZ", "M")]] = 0.0
        return np.asarray(np.einsum("crn,rp->cpn", Y, self.device.parameters.S))

    def torque(self, beta: Array, c: Array, approach: Array | None = None) -> Array:
        """Torque that holds poses, (coordinates, poses), N m or N; without friction where no approach is given."""
        approach = np.zeros(c.shape) if approach is None else approach
        return np.asarray(
            np.einsum("cpn,p->cn", self.columns(c, approach)[:, list(self.base.independent_columns)], beta)
        )


def static_model(model: DynamicModel) -> StaticModel:
    """The static model of a device."""
    return StaticModel(model.device, model.terms)
