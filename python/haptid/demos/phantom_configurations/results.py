"""Results of the mountings: fits, definiteness and physical consistency, comparisons, hand force and tool."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.flaws import FlawedDevice, figures, range_sentence
from haptid.demos.phantom_configurations.fits import Fit, Fits, fit_all, fitted
from haptid.demos.phantom_configurations.hand import HandForces, hand_forces
from haptid.demos.phantom_configurations.plan import Pair, PhantomDemo
from haptid.demos.plan import Progress
from haptid.demos.recordings import BenchRecording, Take, read_recording
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.definiteness import Definiteness, definiteness
from haptid.estimation import Estimate, FeasibleParameters, feasible_parameters
from haptid.experiment.bench.experiment import read_experiment
from haptid.inference.comparison import Comparison, compare
from haptid.inference.payloads import AttachedBody, PayloadEstimate, identify_payloads
from haptid.inference.targets import Targets, target_map
from haptid.treatment_choice.propose import propose

# Fits whose mass matrix and bodies are evaluated.
EVALUATED = ("encoders", "held")
_EXACT = "-exact"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One set of base parameters, published or identified.

    Attributes:
        definite: definiteness of the mass matrix by workspace, in the plan's order.
        feasible: whether real bodies and passive terms can have the parameters.
    """

    definite: tuple[Definiteness, ...]
    feasible: FeasibleParameters


@dataclass(frozen=True, eq=False)
class Results:
    """All results of the demonstration.

    Attributes:
        demo: the plan.
        model: with the gravity of its file.
        fits: by mounting.
        published: evaluation of the published parameters, by column.
        evaluated: evaluation of ours, by mounting and fit.
        comparisons: of pairs of mountings.
        hand: the hand's force.
        tool: parameters added to the handle's link by the tool.
        tool_truth: its true mass and first moments in the link frame, by name, kg and kg m.
        flawed: the first mounting with the flaws of a real device; None where the plan has no such logs.
    """

    demo: PhantomDemo
    model: DynamicModel
    fits: Mapping[str, Fits]
    published: Mapping[str, Evaluation]
    evaluated: Mapping[tuple[str, str], Evaluation]
    comparisons: tuple[tuple[Pair, Comparison], ...]
    hand: HandForces
    tool: PayloadEstimate
    tool_truth: Mapping[str, float]
    flawed: FlawedDevice | None = None


def takes(demo: PhantomDemo, logs: Path) -> list[Take]:
    """Every mounting with encoders and with exact sensors, and the logs with a tool and with a hand."""
    mounted = [demo.take(key, logs, *way) for key in demo.mountings for way in (("", False), (_EXACT, True))]
    flawed = [demo.take(demo.flawed.fit, logs)] if demo.flawed else []
    return [*flawed, *mounted, demo.take(demo.tool.experiment, logs), demo.take(demo.hand.experiment, logs)]


def find(demo: PhantomDemo, logs: Path, progress: Progress) -> Results:
    """All results from the logs."""
    model = DynamicModel(read_device(demo.device))

    def recording(key: str, ending: str = "") -> BenchRecording:
        return read_recording(model, logs / f"{key}.toml", logs / f"{key}{ending}.parquet")

    fits = {}
    for k, key in enumerate(demo.mountings):
        progress("identifying", k / len(demo.mountings))
        fits[key] = fit_all(demo, key, recording(key, _EXACT), recording(key))
    progress("identifying", 1.0)
    published, evaluated = evaluate_all(demo, model, fits, progress)
    first = next(iter(fits.values()))
    return Results(
        demo=demo,
        model=model,
        fits=fits,
        published=published,
        evaluated=evaluated,
        comparisons=tuple(
            (pair, compare(fits[pair.first]["encoders"].command, fits[pair.second]["encoders"].command))
            for pair in demo.comparisons
        ),
        hand=hand_forces(demo.hand, fits[demo.hand.mounting]["encoders"], recording(demo.hand.experiment)),
        tool=tool_found(demo, fits[demo.tool.mounting], recording(demo.tool.experiment)),
        tool_truth=tool_truth(model, logs / f"{demo.tool.experiment}.toml"),
        flawed=flawed(demo, first["encoders"], first.encoders, recording(demo.flawed.fit)) if demo.flawed else None,
    )


