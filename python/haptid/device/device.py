"""The device as a value: what is known of a mechanism before any data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device.parameters import StandardParameters, Symmetry
from haptid.device.terms.term import DRY, Load, Searched, TermColumn, external_columns

if TYPE_CHECKING:
    from haptid.dynamics.base_parameters import BaseParameters
    from haptid.device.loops.linear import Closure, Followed
    from haptid.device.loops.cut_joint import CutJoint
    from haptid.device.loops.newton import NewtonClosure
    from haptid.device.toml.schema import AnyDevice
    from haptid.dynamics.symbolic import Regroupings

Convention = Literal["modified-dh", "dh", "placement"]
TorqueRows = Literal["motor", "joint"]


# Ten parameters of a link, where no estimate has told any: what friction by load is made of until then.
LIKE_ONE_ANOTHER = [0.3, 0.0, 0.0, 0.3, 0.0, 0.3, 0.3, 0.2, 0.1, 1.0]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and the link it moves, in normal form: it turns about, or slides along, its own z axis.

    Pose of link i = pose of its parent * (rotation, translation) * Rz(q) or Tz(q).

    Attributes:
        name: of the joint and of its link.
        parent: index of the parent's joint, -1 for the base.
        prismatic: whether it slides.
        rotation, translation: its placement in the parent's link frame where q = 0, (3, 3) and (3,), m.
        body: whether its link has inertia.
        position_limits: rad or m, None if unknown.
        velocity_limit: rad/s or m/s, None if unknown.
        torque_limit: N m or N, None if unknown.
        frame_rotation, frame_translation: the link frame of the file's own convention, seen in that of the
            normal form, (3, 3) and (3,), m; the identity for modified-dh.
    """

    name: str
    parent: int
    prismatic: bool
    rotation: Array
    translation: Array
    body: bool
    position_limits: tuple[float, float] | None
    velocity_limit: float | None
    torque_limit: float | None
    frame_rotation: Array
    frame_translation: Array

    def __post_init__(self) -> None:
        for name, shape in (("rotation", (3, 3)), ("frame_rotation", (3, 3))):
            expect(name, getattr(self, name).shape, shape)
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("translation", "frame_translation"):
            expect(name, getattr(self, name).shape, (3,))
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame fixed to a link.

    Attributes:
        link: index of its joint, -1 for the base.
        rotation, translation: in the link frame, (3, 3) and (3,), m.
    """

    link: int
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        expect("rotation", self.rotation.shape, (3, 3))
        expect("translation", self.translation.shape, (3,))
        for name in ("rotation", "translation"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


class Handle(Frame):
    """The frame at which the hand holds the device."""


@dataclass(frozen=True)
class Cut:
    """A joint of a loop that was cut to leave a tree.

    Attributes:
        prismatic: False: the frames' origins and z axes coincide. True: z axes one line, orientations equal.
        frame, twin: the two frames that the joint brings together.
        name: of the joint where terms may act on it, else None.
    """

    prismatic: bool
    frame: Frame
    twin: Frame
    name: str | None = None


@dataclass(frozen=True, eq=False)
class Motor:
    """A motor and the joint-side coordinate it drives.

    Attributes:
        name: of the motor; of the joint where there is none.
        gear: shaft position = gear * coordinate.
        gain: shaft torque per unit of command, N m or N; torque on the coordinate = gear * gain * command.
        unit: of the command: N m, N, V, A or counts.
        row: the coordinate as a combination of the active joints' positions, (active,).
        motorised: False for an active joint without motor.
    """

    name: str
    gear: float
    gain: float
    unit: str
    row: Array
    motorised: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", read_only(self.row))


@dataclass(frozen=True)
class Prior:
    """What is known of a standard parameter beforehand: value and deviation (None: unknown), SI."""

    value: float
    sd: float | None = None


@dataclass(frozen=True, eq=False)
class Combination:
    """A linear combination of standard parameters that a user wants to know: a target of the device file.

    Attributes:
        name: such as pi_4.
        text: as written.
        unit: of its value.
        row: factors of the free standard parameters, (p,), SI.
    """

    name: str
    text: str
    unit: str
    row: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", read_only(self.row))


@dataclass(frozen=True, eq=False)
class Device:
    """A mechanism, its transmission and its terms; see `read_device`.

    Attributes:
        name, description, source: what it is, and where its geometry comes from.
        convention: how the file describes frames.
        gravity: in the base frame, (3,), m/s^2.
        joints: parents before children.
        active: indices of the independent joints, in the file's order.
        closure: how the other joints follow them.
        drives: one joint-side coordinate for each active joint: the motors, then active joints without motor.
        torque_rows: whether rows of torque are the motors' or the joints'; they differ where motors are coupled.
        terms: columns beside link inertia, in the core's order.
        parameters: the standard parameters.
        symmetry: what is known of them beforehand.
        lengths: named lengths, m.
        handle: where the hand holds the device, None if unknown.
        prior: by raw parameter name.
        keep: parameters preferred as base parameters.
        base_tolerance: relative length below which a column counts as a combination of others.
        notes: sentences worth showing.
        tables: the checked file itself, where lengths stand as they were written.
        targets: combinations of parameters that a user wants to know.
        cut_joints: cuts that have a name, on which terms may act.
    """

    name: str
    description: str
    source: str
    convention: Convention
    gravity: Array
    joints: tuple[Joint, ...]
    active: tuple[int, ...]
    closure: Closure | NewtonClosure
    drives: tuple[Motor, ...]
    torque_rows: TorqueRows
    terms: tuple[TermColumn, ...]
    parameters: StandardParameters
    symmetry: tuple[Symmetry, ...]
    lengths: Mapping[str, float]
    handle: Handle | None
    prior: Mapping[str, Prior]
    keep: tuple[str, ...]
    base_tolerance: float
    notes: tuple[str, ...]
    tables: AnyDevice = field(repr=False)
    targets: tuple[Combination, ...] = ()
    cut_joints: tuple[CutJoint, ...] = ()

    def __post_init__(self) -> None:
        expect("gravity", self.gravity.shape, (3,))
        expect("closure.constant", self.closure.constant.shape, (len(self.joints), len(self.active)))
        expect("drives", (len(self.drives),), (len(self.active),))
        object.__setattr__(self, "gravity", read_only(self.gravity))

    def __getstate__(self) -> dict[str, Any]:
        """What goes to another process: all but the compiled mechanism, which is made there anew."""
        return {name: value for name, value in self.__dict__.items() if name != "mechanism"}

    def with_gravity(self, gravity: ArrayLike) -> Device:
        """The same mechanism, mounted so that gravity has another direction or size in its base frame.

        Targets keep their factors: g in them stays the size of gravity that the device file has.

        Args:
            gravity: in the base frame, (3,), m/s^2, the direction in which things fall.

        Raises:
            ShapeError: it is not three numbers.
        """
        return replace(self, gravity=np.asarray(gravity, dtype=float))

    @property
    def searched(self) -> tuple[tuple[int, Searched], ...]:
        """Constants of terms that are not known, each with the index of its term."""
        return tuple((k, constant) for k, term in enumerate(self.terms) for constant in term.searched)

    def with_constants(self, values: Sequence[float]) -> Device:
        """The same device with other values of its searched constants, in their order, SI."""
        terms = list(self.terms)
        for (k, constant), value in zip(self.searched, values, strict=True):
            terms[k] = terms[k].with_constant(constant.name, float(value))
        return replace(self, terms=tuple(terms))

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The drives that have a motor."""
        return tuple(drive for drive in self.drives if drive.motorised)

    @cached_property
    def coupling(self) -> Array:
        """N in N qa, drives' coordinates from active joints' positions, (active, active)."""
        return freeze(np.array([drive.row for drive in self.drives], dtype=float))

    @cached_property
    def frame(self) -> Array:
        """B in c = B qa: the coordinates that torque rows belong to, from active joints' positions, (active, active).

        The coupling N where rows are the motors', the identity where they are the joints'.
        """
        return self.coupling if self.torque_rows == "motor" else freeze(np.eye(len(self.active)))

    @cached_property
    def rates(self) -> Array:
        """G B^-1: all joints' rates from the coordinates' rates, (joints, active); zero where they vary."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.frame.T, self.closure.constant.T).T))

    @cached_property
    def varying(self) -> np.ndarray:
        """Which rates from the coordinates' vary with the pose, (joints, active)."""
        moved = np.linalg.inv(self.frame) != 0
        made = np.asarray((self.closure.varying.astype(int) @ moved) > 0)
        made.flags.writeable = False
        return made

    @cached_property
    def drive_rates(self) -> Array:
        """N B^-1: all drives' rates from the coordinates' rates, (active, active)."""
        return freeze(np.ascontiguousarray(np.linalg.solve(self.frame.T, self.coupling.T).T))

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the torque rows: motors, or active joints."""
        if self.torque_rows == "motor":
            return tuple(drive.name for drive in self.drives)
        return tuple(self.joints[j].name for j in self.active)

    @cached_property
    def row_labels(self) -> tuple[str, ...]:
        """What to write beside a torque row: "motor 1", "joint 5"."""
        return tuple(f"{self.torque_rows} {name}" for name in self.row_names)

    @cached_property
    def measured(self) -> tuple[bool, ...]:
        """Whether the torque of each row is known: a motor's own; a joint's if all drives that load it have a motor."""
        blind = np.array([not drive.motorised for drive in self.drives])
        return tuple(bool(known) for known in ~(self.drive_rates[blind] != 0).any(axis=0))

    @cached_property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of every coordinate: rad or m, after the first joint in it."""
        first = [self.joints[self.active[int(np.argmax(row != 0))]] for row in self.frame]
        return tuple("m" if joint.prismatic else "rad" for joint in first)

    @cached_property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of every torque row, at the joint side: N m or N."""
        return tuple("N" if unit == "m" else "N m" for unit in self.coordinate_units)

    @cached_property
    def externals(self) -> tuple[TermColumn, ...]:
        """The terms whose columns Python computes."""
        return tuple(term for term in self.terms if term.kind == "external")

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
            expect(name, array.shape, (len(self.active), qa.shape[1]))
        followed = self.closure.follow(qa, qda)
        return followed.q, followed.velocity(qda), followed.acceleration(qda, qdda)

    def follow(self, c: Array, cd: Array) -> Followed:
        """Positions of all joints and their rates by the coordinates that torque rows belong to.

        Args:
            c: positions of these coordinates, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `tree`.
        """
        to_joints = np.linalg.inv(self.frame)
        return self.closure.follow(to_joints @ c, to_joints @ cd).by(self.frame)

    def loops(self, c: Array, cd: Array) -> Array | None:
        """What the core needs with every sample where rates vary, (channels, samples); None where none does.

        For each joint with such rates its position, those rates by the coordinates, and their rates of change.

        Args:
            c: positions of the coordinates that torque rows belong to, (active, samples), rad or m.
            cd: their velocities.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `tree`.
        """
        return self.given(self.follow(c, cd)) if self.varying.any() else None

    def given(self, followed: Followed) -> Array | None:
        """The same from what is known of all joints, by the coordinates that torque rows belong to."""
        parts = []
        for j in np.flatnonzero(self.varying.any(axis=1)):
            rates = (x[:, j, self.varying[j]].T for x in (followed.G, followed.Gd))
            parts += [followed.q[j : j + 1], *rates]
        return np.ascontiguousarray(np.concatenate(parts)) if parts else None

    def external(self, qa: Array, qda: Array, qdda: Array) -> Array:
        """Columns that Python computes (counterbalances, a user's own), (externals, samples).

        Args:
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            qdda: their accelerations.
        """
        loads = self._loads(*(np.ascontiguousarray(self.frame @ x) for x in (qa, qda, qdda)))
        return external_columns(self.externals, self.joint_names, self.tree(qa, qda, qdda), loads)

    def _loads(self, c: Array, cd: Array, cdd: Array) -> dict[str, Array]:
        """Columns of friction by load, by name, each (samples,), from the coordinates' motion."""
        made = {}
        for term in self.externals:
            if isinstance(term.shape, Load):
                bare, chi = self.bodies
                own, loops = np.zeros((0, c.shape[1])), bare.loops(c, cd)
                made[term.name] = term.shape.values(bare.mechanism.torque(c, cd, cdd, own, chi, loops), cd)
        return made

    @cached_property
    def bodies(self) -> tuple[Device, Array]:
        """Links and rotors alone, and their parameters as friction by load has them, (r,), SI."""
        rotors = tuple(term for term in self.terms if term.kind == "rotor")
        alike = np.array(LIKE_ONE_ANOTHER * len(self.joints) + [0.0] * len(rotors))
        return replace(self, terms=rotors), freeze(alike) if self.load is None else self.load

    @property
    def has_loads(self) -> bool:
        """Whether it has friction by load, whose columns depend on the bodies' parameters."""
        return any(isinstance(term.shape, Load) for term in self.terms)

    @property
    def load(self) -> Array | None:
        """What friction by load is made of: parameters of links, then of rotors, (r,), SI; None where nothing is."""
        return next((term.shape.bodies for term in self.terms if isinstance(term.shape, Load)), None)

    def loaded(self, beta: Array) -> Device:
        """The same device with friction by load as these base parameters' bodies have it, (p,), SI."""
        raw = self.parameters.S[:, list(self.base.kept)] @ beta
        links = 10 * len(self.joints)
        rotors = [links + k for k, term in enumerate(self.terms) if term.kind == "rotor"]
        return self.with_load(np.concatenate([raw[:links], raw[rotors]]))

    def with_load(self, bodies: ArrayLike) -> Device:
        """The same device with friction by load made of bodies, as `load` has them.

        Raises:
            ShapeError: they are not the parameters of its links and rotors.
        """
        rotors = sum(term.kind == "rotor" for term in self.terms)
        bodies = read_only(bodies)
        expect("bodies", bodies.shape, (10 * len(self.joints) + rotors,))
        return replace(
            self,
            terms=tuple(
                replace(term, shape=replace(term.shape, bodies=bodies)) if isinstance(term.shape, Load) else term
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
        return bool(term.weights[row] != 0 or (term.joint is not None and self.varying[term.joint, row]))

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

    @cached_property
    def chi_prior(self) -> Array:
        """Prior value of every free standard parameter, NaN where unknown, (p,), SI.

        Where several raw parameters are one by symmetry, the mean of those that are known.
        """
        known = [[self.prior[n].value for n in names if n in self.prior] for names in self.parameters.members]
        return freeze(np.array([np.mean(values) if values else np.nan for values in known], dtype=float))

    @cached_property
    def mechanism(self) -> Any:
        """The compiled mechanism, `haptid._core.Mechanism`."""
        from haptid.dynamics.mechanism import mechanism

        return mechanism(self)

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters."""
        from haptid.dynamics.base_parameters import base_parameters

        return base_parameters(self)

    @cached_property
    def needed(self) -> tuple[tuple[int, ...], Array]:
        """The core's columns that the base parameters need, and the combinations (columns, p) that make them of these.

        In the parameters' order: where each is one column, the combinations are the identity.
        """
        made = self.parameters.S[:, list(self.base.kept)]
        columns = np.flatnonzero(made.any(axis=1))
        columns = columns[np.argsort(made[columns].argmax(axis=1), kind="stable")]
        return tuple(columns.tolist()), freeze(made[columns])

    @cached_property
    def regroupings(self) -> Regroupings:
        """Base parameters with the lengths as symbols; see `haptid.regroupings` for what it may raise."""
        from haptid.dynamics.symbolic import regroupings

        return regroupings(self)

    @cached_property
    def base_prior(self) -> tuple[tuple[float, float | None] | None, ...]:
        """Value and deviation of every base parameter known beforehand, None where a member is not known."""
        from haptid.device.priors import base_prior

        return base_prior(self)
