"""What logs tell at best of elastic motors: the Cramer-Rao bound of stiffness and damping, and what would lower it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.roots import bracketed_root
from haptid.device.parts import Motor
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import HaptidError, SimulationError
from haptid.estimation.methods.motor_side import MotorSide
from haptid.estimation.methods.simulation_based import base_columns
from haptid.log.spectrum import spectra
from haptid.motion.channels import channel_shares, coordinate_torque, coordinates
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.simulation import smooth
from haptid.simulation.driven import DrivenCourse
from haptid.simulation.driven_noise import encoder_density
from haptid.simulation.information import fisher_information, residual_noise, spectrum_of
from haptid.simulation.loop import behind_position_filter
from haptid.simulation.small_motion import SmallMotion
from haptid.treatment_choice.delay_estimate import delay_prior
from haptid.uncertainty.figures import per_cent

# Standard errors of stiffness and damping that are wanted, per cent.
WANTED = {"spring": 2.0, "viscous": 10.0}
# Highest frequency that counts, over that of the motion: as far as rows are filtered.
_BAND = 1.5
# Encoders and speeds that are tried, over those of the log, and the longest log that is advised, over the one at hand.
_FINER, _FASTER, _LONGER = (2, 4, 8, 16, 32, 64), (1.25, 1.5, 2.0, 3.0), 20.0
# Fewest samples in a period of the fastest motion.
SAMPLES = 7.0
# Frequency above which the torque is noise, over that of the motion.
_ABOVE = 3.0
# Least density of the torque's noise, over that of white noise with the torque's square.
_LEAST_NOISE = 1e-8
# Fewest steps of an encoder in the root mean square of a motion: with fewer their errors are no noise beside it.
_STEPS = 10.0
# Share of the encoders' noise in what tells a parameter from which on nothing is said of the rest: behind encoders of
# which the torsion is two steps the bound would come out at half of what it is.
_MOST_NOISE = 0.25
# Singular values of the information below this share of the largest are rounding.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class SpringBound:
    """Least standard errors that a method can reach on logs.

    Attributes:
        names: of the base parameters of springs and dampers.
        least: their standard errors, per cent of their values; infinite where the log tells nothing of one.
        wanted: the same, as they are wanted.
        highest: frequency up to which the log was taken, Hz.
        at: at which parameters, as a text; empty for those of an estimate.
        enough: what would make all as wanted, as a text; empty where nothing that was tried does.
    """

    names: tuple[str, ...]
    least: Array
    wanted: Array
    highest: float
    at: str = ""
    enough: str = ""

    @property
    def whole(self) -> bool:
        """Whether the log tells something of each."""
        return bool(np.isfinite(self.least).all())

    @property
    def reached(self) -> bool:
        """Whether all are as wanted."""
        return bool((self.least <= self.wanted).all())

    @property
    def sentence(self) -> str:
        """The bound as text."""
        told = [
            f"{name} {per_cent(least)}" if np.isfinite(least) else f"{name} hidden"
            for name, least in zip(self.names, self.least, strict=True)
        ]
        return (
            f"At best, by any method, motion up to {self.highest:.3g} Hz tells with standard errors of (Cramer-Rao "
            f"bound{self.at}) {', '.join(told)}."
        )

    @property
    def advice(self) -> str:
        """What would make all as wanted, as a sentence; empty where they are, and where noise is all there is."""
        if self.reached or not self.whole:
            return ""
        wanted = "2 % of stiffness and 10 % of damping"
        if not self.enough:
            tried = "nothing that was tried, no finer encoders and no faster motion,"
            return f"By the same bound{self.at} {tried} gives {wanted}."
        return f"By the same bound{self.at} {wanted} are within reach with {self.enough}."


def spring_bound(
    rows: Observation,
    beta: Array,
    highest: float,
    links: bool = False,
    delays: bool = True,
    remedies: bool = True,
) -> SpringBound | None:
    """The bound of logs at some parameters; None where it cannot be computed there.

    Args:
        rows: of the logs.
        beta: base parameters, (p,), SI.
        highest: frequency that the motion goes up to, Hz.
        links: whether the links' positions were measured, and are not simulated.
        delays: whether the torque's delay is to be found from the same rows.
        remedies: whether what would lower the bound is tried.
    """
    device = rows.model.device
    logs = [motion.log for motion in rows.motions]
    if device.sensors or device.torque_rows != "motor" or any(log is None for log in logs):
        return None
    names, wanted = zip(*_springs(rows.model), strict=True)
    if any(own.motion_rms < _STEPS * own.step for log in logs if log for own in spectra(log)):
        return None
    try:
        found = [_Source.of(rows.model, beta, motion, highest, links, delays) for motion in rows.motions]
        made = SpringBound(names, _least(found, names, _BAND * highest), np.array(wanted), _BAND * highest)
        return (
            made
            if made.reached or not (made.whole and remedies)
            else replace(made, enough=_enough(found, made, highest))
        )
    except (HaptidError, np.linalg.LinAlgError):
        return None


def residual_density(model: DynamicModel, beta: Array, motion: Motion, delays: bool, f: Array) -> Array:
    """Density of each motor's residual over that of its torque's noise, whose links are simulated, (motors, k).

    Args:
        beta: base parameters, (p,), SI.
        motion: of a log.
        delays: whether the torque's delay is to be found.
        f: frequencies, (k,), Hz.
    """
    highest = (motion.treatment.parallel(float(motion.dt)) or 0.5 / float(motion.dt)) / _BAND
    source = _Source.of(model, beta, motion, highest, False, delays)
    noise = np.diagonal(residual_noise(source.rows.linear, f, source.noise), axis1=1, axis2=2).real.T
    return np.asarray(1.0 + noise / np.diag(source.torque)[:, None])


def _springs(model: DynamicModel) -> Iterator[tuple[str, float]]:
    """Names of the springs' and dampers' base parameters, with the standard errors that are wanted, per cent."""
    for drive in model.device.elastic:
        for nature, wanted in WANTED.items():
            for name in parameters_of(model, drive, nature):
                yield name, wanted


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows along one motion, and their linearised model.

    Attributes:
        linear: the model.
        J: derivatives of the rows' torque by base parameters and by the delays of channels, (rows, columns, samples).
        error: measured torque less that of the model, (rows, samples), N m or N.
        shares: torque of the rows by that of the channels, (rows, channels).
    """

    linear: SmallMotion
    J: Array
    error: Array
    shares: Array

    @staticmethod
    def of_motors(model: DynamicModel, beta: Array, motion: Motion, delays: bool) -> _Rows:
        """Rows of the motors, whose links are simulated along them."""
        joints = MotorSide().joints(smooth(model, [motion], MotorSide().friction), motion)
        course = joints.met(beta)
        if not joints.meets:
            raise SimulationError("the segments of the simulated links do not meet.", where=motion.name)
        linear = SmallMotion.along(model, base_columns(model), beta, motion, joints.unknown, joints.motors)
        measured = behind_position_filter(motion, joints.measured)
        shares = channel_shares(model.device, motion, course.c).mean(axis=0)[:, joints.motors].T
        late = joints.beside_start(course, _late(shares, course.torque[joints.motors], motion))
        J = np.concatenate([course.slope, late[:, : late.shape[1] * delays]], axis=1)
        return _Rows(linear, J, (measured - course.torque)[joints.motors], shares)

    @staticmethod
    def of_both(model: DynamicModel, beta: Array, motion: Motion, delays: bool, course: DrivenCourse | None) -> _Rows:
        """All rows, along measured positions or along a course of the links."""
        device, (low, high), base = model.device, motion.usable, base_columns(model)
        at = (course.c, course.cd, course.cdd) if course else coordinates(device, motion, low, high)
        rows = np.flatnonzero(device.measured).tolist()
        linear = SmallMotion.along(model, base, beta, motion, np.zeros(0, dtype=int), rows)
        J = regressor_columns(model, *at, base)[rows]
        torque = np.tensordot(J, beta, (1, 0))
        measured = behind_position_filter(motion, coordinate_torque(device, motion, 0, len(motion)))[rows]
        shares = channel_shares(device, motion, at[0]).mean(axis=0)[:, rows].T
        own = [rows.index(device.row_names.index(drive.name)) for drive in device.drives if drive.motorised]
        late = _late(shares, torque[own], motion)
        J = np.concatenate([J, late[:, : late.shape[1] * delays]], axis=1)
        return _Rows(linear, J, (measured if course else measured[:, low:high]) - torque, shares)


