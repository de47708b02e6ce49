"""Mass compensation that a hand can hold: the search for settings, and the bench with friction and hands."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.cea_branches.plan import Compensating, Sweep
from haptid.end_effector.characterisation import apparent_mass
from haptid.end_effector.compensation import (
    STIFF_HAND,
    TYPICAL_HAND,
    Compensation,
    CompensationDesign,
    DesignPoint,
    InverseDynamics,
    design_compensation,
)
from haptid.estimation import Estimate
from haptid.experiment.bench.hand import (
    HandleImpedance,
    Stroke,
    along_line,
    guided,
    impedance_curve,
    impedance_of,
    measure_impedance,
)
from haptid.experiment.bench.setup import Setup

# Hands of the trials on the bench.
HANDS = {"typical": TYPICAL_HAND, "stiff": STIFF_HAND}
# Periods of a stroke, the first one is left out of the fit.
_PERIODS = 4


@dataclass(frozen=True, eq=False)
class HandTrial:
    """A hand that moves the handle on the bench.

    Attributes:
        hand: its name.
        law: name of the law.
        predicted: spectral radius of the linear loop at the pose; below 1 is stable.
        power: mean power that the hand gets, W; negative where it gives.
        unrest: rms of the handle's speed above the hand's frequencies, m/s.
    """

    hand: str
    law: str
    predicted: float
    power: float
    unrest: float


@dataclass(frozen=True, eq=False)
class Compensated:
    """Compensation at some poses, dry friction and encoders as they are.

    Attributes:
        degrees: of the sweep's joint, as plotted, (poses,).
        estimated: largest apparent mass of the model, kg.
        design: the search, by the identified parameters at all poses.
        chosen: its point with the wanted reduction and the least damping; None where there is none.
        laws: by name: "weight only", "mass alone" (the chosen share by the default filters, no damping), "chosen".
        felt: impedance on the bench at every pose, by law, at the frequency of the search.
        promised: felt mass and damping there by the model, (poses, 2), by law.
        curves: impedance over frequency at the middle pose, by law.
        trials: hands that move the handle at the middle pose.
    """

    degrees: Array
    estimated: Array
    design: CompensationDesign
    chosen: DesignPoint | None
    laws: dict[str, Compensation]
    felt: dict[str, tuple[HandleImpedance, ...]]
    promised: dict[str, Array]
    curves: dict[str, tuple[HandleImpedance, ...]]
    trials: tuple[HandTrial, ...]


def compensated(plan: Compensating, sweep: Sweep, estimated: Estimate, bench: Setup) -> Compensated:
    """Search settings by the identified parameters, and try them on the bench."""
    angles = {"degrees": (plan.degrees[0], plan.degrees[-1]), "poses": len(plan.degrees)}
    qa = sweep.model_copy(update=angles).along(estimated.model)
    mass = apparent_mass(estimated, qa)
    design = design_compensation(
        Compensation(estimated),
        qa,
        bench.dt,
        bench.amplifiers.delay,
        felt_hz=plan.felt_hz,
        velocity_cutoffs_hz=plan.velocity_cutoffs_hz,
        momentum_cutoffs_hz=plan.momentum_cutoffs_hz,
        shares=plan.shares,
    )
    chosen = design.best(plan.reduction)
    share = chosen.law.share if chosen else plan.reduction
    laws = {"weight only": Compensation(estimated, 0.0), "mass alone": Compensation(estimated, share)}
    laws |= {"chosen": chosen.law} if chosen else {}
    poses = list(zip(qa.T, mass.directions[:, 0], strict=True))
    middle = poses[len(poses) // 2]
    stroke = Stroke(plan.speed / (2 * np.pi * plan.felt_hz), plan.felt_hz, _PERIODS / plan.felt_hz, 0.0)
    return Compensated(
        degrees=np.array(plan.degrees),
        estimated=mass.mass.values[:, 0],
        design=design,
        chosen=chosen,
        laws=laws,
        felt={
            name: tuple(measure_impedance(bench, *pose, law, stroke) for pose in poses) for name, law in laws.items()
        },
        promised={
            name: np.array([_predicted(law, *pose, plan.felt_hz, bench) for pose in poses])
            for name, law in laws.items()
        },
        curves={
            name: impedance_curve(bench, *middle, plan.frequencies_hz, law, plan.speed, _PERIODS)
            for name, law in laws.items()
        },
        trials=tuple(hand_trial(plan, bench, hand, name, law, *middle) for hand in HANDS for name, law in laws.items()),
    )


def _predicted(law: Compensation, pose: Array, direction: Array, hz: float, bench: Setup) -> Array:
    """Felt mass and damping along a direction with none across, (2,), kg and N s/m."""
    Z = law.loop(pose, bench.dt, bench.amplifiers.delay).impedance(np.array([hz]))[0]
    projected = direction @ Z @ direction
    return np.array([projected.imag / (2 * np.pi * hz), projected.real])


def hand_trial(
    plan: Compensating,
    bench: Setup,
    hand: str,
    name: str,
    law: Compensation | InverseDynamics,
    pose: Array,
    direction: Array,
) -> HandTrial:
    """One hand moves the handle at the greatest frequency of the plan."""
    hz, model = max(plan.frequencies_hz), HANDS[hand]
    stroke = Stroke(plan.speed / (2 * np.pi * hz), hz, plan.seconds, 0.0, model)
    motion = guided(bench, pose, direction, law, stroke)
    impedance = impedance_of(bench, motion, pose, direction, stroke)
    _, speed, _, _ = along_line(bench, motion, pose, direction)
    loop = law.loop(pose, bench.dt, bench.amplifiers.delay)
    return HandTrial(hand, name, loop.spectral_radius(model), impedance.power, _above(speed, 4 * hz, bench.dt))


def _above(values: Array, hz: float, dt: float) -> float:
    """Rms of the second half of a signal above a frequency."""
    from scipy import signal

    passed = signal.sosfiltfilt(signal.butter(4, hz, "high", fs=1 / dt, output="sos"), values)
    return float(np.sqrt(np.mean(passed[len(passed) // 2 :] ** 2)))
