"""The report of a demonstration, chapter by chapter, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid.demos.mountings.columns import cells2, ours, published_columns, table1, table2, truth
from haptid.demos.mountings.figures import FIRST_OF_PARTS, per_command
from haptid.demos.mountings.finding import Results
from haptid.demos.mountings.fits import Accuracy, accuracy
from haptid.demos.mountings.judged import Judged
from haptid.demos.report import claims
from haptid.demos.tables import markdown
from haptid.end_effector.torque_decomposition import RIGID, decompose_torque

VISCOUS = "viscous"


def chapters(found: Results) -> Iterator[str]:
    """All lines of the report."""
    for chapter in (_head, _parameters, _errors, _late, _accuracy, _models, _torques, _hand, _compared):
        yield from chapter(found)
    yield from claims(found.demo)


def _head(found: Results) -> Iterator[str]:
    demo, stretch = found.demo, found.demo.stretch
    yield f"# {demo.title}"
    yield ""
    yield f"Source: {demo.source}."
    yield ""
    yield (
        f"{found.model.device.name} on the virtual bench, {len(found.fits)} mountings, one log of each with encoders and one "
        f"with exact sensors. {stretch.start:g} s to {stretch.middle:g} s identify, {stretch.middle:g} s to "
        f"{stretch.stop:g} s validate. The experiments are beside the logs; each can be run by itself with "
        f"`haptid bench`. What is published was measured on a real device, whose true parameters nobody "
        f"knows; ours are of a simulated one, whose parameters are known. Figures are compared, not "
        f"devices."
    )
    yield ""
    gains = ", ".join(f"{scale:g}" for scale in dict.fromkeys(per_command(found.model).round(6).tolist()))
    yield f"One N m at the joint is {gains} units of command. Tables are in units of command, as published."
    yield ""


def _parameters(found: Results) -> Iterator[str]:
    yield "## Parameters (Table I)"
    yield ""
    for title, columns in (
        ("Published", published_columns(found)),
        ("Found from encoders, with the proposed treatment", ours(found, "encoders")),
        ("Found with exact velocities, in the paper's way: momenta through L(s)", ours(found, "exact")),
        ("Found without friction in the model, in the paper's way", ours(found, "frictionless")),
        ("True on the bench", truth(found)),
    ):
        yield from (f"{title}:", "", *markdown(table1(found, columns)), "")
    variances = np.concatenate([np.diag(fits["exact"].command.classical_covariance) for fits in found.fits.values()])
    honest = np.concatenate([np.diag(fits["exact"].command.covariance) for fits in found.fits.values()])
    yield (
        f"Published variances are between 1e-9 and 1e-6. Ours with exact velocities, as if residuals were white, are "
        f"between {variances.min():.0e} and {variances.max():.0e}; with the residuals as they are, between "
        f"{honest.min():.0e} and {honest.max():.0e}. In SI, and with intervals: table1.txt, table1.csv."
    )
    yield ""


def _errors(found: Results) -> Iterator[str]:
    yield "## Torque on the unseen half (Table II)"
    yield ""
    yield (
        "100 norm(measured - predicted) / norm(measured) of the treated torque, by motor. At a reversal a joint sticks "
        "for some milliseconds, and its friction is anything between both Coulomb values: no model with a sign "
        "function predicts that. So rows whose filter sees a reversal are left out, and the same errors on all rows "
        "are given too."
    )
    yield ""
    shown = ("Published", "Exact velocity", "Encoders", "The same, held")
    for title, columns in table2(found).items():
        if title.startswith(shown) and "late" not in title:
            yield from (f"{title}, per cent:", "", *markdown(cells2(found, columns)), "")
    worst, total = 0, 0
    for key, fits in found.fits.items():
        limit = found.demo.errors.column(key)
        worst += int((np.array(fits["exact"].relative) <= limit).sum())
        total += len(limit)
    yield (
        f"With exact velocities, {worst} of {total} errors on rows clear of reversals are at or below the published "
        f"ones. Figures 3 and 5 show the torque without and with friction in the model, figure 4 what friction leaves "
        f"when it is not in the model: two clusters, by the sign of the velocity. Figure 6 is the friction found."
    )
    yield ""
    for name in ("fig03.png", "fig04.png", "fig05.png", "fig06.png"):
        yield from (f"![]({name})", "")


def _late(found: Results) -> Iterator[str]:
    yield "## What the published velocity costs"
    yield ""
    yield (
        "The paper makes velocities by a high-pass, which is late. A velocity that is late turns inertia into apparent "
        "negative friction. From the logs with encoders, momenta through L(s), viscous friction in thousandths of the "
        "command's unit:"
    )
    yield ""
    keys = [key for key in next(iter(found.fits.values())).by if key.startswith("late")]
    titles = {"encoders": "without delay", **{key: f"velocity {key}" for key in keys}}
    cells = [["mounting", "true", *titles.values(), "error on unseen rows, %"]]
    for key, fits in found.fits.items():
        near = accuracy(fits["encoders"].targets, fits.encoders, found.demo.stretch.unseen)
        damping = np.flatnonzero(near.kinds == VISCOUS)
        true = fits["encoders"].command.C @ fits.encoders.beta
        row = [found.demo.mounting(key).title, _list(1e3 * true[damping])]
        row += [_list(1e3 * fits[name].command.value[damping]) for name in titles]
        errors = [f"{fits[name].validation.relative:.1f}" for name in titles]
        cells.append([*row, " / ".join(errors)])
    yield from (*markdown(cells), "")
    published = found.demo.parameters
    rows = _viscous(found)
    negative = sum(published.figures.get((row, key), 0.0) < 0 for row in rows for key in found.fits)
    yield (
        f"Of {len(rows) * len(found.fits)} published viscous coefficients {negative} are negative, which no passive "
        f"joint can have. Lag makes such signs; it is a cause that suffices, not one that is proven."
    )
    yield ""


def _viscous(found: Results) -> list[str]:
    fits = next(iter(found.fits.values()))
    near = accuracy(fits["encoders"].targets, fits.encoders, found.demo.stretch.unseen)
    return [name for name, kind in zip(near.names, near.kinds, strict=True) if kind == VISCOUS]


def _list(figures: np.ndarray) -> str:
    return ", ".join(f"{x:.1f}" for x in figures)


def _accuracy(found: Results) -> Iterator[str]:
    yield "## Against the truth"
    yield ""
    yield (
        "Errors in per cent: of the exact torque on the unseen half where no joint sticks, worst motor; of inertial "
        "and gravity parameters that carry 2 % of a motor's torque; of Coulomb and viscous friction. Then how many of "
        "the parameters are inside their 95 % interval."
    )
    yield ""
    cells = [["mounting", "data", "torque", "parameters", "Coulomb", "viscous", "inside"]]
    for key, fits in found.fits.items():
        for name, log in (("exact", fits.exact), ("encoders", fits.encoders)):
            near = accuracy(fits[name].targets, log, found.demo.stretch.unseen)
            cells.append([found.demo.mounting(key).title, fits[name].title, *_near(near)])
    yield from (*markdown(cells), "")
    for fits in list(found.fits.values())[:1]:
        yield f"Treatment of the logs with encoders, mounting {fits.mounting.title}:"
        yield ""
        yield from (f"- {reason}" for reason in fits.proposal.reasons)
        yield ""


def _near(near: Accuracy) -> list[str]:
    worst = (f"{near.worst(kind):.2f}" for kind in ("body", "Coulomb", VISCOUS))
    return [f"{near.torque.max():.3f}", *worst, f"{int(near.inside.sum())} of {len(near.inside)}"]


def _models(found: Results) -> Iterator[str]:
    demo = found.demo
    yield "## Positive definite, and possible"
    yield ""
    yield "Least eigenvalue of the mass matrix, units of command; the share of poses where it is not positive definite:"
    yield ""
    yield from (f"- {place.name}: {place.title}" for place in demo.workspaces)
    yield ""
    cells = [["parameters", *(place.name for place in demo.workspaces), "real bodies can have them"]]
    scale = float(per_command(found.model).max())
    for name, judged in found.published.items():
        title = demo.bodies if name == demo.parameters.columns[0] else f"published, {demo.mounting(name).title}"
        cells.append([title, *_judged(judged, scale)])
    for (_, fit), judged in found.judged.items():
        cells.append([f"{judged.title}, {'held' if fit == 'held' else 'free'}", *_judged(judged, scale)])
    yield from (*markdown(cells), "")
    yield (
        "Column [1] follows from measured bodies, so it is possible. No identified column that is published is; in "
        "each the mass matrix is not positive definite where the arm is raised. Why each is not possible:"
    )
    yield ""
    for name, judged in found.published.items():
        if not judged.possible.ok:
            yield f"- {demo.mounting(name).title}: {'; '.join(judged.possible.failing)}"
    yield ""
    more = max(fits["held"].validation.relative - fits["encoders"].validation.relative for fits in found.fits.values())
    yield (
        f"Estimates that are held to what bodies can have are all possible, and predict the unseen half at most "
        f"{more:.3f} points worse than free ones: with a good treatment the free ones are possible already."
    )
    yield ""


def _judged(judged: Judged, scale: float) -> list[str]:
    places = zip(judged.eigenvalues(scale), judged.definite, strict=True)
    cells = [f"{least:.2e}" + (f" ({100 * d.share:.1f} %)" if d.share else "") for least, d in places]
    return [*cells, "yes" if judged.possible.ok else "no"]


def _torques(found: Results) -> Iterator[str]:
    yield "## What the torque is made of (figures 7 to 11)"
    yield ""
    yield (
        "Root mean square of each part, per cent of that of the whole, on the unseen half; parts may oppose each "
        "other, so they need not add up."
    )
    yield ""
    cells = [["mounting", "motor", "inertia", "Coriolis and centrifugal", "gravity", "friction"]]
    for key, fits in found.fits.items():
        made = decompose_torque(fits["exact"].estimate, fits["exact"].unseen)
        whole = np.sqrt((made.total**2).mean(axis=1))
        parts = [*(made[part] for part in RIGID), made.friction]
        for k, motor in enumerate(made.motors):
            shares = [f"{100 * np.sqrt((part[k] ** 2).mean()) / whole[k]:.0f}" for part in parts]
            cells.append([found.demo.mounting(key).title, motor, *shares])
    yield from (*markdown(cells), "")
    for k in range(len(found.fits)):
        yield from (f"![](fig{FIRST_OF_PARTS + k:02d}.png)", "")


def _hand(found: Results) -> Iterator[str]:
    errors, last = found.felt.errors, FIRST_OF_PARTS + len(found.fits)
    model, observer = errors["with the model"], errors["observer"]
    through = errors["with the model, through the observer's low-pass"]
    yield f"## The force of the hand (figure {last})"
    yield ""
    yield (
        f"Mounting {found.demo.mounting(found.demo.hand.mounting).title}; the joints turn back several times. The "
        f"force is {errors['force']:.2f} N, root mean square. Without the dynamic model it is estimated with an error "
        f"of {errors['without the model']:.3f} N, with it of {model:.4f} N: {errors['without the model'] / model:.0f} "
        f"times better. The exact force is inside the 95 % interval in {100 * found.felt.inside:.0f} % of the rows and "
        f"components. The momentum observer, causal and without accelerations, is off by {observer:.4f} N at its own "
        f"bandwidth; the estimate with the model, through the same low-pass, by {through:.4f} N."
    )
    yield from ("", f"![](fig{last:02d}.png)", "")


def _compared(found: Results) -> Iterator[str]:
    demo = found.demo
    yield "## Mountings compared"
    yield ""
    for pair, made in found.comparisons:
        yield f"{demo.mounting(pair.first).title} against {demo.mounting(pair.second).title}, encoders:"
        yield ""
        yield from (f"- {sentence}" for sentence in made.sentences)
        yield ""
    yield "What the tool at the handle is, from the log before and the log after:"
    yield ""
    for name, value, (low, high) in zip(found.tool.names, found.tool.value, found.tool.conf_int(), strict=True):
        if name in found.tool_truth:
            yield f"- {name}: {value:.5g}, 95 % interval {low:.5g} .. {high:.5g}; true {found.tool_truth[name]:.5g}"
    yield ""
