"""What a log shows of springs behind motors; where it does not, an error with the motion that would show it.

Far below its resonance a link moves with its rotor, and inertia can be shifted from one to the other, stiffness with
it, without a change of the torque: only the torsion's acceleration tells them apart, which falls with the fourth power
of frequency. Where the noise of the encoders is larger, least squares finds a soft spring and a light link in place of
a stiff one, with small residuals and small standard errors. So the noise is compared with what distinguishes stiffness:
the part of its column that no other column explains.

Source: Fuller (1987), Measurement Error Models, section 2.2, for the attenuation by such a share of noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.parts import Motor
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, LogTimeError
from haptid.estimation import Estimate
from haptid.estimation.methods.errors_in_variables import MOST_NOISE
from haptid.estimation.methods.motor_noise import shares_of_motor_noise
from haptid.estimation.methods.motor_side import MotorSide
from haptid.log import Log
from haptid.log.spectrum import bandwidth, spectra
from haptid.motion.motion import treat
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.noise_effect import possible_noise
from haptid.treatment_choice.spring_bound import SAMPLES, SpringBound, parameters_of, spring_bound
from haptid.uncertainty.figures import per_cent

# Largest relative standard error of a stiffness that counts as known, and largest share of noise in its column.
_KNOWN, _NOISE = 0.25, 0.1
# The same where links are simulated along the motors: what noise moves parameters by is subtracted and in their
# intervals there. Of six arms with 12 bits, intervals held 97 and 90 % at 11 and 15 %, and 73 to 100 % (84 in the mean)
# at 21 to 25 %.
_OF_MOTORS = 0.15
# Half widths of 95 % intervals of stiffness and damping, per cent, above which a note says how well they are known.
_WANTED = {"spring": 2.0, "viscous": 10.0}
# Where a method could tell what is wanted, and that of haptid is refused.
_NOT_REACHED = (
    "That would do, and haptid does not reach it: noise is too large a share of its rows, of all frequencies."
)
# Length of a log on which its noise is compared with the motion, s.
_SECONDS = 120.0
# Largest factor by which more motion is advised from one log.
_FARTHEST = 4.0


def expect_fast_sampling(model: DynamicModel, logs: Sequence[Log]) -> None:
    """Raise LogTimeError where an elastic device was sampled too slowly for its motion."""
    if not model.device.elastic:
        return
    for log in logs:
        highest, rate = bandwidth(log.busiest(_SECONDS)), log.rate_hz
        if rate < SAMPLES * highest:
            raise LogTimeError(
                f"{log.path.name} has {rate:.4g} samples a second, and motion up to {highest:.3g} Hz: too few to see a "
                f"spring behind a motor (at least {SAMPLES:g} samples a period, {SAMPLES * highest:.3g} Hz).",
                where=log.path.name,
                found=rate,
                limit=SAMPLES * highest,
                advice="Record at a higher rate.",
            )


def expect_elasticity(found: Estimate, highest: float) -> None:
    """Raise IdentifiabilityError where logs of both sides do not show a stiffness, or show no stable spring.

    Args:
        found: of a device with elastic motors, whose links were measured.
        highest: frequency that the motion goes up to, Hz.
    """
    model = found.model
    if not model.device.elastic:
        return
    logs = [m.log for m in found.observation.motions if m.log is not None]
    logs = [part for log in logs for part in log.busiest(_SECONDS).parts()]
    treatment, found_spectra = found.observation.motions[0].treatment, [spectra(log) for log in logs]
    rows = observe(model, *(treat(log, treatment) for log in logs))
    shares = noise_shares(found, logs, possible_noise(rows, found.free, logs, found_spectra))
    _expect_shown(found, shares, highest, _NOISE)
    for drive in model.device.elastic:
        for name in (*parameters_of(model, drive, "viscous"), *parameters_of(model, drive, "rotor")):
            low, high = found[name].conf_int(0.99)
            if high < 0:
                raise IdentifiabilityError(
                    f"no stable spring has the parameters of motor {drive.name}: {name} is "
                    f"{found[name].value:.3g} ({low:.3g} .. {high:.3g} at 99 %).",
                    where=name,
                    found=found[name].value,
                    limit=0.0,
                    advice="A late torque does this (give `torque_delay_s`), as do positions of the two sides that "
                    "are in another order, or of another sign or gear, than the device file says.",
                )


def expect_stiffness_of_motors(found: Estimate, highest: float) -> None:
    """Raise IdentifiabilityError where logs of the motors alone do not show a stiffness.

    Args:
        found: by `MotorSide`.
        highest: frequency that the motion goes up to, Hz.
    """
    _expect_shown(found, shares_of_motor_noise(found), highest, _OF_MOTORS)


def noise_of_stiffness(found: Estimate) -> float:
    """Largest share of the encoders' noise in what distinguishes a stiffness; `found` is by `MotorSide`."""
    shares = shares_of_motor_noise(found)
    springs = [parameters_of(found.model, drive, "spring") for drive in found.model.device.elastic]
    return max((float(shares[found.names.index(name)]) for names in springs for name in names), default=0.0)


