"""The identifications of one mounting: the paper's way, from encoders, held to what bodies can have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, expect, read_only
from haptid.demos.mountings.frictionless import without_terms
from haptid.demos.mountings.plan import Mounting, Mountings
from haptid.demos.recordings import Recorded
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS, Estimate, Method, PhysicallyConsistent, estimate
from haptid.inference.targets import Targets, target_map, targets
from haptid.motion.treatment import Motion
from haptid.observation.observation import observe
from haptid.treatment_choice.propose import Proposal, propose
from haptid.validation.validation import Validation, validate

# A joint slower than this may stick, rad/s or m/s: its dry friction is then anything up to the Coulomb one.
STICKS = 0.02
# A parameter counts that carries this share of a motor's torque.
CARRIES = 0.02


@dataclass(frozen=True, eq=False)
class Fit:
    """One identification, and what it predicts of the half that it has not seen.

    Attributes:
        title: for tables.
        estimate: from the first half.
        validation: on the second, on the rows that count.
        everywhere: on the second, on all rows, those at reversals too.
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
        """Errors of the validation by motor, per cent."""
        return tuple(motor.relative for motor in self.validation.motors)

    @property
    def relative_everywhere(self) -> tuple[float, ...]:
        """The same on all rows, those at reversals too."""
        return tuple(motor.relative for motor in self.everywhere.motors)


@dataclass(frozen=True, eq=False)
class Fits:
    """All identifications of one mounting.

    Attributes:
        mounting: which.
        exact, encoders: logs with exact sensors, and as encoders see it.
        proposal: the treatment that the encoders' log was found to need.
        by: fits by their key: "frictionless" and "exact" with exact velocities, "encoders" as proposed, "held" to what
            bodies can have, "late 5 ms" and so on with the paper's own velocity.
    """

    mounting: Mounting
    exact: Recorded
    encoders: Recorded
    proposal: Proposal
    by: Mapping[str, Fit]

    def __getitem__(self, key: str) -> Fit:
        return self.by[key]

    @property
    def model(self) -> DynamicModel:
        """As in its file."""
        return self.encoders.model


def fit_all(demo: Mountings, mounting: Mounting, exact: Recorded, encoders: Recorded) -> Fits:
    """Every identification of one mounting."""
    model, halves = encoders.model, demo.stretch
    proposal = propose(model, encoders.log(halves.fit))
    paper = demo.published.treatment(exact.dt)
    known = exact.exact(halves.fit, paper), exact.exact(halves.unseen, paper)
    read = encoders.motion(halves.fit, proposal.treatment), encoders.motion(halves.unseen, proposal.treatment)
    made = {
        "frictionless": fitted("8 parameters, exact velocity", without_terms(model), *known),
        "exact": fitted("exact velocity, causal filter", model, *known),
        "encoders": fitted("encoders, proposed treatment", model, *read),
        "held": fitted("the same, held to what is possible", model, *read, PhysicallyConsistent()),
    }
    for lag in demo.published.lags:
        late = demo.published.treatment(encoders.dt, lag)
        both = encoders.motion(halves.fit, late), encoders.motion(halves.unseen, late)
        made[f"late {1e3 * lag:g} ms"] = fitted(f"encoders, velocity {1e3 * lag:g} ms late", model, *both)
    return Fits(mounting, exact, encoders, proposal, made)


def fitted(title: str, model: DynamicModel, first: Motion, second: Motion, method: Method | None = None) -> Fit:
    """A fit to the first motion, validated on the second."""
    found = estimate(observe(model, first), method or WLS())
    everywhere = replace(second, treatment=replace(second.treatment, reversal_speed=0.0))
    return Fit(title, found, validate(found, second), validate(found, everywhere), second)


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How near the truth an estimate is.

    Attributes:
        names: of the targets, (k,).
        truth: their true values, (k,), SI.
        errors: in per cent of them, (k,).
        inside: whether the truth is inside each honest interval, (k,).
        carried: greatest share of a motor's torque that each target makes, (k,).
        kinds: what each target is, "viscous", "Coulomb" or "body", (k,).
        torque: error of the torque where no joint sticks, against the exact one, of each motor, per cent.
    """

    names: tuple[str, ...]
    truth: Array
    errors: Array
    inside: np.ndarray
    carried: Array
    kinds: np.ndarray
    torque: Array

    def __post_init__(self) -> None:
        for name in ("truth", "errors", "carried", "torque"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("errors", "inside", "carried", "kinds"):
            expect(name, getattr(self, name).shape, (len(self.names),))

    def worst(self, kind: str) -> float:
        """Greatest error of the targets of a kind, per cent; of bodies, those that carry a share of the torque."""
        counted = (self.kinds == kind) & ((kind != "body") | (self.carried >= CARRIES))
        return float(np.abs(self.errors[counted]).max(initial=0.0))


def accuracy(found: Targets, recorded: Recorded, stretch: tuple[float, float]) -> Accuracy:
    """An estimate's targets against the truth; torques are compared on a stretch of the recording, s."""
    model = recorded.model
    C, moving = target_map(model), (np.abs(recorded.qd) > STICKS).all(axis=0) & recorded.during(stretch)
    states = tuple(x[:, moving] for x in (recorded.q, recorded.qd, recorded.qdd))
    truth, whole = C @ recorded.beta, inverse_dynamics(model, recorded.beta, *states)
    missed = inverse_dynamics(model, found.estimate.beta, *states) - whole
    sizes = np.linalg.norm(whole, axis=1)
    parts = np.linalg.solve(C, np.diag(truth)).T
    shares = [np.linalg.norm(inverse_dynamics(model, part, *states), axis=1) / sizes for part in parts]
    low, high = found.conf_int().T
    return Accuracy(
        names=found.names,
        truth=truth,
        errors=100 * (found.value - truth) / np.abs(truth),
        inside=(low <= truth) & (truth <= high),
        carried=np.max(shares, axis=1),
        kinds=np.array([_kind(model, row) for row in C]),
        torque=100 * np.linalg.norm(missed, axis=1) / sizes,
    )


def _kind(model: DynamicModel, row: Array) -> str:
    """What a target is: friction of one sort, or bodies."""
    kinds = {model.device.parameters.kinds[model.base.independent_columns[k]][:2] for k in np.flatnonzero(row)}
    return {"FV": "viscous", "FC": "Coulomb"}.get(kinds.pop(), "body") if len(kinds) == 1 else "body"
