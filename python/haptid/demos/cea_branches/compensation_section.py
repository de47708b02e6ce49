"""The chapter on mass compensation: the search, what is felt at its point, over frequency, and with hands."""

from __future__ import annotations

from haptid.demos.cea_branches.results import Results
from haptid.end_effector.compensation import DesignPoint
from haptid.experiment.bench import HandleImpedance
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable


def compensation_section(results: Results) -> DocumentSection:
    """The chapter of the page."""
    compensated, plan = results.compensated, results.demo.compensation
    design, chosen = compensated.design, compensated.chosen
    passive = design.front("passive")
    best = max((point.reduction for point in passive), default=0.0)
    text = [
        f"The motors of the {plan.branch} branch carry the weight and a share of the mass, by the identified essential "
        f"parameters; filters, share and damping are searched, {len(design.points)} points. A point is stable where "
        f"the sampled loop is with each of {len(design.hands)} hands, the corners of a published range and a free "
        f"handle; quiet where a hand gets no net energy from any motion on purpose, up to "
        f"{design.motion.bandwidth_hz:g} Hz, {design.motion.speed:g} m/s and {design.motion.acceleration:g} m/s^2, "
        f"while 70 % of the identified dry friction is on; and passive where no hand whatever gets energy. Passive "
        f"points reduce the mass by "
        f"{100 * best:.1f} % at most: passivity takes physical damping, and friction counts for none in it.",
    ]
    if chosen:
        law = chosen.law
        text.append(
            f"Chosen is the least damping that reduces the felt mass by {100 * plan.reduction:.0f} % and is stable and "
            f"quiet: share {law.share:g}, filters of {law.velocity_cutoff_hz:g} and {law.momentum_cutoff_hz:g} Hz, "
            f"damping {law.damping:.2f} N s/m. At {design.felt_hz:g} Hz the felt mass falls by "
            f"{100 * chosen.reduction:.0f} %, the felt damping rises by {chosen.added_damping:.2f} N s/m; "
            f"{chosen.missing_damping:.0f} N s/m lack for passivity."
        )
    else:
        text.append(f"No point reduces the felt mass by {100 * plan.reduction:.0f} % and is stable and quiet.")
    text.append(
        "Other laws of the same model, dry friction on: verdicts with the published hands at all angles, and what the "
        "bench measures at the middle one, moved by a guide and by the stiffest hand. Stability is judged linearly, "
        "without the dry friction that holds a handle still: friction compensation is judged by its slope at rest."
    )
    tables = (_felt_table(results), _frequency_table(results), _hands_table(results), _laws_table(results))
    return DocumentSection("law", "Mass compensation", tuple(text), tables, (_front_chart(results),))


def _ranged(impedance: HandleImpedance, name: str) -> str:
    """A felt figure with half the width of its 95 % interval."""
    k = impedance.quantities.names.index(name)
    low, high = impedance.quantities.conf_int()[k]
    return f"{impedance.quantities.values[k]:.3f} \u00b1 {(high - low) / 2:.3f}"


def _felt_table(results: Results) -> TextTable:
    compensated = results.compensated
    head = ["angle", "mass of the model"]
    rows = [[f"{a:g}", f"{m:.3f}"] for a, m in zip(compensated.degrees, compensated.estimated, strict=True)]
    for name in compensated.laws:
        head += [f"{name}: mass", "promised", "damping", "promised"]
        for row, impedances, (mass, damping) in zip(
            rows, compensated.felt[name], compensated.promised[name], strict=True
        ):
            row += [_ranged(impedances, "mass"), f"{mass:.3f}", _ranged(impedances, "damping"), f"{damping:.2f}"]
    return TextTable(f"Felt at {results.demo.compensation.felt_hz:g} Hz, kg and N s/m", [head, *rows])


def _frequency_table(results: Results) -> TextTable:
    cells = [["law", "Hz", "mass, kg", "damping, N s/m", "dry friction, N", "power to the hand, W"]]
    for name, curve in results.compensated.curves.items():
        figures = ("mass", "damping", "friction", "power")
        cells += [
            [name, f"{impedance.frequency_hz:g}", *(_ranged(impedance, quantity) for quantity in figures)]
            for impedance in curve
        ]
    return TextTable("Felt over frequency at the middle pose", cells)


def _hands_table(results: Results) -> TextTable:
    cells = [["hand", "law", "spectral radius", "power to the hand, W", "unrest, mm/s"]]
    cells += [
        [trial.hand, trial.law, f"{trial.predicted:.4f}", f"{trial.power:.4f}", f"{1e3 * trial.unrest:.2f}"]
        for trial in results.compensated.trials
    ]
    return TextTable("Hands that move the handle on the bench", cells)


def _laws_table(results: Results) -> TextTable:
    head = ["law", "stable", "quiet", "passive", "spectral radius, stiff hand", "mass, kg", "damping, N s/m"]
    cells = [[*head, "stiffness, N/m", "dry friction, N", "unrest in it, mm/s", "power to it, W", "tracking, mm"]]
    for one in results.others:
        verdicts = ("yes" if getattr(one.judged, name) else "no" for name in ("stable", "quiet", "passive"))
        felt = (_ranged(one.felt, name) for name in ("mass", "damping", "stiffness", "friction"))
        held = f"{1e3 * one.stiff.unrest:.2f}", f"{one.stiff.power:.4f}"
        tracking = "" if one.tracking is None else f"{1e3 * one.tracking:.3f}"
        cells.append([one.name, *verdicts, f"{one.stiff.predicted:.4f}", *felt, *held, tracking])
    return TextTable("Weight and friction compensation, and inverse-dynamics control", cells)


def _front_chart(results: Results) -> Chart:
    """All points, and the front of those that a hand can hold."""
    design, chosen = results.compensated.design, results.compensated.chosen
    curves = []
    kinds = {"quiet alone": "sky", "stable alone": "orange", "stable and quiet": "blue", "passive": "green"}
    for name, colour in kinds.items():
        points = [point for point in design.points if point.reduction < 1 and _kind(point) == name]
        x, y = (packed([getattr(point, key) for point in points]) for key in ("reduction", "added_damping"))
        curves.append(chart_series(name, "points", colour, x=x, y=y))
    front = design.front("stable", "quiet")
    x, y = (packed([getattr(point, key) for point in front]) for key in ("reduction", "added_damping"))
    curves.append(chart_series("front", "line", "blue", x=x, y=y))
    if chosen:
        curves.append(
            chart_series(
                "chosen", "points", "vermillion", x=packed([chosen.reduction]), y=packed([chosen.added_damping])
            )
        )
    drawing = plot(axis("reduction of the felt mass"), axis("added damping", "N s/m", zero=True), curves, height=260)
    caption = f"{len(front)} points on the front of {len(design.points)}; felt at {design.felt_hz:g} Hz."
    alt = "Added damping against the reduction of the felt mass, by verdict."
    return Chart("compensation", "Felt mass against added damping", alt, caption, drawing)


def _kind(point: DesignPoint) -> str:
    if point.passive:
        return "passive"
    held = {(True, True): "stable and quiet", (True, False): "stable alone", (False, True): "quiet alone"}
    return held.get((point.stable, point.quiet), "")
