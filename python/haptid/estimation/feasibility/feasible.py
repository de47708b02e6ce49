"""Physical consistency of base parameters: feasibility, interior points, projection on the feasible set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, PhysicalConsistencyError, SettingError
from haptid.estimation.feasibility.cone import Cone, ConeBlock, ConePart, cone, parts, pseudo_inertia
from haptid.estimation.feasibility.conic_program import ConeCondition, minimise
from haptid.estimation.least_squares import weakest_direction
from haptid.observation.r_factor import r_factor

# A margin this little below zero is rounding.
_ROUNDING = 1e-7
# A block is part of a contradiction when its multiplier has at least this share of the sum.
SHARE = 1e-2
# A condition is inactive when its multiplier is below this share of the largest.
_NEGLIGIBLE = 1e-4
# Least ratio of singular values of a metric with unit columns.
LEAST_METRIC_SHARE = 1e-10
# Largest margin, in each link's own mass and length: that of a ball.
_ROOMY = 1.0
# Margins up to this are on the boundary, where there is no choice of standard parameters.
BORDER = 1e-6
# Weight of the penalty on directions without torque, relative to a margin of one and to a torque residual of one.
MARGIN_PENALTY = 1e-8
FIT_PENALTY = 1e-10
_PASSES = 2
# Distance outside of the cone, where the ball's is one, that counts as rounding; narrower cones tried for it.
_OUTSIDE = 1e-9
_NARROWER = 4
# Newton steps to the analytic centre, and the decrement at which it is reached.
_MOST_STEPS = 200
_CENTRED = 1e-9


@dataclass(frozen=True, eq=False)
class FeasibleParameters:
    """Physical consistency of base parameters, with standard parameters of rigid bodies that have them.

    A body's parameters are those of some distribution of mass, which is so if and only if its pseudo-inertia is
    positive semidefinite (Wensing, Kim and Slotine 2018, IEEE RA-L 3(1); Sousa and Cortesao 2014, IJRR 33(6)). Rotor
    inertia, viscous and Coulomb friction are non-negative, and so is the sum of Stribeck and Coulomb friction. Springs,
    offsets, counterbalances and user-defined columns are unconstrained. The mass of a link that torque does not
    determine is limited to some thousands of times what its moments suggest.

    Attributes:
        beta: base parameters, (p,), SI.
        chi: standard parameters with these base parameters, (n,), SI: the feasible ones of least log-det divergence
            from the prior, or from a homogeneous ball for a link without one. Torque determines only their base
            parameters. Where not `ok` no bodies have them.
        margin: the largest t with every pseudo-inertia >= t and every term >= t, each in its own size; negative where
            the base parameters are infeasible. At most 1, that of a ball.
        failing: a sentence for every contradiction, none where `ok`.
    """

    model: DynamicModel
    beta: Array
    chi: Array
    margin: float
    failing: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self, "beta", "chi")

    @property
    def ok(self) -> bool:
        """Whether rigid bodies and passive terms can have these base parameters."""
        return not self.failing

    @property
    def pseudo_inertias(self) -> Array:
        """Of every link, (joints, 4, 4), SI."""
        raw = self.model.device.parameters.S @ self.chi
        return np.array([pseudo_inertia(raw[10 * j : 10 * j + 10]) for j in range(len(self.model.device.joints))])

    def summary(self) -> str:
        """The result as text."""
        if self.ok:
            return f"Physically consistent: margin {self.margin:.2g} (0 on the boundary, 1 for balls)."
        return "\n".join([f"Not physically consistent: margin {self.margin:.2g}.", *self.failing])


def feasible_parameters(model: DynamicModel, beta: Array) -> FeasibleParameters:
    """Whether rigid bodies and passive terms can have these base parameters, identified or published.

    Args:
        beta: its base parameters, in its order, (p,), SI.

    Raises:
        SettingError: one is not a finite number.
        PhysicalConsistencyError: the symmetries declared for the device leave no feasible body.
        ConvergenceError: the solver stopped without a solution.
    """
    beta = check_beta(model, beta)
    conditions = roomy(model, beta)
    return inside(model, conditions, beta, conditions.start(beta))


def inside(
    model: DynamicModel, conditions: Cone, beta: Array, x: Array, fixed: Sequence[ConePart] = ()
) -> FeasibleParameters:
    """The most interior standard parameters with given base parameters, from any scaled x, (n,), that has them."""
    point = interior(conditions, x, fixed)
    failing = tuple(
        _contradiction(part, shares)
        for part, margin, shares in zip(conditions.parts, point.margins, point.multipliers, strict=True)
        if margin < -_ROUNDING
    )
    return FeasibleParameters(model, beta, conditions.scale * point.x, float(point.margins.min(initial=1.0)), failing)


def project_to_feasible(model: DynamicModel, beta: Array, R: Array) -> FeasibleParameters:
    """Projection of base parameters on the physically consistent set: |R (b - beta)| is least.

    With the R factor of an observation, `observation.stack(weights)[:-1, :-1]`, it changes the torque least.

    Args:
        beta: its base parameters, (p,), SI.
        R: of the metric, (p, p): an R factor, or any other root of its square.

    Raises:
        SettingError: a parameter is not a finite number.
        IdentifiabilityError: the metric is singular.
        PhysicalConsistencyError: the symmetries declared for the device leave no feasible body.
        ConvergenceError: the solver stopped without a solution.
    """
    beta = check_beta(model, beta)
    check_metric(model, R)
    nearest = feasible_parameters(model, beta)
    return nearest if nearest.ok else nearest_feasible(model, beta, r_factor(R))[0]


def nearest_feasible(model: DynamicModel, beta: Array, R: Array) -> tuple[FeasibleParameters, tuple[ConeBlock, ...]]:
    """The feasible base parameters nearest to infeasible ones, and the active conditions."""
    conditions = roomy(model, beta)
    x, multipliers = _nearest(conditions, R, beta)
    least = _NEGLIGIBLE * multipliers.max(initial=0.0)
    active = tuple(block for block, z in zip(conditions.blocks, multipliers, strict=True) if z > least)
    for block in active:
        if not block.is_link and np.count_nonzero(block.G) == 1:
            x[np.flatnonzero(block.G[0])] = 0.0  # exactly, not 1e-13 of its size
    fixed = [part for part in conditions.parts if any(block in active for block in part.blocks)]
    return inside(model, conditions, conditions.A @ x, x, fixed), active


def nearest_base_parameters(conditions: Cone, beta: Array, R: Array) -> Array:
    """Feasible base parameters nearest to others in the metric R, without bodies that have them, (p,)."""
    return np.asarray(conditions.A @ _nearest(conditions, R, beta)[0])


def check_beta(model: DynamicModel, beta: ArrayLike) -> Array:
    """Base parameters of the device as floats, (p,).

    Raises:
        ShapeError: there are too many or too few.
        SettingError: one is not a finite number.
    """
    beta = np.asarray(beta, dtype=float)
    expect("beta", beta.shape, (len(model.base),))
    for name, value in zip(model.base.names, beta, strict=True):
        if not np.isfinite(value):
            raise SettingError(
                f"base parameter {name} is {value}, not a finite number.", where=name, found=float(value)
            )
    return beta


def check_metric(model: DynamicModel, R: Array) -> None:
    """Raise IdentifiabilityError, naming the parameter of least weight, where R is numerically singular."""
    p = len(model.base)
    expect("R", np.shape(R), (p, p))
    k, ratio = weakest_direction(R)
    if ratio < LEAST_METRIC_SHARE:
        name = model.base.names[k]
        raise IdentifiabilityError(
            f"the metric has no weight on base parameter {name}: {ratio:.1e} of the largest "
            f"(limit {LEAST_METRIC_SHARE:.1e}).",
            where=name,
            found=ratio,
            limit=LEAST_METRIC_SHARE,
            advice="Use the R factor of an observation that excites all parameters.",
        )


def roomy(model: DynamicModel, beta: Array) -> Cone:
    """The cone of a device, scaled for base parameters of about this size, with a point well inside as its ball.

    Raises:
        PhysicalConsistencyError: the cone has no interior: the symmetries leave no feasible body.
    """
    conditions = cone(model, beta)
    if conditions.room > BORDER:
        return conditions
    nothing = np.zeros((0, len(conditions.scale)))
    free = replace(conditions, A=nothing, parts=parts(nothing, conditions.blocks))
    centre = interior(free, conditions.ball)
    for part, margin in zip(free.parts, centre.margins, strict=True):
        if margin < BORDER:
            labels = ", ".join(block.label for block in part.blocks)
            raise PhysicalConsistencyError(
                f"with the symmetries in the device file no body of positive volume is possible for {labels}: the "
                f"least eigenvalue is at most {margin:.1e} (limit {BORDER:.1e}).",
                where=labels,
                found=float(margin),
                limit=BORDER,
                advice="Take a zero out of [[symmetry]], such as the moment of inertia of a rod about its own axis.",
            )
    return replace(conditions, ball=centre.x)


def _contradiction(part: ConePart, shares: Array) -> str:
    """A sentence on the conditions of a part that contradict each other."""
    labels = [block.label for block, share in zip(part.blocks, shares, strict=True) if share > SHARE]
    if len(labels) == 1:
        return f"{labels[0]}: " + ("no body has this inertia" if labels[0].startswith("link") else "negative")
    return f"{', '.join(labels)}: no bodies have these together"


@dataclass(frozen=True, eq=False)
class Interior:
    """The most interior standard parameters with given base parameters.

    Attributes:
        x: scaled standard parameters, (n,).
        margins: the largest least eigenvalue of every part, (parts,); infinite where a part has no condition.
        multipliers: of each block of the cone, by part; each part's sum is at most one.
    """

    x: Array
    margins: Array
    multipliers: tuple[Array, ...]


def interior(cone: Cone, x: Array, fixed: Sequence[ConePart] = ()) -> Interior:
    """The most interior scaled standard parameters with the base parameters of x, part by part.

    The margin of a part is the largest t with every pseudo-inertia >= t and every term >= t, all scaled. Inside the
    cone the x of least divergence from the centre is taken, which is unique.

    Args:
        cone: the conditions.
        x: any scaled standard parameters with those base parameters, (n,).
        fixed: parts of which x stays as it is.
    """
    x, margins, multipliers = np.array(x), [], []
    for part in cone.parts:
        step, margin, shares = no_step(part, x) if part in fixed else largest_margin(cone, part, x)
        if margin > BORDER and part.null.size and part not in fixed:
            step = step + analytic_centre(cone, part, x + step)
        x += step
        margins.append(margin)
        multipliers.append(shares)
    return Interior(x, np.array(margins), tuple(multipliers))


def no_step(part: ConePart, x: Array) -> tuple[Array, float, Array]:
    """A zero step, the margin of a part at x, and 1 for each block that has no more than it."""
    margin = part.margin(x)
    return np.zeros_like(x), margin, np.array([float(block.margin(x) == margin) for block in part.blocks])


def largest_margin(cone: Cone, part: ConePart, x: Array) -> tuple[Array, float, Array]:
    """The step of a part that maximises its margin, that margin, and the multiplier of each block."""
    k = part.null.shape[1]
    if not (part.blocks and k):
        return no_step(part, x)
    conditions = [
        ConeCondition(np.column_stack([block.G @ part.null, -block.inside]), block.G @ x, block.is_link)
        for block in part.blocks
    ]
    conditions.append(ConeCondition(-np.eye(1, k + 1, k), np.array([_ROOMY])))
    P = np.diag(np.append(np.full(k, MARGIN_PENALTY), 0.0))
    q = np.append(MARGIN_PENALTY * part.null.T @ (x - cone.centre), -1.0)
    v, z = minimise(P, q, conditions)
    step = part.null @ v[:-1]
    shares = np.array([block.inside @ zb for block, zb in zip(part.blocks, z, strict=False)])
    margin = part.margin(x + step)
    # On the boundary itself the solver may end a rounding error below where it began.
    return (step, min(margin, _ROOMY), shares) if margin > part.margin(x) else no_step(part, x)


def analytic_centre(cone: Cone, part: ConePart, x: Array) -> Array:
    """From an x inside, the step of a part to the least divergence from the centre, sum of <C^-1, P> - log det P.

    P is every pseudo-inertia and term, C the centre's (the ball's, where the centre is infeasible). Newton's method
    with the damping of self-concordant functions never leaves the cone.

    Sources: Lee, Wensing and Park (2020), IEEE Transactions on Robotics 36(2), for the divergence; Nesterov and
    Nemirovskii (1994), Interior-Point Polynomial Algorithms, for the damping.
    """
    k = part.null.shape[1]
    alike = [[block for block in part.blocks if block.is_link == is_link] for is_link in (True, False)]
    kinds = [_stacked(cone, part, x, blocks) for blocks in alike if blocks]
    y = np.zeros(k)
    for _ in range(_MOST_STEPS):
        gradient, hessian = np.zeros(k), np.zeros((k, k))
        for start, reference, along in kinds:
            inverse = np.linalg.inv(start + np.tensordot(y, along, 1))
            scaled = inverse @ along
            gradient += along.reshape(k, -1) @ (reference - inverse).swapaxes(1, 2).ravel()
            hessian += scaled.reshape(k, -1) @ scaled.swapaxes(2, 3).reshape(k, -1).T
        step = -np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        decrement = float(np.linalg.norm(step @ gradient)) ** 0.5
        y += step / (1.0 + decrement)
        if decrement < _CENTRED:
            break
    return np.asarray(part.null @ y)


def _stacked(cone: Cone, part: ConePart, x: Array, blocks: Sequence[ConeBlock]) -> tuple[Array, Array, Array]:
    """Of blocks of one size, what their part of the divergence is computed from.

    Returns:
        Their matrices at x, and the inverses of those at their centres, (blocks, size, size); the matrices' changes
        along the directions without effect, (null, blocks, size, size).
    """
    centres = np.array([block.matrix(block.reference(cone.centre, cone.ball)) for block in blocks])
    along = np.stack([block.matrices(part.null) for block in blocks], axis=1)
    return np.array([block.matrix(x) for block in blocks]), np.linalg.inv(centres), along


def _nearest(cone: Cone, R: Array, beta: Array) -> tuple[Array, Array]:
    """The x in the cone whose base parameters b are nearest to beta, |R (b - beta)| least, and the multipliers.

    Directions of x without effect on base parameters have a penalty `FIT_PENALTY` on their distance from the centre,
    which makes x unique. A second pass penalises the distance from the first solution, so that b does not depend on the
    penalty, and is scaled by the first distance, so that small distances have full relative precision. Where the
    infimum is approached only by ever heavier bodies, the penalty limits them. The solver may end further outside of
    the cone than by rounding then, and the way back along the ball would move b: the cone is narrowed by twice that
    distance, and x ends inside where it costs least.

    Args:
        cone: the conditions.
        R: R factor of the metric, (p, p).
        beta: base parameters, (p,), SI.

    Returns:
        x, (n,), and the multiplier of each of the cone's blocks, (blocks,).
    """
    x, p = cone.start(beta), len(beta)
    size = float(np.linalg.norm(R @ beta)) or 1.0
    towards = cone.null.T @ (cone.centre - x)
    for _ in range(_PASSES):
        # v = (r, y): x + to_x r + null y has base parameters beta + R^-1 r size. R'R would halve the digits.
        move = np.column_stack([cone.inverse @ linalg.solve_triangular(R, np.eye(p)) * size, cone.null])
        weights = np.append(np.ones(p), np.full(len(towards), FIT_PENALTY))
        narrower = 0.0
        for _ in range(_NARROWER):
            conditions = [ConeCondition(b.G @ move, b.G @ x - narrower * b.inside, b.is_link) for b in cone.blocks]
            v, z = minimise(np.diag(weights), np.append(np.zeros(p), -FIT_PENALTY * towards), conditions)
            outside = -cone.margin(x + move @ v)
            if outside < _OUTSIDE:
                break
            narrower += 2 * outside
        size, towards = size * (float(np.linalg.norm(v[:p])) or 1.0), v[p:]
    return cone.moved_inside(x + move @ v), np.array([b.inside @ zb for b, zb in zip(cone.blocks, z, strict=True)])
