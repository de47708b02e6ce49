"""Tables 1 and 2 of the paper next to ours, friction test, sweeps and posture, and all numbers as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.cea_branches.compensation import Compensated
from haptid.demos.cea_branches.interface import IdentifiedInterface
from haptid.demos.cea_branches.other_laws import LawInHand
from haptid.demos.cea_branches.results import Handle, Identified, Results, coulomb_of
from haptid.demos.plan import write_csv
from haptid.end_effector.characterisation import Characterisation
from haptid.end_effector.compensation import DesignPoint
from haptid.uncertainty.quantities import Field, aligned
from haptid.validation.validation import Validation

_AXES = "xyz"
_Cells = list[list[str]]


def parameters(branch: Identified) -> _Cells:
    """The published table with the essential parameters found here."""
    cells = [["", "unit", "CAD", "published", "±, %", "found", "±, %", "95 % interval", "true"]]
    for name in branch.table.rows:
        p = branch.reduced[name]
        known = [f"{branch.table.figures[name, column]:g}" for column in branch.table.columns]
        low, high = p.conf_int()
        ours = ["left out", "", ""]
        if name in branch.reduction.essential:
            ours = [f"{p.value:.5f}", f"{p.relative_se:.2f}", f"{low:.5f} .. {high:.5f}"]
        cells.append([name, p.unit, *known, *ours, f"{branch.true(name):.5f}"])
    return cells


def friction(results: Results) -> _Cells:
    """Coulomb friction from the friction test, by branch and motor."""
    cells = [["branch", "motor", "published, test", "found, test", "95 % interval", "true"]]
    for key, test in results.friction.items():
        branch = results.found[key]
        for joint in test.choice.joints:
            name = coulomb_of(results.model, joint.label)
            value, (low, high) = test.coulomb(joint.label)
            row = [f"{branch.table.figures[name, 'cad']:g}", f"{value:.4f}", f"{low:.4f} .. {high:.4f}"]
            cells.append([branch.branch.title, joint.label, *row, f"{branch.true(name):.4f}"])
    return cells


def sweeps(results: Results) -> _Cells:
    """Ranges of the masses along the sweeps: published, and ours by branch with the widest interval."""
    titles = [branch.branch.title for branch in results.found.values()]
    cells = [["sweep", "mass", "published, kg", *(f"{title}, kg" for title in titles)]]
    for sweep in results.demo.sweeps:
        for k, (low, high) in enumerate(sweep.published):
            row = [sweep.title if k == 0 else "", ["largest", "middle", "smallest"][k], f"{low:g} .. {high:g}"]
            for handle in results.handles.values():
                mass = handle.sweeps[sweep.key].mass
                assert mass.se is not None
                row.append(f"{ranged(mass.values[:, k])}, ± {2 * mass.se[:, k].max():.1g}")
            cells.append(row)
    return cells


def ranged(values: Array) -> str:
    """Smallest and largest value, kg."""
    return f"{values.min():.3f} .. {values.max():.3f}"


def posture(results: Results) -> _Cells:
    """Characterisation at the posture, by branch."""
    columns = [dict(at_posture(results, handle)) for handle in results.handles.values()]
    cells = [["figure", "unit", *(branch.branch.title for branch in results.found.values())]]
    return cells + [[quantity, unit, *(column[quantity, unit] for column in columns)] for quantity, unit in columns[0]]


def at_posture(results: Results, handle: Handle) -> Iterator[tuple[tuple[str, str], str]]:
    """Name and unit of each figure, and its value with a 95 % interval where it has one."""
    c, plan = handle.essential, results.demo.posture
    for k in range(3):
        yield (f"apparent mass {k + 1}", "kg"), shown(c.apparent_mass, k)
    for k in range(3):
        yield (f"viscous friction {k + 1}, all parameters", "N s/m"), shown(handle.full.viscous_friction, k)
    for axis, d in zip(_AXES, np.eye(3), strict=True):
        yield (f"Coulomb friction along {axis}", "N"), shown(c.coulomb_friction(d), _AXES.index(axis))
    for axis in _AXES:
        yield (f"Coulomb friction along {axis}, as printed", "N"), shown(c.coulomb_by_axis, _AXES.index(axis))
    for axis, d in zip(_AXES, np.eye(3), strict=True):
        for way, sign in (("+", 1), ("-", -1)):
            yield (f"back-drive force along {way}{axis}", "N"), shown(c.backdrive_force(sign * d))
    for speed in plan.speeds:
        yield (f"force neglected at {speed:g} m/s", "N"), shown(c.neglected_force(speed))
    values, _ = c.stiffness([plan.stiffness[drive.name] for drive in results.model.device.motors])
    for k in range(3):
        yield (f"stiffness {k + 1}", "N/m"), f"{values[0, k]:.0f}"
    yield ("peak force in the worst direction", "N"), shown(c.greatest_force(plan.limits)[0])


def handle_of_interface(interface: IdentifiedInterface) -> _Cells:
    """The handle of the whole interface at its posture: masses, rotational inertias, friction, greatest force."""
    limits, true = interface.plan.limits, dict(_at_interface(interface.truly, interface.plan.limits))
    figures = _at_interface(interface.at_posture, limits)
    return [["figure", "unit", "found", "true"], *([*key, text, true[key]] for key, text in figures)]


# Heights of the handle, as shares of the poses, and tilts, degrees, by which the map is divided.
_HEIGHTS, _TILTS = (0.0, 1 / 3, 2 / 3, 1.0), (0.0, 15.0, 30.0, 90.0)


def map_of_interface(interface: IdentifiedInterface) -> _Cells:
    """Median and range of the handle's figures over the workspace, by height and by tilt from upright."""
    grid, limits = interface.over_workspace, interface.plan.limits
    height = grid["linear"].handle.position[:, 1]
    heights = np.quantile(height, _HEIGHTS)
    parts = {"all poses": np.ones(len(height), dtype=bool)}
    for low, high in pairwise(heights):
        parts[f"{1e3 * low:.0f} to {1e3 * high:.0f} mm high"] = (low <= height) & (height <= high)
    for low, high in pairwise(_TILTS):
        parts[f"tilted by {low:.0f} to {high:.0f} degrees"] = (low <= interface.tilt) & (interface.tilt < high)
    figures = {
        "effective mass, kg": grid["linear"].apparent_mass.values[:, 0],
        "effective inertia, kg m^2": grid["angular"].apparent_mass.values[:, 0],
        "Coulomb friction up, N": np.abs(grid["both"].coulomb_friction(np.eye(6)[1]).values[:, 1]),
        "peak force, N": grid["linear"].greatest_force(limits)[0].values,
        "peak moment, N m": grid["angular"].greatest_force(limits)[0].values,
    }
    cells = [["poses", "number", *figures]]
    for name, chosen in parts.items():
        values = [x[chosen] for x in figures.values()]
        cells.append([name, str(np.count_nonzero(chosen)), *(_spread(x[np.isfinite(x)]) for x in values)])
    return cells


