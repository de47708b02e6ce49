"""Torque that a motor lacks while its link is loose in the play of the transmission, along the motor's motion.

Where the torque that the link needs changes its sign, the link leaves the flank that it leaned on and moves by itself:
its motor turns the rotor alone. When it has crossed the play, it lands on the other flank, and the motor gives it back
the momentum that it lacked. Flanks only push, and landing is plastic: Moreau's time stepping of unilateral contact.

Sources: Nordin and Gutman (2002), Automatica 38(10), section 3, of models of backlash; Moreau (1988), in Nonsmooth
Mechanics and Applications, CISM 302, for the steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array

# Least inertia at a motor over its median: that of an estimate need not be positive in every pose.
_LEAST = 0.1
# Parts of the motion that are integrated side by side, at most, with about so many links in all; steps in a block.
_PARTS, _CELLS, _BLOCK = 16, 1500, 25


@dataclass(frozen=True, eq=False)
class LooseLinks:
    """Motion of motors, and what it takes where links follow them.

    Attributes:
        dt: sampling period, s.
        x, v, a: of each motor, (motors, samples), SI.
        inertia: that it turns, (motors, samples).
        rest: torque without that of inertia and friction: gravity, coupling, (motors, samples), N m or N.
        dry, viscous: friction of motor and link, (motors,).
    """

    dt: float
    x: Array
    v: Array
    a: Array
    inertia: Array
    rest: Array
    dry: Array
    viscous: Array

    @staticmethod
    def of(dt: float, motion: tuple[Array, Array, Array], torque: Array, friction: Array, inertia: Array) -> LooseLinks:
        """From the torque of a rigid model, and its part that is friction, (motors, samples)."""
        x, v, a = motion
        least = _LEAST * np.abs(np.median(inertia, axis=1, keepdims=True))
        M, laws = np.maximum(inertia, np.maximum(least, np.finfo(float).tiny)), []
        for speed, own in zip(v, friction, strict=True):
            laws.append(np.linalg.lstsq(np.array([np.sign(speed), speed]).T, own, rcond=None)[0])
        dry, viscous = np.maximum(np.array(laws).T, 0.0)
        return LooseLinks(dt, x, v, a, M, torque - friction - M * a, dry, viscous)

    def alone(self, motor: int) -> LooseLinks:
        """One motor."""
        own = slice(motor, motor + 1)
        signals = (y[own] for y in (self.x, self.v, self.a, self.inertia, self.rest, self.dry, self.viscous))
        return LooseLinks(self.dt, *signals)

    def change(self, size: Array, share: Array, friction: Array) -> Array:
        """Torque with play less torque without, (motors, cases, samples), N m or N.

        Args:
            size: the play from flank to flank, of each case, (motors, cases), rad or m.
            share: of the inertia that is the link's, (motors, cases).
            friction: share of the friction that acts on the link, (motors, cases).
        """
        made = _Steps.of(self, size, share, friction).landings()
        made *= share[:, :, None] * (self.inertia / self.dt**2)[:, None]
        made -= share[:, :, None] * (self.inertia * self.a)[:, None] + self.rest[:, None]
        law = self.dry[:, None] * np.sign(self.v) + self.viscous[:, None] * self.v
        made -= friction[:, :, None] * law[:, None]
        made[:, :, -1] = 0.0
        return made


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of all links, parts of the motion side by side.

    A link that leans on a flank does not remember what it did before. So all parts begin with a guess, and once more
    where the part before has ended, until the links are where they were: from there on they would do the same again.

    Attributes:
        start: what the motor moves in a step at the beginning of each part, (motors, 1, parts), rad or m.
        moved, motor: what it moves in each, by its positions and by its speed, (steps, motors, 1, parts).
        pull, light: what a link loses to the torque of the rest, times its share, and inverse inertia, likewise.
        half: of the play, (motors, cases, 1).
        share: of the inertia that is the link's, likewise.
        damping, stop: its friction in a step over its share, likewise.
        samples: of the motion.
    """

    start: Array
    moved: Array
    motor: Array
    pull: Array
    light: Array
    half: Array
    share: Array
    damping: Array
    stop: Array
    samples: int

    @staticmethod
    def of(links: LooseLinks, size: Array, share: Array, friction: Array) -> _Steps:
        """Of cases of each motor, (motors, cases)."""
        dt, samples = links.dt, links.x.shape[1]
        parts = min(_PARTS, max(1, _CELLS // size.size))
        length = _BLOCK * -(-samples // (parts * _BLOCK))

        def parted(signal: Array) -> Array:
            filled = np.pad(signal, ((0, 0), (0, -samples % length)), mode="edge")
            return np.moveaxis(filled.reshape(len(signal), 1, -1, length), 3, 0)

        def each(case: Array) -> Array:
            return case[:, :, None]

        speed, moved = dt * links.v, np.diff(links.x, append=links.x[:, -1:])
        later = np.concatenate([speed[:, 1:], speed[:, -1:]], axis=1)
        return _Steps(
            start=parted(speed)[0],
            moved=parted(moved),
            motor=parted(later),
            pull=parted(dt**2 * links.rest / links.inertia),
            light=parted(1 / links.inertia),
            half=each(0.5 * size),
            share=each(share),
            damping=each(dt * friction * links.viscous[:, None] / share),
            stop=each(dt**2 * friction * links.dry[:, None] / share),
            samples=samples,
        )

    def landings(self) -> Array:
        """What flanks add to the displacement of links in each step, (motors, cases, samples), rad or m."""
        length, motors, _, parts = self.moved.shape
        cells = (motors, self.half.shape[1], parts)
        begin = np.zeros((2, *cells))
        begin[1] = self.start
        added, states = np.empty((length, *cells)), np.full((length // _BLOCK + 1, 2, *cells), np.nan)
        due = np.arange(parts)
        for _ in range(parts):
            state = begin[..., due]
            for block, before in enumerate(states):
                if np.array_equal(before[..., due], state):
                    break
                before[..., due] = state
                if block < len(states) - 1:
                    rows = slice(_BLOCK * block, _BLOCK * (block + 1))
                    state, added[rows][..., due] = self._block(rows, due, *state)
            begin[..., 1:] = states[-1][..., :-1]
            due = np.flatnonzero((begin != states[0]).any(axis=(0, 1, 2)))
            if not len(due):
                break
        return np.moveaxis(added, 0, -1).reshape(*cells[:2], -1)[..., : self.samples]

    def _block(self, rows: slice, due: np.ndarray, at: Array, moved: Array) -> tuple[Array, Array]:
        """Some steps of some parts: places in the play and displacements at the end, and what flanks have added."""
        flank, motor, pull, light = (y[rows][..., due] for y in (self.moved, self.motor, self.pull, self.light))
        keep, lose, stop = 1 - light * self.damping, pull / self.share, light * self.stop
        # Whole arrays: within a step NumPy is slow where it broadcasts short axes.
        flank, motor = (np.broadcast_to(y, keep.shape).copy() for y in (flank, motor))
        low, high = -stop, np.broadcast_to(self.half, at.shape).copy()
        other, added = -high, np.empty(keep.shape)
        for k in range(_BLOCK):
            free = keep[k] * moved
            free -= lose[k]
            free -= np.minimum(np.maximum(free, low[k]), stop[k])
            ahead = at + free
            ahead -= flank[k]
            at = np.minimum(np.maximum(ahead, other), high)
            lands = (at - ahead) * (motor[k] - free) > 0
            moved = np.where(lands, motor[k], free)
            np.subtract(moved, free, out=added[k])
        return np.array([at, moved]), added
