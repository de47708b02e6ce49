"""Hand force against a force sensor: without the model, with the model, and by the momentum observer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.phantom_configurations.fits import Fit
from haptid.demos.phantom_configurations.plan import Hand
from haptid.demos.recordings import BenchRecording
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.force import estimate_force
from haptid.end_effector.momentum_observer import MomentumObserver, observe_force
from haptid.estimation import Estimate
from haptid.motion.motion import Motion, treat
from haptid.validation.validation import Validation, validate


@dataclass(frozen=True, eq=False)
class HandForces:
    """Force of the hand on the device in the base frame, each (rows, 3), N.

    Attributes:
        t: (rows,), s.
        measured: by the sensor; through the filter of the force estimate, as are the next three.
        true: exact; constant over each control period on the bench, so here a mean about each sample.
        bare: from the motors' torques without a model.
        modelled: from the motors' torques and the model.
        true_delayed, modelled_delayed: the exact and the modelled one, over each step, through the observer's low-pass.
        observed: by the momentum observer, which has that low-pass.
        inside: share of the exact forces inside the 95 % interval of `modelled`.
    """

    t: Array
    measured: Array
    true: Array
    bare: Array
    modelled: Array
    true_delayed: Array
    modelled_delayed: Array
    observed: Array
    inside: float

    @property
    def errors(self) -> dict[str, float]:
        """RMS length of the force and of the errors, N."""
        return {
            "force": rms(self.true),
            "without the model": rms(self.bare - self.true),
            "with the model": rms(self.modelled - self.true),
            "with the model, against the sensor": rms(self.modelled - self.measured),
            "with the model, through the observer's low-pass": rms(self.modelled_delayed - self.true_delayed),
            "observer": rms(self.observed - self.true_delayed),
        }


def rms(vectors: Array) -> float:
    """Root mean square length of vectors, (rows, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def hand_forces(plan: Hand, fit: Fit, recording: BenchRecording) -> HandForces:
    """Force of the hand along a log, by a fit of the same mounting."""
    treatment, dt = plan.treatment(recording.dt), recording.dt
    motion = recording.motion((float(recording.t[0]), float(recording.t[-1])), treatment)
    assert fit.unseen.log is not None
    noise = validate(fit.estimate, treat(fit.unseen.log, treatment))
    force = estimate_force(fit.estimate, motion, validation=noise)
    rows = (force.t >= plan.start) & (force.t <= plan.stop)
    indices, taps = recording.index(force.t[rows]), treatment.taps(dt)[:, None]
    acting = 0.5 * (recording.hand + previous(recording.hand))
    turned = handle_motion(recording.model, recording.q).rotation
    sensed = np.asarray(np.einsum("nij,nj->ni", turned, recording.sensor))
    true, measured = (signal.convolve(x, taps, mode="same")[indices] for x in (acting, sensed))
    low, high = np.moveaxis(force.conf_int()[rows], -1, 0)
    return HandForces(
        t=force.t[rows],
        measured=measured,
        true=true,
        bare=force.bare[rows, :3],
        modelled=force.force[rows],
        inside=float(((low <= true) & (true <= high)).mean()),
        **_through_observer(fit.estimate, motion, noise, recording, force.t[rows]),
    )


def previous(vectors: Array) -> Array:
    """The sample before each one, the first one its own, (n, 3)."""
    return np.concatenate([vectors[:1], vectors[:-1]])


def _through_observer(
    estimate: Estimate, motion: Motion, noise: Validation, recording: BenchRecording, t: Array
) -> dict[str, Array]:
    """Forces through the observer's low-pass at these times, and the observer's own."""
    observer, dt = MomentumObserver(), recording.dt
    observed = observe_force(estimate, motion, observer, validation=noise)
    every_row = replace(motion, treatment=replace(motion.treatment, decimation=1))
    force = estimate_force(estimate, every_row, validation=noise)
    known = np.nan_to_num(force.force)
    modelled = observer.smooth(0.5 * (known + previous(known)).T, dt).T
    return {
        "true_delayed": observer.smooth(previous(recording.hand).T, dt).T[recording.index(t)],
        "modelled_delayed": modelled[np.rint((t - force.t[0]) / dt).astype(int)],
        "observed": observed.force[np.rint((t - observed.t[0]) / dt).astype(int)],
    }
