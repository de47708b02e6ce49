"""Excitation: torque share of each parameter, parameters not excited, and collinearity of the regressor."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.estimation.estimate import WELL_CONDITIONED
from haptid.inference.diagnosis.finding import Finding, Status, joined_names
from haptid.observation.r_factor import r_factor

# Condition index above which a dependency is strong, and share of variance above which a parameter is part of it
# (Belsley, Kuh and Welsch 1980, Regression Diagnostics, sections 3.2 and 3.4).
_STRONG, SHARED = 30.0, 0.5
# Parameters with at least this component in a direction of unit length are named.
_NAMED = 0.3
# Motion that excites a parameter, by kind; {} is the joint or motor.
_MOTION = {
    "XX XY XZ YY YZ ZZ": "accelerate {} hard both ways, in several poses of the others",
    "MX MY MZ M": "move {} slowly through its whole range, so that gravity changes on it",
    "IA": "accelerate {} hard both ways",
    "FV": "move {} at low and at high speed",
    "FC FS OFF": "move {} both ways at steady low speed",
}


@dataclass(frozen=True, eq=False)
class Dependencies:
    """Belsley's table of collinearity.

    Attributes:
        index: condition indices, the largest last, (p,).
        directions: right singular vectors of the scaled columns, a row each, (p, p).
        proportions: share of each parameter's variance due to each direction, (directions, p).
    """

    index: Array
    directions: Array
    proportions: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "index", "directions", "proportions")


def dependencies(R: Array) -> Dependencies:
    """Condition indices and variance-decomposition proportions of an R factor, (p, p), columns of unit length.

    Source: Belsley, Kuh and Welsch (1980), section 3.2, eqs 3.20 to 3.22.
    """
    _, singular, directions = np.linalg.svd(R / np.linalg.norm(R, axis=0))
    parts = (directions / singular[:, None]) ** 2
    return Dependencies(singular[0] / singular, directions, parts / parts.sum(axis=0))


def torque_shares(fitted: Estimate) -> Array:
    """Largest ratio over the motors of the norm of a base parameter's torque to that of the motor's, (p,)."""
    shares = np.zeros(len(fitted.beta))
    for motor in fitted.observation.motors:
        if (size := motor.size(fitted.beta)) > 0:
            carried = np.linalg.norm(motor.whole[:, :-1], axis=0) * np.abs(fitted.beta[motor.columns]) / size
            np.maximum.at(shares, motor.columns, carried)
    return shares


def advice(fitted: Estimate, k: int) -> str:
    """Motion that excites a base parameter."""
    parameters = fitted.model.device.parameters
    own = fitted.base.independent_columns[k]
    kind, link = parameters.kinds[own], parameters.links[own]
    place = f"{'joint' if link >= 0 else 'motor'} {parameters.names[own].removeprefix(kind)}"
    words = [text for kinds, text in _MOTION.items() if kind in kinds.split()]
    return (words[0] if words else "move {} through its whole range and speed").format(place)


def _table(fitted: Estimate) -> tuple[Dependencies, tuple[str, ...]]:
    """Belsley's table of the parameters that were not eliminated, and their names."""
    free = list(fitted.free_parameters)
    R = r_factor(fitted.observation.stack(fitted.weights)[:-1, free])
    return dependencies(R), tuple(fitted.base.names[k] for k in free)


def excitation(fitted: Estimate) -> Finding:
    """Which parameters are not significantly different from zero, and what motion would excite them."""
    carried, half = torque_shares(fitted), np.diff(fitted.conf_int(), axis=1)[:, 0] / 2
    poor = [int(k) for k in np.argsort(carried) if k in fitted.free_parameters and not half[k] < abs(fitted.beta[k])]
    table, names = _table(fitted)
    weakest = table.directions[-1]
    parts = [f"{weakest[k]:+.2f} {names[k]}" for k in np.argsort(-np.abs(weakest)) if abs(weakest[k]) > _NAMED]
    figures = {f"share {name}": share for name, share in zip(fitted.base.names, carried, strict=True)}
    figures |= {"not_significant": len(poor), "weakest": 1.0 / table.index[-1]}
    least = f"{1 / table.index[-1]:.1e} of the best"
    direction = f"the least excited direction is {' '.join(parts)} (scaled), {least}"
    if not poor:
        return Finding(
            "excitation", "ok", figures, f"Every parameter is significantly different from zero; {direction}."
        )
    hopeless = [k for k in poor if np.isinf(half[k]) or _beyond_prior(fitted, k, float(half[k]))]
    status: Status = "bad" if hopeless or 2 * len(poor) > len(names) else "doubt"
    shown = joined_names([fitted.base.names[k] for k in poor])
    advised = "; ".join(dict.fromkeys(advice(fitted, k) for k in poor[:3]))
    text = (
        f"Not significantly different from zero: {shown} ({len(poor)} of {len(names)} parameters, 95 % intervals); "
        f"{direction}. To excite them: {advised}."
    )
    return Finding("excitation", status, figures, text)


def _beyond_prior(fitted: Estimate, k: int, half: float) -> bool:
    """Whether the interval is wider than the prior value is large."""
    prior = fitted.model.base_prior[k]
    return prior is not None and prior[0] != 0 and half > abs(prior[0])


def collinearity(fitted: Estimate) -> Finding:
    """Which parameters have nearly collinear columns."""
    table, every = _table(fitted)
    strong = table.index > _STRONG
    involved = np.flatnonzero(table.proportions[strong].sum(axis=0) > SHARED)
    largest = float(table.index[-1])
    figures = {"largest_index": largest, "strong": int(strong.sum()), "involved": len(involved)}
    if len(involved) < 2:
        text = f"No collinear parameters (largest condition index {largest:.3g}, limit {_STRONG:g})."
        return Finding("collinearity", "ok", figures, text)
    status: Status = "bad" if largest > WELL_CONDITIONED else "doubt"
    names = joined_names([every[k] for k in involved[np.argsort(-table.proportions[-1, involved])]])
    text = (
        f"{names} are nearly collinear ({int(strong.sum())} condition indices above {_STRONG:g}, the largest "
        f"{largest:.3g}; above {WELL_CONDITIONED:g} no single one is reliable): their joint torque is reliable; to "
        f"separate them, {advice(fitted, fitted.free_parameters[int(involved[0])])}."
    )
    return Finding("collinearity", status, figures, text)
