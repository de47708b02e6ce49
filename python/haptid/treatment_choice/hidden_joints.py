"""Logs of elastic motors without their links: positions of the joints behind springs, simulated, as more channels.

Initial values need no knowledge of the device: see `spring_start`. They are found on a part of one log; all logs then
determine the parameters, each as one motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.toml.reader import device_of
from haptid.dynamics.model import DynamicModel
from haptid.errors import (
    ConvergenceError,
    HaptidError,
    IdentifiabilityError,
    LogMismatchError,
    LogTimeError,
    SimulationError,
)
from haptid.estimation import WLS, Estimate, estimate
from haptid.estimation.methods.motor_side import MotorSide
from haptid.log import Log
from haptid.motion.channels import position_channels
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, observe
from haptid.simulation import smooth
from haptid.simulation.driven import MOST_PARTS
from haptid.treatment_choice.delay_estimate import usual_delay
from haptid.treatment_choice.elasticity import (
    expect_stiffness_of_motors,
    hidden_stiffness,
    noise_of_stiffness,
    with_bound,
)
from haptid.treatment_choice.motion_filters import MotionFilters
from haptid.treatment_choice.motor_delays import motor_delays
from haptid.treatment_choice.propose import TRIED, Proposal, propose
from haptid.treatment_choice.spring_bound import spring_bound
from haptid.treatment_choice.spring_start import SpringStart, spring_start
from haptid.treatment_choice.whitening import whitened_fit

# Least damping ratio of initial values.
_LEAST_DAMPING = 0.02
# Parallel filters that are tried until little of a stiffness is noise, over the proposed one, and such a share.
_FILTERS, _NOISE = (1.0, 2 / 3, 1 / 2, 1 / 3), 0.1
# Length of log that initial values are found on, s.
_SECONDS = 10.0
# Highest frequency of a link that is simulated from sample to sample, over the sampling rate.
_SAMPLED = 0.2
# In a trial of springs, at most: smaller steps for stiff dry friction of the links, so that it does not take minutes,
# and what initial values leave of the squared error of rigid motors.
_TRIED_PARTS, _TRIED_LEFT = 50, 0.5
# Passes of delays and parameters, at most.
_DELAYS = 8
# End of the names of the channels that are added.
_SIMULATED = " (simulated)"


def lacks_links(model: DynamicModel, log: Log) -> bool:
    """Whether a log of an elastic device has no positions of the joints that springs alone move."""
    every = position_channels(model.device, log.channels.position.side)
    idle = sum(drive.unloaded for drive in model.device.drives)
    return bool(idle) and log.position.shape[1] == len(every) - idle


def complete_logs(
    model: DynamicModel,
    logs: Sequence[Log],
    fitting: Sequence[bool],
    measured: Mapping[str, float] | None = None,
    trial: bool = False,
    **given: Any,
) -> tuple[list[Log], Estimate]:
    """The logs with positions of the joints that springs alone move, and the estimate that they are simulated with.

    Args:
        model: the dynamic model, with elastic motors.
        logs: recordings without positions of these joints.
        fitting: which of them the parameters are estimated from.
        measured: frequency of the link on the spring of each elastic motor by its frequency response, Hz, to begin
            with; None where there is none.
        trial: whether springs are only supposed: refused soon where they explain little, and without a bound.
        given: settings of `Treatment` that are fixed.

    Raises:
        IdentifiabilityError: the logs do not show the stiffness of a motor.
        LogMismatchError: the device has torque sensors, or a joint with a row of zero torque.
        HaptidError: as `propose` and `estimate`.
    """
    chosen = [log for log, own in zip(logs, fitting, strict=True) if own]
    if model.device.sensors:
        raise _without_links(model, logs[0])
    if any(drive.free for drive in model.device.drives):
        raise _beside_free_joints(model, logs[0])
    rigid = _without(model, "elastic")
    proposal = _proposed(rigid, chosen, given)
    treatment = _shared(proposal.treatment)
    part = chosen[0].busiest(_SECONDS)
    # All inertia in the links: which of the two a rigid model would have it in is a matter of the order of its terms.
    rigid_fit = estimate(_rows(_without(model, "elastic", "rotor-inertia"), [part], treatment), WLS())
    followed, method = [_followed(model, log) for log in chosen], MotorSide()
    # Behind narrow filters the share of noise no longer tells what noise does to several motors that inertia couples.
    several = len(model.device.elastic) > 1
    filters = (
        [treatment]
        if treatment.parallel_cutoff_hz is None or "parallel_cutoff_hz" in given or several
        else [replace(treatment, parallel_cutoff_hz=share * treatment.parallel_cutoff_hz) for share in _FILTERS]
    )
    if "reversal_guard_s" not in given:
        # A light rotor sticks at reversals, and what that does to the sign of its dry friction goes with its
        # acceleration. Whether joints stick was judged by rigid ones, behind another filter.
        motions = MotionFilters.of(rigid, tuple(chosen), given)
        filters = [motions.clear(own) for own in filters]
    frequencies, start = np.full(len(model.device.elastic), proposal.bandwidth_hz), None
    delays = "torque_delay_s" not in given
    try:
        # A fit that goes astray is known by its simulation, which diverges, or by its passes, which do not settle.
        with np.errstate(over="ignore", invalid="ignore"):
            motion = treat(_followed(model, part), filters[0])
            known = np.array([measured[drive.name] for drive in model.device.elastic]) if measured else None
            parts = _TRIED_PARTS if trial else MOST_PARTS
            begun = spring_start(rigid_fit, model, motion, proposal.bandwidth_hz, method.friction, known, parts)
            frequencies = begun.frequencies
            if trial:
                _expect_springs(begun, rigid_fit)
            start = begun
            _expect_between_samples(part, frequencies)
            found = _with_little_noise(model, followed, filters, start, delays)
        expect_stiffness_of_motors(found, proposal.bandwidth_hz)
    except (ConvergenceError, IdentifiabilityError, SimulationError) as error:
        weighed = None
        if start and several and "parallel_cutoff_hz" not in given:
            weighed = _weighed(model, followed, filters[-1], start, delays, proposal.bandwidth_hz)
        if weighed is None:
            if isinstance(error, IdentifiabilityError):
                made = hidden_stiffness(model, error, proposal.bandwidth_hz)
            else:
                made = _without_solution(chosen, frequencies, proposal.bandwidth_hz, error)
            if start is None or made is error or trial:
                raise made from None
            # No estimate is at hand: the bound is that at the initial values.
            rows = _rows(model, followed, filters[-1])
            bound = spring_bound(rows, _initial(rows, start), proposal.bandwidth_hz, delays=delays)
            raise with_bound(made, replace(bound, at=" at initial values") if bound else None) from error
        found = weighed
    return [_simulated(found, _followed(model, log), treatment) for log in logs], found


def _weighed(
    model: DynamicModel,
    logs: Sequence[Log],
    treatment: Treatment,
    start: SpringStart,
    delays: bool,
    highest: float,
) -> Estimate | None:
    """The estimate from rows that weigh each frequency by its noise; None where that does not show springs either."""

    def observed(treatment: Treatment) -> Observation:
        return _rows(model, logs, treatment)

    try:
        with np.errstate(over="ignore", invalid="ignore"):  # as of fits without weights
            found = whitened_fit(observed, treatment, _initial(observed(treatment), start), delays)
        expect_stiffness_of_motors(found, highest)
    except (ConvergenceError, IdentifiabilityError, SimulationError):
        return None
    return found


def _with_little_noise(
    model: DynamicModel, logs: Sequence[Log], filters: Sequence[Treatment], start: SpringStart, delays: bool
) -> Estimate:
    """The estimate behind the first filter that leaves little noise of the encoders in the columns of the stiffness.

    Args:
        delays: whether those of the torque are estimated.

    Raises:
        HaptidError: as `estimate`, behind the last filter.
    """
    initial, found = None, None
    for treatment in filters:
        known: dict[str, Any] = (
            {"torque_delay_s": found.observation.motions[0].treatment.torque_delay_s} if found else {}
        )
        observation = _rows(model, logs, replace(treatment, **known))
        initial = initial or _stable(observation, start)
        try:
            found = estimate(observation, MotorSide(initial=initial, delays=delays))
            # With a wrong delay damping is wrong, and with it what noise the links amplify.
            found = _with_delays(model, logs, found) if delays else found
        except (ConvergenceError, IdentifiabilityError, SimulationError):
            if treatment is filters[-1]:
                raise
            continue
        initial = dict(zip(found.names, found.beta.tolist(), strict=True))
        if noise_of_stiffness(found) <= _NOISE:
            break
    assert found is not None
    return found


def _with_delays(model: DynamicModel, logs: Sequence[Log], found: Estimate) -> Estimate:
    """The estimate with delays of the torque that are estimated from the same rows.

    Raises:
        ConvergenceError: delays and parameters do not settle.
        HaptidError: as `estimate`.
    """
    for _ in range(_DELAYS):
        delays = motor_delays(found)
        if delays.still:
            return found
        treatment = replace(found.observation.motions[0].treatment, torque_delay_s=delays.setting)
        initial = dict(zip(found.names, delays.beta.tolist(), strict=True))
        found = estimate(_rows(model, logs, treatment), MotorSide(initial=initial, delays=True, near=found.fit))
    raise ConvergenceError(
        f"the delay of the torque and the parameters do not settle within {_DELAYS} passes.",
        where="torque_delay_s",
        found=float(np.max(delays.seconds)),
        advice="Give torque_delay_s.",
    )


def _proposed(rigid: DynamicModel, logs: Sequence[Log], given: Mapping[str, Any]) -> Proposal:
    """Proposed treatment for the rows of motors whose links are simulated: filters of elastic devices."""
    # A spring and a delay turn the torque's phase alike where motion is slow: the delay is estimated with the spring.
    settings = {"torque_delay_s": usual_delay(logs), **given}
    proposal = propose(rigid, *logs, **settings)
    if not {"parallel_cutoff_hz", "cutoff_hz", "decimation"}.isdisjoint(given):
        return proposal
    narrow = MotionFilters.of(rigid, tuple(logs), settings).parallel(TRIED[0])
    if proposal.treatment.parallel_cutoff_hz in (None, narrow):
        return proposal
    return propose(rigid, *logs, **settings, parallel_cutoff_hz=narrow)


def _initial(observation: Observation, start: SpringStart) -> Array:
    """Base parameters to begin with, (p,)."""
    return np.array(list(_stable(observation, start).values()))


def _stable(observation: Observation, start: SpringStart) -> dict[str, float]:
    """Base parameters by name, their friction not below zero, and with damping enough for stable simulations."""
    found = dict(zip(observation.base.names, start.beta.tolist(), strict=True))
    names, model = {name.removesuffix("R"): name for name in found}, observation.model
    for term in model.terms:
        if term.resists and term.name in names:
            found[names[term.name]] = max(found[names[term.name]], 0.0)
    for drive, frequency in zip(model.device.elastic, start.frequencies.tolist(), strict=True):
        own = {t.nature: names[t.name] for t in model.terms if t.on == f"elastic {drive.name}" and t.name in names}
        if "spring" in own and "viscous" in own and np.isfinite(frequency):
            least = 2 * _LEAST_DAMPING * found[own["spring"]] / (2 * np.pi * frequency)
            found[own["viscous"]] = max(found[own["viscous"]], least)
    return found


def _without(model: DynamicModel, *kinds: str) -> DynamicModel:
    """The same device without terms of some kinds; its motors are rigid without elastic ones."""
    tables = model.device.tables
    terms = [term for term in tables.terms if term.kind not in kinds]
    return DynamicModel(device_of(tables.model_copy(update={"terms": terms}), model.device.name))


def _shared(treatment: Treatment) -> Treatment:
    """One value for all channels where there is one for each."""
    slow, cutoff = np.max(treatment.reversal_speed), treatment.cutoff_hz
    return replace(
        treatment,
        reversal_speed=float(slow),
        rest_speed=float(np.max(treatment.rest_speed)),
        cutoff_hz=None if cutoff is None else float(np.max(cutoff)),
        torque_delay_s=float(np.median(treatment.torque_delay_s)),
    )


def _rows(model: DynamicModel, logs: Sequence[Log], treatment: Treatment) -> Observation:
    return observe(model, *(treat(log, treatment) for log in logs))


def _followed(model: DynamicModel, log: Log) -> Log:
    """The log with links that follow their motors as if the springs were rigid."""
    device = model.device
    known = _known(model, log)
    side = log.channels.position.side
    ratios = [drive.gear_ratio if side == "motor" else 1.0 for drive in device.elastic]
    rotors = [
        known.index(drive.name if side == "motor" else device.joints[drive.first].name) for drive in device.elastic
    ]
    load = np.array([np.asarray(log.position[:, k]) / ratio for k, ratio in zip(rotors, ratios, strict=True)])
    active = list(device.active)
    own = [active.index(drive.first) for drive in device.drives if drive.unloaded]
    rates = np.array([(drive.row - drive.torsion) @ device.closure.constant for drive in device.elastic])
    offset = np.array([(drive.row - drive.torsion) @ device.closure.offset for drive in device.elastic])
    rigid = [k for k in range(len(active)) if k not in own and rates[:, k].any()]
    for k in rigid:
        place = known.index(device.joints[active[k]].name)
        load = load - np.outer(rates[:, k], np.asarray(log.position[:, place]))
    links = np.linalg.pinv(rates[:, own]) @ (load - offset[:, None])
    return _with_channels(model, log, links)


def _known(model: DynamicModel, log: Log) -> list[str]:
    """Names of the position channels that the log has, in its order."""
    side = log.channels.position.side
    idle = _idle(model, side)
    return [name for name in position_channels(model.device, side) if name not in idle]


def _idle(model: DynamicModel, side: str) -> dict[str, str]:
    """Names of the position channels of joints that springs alone move, with their units."""
    drives = [drive for drive in model.device.drives if drive.unloaded]
    joints = [model.device.joints[drive.first] for drive in drives]
    names = [drive.name if side == "motor" else joint.name for drive, joint in zip(drives, joints, strict=True)]
    return {name: "m" if joint.prismatic else "rad" for name, joint in zip(names, joints, strict=True)}


def _with_channels(model: DynamicModel, log: Log, links: Array) -> Log:
    """The log with positions of the joints that springs alone move, (u, samples), in the device's order."""
    device, position = model.device, log.channels.position
    known, names = _known(model, log), position_channels(device, position.side)
    idle = [name for name in names if name not in known]
    made = np.empty((len(log.t), len(names)))
    channels = []
    for k, name in enumerate(names):
        hidden = name in idle
        made[:, k] = links[idle.index(name)] if hidden else log.position[:, known.index(name)]
        channels.append(f"{name}{_SIMULATED}" if hidden else position.channels[known.index(name)])
    units = dict(zip(known, position.each_unit, strict=True)) | _idle(model, position.side)
    each = tuple(units[name] for name in names) if position.units else ()
    signal_ = replace(position, channels=tuple(channels), units=each, gain=(), offset=())
    return replace(log, position=made, channels=replace(log.channels, position=signal_))


