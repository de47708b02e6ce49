"""Springs behind motors as expressions: the torque that they carry, their constants, and the rotors before them.

Source: De Luca and Book (2016), Springer Handbook of Robotics, section 11.1: of M qdd + n = s and B thetadd + f =
tau - s, with s = K (theta - q) + D (thetad - qd), the first gives the springs' torque s along a motion of the links,
the second along one of the motors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.elastic import torsion_places
from haptid.device.terms.term import TermColumn
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.emit import Function
from haptid.export.expressions.graph import Expr, Graph
from haptid.export.expressions.vectors import combined
from haptid.export.model.newton import Bodies
from haptid.export.model.terms import term_torque
from haptid.export.model.tree import Tree


def has_linear_springs(model: DynamicModel) -> bool:
    """Whether motors are elastic, none with play, and no motor's rates vary with the pose."""
    springs = [term for term in model.terms if term.on.startswith("elastic ") and term.nature == "spring"]
    linear = all(term.kind == "spring" and term.settings[0] == 0.0 for term in springs)
    return bool(springs) and linear and not model.device.drive_varies.any()


def spring_shares(model: DynamicModel) -> Array:
    """Torques of the springs by those of the links on all coordinates, (springs, active); none by those of torsions."""
    device = model.device
    held = np.delete(np.arange(len(device.active)), torsion_places(model.device))
    shares = device.law.of(device.driven).shares(device.drive_rates[device.driven][:, held])
    motors = [drive.name for drive in device.motors]
    made = np.zeros((len(device.elastic), len(device.active)))
    made[:, held] = shares[[motors.index(drive.name) for drive in device.elastic]]
    return made


def on_rotor(model: DynamicModel, term: TermColumn) -> bool:
    """Whether a term acts on the rotor of an elastic motor."""
    return term.on in [f"motor {drive.name}" for drive in model.device.elastic]


def on_links(model: DynamicModel, term: TermColumn) -> bool:
    """Whether a term is neither on the rotor of an elastic motor nor its spring or damper."""
    return not (term.on.startswith("elastic ") or on_rotor(model, term))


def links_of(model: DynamicModel, bodies: Bodies) -> Bodies:
    """The bodies without the rotors before springs."""
    own = torsion_places(model.device)
    return replace(bodies, rotors=tuple(one for one in bodies.rotors if not one[0][own].any()))


def spring_constants(model: DynamicModel, parameters: Sequence[Expr], graph: Graph) -> Function:
    """Stiffness and damping of the springs."""
    made = {nature: _of_each(model, parameters, graph, nature, "elastic") for nature in ("spring", "viscous")}
    return Function(
        "springs",
        ("Stiffness and damping of the springs behind motors, N m/rad and N m s/rad, or N/m and N s/m.",),
        (),
        (("stiffness", made["spring"]), ("damping", made["viscous"])),
    )


def rotor_function(model: DynamicModel, tree: Tree, parameters: Sequence[Expr], graph: Graph, speed: float) -> Function:
    """Momentum of the rotors and the torque of the terms on them, from the positions of the motors alone."""
    own, count = torsion_places(model.device), len(model.device.elastic)
    theta, thetad = ([graph.name(f"{text}[{k}]") for k in range(count)] for text in ("theta", "thetad"))
    # The rotors' terms depend on their own positions: links at zero, and torsions as large as the rotors' positions.
    q, qd = ([graph.number(0.0)] * tree.coordinates for _ in range(2))
    for place, x, v in zip(own, theta, thetad, strict=True):
        q[place], qd[place] = x, v
    tau = term_torque(model, tree, parameters, q, qd, speed, partial(on_rotor, model))
    inertia = _of_each(model, parameters, graph, "rotor", "motor")
    return Function(
        "rotors",
        (
            "Momentum p of the rotors before springs, and the torque rest of friction and other terms on them:",
            "tau = dp/dt + rest + spring, with theta the positions of these motors at the joint side.",
        ),
        (("theta", count), ("thetad", count)),
        (("p", tuple(i * v for i, v in zip(inertia, thetad, strict=True))), ("rest", tuple(tau[k] for k in own))),
    )


def _of_each(model: DynamicModel, parameters: Sequence[Expr], graph: Graph, nature: str, what: str) -> tuple[Expr, ...]:
    """The parameter of this nature of every elastic motor; zero where it has none."""
    S = model.device.parameters.S[10 * len(model.device.joints) :, list(model.base.independent_columns)]
    made = [graph.number(0.0)] * len(model.device.elastic)
    for k, drive in enumerate(model.device.elastic):
        for term, row in zip(model.terms, S, strict=True):
            if term.on == f"{what} {drive.name}" and term.nature == nature:
                made[k] = made[k] + combined(row, parameters)
    return tuple(made)
