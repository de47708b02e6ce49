"""Tables of the branches: parameters, masses of the sweeps, figures at a posture, all as cells."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.branches.finding import Handle, Results
from haptid.demos.branches.fits import Identified, coulomb_of
from haptid.uncertainty.quantities import Field, aligned

PARAMETERS = ["", "unit", "CAD", "published", "±, %", "found", "±, %", "95 % interval", "true"]
AXES = "xyz"


def parameters(found: Identified) -> list[list[str]]:
    """The published table with our columns: the essential parameters."""
    cells, table = [PARAMETERS], found.table
    for name in table.rows:
        p = found.reduced[name]
        cad, published, relative = (table.figures[name, column] for column in table.columns)
        kept = name in found.reduction.essential
        low, high = p.interval
        ours = [f"{p.value:.5f}", f"{p.relative_se:.2f}", f"{low:.5f} .. {high:.5f}"] if kept else ["left out", "", ""]
        cells.append([name, p.unit, f"{cad:g}", f"{published:g}", f"{relative:g}", *ours, f"{found.true(name):.5f}"])
    return cells


def friction(found: Results) -> list[list[str]]:
    """Coulomb friction from the friction test, by branch and motor."""
    cells = [["branch", "motor", "published, test", "found, test", "95 % interval", "true"]]
    for key, test in found.friction.items():
        one = found.found[key]
        for joint in test.choice.joints:
            name = coulomb_of(found.model, joint.label)
            value, (low, high) = test.coulomb(joint.label)
            published = one.table.figures[name, "cad"]
            row = [f"{published:g}", f"{value:.4f}", f"{low:.4f} .. {high:.4f}", f"{one.true(name):.4f}"]
            cells.append([one.branch.title, joint.label, *row])
    return cells


def sweeps(found: Results) -> list[list[str]]:
    """Ranges of the masses along the sweeps: published, and ours by branch with the largest deviation."""
    titles = [one.branch.title for one in found.found.values()]
    cells = [["sweep", "mass", "published, kg", *(f"{title}, kg" for title in titles)]]
    for sweep in found.demo.sweeps:
        for k, (low, high) in enumerate(sweep.published):
            row = [sweep.title if k == 0 else "", ["largest", "middle", "smallest"][k], f"{low:g} .. {high:g}"]
            for handle in found.handles.values():
                figure = handle.sweeps[sweep.key].mass
                row.append(f"{ranged(figure.values[:, k])}, ± {2 * deviation(figure)[:, k].max():.1g}")
            cells.append(row)
    return cells


def ranged(values: Array) -> str:
    """Least and greatest, kg."""
    return f"{values.min():.3f} .. {values.max():.3f}"


def deviation(figure: Field) -> Array:
    """Deviations of a figure that has them."""
    assert figure.se is not None
    return figure.se


def posture(found: Results) -> list[list[str]]:
    """Every figure at the posture, by branch."""
    columns = [dict(at_posture(found, handle)) for handle in found.handles.values()]
    cells = [["figure", "unit", *(one.branch.title for one in found.found.values())]]
    for what, unit in columns[0]:
        cells.append([what, unit, *(column[what, unit] for column in columns)])
    return cells


def at_posture(found: Results, handle: Handle) -> Iterator[tuple[tuple[str, str], str]]:
    """Name and unit of each figure, and its value with a 95 % interval where it has one."""
    c, plan = handle.essential, found.demo.posture
    for k in range(3):
        yield (f"apparent mass {k + 1}", "kg"), told(c.apparent_mass, k)
    for k in range(3):
        yield (f"viscous friction {k + 1}, all parameters", "N s/m"), told(handle.full.viscous_friction, k)
    for axis, d in zip(AXES, np.eye(3), strict=True):
        yield (f"Coulomb friction along {axis}", "N"), told(c.coulomb_friction(d), AXES.index(axis))
    for axis in AXES:
        yield (f"Coulomb friction along {axis}, as printed", "N"), told(c.coulomb_by_axis, AXES.index(axis))
    for axis, d in zip(AXES, np.eye(3), strict=True):
        for way, sign in (("+", 1), ("-", -1)):
            yield (f"back-drive force along {way}{axis}", "N"), told(c.backdrive_force(sign * d))
    for speed in plan.speeds:
        yield (f"force neglected at {speed:g} m/s", "N"), told(c.neglected_force(speed))
    stiffness = [plan.stiffness[drive.name] for drive in found.model.device.motors]
    values, _ = c.stiffness(stiffness)
    for k in range(3):
        yield (f"stiffness {k + 1}", "N/m"), f"{values[0, k]:.0f}"
    yield ("peak force in the worst direction", "N"), told(c.greatest_force(plan.limits)[0])


def told(figure: Field, k: int | None = None) -> str:
    """The figure of the only pose, and its interval."""
    pick = 0 if k is None else (0, k)
    value, band = float(figure.values[pick]), figure.conf_int()
    if band is None or not np.isfinite(band[pick]).all() or np.ptp(band[pick]) == 0:
        return f"{value:.4f}"
    low, high = band[pick]
    return f"{value:.4f} ({low:.4f} .. {high:.4f})"


def summary(found: Results) -> str:
    """Published parameters and ours, as text."""
    lines = []
    for one in found.found.values():
        lines += [f"{one.branch.title} branch", *aligned(parameters(one)), ""]
        lines += [
            f"W: {one.every.rows} x {len(one.full.beta)}, condition {one.every.condition[0]:.3g} raw and "
            f"{one.every.condition[1]:.3g} scaled; of the {len(one.table.rows)} published columns "
            f"{one.condition_of_published[0]:.3g} and {one.condition_of_published[1]:.3g}.",
            f"{len(one.full.kept)} parameters, {len(one.reduction.essential)} essential; relative error "
            f"{one.direct.relative:.2f} % direct, {one.cross.relative:.2f} % on unseen motion.",
            "",
        ]
    return "\n".join(lines)