def _spread(values: Array) -> str:
    """Median, least and greatest."""
    if not len(values):
        return ""
    return f"{np.median(values):.3g} ({values.min():.3g} .. {values.max():.3g})"


def _at_interface(
    handle: Mapping[str, Characterisation], limits: Mapping[str, float]
) -> Iterator[tuple[tuple[str, str], str]]:
    """Name and unit of each figure, and its value with a 95 % interval where it has one."""
    for k in range(3):
        yield (f"effective mass {k + 1}", "kg"), shown(handle["linear"].apparent_mass, k)
    for k in range(3):
        yield (f"effective inertia {k + 1}", "kg m^2"), shown(handle["angular"].apparent_mass, k, digits=6)
    for k, axis in enumerate((*_AXES, *(f"about {axis}" for axis in _AXES))):
        direction, unit = np.eye(6)[k], "N" if k < len(_AXES) else "N m"
        yield (f"Coulomb friction, {axis}", unit), shown(handle["both"].coulomb_friction(direction), k)
    yield ("peak force in the worst direction", "N"), shown(handle["linear"].greatest_force(limits)[0])
    yield ("peak moment in the worst direction", "N m"), shown(handle["angular"].greatest_force(limits)[0])


def shown(figure: Field, k: int | None = None, digits: int = 4) -> str:
    """The figure of the only pose, and its interval."""
    pick = 0 if k is None else (0, k)
    value, band = float(figure.values[pick]), figure.conf_int()
    if band is None or not np.isfinite(band[pick]).all() or np.ptp(band[pick]) == 0:
        return f"{value:.{digits}f}"
    low, high = band[pick]
    return f"{value:.{digits}f} ({low:.{digits}f} .. {high:.{digits}f})"


def summary(results: Results) -> str:
    """Published parameters and ours, as text."""
    lines = []
    for branch in results.found.values():
        lines += [
            f"{branch.branch.title} branch",
            *aligned(parameters(branch)),
            "",
            f"W: {branch.every.rows} x {len(branch.full.beta)}, condition {branch.every.condition[0]:.3g} raw and "
            f"{branch.every.condition[1]:.3g} scaled; of the {len(branch.table.rows)} published columns "
            f"{branch.condition_of_published[0]:.3g} and {branch.condition_of_published[1]:.3g}.",
            f"{len(branch.full.free_parameters)} parameters, {len(branch.reduction.essential)} essential; relative "
            f"error {branch.fit_errors.relative:.2f} % on the rows of the fit, {branch.cross.relative:.2f} % on unseen "
            "motion.",
            "",
        ]
    return "\n".join(lines)


