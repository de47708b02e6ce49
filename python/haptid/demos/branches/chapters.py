"""The report on the branches of a device, chapter by chapter, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid.demos.branches.columns import friction, parameters, posture, sweeps
from haptid.demos.branches.finding import Results
from haptid.demos.branches.fits import Identified
from haptid.demos.branches.said import alike, disagreements, homogeneity, published_deviations, statements
from haptid.demos.report import claims
from haptid.demos.tables import markdown
from haptid.inference.elimination import Drop
from haptid.validation.validation import Validation

# A reduction is told from its beginning and its end: so many steps each.
STEPS_TOLD = 3


def chapters(found: Results) -> Iterator[str]:
    """All lines of the report."""
    for chapter in (_head, _friction, _identified, _reduction, _parameters, _sweeps, _posture, _compensated):
        yield from chapter(found)
    yield from claims(found.demo)


def _head(found: Results) -> Iterator[str]:
    demo = found.demo
    yield f"# {demo.title}"
    yield ""
    yield f"Source: {demo.source}."
    yield ""
    yield (
        f"{found.model.device.name}, on the virtual bench with encoders and noise. Of each branch there are three logs: a "
        f"friction test, the motion that identifies, and another that it is compared on. The experiments are beside "
        f"the logs; each can be run by itself with `haptid bench`. What is true there are the published identified "
        f"values, and zero where the paper reports none. What is published was measured on a real device, whose true "
        f"parameters nobody knows. Figures are compared, not devices."
    )
    yield ""


def _friction(found: Results) -> Iterator[str]:
    yield "## Friction test"
    yield ""
    yield "Each joint in turn, to and fro at constant velocities; models are compared by AIC for small samples."
    yield ""
    for key, test in found.friction.items():
        for joint in test.choice.joints:
            yield f"- {found.found[key].branch.title} branch, {joint.sentence}"
    yield ""
    yield from (*markdown(friction(found)), "", "![](friction.png)", "")


def _identified(found: Results) -> Iterator[str]:
    yield "## Identification"
    yield ""
    for one in found.found.values():
        yield from _fit(one)
    yield "Relative errors, 100 norm(measured - predicted) / norm(measured) of the treated torque, per cent:"
    yield ""
    motors = [motor.label for motor in next(iter(found.found.values())).cross.motors]
    cells = [["branch", "comparison", *motors, "all"]]
    for one in found.found.values():
        cells.append([one.branch.title, "direct, rows of the fit", *_errors(one.direct)])
        cells.append([one.branch.title, "cross test, unseen motion", *_errors(one.cross)])
    yield from (*markdown(cells), "")
    yield from (f"![]({drawn.file})\n" for drawn in found.demo.drawn)


def _fit(one: Identified) -> Iterator[str]:
    every, used = one.every, one.full.observation
    yield (
        f"{one.branch.title} branch: W is {every.rows} x {len(one.full.beta)}, of which {used.rows} rows are clear of "
        f"reversals. Condition number of all rows: {every.condition[0]:.0f} raw, {every.condition[1]:.0f} with unit "
        f"columns; of the {len(one.table.rows)} published columns {one.condition_of_published[0]:.0f} and "
        f"{one.condition_of_published[1]:.1f}. The treatment:"
    )
    yield ""
    yield from (f"- {reason}" for reason in one.proposal.reasons)
    yield ""


def _errors(validation: Validation) -> list[str]:
    return [*(f"{motor.relative:.2f}" for motor in validation.motors), f"{validation.relative:.2f}"]


def _reduction(found: Results) -> Iterator[str]:
    yield "## Essential parameters"
    yield ""
    yield (
        "One by one, the parameter of the largest relative deviation is left out, until the largest is within ten "
        "times the smallest, or an F-test against the full model objects."
    )
    yield ""
    for one in found.found.values():
        reduction, names = one.reduction, one.reduction.essential
        moved = np.nanmax(np.abs(reduction.shift))
        assert reduction.unseen is not None
        yield (
            f"{one.branch.title} branch: {len(one.full.kept)} parameters, {len(names)} essential: {', '.join(names)}. "
            f"{reduction.reason} Leaving out the others moves none of these by more than {moved:.1f} of its own "
            f"deviations of before; the error on unseen motion goes from {reduction.unseen[0].relative:.3f} % to "
            f"{reduction.unseen[1].relative:.3f} %."
        )
        yield ""
        yield from (f"- {step}" for step in _steps(reduction.drops))
        yield from (f"- {sentence}" for sentence in differences(one))
        for made in one.by_motor:
            label = made.full.observation.motors[0].label
            names = made.essential
            yield f"- {label} by itself, {len(made.full.kept)} told by its rows: {', '.join(names)}."
        yield ""


def _steps(drops: tuple[Drop, ...]) -> Iterator[str]:
    """The first and the last parameters left out."""
    for k, drop in enumerate(drops):
        if k < STEPS_TOLD or k >= len(drops) - STEPS_TOLD:
            yield (
                f"step {k + 1}: without {drop.name}, whose relative deviation is {drop.relative_se:.0f} %; p of all "
                f"left out so far {drop.test.p:.2f}"
            )


def differences(one: Identified) -> Iterator[str]:
    """Why what is kept is not what is published, a sentence for each parameter."""
    if not (one.missing or one.more):
        yield f"These are the {len(one.table.rows)} that are published."
    for name in one.missing:
        (drop,) = [drop for drop in one.reduction.drops if drop.name == name]
        yield (
            f"{name} is published and left out here: its relative deviation was {drop.relative_se:.3g} %, its value "
            f"{one.full[name].value:.2g} {one.full[name].unit}."
        )
    for name in one.more:
        p = one.reduced[name]
        yield (
            f"{name} is kept here and not published: it is {p.value:.2g} {p.unit} with a relative deviation of "
            f"{p.relative_se:.3g} %; its true value is {one.true(name):.2g}."
        )


def _parameters(found: Results) -> Iterator[str]:
    yield "## Parameters (tables 1 and 2)"
    yield ""
    yield (
        "± is 100 sd / |value|. Published deviations take residuals as white; ours do not. CAD values of friction are "
        "those of the published friction test."
    )
    yield ""
    for one in found.found.values():
        inside = sum(one.inside(name) for name in one.reduction.essential)
        yield from (f"{one.branch.title} branch:", "", *markdown(parameters(one)), "")
        yield f"{inside} of {len(one.reduction.essential)} intervals hold the truth. {published_deviations(one)}"
        yield ""


def _sweeps(found: Results) -> Iterator[str]:
    yield "## What the hand feels (figure 7)"
    yield ""
    yield from (f"- {sweep.label.split(',')[0]}: {sweep.title}." for sweep in found.demo.sweeps)
    yield ""
    yield from (*markdown(sweeps(found)), "", "![](fig07.png)", "")
    for sentence in (*statements(found), *disagreements(found), *homogeneity(found), *alike(found)):
        yield f"- {sentence}"
    yield ""


def _posture(found: Results) -> Iterator[str]:
    plan = found.demo.posture
    pose = ", ".join(f"q{name} = {angle:g}" for name, angle in plan.degrees.items())
    limits = ", ".join(f"{limit:g}" for limit in plan.limits.values())
    stiffness = ", ".join(f"{k:g}" for k in plan.stiffness.values())
    yield "## At a posture"
    yield ""
    yield (
        f"{pose} degrees. 95 % intervals in brackets. Viscous friction is from all parameters, as none of it is "
        f"essential. Stiffness is of motors that hold with {stiffness} N m/rad, peak force of motors with "
        f"{limits} N m; both are assumed, and stiffness follows from them and the geometry alone."
    )
    yield from ("", *markdown(posture(found)), "")
    yield (
        "Coulomb friction is the force for slow motion along an axis, by the signs of the joints' velocities. As "
        "printed in eq. (18) it has the signs of the handle's: it is right only where both agree. The neglected force "
        "has the weight in it, as in the paper."
    )
    yield ""


def _compensated(found: Results) -> Iterator[str]:
    made, asked = found.compensated, found.demo.compensation
    yield "## Taking mass off the hand"
    yield ""
    yield (
        f"The published conclusion asks for a law of control. Motors carry {100 * asked.share:.0f} % of the mass and "
        f"all of the weight, from the essential parameters that were found. On the bench a hand shakes the handle of "
        f"the {found.found[asked.branch].branch.title.lower()} branch at {asked.shaken_hz:g} Hz along its largest "
        f"mass. Friction is off in this trial, so that what the hand feels is mass alone. kg:"
    )
    yield ""
    cells = [["angle", "model", "felt, weight carried", "felt, with the law", "promised", "felt, towards one mass"]]
    felt = (made.estimated, made.before, made.after, made.promised, made.even)
    for angle, *masses in zip(made.degrees, *felt, strict=True):
        cells.append([f"{angle:g}", *(f"{mass:.3f}" for mass in masses)])
    yield from (*markdown(cells), "")
    before, after = np.ptp(made.before), np.ptp(made.after)
    ratios = [mass.max() / mass.min() for mass in (made.before, made.after, made.even)]
    yield (
        f"The felt mass varies by {before:.3f} kg without the law and {after:.3f} kg with it: it falls with the mass. "
        f"The ratio of greatest to least does not: it is {ratios[0]:.2f} without and {ratios[1]:.2f} with the law. A "
        f"share that depends on the pose, towards {made.target:.3f} kg everywhere and {100 * asked.share:.0f} % at the "
        f"most, brings it to {ratios[2]:.2f}. With a hand that holds the handle by {asked.hand_stiffness:g} N/m "
        f"and {asked.hand_damping:g} N s/m, and all lags of the law as one of {1e3 * made.lag:.1f} ms, the loop is "
        f"stable below a share of {made.bound:.2f}, pose by pose."
    )
    yield from ("", "![](compensation.png)", "")
