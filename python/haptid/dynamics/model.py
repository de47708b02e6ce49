"""The dynamic model of a device: its compiled mechanism, its base parameters and the columns of its regressor."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device import Device, Followed
from haptid.device.priors import combined_prior
from haptid.device.terms.term import DRY, LoadDependentFriction, TermColumn, external_columns
from haptid.dynamics.base_parameters import BaseParameters, base_parameters

if TYPE_CHECKING:
    from haptid.dynamics.symbolic import Regroupings

# Ten parameters of a link before any estimate: the bodies whose torque scales load-dependent friction until then.
NOMINAL_LINK = [0.3, 0.0, 0.0, 0.3, 0.0, 0.3, 0.3, 0.2, 0.1, 1.0]


@dataclass(frozen=True, eq=False, init=False)
class DynamicModel:
    """The dynamic model of a device, linear in its base parameters: tau = Y(c, cd, cdd) beta.

    `DynamicModel(device)` is the model at the constants that the device file gives. Columns that are not linear in a
    constant (Stribeck velocity, smoothing width, the bodies behind load-dependent friction) are evaluated at the
    constants in `terms`; `at_constants` and `with_load` give the model at others. It holds no estimated parameters.

    Attributes:
        device: the mechanism as its file describes it.
        terms: columns in addition to link inertia, in the core's order, at the constants used; the device's own where
            left out.
    """

    device: Device
    terms: tuple[TermColumn, ...]

    def __init__(self, device: Device, terms: tuple[TermColumn, ...] | None = None) -> None:
        object.__setattr__(self, "device", device)
        object.__setattr__(self, "terms", device.terms if terms is None else terms)

    def __getstate__(self) -> dict[str, Any]:
        """State for another process: all but the compiled mechanism, which is compiled again there."""
        return {name: value for name, value in self.__dict__.items() if name != "mechanism"}

    def is_same_as(self, other: DynamicModel) -> bool:
        """Whether both have the same device, at the same constants."""
        same_terms = len(self.terms) == len(other.terms) and all(map(_identical, self.terms, other.terms))
        return self is other or (self.device is other.device and same_terms)

    def at_constants(self, values: Sequence[float]) -> DynamicModel:
        """The model at other values of the constants that the device file leaves open, in their order, SI."""
        terms = list(self.terms)
        for (k, constant), value in zip(self.device.searched, values, strict=True):
            terms[k] = terms[k].with_constant(constant.name, float(value))
        return replace(self, terms=tuple(terms))

    def with_gravity(self, gravity: ArrayLike) -> DynamicModel:
        """The model of the device mounted so that gravity is another vector in its base frame, (3,), m/s^2."""
        return replace(self, device=self.device.with_gravity(gravity))

    @cached_property
    def mechanism(self) -> Any:
        """The compiled mechanism, `haptid._core.Mechanism`."""
        from haptid.dynamics.mechanism import mechanism_arguments

        return importlib.import_module("haptid._core").Mechanism(*mechanism_arguments(self))

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters."""
        return base_parameters(self)

    @cached_property
    def needed(self) -> tuple[tuple[int, ...], Array]:
        """The core's columns that base parameters need, and the combinations (columns, p) that make them of these.

        In the parameters' order: where each is one column, the combinations are the identity.
        """
        made = self.device.parameters.S[:, list(self.base.independent_columns)]
        columns = np.flatnonzero(made.any(axis=1))
        columns = columns[np.argsort(made[columns].argmax(axis=1), kind="stable")]
        return tuple(columns.tolist()), freeze(made[columns])

    @cached_property
    def regroupings(self) -> Regroupings:
        """Base parameters with the lengths as symbols; see `haptid.regroupings` for the errors raised."""
        from haptid.dynamics.symbolic import regroupings

        return regroupings(self)

    @cached_property
    def base_prior(self) -> tuple[tuple[float, float | None] | None, ...]:
        """Prior value and standard deviation of every base parameter, None where one of its members has no prior."""
        return combined_prior(self.device, self.base.regrouping)

    # Kinematics of the tree and its loops.

    def tree(self, qa: Array, qda: Array, qdda: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of all joints, each (joints, samples), from the active ones'.

        Args:
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            qdda: their accelerations.

        Raises:
            LoopUnreachableError, SingularLoopError: loops that are not linear do not close at a pose, or not clearly.
        """
        for name, array in (("qa", qa), ("qda", qda), ("qdda", qdda)):
            expect(name, array.shape, (len(self.device.active), qa.shape[1]))
        followed = self.device.closure.follow(qa, qda)
        return followed.q, followed.velocity(qda), followed.acceleration(qda, qdda)

    def follow(self, c: Array, cd: Array) -> Followed:
        """Positions of all joints and their rates by the coordinates that torque rows belong to.

        Args:
            c: positions of these coordinates, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `tree`.
        """
        to_joints = np.linalg.inv(self.device.row_map)
        return self.device.closure.follow(to_joints @ c, to_joints @ cd).by(self.device.row_map)

    def loops(self, c: Array, cd: Array) -> Array | None:
        """What the core needs with every sample where rates vary, (channels, samples); None where none does.

        For each joint with such rates its position, those rates by the coordinates, and their rates of change.

        Args:
            c: positions of the coordinates that torque rows belong to, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `tree`.
        """
        return self.given(self.follow(c, cd)) if self.device.varying.any() else None

    def given(self, followed: Followed) -> Array | None:
        """The same from what is known of all joints, by the coordinates that torque rows belong to."""
        parts = []
        for j in np.flatnonzero(self.device.varying.any(axis=1)):
            rates = (x[:, j, self.device.varying[j]].T for x in (followed.G, followed.Gd))
            parts += [followed.q[j : j + 1], *rates]
        return np.ascontiguousarray(np.concatenate(parts)) if parts else None

    # Columns in addition to link inertia.

    @cached_property
    def externals(self) -> tuple[TermColumn, ...]:
        """The terms whose columns Python computes."""
        return tuple(term for term in self.terms if term.kind == "external")

    def external(self, qa: Array, qda: Array, qdda: Array) -> Array:
        """Columns that Python computes (counterbalances, a user's own), (externals, samples).

        Args:
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            qdda: their accelerations.
        """
        loads = self._loads(*(np.ascontiguousarray(self.device.row_map @ x) for x in (qa, qda, qdda)))
        return external_columns(self.externals, self.device.joint_names, self.tree(qa, qda, qdda), loads)

    def _loads(self, c: Array, cd: Array, cdd: Array) -> dict[str, Array]:
        """Columns of friction by load, by name, each (samples,), from the coordinates' motion."""
        made = {}
        for term in self.externals:
            if isinstance(term.shape, LoadDependentFriction):
                bare, chi = self.bodies
                own, loops = np.zeros((0, c.shape[1])), bare.loops(c, cd)
                made[term.name] = term.shape.values(bare.mechanism.torque(c, cd, cdd, own, chi, loops), cd)
        return made

    @cached_property
    def bodies(self) -> tuple[DynamicModel, Array]:
        """Links and rotors alone, and their parameters as friction by load has them, (r,), SI."""
        rotors = tuple(term for term in self.terms if term.kind == "rotor")
        alike = np.array(NOMINAL_LINK * len(self.device.joints) + [0.0] * len(rotors))
        return replace(self, terms=rotors), freeze(alike) if self.load is None else self.load

    @property
    def has_loads(self) -> bool:
        """Whether it has friction by load, whose columns depend on the bodies' parameters."""
        return any(isinstance(term.shape, LoadDependentFriction) for term in self.terms)

    @property
    def load(self) -> Array | None:
        """What friction by load is made of: parameters of links, then of rotors, (r,), SI; None where nothing is."""
        return next((term.shape.bodies for term in self.terms if isinstance(term.shape, LoadDependentFriction)), None)

    def loaded(self, beta: Array) -> DynamicModel:
        """The same device with friction by load as these base parameters' bodies have it, (p,), SI."""
        raw = self.device.parameters.S[:, list(self.base.independent_columns)] @ beta
        links = 10 * len(self.device.joints)
        rotors = [links + k for k, term in enumerate(self.terms) if term.kind == "rotor"]
        return self.with_load(np.concatenate([raw[:links], raw[rotors]]))

    def with_load(self, bodies: ArrayLike) -> DynamicModel:
        """The same device with friction by load made of bodies, as `load` has them.

        Raises:
            ShapeError: they are not the parameters of its links and rotors.
        """
        rotors = sum(term.kind == "rotor" for term in self.terms)
        bodies = read_only(bodies)
        expect("bodies", bodies.shape, (10 * len(self.device.joints) + rotors,))
        return replace(
            self,
            terms=tuple(
                replace(term, shape=replace(term.shape, bodies=bodies))
                if isinstance(term.shape, LoadDependentFriction)
                else term
                for term in self.terms
            ),
        )

    def coulomb_terms(self, row: int) -> tuple[TermColumn, ...]:
        """Terms on whose sign of velocity a torque row depends, one for each velocity."""
        found: list[TermColumn] = []
        for term in self.terms:
            felt = term.kind in DRY and self.feels(row, term)
            if felt and not any(term.moves_as(known) for known in found):
                found.append(term)
        return tuple(found)

    def feels(self, row: int, term: TermColumn) -> bool:
        """Whether a term's torque acts on a torque row."""
        return bool(term.weights[row] != 0 or (term.joint is not None and self.device.varying[term.joint, row]))

    def speed(self, term: TermColumn, c: Array, cd: Array) -> Array:
        """Velocity of what a term acts on, (samples,); arguments as in `shares`."""
        return np.asarray((self.shares(term, c, cd) * cd).sum(axis=0))

    def shares(self, term: TermColumn, c: Array, cd: Array) -> Array:
        """Rates of what a term acts on by the coordinates, (active, samples), or (active, 1) where they are constant.

        Args:
            term: one of the device's.
            c, cd: position and velocity of the coordinates that torque rows belong to, (active, samples).
        """
        if term.joint is None:
            return np.asarray(term.weights)[:, None]
        return np.asarray(self.follow(c, cd).G[:, term.joint].T)


def _identical(one: TermColumn, other: TermColumn) -> bool:
    return one is other