def hidden_stiffness(model: DynamicModel, error: IdentifiabilityError, highest: float) -> IdentifiabilityError:
    """The error of logs whose noise hides a direction of the parameters, with the motion that would show it.

    Args:
        model: with elastic motors.
        error: by `MotorSide`; returned as it is where it is of something else.
        highest: frequency that the motion goes up to, Hz.
    """
    if error.limit != MOST_NOISE:
        return error
    natures = ("spring", "viscous", "rotor")
    own = {
        n: drive for drive in model.device.elastic for nature in natures for n in parameters_of(model, drive, nature)
    }
    name = str(error.where)
    return _hidden(own.get(name, model.device.elastic[0]), name, float(error.found), highest, MOST_NOISE)


def with_bound(error: IdentifiabilityError, bound: SpringBound | None) -> IdentifiabilityError:
    """The error of logs that do not show a stiffness, with what they tell at best."""
    if bound is None:
        return error
    text = str(error).removesuffix(error.advice).strip()
    missed = f" {_NOT_REACHED}" if bound.reached else ""
    advice = f"{error.advice} {bound.advice}".strip()
    made = f"{text} {bound.sentence}{missed}"
    return IdentifiabilityError(made, where=error.where, found=error.found, limit=error.limit, advice=advice)


def bound_of(found: Estimate, highest: float, remedies: bool = True) -> SpringBound | None:
    """What the logs of an estimate tell at best; motion goes up to `highest`, Hz."""
    alone = isinstance(found.method, MotorSide)
    delays = not isinstance(found.method, MotorSide) or found.method.delays
    return spring_bound(found.observation, found.beta, highest, not alone, delays, remedies)


def _expect_shown(found: Estimate, shares: Array, highest: float, limit: float) -> None:
    """Raise IdentifiabilityError where noise hides a stiffness, or it is hardly known."""
    try:
        _expect_little_noise(found, shares, highest, limit)
        expect_known(found, highest)
    except IdentifiabilityError as error:
        raise with_bound(error, bound_of(found, highest)) from None


def _expect_little_noise(found: Estimate, shares: Array, highest: float, limit: float) -> None:
    """Raise IdentifiabilityError where noise is more than a share of what distinguishes a stiffness."""
    for drive in found.model.device.elastic:
        for name in parameters_of(found.model, drive, "spring"):
            share = shares[found.names.index(name)]
            if share > limit:
                raise _hidden(drive, name, min(share, 1.0), highest, limit)


def _hidden(drive: Motor, name: str, share: float, highest: float, limit: float) -> IdentifiabilityError:
    """The error of a stiffness that the encoders' noise hides.

    With strokes as they are, the torsion's acceleration grows with the fourth power of frequency, and its noise in the
    filters that pass it with the power 2.5: the share of noise falls with the third power.
    """
    return IdentifiabilityError(
        f"the log does not show the stiffness of motor {drive.name}: {100 * share:.0f} % of what distinguishes {name} "
        f"from the inertias is noise of the encoders (limit {100 * limit:.0f} %), with motion up to {highest:.3g} Hz.",
        where=drive.name,
        found=share,
        limit=limit,
        advice=_advice(drive, (share / limit) ** (1 / 3) * highest, (share / limit) ** 0.5),
    )


