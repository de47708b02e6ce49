"""Identifications of one mounting: by the paper's method, from encoders, and constrained to physical consistency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.late import dataclass
from haptid.demos.phantom_configurations.plan import PhantomDemo
from haptid.demos.recordings import BenchRecording
from haptid.device.parameters import standard_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS, Estimate, Method, PhysicallyConsistent, estimate
from haptid.inference.targets import Targets, targets
from haptid.motion.motion import Motion
from haptid.observation.observation import observe
from haptid.treatment_choice.propose import Proposal, propose
from haptid.validation.validation import Validation, validate


@dataclass(frozen=True, eq=False)
class Fit:
    """One identification, validated on the other half of the log.

    Attributes:
        title: for tables.
        estimate: from the first half.
        validation: on the second half, rows clear of reversals.
        everywhere: on the second half, all rows.
        unseen: the second half, treated.
    """

    title: str
    estimate: Estimate
    validation: Validation
    everywhere: Validation
    unseen: Motion

    @cached_property
    def targets(self) -> Targets:
        """In SI."""
        return targets(self.estimate)

    @cached_property
    def command(self) -> Targets:
        """In units of command."""
        return self.targets.in_command()

    @property
    def relative(self) -> tuple[float, ...]:
        """Relative errors of the motors on rows clear of reversals, per cent."""
        return tuple(motor.relative for motor in self.validation.motors)

    @property
    def relative_everywhere(self) -> tuple[float, ...]:
        """The same on all rows."""
        return tuple(motor.relative for motor in self.everywhere.motors)


@dataclass(frozen=True, eq=False)
class Fits:
    """All identifications of one mounting.

    Attributes:
        mounting: its key.
        encoders: the log as the encoders measure it.
        exact: the log with exact sensors.
        proposal: treatment proposed for the log with encoders.
        by: fits by key: "frictionless" and "exact" with exact velocities, "encoders" with the proposed treatment,
            "held" the same constrained to physical consistency, "late 5 ms" and so on with the paper's velocity.
    """

    mounting: str
    exact: BenchRecording
    encoders: BenchRecording
    proposal: Proposal
    by: Mapping[str, Fit]

    def __getitem__(self, key: str) -> Fit:
        return self.by[key]

    @property
    def model(self) -> DynamicModel:
        """With the gravity of its file."""
        return self.encoders.model


def fit_all(demo: PhantomDemo, mounting: str, exact: BenchRecording, encoders: BenchRecording) -> Fits:
    """Every identification of one mounting."""
    model, halves = encoders.model, (demo.stretch.fit, demo.stretch.unseen)
    proposal = propose(model, encoders.log(halves[0]))
    paper = demo.published.treatment(exact.dt)
    known = [exact.exact(half, paper) for half in halves]
    read = [encoders.motion(half, proposal.treatment) for half in halves]
    fits = {
        "frictionless": fitted("8 parameters, exact velocity", without_terms(model), known),
        "exact": fitted("exact velocity, causal filter", model, known),
        "encoders": fitted("encoders, proposed treatment", model, read),
        "held": fitted("the same, held to what is possible", model, read, PhysicallyConsistent()),
    }
    for lag in demo.published.lags:
        late = demo.published.treatment(encoders.dt, lag)
        motions = [encoders.motion(half, late) for half in halves]
        fits[f"late {1e3 * lag:g} ms"] = fitted(f"encoders, velocity {1e3 * lag:g} ms late", model, motions)
    return Fits(mounting, exact, encoders, proposal, fits)


def fitted(title: str, model: DynamicModel, halves: Sequence[Motion], method: Method | None = None) -> Fit:
    """A fit to the first motion, validated on the second."""
    first, second = halves
    estimate_found = estimate(observe(model, first), method or WLS())
    everywhere = replace(second, treatment=replace(second.treatment, reversal_speed=0.0))
    return Fit(title, estimate_found, validate(estimate_found, second), validate(estimate_found, everywhere), second)


def without_terms(model: DynamicModel) -> DynamicModel:
    """The same links, loops and motors, without friction or any other term.

    Targets that need a term are left out, the others keep their factors.
    """
    device = model.device
    inertial = device.parameters.raw[: 10 * len(device.joints)]
    rules = tuple(rule.among(inertial) for rule in device.symmetry)
    links = standard_parameters([j.name for j in device.joints], [j.body for j in device.joints], (), rules)
    columns = [device.parameters.index[name] for name in links.names]
    terms = np.setdiff1d(np.arange(len(device.parameters.names)), columns)
    bare = replace(
        device,
        terms=(),
        parameters=links,
        symmetry=rules,
        prior={name: value for name, value in device.prior.items() if name in links.raw},
        keep=tuple(name for name in device.keep if name in links.raw),
        targets=tuple(replace(t, row=t.row[columns]) for t in device.targets if not t.row[terms].any()),
    )
    return DynamicModel(bare)
