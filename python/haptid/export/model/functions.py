"""The functions of the generated code, each as expressions of its inputs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache, partial

import numpy as np

from haptid._internal.late import dataclass
from haptid.device.parts import DistributionLaw
from haptid.dynamics.model import DynamicModel
from haptid.errors import index_of
from haptid.export.expressions.emit import Function
from haptid.export.expressions.factoring import shortest
from haptid.export.expressions.graph import PARAMETER, Expr, Graph, Operations, cost, operations
from haptid.export.expressions.polynomial import TRIALS, cheapest
from haptid.export.expressions.rewriting import replaced
from haptid.export.expressions.solving import Factors, Orthogonal, force, mobility
from haptid.export.expressions.vectors import Turn, combined, dot, snapped
from haptid.export.model.composite import mass_matrix_expressions
from haptid.export.model.elastic import (
    has_linear_springs,
    links_of,
    on_links,
    rotor_function,
    spring_constants,
    spring_shares,
)
from haptid.export.model.frames import FrameExpressions, frame_expressions
from haptid.export.model.hamilton import momentum_expressions
from haptid.export.model.loops import LoopExpressions
from haptid.export.model.moments import moments_of
from haptid.export.model.newton import Bodies, inverse_dynamics_expressions
from haptid.export.model.terms import term_torque
from haptid.export.model.tree import Tree, tree_of
from haptid.export.output import CCode, default_name
from haptid.export.provenance import Provenance

# Factor on the number of orders tried for the inverse dynamics, which is called most.
MORE = 4


@dataclass(frozen=True, eq=False)
class Code:
    """The functions of one mechanism; see `code_of`.

    Attributes:
        graph: the store of their expressions.
        functions: in the order of the file.
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
        passive: indices of the joints whose positions `close` finds.
    """

    model: DynamicModel
    graph: Graph
    functions: tuple[Function, ...]
    speed: float
    passive: tuple[int, ...] = ()

    def __getitem__(self, name: str) -> Function:
        return self.functions[index_of(name, [function.name for function in self.functions], "function")]

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
        ExportError: a term that code cannot compute.
    """
    return _code_of(model, speed, frozenset(zero))


@lru_cache(maxsize=4)  # the search for cheap forms takes seconds, and six formats write the same functions
def _code_of(model: DynamicModel, speed: float, zero: frozenset[int]) -> Code:
    graph, tree = Graph(), tree_of(model)
    none = graph.number(0.0)
    parameters = [none if k in zero else graph.name(f"p[{k}]", PARAMETER) for k in range(len(model.base))]
    made = _Functions(model, graph, tree, Bodies.of(moments_of(model), parameters, tree), parameters, speed)
    functions = [*made.closing(), *made.torques(), *made.rigid(), made.momentum()]
    if model.device.handle is not None:
        functions += made.at_handle(frame_expressions(tree, model.device.handle, made.x))
    if has_linear_springs(model):
        functions += made.elastic()
    return Code(model, graph, (*functions, *made.drives()), speed, tree.passive)


def code_for(source: Provenance, settings: CCode | None) -> tuple[Code, str]:
    """The functions of a model to export, without its eliminated parameters, and the prefix of their names."""
    settings = settings or CCode()
    name = settings.name or default_name(source.model.device.name)
    return code_of(source.model, settings.reversal_speed, source.zero), name


def cheapest_form(graph: Graph, outputs: Sequence[Expr], trials: int = TRIALS) -> list[Expr]:
    """The outputs in the cheapest form found: factored recursion, or Horner form of small polynomials."""
    nested = cheapest(graph, outputs, trials)
    forms = [shortest(graph, outputs)] + ([] if nested is None else [nested])
    return min(forms, key=lambda form: cost(graph, form))


