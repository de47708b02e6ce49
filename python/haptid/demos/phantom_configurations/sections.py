"""The page: parameters, errors and figures 3 to 12 of the paper, with the numbers of the demonstration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.accuracy import accuracy
from haptid.demos.flaws import flaws_section
from haptid.demos.phantom_configurations.fits import Fit
from haptid.demos.phantom_configurations.redesign import redesign_section
from haptid.demos.phantom_configurations.results import Evaluation, Results
from haptid.demos.phantom_configurations.tables import cells2, error_comparison, ours, published, table1, table2, truth
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.torque_decomposition import RIGID, decompose_torque
from haptid.motion.motion import Motion
from haptid.observation.rows import chunks
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable, panels
from haptid.validation.prediction import predict

# Seconds that are drawn, from the start of the half that validates.
TORQUES, PARTS = 9.0, 10.0
FIRST_OF_PARTS = 7


def sections(results: Results) -> list[DocumentSection]:
    """All sections of the page but the claims."""
    makers = (_bench, _parameters, _errors, _delay, _accuracy, _consistency, _decomposition, _hand, _comparisons)
    flaws = [flaws_section(results.flawed)] if results.flawed else []
    return [*(make(results) for make in makers), *flaws, redesign_section(results)]


def per_command(model: DynamicModel) -> Array:
    """Command per joint torque of each motor, (motors,)."""
    return np.array([1.0 / (drive.gear_ratio * drive.torque_constant) for drive in model.device.motors])


def _bench(results: Results) -> DocumentSection:
    stretch = results.demo.stretch
    gains = ", ".join(f"{scale:g}" for scale in dict.fromkeys(per_command(results.model).round(6).tolist()))
    text = (
        f"{results.model.device.name} on the virtual bench in {len(results.fits)} mountings, each with one log from "
        f"encoders and one from exact sensors. {stretch.start:g} s to {stretch.middle:g} s identify, "
        f"{stretch.middle:g} s to {stretch.stop:g} s validate. The experiment files are next to the logs, for "
        f"`haptid bench`. The published values were measured on a real device with unknown true parameters; the "
        f"simulated device has known ones.",
        f"One N m at the joint is {gains} units of command. Tables are in units of command, as published.",
    )
    return DocumentSection("bench", "Setup", text)


def _parameters(results: Results) -> DocumentSection:
    columns = {
        "Published": published(results),
        "Encoders, proposed treatment": ours(results, "encoders"),
        "Exact velocities, the paper's method: momentum equation filtered by L(s)": ours(results, "exact"),
        "Without friction in the model, the paper's method": ours(results, "frictionless"),
        "True on the bench": truth(results),
    }
    fits = [fits["exact"].command for fits in results.fits.values()]
    white, robust = (
        np.concatenate([np.diag(cov) for cov in some])
        for some in ([f.classical_covariance for f in fits], [f.covariance for f in fits])
    )
    about = (
        f"Published variances are between 1e-9 and 1e-6. With exact velocities ours are between {white.min():.0e} and "
        f"{white.max():.0e} for white residuals (classical), and between {robust.min():.0e} and {robust.max():.0e} "
        f"for serially correlated ones (cluster-robust). In SI and with intervals: table1.txt, table1.csv."
    )
    tables = tuple(TextTable(title, table1(results, evaluation)) for title, evaluation in columns.items())
    return DocumentSection("parameters", "Parameters (Table I)", (about,), tables)


def _errors(results: Results) -> DocumentSection:
    shown = ("Published", "Exact velocity", "Encoders", "The same, held")
    tables = [
        TextTable(f"{title}, per cent", cells2(results, columns))
        for title, columns in table2(results).items()
        if title.startswith(shown) and "late" not in title
    ]
    tables.append(TextTable("Published, and all rows here, per cent", error_comparison(results)))
    text = (
        "100 norm(measured - predicted) / norm(measured) of the treated torque on the unseen half, by motor. At a "
        "reversal a joint sticks for some milliseconds and its friction is between the two Coulomb values, which no "
        "sign function predicts. Rows whose filter sees a reversal are therefore left out; errors on all rows are "
        "given too.",
        "Figures 3 and 5: torque without and with friction in the model. Figure 4: residual of the model without "
        "friction against velocity, in two clusters by the sign of the velocity. Figure 6: identified friction.",
    )
    charts = tuple(_friction_charts(results))
    return DocumentSection("errors", "Torque prediction (Table II)", text, tuple(tables), charts)


def _friction_charts(results: Results) -> list[Chart]:
    """Figures 3 to 6 for the first mounting."""
    fits = next(iter(results.fits.values()))
    bare, exact = fits["frictionless"], fits["exact"]
    model = bare.estimate.model
    labels = results.model.device.row_labels
    t, measured, predicted = torques(bare, TORQUES)
    constants = torques(bare, TORQUES, model.prior_beta)[2]
    curves = {
        "measured": ("black", measured),
        "fit of 8 parameters": ("blue", predicted),
        "constants of [1]": ("vermillion", constants),
    }
    charts = panels("fig3", "Fig. 3: filtered torque, no friction model", labels, "N m of command", t, curves)
    prediction = predict(bare.estimate, bare.unseen)
    speed = np.concatenate([s.filtered(s.cd) for s in chunks(model, bare.unseen)], axis=1)
    residual = per_command(model)[:, None] * (prediction.measured - prediction.predicted)
    for k, label in enumerate(labels):
        points = [chart_series("residual", "points", "blue", x=packed(speed[k]), y=packed(residual[k]))]
        drawing = plot(axis("velocity", "rad/s"), axis("residual", "N m of command", zero=True), points, height=220)
        about = f"Residual of the fit of 8 parameters against velocity, {label}."
        charts.append(Chart(f"fig4-{k}", f"Fig. 4: {label}", about, about, drawing))
    t, measured, predicted = torques(exact, TORQUES)
    curves = {"measured": ("black", measured), "fit of 14 parameters": ("blue", predicted)}
    charts += panels("fig5", "Fig. 5: filtered torque, friction modelled", labels, "N m of command", t, curves)
    t, parts = _torque_parts(exact, TORQUES)
    both = {"friction": ("black", parts["viscous"] + parts["Coulomb"])}
    both |= {"Coulomb": ("blue", parts["Coulomb"]), "viscous": ("vermillion", parts["viscous"])}
    return charts + panels("fig6", "Fig. 6: friction", labels, "N m of command", t, both)


def _delay(results: Results) -> DocumentSection:
    text = (
        "The paper computes velocities by a high-pass, which delays them. A delayed velocity turns inertia into "
        "apparent negative viscous friction. Viscous coefficients from the logs with encoders, momentum equation "
        "filtered by L(s), in thousandths of the command's unit:"
    )
    late = [key for key in next(iter(results.fits.values())).by if key.startswith("late")]
    keys = ["encoders", *late]
    heads = ["without delay", *(f"velocity {key}" for key in late)]
    cells = [["mounting", "true", *heads, "error on unseen rows, %"]]
    printed, rows = results.demo.parameters, []
    for key, fits in results.fits.items():
        near = accuracy(fits["encoders"].targets, fits.encoders, results.demo.stretch.unseen)
        damping = np.flatnonzero(near.kinds == "viscous")
        true = fits["encoders"].command.C @ fits.encoders.beta
        found_here = [fits[name].command.value for name in keys]
        triples = [", ".join(f"{1e3 * x:.1f}" for x in values[damping]) for values in (true, *found_here)]
        errors = " / ".join(f"{fits[name].validation.relative:.1f}" for name in keys)
        cells.append([results.demo.mountings[key], *triples, errors])
        rows += [printed.figures.get((near.names[k], key), 0.0) < 0 for k in damping]
    count = (
        f"Of {len(rows)} published viscous coefficients {sum(rows)} are negative, which no passive joint can have. "
        f"Delay is a sufficient cause, not a proven one."
    )
    return DocumentSection("delay", "Delayed velocity", (text, count), (TextTable("", cells),))


def _accuracy(results: Results) -> DocumentSection:
    text = (
        "Errors in per cent: of the exact torque on the unseen half where no joint sticks, worst motor; of inertial "
        "and gravity parameters that carry 2 % of a motor's torque; of Coulomb and viscous friction. Last: how many "
        "true parameters are inside their 95 % interval."
    )
    cells = [["mounting", "data", "torque", "parameters", "Coulomb", "viscous", "inside"]]
    for key, fits in results.fits.items():
        for name, log in (("exact", fits.exact), ("encoders", fits.encoders)):
            near = accuracy(fits[name].targets, log, results.demo.stretch.unseen)
            worst = [f"{near.worst(kind):.2f}" for kind in ("body", "Coulomb", "viscous")]
            inside = f"{int(near.inside.sum())} of {len(near.inside)}"
            cells.append([results.demo.mountings[key], fits[name].title, f"{near.torque.max():.3f}", *worst, inside])
    key, first = next(iter(results.fits.items()))
    reasons = " ".join(first.proposal.reasons)
    about = f"Treatment of the logs with encoders, mounting {results.demo.mountings[key]}: {reasons}"
    return DocumentSection("accuracy", "Errors against the true parameters", (text, about), (TextTable("", cells),))


def _consistency(results: Results) -> DocumentSection:
    demo, scale = results.demo, float(per_command(results.model).max())
    cells = [["parameters", *(place.name for place in demo.workspaces), "physically consistent"]]
    reasons = []
    for name, evaluation in results.published.items():
        title = demo.mountings.get(name, demo.bodies)
        cells.append([f"published, {title}", *_evaluation(evaluation, scale)])
        if not evaluation.feasible.ok:
            reasons.append(f"{title}: {'; '.join(evaluation.feasible.failing)}")
    for (key, fit), evaluation in results.evaluated.items():
        title = f"{demo.mountings[key]}, {'constrained' if fit == 'held' else 'free'}"
        cells.append([title, *_evaluation(evaluation, scale)])
    largest = max(
        fits["held"].validation.relative - fits["encoders"].validation.relative for fits in results.fits.values()
    )
    text = (
        "Smallest eigenvalue of the mass matrix in units of command, and the share of poses where it is not positive "
        f"definite. Workspaces: {'; '.join(f'{place.name}: {place.title}' for place in demo.workspaces)}.",
        f"Published columns that no real bodies can have: {'. '.join(reasons)}.",
        f"Estimates constrained to physical consistency predict the unseen half at most {largest:.3f} percentage "
        f"points worse than the free ones.",
    )
    title = "Positive definiteness and physical consistency"
    return DocumentSection("consistency", title, text, (TextTable("", cells),))


def _evaluation(evaluation: Evaluation, scale: float) -> list[str]:
    cells = [
        f"{d.smallest * scale:.2e}" + (f" ({100 * d.share:.1f} %)" if d.share else "") for d in evaluation.definite
    ]
    return [*cells, "yes" if evaluation.feasible.ok else "no"]


def _decomposition(results: Results) -> DocumentSection:
    labels = results.model.device.row_labels
    cells, charts = [["mounting", "motor", *RIGID, "friction"]], []
    colours = {"measured": "black", "inertia": "blue", "Coriolis and centrifugal": "green"}
    colours |= {"gravity": "vermillion", "friction": "purple"}
    for number, (key, fits) in enumerate(results.fits.items(), FIRST_OF_PARTS):
        fit, title = fits["exact"], results.demo.mountings[key]
        decomposition = decompose_torque(fit.estimate, fit.unseen)
        total = np.sqrt((decomposition.total**2).mean(axis=1))
        for k, motor in enumerate(decomposition.motors):
            shares = (
                np.sqrt((part[k] ** 2).mean()) / total[k]
                for part in (*(decomposition[p] for p in RIGID), decomposition.friction)
            )
            cells.append([title, motor, *(f"{100 * share:.0f}" for share in shares)])
        t, parts = _torque_parts(fit, PARTS)
        curves = {name: (colour, parts[name]) for name, colour in colours.items()}
        charts += panels(f"fig{number}", f"Fig. {number}: {title}", labels, "N m of command", t, curves)
    text = "RMS of each part on the unseen half, per cent of the RMS of the whole; parts may cancel each other."
    last = FIRST_OF_PARTS + len(results.fits) - 1
    title = f"Decomposition of the torque (figures {FIRST_OF_PARTS} to {last})"
    return DocumentSection("decomposition", title, (text,), (TextTable("", cells),), tuple(charts))


def _hand(results: Results) -> DocumentSection:
    hand, number, direction = results.hand, FIRST_OF_PARTS + len(results.fits), results.demo.hand.axis
    text = (
        f"Mounting {results.demo.mountings[results.demo.hand.mounting]}. The exact force is inside the 95 % interval "
        f"in {100 * hand.inside:.0f} % of the rows and components. The momentum observer is causal and uses no "
        f"accelerations; it is compared at its own bandwidth with the model's force through the same low-pass."
    )
    cells = [["RMS of the error", "N"], *([name, f"{error:.4f}"] for name, error in hand.errors.items())]

    def curve(values: Array) -> Array:
        return values[None, :, direction]

    forces = {
        "force sensor": ("black", curve(hand.measured)),
        "without the model": ("vermillion", curve(hand.bare)),
        "with the model": ("blue", curve(hand.modelled)),
    }
    errors = {
        "without the model": ("vermillion", curve(hand.bare - hand.measured)),
        "with the model": ("blue", curve(hand.modelled - hand.measured)),
    }
    fine = {
        "with the model": ("blue", curve(hand.modelled_delayed - hand.true_delayed)),
        "momentum observer": ("green", curve(hand.observed - hand.true_delayed)),
    }
    title, charts = f"Fig. {number}: force along {'xyz'[direction]}", []
    for key, label, curves in (
        ("force", "force", forces),
        ("error", "error", errors),
        ("late", "error at the observer's bandwidth", fine),
    ):
        charts += panels(f"fig{number}-{key}", title, [label], "N", hand.t, curves)
    return DocumentSection("hand", f"Hand force (figure {number})", (text,), (TextTable("", cells),), tuple(charts))


def _comparisons(results: Results) -> DocumentSection:
    demo, text = results.demo, []
    for pair, made in results.comparisons:
        names = f"{demo.mountings[pair.first]} compared with {demo.mountings[pair.second]}, encoders"
        text.append(f"{names}: {' '.join(made.sentences)}")
    cells = [["tool at the handle", "value", "95 % interval", "true"]]
    tool = results.tool.parameters
    for name, value, (low, high) in zip(tool.names, tool.values, tool.conf_int(), strict=True):
        if name in results.tool_truth:
            cells.append([name, f"{value:.5g}", f"{low:.5g} .. {high:.5g}", f"{results.tool_truth[name]:.5g}"])
    return DocumentSection("comparisons", "Mountings compared", tuple(text), (TextTable("", cells),))


def torques(fit: Fit, seconds: float, beta: Array | None = None) -> tuple[Array, Array, Array]:
    """Times (rows,), measured and predicted command (motors, rows) of the first seconds of the unseen half."""
    given = fit.estimate.quantities
    given = given if beta is None else replace(given, values=beta)
    estimate = replace(fit.estimate, quantities=given)
    made, scale = predict(estimate, beginning(fit.unseen, seconds)), per_command(fit.estimate.model)[:, None]
    return made.t, scale * made.measured, scale * made.predicted


def beginning(motion: Motion, seconds: float) -> Motion:
    """The first seconds of a motion with known velocities and accelerations."""
    n = min(len(motion), round(seconds / motion.dt))
    assert motion.rates is not None
    qd, qdd = motion.rates
    # Segments and gaps are those of the log, which is longer.
    return replace(motion, q=motion.q[:n], tau=motion.tau[:n], rates=(qd[:n], qdd[:n]), log=None)


def _torque_parts(fit: Fit, seconds: float) -> tuple[Array, dict[str, Array]]:
    """Times, and the parts of the command by name, with the measured one and friction, each (motors, rows)."""
    made = decompose_torque(fit.estimate, beginning(fit.unseen, seconds))
    scale = per_command(fit.estimate.model)[:, None]
    parts = {part: scale * made[part] for part in made.parts}
    return made.t, parts | {"friction": scale * made.friction, "measured": scale * made.measured}
