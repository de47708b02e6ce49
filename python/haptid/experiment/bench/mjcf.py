"""MJCF (MuJoCo XML) of a device with its true parameters, as the bench simulates it.

Settings: stiff pins (`solref` from the step), RK4, and Coulomb friction as close to discontinuous as the solver allows,
see docs/bench.md. Source: MuJoCo documentation, "Computation", sections "Constraint model" and "Numerical integration".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import factorial
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from haptid._internal.arrays import Array, expect
from haptid._internal.escaping import printable
from haptid._internal.late import dataclass
from haptid.device import Cut, FormulaClosure, Frame, NewtonClosure
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.compensation.hands import HandModel
from haptid.errors import ExportError, IncompleteDeviceError
from haptid.experiment.bench.bodies import Effect, SimulatedBody, bodies, effects
from haptid.experiment.bench.limits import cuts_of_unknown, determined_by_pins

# Mass and inertia of a massless link: MuJoCo rejects moving bodies below 1e-15 (kg, kg m^2).
_LEAST = 2e-15
# Stiffest constraint that MuJoCo accepts.
STIFF = "0.9999 0.9999 0.001 0.5 2"
# Distance of the two pins of a hinge, relative to the mechanism's size.
HINGE = 0.1
# Radius of a link's capsule, relative to the mechanism's size.
THIN = 0.02
# Highest degree of MuJoCo's equality between two joints.
_HIGHEST = 4
HANDLE, PAYLOAD, HAND = "handle", "payload", "hand"


@dataclass(frozen=True)
class Physics:
    """Settings of the simulator.

    Attributes:
        step: integration step, s.
        tolerance, iterations: of its Newton constraint solver.
    """

    step: float = 1e-4
    tolerance: float = 1e-10
    iterations: int = 50


@dataclass(frozen=True)
class SimulatedPayload:
    """Point mass fixed to the handle.

    Attributes:
        mass: kg.
        com: position in the handle frame, (3,), m.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)