@dataclass(frozen=True, eq=False)
class _Functions:
    """Builder of the functions: mechanism, parameters and input symbols.

    What depends on rates of passive joints is written with symbols for these and brought into its cheapest form; then
    the rates that the loops imply take their place.
    """

    model: DynamicModel
    graph: Graph
    tree: Tree
    bodies: Bodies
    parameters: Sequence[Expr]
    speed: float

    def names(self, text: str, count: int) -> list[Expr]:
        """Symbols of an array."""
        return [self.graph.name(f"{text}[{k}]") for k in range(count)]

    def by_coordinate(self, text: str, passive: str) -> list[Expr]:
        """Symbols for the coordinates of the rows, then for the passive joints."""
        return self.names(text, self.tree.active) + self.names(passive, len(self.tree.passive))

    @cached_property
    def x(self) -> list[Expr]:
        """Coordinates of the tree."""
        return self.by_coordinate("q", "z")

    @cached_property
    def xd(self) -> list[Expr]:
        return self.by_coordinate("qd", "zd")

    @cached_property
    def xdd(self) -> list[Expr]:
        return self.by_coordinate("qdd", "zdd")

    @cached_property
    def loops(self) -> LoopExpressions:
        return LoopExpressions.of(self.model, self.tree, self.x, self.xd)

    @property
    def none(self) -> list[Expr]:
        return [self.graph.number(0.0)] * self.tree.coordinates

    def rows(self, values: list[Expr]) -> list[Expr]:
        """The entries of the torque rows' coordinates."""
        return values[: self.tree.active]

    def sizes(self, *names: str) -> tuple[tuple[str, int], ...]:
        """Inputs; with positions those of the passive joints."""
        passive = (("z", len(self.tree.passive)),) if self.tree.passive else ()
        return tuple(each for name in names for each in ((name, self.tree.active), *(passive if name == "q" else ())))

    def newton(self, xd: list[Expr], xdd: list[Expr]) -> list[Expr]:
        return inverse_dynamics_expressions(self.tree, self.bodies, self.x, xd, xdd, self.tree.gravity)

    def moving(self, values: list[Expr], qdd: list[Expr] | None = None) -> list[Expr]:
        """The values with the motion of the passive joints in place of its symbols; at accelerations of the rows."""
        n, loops = self.tree.active, self.loops
        motion = dict(zip(self.xd[n:], loops.rates(self.rows(self.xd)), strict=True))
        if qdd is not None:
            motion |= dict(zip(self.xdd[n:], self.moving(loops.accelerations(qdd)), strict=True))
        return replaced(self.graph, values, {name.node: value for name, value in motion.items()})

    def closing(self) -> list[Function]:
        """Positions of the passive joints."""
        if not self.tree.passive:
            return []
        count = len(self.tree.passive)
        made = self.loops.close(self.names("before", count))
        return [
            Function(
                "close",
                (
                    "Positions of the passive joints, rad or m, at which the loops close: a fixed number of Newton",
                    "steps from those of the sample before. The bound is on their error, rad or sizes of the",
                    "mechanism, beyond rounding. Fails near singular poses and too far from the sample before: z is",
                    "then before.",
                ),
                (("q", self.tree.active), ("before", count)),
                (("z", tuple(made.positions)), ("bound", (made.bound,))),
                tuple(made.checks),
                parameters=False,
                otherwise={"z": "before"},
            )
        ]

    def torques(self) -> list[Function]:
        """Torques: inverse dynamics, gravity, terms and friction."""
        project, qdd = self.loops.projected, self.rows(self.xdd)
        inverse = project(cheapest_form(self.graph, self.newton(self.xd, self.xdd), MORE * TRIALS))
        gravity = project(cheapest_form(self.graph, self.newton(self.none, self.none)))
        arguments = self.model, self.tree, self.parameters, self.x, self.xd, self.speed
        terms, friction = (
            self.moving(project(shortest(self.graph, term_torque(*arguments, wanted))))
            for wanted in (lambda _: True, lambda term: term.resists)
        )
        return [
            Function(
                "inverse_dynamics",
                ("Torque of bodies and rotors, M qdd + C qd + g: no friction, no springs, N m or N.",),
                self.sizes("q", "qd", "qdd"),
                (("tau", tuple(self.moving(inverse, qdd))),),
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
                (("tau", tuple(terms)),),
            ),
            Function(
                "friction",
                ("Friction torque, viscous and dry, N m or N; smoothed in the same way.",),
                self.sizes("q", "qd") if self.tree.passive else self.sizes("qd"),
                (("tau", tuple(friction)),),
            ),
        ]

    def rigid(self) -> list[Function]:
        """Mass matrix and forward dynamics."""
        n = self.tree.active
        mass = self.mass(self.tree.relative(self.x))
        full = tuple(mass[a][b] for a in range(n) for b in range(n))
        low = _low(mass_matrix_expressions(self.tree, self.bodies, self.x, self._shared_turns))
        # Accelerations of the coordinates are zero, those of passive joints are not.
        slowed = self.rows(self.none) + self.xdd[n:]
        both = cheapest_form(self.graph, [*self.newton(self.xd, slowed), *low])
        bias, entries = both[: self.tree.coordinates], both[self.tree.coordinates :]
        bias = self.moving(self.loops.projected(bias), self.rows(self.none))
        made = Function(
            "mass_matrix",
            ("Mass matrix including rotors, kg m^2, kg m or kg.",),
            self.sizes("q"),
            (("M", full),),
        )
        try:
            factors = Factors.of(self._on_rows(_full(entries, self.tree.coordinates)))
        except ZeroDivisionError:  # a coordinate without inertia
            return [made]
        qdd = factors.solve([t - h for t, h in zip(self.names("tau", n), bias, strict=True)])
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

    @property
    def _shared_turns(self) -> list[Turn]:
        """Turns of every link in its parent, from the absolute angles that the recursions use."""
        return self.tree.differences(self.tree.turns(self.x))

    def mass(self, relative: list[Turn]) -> list[list[Expr]]:
        """The matrix from joint angles or from absolute angles, whichever is cheaper."""
        own = _low(mass_matrix_expressions(self.tree, self.bodies, self.x, relative))
        absolute = _low(mass_matrix_expressions(self.tree, self.bodies, self.x, self._shared_turns))
        forms = [cheapest_form(self.graph, form) for form in (own, absolute)]
        return self._on_rows(_full(min(forms, key=lambda form: cost(self.graph, form)), self.tree.coordinates))

    def _on_rows(self, M: list[list[Expr]]) -> list[list[Expr]]:
        """[1 G'] M [1; G]: the matrix of the rows' coordinates from that of the tree's."""
        n = self.tree.active
        if not self.tree.passive:
            return M
        G = list(zip(*self.loops.jacobian_by_rows, strict=True))
        half = [[row[a] + dot(row[n:], G[a]) for a in range(n)] for row in M]  # M [1; G]
        passive = list(zip(*half[n:], strict=True))
        low = [half[a][b] + dot(G[a], passive[b]) for a in range(n) for b in range(a + 1)]
        return _full(low, n)

    def momentum(self) -> Function:
        """Generalised momentum and its remainder, for the momentum observer."""
        p, slope = momentum_expressions(self.tree, self.bodies, self.x, self.xd, self.tree.turns(self.x))
        gravity = self.newton(self.none, self.none)
        rest = [g - s for g, s in zip(gravity, slope, strict=True)]
        both = cheapest_form(self.graph, [*p, *rest])
        p, rest = both[: self.tree.coordinates], both[self.tree.coordinates :]
        rest = [r + t for r, t in zip(rest, self.loops.turning(p), strict=True)]
        p, rest = (self.moving(self.loops.projected(values)) for values in (p, rest))
        return Function(
            "momentum",
            ("Generalised momentum p = M qd, kg m^2/s or kg m/s, and rest in tau = dp/dt + rest, N m or N.",),
            self.sizes("q", "qd"),
            (("p", tuple(p)), ("rest", tuple(rest))),
        )

    def at_handle(self, handle: FrameExpressions) -> list[Function]:
        """Pose and Jacobian of the handle, and where they exist its mobility and force."""
        n, m = self.tree.active, self.tree.coordinates
        pose = cheapest_form(self.graph, [*handle.position, *(x for row in handle.rotation for x in row)])
        entries = cheapest_form(self.graph, [x for row in handle.jacobian for x in row])
        J = self._by_rows([entries[k : k + m] for k in range(0, len(entries), m)])
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
                (("J", tuple(x for row in J for x in row)),),
                parameters=False,
            ),
        ]
        optional = [self._mobility] + [self._force] * all(self.model.device.measured)
        for function in optional:
            with suppress(ZeroDivisionError):  # singular in every pose
                made.append(function(J[:3]))
        return made

    def _by_rows(self, J: list[list[Expr]]) -> list[list[Expr]]:
        """J [1; G]: a Jacobian by the rows' coordinates from one by the tree's."""
        n, G = self.tree.active, list(zip(*self.loops.jacobian_by_rows, strict=True)) if self.tree.passive else []
        return [[row[a] + dot(row[n:], G[a]) for a in range(n)] for row in J] if G else J

    def _mobility(self, J: list[list[Expr]]) -> Function:
        low = _low(mass_matrix_expressions(self.tree, self.bodies, self.x, self._shared_turns))
        whole = _full(cheapest_form(self.graph, low), self.tree.coordinates)
        factors = Factors.of(self._on_rows(whole))
        A = mobility(factors, J)
        return Function(
            "handle_mobility",
            ("Mobility Jv M^-1 Jv', 3 x 3: acceleration of the handle per force on it, in the base frame, 1/kg.",),
            self.sizes("q"),
            (("mobility", tuple(x for row in A for x in row)),),
            tuple(factors.checks),
        )

    def _force(self, J: list[list[Expr]]) -> Function:
        found, checks = force(J, self.names("tau", self.tree.active))
        return Function(
            "handle_force",
            ("Force at the handle's origin equivalent to these torques, in the base frame, without moment, N.",),
            self.sizes("q", "tau"),
            (("force", tuple(found)),),
            tuple(checks),
            parameters=False,
        )

    def elastic(self) -> list[Function]:
        """Springs behind motors: constants, the torque that they carry, rotors, and positions of the motors."""
        model, qdd = self.model, self.rows(self.xdd)
        arguments = self.model, self.tree, self.parameters, self.x, self.xd, self.speed
        moved = inverse_dynamics_expressions(
            self.tree, links_of(model, self.bodies), self.x, self.xd, self.xdd, self.tree.gravity
        )
        resisting = term_torque(*arguments, partial(on_links, model))
        whole = [a + b for a, b in zip(moved, resisting, strict=True)]
        tau = self.moving(self.loops.projected(cheapest_form(self.graph, whole)), qdd)
        carried = tuple(combined(row, tau) for row in spring_shares(model))
        positions = [
            combined(row, self.rows(self.x)) + float(drive.row @ model.device.closure.offset)
            for row, drive in zip(snapped(model.device.drive_rates), model.device.drives, strict=True)
        ]
        return [
            spring_constants(model, self.parameters, self.graph),
            Function(
                "spring_torque",
                (
                    "Torque that the springs behind motors carry along a motion of the links, N m or N: that of bodies",
                    "and terms behind them. Positions, rates and accelerations of torsions are not read.",
                ),
                self.sizes("q", "qd", "qdd"),
                (("spring", carried),),
            ),
            rotor_function(model, self.tree, self.parameters, self.graph, self.speed),
            Function(
                "motor_position",
                ("Positions of the motors at the joint side, rad or m, from the coordinates.",),
                self.sizes("q"),
                (("theta", tuple(positions[d] for d in model.device.driven)),),
                parameters=False,
            ),
        ]

    def drives(self) -> list[Function]:
        """Torques of the motors from those of the rows, and back; none where rows are the motors'."""
        device = self.model.device
        if not device.drive_varies.any() and np.array_equal(device.drive_rates, np.eye(self.tree.active)):
            return []
        B = self._drive_rates
        motors = [B[d] for d in device.driven]
        torques = self.names("motor", len(motors))
        made = [
            Function(
                "row_torque",
                (
                    "Torques of the coordinates, B' motor, N m or N, from those of the motors' coordinates: the tau of",
                    "other functions. What the motors hold in balance moves nothing and is not in it.",
                ),
                (*self.sizes("q"), ("motor", len(motors))),
                (("tau", tuple(dot(column, torques) for column in zip(*motors, strict=True))),),
                parameters=False,
            )
        ]
        if device.distribution is not None and len(B) >= self.tree.active:
            shared, checks = self._shared(B, device.distribution)
            made.append(
                Function(
                    "motor_torque",
                    (
                        "Torques of the motors' coordinates, N m or N, that make up these torques of the coordinates,",
                        "by the device file's distribution law: least sum of weighted squares, plus its preload.",
                    ),
                    self.sizes("q", "tau"),
                    (("motor", tuple(shared[d] for d in device.driven)),),
                    tuple(checks),
                    parameters=False,
                )
            )
        return made

    @property
    def _drive_rates(self) -> list[list[Expr]]:
        """B, rates of the drives by the coordinates of the rows, (drives, active)."""
        rates = self.model.device.drive_rows @ np.array([link.rate for link in self.tree.links])
        numbers = [[self.graph.number(float(x)) for x in row] for row in snapped(rates)]
        return self._by_rows(numbers)

    def _shared(self, B: list[list[Expr]], law: DistributionLaw) -> tuple[list[Expr], list[Expr]]:
        """Torques of all drives, and what must be positive: see `DistributionLaw.shares`."""
        roots = [float(root) for root in np.sqrt(law.weights)]
        factors = Orthogonal.of([[(1.0 / root) * x for x in row] for row, root in zip(B, roots, strict=True)])
        # With the preload p the torques are p + D (tau - B' p).
        moving = [dot(column, [self.graph.number(float(p)) for p in law.preload]) for column in zip(*B, strict=True)]
        moved = [t - m for t, m in zip(self.names("tau", self.tree.active), moving, strict=True)]
        scaled = factors.transposed(moved)
        shared = [(1.0 / root) * u + float(p) for u, root, p in zip(scaled, roots, law.preload, strict=True)]
        return shared, [check for check in factors.checks if check.value is None]


def _low(M: list[list[Expr]]) -> list[Expr]:
    """Lower triangle, row by row."""
    return [M[a][b] for a in range(len(M)) for b in range(a + 1)]


def _full(low: list[Expr], n: int) -> list[list[Expr]]:
    rows, columns = np.tril_indices(n)
    made = [[low[0]] * n for _ in range(n)]
    for a, b, value in zip(rows, columns, low, strict=True):
        made[a][b] = made[b][a] = value
    return made
