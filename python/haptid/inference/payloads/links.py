"""Whether a payload is on the link that is said: other links, and any change at all, on blocks that no fit has seen.

Every candidate is fitted to every other block and judged on the rest, and the other way round: a body on the link that
is said, on each other link, none at all, and all base parameters free in the loaded rows. What none leaves over is the
load's effect; another link is the better one where it takes away clearly more of it, block for block.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import ConvergenceError, listed
from haptid.inference.payloads.body import AttachedBody
from haptid.inference.payloads.fit import JointFit, LoadedRows, joint_fit, summed
from haptid.inference.payloads.layout import Layout
from haptid.observation.observation import MotorRows, Observation
from haptid.uncertainty.distributions import signed_rank_tail, t_tail
from haptid.uncertainty.quantities import half_width

# Blocks of a load, at least, of which half are fitted.
_FEWEST = 6
# Significance of what is said, over all candidates of a payload, and above which two links do as well.
_SIGNIFICANCE, _AS_WELL = 0.01, 0.05
# Times as much of the load's effect that the better link takes away, or times less that it leaves over, at least.
_CLEARLY = 1.25
# Change of a gain's logarithm that is none in errors of which quarters count.
_GAINS = 1e-5
# Ratio of a drive's torques with and without the payload up to which friction that the model lacks may cause it.
_DRIVE = 1.05
# Share of the load's squared effect that counts as nothing left: a thousandth of its torque.
_NOTHING = 1e-6


def link_notes(
    own: DynamicModel,
    wide: DynamicModel,
    layout: Layout,
    bodies: Sequence[AttachedBody],
    observations: Sequence[Observation],
    fit: JointFit,
) -> Iterator[str]:
    """A sentence on the link of each payload; empty where nothing speaks against it.

    Each is judged by its own rows and those of the bare device: another payload on a wrong link changes the base
    parameters that all share.

    Args:
        own, wide: models of the device, and with the payloads' parameters on every link that may carry one.
        layout: of the bodies on the links that are said.
        bodies: as given.
        observations: of the bare device and of each load, of the wide model.
        fit: with these bodies, of which the motors and gains are used.
    """
    rows = [_Rows(observation) for observation in observations]
    scaled = [_Rows(_at_gains(o, fit)) for o in observations] if fit.gains else rows
    for body, raw, at in zip(bodies, rows[1:], scaled[1:], strict=True):
        gains = fit.gains if body.mass is not None else ()  # elsewhere nothing but the fit tells them
        alone = Layout.of(own, wide, layout.embedding, [body], layout.shared)
        told = (rows[0], raw) if gains else (scaled[0], at)
        start = fit.theta if gains else np.zeros(0)
        yield LinkTest(own, wide, alone, body, told, (scaled[0], at), fit.motors, gains, start).note()


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a load, whole and in halves, each computed once."""

    observation: Observation

    @cached_property
    def summed(self) -> Observation:
        return summed(self.observation)

    @cached_property
    def blocks(self) -> tuple[Observation, Observation]:
        """Alternate blocks, to be judged on."""
        return self.observation.alternate()

    @cached_property
    def halves(self) -> tuple[Observation, Observation]:
        """The same as one block each, which is what a fit needs of them."""
        even, odd = self.blocks
        return summed(even), summed(odd)


