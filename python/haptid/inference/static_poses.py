"""Identification from held poses: gravity, springs, offsets, friction at rest, and whether to compensate gravity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.static import COULOMB, StaticModel, static_model
from haptid.errors import EstimationError, NoRowsError, listed
from haptid.estimation import WLS, Estimate, estimate
from haptid.estimation.method import Method
from haptid.motion.holds import Poses
from haptid.observation.observation import Observation
from haptid.observation.static import observe_poses
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import aligned

# Most folds of the cross-validation; configurations are dealt to them in turn.
MOST_FOLDS = 10
# Significance level at which compensation is proven to take torque off.
COMPENSATION_SIGNIFICANCE = 0.05
_NO_INTERVAL = (
    "These are ranges, not intervals of the Coulomb friction in motion: a joint that comes to rest keeps a part of it, "
    "which differs from hold to hold. Record motion for Coulomb friction."
)


@dataclass(frozen=True)
class GravityVerdict:
    """Whether a motor's gravity is worth compensating, by poses that the fit has not seen.

    Attributes:
        label, unit: of the motor.
        verdict: "worth it"; "not needed" where friction alone holds the arm at every pose; "unproven" where the
            predicted torque takes nothing off significantly, or no pose could be held out.
        holding: root mean square torque that holds the configurations, friction averaged out, N m or N.
        left: the same with the predicted gravity, springs and offset taken off, at configurations not fitted.
        explained: 1 - left^2 / holding^2, per cent.
        friction: root mean square Coulomb friction, N m or N.
        configurations: that were predicted without having been fitted.
        p: one-sided p-value of the hypothesis that nothing is taken off.
    """

    label: str
    unit: str
    verdict: Literal["worth it", "not needed", "unproven"]
    holding: float
    left: float
    explained: float
    friction: float
    configurations: int
    p: float

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        figures = (
            f"{self.label}: {self.explained:.0f} % of the holding torque ({self.holding:.3g} {self.unit} RMS) is "
            f"explained at {self.configurations} configurations not fitted; {self.left:.2g} {self.unit} is left, "
            f"friction is {self.friction:.2g} {self.unit}."
        )
        match self.verdict:
            case "worth it":
                return f"{figures} Gravity compensation is worth it."
            case "not needed":
                return f"{figures} Gravity compensation is not needed: friction holds every pose."
        if not self.configurations:
            return f"{self.label}: no configuration could be held out. Record more poses."
        return f"{figures} Gravity compensation is unproven (p = {self.p:.2g}): record more poses, with larger moves."


@dataclass(frozen=True)
class FrictionAtRest:
    """Range of the dry friction that is left of a motor's when it has come to rest, over the configurations.

    It is no interval of the Coulomb friction in motion: a joint that stops under its controller keeps a part of it.

    Attributes:
        label, unit: of the motor.
        least, mean, greatest: over configurations, N m or N.
        configurations: that its friction was found at.
    """

    label: str
    unit: str
    least: float
    mean: float
    greatest: float
    configurations: int

    @property
    def sentence(self) -> str:
        """The range in words."""
        return (
            f"{self.label}: dry friction at rest is {self.least:.2g} to {self.greatest:.2g} {self.unit} at "
            f"{self.configurations} configurations, {self.mean:.3g} {self.unit} in the mean."
        )


@dataclass(frozen=True, eq=False)
class StaticIdentification:
    """A device identified from held poses.

    Attributes:
        poses: that were used.
        estimate: static base parameters; intervals are clustered by configuration. Its Coulomb constants are means of
            the friction at rest, and their intervals those of these means.
        left_out: sentences on what the poses do not determine.
        verdicts: one for each motor.
    """

    poses: Poses
    estimate: Estimate
    left_out: tuple[str, ...]
    verdicts: tuple[GravityVerdict, ...]

    @property
    def model(self) -> StaticModel:
        """The static model, with the base parameters that the poses determine."""
        assert isinstance(self.estimate.model, StaticModel)
        return self.estimate.model

    def holding_torque(self, qa: ArrayLike) -> Array:
        """Torque of gravity, springs and offsets, (coordinates, poses), N m or N.

        Args:
            qa: positions of the active joints, (active, poses), rad or m.
        """
        c = self.model.device.row_map @ np.asarray(qa, dtype=float)
        return self.model.torque(self.estimate.beta, np.ascontiguousarray(c))

    @cached_property
    def friction(self) -> tuple[FrictionAtRest, ...]:
        """The friction at rest of each motor that has Coulomb friction in the model."""
        return tuple(_friction_at_rest(self.poses, self.model, self.estimate.beta))

    @property
    def quoted(self) -> list[int]:
        """Indices of the base parameters that are quoted with intervals: all but Coulomb constants."""
        dry = {term.name for term in self.model.terms if term.kind in COULOMB}
        return [k for k, name in enumerate(self.estimate.base.names) if name not in dry]

    def summary(self) -> str:
        """Table of parameters, friction at rest, verdicts and notes."""
        base = self.estimate.base
        groups = [f"{base.names[k]} = {base.groupings[k]}" for k in self.quoted if base.names[k] != base.groupings[k]]
        parts = [self.estimate.quantities.pick(self.quoted).table(), "\n".join(groups)]
        if self.friction:
            parts.append("\n".join([*(friction.sentence for friction in self.friction), _NO_INTERVAL]))
        parts.append("\n".join([v.sentence for v in self.verdicts]))
        parts.append("\n".join([*self.left_out, *self.estimate.notes, *self.noise_notes()]))
        return "\n\n".join(part for part in parts if part)

    def noise_notes(self) -> Iterator[str]:
        """Noise of the means within holds compared with the residual between poses, one sentence for each motor."""
        model, beta = self.model, self.estimate.beta
        rest = self.poses.tau - model.torque(beta, self.poses.c.T, self.poses.approach.T).T
        used = model.used_rows(self.poses.approach.T).T
        for row in np.flatnonzero(model.device.measured).tolist():
            se = self.poses.se[used[:, row], row]
            if se.size and np.isfinite(se).any():
                within, between = (
                    float(np.sqrt(np.nanmean(se**2))),
                    float(np.sqrt(np.mean(rest[used[:, row], row] ** 2))),
                )
                unit = model.device.torque_units[row]
                yield (
                    f"{model.device.row_labels[row]}: {within:.2g} {unit} is the noise of a pose's mean, "
                    f"{between:.2g} {unit} the residual between poses."
                )

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        base, quoted = self.estimate.base, self.quoted
        return {
            "device": self.model.device.name,
            "poses": len(self.poses),
            "configurations": self.poses.configurations,
            "parameters": [
                friction | {"grouping": base.groupings[k]}
                for friction, k in zip(self.estimate.quantities.pick(quoted).to_json(), quoted, strict=True)
            ],
            "friction_at_rest": [
                {
                    "motor": friction.label,
                    "unit": friction.unit,
                    "least": friction.least,
                    "mean": friction.mean,
                    "greatest": friction.greatest,
                    "configurations": friction.configurations,
                }
                for friction in self.friction
            ],
            "status": self.estimate.status,
            "left_out": list(self.left_out),
            "gravity": [
                {
                    "motor": v.label,
                    "unit": v.unit,
                    "verdict": v.verdict,
                    "holding_rms": v.holding,
                    "left_rms": v.left,
                    "explained_percent": v.explained,
                    "friction_rms": v.friction,
                    "configurations": v.configurations,
                    "p": v.p,
                }
                for v in self.verdicts
            ],
            "notes": [*([_NO_INTERVAL] if self.friction else []), *self.estimate.notes, *self.noise_notes()],
        }

    def gravity_table(self) -> str:
        """The verdicts as a text table."""
        rows = [["", "holding", "left", "explained", "friction", "unit", "verdict"]]
        rows += [
            [
                v.label,
                f"{v.holding:.3g}",
                f"{v.left:.2g}",
                f"{v.explained:.0f} %",
                f"{v.friction:.2g}",
                v.unit,
                v.verdict,
            ]
            for v in self.verdicts
        ]
        return "\n".join(aligned(rows))


def identify_poses(model: DynamicModel, poses: Poses, method: Method | None = None) -> StaticIdentification:
    """Identify gravity, springs, offsets and the friction at rest from held poses.

    The base parameters are those of the static regressor at these poses; what they do not determine is left out.

    Args:
        poses: by `find_poses` or `read_poses`.
        method: of estimation, one that works on R factors; `WLS()` where None.

    Raises:
        NoRowsError: no joint moved between poses, or fewer rows than parameters.
        LogMismatchError: the channels do not fit the device.
    """
    static = static_model(model)
    determined = static.determined_by(poses.c.T, poses.approach.T)
    if not len(determined.base):
        raise NoRowsError("no joint moved between the poses, so no torque is used.", found=0, limit=1)
    observation = observe_poses(determined, poses)
    observation = replace(observation, motors=tuple(motor for motor in observation.motors if motor.rows.sum()))
    fitted = estimate(observation, method or WLS())
    return StaticIdentification(
        poses,
        fitted,
        _static_left_out(model, static, determined),
        tuple(_verdicts(poses, observation, fitted, method or WLS())),
    )


def _static_left_out(model: DynamicModel, static: StaticModel, determined: StaticModel) -> tuple[str, ...]:
    """Sentences on what poses, and these poses, do not determine."""
    sentences = []
    moving = [name for name in static.base.no_effect if name not in model.base.no_effect]
    if moving:
        sentences.append(
            f"{len(moving)} parameters have no effect on the torque of a held pose, inertia and viscous friction among "
            f"them: record motion for {listed(moving)}."
        )
    lost = [
        static.device.parameters.names[k]
        for k in static.base.independent_columns
        if k not in determined.base.independent_columns
    ]
    if lost:
        dry = {term.name for term in static.terms if term.kind in COULOMB} & set(lost)
        advice = "reach each pose from both sides" if dry else "add poses that move other joints, and move them further"
        sentences.append(f"These poses do not determine {listed(lost)} separately: {advice}.")
    return tuple(sentences)


def _friction_at_rest(poses: Poses, model: StaticModel, beta: Array) -> Iterator[FrictionAtRest]:
    """The range of each motor's friction: torque less gravity, springs and offset, towards the approach.

    Sides of a configuration are averaged with equal weight, so that errors of its gravity cancel.

    Args:
        beta: base parameters of the model, SI.
    """
    rest = poses.approach * (poses.tau - model.torque(beta, poses.c.T).T)
    for row in np.flatnonzero(model.device.measured).tolist():
        if not any(term.kind in COULOMB for term in model.coulomb_terms(row)):
            continue
        side = poses.approach[:, row]
        known = np.abs(np.nan_to_num(side)) > 0
        frictions = []
        for k in np.unique(poses.configuration[known]):
            members = known & (poses.configuration == k)
            frictions.append(np.mean([rest[members & (side == s), row].mean() for s in np.unique(side[members])]))
        if frictions:
            yield FrictionAtRest(
                model.device.row_labels[row], model.device.torque_units[row],
                float(np.min(frictions)), float(np.mean(frictions)), float(np.max(frictions)), len(frictions),
            )  # fmt: skip


def _verdicts(poses: Poses, observation: Observation, fitted: Estimate, method: Method) -> Iterator[GravityVerdict]:
    """The gravity verdict of each motor, by cross-validation over configurations."""
    model = observation.model
    assert isinstance(model, StaticModel)
    used, count = model.used_rows(poses.approach.T).T, poses.configurations
    predicted = np.full(poses.tau.shape, np.nan)
    fold_of = np.arange(count) % min(count, MOST_FOLDS)
    for fold in range(int(fold_of.max()) + 1):
        unseen = np.isin(poses.configuration, np.flatnonzero(fold_of == fold))
        try:
            beta = estimate(observation.pick(np.flatnonzero(fold_of != fold)), method).beta
        except EstimationError:  # the other poses do not determine the parameters: nothing is predicted
            continue
        predicted[unseen] = model.torque(beta, poses.c[unseen].T).T
    smooth = model.torque(fitted.beta, poses.c.T).T
    friction = model.torque(fitted.beta, poses.c.T, poses.approach.T).T - smooth
    for row in np.flatnonzero(model.device.measured).tolist():
        own = used[:, row]
        held, missing = [], []
        for k in range(count):
            members = np.flatnonzero(own & (poses.configuration == k) & np.isfinite(predicted[:, row]))
            if members.size:
                # Sides are averaged with equal weight; a configuration with one side has its friction taken off.
                sides = poses.approach[members, row]
                has_both = {1.0, -1.0} <= set(sides.tolist())
                tau = poses.tau[members, row] - (0.0 if has_both else friction[members, row])
                groups = (
                    [sides == side for side in np.unique(np.nan_to_num(sides))]
                    if has_both
                    else [np.ones(len(members), bool)]
                )
                held.append(np.mean([tau[group].mean() for group in groups]))
                missing.append(held[-1] - np.mean([predicted[members, row][group].mean() for group in groups]))
        yield _verdict(model, row, np.array(held), np.array(missing), friction[own, row], smooth[own, row])


def _verdict(
    model: StaticModel, row: int, held: Array, missing: Array, friction: Array, smooth: Array
) -> GravityVerdict:
    """From the holding torque and the unseen error of each configuration."""
    dry = float(np.sqrt(np.mean(friction**2))) if friction.size else 0.0
    holding, left = (float(np.sqrt(np.mean(x**2))) if x.size else float("nan") for x in (held, missing))
    explained = 100 * (1 - (left / holding) ** 2) if held.size and holding > 0 else float("nan")
    p = 1.0
    if held.size > 1:
        gain = held**2 - missing**2
        spread = float(gain.std(ddof=1) / np.sqrt(gain.size))
        p = float(t_tail(gain.mean() / spread, gain.size - 1)) if spread > 0 else float(gain.mean() <= 0)
    verdict: Literal["worth it", "not needed", "unproven"] = "unproven"
    if p < COMPENSATION_SIGNIFICANCE:
        verdict = "worth it"
    if smooth.size and np.abs(smooth).max() < dry:
        verdict = "not needed"
    label, unit = model.device.row_labels[row], model.device.torque_units[row]
    return GravityVerdict(label, unit, verdict, holding, left, explained, dry, int(held.size), p)