def mjcf(
    model: DynamicModel,
    chi: Array,
    physics: Physics | None = None,
    payload: SimulatedPayload | None = None,
    hand: tuple[HandModel, Array] | None = None,
) -> str:
    """The device as MJCF.

    Joints, bodies and sites have the device's names; the input of the actuator `motor <name>` is the torque on that
    motor coordinate, at the joint side, N m or N; the actuators `offset <joint>` are constant forces without input.

    Args:
        chi: its true free standard parameters, (p,), SI.
        physics: settings of the simulator; the default where None.
        payload: point mass at the handle, if any.
        hand: that holds the handle, and where the handle is at the start, (3,), m; its joints and its actuators (the
            grasp along x, y, z, then the arm) are the last of each kind.

    Raises:
        PhysicalConsistencyError, ExportError: the device cannot be simulated.
        IncompleteDeviceError: a payload on a device without handle.
    """
    physics = physics or Physics()
    chi = np.asarray(chi, dtype=float)
    expect("chi", chi.shape, (len(model.device.parameters),))
    if payload is not None and model.device.handle is None:
        raise IncompleteDeviceError(
            f"the experiment has a payload, but {model.device.name} has no handle.",
            where="payload",
            advice="Add [handle] to the device file.",
        )
    made = bodies(model, chi)
    acts = effects(model, chi, made)
    root = Element("mujoco", model=printable(model.device.name))
    _settings(root, model, physics)
    world = SubElement(root, "worldbody")
    SubElement(world, "light", pos="0 0 3", dir="0 0 -1", directional="true")
    _tree(world, model, made, acts, physics, payload)
    _coordinates(root, model, acts, physics)
    _loops(root, model, physics)
    actuators = _actuators(root, model, acts)
    if hand is not None:
        _hand(world, actuators, *hand)
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def numbers(values: Iterable[float]) -> str:
    """Numbers with all digits (round-trip), separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def cut_sites(model: DynamicModel) -> tuple[tuple[str, str], ...]:
    """Names of the two sites of every pin that closes a loop; none where loops are imposed by linear relations.

    A planar loop needs one pin at each cut joint, a spatial loop two along the cut axis: a hinge.
    """
    return tuple((a, b) for a, b, _ in _pins(model))


def _pins(model: DynamicModel) -> list[tuple[str, str, Cut]]:
    """Names of both sites of every pin, and its cut joint, shifted along its axis for the second pin of a hinge."""
    cuts = model.device.closure.cuts
    if any(cut.kind == "prismatic" for cut in cuts):
        if isinstance(model.device.closure, NewtonClosure):
            raise ExportError(
                f"{model.device.name}: a nonlinear loop is cut at a prismatic joint, which the simulator cannot model "
                "by pins; only revolute and spherical cuts are supported.",
                where=model.device.name,
                advice="Cut the loop at a revolute or spherical joint, and list the prismatic one in [[joints]].",
            )
        return []
    closure = model.device.closure
    found = [(f"cut {k + 1} a", f"cut {k + 1} b", cut) for k, cut in enumerate(cuts)]
    if isinstance(closure, NewtonClosure) and not determined_by_pins(closure):
        arm, spatial = HINGE * size(model), cuts_of_unknown(closure)
        pins = [pin for pin, hinge in zip(found, spatial, strict=True) if hinge and pin[2].kind == "revolute"]
        found += [(f"{a} axis", f"{b} axis", _along_axis(cut, arm)) for a, b, cut in pins]
    return found


def _along_axis(cut: Cut, arm: float) -> Cut:
    """The cut joint with its frames shifted along their z axes."""
    one, other = (Frame(f.link, f.rotation, f.translation + arm * f.rotation[:, 2]) for f in (cut.frame_a, cut.frame_b))
    return Cut(cut.kind, one, other)


def _settings(root: Element, model: DynamicModel, physics: Physics) -> None:
    free = {"angle": "radian", "autolimits": "true", "boundmass": "0", "boundinertia": "0", "balanceinertia": "false"}
    SubElement(root, "compiler", free)
    option = {
        "timestep": repr(physics.step),
        "integrator": "RK4",
        "solver": "Newton",
        "tolerance": repr(physics.tolerance),
        "iterations": str(physics.iterations),
        "gravity": numbers(model.device.gravity),
    }
    SubElement(SubElement(root, "option", option), "flag", contact="disable", autoreset="disable", island="disable")
    SubElement(SubElement(root, "default"), "geom", contype="0", conaffinity="0", rgba="0.45 0.55 0.7 1")


def _tree(
    world: Element,
    model: DynamicModel,
    made: Sequence[SimulatedBody],
    acts: Sequence[Effect],
    physics: Physics,
    payload: SimulatedPayload | None,
) -> None:
    """Bodies, joints, sites and capsules."""
    elements: list[Element] = []
    radius = THIN * size(model)
    for j, (joint, body) in enumerate(zip(model.device.joints, made, strict=True)):
        above = world if joint.parent < 0 else elements[joint.parent]
        element = SubElement(above, "body", {"name": joint.name, **_placed(joint.rotation, joint.translation)})
        elements.append(element)
        kind = {"name": joint.name, "type": "slide" if joint.prismatic else "hinge", "axis": "0 0 1"}
        SubElement(element, "joint", kind | _effect(acts[j], physics))
        SubElement(element, "inertial", _inertial(body))
        _sites(element, model, j, radius)
        _capsules(element, model, j, radius)
    _sites(world, model, -1, radius)
    if payload is not None and model.device.handle is not None:
        at = model.device.handle
        carrier = world if at.link < 0 else elements[at.link]
        element = SubElement(carrier, "body", {"name": PAYLOAD, **_placed(at.rotation, at.translation)})
        mass = {"mass": repr(payload.mass), "pos": numbers(payload.com), "diaginertia": "0 0 0"}
        SubElement(element, "inertial", mass)
        SubElement(element, "geom", type="sphere", size=repr(2 * radius), pos=numbers(payload.com), mass="0")


def _sites(element: Element, model: DynamicModel, link: int, radius: float) -> None:
    """Sites of a link, -1 for the base."""
    for name, frame in _frames(model):
        if frame.link == link:
            placed = _placed(frame.rotation, frame.translation)
            SubElement(element, "site", {"name": name, "size": repr(radius), **placed})


def _frames(model: DynamicModel) -> list[tuple[str, Frame]]:
    """Named frames that become sites: those of the cut joints and the handle."""
    found: list[tuple[str, Frame]] = []
    for a, b, cut in _pins(model):
        found += [(a, cut.frame_a), (b, cut.frame_b)]
    if model.device.handle is not None:
        found.append((HANDLE, model.device.handle))
    return found


def _placed(rotation: Array, translation: Array) -> dict[str, str]:
    return {"pos": numbers(translation), "xyaxes": numbers([*rotation[:, 0], *rotation[:, 1]])}


def _inertial(body: SimulatedBody) -> dict[str, str]:
    if body.weightless:
        return {"mass": repr(_LEAST), "pos": "0 0 0", "diaginertia": numbers([_LEAST] * 3)}
    J = body.inertia
    full = (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
    return {"mass": repr(body.mass), "pos": numbers(body.com), "fullinertia": numbers(full)}


def _effect(effect: Effect, physics: Physics, rest: str = "springref") -> dict[str, str]:
    """Attributes of a joint or tendon for rotor inertia, friction and spring."""
    given: dict[str, str] = {}
    if effect.armature:
        given["armature"] = repr(effect.armature)
    if effect.viscous:
        given["damping"] = repr(effect.viscous)
    if effect.stiffness:
        given |= {"stiffness": repr(effect.stiffness), rest: repr(effect.rest)}
    if effect.coulomb:
        given["frictionloss"] = repr(effect.coulomb)
        given |= {"solreffriction": f"0 {-1 / physics.step!r}", "solimpfriction": STIFF}
    return given


def _capsules(element: Element, model: DynamicModel, j: int, radius: float) -> None:
    """Bars from a link's origin to its children and sites, for display only."""
    ends = [joint.translation for joint in model.device.joints if joint.parent == j]
    ends += [np.asarray(frame.translation) for _, frame in _frames(model) if frame.link == j]
    drawn = [end for end in ends if np.linalg.norm(end) > 2 * radius]
    for end in drawn:
        line = numbers([0, 0, 0, *end])
        SubElement(element, "geom", type="capsule", size=repr(radius), fromto=line, mass="0")
    if not drawn:
        SubElement(element, "geom", type="sphere", size=repr(1.5 * radius), mass="0")


