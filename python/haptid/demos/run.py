"""Walking a demonstration: record all mountings, identify, judge, compare, and write it down."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from haptid.added import Addition, addition
from haptid.bench.experiment import read_experiment
from haptid.bench.simulation import load_mujoco
from haptid.comparison import Comparison, compare
from haptid.demos.fits import Fits, fit_all, fitted
from haptid.demos.hand import Felt, feel
from haptid.demos.judged import Judged, judge, published
from haptid.demos.plan import Demo, Pair
from haptid.demos.recordings import Recorded, Take, read_recorded, record_all
from haptid.device import Device, read_device

Tell = Callable[[str, float], None]
# Fits whose mass matrix and bodies are judged.
JUDGED = ("encoders", "held")
EXACT = "-exact"


@dataclass(frozen=True, eq=False)
class Results:
    """All that a demonstration finds.

    Attributes:
        demo: what was asked.
        device: as in its file.
        fits: by mounting.
        published, judged: what becomes of the published parameters by column, and of ours by mounting and fit.
        comparisons: of mountings, with the pair that was asked for.
        felt: the hand's force.
        tool: what was added to the handle's link.
        tool_truth: its true mass and first moments in the link frame, by name, kg and kg m.
    """

    demo: Demo
    device: Device
    fits: Mapping[str, Fits]
    published: Mapping[str, Judged]
    judged: Mapping[tuple[str, str], Judged]
    comparisons: tuple[tuple[Pair, Comparison], ...]
    felt: Felt
    tool: Addition
    tool_truth: Mapping[str, float]


def run_demo(demo: Demo, folder: Path, tell: Tell, processes: int | None = None) -> Results:
    """Record into `folder`/logs, find everything, and write tables, figures and the report into `folder`.

    Args:
        demo: what to do.
        folder: an empty folder.
        tell: called with what is being done and the share of it done.
        processes: simulations at a time; None for as many as there are processors.

    Raises:
        MujocoMissingError: there is no simulator.
        OutputError: nothing can be written there.
    """
    from haptid.demos.figures import draw_all
    from haptid.demos.report import write_all

    load_mujoco()
    logs = folder / "logs"
    logs.mkdir()
    record_logs(demo, logs, tell, processes)
    found = find(demo, logs, tell)
    draw_all(found, folder, tell)
    tell("writing", 0.0)
    write_all(found, folder)
    tell("writing", 1.0)
    return found


def record_logs(demo: Demo, logs: Path, tell: Tell, processes: int | None = None) -> None:
    """Every log of a demonstration, with the experiments that made them."""
    takes = []
    for mounting in demo.mountings:
        for ending, exact in (("", False), (EXACT, True)):
            out = logs / f"{mounting.key}{ending}.parquet"
            takes.append(Take(demo.device, demo.folder / mounting.experiment, out, exact))
    takes += [
        Take(demo.device, demo.folder / name, logs / Path(name).with_suffix(".parquet").name)
        for name in (demo.tool.experiment, demo.hand.experiment)
    ]
    tell("simulating", 0.0)
    for done, _ in enumerate(record_all(takes, processes), 1):
        tell("simulating", done / len(takes))
    for name in dict.fromkeys(take.experiment for take in takes):
        shutil.copy(name, logs)


def find(demo: Demo, logs: Path, tell: Tell) -> Results:
    """Everything from the logs."""
    device = read_device(demo.device)
    fits = {}
    for k, mounting in enumerate(demo.mountings):
        tell("identifying", k / len(demo.mountings))
        exact, encoders = (
            read_recorded(device, demo.folder / mounting.experiment, logs / f"{mounting.key}{ending}.parquet")
            for ending in (EXACT, "")
        )
        fits[mounting.key] = fit_all(demo, mounting, exact, encoders)
    tell("identifying", 1.0)
    columns, ours = _judged(demo, device, fits, tell)
    pushed = _beside(demo, device, demo.hand.experiment, logs)
    return Results(
        demo=demo,
        device=device,
        fits=fits,
        published=columns,
        judged=ours,
        comparisons=tuple(
            (pair, compare(fits[pair.first]["encoders"].command, fits[pair.second]["encoders"].command))
            for pair in demo.comparisons
        ),
        felt=feel(demo.hand, fits[demo.hand.mounting]["encoders"], pushed),
        tool=tool_found(demo, fits[demo.tool.mounting], _beside(demo, device, demo.tool.experiment, logs)),
        tool_truth=tool_truth(demo, device),
    )


def tool_found(demo: Demo, without: Fits, recorded: Recorded) -> Addition:
    """What the tool adds to the handle's link, from the mounting without it and a log with it."""
    device, treatment = without.device, without.proposal.treatment
    assert device.handle is not None
    first, second = (recorded.motion(half, treatment) for half in (demo.stretch.fit, demo.stretch.unseen))
    fit = fitted("with the tool", device, first, second)
    return addition(without["encoders"].estimate, fit.estimate, device.joint_names[device.handle.link])


def tool_truth(demo: Demo, device: Device) -> dict[str, float]:
    """Mass and first moments of the tool in the frame of the handle's link, by name, kg and kg m."""
    payload = read_experiment(demo.folder / demo.tool.experiment).setup(device).payload
    assert payload is not None
    assert device.handle is not None
    joint = device.joints[device.handle.link]
    com = device.handle.translation + device.handle.rotation @ payload.com
    x, y, z = payload.mass * joint.frame_rotation.T @ (com - joint.frame_translation)
    return {f"M{joint.name}": payload.mass} | {
        f"{kind}{joint.name}": float(moment) for kind, moment in zip(("MX", "MY", "MZ"), (x, y, z), strict=True)
    }


def _beside(demo: Demo, device: Device, experiment: str, logs: Path) -> Recorded:
    """The log of an experiment that is no mounting of its own."""
    return read_recorded(device, demo.folder / experiment, logs / Path(experiment).with_suffix(".parquet").name)


def _judged(
    demo: Demo, device: Device, fits: Mapping[str, Fits], tell: Tell
) -> tuple[dict[str, Judged], dict[tuple[str, str], Judged]]:
    """What becomes of published parameters and of ours."""
    like = next(iter(fits.values()))["encoders"].targets
    named = (demo.parameters.columns[0], *fits)
    many = len(named) + len(JUDGED) * len(fits)
    columns, ours = dict[str, Judged](), dict[tuple[str, str], Judged]()
    for name in named:
        tell("judging", len(columns) / many)
        columns[name] = judge(name, published(demo, like, name), device, demo.workspaces)
    for key, made in fits.items():
        for fit in JUDGED:
            tell("judging", (len(columns) + len(ours)) / many)
            ours[key, fit] = judge(made.mounting.title, made[fit].estimate, device, demo.workspaces)
    tell("judging", 1.0)
    return columns, ours
