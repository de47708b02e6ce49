"""Plausibility of units, gears, signs and clocks: the torque compared with that of the prior bodies."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Device
from haptid.device.parameters import INERTIAL
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import AugmentedRows
from haptid.inference.diagnosis.finding import BODIES, NEGATIVE, SIGNIFICANCE, Finding, Status, joined_names
from haptid.observation.augmented import CandidateColumns, ResidualContext, torque_of
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import half_width

# Factors that confused units cause.
_UNITS = {
    1000.0: "milli- for whole units",
    1e-3: "whole for milli-units",
    1e6: "milliseconds for seconds, or mm^2 for m^2",
    1e-6: "microseconds or um^2",
    180 / np.pi: "degrees for radians",
    np.pi / 180: "radians for degrees",
    9.80665: "kilograms for newtons",
    1 / 9.80665: "newtons for kilograms",
}
# Those that one program or one convention makes for all channels alike, and those that no electric current has.
_COMMON = {words for value, words in _UNITS.items() if value not in (1000.0, 1e-3)}
_OF_FORCES = {"kilograms for newtons", "newtons for kilograms"}
# Tolerance, as a logarithm, for a factor to have a known cause; factors up to this one are within prior uncertainty.
_NAMED, GOOD = 0.15, 2.0
# A torque scale is used if its standard error is below this share of it.
IDENTIFIABLE = 0.25
# Columns of each motor: inertial torque, gravity, a rotor; torque over that of the bodies that no rotor causes.
_OF_A_MOTOR, _NO_ROTOR = 3, 100.0
# Share of the inertial torque below which a motor does not move its bodies.
_NOT_MOVED = 0.25
# Share of dry friction in a motor's torque from which on the motor moves the joint itself.
_OVERCOMES = 0.1
# Parameters that cannot be negative, by kind.
_POSITIVE = ("FV", "FC", "IA")


@dataclass(frozen=True, eq=False)
class PriorBodies:
    """Prior values of the inertial base parameters.

    Attributes:
        inertial: indices of the inertial base parameters, (k,).
        beta: their prior values, the others zero, (p,), SI.
    """

    inertial: tuple[int, ...]
    beta: Array


def prior_bodies(model: DynamicModel) -> PriorBodies | None:
    """Prior bodies of the device file as far as it has them; None where it has none.

    A base parameter without a prior, such as one into which a rotor's inertia regroups, stays to be estimated.
    """
    kinds = [model.device.parameters.kinds[k] for k in model.base.independent_columns]
    prior = model.base_prior
    inertial = tuple(k for k, kind in enumerate(kinds) if kind in INERTIAL and prior[k] is not None)
    if not inertial:
        return None
    beta = np.zeros(len(model.base))
    beta[list(inertial)] = [prior[k][0] for k in inertial]  # type: ignore[index]
    return PriorBodies(inertial, beta) if beta.any() else None


def prior_torque(model: DynamicModel, rows: Sequence[int], bodies: PriorBodies) -> tuple[CandidateColumns, ...]:
    """For every row the torque of the prior bodies, inertial and gravitational, and that of a rotor.

    Only the first is judged: in a balanced device, gravity is a small difference of large terms, which the prior does
    not determine, and descriptions seldom have rotors.
    """
    chi = raw_parameters(model, bodies.beta)

    @lru_cache(maxsize=1)  # torque is computed for all rows at once
    def torques(context: ResidualContext) -> Array:
        c = context.motion[0]
        weight = torque_of(model, chi, c, np.zeros_like(c), np.zeros_like(c))
        cdd = context.motion[2]
        return np.array([context.torque(chi) - weight, weight, np.zeros_like(c) if cdd is None else cdd])

    units = np.eye(len(model.device.active))
    return tuple(
        CandidateColumns(units[row], 1, lambda context, r=row, k=kind: torques(context)[k, [r]])  # type: ignore[misc]
        for row in rows
        for kind in range(_OF_A_MOTOR)
    )


@dataclass(frozen=True)
class TorqueScale:
    """Ratio of a motor's inertial torque to that of the prior bodies.

    Attributes:
        motor: "motor 2".
        value, se: the ratio and its standard error.
        half: half-width of the 95 % confidence interval.
    """

    motor: str
    value: float
    se: float
    half: float


def torque_scales(
    augmented: AugmentedRows, candidates: Sequence[int], bodies: PriorBodies, labels: Sequence[str]
) -> tuple[TorqueScale, ...]:
    """Of every motor where it is identifiable; gravity, a rotor and the other terms are estimated jointly.

    Where a rotor's inertia cannot be distinguished from that of the bodies, it may explain a larger torque: the scale
    then counts where it is below one or beyond what rotors do, or where gravity has the same.
    """
    scales: list[TorqueScale] = []
    for m, label in enumerate(labels):
        motion, weight, rotor = candidates[_OF_A_MOTOR * m : _OF_A_MOTOR * (m + 1)]
        for tried in ((motion, weight, rotor), (motion, rotor), (motion, weight), (motion,)):
            test = augmented.test(tried, bodies.inertial, motor=m)
            if test is None:
                continue
            value, se = float(test.values[0]), float(test.se[0])
            if se >= IDENTIFIABLE * abs(value):
                continue
            confirms = weight in tried and abs(test.values[1] / value - 1) < _NAMED
            if rotor in tried or value < GOOD or value > _NO_ROTOR or confirms:
                scales.append(TorqueScale(label, value, se, float(half_width(se, test.dof))))
                break
    return tuple(scales)


def moved_from_outside(
    augmented: AugmentedRows, candidates: Sequence[int], bodies: PriorBodies, labels: Sequence[str]
) -> Finding | None:
    """Motors whose torque holds the weight of the prior bodies and does not accelerate them; None where there are none.

    Something else moved the device then, such as the hand that guides it while gravity is compensated: no sign and no
    unit is wrong, and inertia and friction cannot be identified from the log. A motor that overcomes dry friction moves
    its joint itself: the bodies' inertia, far too large in some robot descriptions, is wrong then.
    """
    figures: dict[str, float] = {}
    found: list[str] = []
    for m, label in enumerate(labels):
        motion, weight, _ = candidates[_OF_A_MOTOR * m : _OF_A_MOTOR * (m + 1)]
        test = augmented.test((motion, weight), bodies.inertial, motor=m)
        if test is None:
            continue
        (moved, held), (se, own) = test.values[:2], test.se[:2]
        carries = 1 / GOOD < held < GOOD and own < IDENTIFIABLE * held  # masses of descriptions are not exact
        still = abs(moved) + half_width(float(se), test.dof) < _NOT_MOVED
        if still and carries and dry_friction_share(augmented.estimate, m) < _OVERCOMES:
            figures |= {f"inertial {label}": float(moved), f"weight {label}": float(held)}
            found.append(label)
    if not found:
        return None
    held, moved = figures[f"weight {found[0]}"], figures[f"inertial {found[0]}"]
    return Finding(
        "moved from outside",
        "bad",
        figures,
        f"The torque of {joined_names(found)} holds the weight of the device file's bodies ({held:.3g} of it) and does "
        f"not accelerate them ({moved:.2g} of it): something else moved the device, or their inertia is far too large.",
    )


def dry_friction_share(fitted: Estimate, m: int) -> float:
    """Dry friction of a motor's row over its torque, by their norms, as far as it is significantly positive."""
    own, kinds = fitted.observation.motors[m], fitted.model.device.parameters.kinds
    dry = [
        k
        for k in own.columns
        if kinds[fitted.base.independent_columns[k]] == "FC"
        and fitted.beta[k] > half_width(fitted.se[k], fitted.dof[k])
    ]
    beta = np.where(np.isin(np.arange(len(fitted.beta)), dry), fitted.beta, 0.0)
    return float(np.linalg.norm(own.whole[:, :-1] @ beta[own.columns])) / own.norm if own.norm > 0 else 0.0