def size(model: DynamicModel) -> float:
    """Rough extent of the mechanism, m: the longest path along the tree; 0.1 where all lengths are zero."""
    reach = np.zeros(len(model.device.joints))
    for j, joint in enumerate(model.device.joints):
        reach[j] = np.linalg.norm(joint.translation) + (reach[joint.parent] if joint.parent >= 0 else 0.0)
    handle = 0.0 if model.device.handle is None else float(np.linalg.norm(model.device.handle.translation))
    return float(reach.max() + handle) or 0.1


def _coordinates(root: Element, model: DynamicModel, acts: Sequence[Effect], physics: Physics) -> None:
    """Tendons: coordinates of motors and cut joints that combine several joints, and relations of passive joints."""
    tendons = SubElement(root, "tendon")
    for name, shares in _combined(model):
        act = next((a for a in acts if a.name == name), Effect(name, shares))
        _fixed(tendons, model, name, shares, _effect(act, physics, "springlength"))
    for act in acts:
        if act.name.startswith(("cut ", "coordinate ", "elastic ")):
            _fixed(tendons, model, act.name, act.joints, _effect(act, physics, "springlength"))
    if not isinstance(model.device.closure, NewtonClosure) and not cut_sites(model):
        for j in _passive(model):
            if model.device.closure.varying[j].any():
                continue
            shares = -model.device.closure.constant[j] @ np.eye(len(model.device.joints))[list(model.device.active)]
            shares[j] += 1.0
            _fixed(tendons, model, f"relation {model.device.joints[j].name}", shares, {})


def _fixed(tendons: Element, model: DynamicModel, name: str, shares: Array, settings: dict[str, str]) -> None:
    tendon = SubElement(tendons, "fixed", {"name": name, **settings})
    for k in np.flatnonzero(shares):
        SubElement(tendon, "joint", joint=model.device.joints[k].name, coef=repr(float(shares[k])))


def _combined(model: DynamicModel) -> list[tuple[str, Array]]:
    """Motors that move several joints: name, and weight of every joint."""
    found = []
    for drive in model.device.drives:
        if np.count_nonzero(drive.row) > 1:
            found.append((f"motor {drive.name}", drive.row))
    return found


def _passive(model: DynamicModel) -> list[int]:
    return [j for j in range(len(model.device.joints)) if j not in model.device.active]


def _loops(root: Element, model: DynamicModel, physics: Physics) -> None:
    """Pins of the cut joints; the relations of the passive joints where there are no cuts or one is prismatic."""
    equality = SubElement(root, "equality")
    h = physics.step
    stiff = {"solref": f"{-1 / h**2!r} {-2 / h!r}", "solimp": STIFF}
    for one, other in cut_sites(model):
        SubElement(equality, "connect", {"site1": one, "site2": other, **stiff})
    if not cut_sites(model):
        zero = np.zeros(len(model.device.joints))
        for j in _passive(model):
            if model.device.closure.varying[j].any():
                SubElement(equality, "joint", polynomial_equality(model, j, zero) | stiff)
                continue
            constant = numbers([model.device.closure.offset[j], 0, 0, 0, 0])
            name = f"relation {model.device.joints[j].name}"
            SubElement(equality, "tendon", {"tendon1": name, "polycoef": constant, **stiff})


