"""The whole interface: two branches on one handle, seven motors for six degrees of freedom, from one log."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.cea_branches.plan import Interface
from haptid.demos.recordings import BenchRecording
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import Characterisation, GivenParameters, IdentifiedModel, characterise
from haptid.estimation import Estimate, TorqueNoise, estimate
from haptid.motion.motion import Motion
from haptid.observation.observation import observe
from haptid.treatment_choice.propose import Proposal, propose
from haptid.validation.validation import Validation, validate

# Components of the handle's velocity: of its point, of its rotation, both.
_LINEAR, _ANGULAR, _BOTH = (0, 1, 2), (3, 4, 5), (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, eq=False)
class IdentifiedInterface:
    """The whole interface, identified.

    Attributes:
        plan: its plan.
        beta: true base parameters, (p,), SI.
        proposal: treatment proposed for the log.
        estimate: of all base parameters.
        unseen: another motion, treated.
    """

    plan: Interface
    beta: Array
    proposal: Proposal
    estimate: Estimate
    unseen: Motion

    @property
    def model(self) -> DynamicModel:
        """The dynamic model."""
        return self.estimate.model

    @cached_property
    def cross(self) -> Validation:
        """On the unseen motion, rows clear of reversals."""
        return validate(self.estimate, self.unseen)

    @cached_property
    def cross_everywhere(self) -> Validation:
        """The same on all rows."""
        treatment = replace(self.unseen.treatment, reversal_speed=0.0)
        return validate(self.estimate, replace(self.unseen, treatment=treatment))

    @cached_property
    def inside(self) -> tuple[str, ...]:
        """Base parameters whose 95 % interval contains the true value."""
        low, high = self.estimate.conf_int().T
        held = (low <= self.beta) & (self.beta <= high)
        return tuple(name for name, ok in zip(self.model.base.names, held, strict=True) if ok)

    @property
    def pose(self) -> Array:
        """The posture, (active, 1), rad."""
        names = [self.model.device.joint_names[j] for j in self.model.device.active]
        return np.radians([[self.plan.posture[name]] for name in names])

    @cached_property
    def at_posture(self) -> dict[str, Characterisation]:
        """The handle there: of its point, of its rotation with the point free to move, and of both."""
        return self._handle(self.estimate, self.pose)

    @cached_property
    def over_workspace(self) -> dict[str, Characterisation]:
        """The same at random poses of the workspace."""
        poses = self.model.device.closure.draw(np.random.default_rng(0), self.plan.map_poses)
        return self._handle(self.estimate, poses)

    @cached_property
    def tilt(self) -> Array:
        """Angle of the handle's own axis from upright at these poses, (poses,), degrees."""
        vertical = handle_motion(self.model, self.over_workspace["linear"].handle.qa).rotation[:, 1, 2]
        return np.asarray(np.degrees(np.arccos(np.clip(np.abs(vertical), 0.0, 1.0))))

    @cached_property
    def truly(self) -> dict[str, Characterisation]:
        """The same with the true parameters."""
        return self._handle(GivenParameters(self.model, self.beta), self.pose)

    def _handle(self, identified: IdentifiedModel, poses: Array) -> dict[str, Characterisation]:
        rows = {"linear": _LINEAR, "angular": _ANGULAR, "both": _BOTH}
        return {name: characterise(identified, poses, some) for name, some in rows.items()}


def identified_interface(plan: Interface, recording: BenchRecording, unseen: BenchRecording) -> IdentifiedInterface:
    """All base parameters from one log, with the covariance of the seven torque channels, and the other log treated."""
    proposal = propose(recording.model, recording.log(plan.identify))
    fit = recording.motion(plan.identify, proposal.treatment)
    fitted = estimate(observe(recording.model, fit), TorqueNoise())
    other = unseen.motion(plan.validate_, proposal.treatment)
    return IdentifiedInterface(plan, recording.beta, proposal, fitted, other)