def write_files(results: Results, folder: Path) -> None:
    """One table of parameters for each branch, friction test, sweeps and posture, each as text and CSV."""
    tables = {Path(branch.branch.table).stem: parameters(branch) for branch in results.found.values()}
    tables |= {"friction": friction(results), "sweeps": sweeps(results), "posture": posture(results)}
    if results.interface:
        tables["interface"] = handle_of_interface(results.interface)
    for name, cells in tables.items():
        (folder / f"{name}.txt").write_text("\n".join(aligned(cells)) + "\n", encoding="utf-8")
        write_csv(folder / f"{name}.csv", cells)


def values(results: Results) -> dict[str, Any]:
    """All numbers, as JSON."""
    compensated = results.compensated
    return {
        "branches": {key: _branch(results, key) for key in results.found},
        "compensation": _compensation(compensated),
        "other_laws": [_law(one) for one in results.others],
        "interface": _interface(results.interface) if results.interface else None,
    }


def _compensation(compensated: Compensated) -> dict[str, Any]:
    return {
        "degrees": compensated.degrees.tolist(),
        "mass": compensated.estimated.tolist(),
        "search": [_point(point) for point in compensated.design.points],
        "chosen": _point(compensated.chosen) if compensated.chosen else None,
        "promised": {name: values.tolist() for name, values in compensated.promised.items()},
        "felt": {
            name: [impedance.quantities.to_json() for impedance in impedances]
            for name, impedances in compensated.felt.items()
        },
        "over_frequency": {
            name: {f"{impedance.frequency_hz:g} Hz": impedance.quantities.to_json() for impedance in impedances}
            for name, impedances in compensated.curves.items()
        },
        "hands": [asdict(trial) for trial in compensated.trials],
    }


def _law(one: LawInHand) -> dict[str, Any]:
    """A law in a hand, as JSON."""
    return {
        "name": one.name,
        "judged": vars(one.judged),
        "felt": one.felt.quantities.to_json(),
        "stiff_hand": asdict(one.stiff),
        "tracking": one.tracking,
    }


def _point(point: DesignPoint) -> dict[str, Any]:
    """A point of the search, as JSON."""
    names = ("share", "velocity_cutoff_hz", "momentum_cutoff_hz", "damping")
    figures = {name: value for name, value in vars(point).items() if name != "law"}
    return {name: getattr(point.law, name) for name in names} | figures


def _interface(interface: IdentifiedInterface) -> dict[str, Any]:
    every = zip(
        interface.model.base.names,
        interface.model.base.units,
        interface.estimate.beta,
        interface.estimate.se,
        interface.beta,
        strict=True,
    )
    return {
        "reasons": interface.proposal.reasons,
        "relative_error_percent": {
            "cross": _errors(interface.cross),
            "cross, all rows": _errors(interface.cross_everywhere),
        },
        "intervals that contain the true value": len(interface.inside),
        "parameters": {
            name: {"unit": unit, "true": float(true), "value": float(value), "se": float(se)}
            for name, unit, value, se, true in every
        },
        "posture": {f"{quantity}, {unit}": text for quantity, unit, text, _ in handle_of_interface(interface)[1:]},
        "workspace": map_of_interface(interface),
    }


def _branch(results: Results, key: str) -> dict[str, Any]:
    branch, handle = results.found[key], results.handles[key]
    return {
        "friction_test": {
            joint.label: {"model": joint.chosen.friction_model, "enough": joint.enough, "values": joint.chosen.values}
            for joint in results.friction[key].choice.joints
        },
        "reasons": branch.proposal.reasons,
        "rows": {"all": branch.every.rows, "used": branch.full.observation.rows},
        "condition": {
            "all rows": branch.every.condition,
            "all rows, published columns": branch.condition_of_published,
            "rows of the fit": branch.full.observation.condition,
        },
        "relative_error_percent": {
            "direct": _errors(branch.fit_errors),
            "cross": _errors(branch.cross),
            "cross, all rows": _errors(branch.cross_everywhere),
        },
        "parameters": {name: _parameter(branch, name) for name in branch.full.base.names},
        "essential": branch.reduction.essential,
        "essential_by_motor": {
            elimination.full.observation.motors[0].name: elimination.essential for elimination in branch.by_motor
        },
        "sweeps": {name: {"mass": sweep.mass.values.tolist()} for name, sweep in handle.sweeps.items()},
        "posture": {f"{quantity}, {unit}": text for (quantity, unit), text in at_posture(results, handle)},
    }


def _parameter(branch: Identified, name: str) -> dict[str, Any]:
    full, reduced = branch.full[name], branch.reduced[name]
    table: dict[str, Any] = {"unit": full.unit, "true": branch.true(name)}
    table["full"] = {"value": full.value, "se": full.se, "conf_int": full.conf_int()}
    if name in branch.reduction.essential:
        table["essential"] = {"value": reduced.value, "se": reduced.se, "conf_int": reduced.conf_int()}
    return table


def _errors(validation: Validation) -> dict[str, float]:
    return {"all": validation.relative, **{motor.label: motor.relative for motor in validation.motors}}
