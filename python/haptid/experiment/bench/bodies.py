"""Standard parameters in a simulator's form: rigid bodies about their centres of mass, and forces along coordinates."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device import NewtonClosure, TermColumn
from haptid.device.priors import TENSOR
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import rows
from haptid.dynamics.static import COULOMB
from haptid.errors import ExportError, PhysicalConsistencyError

# Relative rounding allowed in the triangle inequality of the principal moments of inertia.
TRIANGLE_SLACK = 1e-9
# Share of the largest moment below which that about a thin rod counts as none; the simulator gets twice as much.
_THIN_ROD = 1e-9
# Inertia moved from a link to its rotor beyond the minimum that makes the link physical, relative to the other moments.
MOVED_SPARE = 0.02
# Rotor inertia given to a massless link in a loop, relative to the largest inertia of the device's bodies.
LIGHT = 1e-6
# Relative difference below which two regressor columns are equal.
SAME_COLUMN = 1e-10


@dataclass(frozen=True, eq=False)
class SimulatedBody:
    """A rigid body in its link's frame.

    Attributes:
        mass: kg.
        com: centre of mass, (3,), m.
        inertia: tensor about the centre of mass, (3, 3), kg m^2.
        moved: inertia about the joint axis that was moved to the rotor, kg m^2.
    """

    mass: float
    com: Array
    inertia: Array
    moved: float = 0.0

    def __post_init__(self) -> None:
        freeze_fields(self, com=(3,), inertia=(3, 3))

    @property
    def weightless(self) -> bool:
        """Whether it is massless."""
        return self.mass == 0


@dataclass
class Effect:
    """Rotor inertia, friction, spring and constant force along one coordinate, a combination of joint positions.

    Attributes:
        name: of the joint, or of the motor where the combination has several joints.
        joints: weight of every joint in the combination, (joints,).
        armature, viscous, coulomb, stiffness, rest, offset: rotor inertia, friction, spring and constant force, SI.
    """

    name: str
    joints: Array
    armature: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    offset: float = 0.0
    _springs: list[tuple[float, float]] = field(default_factory=list, repr=False)

    def spring(self, stiffness: float, rest: float) -> None:
        """Add a spring in parallel: the sum has the rest position at which the forces balance."""
        self._springs.append((stiffness, rest))
        self.stiffness = sum(k for k, _ in self._springs)
        self.rest = sum(k * r for k, r in self._springs) / self.stiffness


def bodies(model: DynamicModel, chi: Array) -> tuple[SimulatedBody, ...]:
    """Rigid bodies of all links.

    A moment of inertia about the joint axis that violates the triangle inequality includes a rotor's; the excess is
    moved to the rotor where the two have the same regressor column.

    Args:
        chi: its free standard parameters, (p,), SI.

    Raises:
        PhysicalConsistencyError: no rigid body has the parameters of a link.
    """
    raw = model.device.parameters.S @ chi
    return tuple(_body(model, j, raw[10 * j : 10 * j + 10]) for j in range(len(model.device.joints)))


def effects(model: DynamicModel, chi: Array, made: tuple[SimulatedBody, ...]) -> tuple[Effect, ...]:
    """Effects of the terms: one for each joint, then one for each motor or cut joint that combines several joints.

    Raises:
        ExportError: a nonzero term without counterpart in MuJoCo.
        PhysicalConsistencyError: a joint moves neither mass nor rotor.
    """
    raw = model.device.parameters.S @ chi
    unit = np.eye(len(model.device.joints))
    found = {joint.name: Effect(joint.name, unit[j]) for j, joint in enumerate(model.device.joints)}
    single = list(found.values())
    for effect, body in zip(single, made, strict=True):
        effect.armature += body.moved
    for term, value in zip(model.terms, raw[10 * len(model.device.joints) :], strict=True):
        shares = joint_shares(model, term)
        used = np.flatnonzero(shares)
        if value == 0 or not len(used):
            continue
        if len(used) == 1:
            _add(single[int(used[0])], term, float(value), float(shares[used[0]]))
        else:
            _add(found.setdefault(term.on, Effect(term.on, shares)), term, float(value), 1.0)
    _regularise(model, made, single)
    moves_mass = _moves_mass(model, made, tuple(found.values()))
    if not all(moves_mass):
        link = model.device.joints[moves_mass.index(False)].name
        raise PhysicalConsistencyError(
            f"link {link} and all links beyond it have neither mass nor rotor inertia; the mass must be positive.",
            where=link,
            found=0.0,
            limit=0.0,
            advice="Give it mass, com and inertia: [[bodies]] of an experiment, [[prior.bodies]] of the device file.",
        )
    return tuple(found.values())


def has_counterpart(term: TermColumn) -> bool:
    """Whether the simulator has a term of this kind of its own."""
    dry = term.kind in COULOMB and term.settings[0] == 0
    return dry or term.kind in ("rotor", "viscous", "spring", "offset")


def joint_shares(model: DynamicModel, term: TermColumn) -> Array:
    """Coordinate of a term as a combination of all joints, (joints,)."""
    shares = np.zeros(len(model.device.joints))
    what, _, name = term.on.partition(" ")
    if what == "joint":
        shares[model.device.joint_names.index(name)] = 1.0
    elif what in ("motor", "elastic"):
        drive = next(drive for drive in model.device.drives if drive.name == name)
        return drive.row if what == "motor" else drive.torsion
    else:
        shares[list(model.device.active)] = term.weights @ model.device.row_map
    return shares


def _add(effect: Effect, term: TermColumn, value: float, share: float) -> None:
    """Add a term whose coordinate is `share` times the effect's."""
    width = term.settings[0]
    if term.kind == "rotor":
        effect.armature += value * share**2
    elif term.kind == "viscous":
        effect.viscous += value * share**2
    elif term.kind == "coulomb" and width == 0:
        effect.coulomb += value * abs(share)
    elif term.kind in ("coulomb+", "coulomb-") and width == 0:
        effect.coulomb += value * abs(share) / 2  # F+ and F- are their mean, and half their difference as an offset
        effect.offset += (1 if term.kind == "coulomb+" else -1) * value * share / 2
    elif term.kind == "spring":
        combined = term.on.startswith(("cut ", "coordinate "))
        start = term.offset if combined else 0.0  # where its combination of joints is zero
        effect.spring(value * share**2, (term.settings[0] - start) / share)
    elif term.kind == "offset":
        effect.offset += value * share
    else:
        raise ExportError(
            f"term {term.name} = {value:g} is of kind {term.kind!r}, which simulated joints do not have; supported are "
            "rotor, viscous, coulomb (of width 0), spring and offset.",
            where=term.name,
            found=value,
            advice=f"Take a device without this term, or set {term.name} to 0.",
        )


