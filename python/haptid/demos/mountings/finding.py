"""What is recorded of a device in several mountings, and everything that is found: fits, judgements, comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from haptid.demos.kind import Tell
from haptid.demos.mountings.fits import Fits, fit_all, fitted
from haptid.demos.mountings.hand import Felt, feel
from haptid.demos.mountings.judged import Judged, judge, published
from haptid.demos.mountings.plan import Mountings, Pair
from haptid.demos.recordings import Recorded, Take, read_recorded
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.experiment import read_experiment
from haptid.inference.comparison import Comparison, compare
from haptid.inference.payload_estimate import PayloadEstimate, estimate_payload

# Fits whose mass matrix and bodies are judged.
JUDGED = ("encoders", "held")
EXACT = "-exact"


@dataclass(frozen=True, eq=False)
class Results:
    """All that a demonstration finds.

    Attributes:
        demo: what was asked.
        model: as in its file.
        fits: by mounting.
        published, judged: what becomes of the published parameters by column, and of ours by mounting and fit.
        comparisons: of mountings, with the pair that was asked for.
        felt: the hand's force.
        tool: what was added to the handle's link.
        tool_truth: its true mass and first moments in the link frame, by name, kg and kg m.
    """

    demo: Mountings
    model: DynamicModel
    fits: Mapping[str, Fits]
    published: Mapping[str, Judged]
    judged: Mapping[tuple[str, str], Judged]
    comparisons: tuple[tuple[Pair, Comparison], ...]
    felt: Felt
    tool: PayloadEstimate
    tool_truth: Mapping[str, float]


def takes(demo: Mountings, logs: Path) -> list[Take]:
    """Every mounting with encoders and with exact sensors, and the logs with a tool and with a hand."""
    made = []
    for mounting in demo.mountings:
        for ending, exact in (("", False), (EXACT, True)):
            out = logs / f"{mounting.key}{ending}.parquet"
            made.append(Take(demo.device, demo.folder / mounting.experiment, out, exact))
    made += [
        Take(demo.device, demo.folder / name, logs / Path(name).with_suffix(".parquet").name)
        for name in (demo.tool.experiment, demo.hand.experiment)
    ]
    return made


def find(demo: Mountings, logs: Path, tell: Tell) -> Results:
    """Everything from the logs."""
    model = DynamicModel(read_device(demo.device))
    fits = {}
    for k, mounting in enumerate(demo.mountings):
        tell("identifying", k / len(demo.mountings))
        exact, encoders = (
            read_recorded(model, demo.folder / mounting.experiment, logs / f"{mounting.key}{ending}.parquet")
            for ending in (EXACT, "")
        )
        fits[mounting.key] = fit_all(demo, mounting, exact, encoders)
    tell("identifying", 1.0)
    columns, ours = _judged(demo, model, fits, tell)
    pushed = _beside(demo, model, demo.hand.experiment, logs)
    return Results(
        demo=demo,
        model=model,
        fits=fits,
        published=columns,
        judged=ours,
        comparisons=tuple(
            (pair, compare(fits[pair.first]["encoders"].command, fits[pair.second]["encoders"].command))
            for pair in demo.comparisons
        ),
        felt=feel(demo.hand, fits[demo.hand.mounting]["encoders"], pushed),
        tool=tool_found(demo, fits[demo.tool.mounting], _beside(demo, model, demo.tool.experiment, logs)),
        tool_truth=tool_truth(demo, model),
    )


def tool_found(demo: Mountings, without: Fits, recorded: Recorded) -> PayloadEstimate:
    """What the tool adds to the handle's link, from the mounting without it and a log with it."""
    model, treatment = without.model, without.proposal.treatment
    assert model.device.handle is not None
    first, second = (recorded.motion(half, treatment) for half in (demo.stretch.fit, demo.stretch.unseen))
    fit = fitted("with the tool", model, first, second)
    return estimate_payload(
        without["encoders"].estimate, fit.estimate, model.device.joint_names[model.device.handle.link]
    )


def tool_truth(demo: Mountings, model: DynamicModel) -> dict[str, float]:
    """Mass and first moments of the tool in the frame of the handle's link, by name, kg and kg m."""
    payload = read_experiment(demo.folder / demo.tool.experiment).setup(model).payload
    assert payload is not None
    assert model.device.handle is not None
    joint = model.device.joints[model.device.handle.link]
    com = model.device.handle.translation + model.device.handle.rotation @ payload.com
    x, y, z = payload.mass * joint.frame_rotation.T @ (com - joint.frame_translation)
    return {f"M{joint.name}": payload.mass} | {
        f"{kind}{joint.name}": float(moment) for kind, moment in zip(("MX", "MY", "MZ"), (x, y, z), strict=True)
    }


def _beside(demo: Mountings, model: DynamicModel, experiment: str, logs: Path) -> Recorded:
    """The log of an experiment that is no mounting of its own."""
    return read_recorded(model, demo.folder / experiment, logs / Path(experiment).with_suffix(".parquet").name)


def _judged(
    demo: Mountings, model: DynamicModel, fits: Mapping[str, Fits], tell: Tell
) -> tuple[dict[str, Judged], dict[tuple[str, str], Judged]]:
    """What becomes of published parameters and of ours."""
    like = next(iter(fits.values()))["encoders"].targets
    named = (demo.parameters.columns[0], *fits)
    many = len(named) + len(JUDGED) * len(fits)
    columns, ours = dict[str, Judged](), dict[tuple[str, str], Judged]()
    for name in named:
        tell("judging", len(columns) / many)
        columns[name] = judge(name, published(demo, like, name), model, demo.workspaces)
    for key, made in fits.items():
        for fit in JUDGED:
            tell("judging", (len(columns) + len(ours)) / many)
            ours[key, fit] = judge(made.mounting.title, made[fit].estimate, model, demo.workspaces)
    tell("judging", 1.0)
    return columns, ours