def _late(shares: Array, torque: Array, motion: Motion) -> Array:
    """Derivatives of the rows' torque by the delays of channels, (rows, channels, samples); torque of the channels."""
    return np.asarray(shares[:, :, None] * np.gradient(torque, float(motion.dt), axis=1))


@dataclass(frozen=True, eq=False)
class _Source:
    """One motion: its rows and the noise in them.

    Attributes:
        links, delays: as `spring_bound` takes them.
        torque: density of the noise of the rows' torque, (rows, rows), (N m)^2/Hz.
        noise: frequencies and densities of the position channels.
    """

    model: DynamicModel
    beta: Array
    motion: Motion
    links: bool
    delays: bool
    rows: _Rows
    torque: Array
    noise: tuple[Array, Array]

    @staticmethod
    def of(model: DynamicModel, beta: Array, motion: Motion, highest: float, links: bool, delays: bool) -> _Source:
        """Of a log whose motion goes up to a frequency, Hz."""
        if links:
            rows = _Rows.of_both(model, beta, motion, delays, None)
        else:
            rows = _Rows.of_motors(model, beta, motion, delays)
        dt, noise, device = float(motion.dt), encoder_density(motion), model.device
        f, E = spectrum_of(rows.error, dt, _BAND * highest)
        S, square = residual_noise(rows.linear, f, noise), 2 * dt / rows.error.shape[1] * np.abs(E) ** 2
        motors = [device.row_names.index(drive.name) for drive in device.drives if drive.motorised]
        own = [list(rows.linear.rows).index(k) for k in motors]
        measured = coordinate_torque(device, motion, 0, len(motion))[motors]
        # Above the motion is noise alone, and what the controller makes of the encoders'.
        f, U = spectrum_of(measured - measured.mean(axis=1, keepdims=True), dt, 0.5 / dt)
        above = 2 * dt / measured.shape[1] * np.abs(U[:, f > _ABOVE * highest]) ** 2
        least = 2 * dt * _LEAST_NOISE * np.mean(measured**2, axis=1)
        most = np.maximum(np.median(above, axis=1) / np.log(2), least)
        density = np.clip([_white(square[k], S[:, k, k].real) for k in own], least, most)
        return _Source(
            model, beta, motion, links, delays, rows, rows.shares @ (density[:, None] * rows.shares.T), noise
        )

    def faster(self, times: float) -> _Source:
        """The same motion of the motors, played faster, in as long a log."""
        model, motion, beta = self.model, self.motion, self.beta
        rates = (times * motion.qd, times**2 * motion.qdd)
        played = replace(motion, dt=float(motion.dt) / times, rates=rates, _shared={})
        if not self.links:
            return replace(self, motion=played, rows=_Rows.of_motors(model, beta, played, self.delays))
        joints = MotorSide().joints(smooth(model, [played], MotorSide().friction), played)
        rows = _Rows.of_both(model, beta, played, self.delays, joints.met(beta))
        return replace(self, motion=played, rows=rows)

    def information(self, highest: float, finer: float = 1.0) -> tuple[Array, Array]:
        """Up to a frequency, of a log as long as that at hand, on the base parameters, and what of it is noise."""
        assert self.motion.log is not None
        p, dt = len(self.beta), float(self.motion.log.dt)
        times = dt / float(self.motion.dt)
        seen = self.noise if finer == 1.0 else encoder_density(self.motion, finer)
        inside = (self.noise[0] * times, self.noise[1] / times)
        linear, J = self.rows.linear, self.rows.J
        G, N = fisher_information(linear, J, float(self.motion.dt), seen, self.torque, highest, inside)
        known = np.linalg.inv(delay_prior(len(G) - p, dt))
        late = times * G[p:, :p]
        # Delays of each log are its own.
        return times * G[:p, :p] - late.T @ np.linalg.solve(times * G[p:, p:] + known, late), times * N


