"""Other laws of the identified model in a hand: weight and friction compensation, and inverse-dynamics control."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.cea_branches.compensation import HandTrial, hand_trial
from haptid.demos.cea_branches.plan import Compensating, Sweep
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import apparent_mass
from haptid.end_effector.compensation import Compensation, InverseDynamics, JudgedLaw, judge_law
from haptid.estimation import Estimate
from haptid.experiment.bench.hand import HandleImpedance, Stroke, measure_impedance
from haptid.experiment.bench.setup import Controller, Setup
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Share of friction that is compensated, and natural frequency of the tracking error.
_FRICTION, _NATURAL_HZ = 0.7, 5.0
# The motion that is tracked: amplitude of every joint, rad, frequency, Hz, duration, s, and what is left out of it.
_AMPLITUDE, _HZ, _SECONDS, _SETTLED = 0.15, 1.0, 3.0, 1.0


@dataclass(frozen=True, eq=False)
class LawInHand:
    """A law, judged at all poses and tried on the bench at the middle one, dry friction and encoders on.

    Attributes:
        name: of the law.
        judged: verdicts with the published hands.
        felt: by a guide along the largest mass; the stiffness is zero where the law has no spring.
        stiff: the stiffest hand of the published range moves the handle.
        tracking: rms error of the handle along a planned motion, m; None of a law without a plan.
    """

    name: str
    judged: JudgedLaw
    felt: HandleImpedance
    stiff: HandTrial
    tracking: float | None


def other_laws(plan: Compensating, sweep: Sweep, estimated: Estimate, bench: Setup) -> tuple[LawInHand, ...]:
    """The laws at the poses of the plan."""
    angles = {"degrees": (plan.degrees[0], plan.degrees[-1]), "poses": len(plan.degrees)}
    qa = sweep.model_copy(update=angles).along(estimated.model)
    middle = qa.shape[1] // 2
    pose, direction = qa[:, middle], apparent_mass(estimated, qa).directions[middle, 0]
    laws: dict[str, Compensation | InverseDynamics] = {
        "weight": Compensation(estimated, 0.0),
        f"weight, {100 * _FRICTION:.0f} % of friction": Compensation(estimated, 0.0, friction=_FRICTION),
        f"inverse dynamics, {_NATURAL_HZ:g} Hz": InverseDynamics(estimated, _NATURAL_HZ, friction=1.0),
    }
    # A third harmonic tells a spring from mass; where there is none, dry friction would be taken for one.
    amplitude, springs = plan.speed / (2 * np.pi * plan.felt_hz), {Compensation: 0.0, InverseDynamics: 0.25}
    return tuple(
        LawInHand(
            name,
            judge_law(law, qa, bench.dt, bench.amplifiers.delay, felt_hz=plan.felt_hz),
            measure_impedance(bench, pose, direction, law, Stroke(amplitude, plan.felt_hz, third=springs[type(law)])),
            hand_trial(plan, bench, "stiff", name, law, pose, direction),
            _tracking(law, pose, bench) if isinstance(law, InverseDynamics) else None,
        )
        for name, law in laws.items()
    )


def _tracking(law: InverseDynamics, pose: Array, bench: Setup) -> float:
    """Rms error of the handle along raised cosines of all joints, which begin at rest at a pose, m."""
    w, ones = 2 * np.pi * _HZ, np.ones(len(pose))

    def planned(t: float) -> tuple[Array, Array, Array]:
        c, s = np.cos(w * t), np.sin(w * t)
        return pose + _AMPLITUDE * (1 - c) * ones, _AMPLITUDE * w * s * ones, _AMPLITUDE * w**2 * c * ones

    t = bench.dt * np.arange(round(_SECONDS / bench.dt))
    q, qd, qdd = (np.array(x) for x in zip(*map(planned, t.tolist()), strict=True))
    off = Controller((0.0,), (0.0,), rate_hz=bench.controller.rate_hz, tracking_limit=np.inf)
    alone = replace(bench, controller=off, law=replace(law, plan=planned))
    moved = simulate(alone, Trajectory(bench.dt, q, qd, qdd), np.random.default_rng(0))
    model, late = law.identified.model, t >= _SETTLED
    found, wanted = (handle_motion(model, x.T).position[late] for x in (moved.q[:, list(model.device.active)], q))
    return float(np.sqrt(np.mean(np.sum((found - wanted) ** 2, axis=1))))