def unit_error(factor: float, gears: Sequence[float], impossible: Collection[str] = ()) -> str | None:
    """The possible confusion of units or gear ratios that causes a factor; None if no known one does."""
    named = {value: words for value, words in _UNITS.items() if words not in impossible}
    for gear in gears:
        if abs(np.log(abs(gear))) > np.log(GOOD):
            named |= {abs(gear): "a gear ratio left out", 1 / abs(gear): "a gear ratio counted twice"}
            named |= {gear**2: "a gear ratio squared", gear**-2: "a gear ratio squared"}
    near = [(abs(np.log(abs(factor) / value)), words) for value, words in named.items()]
    distance, words = min(near)
    return words if distance < _NAMED else None


def confusions(fitted: Estimate, factors: Mapping[str, float]) -> dict[str, str]:
    """The confusion of units or gear ratios behind each motor's factor, for those that a known one causes.

    Degrees, kilograms and the unit of time are common to channels of one unit: where the median of the motors in the
    same unit is another factor, or that of no other motor is known, no such confusion makes that of a single motor.
    Torque constants of one robot are alike too, and near some of these factors by chance.

    Args:
        fitted: whose motors.
        factors: torque over that of the prior bodies, by the motor's label, of those where it is known.
    """
    motors = fitted.observation.motors
    units = dict(zip((motor.label for motor in motors), _channel_units(fitted, len(motors)), strict=True))
    found = {}
    for label, factor in factors.items():
        sizes = [max(abs(own), 1e-300) for name, own in factors.items() if units[name] == units[label]]
        middle, gears = float(np.exp(np.median(np.log(sizes)))), gears_of(fitted.model.device)
        shared = set(_COMMON)
        if list(units.values()).count(units[label]) > 1:
            cause = unit_error(middle, ()) if len(sizes) > 1 else None
            shared = {cause} & _COMMON if cause else set()
        impossible = (_COMMON - shared) | (_OF_FORCES if units[label] == "A" else set())
        if words := unit_error(factor, gears, impossible):
            found[label] = words
    return found