def _white(square: Array, known: Array) -> float:
    """Density of white noise beside a known one, by the median of a periodogram: lines of a misfit count as one each.

    Args:
        square: periodogram, (bins,).
        known: density of the other noise, (bins,).
    """

    def surplus(white: float) -> float:
        return float(np.median(square / (known + white)) - np.log(2))

    most = float(np.median(square)) / np.log(2)
    tiny = np.finfo(float).tiny
    if not most > tiny or surplus(tiny) <= 0:
        return 0.0
    return bracketed_root(surplus, 0.0, most, xtol=1e-6 * most) if surplus(most) < 0 else most


def _least(sources: Sequence[_Source], names: Sequence[str], highest: float, finer: float = 1.0) -> Array:
    """Least standard errors of some parameters, per cent; infinite where nothing is known of them."""
    model, each = sources[0].model, [source.information(highest, finer) for source in sources]
    G, N = (np.sum(parts, axis=0) for parts in zip(*each, strict=True))
    size = np.sqrt(np.maximum(np.diag(G), np.finfo(float).tiny))
    G, N = G / np.outer(size, size), N / np.outer(size, size)
    # Of what tells a parameter, its noise; where that is most of it, the difference is no figure.
    v = np.linalg.pinv(G, rcond=_ROUNDING, hermitian=True)
    noisy = np.einsum("ij,ik,kj->j", v, N, v) > _MOST_NOISE * np.einsum("ij,ik,kj->j", v, G, v)
    values, vectors = np.linalg.eigh(G - N)
    told = values > _ROUNDING * values[-1]
    variance = np.sum(vectors[:, told] ** 2 / values[told], axis=1) / size**2
    hidden = noisy | (np.sum(vectors[:, ~told] ** 2, axis=1) > _ROUNDING)
    own = [model.base.names.index(name) for name in names]
    with np.errstate(divide="ignore"):
        least = 100 * np.sqrt(variance) / np.abs(sources[0].beta)
    return np.asarray(np.where(hidden, np.inf, least)[own])