def _simulated(found: Estimate, log: Log, treatment: Treatment) -> Log:
    """The log with links simulated along its motors with the estimated parameters."""
    model, method = found.model, found.method
    assert isinstance(method, MotorSide)
    motion = treat(log, replace(treatment, torque_delay_s=0.0))  # a delay would shift the positions
    joints = method.joints(smooth(model, [motion], method.friction), motion)
    course = joints.met(found.beta)
    made = np.array(log.position)
    hidden = [k for k, name in enumerate(log.channels.position.channels) if name.endswith(_SIMULATED)]
    made[:, hidden] = np.linalg.solve(model.device.row_map, course.c)[joints.unknown].T
    return replace(log, position=made)


def _expect_springs(start: SpringStart, rigid: Estimate) -> None:
    """Raise IdentifiabilityError where initial values of springs leave much of what rigid motors leave."""
    motors = rigid.observation.motors
    left = sum(m.residual(rigid.beta) ** 2 / max(m.size(rigid.beta), 1e-300) ** 2 for m in motors) / len(motors)
    if start.misfit > _TRIED_LEFT * left:
        raise IdentifiabilityError(
            f"springs leave {start.misfit / left:.2g} of the squared error of rigid motors (limit {_TRIED_LEFT:g}).",
            where="springs",
            found=start.misfit / left,
            limit=_TRIED_LEFT,
            advice="The error has another cause.",
        )