def _body(model: DynamicModel, j: int, chi: Array) -> SimulatedBody:
    """Body of one link from its ten standard parameters, (10,)."""
    joint, mass = model.device.joints[j], float(chi[9])
    J = np.zeros((3, 3))
    for value, (i, k) in zip(chi[:6], TENSOR, strict=True):
        J[i, k] = J[k, i] = value
    if not chi.any():
        return SimulatedBody(0.0, np.zeros(3), J)
    if mass <= 0:
        alone = mass == 0 and J[2, 2] > 0 and not np.delete(chi, 5).any()
        if alone and _is_rotor(model, j):
            return SimulatedBody(0.0, np.zeros(3), np.zeros((3, 3)), float(J[2, 2]))
        raise _unphysical_body(joint.name, f"its mass is {mass:g} kg but other parameters are not zero", mass)
    com = chi[6:9] / mass
    central = J - mass * (com @ com * np.eye(3) - np.outer(com, com))
    central, moved = _physical(model, j, central)
    return SimulatedBody(mass, com, central, moved)


def _physical(model: DynamicModel, j: int, central: Array) -> tuple[Array, float]:
    """A tensor that satisfies the triangle inequality, and the inertia that was moved to the rotor."""
    moments = np.linalg.eigvalsh(central)
    excess = moments[2] - moments[0] - moments[1]
    if moments[0] > 0 and excess <= TRIANGLE_SLACK * moments[2]:
        return central, 0.0
    if abs(moments[0]) <= _THIN_ROD * moments[2] and moments[2] - moments[1] <= _THIN_ROD * moments[2]:  # a thin rod
        line = np.linalg.eigh(central)[1][:, 0]
        return central + 2 * _THIN_ROD * moments[2] * np.outer(line, line), 0.0
    moved = (1 + 2 * MOVED_SPARE) * excess + MOVED_SPARE * (moments[0] + moments[1])
    less = central - np.diag([0.0, 0.0, moved])
    now = np.linalg.eigvalsh(less)
    if moments[0] > 0 and now[0] > 0 and now[2] <= now[0] + now[1] and _is_rotor(model, j):
        return less, float(moved)
    values = ", ".join(f"{moment:.3g}" for moment in moments)
    rule = "not positive" if moments[0] <= 0 else "above the sum of the other two"
    what = f"its principal moments of inertia about the centre of mass are {values} kg m^2, one of them {rule}"
    raise _unphysical_body(model.device.joints[j].name, what, moments.tolist())