def _enough(sources: Sequence[_Source], found: SpringBound, highest: float) -> str:
    """What makes all standard errors as wanted: finer encoders, a faster motion, a longer log, tried one by one."""
    names, ways = found.names, list[str]()

    def well(least: Array) -> bool:
        return bool((least <= found.wanted).all())

    # Standard errors fall with the encoders' noise: the coarsest that does is found by halving.
    place = bisect_left(_FINER, True, key=lambda finer: well(_least(sources, names, found.highest, finer)))
    if place < len(_FINER):
        ways.append(_encoders(sources[0], _FINER[place]))
    for times in _FASTER:
        logs = [source.motion.log for source in sources]
        if any(log is not None and SAMPLES * times * highest > log.rate_hz for log in logs):
            break
        try:
            played = [source.faster(times) for source in sources]
        except SimulationError:
            continue
        if well(_least(played, names, times * found.highest)):
            ways.append(f"this motion {times:g} times as fast (to {times * highest:.3g} Hz)")
            break
    longer = float(np.max(found.least / found.wanted)) ** 2
    if longer <= _LONGER:
        ways.append(f"a log {longer:.2g} times as long")
    return ", or ".join(ways)


def _encoders(source: _Source, finer: int) -> str:
    """Encoders that are finer, with their counts a turn where those of the log are known."""
    assert source.motion.log is not None
    steps = [own.step or own.recorded for own in spectra(source.motion.log)]
    turn = not any(joint.prismatic for joint in source.model.device.joints)
    counts = sorted({round(finer * 2 * np.pi / step) for step in steps if step and turn})
    text = f"encoders {finer} times as fine"
    return f"{text} ({' and '.join(map(str, counts))} counts a turn)" if counts else text


def parameters_of(model: DynamicModel, drive: Motor, nature: str) -> Iterator[str]:
    """Names of the base parameters of one nature of an elastic motor: spring, viscous (its damper) or rotor."""
    names = {name.removesuffix("R"): name for name in model.base.names}
    on = f"motor {drive.name}" if nature == "rotor" else f"elastic {drive.name}"
    return (names[t.name] for t in model.terms if t.on == on and t.nature == nature and t.name in names)