def polynomial_equality(model: DynamicModel, j: int, ref: Array) -> dict[str, str]:
    """Attributes of MuJoCo's equality for a joint that follows one other by a polynomial, about reference positions.

    Args:
        j: index of the joint.
        ref: reference positions of all joints, (joints,), rad or m.

    Raises:
        ExportError: it follows several joints, or its degree is above four.
    """
    closure, device = model.device.closure, model.device
    assert isinstance(closure, FormulaClosure)
    polynomial = closure.polynomials[j]
    degree = max(map(len, polynomial.terms))
    if len(polynomial.symbols) > 1 or degree > _HIGHEST:
        raise ExportError(
            f"{device.name}: joint {device.joints[j].name} follows {len(polynomial.symbols)} joints by a polynomial of "
            f"degree {degree}; MuJoCo has those of one joint up to degree {_HIGHEST}.",
            where=device.joints[j].name,
            found=degree,
            limit=_HIGHEST,
            advice="Describe it by a relation of that kind to simulate the device.",
        )
    (symbol,) = polynomial.symbols
    k = device.active[closure.symbols.index(symbol)]
    about, factors = polynomial, []
    for power in range(_HIGHEST + 1):
        factors.append(float(about.value({symbol: ref[k]})) / factorial(power))
        about = about.slope(symbol)
    names = {"name": f"relation {device.joints[j].name}", "joint1": device.joints[j].name}
    return {**names, "joint2": device.joints[k].name, "polycoef": numbers([factors[0] - ref[j], *factors[1:]])}


def _hand(world: Element, actuators: Element, hand: HandModel, start: Array) -> None:
    """The mass of the hand on three slides; the grasp acts between its site and the handle's, the arm on the slides."""
    # The person carries the weight of the hand.
    body = SubElement(world, "body", {"name": HAND, "pos": numbers(start), "gravcomp": "1"})
    SubElement(body, "inertial", mass=repr(hand.mass), pos="0 0 0", diaginertia=numbers([1e-3 * hand.mass] * 3))
    SubElement(body, "site", name=HAND)
    affine = {"gainprm": "1", "biastype": "affine"}
    for k, axis in enumerate(np.eye(3)):
        SubElement(body, "joint", {"name": f"{HAND} {'xyz'[k]}", "type": "slide", "axis": numbers(axis)})
        grasp = {"biasprm": numbers([0, -hand.grip_stiffness, -hand.grip_damping]), "gear": numbers([*axis, 0, 0, 0])}
        SubElement(actuators, "general", {"site": HANDLE, "refsite": HAND, **grasp, **affine})
    for k in range(3):
        arm = {"joint": f"{HAND} {'xyz'[k]}", "biasprm": numbers([0, -hand.stiffness, -hand.damping])}
        SubElement(actuators, "general", arm | affine)


def _actuators(root: Element, model: DynamicModel, acts: Sequence[Effect]) -> Element:
    """The motors in the device's order, then the constant forces."""
    actuators = SubElement(root, "actuator")
    for drive in model.device.motors:
        name = f"motor {drive.name}"
        if np.count_nonzero(drive.row) == 1:
            joint = model.device.joints[drive.first].name
            SubElement(actuators, "motor", name=name, joint=joint, gear=repr(float(drive.row[drive.first])))
        else:
            SubElement(actuators, "motor", name=name, tendon=name)
    for act in acts:
        if act.offset:
            on = {"joint": act.name} if np.count_nonzero(act.joints) == 1 else {"tendon": act.name}
            constant = {"gainprm": "0", "biastype": "affine", "biasprm": f"{-act.offset!r} 0 0"}
            SubElement(actuators, "general", {"name": f"offset {act.name}", **on, **constant})
    return actuators


def closed(model: DynamicModel, qa: Array) -> Array:
    """Positions of all joints on the closed loops, in MuJoCo's (depth-first) order, (joints,)."""
    return model.device.closure.positions(qa[:, None])[list(depth_first(model)), 0]


def depth_first(model: DynamicModel) -> tuple[int, ...]:
    """Indices of the device's joints in MuJoCo's order."""
    children: dict[int, list[int]] = {}
    for j, joint in enumerate(model.device.joints):
        children.setdefault(joint.parent, []).append(j)
    order: list[int] = []
    waiting = list(reversed(children.get(-1, [])))
    while waiting:
        j = waiting.pop()
        order.append(j)
        waiting.extend(reversed(children.get(j, [])))
    return tuple(order)
