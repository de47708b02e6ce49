"""Whether a payload is on the link that is said: other links, and any change at all, on blocks that no fit has seen.

Every candidate is fitted to every other block and judged on the rest, and the other way round: a body on the link that
is said, on each other link, none at all, and all base parameters free in the loaded rows. What none leaves over is the
load's effect; another link is the better one where it takes away clearly more of it, block for block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import ConvergenceError, listed
from haptid.inference.payloads.body import AttachedBody
from haptid.inference.payloads.fit import JointFit, LoadedRows, joint_fit
from haptid.inference.payloads.layout import Layout
from haptid.observation.observation import MotorRows, Observation
from haptid.uncertainty.distributions import signed_rank_tail, t_tail

# Blocks of a load, at least, of which half are fitted.
_FEWEST = 6
# Significance of what is said, over all candidates of a payload, and above which two links do as well.
_SIGNIFICANCE, _AS_WELL = 0.01, 0.05
# Times as much of the load's effect that the better link takes away, or times less that it leaves over, at least.
_CLEARLY = 1.25
# Share of the load's squared effect that counts as nothing left: a thousandth of its torque.
_NOTHING = 1e-6


@dataclass(frozen=True, eq=False)
class _Halves:
    """Alternate blocks of each load: to be judged on, and as one block each, which is what a fit needs of them."""

    blocks: list[tuple[Observation, Observation]]
    summed: list[tuple[Observation, Observation]]

    @staticmethod
    def of(observations: Sequence[Observation]) -> _Halves:
        blocks = [observation.alternate() for observation in observations]
        return _Halves(blocks, [(_summed(even), _summed(odd)) for even, odd in blocks])


@dataclass(frozen=True, eq=False)
class LinkTest:
    """Rows of the bare device and of each load, and what was fitted to them.

    Attributes:
        own, wide: models of the device, and with the payloads' parameters on every link that may carry one.
        layout: of the bodies on the links that are said.
        bodies: as given.
        observations: of the bare device and of each load, of the wide model.
        fit: with these bodies, of which the motors and gains are used.
    """

    own: DynamicModel
    wide: DynamicModel
    layout: Layout
    bodies: tuple[AttachedBody, ...]
    observations: tuple[Observation, ...]
    fit: JointFit

    def note(self, load: int) -> str:
        """A sentence on the link of a payload, by number; empty where nothing speaks against it."""
        body = self.bodies[load]
        others = [link for link in body_links(self.wide) if link != body.link]
        if len(self.observations[load + 1].blocks) < _FEWEST or not others:
            return ""
        bare = self._errors(self._free(load, 0), load, at_gains=True)
        own = self._errors(self.layout, load)
        if bare is None or own is None:
            return ""
        found = {link: e for link in others if (e := self._errors(self._moved(load, link), load)) is not None}
        effect, limit = bare.sum() - own.sum(), _SIGNIFICANCE / (len(others) + 1)
        # What is left below this is nothing: how many times more the other leaves over is rounding.
        nothing = _NOTHING * bare.sum()
        mass = cache(lambda link: self._mass(load, link))

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
        free = self._errors(self._free(load, len(self.layout.embedding)), load, at_gains=True)
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
    def _halves(self) -> _Halves:
        return _Halves.of(self.observations)

    @cached_property
    def _halves_at_gains(self) -> _Halves:
        return _Halves.of([self._at_gains(o) for o in self.observations]) if self.fit.gains else self._halves

    @cached_property
    def _weights(self) -> Array:
        """One over the residual of each motor where every load has parameters of its own, (motors,)."""
        every, nothing = np.eye(len(self.layout.embedding)), np.zeros(len(self.layout.embedding))
        alone = (LoadedRows(_summed(self._at_gains(o)), every, nothing) for o in self.observations)
        return np.asarray(np.min([joint_fit([rows], self.fit.motors, ()).weights for rows in alone], axis=0))

    def _free(self, load: int, count: int) -> Layout:
        """The layout with the first base parameters of a load free in place of a body."""
        offsets, bases, maps = list(self.layout.offsets), list(self.layout.bases), list(self.layout.maps)
        offsets[load] = np.zeros(len(self.layout.embedding))
        bases[load] = np.eye(len(self.layout.embedding))[:, :count]
        maps[load] = np.zeros(10), np.zeros((10, count))
        return replace(self.layout, offsets=tuple(offsets), bases=tuple(bases), maps=tuple(maps))

    def _moved(self, load: int, link: str) -> Layout:
        """The layout with a payload on another link, of which the mass alone may be known."""
        body = self.bodies[load]
        bodies = list(self.bodies)
        bodies[load] = AttachedBody(body.name, link, mass=body.mass)
        return Layout.of(self.own, self.wide, self.layout.embedding, bodies, self.layout.shared)

    def _errors(self, layout: Layout, load: int, at_gains: bool = False) -> Array | None:
        """Weighted squared errors of a load's blocks, of which no fit has seen its own, (blocks,); None without a fit.

        Args:
            at_gains: whether the gains are those of the fit, where no known mass tells them.
        """
        gains, halves = ((), self._halves_at_gains) if at_gains else (self.fit.gains, self._halves)
        errors = np.empty(len(self.observations[load + 1].blocks))
        for own in (0, 1):
            unseen = halves.blocks[load + 1][1 - own]
            rows = [LoadedRows(half[own], *layout.affine(k)) for k, half in enumerate(halves.summed)]
            try:
                fit = joint_fit(rows, self.fit.motors, gains)
            except ConvergenceError:
                return None
            M, m = layout.affine(load + 1)
            beta, scale = M @ fit.x + m, dict(zip(gains, np.exp(-fit.theta), strict=True))
            parts = [
                weight * np.linalg.norm(_residual(unseen.motors[k], scale.get(k, 1.0) * beta), axis=1)
                for k, weight in zip(self.fit.motors, self._weights, strict=True)
            ]
            errors[1 - own :: 2] = np.square(parts).sum(axis=0)
        return errors

    def _at_gains(self, observation: Observation) -> Observation:
        """The rows in the torque of the motors at the gains of the fit."""
        motors = list(observation.motors)
        for k, theta in zip(self.fit.gains, self.fit.theta, strict=True):
            factor = np.append(np.full(motors[k].r_factors.shape[2] - 1, np.exp(-theta)), 1.0)
            motors[k] = replace(motors[k], r_factors=motors[k].r_factors * factor)
        return replace(observation, motors=tuple(motors))

    def _mass(self, load: int, link: str) -> tuple[float, float, float] | None:
        """Mass of a payload on a link and its 95 % interval, kg; None where it is given, not determined, or without a
        fit."""
        if self.bodies[load].mass is not None:
            return None
        layout, fit = self.layout, self.fit
        if link != self.bodies[load].link:
            layout = self._moved(load, link)
            rows = [LoadedRows(o, *layout.affine(k)) for k, o in enumerate(self.observations)]
            try:
                fit = joint_fit(rows, self.fit.motors, self.fit.gains)
            except ConvergenceError:
                return None
        columns, offset, basis = layout.columns(load)
        way = np.zeros((1, len(fit.scale)))
        way[0, columns] = basis[9]
        if not fit.determined(way)[0]:
            return None
        mass = float(offset[9] + basis[9] @ fit.x[columns])
        low, high = fit.spread(way).quantities(("M",), ("kg",), np.array([mass])).conf_int()[0]
        return mass, float(low), float(high)


def body_links(model: DynamicModel) -> list[str]:
    """Links that have a body, by the names of their joints."""
    return [joint.name for joint in model.device.joints if joint.body]


def _summed(observation: Observation) -> Observation:
    """All rows as one block: what a fit needs of them."""
    motors = (
        replace(motor, r_factors=motor.whole[None], rows=np.array([motor.rows.sum()])) for motor in observation.motors
    )
    return replace(observation, motors=tuple(motors), blocks=observation.blocks[:1])


def _residual(motor: MotorRows, beta: Array) -> Array:
    """Residual of each block's R factor, whose norm is that of its rows, (blocks, p + 1)."""
    return np.asarray(motor.r_factors @ np.append(beta[motor.columns], -1.0))


def _p(differences: Array) -> float:
    """One-sided p-value that blocks' differences are not above zero: by their mean, or by their signed ranks."""
    n = len(differences)
    se = float(differences.std(ddof=1)) / np.sqrt(n)
    mean = float(t_tail(differences.mean() / se, n - 1)) if se > 0 else float(differences.mean() <= 0)
    return min(1.0, 2 * min(mean, signed_rank_tail(differences)))
