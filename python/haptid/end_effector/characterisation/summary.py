"""Summary of a characterisation as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from haptid.uncertainty.quantities import Field

if TYPE_CHECKING:
    from haptid.end_effector.characterisation.characterise import Characterisation


def summary(found: Characterisation) -> str:
    """Median and range of the quantities over the poses that are not left out, and notes."""
    grasp = found.grasp
    lines = [f"{found.model.device.name} at the handle: {int(grasp.usable.sum())} of {len(grasp)} poses"]
    for k in range(found.apparent_mass.values.shape[1]):
        lines.append(_line(f"apparent mass {k + 1}", found.apparent_mass, k))
    lines.append(_line("isotropy", found.isotropy))
    if not grasp.redundancy:
        lines.append(_line("largest viscous friction", found.viscous_friction, 0))
        size = np.linalg.norm(found.weight.values, axis=1)
        lines.append(_line("weight", Field(size, None, float("inf"), "N")))
    return "\n".join([*lines, *(f"  {note}" for note in notes(found))])


def _line(name: str, figure: Field, k: int | None = None) -> str:
    pick = slice(None) if k is None else (slice(None), k)
    value = figure.values[pick]
    known = np.isfinite(value)
    unit = "" if figure.unit == "1" else f" {figure.unit}"
    if not known.any():
        return f"  {name}: not known at any pose"
    value = value[known]
    text = f"  {name}: {np.median(value):.3g}{unit} at the median, {value.min():.3g} .. {value.max():.3g}"
    if figure.se is None:
        return text
    return f"{text}, standard error up to {figure.se[pick][known].max():.2g}"


def notes(found: Characterisation) -> Iterator[str]:
    """What is not determined, in sentences."""
    grasp, masses = found.grasp, found.masses
    out, indefinite = ~grasp.usable, grasp.usable & ~masses.definite
    if out.any():
        yield (
            f"{int(out.sum())} of {len(grasp)} poses ({100 * out.mean():.3g} %) are left out: the condition number of "
            f"the handle's Jacobian is above {grasp.worst:g} there{_where(found, out)}."
        )
    if indefinite.any():
        yield (
            f"At {int(indefinite.sum())} of {len(grasp)} poses the mass matrix is not positive definite, so no mass is "
            f"given{_where(found, indefinite)}; `definiteness` finds the direction."
        )
    if grasp.redundancy:
        yield (
            f"{len(grasp.moving)} joints move {len(grasp.rows)} components of the handle's velocity: masses are "
            f"effective masses with all joints free; friction and weight at the handle are not determined."
        )
    if len(grasp.moving) < len(grasp.rows):
        yield f"The handle moves in {len(grasp.moving)} directions at a pose: all quantities are of that motion."
    if labels := ", ".join(found.model.unmeasured_labels):
        yield f"Torque is not measured on {labels}: those coordinates are taken as constrained."
    if min(grasp.rows) < 3 <= max(grasp.rows):
        yield "Linear and angular components are mixed: principal values depend on the units."
    if masses.mass.se is not None and np.isinf(masses.mass.se).any():
        yield "The standard error of some parameter cannot be estimated, so intervals are unbounded."


def _where(found: Characterisation, poses: np.ndarray) -> str:
    """Range of each active joint over these poses, as text."""
    model, parts = found.model, []
    for j, row in zip(model.device.active, found.grasp.qa[:, poses], strict=True):
        joint = model.device.joints[j]
        low, high = (row.min(), row.max()) if joint.prismatic else np.degrees([row.min(), row.max()])
        parts.append(f"{joint.name} {low:.3g} .. {high:.3g} {'m' if joint.prismatic else 'deg'}")
    return f" ({', '.join(parts)})"