@dataclass(frozen=True, eq=False)
class LinkTest:
    """Rows of the bare device and of a load, and what is to be fitted to them.

    Attributes:
        own, wide: models of the device, and with the payloads' parameters on every link that may carry one.
        layout: of the body on the link that is said.
        body: as given.
        rows: of the bare device and of the load; at the gains of the fit where the body does not tell them.
        scaled: the same at the gains of the fit.
        motors: indices of those whose rows are used.
        gains: indices of those whose gain the body tells.
        start: logarithms of these gains with all payloads, (gains,).
    """

    own: DynamicModel
    wide: DynamicModel
    layout: Layout
    body: AttachedBody
    rows: tuple[_Rows, _Rows]
    scaled: tuple[_Rows, _Rows]
    motors: tuple[int, ...]
    gains: tuple[int, ...]
    start: Array

    def note(self) -> str:
        """A sentence on the link of the payload; empty where nothing speaks against it."""
        body = self.body
        others = [link for link in body_links(self.wide) if link != body.link]
        if len(self.rows[1].observation.blocks) < _FEWEST or not others:
            return ""
        bare = self._errors(self._free(0), at_gains=True)
        own = self._errors(self.layout)
        if bare is None or own is None:
            return ""
        found = {link: e for link in others if (e := self._errors(self._moved(link))) is not None}
        effect, limit = bare.sum() - own.sum(), _SIGNIFICANCE / (len(others) + 1)
        # What is left below this is nothing: how many times more the other leaves over is rounding.
        nothing = _NOTHING * bare.sum()
        mass = cache(self._mass)

        def clearly(errors: Array) -> bool:
            more = bare.sum() - errors.sum() > _CLEARLY * max(effect, 0.0)
            less = own.sum() > _CLEARLY * max(errors.sum(), nothing)
            explains = errors.sum() < bare.sum() and _p(bare - errors) < limit
            return bool((more or less) and explains and _p(own - errors) < limit)

        def of_body(link: str) -> bool:
            return not (m := mass(link)) or m[0] > 0

        ranked = sorted(found, key=lambda link: float(found[link].sum()))
        best = next((link for link in ranked if clearly(found[link]) and of_body(link)), "")
        if best:
            alike = [
                link for link in ranked if link != best and _p(found[link] - found[best]) > _AS_WELL and of_body(link)
            ]
            share, rest = max(100 * effect / (bare.sum() - found[best].sum()), 0.0), found[best].sum()
            times = f"{own.sum() / rest:.2g} times as much" if rest > nothing else f"much, one on {best} nearly nothing"
            weighs = f" (mass {m[0]:.3g} kg there)" if (m := mass(best)) and m[1] > 0 else ""
            also = f"; one on {listed(alike)} does as well as on {best}" if alike else ""
            return (
                f"Payload {body.name} is better explained on link {best}{weighs} than on {body.link}: of what a body "
                f"on {best} explains of the load's effect on unseen rows, one on {body.link} explains {share:.2g} % "
                f"and leaves over {times}{also}. Check `link`."
            )
        free = self._errors(self._free(len(self.layout.embedding)), at_gains=True)
        if drives := self._drives(own, free, limit):
            return drives
        own_mass = mass(body.link)
        if own_mass and own_mass[2] < 0:
            return (
                f"The mass of payload {body.name} on link {body.link} would be {own_mass[0]:.3g} kg, below zero beyond "
                "its interval: something else changed than a body, or its logs are those without it. Check them."
            )
        if free is not None and clearly(free):
            share = max(100 * effect / (bare.sum() - free.sum()), 0.0)
            return (
                f"A body on link {body.link} explains {share:.2g} % of how the rows with payload {body.name} differ "
                "from the bare ones, and one on no other link clearly more: something else changed too, such as "
                "friction, the mounting, a drive, or a second body. The figures are no body's."
            )
        visible = own_mass is not None and _p(bare - own) < limit
        unlike = [
            f"{link} with {m[0]:.3g} kg"
            for link in found
            if visible and own_mass and _p(found[link] - own) > _AS_WELL and (m := mass(link)) and m[0] > 0
            if not own_mass[1] <= m[0] <= own_mass[2]
        ]
        if not unlike:
            return ""
        return (
            f"These logs do not tell whether payload {body.name} is on link {body.link}, or on {listed(unlike)}: "
            "record motions that move these links against each other."
        )

    @cached_property
    def _weights(self) -> Array:
        """One over the residual of each motor where every load has parameters of its own, (motors,)."""
        every, nothing = np.eye(len(self.layout.embedding)), np.zeros(len(self.layout.embedding))
        alone = (LoadedRows(rows.summed, every, nothing) for rows in self.scaled)
        return np.asarray(np.min([joint_fit([rows], self.motors, ()).weights for rows in alone], axis=0))

    def _free(self, count: int) -> Layout:
        """The layout with the first base parameters of the load free in place of a body."""
        p = len(self.layout.embedding)
        empty, columns = np.zeros((10, count)), np.eye(p)[:, :count]
        return replace(self.layout, offsets=(np.zeros(p),), bases=(columns,), maps=((np.zeros(10), empty),))

    def _moved(self, link: str) -> Layout:
        """The layout with the payload on another link, of which the mass alone may be known."""
        moved = AttachedBody(self.body.name, link, mass=self.body.mass)
        return Layout.of(self.own, self.wide, self.layout.embedding, [moved], self.layout.shared)

    def _errors(self, layout: Layout, at_gains: bool = False, drives: tuple[int, ...] = ()) -> Array | None:
        """Weighted squared errors of the load's blocks, unseen by the fit, (blocks,); None where none converges.

        Args:
            at_gains: whether the gains are those of the fit, where no known mass tells them.
            drives: motors whose gain in the load's rows is another than in the bare ones, with `at_gains`.
        """
        gains, rows = (drives, self.scaled) if at_gains else (self.gains, self.rows)
        only, start = (1, None) if at_gains else (None, self.start)
        errors = np.empty(len(rows[1].observation.blocks))
        for own in (0, 1):
            unseen = rows[1].blocks[1 - own]
            seen = [LoadedRows(half.halves[own], *layout.affine(k)) for k, half in enumerate(rows)]
            try:
                fit = joint_fit(seen, self.motors, gains, only, start, _GAINS)
            except ConvergenceError:
                return None
            M, m = layout.affine(1)
            beta, scale = M @ fit.x + m, dict(zip(gains, np.exp(-fit.theta), strict=True))
            parts = [
                weight * np.linalg.norm(_residual(unseen.motors[k], scale.get(k, 1.0) * beta), axis=1)
                for k, weight in zip(self.motors, self._weights, strict=True)
            ]
            errors[1 - own :: 2] = np.square(parts).sum(axis=0)
        return errors

    def _drives(self, own: Array, free: Array | None, limit: float) -> str:
        """A sentence on motors that give another torque for their command with a payload than without; empty for none.

        Args:
            own: errors of the body as it is said, on unseen blocks.
            free: the same with any base parameters, which explain other changes better; None without a fit.
            limit: significance.
        """
        rows = [LoadedRows(one.observation, *self.layout.affine(k)) for k, one in enumerate(self.scaled)]
        try:
            fit = joint_fit(rows, self.motors, self.motors, 1)
        except ConvergenceError:  # a motor of which the bare device's parameters tell no torque
            return ""
        ways = fit.of_gains()
        spread = fit.spread(ways)
        reach = half_width(np.sqrt(np.diag(spread.covariance)), spread.dof, 1 - _SIGNIFICANCE / len(self.motors))
        told = fit.determined(ways) & (np.abs(fit.theta) > np.maximum(reach, np.log(_DRIVE)))
        found = tuple(k for k, own_told in zip(self.motors, told, strict=True) if own_told)
        errors = self._errors(self.layout, at_gains=True, drives=found) if found else None
        if errors is None or not _p(own - errors) < limit or (free is not None and _p(errors - free) < limit):
            return ""
        labels = [self.rows[0].observation.motors[k].label for k in found]
        sizes = ", ".join(f"{x:.3g}" for x in np.exp(fit.theta[told]))
        return (
            f"With payload {self.body.name} the drive of {listed(labels)} gives {sizes} times the torque for its "
            f"command that it gives without (limits {1 / _DRIVE:.3g} and {_DRIVE:.3g}), beyond its interval, and "
            "unseen rows tell it too: the figures are no body's. Record both logs with one drive, warm alike, and "
            "check its current limit."
        )

    def _mass(self, link: str) -> tuple[float, float, float] | None:
        """Mass of the payload on a link and its 95 % interval, kg; None where it is given, not determined, or without
        a fit."""
        if self.body.mass is not None:
            return None
        layout = self.layout if link == self.body.link else self._moved(link)
        rows = [LoadedRows(one.observation, *layout.affine(k)) for k, one in enumerate(self.rows)]
        try:
            fit = joint_fit(rows, self.motors, ())
        except ConvergenceError:
            return None
        columns, offset, basis = layout.columns(0)
        way = np.zeros((1, len(fit.scale)))
        way[0, columns] = basis[9]
        if not fit.determined(way)[0]:
            return None
        mass = float(offset[9] + basis[9] @ fit.x[columns])
        low, high = fit.spread(way).quantities(("M",), ("kg",), np.array([mass])).conf_int()[0]
        return mass, float(low), float(high)


