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


def sections(results: Results) -> list[DocumentSection]:
    """All sections of the page but the claims."""
    makers = (_friction, _identification, _elimination, _parameters, _masses, _posture, compensation_section)
    flaws = [flaws_section(results.flawed)] if results.flawed else []
    interface = [_interface(results.interface)] if results.interface else []
    return [*(make(results) for make in makers), *flaws, *interface]


def _friction(results: Results) -> DocumentSection:
    text = [
        f"{results.model.device.name} on the virtual bench with encoders and noise. Each branch has three logs: a "
        f"friction test, the motion that identifies, and another motion for validation. The experiment files are "
        f"next to the logs, for `haptid bench`. The true parameters are the published identified values, and zero "
        f"where the paper reports none; those of the real device are unknown.",
        "In the friction test each joint in turn moves to and fro at constant velocities; friction models are compared "
        "by AICc.",
    ]
    charts = []
    for key, test in results.friction.items():
        title = results.found[key].branch.title
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
    table = TextTable("Coulomb friction, N m", friction(results))
    return DocumentSection("friction-test", "Friction test", tuple(text), (table,), tuple(charts))


def _identification(results: Results) -> DocumentSection:
    text = []
    for branch in results.found.values():
        raw, scaled = branch.every.condition
        published_raw, published_scaled = branch.condition_of_published
        text.append(
            f"{branch.branch.title} branch: W is {branch.every.rows} x {len(branch.full.beta)}, with "
            f"{branch.full.observation.rows} rows clear of reversals. Condition number of all rows: {raw:.0f}, with "
            f"unit columns {scaled:.0f}; of the {len(branch.table.rows)} published columns {published_raw:.0f} and "
            f"{published_scaled:.1f}. Treatment: {' '.join(branch.proposal.reasons)}"
        )
    motors = [motor.label for motor in next(iter(results.found.values())).cross.motors]
    cells = [["branch", "comparison", *motors, "all"]]
    for branch in results.found.values():
        cells.append([branch.branch.title, "in-sample, rows of the fit", *_errors(branch.fit_errors)])
        cells.append([branch.branch.title, "cross test, unseen motion", *_errors(branch.cross)])
        cells.append([branch.branch.title, "cross test, unseen motion, all rows", *_errors(branch.cross_everywhere)])
    title = "100 norm(measured - predicted) / norm(measured) of the treated torque, per cent"
    charts = [chart for k, drawn in enumerate(results.demo.drawn) for chart in _torque(results, drawn, f"torque-{k}")]
    return DocumentSection("identification", "Identification", tuple(text), (TextTable(title, cells),), tuple(charts))


def _errors(validation: Validation) -> list[str]:
    return [*(f"{motor.relative:.2f}" for motor in validation.motors), f"{validation.relative:.2f}"]


def _torque(results: Results, drawn: Drawn, key: str) -> list[Chart]:
    """Measured and predicted torque of one motor, and the residual on the rows that count."""
    branch = results.found[drawn.branch]
    prediction = predict(branch.reduced, branch.unseen if drawn.unseen else branch.fit)
    row, shown = branch.model.device.row_names.index(drawn.motor), prediction.t < prediction.t[0] + drawn.seconds
    measured, predicted = prediction.measured[[row]][:, shown], prediction.predicted[[row]][:, shown]
    residual = np.where(prediction.used[[row]][:, shown], measured - predicted, 0.0)
    upper = {"measured": ("black", measured), "predicted": ("blue", predicted)}
    lower = {"residual, zero at reversals": ("vermillion", residual)}
    return [
        *panels(key, drawn.title, [prediction.motors[row]], prediction.units[row], prediction.t[shown], upper),
        *panels(f"{key}-residual", drawn.title, ["residual"], prediction.units[row], prediction.t[shown], lower),
    ]


def _elimination(results: Results) -> DocumentSection:
    text, tables = [], []
    for branch in results.found.values():
        reduction, names = branch.reduction, branch.reduction.essential
        assert reduction.unseen is not None
        before, after = reduction.unseen
        text.append(
            f"{branch.branch.title} branch: {len(branch.full.free_parameters)} parameters, {len(names)} essential: "
            f"{', '.join(names)}. {reduction.reason} The essential parameters move by at most "
            f"{np.nanmax(np.abs(reduction.shift)):.1f} of their standard errors in the full model; the error on "
            f"unseen motion changes from {before.relative:.3f} % to {after.relative:.3f} %."
        )
        text += differences(branch)
        for motor in branch.by_motor:
            label, count = motor.full.observation.motors[0].label, len(motor.full.free_parameters)
            text.append(f"{label} alone: {count} identifiable parameters, essential {', '.join(motor.essential)}.")
        cells = [["eliminated", "relative standard error, %", "p of the F-test"]]
        cells += [[step.name, f"{step.relative_se:.0f}", f"{step.test.p:.2f}"] for step in reduction.steps]
        tables.append(TextTable(f"Backward elimination, {branch.branch.title.lower()} branch", cells))
    return DocumentSection("elimination", "Essential parameters", tuple(text), tuple(tables))


