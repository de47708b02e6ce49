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
    handle = found.handle
    lines = [f"{found.model.device.name} at the handle: {int(handle.usable.sum())} of {len(handle)} poses"]
    for k in range(found.apparent_mass.values.shape[1]):
        lines.append(_line(f"apparent mass {k + 1}", found.apparent_mass, k))
    lines.append(_line("isotropy", found.isotropy))
    if not handle.redundancy:
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
    handle, masses = found.handle, found.masses
    out, indefinite = ~handle.usable, handle.usable & ~masses.definite
    if out.any():
        yield (
            f"{int(out.sum())} of {len(handle)} poses ({100 * out.mean():.3g} %) are left out: the condition number of "
            f"the handle's Jacobian is above {handle.worst:g} there{_where(found, out)}."
        )
    if indefinite.any():
        yield (
            f"At {int(indefinite.sum())} of {len(handle)} poses the mass matrix is not positive definite, so no mass "
            f"is given{_where(found, indefinite)}; `definiteness` finds the direction."
        )
    if handle.redundancy:
        yield (
            f"{len(handle.moving)} joints move {len(handle.rows)} components of the handle's velocity: masses are "
            f"effective masses with all joints free; friction and weight at the handle are not determined."
        )
    if len(handle.moving) < len(handle.rows):
        yield f"The handle moves in {len(handle.moving)} directions at a pose: all quantities are of that motion."
    if labels := ", ".join(found.model.unmeasured_labels):
        yield f"Torque is not measured on {labels}: those coordinates are taken as constrained."
    if min(handle.rows) < 3 <= max(handle.rows):
        yield "Linear and angular components are mixed: principal values depend on the units."
    if masses.mass.se is not None and np.isinf(masses.mass.se).any():
        yield "The standard error of some parameter cannot be estimated, so intervals are unbounded."


def _where(found: Characterisation, poses: np.ndarray) -> str:
    """Range of each active joint over these poses, as text."""
    model, parts = found.model, []
    for j, row in zip(model.device.active, found.handle.qa[:, poses], strict=True):
        joint = model.device.joints[j]
        low, high = (row.min(), row.max()) if joint.prismatic else np.degrees([row.min(), row.max()])
        parts.append(f"{joint.name} {low:.3g} .. {high:.3g} {'m' if joint.prismatic else 'deg'}")
    return f" ({', '.join(parts)})"