def expect_known(found: Estimate, highest: float) -> None:
    """Raise IdentifiabilityError where a stiffness has too large a standard error; motion goes up to `highest`, Hz."""
    for drive in found.model.device.elastic:
        for name in parameters_of(found.model, drive, "spring"):
            value, se = found[name].value, float(found.se[found.names.index(name)])
            if not (value > 0 and se < _KNOWN * value):
                raise _not_shown(drive, name, value, se, highest)


def with_bounds(found: Estimate, highest: float) -> Estimate:
    """An estimate with a note on each motor whose stiffness or damping the log tells less well than one wants.

    Args:
        found: with the uncertainty of its treatment.
        highest: frequency that the motion goes up to, Hz.
    """
    notes = []
    for drive in found.model.device.elastic:
        wide = [
            f"{name} within {per_cent(known)} (wanted {wanted:g} %)"
            for nature, wanted in _WANTED.items()
            for name in parameters_of(found.model, drive, nature)
            if (known := _within(found, name)) > wanted
        ]
        if wide:
            notes.append(
                f"The log tells {' and '.join(wide)}, at 95 %. To know the spring of motor {drive.name} better, move "
                f"faster than the {highest:.3g} Hz of this motion, or longer, or measure with finer encoders."
            )
    if notes and (bound := bound_of(found, highest, remedies=False)):
        notes.append(bound.sentence)
    return replace(found, notes=(*found.notes, *notes)) if notes else found


def _within(found: Estimate, name: str) -> float:
    """Half of a parameter's 95 % interval, per cent of its value."""
    low, high = found[name].conf_int()
    return 50 * float(high - low) / abs(found[name].value) if found[name].value else np.inf


def _not_shown(drive: Motor, name: str, value: float, se: float, highest: float) -> IdentifiabilityError:
    """The error of a stiffness whose standard error is too large."""
    share = se / value if value > 0 else np.inf
    times = float(np.clip(np.sqrt(share / _KNOWN), 1.3, _FARTHEST))
    return IdentifiabilityError(
        f"the log does not show the stiffness of motor {drive.name}: {name} is {value:.3g} with a standard "
        f"error of {se:.2g} (limit {100 * _KNOWN:.0f} % of it), from motion up to {highest:.3g} Hz.",
        where=drive.name,
        found=share,
        limit=_KNOWN,
        advice=_advice(drive, times * highest, None),
    )


def _advice(drive: Motor, frequency: float, finer: float | None) -> str:
    """The motion that would show a stiffness."""
    encoder = "" if finer is None else f", or measure with encoders {finer:.2g} times as fine"
    return (
        f"Excite motor {drive.name} up to {frequency:.2g} Hz or above, with the same strokes{encoder}. If nothing "
        f"shows it there either, this motor is rigid for such motion: remove its elastic term."
    )


def noise_shares(found: Estimate, logs: Sequence[Log], noise: Sequence[Array]) -> Array:
    """Share of the positions' noise in the part of each column that no other column explains, (p,).

    Noise is added to the positions and subtracted from them: with G the weighted sum of squares of the rows and N that
    of the noise in them, the half sum of both is G + N, as far as columns are linear in the noise. A share above one
    is one of motion that is nearly absent from the true column.

    Args:
        found: for its model, treatment and weights.
        logs: whose rows are compared.
        noise: of their positions, each (samples, channels), rad or m.
    """
    treatment = found.observation.motions[0].treatment

    def squares(sign: float) -> Array:
        moved = [
            replace(log, position=np.asarray(log.position[:]) + sign * n) for log, n in zip(logs, noise, strict=True)
        ]
        return _squares(observe(found.model, *(treat(log, treatment) for log in moved)), found.weights)

    G = squares(0.0)
    N = 0.5 * (squares(1.0) + squares(-1.0)) - G
    size = np.sqrt(np.diag(G))
    v = np.linalg.pinv(G / np.outer(size, size), hermitian=True) / size[:, None]
    return np.asarray(np.einsum("ij,ik,kj->j", v, N, v) / np.einsum("ij,ik,kj->j", v, G, v))


def _squares(rows: Observation, weights: Array) -> Array:
    """W' W of weighted rows, (p, p)."""
    made = np.zeros((len(rows.base), len(rows.base)))
    for motor, weight in zip(rows.motors, weights, strict=True):
        R = weight * motor.whole[:, :-1]
        made[np.ix_(motor.columns, motor.columns)] += R.T @ R
    return made