def _at_gains(observation: Observation, fit: JointFit) -> Observation:
    """The rows in the torque of the motors at the gains of a fit."""
    motors = list(observation.motors)
    for k, theta in zip(fit.gains, fit.theta, strict=True):
        factor = np.append(np.full(motors[k].r_factors.shape[2] - 1, np.exp(-theta)), 1.0)
        motors[k] = replace(motors[k], r_factors=motors[k].r_factors * factor)
    return replace(observation, motors=tuple(motors))


def body_links(model: DynamicModel) -> list[str]:
    """Links that have a body, by the names of their joints."""
    return [joint.name for joint in model.device.joints if joint.body]


def _residual(motor: MotorRows, beta: Array) -> Array:
    """Residual of each block's R factor, whose norm is that of its rows, (blocks, p + 1)."""
    return np.asarray(motor.r_factors @ np.append(beta[motor.columns], -1.0))


def _p(differences: Array) -> float:
    """One-sided p-value that blocks' differences are not above zero: by their mean, or by their signed ranks."""
    n = len(differences)
    se = float(differences.std(ddof=1)) / np.sqrt(n)
    mean = float(t_tail(differences.mean() / se, n - 1)) if se > 0 else float(differences.mean() <= 0)
    return min(1.0, 2 * min(mean, signed_rank_tail(differences)))
