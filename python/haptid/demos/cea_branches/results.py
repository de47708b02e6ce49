"""Results of the branches: identification, essential parameters, friction test, end-effector, compensation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.cea_branches.compensation import Compensated, compensated
from haptid.demos.cea_branches.interface import IdentifiedInterface, identified_interface
from haptid.demos.cea_branches.other_laws import LawInHand, other_laws
from haptid.demos.cea_branches.plan import Branch, CeaDemo, Interface, Stretch
from haptid.demos.flaws import FlawedDevice, figures, range_sentence
from haptid.demos.plan import Progress, Table
from haptid.demos.recordings import BenchRecording, Take, read_recording
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import ApparentMass, Characterisation, apparent_mass, characterise
from haptid.estimation import WLS, Estimate, estimate
from haptid.experiment.bench.experiment import read_experiment
from haptid.experiment.friction_test.choice import FrictionChoice, choose_friction
from haptid.experiment.friction_test.curve import FrictionCurve, friction_curve
from haptid.inference.elimination import Elimination, eliminate, eliminate_by_motor
from haptid.motion.motion import Motion
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.propose import Proposal, propose
from haptid.validation.validation import Validation, validate


@dataclass(frozen=True, eq=False)
class Identified:
    """One branch, identified.

    Attributes:
        branch, table: the branch and its published table.
        beta: true base parameters, (p,), SI.
        proposal: treatment proposed for the log.
        fit, unseen: the log that identifies and the other one, treated.
        every: all rows of `fit`, those at reversals too: the matrix W of the paper.
        reduction: backward elimination from all base parameters to the essential ones, with predictions of both.
    """

    branch: Branch
    table: Table
    beta: Array
    proposal: Proposal
    fit: Motion
    unseen: Motion
    every: Observation
    reduction: Elimination

    @property
    def model(self) -> DynamicModel:
        """With the gravity of its file."""
        return self.full.model

    @property
    def full(self) -> Estimate:
        """All base parameters."""
        return self.reduction.full

    @property
    def reduced(self) -> Estimate:
        """The essential parameters."""
        return self.reduction.reduced

    @property
    def fit_errors(self) -> Validation:
        """The essential parameters on the rows of the fit."""
        return self.reduction.seen[1]

    @property
    def cross(self) -> Validation:
        """The essential parameters on the unseen motion."""
        assert self.reduction.unseen is not None
        return self.reduction.unseen[1]

    @cached_property
    def cross_everywhere(self) -> Validation:
        """The same on all rows, those at reversals too."""
        return validate(
            self.reduced, replace(self.unseen, treatment=replace(self.unseen.treatment, reversal_speed=0.0))
        )

    @cached_property
    def by_motor(self) -> tuple[Elimination, ...]:
        """The same elimination on the rows of each motor alone."""
        return eliminate_by_motor(self.full)

    @property
    def condition_of_published(self) -> tuple[float, float]:
        """Condition number of the published parameters' columns, raw and scaled."""
        others = [k for k, name in enumerate(self.every.base.names) if name not in self.table.rows]
        return self.every.condition_without(others)

    @property
    def missing(self) -> tuple[str, ...]:
        """Published parameters that were eliminated here."""
        return tuple(name for name in self.table.rows if name not in self.reduction.essential)

    @property
    def more(self) -> tuple[str, ...]:
        """Essential parameters here that are not published."""
        return tuple(name for name in self.reduction.essential if name not in self.table.rows)

    def true(self, name: str) -> float:
        """True value of a base parameter, SI."""
        return float(self.beta[self.model.base.names.index(name)])

    def inside(self, name: str) -> bool:
        """Whether the true value is inside the 95 % interval of an essential parameter."""
        low, high = self.reduced[name].conf_int()
        return low <= self.true(name) <= high


def identified(
    branch: Branch, table: Table, stretch: Stretch, recording: BenchRecording, unseen: BenchRecording
) -> Identified:
    """All base parameters and the essential ones from one log, validated on another."""
    model = recording.model
    proposal = propose(model, recording.log(stretch.identify), decimation=stretch.decimation)
    fit = recording.motion(stretch.identify, proposal.treatment)
    other = unseen.motion(stretch.unseen, proposal.treatment)
    full = estimate(observe(model, fit), WLS())
    every = observe(model, replace(fit, treatment=replace(fit.treatment, reversal_speed=0.0)))
    return Identified(branch, table, recording.beta, proposal, fit, other, every, eliminate(full, unseen=other))


@dataclass(frozen=True, eq=False)
class FrictionTest:
    """Friction test of one branch: torque against velocity, and the friction model selected from it."""

    curve: FrictionCurve
    choice: FrictionChoice

    def coulomb(self, label: str) -> tuple[float, tuple[float, float]]:
        """Coulomb friction of a motor and its 95 % interval, N m."""
        chosen = next(joint.chosen for joint in self.choice.joints if joint.label == label)
        return chosen.values["FC"], chosen.conf_int()["FC"]


def friction_test(stretch: Stretch, recording: BenchRecording) -> FrictionTest:
    """Friction of each motor from a log in which the joints move in turn."""
    ends = stretch.friction_edge, float(recording.t[-1]) - stretch.friction_edge
    treatment = Treatment(cutoff_hz=stretch.friction_cutoff_hz, torque_delay_s=recording.dt / 2)
    curve = friction_curve(recording.model, recording.motion(ends, treatment))
    return FrictionTest(curve, choose_friction(curve))