def _is_rotor(model: DynamicModel, j: int) -> bool:
    """Whether inertia about a revolute joint's axis has the same regressor column as its rotor inertia."""
    if model.device.joints[j].prismatic:
        return False
    rng = np.random.default_rng(0)
    c = np.ascontiguousarray(model.device.row_map @ model.device.closure.draw(rng, 20))
    cd, cdd = rng.uniform(-2, 2, (2, *c.shape))
    column = rows(model, c, cd, cdd)[:, 10 * j + 5]
    followed = model.follow(c, cd)
    G = np.broadcast_to(followed.G, (20, *model.device.rates.shape))[:, j].T
    rotor = G * followed.acceleration(cd, cdd)[j]
    return bool(np.abs(column - rotor).max() <= SAME_COLUMN * max(np.abs(rotor).max(), 1e-300))


def _regularise(model: DynamicModel, made: tuple[SimulatedBody, ...], single: list[Effect]) -> None:
    """Give massless links inside a loop a negligible rotor inertia.

    The simulator integrates the tree, whose mass matrix would be singular there.
    """
    if not isinstance(model.device.closure, NewtonClosure):
        return
    masses = np.array([body.mass for body in made])
    turned = np.array([np.trace(body.inertia) + body.mass * body.com @ body.com for body in made])
    moves_mass = _moves_mass(model, made, tuple(single))
    for j in model.device.closure.unknown:
        if not moves_mass[j]:
            single[j].armature = LIGHT * float((masses if model.device.joints[j].prismatic else turned).max())


def _moves_mass(model: DynamicModel, made: tuple[SimulatedBody, ...], found: tuple[Effect, ...]) -> list[bool]:
    """Whether each joint moves a mass or a rotor, of its own link or of one that it carries."""
    moves = [not body.weightless or any(e.armature > 0 and e.joints[j] for e in found) for j, body in enumerate(made)]
    for j in reversed(range(len(made))):
        if moves[j] and model.device.joints[j].parent >= 0:
            moves[model.device.joints[j].parent] = True
    return moves


def _unphysical_body(link: str, what: str, found: object) -> PhysicalConsistencyError:
    return PhysicalConsistencyError(
        f"link {link}: {what}, which no rigid body has, so it cannot be simulated.",
        where=link,
        found=found,
        advice="Base parameters do not define a body: give the link's mass, com and inertia: [[bodies]] of an "
        "experiment, or [[prior.bodies]] of the device file.",
    )