def _expect_between_samples(log: Log, frequencies: Array) -> None:
    """Raise LogTimeError where the frequency of a link is higher than the sampling rate permits."""
    highest, found = _SAMPLED * log.rate_hz, float(np.nanmax(frequencies, initial=0.0))
    if found > highest:
        raise LogTimeError(
            f"{log.path.name} has {log.rate_hz:.4g} samples a second: too few for the resonance of a link that is not "
            f"measured, which is near {found:.3g} Hz (limit {_SAMPLED:g} of the rate).",
            where=log.path.name,
            found=log.rate_hz,
            limit=found / _SAMPLED,
            advice=f"Record at {found / _SAMPLED:.3g} Hz or more, or positions of the joints too.",
        )


def _without_links(model: DynamicModel, log: Log) -> LogMismatchError:
    """The error of a log with torque sensors and without positions of the links."""
    every = position_channels(model.device, log.channels.position.side)
    return LogMismatchError(
        f"{log.path.name} has torque sensors behind springs, and {log.position.shape[1]} position channels; "
        f"with a torque sensor, positions of both sides are required: {', '.join(every)}.",
        where="position",
        found=log.position.shape[1],
        limit=len(every),
        advice="Record the joints' positions too; or write sensor = false and leave the sensors' channels out, and "
        "stiffness is found from the motors alone.",
    )


