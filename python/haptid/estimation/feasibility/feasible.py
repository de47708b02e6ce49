"""Whether bodies and passive terms can have some base parameters, and the nearest ones that they can have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, read_only
from haptid.dynamics.model import DynamicModel
from haptid.errors import MetricError, NoBodyError, ParameterValueError
from haptid.estimation.feasibility.cone import Block, Cone, Part, cone, parts, pseudo_inertia
from haptid.estimation.feasibility.nearest import BORDER, interior, nearest
from haptid.observation.r_factor import triangle

# A margin this little below zero is rounding.
ROUNDING = 1e-7
# A block has its share in a contradiction when its multiplier has this much of all.
SHARE = 1e-2
# A condition holds nothing where its multiplier is this little beside the largest.
NEGLIGIBLE = 1e-4
# A direction of the scaled parameters that weighs less than this share of the largest one has no metric.
WEIGHED = 1e-10


@dataclass(frozen=True, eq=False)
class FeasibleParameters:
    """Base parameters, and the standard parameters of real bodies behind them.

    A body's parameters are those of some distribution of mass, which is so where its pseudo-inertia is positive
    semidefinite (Wensing, Kim and Slotine 2018, IEEE RA-L 3(1); Sousa and Cortesao 2014, IJRR 33(6)). Rotor inertia,
    viscous and Coulomb friction are not negative; where there is Stribeck friction, nor is its sum with Coulomb's.
    Springs, offsets, counterbalances and columns of the user's own are free. Where torque does not tell a link's mass,
    any mass will do, up to some thousands of times what its moments suggest: nobody builds the bodies beyond.

    Attributes:
        model: the dynamic model.
        beta: base parameters, (p,), SI.
        chi: standard parameters with these base parameters, (n,), SI: of all that are inside, those of least log-det
            divergence from the prior, or from a homogeneous ball for a link without one. Torque tells only their base
            parameters. Where not `ok` they are no bodies'.
        margin: the largest t with every pseudo-inertia >= t and every term >= t, each in its own size; negative where
            no bodies have these base parameters. At most 1, a ball's.
        failing: a sentence for every contradiction, none where `ok`.
    """

    model: DynamicModel
    beta: Array
    chi: Array
    margin: float
    failing: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("beta", "chi"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def ok(self) -> bool:
        """Whether real bodies and passive terms can have these base parameters."""
        return not self.failing

    @property
    def pseudo_inertias(self) -> Array:
        """Of every link, (joints, 4, 4), SI."""
        raw = self.model.device.parameters.S @ self.chi
        return np.array([pseudo_inertia(raw[10 * j : 10 * j + 10]) for j in range(len(self.model.device.joints))])

    def summary(self) -> str:
        """The verdict as text."""
        if self.ok:
            return f"Real bodies can have these parameters: margin {self.margin:.2g} (0 on the border, 1 for balls)."
        return "\n".join([f"No real bodies have these parameters: margin {self.margin:.2g}.", *self.failing])


def possible(model: DynamicModel, beta: Array) -> FeasibleParameters:
    """Whether real bodies and passive terms can have these base parameters, identified or published.

    Args:
        model: the dynamic model.
        beta: its base parameters, in its order, (p,), SI.

    Raises:
        ParameterValueError: one is not a finite number.
        NoBodyError: the symmetries declared for the device leave no body.
        UnsolvedError: the solver stopped before it had an answer.
    """
    beta = checked(model, beta)
    conditions = roomy(model, beta)
    return inside(model, conditions, beta, conditions.start(beta))


def inside(
    model: DynamicModel, conditions: Cone, beta: Array, x: Array, settled: Sequence[Part] = ()
) -> FeasibleParameters:
    """The most interior standard parameters behind base parameters, from any scaled ones x, (n,), that have them."""
    found = interior(conditions, x, settled)
    failing = tuple(
        sentence(part, shares)
        for part, margin, shares in zip(conditions.parts, found.margins, found.multipliers, strict=True)
        if margin < -ROUNDING
    )
    return FeasibleParameters(model, beta, conditions.scale * found.x, float(found.margins.min(initial=1.0)), failing)


def project_to_feasible(model: DynamicModel, beta: Array, R: Array) -> FeasibleParameters:
    """The nearest base parameters that real bodies can have: |R (b - beta)| least.

    With the triangle of an observation, `observation.stack(weights)[:-1, :-1]`, nearest is: torque changes least.

    Args:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        R: of the metric, (p, p): a triangle, or any other root of its square.

    Raises:
        ParameterValueError: a parameter is not a finite number.
        MetricError: a direction of the parameters has no weight.
        NoBodyError: the symmetries declared for the device leave no body.
        UnsolvedError: the solver stopped before it had an answer.
    """
    beta = checked(model, beta)
    check_metric(model, R)
    found = possible(model, beta)
    return found if found.ok else hold(model, beta, triangle(R))[0]


def hold(model: DynamicModel, beta: Array, R: Array) -> tuple[FeasibleParameters, tuple[Block, ...]]:
    """The nearest that is possible to what is not, and the conditions that hold it."""
    conditions = roomy(model, beta)
    x, strength = nearest(conditions, R, beta)
    least = NEGLIGIBLE * strength.max(initial=0.0)
    held = tuple(block for block, z in zip(conditions.blocks, strength, strict=True) if z > least)
    for block in held:
        if not block.is_link and np.count_nonzero(block.G) == 1:
            x[np.flatnonzero(block.G[0])] = 0.0  # not 1e-13 of its size
    settled = [part for part in conditions.parts if any(block in held for block in part.blocks)]
    return inside(model, conditions, conditions.A @ x, x, settled), held


def checked(model: DynamicModel, beta: ArrayLike) -> Array:
    """Base parameters of the device as floats, after a look at their shape and at each."""
    beta = np.asarray(beta, dtype=float)
    expect("beta", beta.shape, (len(model.base),))
    for name, value in zip(model.base.names, beta, strict=True):
        if not np.isfinite(value):
            raise ParameterValueError(name, float(value))
    return beta


def check_metric(model: DynamicModel, R: Array) -> None:
    """Raise MetricError, naming the parameter it says least about, where R is as good as singular."""
    p = len(model.base)
    expect("R", np.shape(R), (p, p))
    sizes = np.linalg.norm(R, axis=0)
    if not sizes.all():
        raise MetricError(model.base.names[int(np.argmin(sizes))], 0.0, WEIGHED)
    _, singular, directions = np.linalg.svd(R / sizes)
    ratio = float(singular[-1] / singular[0])
    if ratio < WEIGHED:
        raise MetricError(model.base.names[int(np.argmax(np.abs(directions[-1])))], ratio, WEIGHED)


def roomy(model: DynamicModel, beta: Array) -> Cone:
    """The conditions, scaled for base parameters of about this size.

    Raises:
        NoBodyError: no standard parameters at all are well inside: the symmetries leave no body.
    """
    made = cone(model, beta)
    if made.margin(made.ball) > BORDER:
        return made
    nothing = np.zeros((0, len(made.scale)))
    free = replace(made, A=nothing, parts=parts(nothing, made.blocks))
    found = interior(free, made.ball)
    for part, margin in zip(free.parts, found.margins, strict=True):
        if margin < BORDER:
            raise NoBodyError([block.label for block in part.blocks], float(margin), BORDER)
    return replace(made, ball=found.x)


def sentence(part: Part, shares: Array) -> str:
    """What contradicts what in a part."""
    labels = [block.label for block, share in zip(part.blocks, shares, strict=True) if share > SHARE]
    if len(labels) == 1:
        return f"{labels[0]}: " + ("no body has this inertia" if labels[0].startswith("link") else "negative")
    return f"{', '.join(labels)}: no bodies have these together"
