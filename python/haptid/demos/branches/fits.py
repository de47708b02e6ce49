"""The identification of one branch: friction test, all base parameters, essential ones, all against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.branches.plan import Branch, Stretch
from haptid.demos.recordings import Recorded
from haptid.demos.tables import Table
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS, Estimate, estimate
from haptid.experiment.friction_test.choice import FrictionChoice, choose_friction
from haptid.experiment.friction_test.curve import FrictionCurve, friction_curve
from haptid.inference.elimination import Elimination, eliminate, eliminate_by_motor
from haptid.motion.treatment import Motion, Treatment
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.propose import Proposal, propose
from haptid.validation.validation import Validation


@dataclass(frozen=True, eq=False)
class Identified:
    """One branch, identified.

    Attributes:
        branch, table: which, and what is published of it.
        beta: true base parameters, (p,), SI.
        proposal: the treatment that the log was found to need.
        fit, unseen: the log that identifies and the other one, treated.
        every: the rows of `fit`, those at reversals too: the W that the paper counts.
        reduction: from all base parameters to the essential ones, and what both predict of the unseen motion.
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
        """As in its file."""
        return self.full.model

    @property
    def full(self) -> Estimate:
        """All base parameters."""
        return self.reduction.full

    @property
    def reduced(self) -> Estimate:
        """The essential ones."""
        return self.reduction.reduced

    @property
    def direct(self) -> Validation:
        """The essential parameters on the rows of the fit."""
        return self.reduction.seen[1]

    @property
    def cross(self) -> Validation:
        """The essential parameters on the unseen motion."""
        assert self.reduction.unseen is not None
        return self.reduction.unseen[1]

    @cached_property
    def by_motor(self) -> tuple[Elimination, ...]:
        """The same reduction of each motor's rows by themselves."""
        return eliminate_by_motor(self.full)

    @property
    def condition_of_published(self) -> tuple[float, float]:
        """Condition number of the published parameters' columns, raw and scaled."""
        return self.every.condition_without(
            [k for k, name in enumerate(self.every.base.names) if name not in self.table.rows]
        )

    @property
    def missing(self) -> tuple[str, ...]:
        """Published parameters that were left out here."""
        return tuple(name for name in self.table.rows if name not in self.reduction.essential)

    @property
    def more(self) -> tuple[str, ...]:
        """Parameters that were kept here and are not published."""
        return tuple(name for name in self.reduction.essential if name not in self.table.rows)

    def true(self, name: str) -> float:
        """True value of a base parameter, SI."""
        return float(self.beta[self.model.base.names.index(name)])

    def inside(self, name: str) -> bool:
        """Whether the essential estimate's interval of a parameter holds the truth."""
        low, high = self.reduced[name].conf_int()
        return low <= self.true(name) <= high


def identified(branch: Branch, table: Table, stretch: Stretch, recorded: Recorded, unseen: Recorded) -> Identified:
    """All base parameters from one log, and the essential ones, compared on another."""
    model = recorded.model
    proposal = propose(model, recorded.log(stretch.identify), decimation=stretch.decimation)
    fit, other = (
        recorded.motion(stretch.identify, proposal.treatment),
        unseen.motion(stretch.unseen, proposal.treatment),
    )
    full = estimate(observe(model, fit), WLS())
    every = observe(model, replace(fit, treatment=replace(fit.treatment, reversal_speed=0.0)))
    reduction = eliminate(full, unseen=other)
    return Identified(branch, table, recorded.beta, proposal, fit, other, every, reduction)


@dataclass(frozen=True, eq=False)
class FrictionTest:
    """The friction test of one branch.

    Attributes:
        curve: friction torque against velocity.
        choice: the model that it asks for.
    """

    curve: FrictionCurve
    choice: FrictionChoice

    def coulomb(self, label: str) -> tuple[float, tuple[float, float]]:
        """Coulomb friction of a motor and its 95 % interval, N m."""
        chosen = next(joint.chosen for joint in self.choice.joints if joint.label == label)
        return chosen.values["FC"], chosen.conf_int()["FC"]


def friction_test(stretch: Stretch, recorded: Recorded) -> FrictionTest:
    """Friction of each motor from a log in which the joints move in turn."""
    ends = stretch.friction_edge, float(recorded.t[-1]) - stretch.friction_edge
    treatment = Treatment(cutoff_hz=stretch.friction_cutoff_hz, torque_delay_s=recorded.dt / 2)
    curve = friction_curve(recorded.model, recorded.motion(ends, treatment))
    return FrictionTest(curve, choose_friction(curve))


def coulomb_of(model: DynamicModel, label: str) -> str:
    """Name of the base parameter that is a motor's own Coulomb friction."""
    motor = model.device.row_names[model.device.row_labels.index(label)]
    (term,) = [name for name in model.device.parameters.names if name == f"FC{motor}"]
    column = model.base.regrouping[:, model.device.parameters.index[term]]
    return model.base.names[int(np.argmax(np.abs(column)))]