def flawed(demo: PhantomDemo, ours: Fit, ideal: BenchRecording, recording: BenchRecording) -> FlawedDevice:
    """The first mounting from its log with flaws, with the treatment proposed for that log.

    Args:
        ours: the fit to the log without flaws.
        ideal: that log.
        recording: with flaws.
    """
    halves = (demo.stretch.fit, demo.stretch.unseen)
    treatment = propose(recording.model, recording.log(halves[0])).treatment
    fit = fitted("with flaws", recording.model, [recording.motion(half, treatment) for half in halves])
    return FlawedDevice(
        f"Mounting {next(iter(demo.mountings.values()))}",
        figures(ours.targets, ours.unseen, ideal, halves[1]),
        figures(fit.targets, fit.unseen, recording, halves[1]),
        range_sentence(fit.estimate),
    )


def tool_found(demo: PhantomDemo, without: Fits, recording: BenchRecording) -> PayloadEstimate:
    """Parameters that the tool adds to the handle's link, from the mounting without it and a log with it."""
    model, treatment = without.model, without.proposal.treatment
    assert model.device.handle is not None
    halves = [recording.motion(half, treatment) for half in (demo.stretch.fit, demo.stretch.unseen)]
    tool = AttachedBody("tool", model.device.joint_names[model.device.handle.link])
    return identify_payloads(model, without["encoders"].estimate.observation.motions, [(tool, halves)])["tool"]


def tool_truth(model: DynamicModel, experiment: Path) -> dict[str, float]:
    """Mass and first moments of the tool in the frame of the handle's link, by name, kg and kg m."""
    payload, handle = read_experiment(experiment).setup(model).payload, model.device.handle
    assert payload is not None
    assert handle is not None
    joint = model.device.joints[handle.link]
    com = handle.translation + handle.rotation @ payload.com
    moments = payload.mass * joint.frame_rotation.T @ (com - joint.frame_translation)
    named = {f"{kind}{joint.name}": float(x) for kind, x in zip(("MX", "MY", "MZ"), moments, strict=True)}
    return {f"M{joint.name}": payload.mass, **named}


def evaluate_all(
    demo: PhantomDemo, model: DynamicModel, fits: Mapping[str, Fits], progress: Progress
) -> tuple[dict[str, Evaluation], dict[tuple[str, str], Evaluation]]:
    """Evaluation of the published columns, and of our fits by mounting."""
    like = next(iter(fits.values()))["encoders"].targets
    named = (demo.parameters.columns[0], *fits)
    count = len(named) + len(EVALUATED) * len(fits)
    published, ours = dict[str, Evaluation](), dict[tuple[str, str], Evaluation]()
    for name in named:
        progress("evaluating", len(published) / count)
        published[name] = evaluate(demo, model, published_beta(demo, like, name))
    for key, made in fits.items():
        for fit in EVALUATED:
            progress("evaluating", (len(published) + len(ours)) / count)
            ours[key, fit] = evaluate(demo, model, made[fit].estimate)
    progress("evaluating", 1.0)
    return published, ours


def evaluate(demo: PhantomDemo, model: DynamicModel, parameters: Estimate | Array) -> Evaluation:
    """Definiteness of the mass matrix over all workspaces, and physical consistency."""
    beta = parameters.beta if isinstance(parameters, Estimate) else parameters
    definite = tuple(definiteness(parameters, place.of(model)) for place in demo.workspaces)
    return Evaluation(definite, feasible_parameters(model, beta))


def published_beta(demo: PhantomDemo, like: Targets, column: str) -> Array:
    """Base parameters of a published column, in SI, missing ones taken as zero, (p,).

    Args:
        demo: the plan.
        like: targets of any estimate of the device, for the units of command.
        column: of the table of parameters.
    """
    per_command = np.linalg.norm(like.in_command().C, axis=1) / np.linalg.norm(like.C, axis=1)
    values = np.nan_to_num(demo.parameters.column(column)) / per_command
    return np.asarray(np.linalg.solve(target_map(like.estimate.model), values))