def differences(branch: Identified) -> Iterator[str]:
    """How the essential parameters differ from the published ones, a sentence for each parameter."""
    if not (branch.missing or branch.more):
        yield f"These are the {len(branch.table.rows)} that are published."
    for name in branch.missing:
        (step,) = [step for step in branch.reduction.steps if step.name == name]
        yield (
            f"{name} is published and eliminated here: relative standard error {step.relative_se:.3g} %, value "
            f"{branch.full[name].value:.2g} {branch.full[name].unit}."
        )
    for name in branch.more:
        p = branch.reduced[name]
        yield (
            f"{name} is essential here and not published: {p.value:.2g} {p.unit}, relative standard error "
            f"{p.relative_se:.3g} %; true value {branch.true(name):.2g}."
        )


def _parameters(results: Results) -> DocumentSection:
    text = [
        "± is 100 standard errors / |value|. The published ones assume white residuals, ours do not. CAD values of "
        "friction are those of the published friction test."
    ]
    for branch in results.found.values():
        names = branch.reduction.essential
        ratio = {
            n: branch.reduced[n].relative_se / branch.table.figures[n, "relative"]
            for n in branch.table.rows
            if n in names
        }
        text.append(
            f"{branch.branch.title} branch: {sum(map(branch.inside, names))} of {len(names)} intervals contain the "
            f"true value; relative standard errors are {100 * min(ratio.values()):.0f} to "
            f"{100 * max(ratio.values()):.0f} % of the published ones."
        )
    tables = tuple(TextTable(f"{branch.branch.title} branch", parameters(branch)) for branch in results.found.values())
    return DocumentSection("parameters", "Parameters (tables 1 and 2)", tuple(text), tables)


def _masses(results: Results) -> DocumentSection:
    text = [f"{sweep.label.split(',')[0]}: {sweep.title}." for sweep in results.demo.sweeps]
    text += [*_disjoint_ranges(results), *_similarity(results)]
    cells = [["sweep", "largest mass", "printed, kg", *(branch.branch.title for branch in results.found.values())]]
    for statement in results.demo.statements:
        masses = (handle.sweeps[statement.sweep].mass.values[:, 0] for handle in results.handles.values())
        ours = [f"{_FIGURES[statement.what](mass):.2f}" for mass in masses]
        label = results.demo.sweep(statement.sweep).label.split(",")[0]
        cells.append([label, _WORDS[statement.what], f"{statement.published:.2f}", *ours])
    charts = [
        _sweep_chart(results, sweep, key, branch)
        for sweep in results.demo.sweeps
        for key, branch in results.found.items()
    ]
    tables = (TextTable("Ranges", sweeps(results)), TextTable("Printed statements", cells))
    return DocumentSection("masses", "Apparent mass (figure 7)", tuple(text), tables, tuple(charts))


def _sweep_chart(results: Results, sweep: Sweep, key: str, branch: Identified) -> Chart:
    """Principal apparent masses along a sweep with 95 % intervals; the published ranges are dashed."""
    mass, x = results.handles[key].sweeps[sweep.key].mass, packed(sweep.plotted)
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
    title = f"Fig. 7, {branch.branch.title.lower()} branch: {sweep.title}"
    alt = f"Principal apparent masses against {label}, with the published ranges."
    return Chart(f"sweep-{sweep.key}-{key}", title, alt, f"{ranges}.", drawing)


def _disjoint_ranges(results: Results) -> Iterator[str]:
    """Masses whose published ranges in the two sweeps are disjoint, where ours are equal."""
    first, second = results.demo.sweeps
    for k, ((low, high), (other_low, other_high)) in enumerate(zip(first.published, second.published, strict=True)):
        if max(low, other_low) > min(high, other_high):
            for key, handle in results.handles.items():
                masses = np.concatenate([handle.sweeps[sweep.key].mass.values[:, k] for sweep in (first, second)])
                yield (
                    f"The published ranges of mass {k + 1} in the two sweeps are disjoint: {low:g} .. {high:g} and "
                    f"{other_low:g} .. {other_high:g} kg. Ours ({results.found[key].branch.title.lower()}) vary by "
                    f"{100 * np.ptp(masses) / masses.mean():.1f} % over both: one geometry cannot have both ranges."
                )


