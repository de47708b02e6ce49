"""The page: friction test, identification, essential parameters, apparent mass along the sweeps, compensation."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.cea_branches.compensation_section import compensation_section
from haptid.demos.cea_branches.interface import IdentifiedInterface
from haptid.demos.cea_branches.plan import Drawn, Sweep
from haptid.demos.cea_branches.results import Identified, Results
from haptid.demos.cea_branches.tables import (
    friction,
    handle_of_interface,
    map_of_interface,
    parameters,
    posture,
    ranged,
    sweeps,
)
from haptid.demos.flaws import flaws_section
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable, panels
from haptid.validation.prediction import predict
from haptid.validation.validation import Validation

_WORDS = {"greatest": "maximum", "least": "minimum", "variation": "variation"}
_FIGURES: dict[str, Callable[[Array], float]] = {"greatest": np.max, "least": np.min, "variation": np.ptp}
# One colour for each mass, largest first.
_COLOURS = ("blue", "vermillion", "green")


def sections(found: Results) -> list[DocumentSection]:
    """All sections of the page but the claims."""
    makers = (_friction, _identification, _elimination, _parameters, _masses, _posture, compensation_section)
    flaws = [flaws_section(found.flawed)] if found.flawed else []
    whole = [_interface(found.interface)] if found.interface else []
    return [*(make(found) for make in makers), *flaws, *whole]


def _friction(found: Results) -> DocumentSection:
    text = [
        f"{found.model.device.name} on the virtual bench with encoders and noise. Each branch has three logs: a "
        f"friction test, the motion that identifies, and another motion for validation. The experiment files are "
        f"next to the logs, for `haptid bench`. The true parameters are the published identified values, and zero "
        f"where the paper reports none; those of the real device are unknown.",
        "In the friction test each joint in turn moves to and fro at constant velocities; friction models are compared "
        "by AICc.",
    ]
    charts = []
    for key, test in found.friction.items():
        title = found.found[key].branch.title
        text += [f"{title} branch, {joint.sentence}" for joint in test.choice.joints]
        for k, joint in enumerate(test.curve.joints):
            low, high = joint.conf_int().T
            points = {"x": packed(joint.velocity), "y": packed(joint.torque), "low": packed(low), "high": packed(high)}
            drawing = plot(
                axis("velocity", "rad/s"),
                axis("friction torque", joint.unit, zero=True),
                [chart_series("mean", "interval", "blue", **points)],
                height=200,
            )
            caption = f"{len(joint.velocity)} constant velocities with 95 % intervals."
            alt = f"Friction torque of {joint.label} against velocity, {title.lower()} branch."
            charts.append(Chart(f"friction-{key}-{k}", f"{title} branch, {joint.label}", alt, caption, drawing))
    table = TextTable("Coulomb friction, N m", friction(found))
    return DocumentSection("friction-test", "Friction test", tuple(text), (table,), tuple(charts))


def _identification(found: Results) -> DocumentSection:
    text = []
    for one in found.found.values():
        raw, scaled = one.every.condition
        published_raw, published_scaled = one.condition_of_published
        text.append(
            f"{one.branch.title} branch: W is {one.every.rows} x {len(one.full.beta)}, with "
            f"{one.full.observation.rows} rows clear of reversals. Condition number of all rows: {raw:.0f}, with unit "
            f"columns {scaled:.0f}; of the {len(one.table.rows)} published columns {published_raw:.0f} and "
            f"{published_scaled:.1f}. Treatment: {' '.join(one.proposal.reasons)}"
        )
    motors = [motor.label for motor in next(iter(found.found.values())).cross.motors]
    cells = [["branch", "comparison", *motors, "all"]]
    for one in found.found.values():
        cells.append([one.branch.title, "in-sample, rows of the fit", *_errors(one.fit_errors)])
        cells.append([one.branch.title, "cross test, unseen motion", *_errors(one.cross)])
        cells.append([one.branch.title, "cross test, unseen motion, all rows", *_errors(one.cross_everywhere)])
    title = "100 norm(measured - predicted) / norm(measured) of the treated torque, per cent"
    charts = [chart for k, drawn in enumerate(found.demo.drawn) for chart in _torque(found, drawn, f"torque-{k}")]
    return DocumentSection("identification", "Identification", tuple(text), (TextTable(title, cells),), tuple(charts))


def _errors(validation: Validation) -> list[str]:
    return [*(f"{motor.relative:.2f}" for motor in validation.motors), f"{validation.relative:.2f}"]


def _torque(found: Results, drawn: Drawn, key: str) -> list[Chart]:
    """Measured and predicted torque of one motor, and the residual on the rows that count."""
    one = found.found[drawn.branch]
    made = predict(one.reduced, one.unseen if drawn.unseen else one.fit)
    row, at = one.model.device.row_names.index(drawn.motor), made.t < made.t[0] + drawn.seconds
    measured, predicted = made.measured[[row]][:, at], made.predicted[[row]][:, at]
    residual = np.where(made.used[[row]][:, at], measured - predicted, 0.0)
    upper = {"measured": ("black", measured), "predicted": ("blue", predicted)}
    lower = {"residual, zero at reversals": ("vermillion", residual)}
    return [
        *panels(key, drawn.title, [made.motors[row]], made.units[row], made.t[at], upper),
        *panels(f"{key}-residual", drawn.title, ["residual"], made.units[row], made.t[at], lower),
    ]


def _elimination(found: Results) -> DocumentSection:
    text, tables = [], []
    for one in found.found.values():
        made, names = one.reduction, one.reduction.essential
        assert made.unseen is not None
        before, after = made.unseen
        text.append(
            f"{one.branch.title} branch: {len(one.full.free_parameters)} parameters, {len(names)} essential: "
            f"{', '.join(names)}. {made.reason} The essential parameters move by at most "
            f"{np.nanmax(np.abs(made.shift)):.1f} of their standard errors in the full model; the error on "
            f"unseen motion changes from {before.relative:.3f} % to {after.relative:.3f} %."
        )
        text += differences(one)
        for motor in one.by_motor:
            label, kept = motor.full.observation.motors[0].label, len(motor.full.free_parameters)
            text.append(f"{label} alone: {kept} identifiable parameters, essential {', '.join(motor.essential)}.")
        cells = [["eliminated", "relative standard error, %", "p of the F-test"]]
        cells += [[step.name, f"{step.relative_se:.0f}", f"{step.test.p:.2f}"] for step in made.steps]
        tables.append(TextTable(f"Backward elimination, {one.branch.title.lower()} branch", cells))
    return DocumentSection("elimination", "Essential parameters", tuple(text), tuple(tables))


def differences(one: Identified) -> Iterator[str]:
    """How the essential parameters differ from the published ones, a sentence for each parameter."""
    if not (one.missing or one.more):
        yield f"These are the {len(one.table.rows)} that are published."
    for name in one.missing:
        (step,) = [step for step in one.reduction.steps if step.name == name]
        yield (
            f"{name} is published and eliminated here: relative standard error {step.relative_se:.3g} %, value "
            f"{one.full[name].value:.2g} {one.full[name].unit}."
        )
    for name in one.more:
        p = one.reduced[name]
        yield (
            f"{name} is essential here and not published: {p.value:.2g} {p.unit}, relative standard error "
            f"{p.relative_se:.3g} %; true value {one.true(name):.2g}."
        )


def _parameters(found: Results) -> DocumentSection:
    text = [
        "± is 100 standard errors / |value|. The published ones assume white residuals, ours do not. CAD values of "
        "friction are those of the published friction test."
    ]
    for one in found.found.values():
        names = one.reduction.essential
        ratio = {n: one.reduced[n].relative_se / one.table.figures[n, "relative"] for n in one.table.rows if n in names}
        text.append(
            f"{one.branch.title} branch: {sum(map(one.inside, names))} of {len(names)} intervals contain the true "
            f"value; relative standard errors are {100 * min(ratio.values()):.0f} to {100 * max(ratio.values()):.0f} % "
            f"of the published ones."
        )
    tables = tuple(TextTable(f"{one.branch.title} branch", parameters(one)) for one in found.found.values())
    return DocumentSection("parameters", "Parameters (tables 1 and 2)", tuple(text), tables)


def _masses(found: Results) -> DocumentSection:
    text = [f"{sweep.label.split(',')[0]}: {sweep.title}." for sweep in found.demo.sweeps]
    text += [*_disjoint_ranges(found), *_similarity(found)]
    cells = [["sweep", "largest mass", "printed, kg", *(one.branch.title for one in found.found.values())]]
    for statement in found.demo.statements:
        masses = (handle.sweeps[statement.sweep].mass.values[:, 0] for handle in found.handles.values())
        ours = [f"{_FIGURES[statement.what](mass):.2f}" for mass in masses]
        label = found.demo.sweep(statement.sweep).label.split(",")[0]
        cells.append([label, _WORDS[statement.what], f"{statement.published:.2f}", *ours])
    charts = [_sweep_chart(found, sweep, key, one) for sweep in found.demo.sweeps for key, one in found.found.items()]
    tables = (TextTable("Ranges", sweeps(found)), TextTable("Printed statements", cells))
    return DocumentSection("masses", "Apparent mass (figure 7)", tuple(text), tables, tuple(charts))


def _sweep_chart(found: Results, sweep: Sweep, key: str, one: Identified) -> Chart:
    """Principal apparent masses along a sweep with 95 % intervals; the published ranges are dashed."""
    mass, x = found.handles[key].sweeps[sweep.key].mass, packed(sweep.plotted)
    band, curves = mass.conf_int(), []
    for k, (ends, colour) in enumerate(zip(sweep.published, _COLOURS, strict=True)):
        curves.append(chart_series(f"mass {k + 1}", "line", colour, x=x, y=packed(mass.values[:, k])))
        for end, level in zip(("lowest", "highest"), ends, strict=True):
            y = packed(np.full(sweep.poses, level))
            curves.append(chart_series(f"{end} published {k + 1}", "line", colour, x=x, y=y, dash="4 3"))
        if band is not None:
            low, high = packed(band[:, k, 0]), packed(band[:, k, 1])
            curves.append(chart_series(f"95 % interval {k + 1}", "band", colour, x=x, low=low, high=high))
    label, _, unit = sweep.label.partition(", ")
    drawing = plot(axis(label, unit), axis("apparent mass", "kg", zero=True), curves, height=260)
    ranges = "; ".join(f"mass {k + 1} {ranged(mass.values[:, k])} kg" for k in range(len(_COLOURS)))
    title = f"Fig. 7, {one.branch.title.lower()} branch: {sweep.title}"
    alt = f"Principal apparent masses against {label}, with the published ranges."
    return Chart(f"sweep-{sweep.key}-{key}", title, alt, f"{ranges}.", drawing)


def _disjoint_ranges(found: Results) -> Iterator[str]:
    """Masses whose published ranges in the two sweeps are disjoint, where ours are equal."""
    first, second = found.demo.sweeps
    for k, (one, other) in enumerate(zip(first.published, second.published, strict=True)):
        if max(one[0], other[0]) > min(one[1], other[1]):
            for key, handle in found.handles.items():
                masses = np.concatenate([handle.sweeps[sweep.key].mass.values[:, k] for sweep in (first, second)])
                yield (
                    f"The published ranges of mass {k + 1} in the two sweeps are disjoint: {one[0]:g} .. {one[1]:g} "
                    f"and {other[0]:g} .. {other[1]:g} kg. Ours ({found.found[key].branch.title.lower()}) vary by "
                    f"{100 * np.ptp(masses) / masses.mean():.1f} % over both: one geometry cannot have both ranges."
                )


def _similarity(found: Results) -> Iterator[str]:
    """Change of the largest mass in 10 degrees of each sweep, and differences between the branches."""
    for sweep in found.demo.sweeps:
        masses = [handle.sweeps[sweep.key].mass.values[:, 0] for handle in found.handles.values()]
        rate = max(10 * np.ptp(mass) / np.ptp(sweep.degrees) for mass in masses)
        yield f"The largest mass changes by {rate:.2f} kg in 10 degrees of {sweep.label.split(',')[0]}."
    first, *others = (
        np.concatenate([handle.sweeps[sweep.key].mass.values for sweep in found.demo.sweeps])
        for handle in found.handles.values()
    )
    for other in others:
        apart = 100 * np.abs(first / other - 1)
        yield f"Masses of the branches differ by {np.median(apart):.0f} % (median), {apart.max():.0f} % (maximum)."


def _posture(found: Results) -> DocumentSection:
    plan = found.demo.posture
    pose = ", ".join(f"q{name} = {angle:g}" for name, angle in plan.degrees.items())
    limits, stiffness = (", ".join(f"{x:g}" for x in some.values()) for some in (plan.limits, plan.stiffness))
    text = (
        f"{pose} degrees, 95 % intervals in brackets. Viscous friction is from all parameters, as none of it is "
        f"essential. Assumed: joint stiffness of {stiffness} N m/rad and motor limits of {limits} N m.",
        "Coulomb friction is the force for slow motion along an axis, by the signs of the joints' velocities. Eq. (18) "
        "as printed uses the signs of the handle's velocity, which is right only where both agree. The neglected "
        "force includes the weight, as in the paper.",
    )
    return DocumentSection("posture", "Characterisation at a posture", text, (TextTable("", posture(found)),))


def _interface(one: IdentifiedInterface) -> DocumentSection:
    """Both branches on one handle."""
    device, base, rows = one.model.device, one.model.base, one.estimate.observation
    regroupings = one.model.regroupings
    apart = np.abs(regroupings.values - base.regrouping).max() / np.abs(base.regrouping).max()
    text = (
        f"{device.name}: {len(device.joints)} joints, {len(device.active)} degrees of freedom, {len(device.motors)} "
        "motors. Published are the branches alone; the device file says what is assumed of how they stand and hold the "
        f"handle. Torque rows are those of the {len(device.active)} coordinates, B' times the motors' torques; their "
        "covariance varies with the pose.",
        f"{len(base)} base parameters of {len(base.standard)}. Numeric and exact regroupings differ by {apart:.0e} "
        f"of the largest coefficient. MXUBR is "
        f"{regroupings.formulas[base.names.index('MXUBR')]}.",
        f"They are identified from {rows.rows} rows of "
        f"{one.plan.identify[1] - one.plan.identify[0]:g} s; {len(one.inside)} of their 95 % intervals contain the "
        f"true value. Treatment: {' '.join(one.proposal.reasons)}",
    )
    labels = [motor.label for motor in one.cross.motors]
    errors = [["comparison", *labels, "all"]]
    errors.append(["unseen motion", *_errors(one.cross)])
    errors.append(["unseen motion, all rows", *_errors(one.cross_everywhere)])
    tables = (
        TextTable("100 norm(measured - predicted) / norm(measured) of the treated torque, per cent", errors),
        TextTable("Handle at a posture, 95 % intervals", handle_of_interface(one)),
        TextTable(
            "Handle over the workspace: median (least .. greatest) of its greatest masses", map_of_interface(one)
        ),
    )
    made = predict(one.estimate, one.unseen)
    residual = np.where(made.used, made.measured - made.predicted, 0.0)
    title = "Unseen motion"
    upper = {"measured": ("black", made.measured[:1]), "predicted": ("blue", made.predicted[:1])}
    lower = {"residual, zero at reversals": ("vermillion", residual[:1])}
    charts = panels("interface", title, made.motors[:1], made.units[0], made.t, upper)
    charts += panels("interface-residual", title, ["residual"], made.units[0], made.t, lower)
    return DocumentSection("interface", "The whole interface", text, tables, tuple(charts))
