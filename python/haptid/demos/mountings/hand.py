"""The force of a hand against a force sensor: without the model, with it, and by the momentum observer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, expect, read_only
from haptid.demos.mountings.fits import Fit
from haptid.demos.mountings.plan import Hand
from haptid.demos.recordings import Recorded
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.force import estimate_force
from haptid.end_effector.momentum_observer import MomentumObserver, observe_force
from haptid.estimation import Estimate
from haptid.motion.treatment import Motion, treat
from haptid.validation.validation import Validation, validate

FORCES = ("measured", "true", "bare", "modelled", "true_late", "modelled_late", "observed")


@dataclass(frozen=True, eq=False)
class Felt:
    """The force of the hand on the device in the base frame, each (rows, 3), N.

    Attributes:
        t: (rows,), s.
        measured: by the sensor; as all others but the late ones, through the force estimate's own filter.
        true: exact; the bench holds it from one control period to the next, so that it is a mean about each sample.
        bare: from the motors' torques without a model.
        modelled: from the motors' torques and the model.
        true_late, modelled_late: the exact and the modelled one, over each step, through the observer's low-pass.
        observed: by the momentum observer, which has that low-pass.
        inside: share of the exact forces inside the 95 % interval of `modelled`.
    """

    t: Array
    measured: Array
    true: Array
    bare: Array
    modelled: Array
    true_late: Array
    modelled_late: Array
    observed: Array
    inside: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", read_only(self.t))
        for name in FORCES:
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, (len(self.t), 3))

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square length of the force and of the errors, N."""
        return {
            "force": rms(self.true),
            "without the model": rms(self.bare - self.true),
            "with the model": rms(self.modelled - self.true),
            "with the model, against the sensor": rms(self.modelled - self.measured),
            "with the model, through the observer's low-pass": rms(self.modelled_late - self.true_late),
            "observer": rms(self.observed - self.true_late),
        }


def rms(vectors: Array) -> float:
    """Root mean square length of vectors, (rows, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def feel(plan: Hand, fit: Fit, recorded: Recorded) -> Felt:
    """The hand's force along a log, by a fit of the same mounting."""
    treatment, dt = plan.treatment(recorded.dt), recorded.dt
    motion = recorded.motion((float(recorded.t[0]), float(recorded.t[-1])), treatment)
    assert fit.unseen.log is not None
    noise = validate(fit.estimate, treat(fit.unseen.log, treatment))
    force = estimate_force(fit.estimate, motion, validation=noise)
    rows = (force.t >= plan.start) & (force.t <= plan.stop)
    at, taps = recorded.index(force.t[rows]), treatment.taps(dt)[:, None]
    acting = 0.5 * (recorded.hand + before(recorded.hand))
    true, measured = (signal.convolve(x, taps, mode="same")[at] for x in (acting, sensed(recorded)))
    low, high = np.moveaxis(force.conf_int()[rows], -1, 0)
    return Felt(
        t=force.t[rows],
        measured=measured,
        true=true,
        bare=force.bare[rows, :3],
        modelled=force.force[rows],
        inside=float(((low <= true) & (true <= high)).mean()),
        **_late(fit.estimate, motion, noise, recorded, force.t[rows]),
    )


def sensed(recorded: Recorded) -> Array:
    """Force of the hand by the sensor, turned from the handle's frame to the base's, (n, 3), N."""
    turned = handle_motion(recorded.model, recorded.q).rotation
    return np.asarray(np.einsum("nij,nj->ni", turned, recorded.sensor))


def before(vectors: Array) -> Array:
    """Each sample's forerunner, the first one its own, (n, 3)."""
    return np.concatenate([vectors[:1], vectors[:-1]])


def _late(estimate: Estimate, motion: Motion, noise: Validation, recorded: Recorded, t: Array) -> dict[str, Array]:
    """Forces through the observer's low-pass at some times, and what the observer says."""
    observer, dt = MomentumObserver(), recorded.dt
    seen = observe_force(estimate, motion, observer, validation=noise)
    plain = replace(motion, treatment=replace(motion.treatment, decimation=1))
    force = estimate_force(estimate, plain, validation=noise)
    plain_force = np.nan_to_num(force.force)
    modelled = observer.smooth(0.5 * (plain_force + before(plain_force)).T, dt).T
    return {
        "true_late": observer.smooth(before(recorded.hand).T, dt).T[recorded.index(t)],
        "modelled_late": modelled[np.rint((t - force.t[0]) / dt).astype(int)],
        "observed": seen.force[np.rint((t - seen.t[0]) / dt).astype(int)],
    }