def unlike_together(fitted: Estimate, factors: Mapping[str, float]) -> str:
    """A sentence on torques of most motors that are all too small, or all too large, by unlike factors; else empty.

    So currents taken as torques: the factors are the torque constants, times the gear ratios.

    Args:
        fitted, factors: as for `confusions`.
    """
    motors = fitted.observation.motors
    units = dict(zip((motor.label for motor in motors), _channel_units(fitted, len(motors)), strict=True))
    small = {label: factor for label, factor in factors.items() if 0 < factor < 1 / GOOD}
    large = {label: factor for label, factor in factors.items() if factor > GOOD}
    for side, words in ((small, "small"), (large, "large")):
        if len(side) < 2 or 2 * len(side) <= len(motors):
            continue
        currents = all(units[label] == "A" for label in side)
        cause = (
            "check the motors' `torque_constant` and `gear_ratio` in the device file"
            if currents
            else "if the channels are currents, or torques before the gears, give `command_unit`, `torque_constant` "
            "and `gear_ratio` in the device file's [[motors]], and `unit` and `side` in the study"
        )
        return (
            f"The torques of {joined_names(list(side), most=8)} are {min(side.values()):.3g} to "
            f"{max(side.values()):.3g} times those of the device file's bodies, all too {words}: {cause}. Not known: "
            "whether the channels or the bodies are wrong."
        )
    return ""


def _channel_units(fitted: Estimate, motors: int) -> tuple[str, ...]:
    """Unit of each motor's channel, SI; where a motor has several channels, those of the log."""
    logs = [motion.log for motion in fitted.observation.motions if motion.log is not None]
    if not logs:
        return ("",) * motors
    units = logs[0].channels.torque_units
    return units if len(units) == motors else (logs[0].channels.torque_unit,) * motors


def gears_of(device: Device) -> list[float]:
    """Ratios that may be left out or counted twice: gears, and these with torque constants."""
    return [motor.gear_ratio for motor in device.motors] + [
        motor.gear_ratio * motor.torque_constant for motor in device.motors
    ]


def units_and_signs(fitted: Estimate, scales: Sequence[TorqueScale]) -> Finding:
    """Torque scales with a known cause, and negative friction."""
    figures = {f"factor {scale.motor}": scale.value for scale in scales}
    causes = confusions(fitted, {scale.motor: scale.value for scale in scales})
    bad, doubt, unlike = [], [], list[TorqueScale]()
    for scale in scales:
        size = f"The torque of {scale.motor} is {scale.value:.3g} times {BODIES}"
        words = causes.get(scale.motor)
        if scale.value < 0:
            bad.append(f"{size}: a sign is wrong, of torque or of position.")
        elif words and not 1 / GOOD < scale.value < GOOD:
            bad.append(f"{size}, as caused by {words}.")
        elif not 1 / GOOD < scale.value + np.sign(1 - scale.value) * scale.half < GOOD:
            unlike.append(scale)
    for side in ([s for s in unlike if s.value < 1], [s for s in unlike if s.value > 1]):
        if side:
            low, high = (f"{pick(s.value for s in side):.3g}" for pick in (min, max))
            size = low if low == high else f"{low} to {high}"
            doubt.append(
                f"The torque of {joined_names([s.motor for s in side], most=8)} is {size} times {BODIES} (limit "
                f"{GOOD:g}): command unit, gear ratio, torque constant, or the bodies of the device file differ."
            )
    if negative := _negative(fitted):
        figures |= {f"{NEGATIVE}{name}": value for name, value in negative.items()}
        doubt.append(f"{joined_names(list(negative))} negative, which is impossible.")
    status: Status = "bad" if bad else "doubt" if doubt else "ok"
    if status != "ok":
        return Finding("units and signs", status, figures, " ".join([*bad, *doubt][:3]))
    text = "Torques agree with the device file's bodies" if scales else "No prior bodies to compare with"
    return Finding("units and signs", status, figures, f"{text}, and no friction is negative.")


def _negative(fitted: Estimate) -> dict[str, float]:
    """Values of friction and rotor parameters that are significantly negative, with Bonferroni's correction."""
    kinds = [fitted.model.device.parameters.kinds[k] for k in fitted.base.independent_columns]
    found = {}
    for k, kind in enumerate(kinds):
        if kind in _POSITIVE and fitted.beta[k] < 0:
            p = t_tail(-fitted.beta[k] / fitted.se[k], fitted.dof[k])
            if p * len(kinds) < SIGNIFICANCE:
                found[fitted.base.names[k]] = float(fitted.beta[k])
    return found