def coulomb_of(model: DynamicModel, label: str) -> str:
    """Name of the base parameter that is a motor's own Coulomb friction."""
    motor = model.device.row_names[model.device.row_labels.index(label)]
    column = model.base.regrouping[:, model.device.parameters.index[f"FC{motor}"]]
    return model.base.names[int(np.argmax(np.abs(column)))]


@dataclass(frozen=True, eq=False)
class Handle:
    """End-effector of one branch.

    Attributes:
        sweeps: principal apparent masses along each published sweep.
        essential, full: characterisation at the posture, from the essential parameters and from all, with viscous
            friction.
    """

    sweeps: Mapping[str, ApparentMass]
    essential: Characterisation
    full: Characterisation


@dataclass(frozen=True, eq=False)
class Results:
    """All results of the demonstration.

    Attributes:
        demo, model: its plan, and the model of a branch.
        friction, found, handles: friction tests, identifications and end-effectors by branch.
        compensated: inertia compensation of one branch.
        others: other laws of that branch in a hand.
        interface: both branches on one handle; None without it.
        flawed: the first branch with the flaws of a real device; None where the plan has no such logs.
    """

    demo: CeaDemo
    model: DynamicModel
    friction: Mapping[str, FrictionTest]
    found: Mapping[str, Identified]
    handles: Mapping[str, Handle]
    compensated: Compensated
    others: tuple[LawInHand, ...]
    interface: IdentifiedInterface | None
    flawed: FlawedDevice | None = None


def takes(demo: CeaDemo, logs: Path) -> list[Take]:
    """Both logs of the interface, and of every branch the friction test and its two logs; long ones first."""
    interface, kinds = demo.interface, ("friction", "key", "unseen")
    takes = (
        [demo.take(key, logs, device=interface.device) for key in (interface.key, interface.unseen)]
        if interface
        else []
    )
    takes += [demo.take(key, logs) for key in (demo.flawed.fit, demo.flawed.unseen)] if demo.flawed else []
    return takes + [demo.take(getattr(branch, kind), logs) for kind in kinds for branch in demo.branches]


def find(demo: CeaDemo, logs: Path, progress: Progress) -> Results:
    """All results from the logs; compensation is simulated here, as it requires the identified model."""
    model = DynamicModel(read_device(demo.device))

    def recording(key: str) -> BenchRecording:
        return read_recording(model, logs / f"{key}.toml", logs / f"{key}.parquet")

    friction, identified_branches, handles = dict[str, FrictionTest](), dict[str, Identified](), dict[str, Handle]()
    for k, branch in enumerate(demo.branches):
        progress("identifying", k / len(demo.branches))
        friction[branch.key] = friction_test(demo.stretch, recording(branch.friction))
        table = demo.tables[branch.key]
        branch_fit = identified(branch, table, demo.stretch, recording(branch.key), recording(branch.unseen))
        identified_branches[branch.key] = branch_fit
        progress("identifying", (k + 0.7) / len(demo.branches))
        posture = demo.posture.at(model)
        handles[branch.key] = Handle(
            sweeps={sweep.key: apparent_mass(branch_fit.reduced, sweep.along(model)) for sweep in demo.sweeps},
            essential=characterise(branch_fit.reduced, posture),
            full=characterise(branch_fit.full, posture),
        )
    progress("identifying", 1.0)
    plan = demo.compensation
    progress("compensating", 0.0)
    setup = read_experiment(logs / f"{plan.branch}.toml").setup(model)
    given = plan, demo.sweep(plan.sweep), identified_branches[plan.branch].reduced, setup
    compensation, others = compensated(*given), other_laws(*given)
    progress("compensating", 1.0)
    interface = interface_of(demo.interface, logs, progress) if demo.interface else None
    bent = None
    if demo.flawed:
        first = demo.branches[0]
        pairs = (first.key, first.unseen), (demo.flawed.fit, demo.flawed.unseen)
        bent = flawed(demo, identified_branches[first.key], *([recording(key) for key in pair] for pair in pairs))
    return Results(demo, model, friction, identified_branches, handles, compensation, others, interface, bent)


def flawed(
    demo: CeaDemo, ideal: Identified, as_is: Sequence[BenchRecording], with_flaws: Sequence[BenchRecording]
) -> FlawedDevice:
    """All base parameters of a branch from its logs with flaws, with the treatment proposed for them.

    Args:
        ideal: the branch as it was identified.
        as_is, with_flaws: the log that identifies and that which validates.
    """
    stretch, (logged, other) = demo.stretch, with_flaws
    treatment = propose(logged.model, logged.log(stretch.identify)).treatment
    full = estimate(observe(logged.model, logged.motion(stretch.identify, treatment)), WLS())
    return FlawedDevice(
        f"{ideal.branch.title} branch, all base parameters",
        figures(ideal.full, ideal.unseen, as_is[1], stretch.unseen),
        figures(full, other.motion(stretch.unseen, treatment), other, stretch.unseen),
        range_sentence(full),
    )


def interface_of(plan: Interface, logs: Path, progress: Progress) -> IdentifiedInterface:
    """The whole interface from its two logs."""
    progress("identifying the interface", 0.0)
    model = DynamicModel(read_device(plan.device))
    logged, other = (
        read_recording(model, logs / f"{key}.toml", logs / f"{key}.parquet") for key in (plan.key, plan.unseen)
    )
    interface = identified_interface(plan, logged, other)
    progress("identifying the interface", 1.0)
    return interface