def _beside_free_joints(model: DynamicModel, log: Log) -> LogMismatchError:
    """The error of a log without positions of the links, of a device with rows of zero torque."""
    every, device = position_channels(model.device, log.channels.position.side), model.device
    free = ", ".join(f"joint {drive.name}" for drive in device.drives if drive.free)
    return LogMismatchError(
        f"{log.path.name} has {log.position.shape[1]} position channels, and no positions behind the springs. Links "
        f"are simulated there, and the row of {free} has zero torque at any scale of what is simulated.",
        where="position",
        found=log.position.shape[1],
        limit=len(every),
        advice=f'Record positions of both sides: {", ".join(every)}; or leave torque = "zero" out, and what the motors '
        "alone tell of that joint is found.",
    )


def _without_solution(
    logs: Sequence[Log], frequencies: Array, highest: float, error: HaptidError
) -> IdentifiabilityError:
    """The error of logs from which the estimation of stiffness does not converge."""
    tried = ", ".join(f"{f:.3g}" for f in frequencies)
    why = str(error).removesuffix(error.advice).strip()
    why = f"{why[:1].upper()}{why[1:]}"
    return IdentifiabilityError(
        f"{logs[0].path.name}: no stiffness is found from the motors' positions alone, with motion up to {highest:.3g} "
        f"Hz. Frequencies of the links on their springs came out as {tried} Hz. {why}",
        where=logs[0].path.name,
        found=highest,
        advice=f"Excite up to {2 * highest:.3g} Hz, or record positions of the joints too. If that shows nothing "
        "either, the motors are rigid for such motion: remove the elastic terms.",
    )