def _similarity(results: Results) -> Iterator[str]:
    """Change of the largest mass in 10 degrees of each sweep, and differences between the branches."""
    for sweep in results.demo.sweeps:
        masses = [handle.sweeps[sweep.key].mass.values[:, 0] for handle in results.handles.values()]
        rate = max(10 * np.ptp(mass) / np.ptp(sweep.degrees) for mass in masses)
        yield f"The largest mass changes by {rate:.2f} kg in 10 degrees of {sweep.label.split(',')[0]}."
    first, *others = (
        np.concatenate([handle.sweeps[sweep.key].mass.values for sweep in results.demo.sweeps])
        for handle in results.handles.values()
    )
    for other in others:
        percent = 100 * np.abs(first / other - 1)
        yield f"Masses of the branches differ by {np.median(percent):.0f} % (median), {percent.max():.0f} % (maximum)."


def _posture(results: Results) -> DocumentSection:
    plan = results.demo.posture
    pose = ", ".join(f"q{name} = {angle:g}" for name, angle in plan.degrees.items())
    limits, stiffness = (", ".join(f"{x:g}" for x in some.values()) for some in (plan.limits, plan.stiffness))
    text = (
        f"{pose} degrees, 95 % intervals in brackets. Viscous friction is from all parameters, as none of it is "
        f"essential. Assumed: joint stiffness of {stiffness} N m/rad and motor limits of {limits} N m.",
        "Coulomb friction is the force for slow motion along an axis, by the signs of the joints' velocities. Eq. (18) "
        "as printed uses the signs of the handle's velocity, which is right only where both agree. The neglected "
        "force includes the weight, as in the paper.",
    )
    return DocumentSection("posture", "Characterisation at a posture", text, (TextTable("", posture(results)),))


def _interface(interface: IdentifiedInterface) -> DocumentSection:
    """Both branches on one handle."""
    device, base, rows = interface.model.device, interface.model.base, interface.estimate.observation
    regroupings = interface.model.regroupings
    difference = np.abs(regroupings.values - base.regrouping).max() / np.abs(base.regrouping).max()
    text = (
        f"{device.name}: {len(device.joints)} joints, {len(device.active)} degrees of freedom, {len(device.motors)} "
        "motors. Published are the branches alone; the device file says what is assumed of how they stand and hold the "
        f"handle. Torque rows are those of the {len(device.active)} coordinates, B' times the motors' torques; their "
        "covariance varies with the pose.",
        f"{len(base)} base parameters of {len(base.standard)}. Numeric and exact regroupings differ by "
        f"{difference:.0e} of the largest coefficient. MXUBR is "
        f"{regroupings.formulas[base.names.index('MXUBR')]}.",
        f"They are identified from {rows.rows} rows of "
        f"{interface.plan.identify[1] - interface.plan.identify[0]:g} s; {len(interface.inside)} of their 95 % "
        f"intervals contain the true value. Treatment: {' '.join(interface.proposal.reasons)}",
    )
    labels = [motor.label for motor in interface.cross.motors]
    errors = [["comparison", *labels, "all"]]
    errors.append(["unseen motion", *_errors(interface.cross)])
    errors.append(["unseen motion, all rows", *_errors(interface.cross_everywhere)])
    tables = (
        TextTable("100 norm(measured - predicted) / norm(measured) of the treated torque, per cent", errors),
        TextTable("Handle at a posture, 95 % intervals", handle_of_interface(interface)),
        TextTable(
            "Handle over the workspace: median (least .. greatest) of its greatest masses", map_of_interface(interface)
        ),
    )
    prediction = predict(interface.estimate, interface.unseen)
    residual = np.where(prediction.used, prediction.measured - prediction.predicted, 0.0)
    title = "Unseen motion"
    upper = {"measured": ("black", prediction.measured[:1]), "predicted": ("blue", prediction.predicted[:1])}
    lower = {"residual, zero at reversals": ("vermillion", residual[:1])}
    charts = panels("interface", title, prediction.motors[:1], prediction.units[0], prediction.t, upper)
    charts += panels("interface-residual", title, ["residual"], prediction.units[0], prediction.t, lower)
    return DocumentSection("interface", "The whole interface", text, tables, tuple(charts))
