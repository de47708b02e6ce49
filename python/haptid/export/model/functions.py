"""The functions of the generated code, each as expressions of its inputs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.export.expressions.emit import Function
from haptid.export.expressions.factoring import shortest
from haptid.export.expressions.graph import PARAMETER, Expr, Graph, Operations, cost, operations
from haptid.export.expressions.polynomial import TRIALS, cheapest
from haptid.export.expressions.solving import Factors, force, mobility
from haptid.export.model.composite import mass_matrix_expressions
from haptid.export.model.hamilton import momentum_expressions
from haptid.export.model.handle import HandleExpressions, handle_expressions
from haptid.export.model.moments import moments_of
from haptid.export.model.newton import Bodies, inverse_dynamics_expressions
from haptid.export.model.terms import term_torque
from haptid.export.model.tree import Tree, tree_of

# Factor on the number of orders tried for the inverse dynamics, which is called most.
MORE = 4


@dataclass(frozen=True, eq=False)
class Code:
    """The functions of one mechanism; see `code_of`.

    Attributes:
        graph: the store of their expressions.
        functions: in the order of the file.
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
    """

    model: DynamicModel
    graph: Graph
    functions: tuple[Function, ...]
    speed: float

    def __getitem__(self, name: str) -> Function:
        return next(function for function in self.functions if function.name == name)

    def __contains__(self, name: str) -> bool:
        return any(function.name == name for function in self.functions)

    @property
    def operations(self) -> dict[str, Operations]:
        """Operation count of one call of every function."""
        return {function.name: operations(self.graph, function.all) for function in self.functions}


def code_of(model: DynamicModel, speed: float, zero: Collection[int] = ()) -> Code:
    """All functions of a device, with its base parameters as symbols.

    Args:
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
        zero: indices of eliminated base parameters, zero in the code.

    Raises:
        ExportError: a term that code cannot compute, or loops that are not linear.
    """
    varying = model.device.varying.any(axis=1)
    if varying.any():
        passive = [model.device.joint_names[j] for j in np.flatnonzero(varying)]
        raise ExportError(
            f"{model.device.name} has nonlinear loops: {', '.join(passive)} depend nonlinearly on the active joints.",
            where=model.device.name,
            found=passive,
            advice="Code without iterations exists only for linear loops: parallelograms, couplings and mimic joints.",
        )
    graph, tree = Graph(), tree_of(model)
    none = graph.number(0.0)
    parameters = [none if k in zero else graph.name(f"p[{k}]", PARAMETER) for k in range(len(model.base))]
    bodies = Bodies.of(moments_of(model), parameters, tree.length)
    made = _Functions(model, graph, tree, bodies, parameters, speed)
    functions = [*made.torques(), *made.rigid(), made.momentum()]
    if model.device.handle is not None:
        functions += made.at_handle(handle_expressions(tree, model.device.handle, made.q))
    return Code(model, graph, tuple(functions), speed)


def cheapest_form(graph: Graph, outputs: Sequence[Expr], trials: int = TRIALS) -> list[Expr]:
    """The outputs in the cheapest form found: factored recursion, or Horner form of small polynomials."""
    nested = cheapest(graph, outputs, trials)
    forms = [shortest(graph, outputs)] + ([] if nested is None else [nested])
    return min(forms, key=lambda form: cost(graph, form))


@dataclass(frozen=True, eq=False)
class _Functions:
    """Builder of the functions: mechanism, parameters and input symbols."""

    model: DynamicModel
    graph: Graph
    tree: Tree
    bodies: Bodies
    parameters: Sequence[Expr]
    speed: float
    q: list[Expr] = field(init=False)
    qd: list[Expr] = field(init=False)
    qdd: list[Expr] = field(init=False)
    tau: list[Expr] = field(init=False)

    def __post_init__(self) -> None:
        for name in ("q", "qd", "qdd", "tau"):
            symbols = [self.graph.name(f"{name}[{k}]") for k in range(self.tree.active)]
            object.__setattr__(self, name, symbols)

    @property
    def none(self) -> list[Expr]:
        return [self.graph.number(0.0)] * self.tree.active

    def sizes(self, *names: str) -> tuple[tuple[str, int], ...]:
        return tuple((name, self.tree.active) for name in names)

    def newton(self, qd: list[Expr], qdd: list[Expr]) -> list[Expr]:
        return inverse_dynamics_expressions(self.tree, self.bodies, self.q, qd, qdd, self.tree.gravity)

    def torques(self) -> list[Function]:
        """Torques: inverse dynamics, gravity, terms and friction."""
        inverse = cheapest_form(self.graph, self.newton(self.qd, self.qdd), MORE * TRIALS)
        gravity = cheapest_form(self.graph, self.newton(self.none, self.none))
        terms = term_torque(self.model, self.parameters, self.q, self.qd, self.speed, friction_only=False)
        friction = term_torque(self.model, self.parameters, self.q, self.qd, self.speed, friction_only=True)
        return [
            Function(
                "inverse_dynamics",
                ("Torque of bodies and rotors, M qdd + C qd + g: no friction, no springs, N m or N.",),
                self.sizes("q", "qd", "qdd"),
                (("tau", tuple(inverse)),),
            ),
            Function(
                "gravity",
                ("Gravity torque of the bodies, N m or N.",),
                self.sizes("q"),
                (("tau", tuple(gravity)),),
            ),
            Function(
                "terms",
                (
                    "Torque of friction, springs, offsets and all terms other than bodies and rotors, N m or N.",
                    f"The sign of a velocity v is tanh(v / {self.speed:g}), or smoother if the device file says so.",
                ),
                self.sizes("q", "qd"),
                (("tau", tuple(shortest(self.graph, terms))),),
            ),
            Function(
                "friction",
                ("Friction torque, viscous and dry, N m or N; smoothed in the same way.",),
                self.sizes("qd"),
                (("tau", tuple(shortest(self.graph, friction))),),
            ),
        ]

    def rigid(self) -> list[Function]:
        """Mass matrix and forward dynamics."""
        mass = self.mass(self.tree.relative(self.q))
        full = tuple(mass[a][b] for a in range(self.tree.active) for b in range(self.tree.active))
        turns = self.tree.turns(self.q)
        low = _low(mass_matrix_expressions(self.tree, self.bodies, self.q, self.tree.differences(turns)))
        both = cheapest_form(self.graph, [*self.newton(self.qd, self.none), *low])
        bias, entries = both[: self.tree.active], both[self.tree.active :]
        made = Function(
            "mass_matrix",
            ("Mass matrix including rotors, kg m^2, kg m or kg.",),
            self.sizes("q"),
            (("M", full),),
        )
        try:
            factors = Factors.of(_full(entries, self.tree.active))
        except ZeroDivisionError:  # a coordinate without inertia
            return [made]
        qdd = factors.solve([t - h for t, h in zip(self.tau, bias, strict=True)])
        return [
            made,
            Function(
                "forward_dynamics",
                (
                    "Accelerations from the torque on bodies and rotors: that of the motors less friction, springs and",
                    "other terms, plus that of the hand. rad/s^2 or m/s^2.",
                ),
                self.sizes("q", "qd", "tau"),
                (("qdd", tuple(qdd)),),
                tuple(factors.checks),
            ),
        ]

    def mass(self, relative: list[tuple[Expr, Expr]]) -> list[list[Expr]]:
        """The matrix from joint angles or from absolute angles, whichever is cheaper."""
        own = _low(mass_matrix_expressions(self.tree, self.bodies, self.q, relative))
        turns = self.tree.turns(self.q)
        absolute = _low(mass_matrix_expressions(self.tree, self.bodies, self.q, self.tree.differences(turns)))
        forms = [cheapest_form(self.graph, form) for form in (own, absolute)]
        return _full(min(forms, key=lambda form: cost(self.graph, form)), self.tree.active)

    def momentum(self) -> Function:
        """Generalised momentum and its remainder, for the momentum observer."""
        p, slope = momentum_expressions(self.tree, self.bodies, self.q, self.qd, self.tree.turns(self.q))
        gravity = self.newton(self.none, self.none)
        rest = [g - s for g, s in zip(gravity, slope, strict=True)]
        both = cheapest_form(self.graph, [*p, *rest])
        n = self.tree.active
        return Function(
            "momentum",
            ("Generalised momentum p = M qd, kg m^2/s or kg m/s, and rest in tau = dp/dt + rest, N m or N.",),
            self.sizes("q", "qd"),
            (("p", tuple(both[:n])), ("rest", tuple(both[n:]))),
        )

    def at_handle(self, handle: HandleExpressions) -> list[Function]:
        """Pose and Jacobian of the handle, and where they exist its mobility and force."""
        n = self.tree.active
        pose = cheapest_form(self.graph, [*handle.position, *(x for row in handle.rotation for x in row)])
        entries = cheapest_form(self.graph, [x for row in handle.jacobian for x in row])
        J = [entries[k : k + n] for k in range(0, 3 * n, n)]
        made = [
            Function(
                "handle_pose",
                ("Origin of the handle in the base frame, m, and its rotation matrix, 3 x 3.",),
                self.sizes("q"),
                (("position", tuple(pose[:3])), ("rotation", tuple(pose[3:]))),
                parameters=False,
            ),
            Function(
                "handle_jacobian",
                (
                    f"Jacobian, 6 x {n}: linear, then angular velocity of the handle in the base frame, per rate of",
                    "the coordinates. Its transpose maps a wrench to torques.",
                ),
                self.sizes("q"),
                (("J", tuple(entries)),),
                parameters=False,
            ),
        ]
        optional = [self._mobility] + [self._force] * all(self.model.device.measured)
        for function in optional:
            with suppress(ZeroDivisionError):  # singular in every pose
                made.append(function(J))
        return made

    def _mobility(self, J: list[list[Expr]]) -> Function:
        turns = self.tree.turns(self.q)
        low = _low(mass_matrix_expressions(self.tree, self.bodies, self.q, self.tree.differences(turns)))
        factors = Factors.of(_full(cheapest_form(self.graph, low), self.tree.active))
        A = mobility(factors, J)
        return Function(
            "handle_mobility",
            ("Mobility Jv M^-1 Jv', 3 x 3: acceleration of the handle per force on it, in the base frame, 1/kg.",),
            self.sizes("q"),
            (("mobility", tuple(x for row in A for x in row)),),
            tuple(factors.checks),
        )

    def _force(self, J: list[list[Expr]]) -> Function:
        found, checks = force(J, self.tau)
        return Function(
            "handle_force",
            ("Force at the handle's origin equivalent to these torques, in the base frame, without moment, N.",),
            self.sizes("q", "tau"),
            (("force", tuple(found)),),
            tuple(checks),
            parameters=False,
        )


def _low(M: list[list[Expr]]) -> list[Expr]:
    """Lower triangle, row by row."""
    return [M[a][b] for a in range(len(M)) for b in range(a + 1)]


def _full(low: list[Expr], n: int) -> list[list[Expr]]:
    rows, columns = np.tril_indices(n)
    made = [[low[0]] * n for _ in range(n)]
    for a, b, value in zip(rows, columns, low, strict=True):
        made[a][b] = made[b][a] = value
    return made
