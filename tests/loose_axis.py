"""One axis whose link is loose in the play of its transmission, or rigid, under a controller: many logs side by side.

Two bodies with a stiff spring outside a dead zone, and dry friction with presliding, integrated in tenths of a
millisecond: another law and another method than those of the tested search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import haptid
from haptid.device.toml.reader import checked_tables, device_of

LINK, ROTOR, STIFFNESS, DAMPING, VISCOUS, CRANK = 0.1, 0.05, 2e4, 3.0, 0.1, 0.1
DT, STEPS = 1e-3, 10
TERMS = [
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "coulomb", "joints": "all"},
]


@dataclass(frozen=True)
class Axis:
    """What differs from log to log.

    Attributes:
        play: from end to end, rad; None for a rigid axis.
        dry: friction of link and motor, N m.
        presliding: distance over which it builds up, rad.
        stribeck: friction at standstill over Coulomb friction, less one.
        counts: of the encoder.
        noise: of the torque, N m.
        gravity: whether the axis is horizontal.
        stiffness: of the spring, N m/rad.
    """

    play: float | None = None
    dry: tuple[float, float] = (0.2, 0.1)
    presliding: float = 2e-4
    stribeck: float = 0.0
    counts: float = 20_000.0
    noise: float = 0.02
    gravity: bool = False
    stiffness: float = STIFFNESS


def model(gravity: bool) -> haptid.DynamicModel:
    """The rigid axis."""
    g = [0.0, -9.81, 0.0] if gravity else [0.0, 0.0, -9.81]
    data = {"schema": 1, "name": "axis", "gravity": g, "joints": [{"name": "1"}], "terms": TERMS}
    return haptid.DynamicModel(device_of(*checked_tables(data, "axis.toml")))


def _planned(seed: int, samples: int) -> np.ndarray:
    """Sines up to 3 Hz, rad."""
    rng, t = np.random.default_rng(seed), DT * np.arange(samples)
    f = np.linspace(0.2, 3.0, 8)
    size, phase = rng.uniform(0.7, 1.3, 8) / np.sqrt(f), rng.uniform(0, 2 * np.pi, 8)
    wave = size @ np.sin(2 * np.pi * f[:, None] * t + phase[:, None])
    return 0.3 + 0.8 * np.clip(t / 0.5, 0, 1) ** 2 * wave / np.abs(wave).max()


def recorded(axis: Axis, seeds: Sequence[int], seconds: float = 15.0, link: bool = False) -> list[haptid.Log]:
    """Motor position and torque, a log for each seed; with positions of the link where told."""
    samples, h = round(seconds / DT), DT / STEPS
    plan = np.array([_planned(seed, samples) for seed in seeds])
    noise = axis.noise * np.array([np.random.default_rng(10_000 + s).standard_normal(samples) for s in seeds])
    v_plan = np.gradient(plan, DT, axis=1)
    weight, step, total = CRANK * 9.81 * axis.gravity, 2 * np.pi / axis.counts, LINK + ROTOR
    ahead = total * np.gradient(v_plan, DT, axis=1) + sum(axis.dry) * np.tanh(v_plan / 0.05)
    x, y = plan[:, 0].copy(), plan[:, 0].copy()
    v, w, bent, bent_link, speed = np.zeros((5, len(seeds)))
    position, linked, torque, before = np.empty_like(plan), np.empty_like(plan), np.empty_like(plan), x
    for k in range(samples):
        seen = np.round(x / step) * step
        speed, before = speed + 0.3 * ((seen - before) / DT - speed), seen
        u = 80 * (plan[:, k] - seen) + 3 * (v_plan[:, k] - speed) + ahead[:, k] + weight * np.cos(seen)
        position[:, k], linked[:, k] = seen, np.round(y / step) * step
        torque[:, k], acted = u, u + noise[:, k]
        for _ in range(STEPS):
            bent = _bent(bent, h * v, axis.presliding)
            if axis.play is None:
                dry = sum(axis.dry) * (1 + axis.stribeck * np.exp(-((v / 0.1) ** 2))) * bent
                v = v + h * (acted - dry - VISCOUS * v - weight * np.cos(x)) / total
                x = x + h * v
                continue
            bent_link = _bent(bent_link, h * w, axis.presliding)
            held = np.clip(x - y, -axis.play / 2, axis.play / 2)
            push = axis.stiffness * (x - y - held) + DAMPING * (v - w)
            push = np.where(push * (x - y - held) > 0, push, 0.0)  # flanks do not pull
            v = v + h * (acted - push - axis.dry[1] * bent) / ROTOR
            w = w + h * (push - axis.dry[0] * bent_link - VISCOUS * w - weight * np.cos(y)) / LINK
            x, y = x + h * v, y + h * w
    names = ("link", "q") if link else ("q",)
    channels = haptid.Channels(haptid.Signal(names, "rad"), haptid.Signal(("u",), "N m", side="motor"), "t")
    t = DT * np.arange(samples)
    return [
        haptid.Log(
            Path("made"),
            str(s),
            t,
            np.column_stack([y, q] if link else [q]),
            np.ascontiguousarray(u[:, None]),
            channels,
        )
        for s, y, q, u in zip(seeds, linked, position, torque, strict=True)
    ]


def _bent(z: np.ndarray, dx: np.ndarray, distance: float) -> np.ndarray:
    """Dahl's friction over Coulomb's after a step."""
    return (z + dx / distance) / (1 + np.abs(dx) / distance)


def estimated(axis: Axis, log: haptid.Log) -> haptid.Estimate:
    """The rigid axis from a log, treated as proposed."""
    own = model(axis.gravity)
    return haptid.estimate(haptid.observe(own, haptid.treat(log, haptid.propose(own, log).treatment)), haptid.WLS())
