"""What is recorded of the branches of a device, and everything that is found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from haptid.demos.branches.compensated import Compensated, compensated
from haptid.demos.branches.fits import FrictionTest, Identified, friction_test, identified
from haptid.demos.branches.plan import Branch, Branches
from haptid.demos.kind import Tell
from haptid.demos.recordings import Recorded, Take, read_recorded
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import ApparentMass, Characterisation, apparent_mass, characterise


@dataclass(frozen=True, eq=False)
class Handle:
    """What the hand feels of one branch.

    Attributes:
        sweeps: principal masses along each published sweep.
        essential, full: at the posture, from the essential parameters, and from all, which have viscous friction.
    """

    sweeps: Mapping[str, ApparentMass]
    essential: Characterisation
    full: Characterisation


@dataclass(frozen=True, eq=False)
class Results:
    """All that the demonstration finds.

    Attributes:
        demo: what was asked.
        model: as in its file.
        friction, found, handles: by branch.
        compensated: on the bench.
    """

    demo: Branches
    model: DynamicModel
    friction: Mapping[str, FrictionTest]
    found: Mapping[str, Identified]
    handles: Mapping[str, Handle]
    compensated: Compensated


def takes(demo: Branches, logs: Path) -> list[Take]:
    """Of every branch the friction test, the log that identifies and the unseen one; long ones first."""
    return [
        Take(demo.device, demo.folder / name, log_of(logs, name))
        for kind in ("friction", "experiment", "unseen")
        for name in (getattr(branch, kind) for branch in demo.branches)
    ]


def log_of(logs: Path, experiment: str) -> Path:
    """Where the log of an experiment is."""
    return logs / Path(experiment).with_suffix(".parquet").name


def find(demo: Branches, logs: Path, tell: Tell) -> Results:
    """Everything from the logs; compensation is tried on the bench here, as it needs a model."""
    model = DynamicModel(read_device(demo.device))

    def recorded(name: str) -> Recorded:
        return read_recorded(model, demo.folder / name, log_of(logs, name))

    friction, found, handles = dict[str, FrictionTest](), dict[str, Identified](), dict[str, Handle]()
    for k, branch in enumerate(demo.branches):
        tell("identifying", k / len(demo.branches))
        friction[branch.key] = friction_test(demo.stretch, recorded(branch.friction))
        found[branch.key] = _identified(demo, branch, recorded(branch.experiment), recorded(branch.unseen))
        tell("identifying", (k + 0.7) / len(demo.branches))
        handles[branch.key] = handle(demo, found[branch.key])
    tell("identifying", 1.0)
    asked = demo.compensation
    tell("compensating", 0.0)
    compensation = compensated(
        asked,
        demo.sweep(asked.sweep),
        found[asked.branch].reduced,
        demo.folder,
        demo.branch(asked.branch).experiment,
    )
    tell("compensating", 1.0)
    return Results(demo, model, friction, found, handles, compensation)


def _identified(demo: Branches, branch: Branch, recorded: Recorded, unseen: Recorded) -> Identified:
    return identified(branch, demo.tables[branch.key], demo.stretch, recorded, unseen)


def handle(demo: Branches, found: Identified) -> Handle:
    """What the hand feels along the sweeps and at the posture."""
    model, at = found.model, demo.posture.at(found.model)
    return Handle(
        sweeps={sweep.key: apparent_mass(found.reduced, sweep.along(model)) for sweep in demo.sweeps},
        essential=characterise(found.reduced, at),
        full=characterise(found.full, at),
    )
