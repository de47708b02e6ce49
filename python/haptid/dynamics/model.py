"""The dynamic model of a device: its compiled mechanism, its base parameters and the columns of its regressor."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid._internal.bounded_files import SYMBOLIC_JOINTS
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.device import Device, Followed
from haptid.device.priors import combined_prior
from haptid.device.terms.friction import DRY, LoadDependentFriction
from haptid.device.terms.presliding import Presliding
from haptid.device.terms.term import TermColumn, external_columns
from haptid.device.terms.warming import Warming
from haptid.dynamics.base_parameters import BaseParameters, base_parameters
from haptid.errors import ModelMismatchError, RegroupingError

if TYPE_CHECKING:
    from haptid.dynamics.symbolic import Regroupings


# Nominal inertial parameters of a link: load-dependent friction is scaled by their torque before the first estimate.
NOMINAL_LINK = [0.3, 0.0, 0.0, 0.3, 0.0, 0.3, 0.3, 0.2, 0.1, 1.0]


@displayed
@dataclass(frozen=True, eq=False, init=False)
class DynamicModel:
    """The dynamic model of a device, linear in its base parameters: tau = Y(c, cd, cdd) beta.

    `DynamicModel(device)` is the model at the constants that the device file gives. Columns that are not linear in a
    constant (Stribeck velocity, smoothing width, the bodies behind load-dependent friction) are evaluated at the
    constants in `terms`; `at_constants` and `with_load` give the model at others. It holds no estimated parameters.

    Attributes:
        device: the mechanism as its file describes it.
        terms: columns in addition to link inertia, in the core's order; the device's own by default.
    """

    device: Device
    terms: tuple[TermColumn, ...]

    def __init__(self, device: Device, terms: tuple[TermColumn, ...] | None = None) -> None:
        object.__setattr__(self, "device", device)
        object.__setattr__(self, "terms", device.terms if terms is None else terms)

    def __getstate__(self) -> dict[str, Any]:
        """State for another process, without the compiled mechanism, which is compiled again there."""
        return {name: value for name, value in self.__dict__.items() if name != "mechanism"}

    def is_same_as(self, other: DynamicModel) -> bool:
        """Whether both have the same device and the same constants."""
        same_terms = list(map(id, self.terms)) == list(map(id, other.terms))
        return self is other or (self.device is other.device and same_terms)

    def require_same(self, other: DynamicModel) -> None:
        """Raise ModelMismatchError unless both have the same device and the same constants."""
        if not self.is_same_as(other):
            raise ModelMismatchError(
                f"these are of two models, of devices {other.device.name!r} and {self.device.name!r}.",
                where=(other.device.name, self.device.name),
                advice="Read the device once, and make every observation with it.",
            )

    def with_terms(self, terms: Sequence[TermColumn]) -> Self:
        """The model with other columns in addition to link inertia, or with the same at other constants."""
        model = object.__new__(type(self))
        for entry in fields(self):
            object.__setattr__(model, entry.name, getattr(self, entry.name))
        object.__setattr__(model, "terms", tuple(terms))
        return model

    def at_constants(self, values: Sequence[float]) -> DynamicModel:
        """The model at other values of the constants that the device file leaves open, in their order, SI."""
        terms = list(self.terms)
        for (k, constant), value in zip(self.device.searched, values, strict=True):
            terms[k] = terms[k].with_constant(constant.name, float(value))
        return self.with_terms(terms)

    def with_gravity(self, gravity: ArrayLike) -> DynamicModel:
        """The model of the device mounted with another gravity vector in its base frame, (3,), m/s^2."""
        return replace(self, device=self.device.with_gravity(gravity))

    @cached_property
    def mechanism(self) -> Any:
        """The compiled mechanism, `haptid._core.Mechanism`."""
        return importlib.import_module("haptid._core").Mechanism(*mechanism_arguments(self))

    @cached_property
    def measured_rows(self) -> tuple[int, ...]:
        """Indices of the torque rows whose torque is measured."""
        return tuple(k for k, measured in enumerate(self.device.measured) if measured)

    @cached_property
    def known_rows(self) -> tuple[int, ...]:
        """Indices of the torque rows whose torque is measured, or known to be zero: those of the regression."""
        return tuple(k for k, known in enumerate(self.device.known) if known)

    @cached_property
    def unmeasured_labels(self) -> tuple[str, ...]:
        """Labels of the torque rows whose torque is not known."""
        return tuple(x for k, x in enumerate(self.device.row_labels) if k not in self.known_rows)

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters."""
        return base_parameters(self)

    @cached_property
    def only_by_rounding(self) -> tuple[str, ...]:
        """Base parameters that vanish if nearly special axes are exactly so: rounded angles invent them."""
        from haptid.dynamics.near_special import special_geometry

        device = special_geometry(self.device)
        if device is None:
            return ()
        independent = set(replace(self, device=device).base.independent_columns)
        pairs = zip(self.base.names, self.base.independent_columns, strict=True)
        return tuple(name for name, column in pairs if column not in independent)

    @cached_property
    def needed(self) -> tuple[tuple[int, ...], Array]:
        """The core's columns that base parameters depend on, and the map (columns, p) from them to base columns.

        In the parameters' order; the identity where each parameter is one column.
        """
        S = self.device.parameters.S[:, list(self.base.independent_columns)]
        columns = np.flatnonzero(S.any(axis=1))
        columns = columns[np.argsort(np.abs(S[columns]).argmax(axis=1), kind="stable")]
        return tuple(columns.tolist()), freeze(S[columns])

    @cached_property
    def regroupings(self) -> Regroupings:
        """Base parameters with symbolic lengths; see `haptid.dynamics.symbolic.regroupings` for the errors raised."""
        from haptid.dynamics.symbolic import regroupings

        count, most = len(self.device.joints), SYMBOLIC_JOINTS.value
        if count > most:
            raise RegroupingError(
                f"{self.device.name} has {count} joints; lengths are symbols up to {most}.",
                found=count,
                limit=most,
                advice=f"Set {SYMBOLIC_JOINTS.variable} to allow more; the time grows with the third power.",
            )
        return regroupings(self)

    @property
    def prior_beta(self) -> Array:
        """Base parameters of the prior's bodies and constants, zero where the device file has none, (p,), SI."""
        return self.base.of(np.nan_to_num(self.device.chi_prior))

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
            LoopClosureError, SingularityError: a loop does not close at a pose, or is singular there.
        """
        for name, array in (("qa", qa), ("qda", qda), ("qdda", qdda)):
            expect(name, array.shape, (len(self.device.active), qa.shape[1]))
        followed = self.device.closure.follow(qa, qda)
        return followed.q, followed.velocity(qda), followed.acceleration(qda, qdda)

    def follow(self, c: Array, cd: Array) -> Followed:
        """Positions of all joints and their rates with respect to the torque rows' coordinates.

        Args:
            c: positions of these coordinates, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopClosureError, SingularityError: as for `tree`.
        """
        to_joints = np.linalg.inv(self.device.row_map)
        return self.device.closure.follow(to_joints @ c, to_joints @ cd).by(self.device.row_map)

    def loops(self, c: Array, cd: Array) -> Array | None:
        """The core's inputs for joints whose rates vary with the pose, (channels, samples); None where no rate varies.

        For each such joint its position, its rates with respect to the coordinates, and their time derivatives.

        Args:
            c: positions of the torque rows' coordinates, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopClosureError, SingularityError: as for `tree`.
        """
        return self.given(self.follow(c, cd)) if self._rates_vary else None

    @cached_property
    def _rates_vary(self) -> bool:
        return bool(self.device.varying.any())

    def given(self, followed: Followed) -> Array | None:
        """The same inputs from known positions and rates of all joints with respect to the torque rows' coordinates."""
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

    def external(self, qa: Array, qda: Array, qdda: Array, history: Mapping[str, Array] | None = None) -> Array:
        """Columns that Python computes: counterbalances, user-defined ones, special friction; (externals, samples).

        Args:
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            qdda: their accelerations.
            history: columns that depend on the motion before, as `history` gives them; None for steady sliding.
        """
        coordinates = [np.ascontiguousarray(self.device.row_map @ x) for x in (qa, qda, qdda)]
        columns = self._by_state(*coordinates) | dict(history or {})
        if all(term.name in columns for term in self.externals):  # without the poses of all joints
            return np.array([columns[term.name] for term in self.externals]).reshape(len(self.externals), qa.shape[1])
        return external_columns(self.externals, self.device.joint_names, self.tree(qa, qda, qdda), columns)

    @property
    def has_history(self) -> bool:
        """Whether it has friction with presliding or warming, whose columns depend on the motion before or on time."""
        return any(term.historic for term in self.externals)

    def history(self, c: Array, cd: Array, t: Array) -> dict[str, Array]:
        """Columns of friction with presliding or warming along consecutive samples, by name, each (samples,).

        Args:
            c: positions of the torque rows' coordinates, (active, samples), rad or m.
            cd: their velocities.
            t: times since the start of the log, (samples,), s.
        """
        columns = {}
        for term in self.externals:
            if isinstance(term.shape, Presliding):
                x = term.weights @ c if term.joint is None else self.follow(c, cd).q[term.joint]
                columns[term.name] = term.shape.along(x, self.speed(term, c, cd))
            elif isinstance(term.shape, Warming):
                columns[term.name] = term.shape.along(t, self.speed(term, c, cd))
        return columns

    def _by_state(self, c: Array, cd: Array, cdd: Array) -> dict[str, Array]:
        """Columns of load-dependent friction, and of sliding friction of a warm device, by name, each (samples,)."""
        columns = {}
        for term in self.externals:
            if isinstance(term.shape, Presliding):
                columns[term.name] = term.shape.sliding(self.speed(term, c, cd))
            if isinstance(term.shape, Warming):
                columns[term.name] = np.zeros(c.shape[1])
            if isinstance(term.shape, LoadDependentFriction):
                rigid, chi = self.bodies
                own, loops = np.zeros((0, c.shape[1])), rigid.loops(c, cd)
                columns[term.name] = term.shape.values(rigid.mechanism.torque(c, cd, cdd, own, chi, loops), cd)
        return columns

    @cached_property
    def bodies(self) -> tuple[DynamicModel, Array]:
        """The model with links and rotors only, and their parameters that load-dependent friction uses, (r,), SI."""
        rotors = tuple(term for term in self.terms if term.kind == "rotor")
        nominal = np.array(NOMINAL_LINK * len(self.device.joints) + [0.0] * len(rotors))
        return self.with_terms(rotors), freeze(nominal) if self.load is None else self.load

    @cached_property
    def dry_terms(self) -> tuple[tuple[TermColumn, ...], Array]:
        """Its terms of dry friction, and the widths of their smoothed signs, (terms, 1), rad/s or m/s."""
        terms = tuple(term for term in self.terms if term.dry)
        return terms, np.array([[term.constant("width")] for term in terms])

    @cached_property
    def has_loads(self) -> bool:
        """Whether it has load-dependent friction, whose columns depend on the bodies' parameters."""
        return any(isinstance(term.shape, LoadDependentFriction) for term in self.terms)

    @property
    def load(self) -> Array | None:
        """Parameters of links, then of rotors, that scale load-dependent friction, (r,), SI; None without it."""
        return next((term.shape.bodies for term in self.terms if isinstance(term.shape, LoadDependentFriction)), None)

    def loaded(self, beta: Array) -> DynamicModel:
        """The same device with load-dependent friction scaled by the bodies of these base parameters, (p,), SI."""
        raw = self.device.parameters.S[:, list(self.base.independent_columns)] @ beta
        links = 10 * len(self.device.joints)
        rotors = [links + k for k, term in enumerate(self.terms) if term.kind == "rotor"]
        return self.with_load(np.concatenate([raw[:links], raw[rotors]]))

    def with_load(self, bodies: ArrayLike) -> DynamicModel:
        """The same device with load-dependent friction scaled by these bodies, (r,), ordered as `load`, SI.

        Raises:
            ShapeError: they are not the parameters of its links and rotors.
        """
        rotors = sum(term.kind == "rotor" for term in self.terms)
        bodies = read_only(bodies)
        expect("bodies", bodies.shape, (10 * len(self.device.joints) + rotors,))
        return self.with_terms(
            [
                replace(term, shape=replace(term.shape, bodies=bodies))
                if isinstance(term.shape, LoadDependentFriction)
                else term
                for term in self.terms
            ]
        )

    def coulomb_terms(self, row: int) -> tuple[TermColumn, ...]:
        """Dry-friction terms that act on a torque row, one for each velocity whose sign they depend on."""
        terms: list[TermColumn] = []
        for term in self.terms:
            acts = term.kind in DRY and self.friction_acts(row, term)
            if acts and not any(term.moves_as(known) for known in terms):
                terms.append(term)
        return tuple(terms)

    def friction_acts(self, row: int, term: TermColumn) -> bool:
        """Whether a term's torque acts on a torque row."""
        return bool(term.weights[row] != 0 or (term.joint is not None and self.device.varying[term.joint, row]))

    def speed(self, term: TermColumn, c: Array, cd: Array) -> Array:
        """Velocity that a term acts on, (samples,); arguments as in `shares`."""
        if term.joint is None:
            acting = np.flatnonzero(term.weights)  # mostly one
            return np.asarray((term.weights[acting, None] * cd[acting]).sum(axis=0))
        return np.asarray((self.shares(term, c, cd) * cd).sum(axis=0))

    def shares(self, term: TermColumn, c: Array, cd: Array) -> Array:
        """Rates of a term's velocity with respect to the coordinates, (active, samples), or (active, 1) where constant.

        Args:
            term: one of the device's.
            c, cd: position and velocity of the torque rows' coordinates, (active, samples).
        """
        if term.joint is None:
            return np.asarray(term.weights)[:, None]
        return np.asarray(self.follow(c, cd).G[:, term.joint].T)

    def _shown(self) -> Overview:
        base = self.base
        rows = list(zip(base.names, base.units, base.groupings, strict=True))
        title = f"DynamicModel of {self.device.name}: {len(base)} base parameters of {len(base.standard)}"
        return Overview(title, ("parameter", "unit", "regroups"), rows)


class MechanismArguments(NamedTuple):
    """Arguments of `haptid._core.Mechanism`, in its order.

    Attributes:
        parent: index of each joint's parent, -1 for the base.
        rotation, translation: placements, (joints, 3, 3) and (joints, 3), m.
        prismatic: whether each joint slides.
        gravity: (3,), m/s^2.
        rates: all joints' rates with respect to the coordinates, (joints, active).
        offset: all joints' positions where the device's coordinates are zero, (joints,).
        terms: (kind, weights, offset, a, b, c) of every column in addition to link inertia.
        backend: the core's choice.
        given: which rates vary with the pose and are passed with every sample, (joints, active); None for none.
        on: for each term the joint with such rates that it acts on, None for others.
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
