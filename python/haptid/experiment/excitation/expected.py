"""Treatment and noise that are expected of the log of a planned motion, from the instruments, before there is a log.

Positions of the planned motion are rounded by the encoders, its torques have the amplifiers' noise. A treatment and an
identification make of these what they make of the log; there is no controller and no simulator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from haptid.dynamics.inverse import inverse_dynamics
from haptid.errors import HaptidError
from haptid.estimation import estimate
from haptid.estimation.methods.wls import WLS
from haptid.experiment.bench.run import active_names, joint_unit
from haptid.experiment.bench.setup import Setup
from haptid.experiment.bench.trajectories import per_coordinate
from haptid.experiment.excitation.planned import Excitation, PlannedMotion
from haptid.experiment.excitation.sequential import FurtherMotions, LogInformation, with_motions
from haptid.experiment.excitation.treated import TreatedNoise
from haptid.log import Channels, Log, Signal
from haptid.motion.motion import treat
from haptid.observation.observation import observe
from haptid.treatment_choice import propose, with_treatment_uncertainty

# Variance of rounding, squared steps.
_ROUNDED = 1 / 12
# Draws of the noise whose residuals are taken together: the spectrum of a single one scatters by a factor of two.
_DRAWS = 8


def expected_log(setup: Setup, planned: PlannedMotion, seed: int = 0) -> Log:
    """The log of a planned motion that is followed exactly: positions by the encoders, commands with noise.

    Noise of the actual torque and the rounding of commands are in the commands; of a log of one control period in
    several they count by the mean of these periods, as the motion does.

    Args:
        setup: true parameters, sampling rate and instruments; its device has no elastic motors.
        seed: of the noise, and of where the steps of the encoders lie.
    """
    model, device, every = setup.model, setup.model.device, setup.controller.log_every
    made = planned.trajectory(every * setup.dt)
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (made.q, made.qd, made.qdd))
    tau = inverse_dynamics(model, model.base.of(setup.chi), q, qd, qdd)
    torque = device.drive_torque(device.row_map @ q, tau).T
    motors = [drive.name for drive in device.motors]
    noise, step = (per_coordinate(name, getattr(setup.amplifiers, name), motors) for name in ("noise", "step"))
    scatter = np.sqrt((noise**2 + _ROUNDED * step**2) / every)
    rng = np.random.default_rng(seed)
    torque = torque + scatter * rng.standard_normal(torque.shape)
    c = device.closure.follow(q).q.T @ device.drive_rows.T
    if (count := setup.encoders.step(model)) is not None:
        c = count * (np.rint(c / count + (shift := rng.random(len(count)))) - shift)
    names = active_names(model)
    position = Signal(
        tuple(f"q{name}" for name in names), "rad", units=tuple(joint_unit(model, j) for j in device.active)
    )
    command = Signal(
        tuple(f"command{k + 1}" for k in range(len(motors))),
        "N m",
        side="motor",
        units=tuple(drive.command_unit for drive in device.motors),
    )
    units = [drive.gear_ratio * drive.torque_constant for drive in device.motors]
    channels = Channels(position, command, time="t")
    return Log(Path("expected"), "", made.t, c @ device.active_from_drives.T, torque / units, channels)


def expected_noise(
    setup: Setup, planned: PlannedMotion, given: Mapping[str, Any] | None = None, seed: int = 0
) -> TreatedNoise | None:
    """Treatment of the expected log of a planned motion, and the noise that it leaves in the rows.

    Args:
        setup: true parameters, sampling rate and instruments.
        given: settings of `Treatment` that are fixed; the others are proposed from the expected log.
        seed: of the noise.

    Returns:
        None where instruments are exact, motors are elastic, or too little is left of the motion to identify from.
    """
    exact = setup.encoders.counts_per_turn is None and not any((*setup.amplifiers.noise, *setup.amplifiers.step))
    if exact or setup.model.device.elastic:
        return None
    model, logs = setup.model, [expected_log(setup, planned, _DRAWS * seed + k) for k in range(_DRAWS)]
    try:
        proposal = propose(model, logs[0], **(given or {}))
        found = [estimate(observe(model, treat(log, proposal.treatment)), WLS()) for log in logs]
        unsure = with_treatment_uncertainty(found[0], proposal.delays, proposal.effects, proposal.rounding)
        return replace(TreatedNoise.of(*found), shifts=unsure.shifts)
    except HaptidError:
        return None


def expected_information(setup: Setup, noise: TreatedNoise) -> LogInformation:
    """No log yet, the true values of a set-up, and the noise that is expected."""
    none = LogInformation.none(setup.model, setup.model.base.of(setup.chi))
    step = noise.dt * noise.treatment.decimation
    return replace(none, noise=np.sqrt(np.array(noise.variances) * step), treated=noise)


def expected_motions(
    setup: Setup,
    noise: TreatedNoise,
    motions: Sequence[Excitation],
    parameters: Sequence[str] | None = None,
    accuracy: float | None = None,
) -> FurtherMotions:
    """What motions are predicted to bring before there is a log.

    Args:
        setup: true parameters.
        noise: expected of a log.
        motions: one at least.
        parameters: names of those that count; default: all that have a value.
        accuracy: wanted half width of every interval, per cent of the value.
    """
    known = expected_information(setup, noise)
    return replace(with_motions(known, motions, parameters or known.valued, accuracy), basis=basis(noise))


def basis(noise: TreatedNoise) -> str:
    """The sentence on expected noise and treatment."""
    treatment = noise.treatment
    cutoff = treatment.cutoff_hz if isinstance(treatment.cutoff_hz, tuple) else (treatment.cutoff_hz,)
    low, high = (f"{x:.3g}" for x in (min(c or 0.0 for c in cutoff), max(c or 0.0 for c in cutoff)))
    positions = f"positions filtered at {low if low == high else f'{low} to {high}'} Hz" if high != "0" else "no filter"
    rows = f"{1 / (noise.dt * treatment.decimation):.3g} rows a second"
    return (
        f"The intervals are those expected of the experiment's encoders, amplifiers and sampling rate, behind the "
        f"treatment that such a log will get: {positions}, {rows}."
    )
