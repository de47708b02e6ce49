"""Cases of the zoo: what one simulated log is made with, and a stratified draw of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

Array = np.ndarray
# Share of the cases of each device, and the most samples of a log.
DEVICES = {"axis": 0.14, "pendulum": 0.14, "arm2": 0.18, "arm3": 0.22, "arm7": 0.12, "phantom": 0.12, "cea": 0.08}
LARGEST = {"arm7": 25_000, "cea": 25_000}
SAMPLES = 40_000
ONE_JOINT = ("axis", "pendulum")
RATES = (50, 100, 200, 250, 500, 1000, 2000, 4000)
# Samples in a period of the fastest harmonic, at least; periods of the slowest in a log, at least.
IN_PERIOD, PERIODS = 12, 3
MOTION_HZ, SECONDS = (0.05, 20.0), (5.0, 600.0)
# Above this a stroke is of mm: only fine encoders see the motion.
FAST_HZ, FINE_BITS = 4.0, 15
# Of cases on the bench, where noise acts inside the loop: rates of the log, highest motion, longest log, coarsest
# encoder. The controller has 1 kHz.
BENCH_RATES, BENCH_HZ, BENCH_SECONDS, BENCH_BITS = (250, 500, 1000), 4.0, 15.0, 14
MISFITS = ("presliding", "Stribeck", "load", "ripple", "elastic")
GEAR = 50.0


@dataclass(frozen=True)
class Case:
    """One simulated log.

    Attributes:
        seed: of all its random numbers.
        device: name in `DEVICES`.
        rate, seconds: of the log, Hz and s.
        motion_hz, harmonics: highest frequency of the motion, and number of its harmonics from the slowest on.
        bits, gear: of the encoder: 2**bits steps a turn, behind a gear if it is on the motor.
        friction: rms of the friction over rms of the torque.
        noise, level: kind of the torque noise (white, AR, walk), and its rms over the torque's.
        loop: whether the noise acts inside the control loop, unrecorded.
        encoder, steps: kind of the encoder's noise besides quantisation (none, AR, ripple), and its rms in steps.
        delay, spread: of the torque, samples; each motor's own within +-spread.
        jitter, stamps: sd of the sampling instants, samples; stamps are "true", or "false" where sampling is regular
            and only the stamps are not.
        stale, repeats: share of rows that repeat the one before, in their positions, torques or both.
        gaps: share of rows that are missing, in runs.
        misfit: effect that the model does not have, or none.
    """

    seed: int
    device: str
    rate: float
    seconds: float
    motion_hz: float
    harmonics: int
    bits: int = 16
    gear: float = 1.0
    friction: float = 0.3
    noise: str = "white"
    level: float = 0.02
    loop: bool = False
    encoder: str = "none"
    steps: float = 0.0
    delay: float = 0.0
    spread: float = 0.0
    jitter: float = 0.0
    stamps: str = "true"
    stale: float = 0.0
    repeats: str = "both"
    gaps: float = 0.0
    misfit: str = "none"

    @property
    def resolution_bits(self) -> float:
        """Bits of a turn of the joint."""
        return self.bits + float(np.log2(self.gear))

    @property
    def random(self) -> Random:
        return Random(self.seed)

    def __str__(self) -> str:
        """All settings that are not the default, in one line."""
        kept = [f for f in fields(self) if f.name != "seed" and (getattr(self, f.name) != f.default)]
        return f"#{self.seed} " + " ".join(f"{f.name}={_short(getattr(self, f.name))}" for f in kept)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Random:
    """Random numbers of a case, one stream for each purpose, so that to leave out one disturbance keeps the others."""

    seed: int

    def __call__(self, purpose: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, *purpose.encode()])


def draw(count: int, seed: int) -> list[Case]:
    """Cases with every factor stratified over all of them.

    Args:
        count: how many.
        seed: of the draw; case k has the seed 1000 seed + k.
    """
    rng = np.random.default_rng(seed)

    def levels(shares: dict[Any, float]) -> list[Any]:
        return _quota(rng, shares, count)

    def even(low: float, high: float) -> Array:
        return low + (high - low) * (rng.permutation(count) + rng.random(count)) / count

    columns: dict[str, Sequence[Any]] = {
        "device": levels(DEVICES),
        "motion_hz": np.exp(even(*np.log(MOTION_HZ))),
        "harmonics": levels({1: 0.1, 2: 0.1, 3: 0.25, 5: 0.3, 8: 0.25}),
        "seconds": np.exp(even(*np.log(SECONDS))),
        "bits": np.floor(even(10, 21)).astype(int),
        "gear": levels({1.0: 0.8, GEAR: 0.2}),
        "friction": levels({0.0: 0.1, 0.1: 0.15, 0.3: 0.3, 0.5: 0.25, 0.8: 0.2}),
        "noise": levels({"white": 0.4, "AR": 0.45, "walk": 0.15}),
        "level": np.exp(even(np.log(0.003), np.log(0.06))),
        "loop": levels({False: 0.86, True: 0.14}),
        "encoder": levels({("none", 0.0): 0.6, ("AR", 1.0): 0.14, ("AR", 4.0): 0.13, ("ripple", 2.0): 0.13}),
        "delay": levels({0.0: 0.3, 0.5: 0.3, 1.0: 0.15, 1.5: 0.1, 3.0: 0.15}),
        "spread": levels({0.0: 0.75, 0.5: 0.25}),
        "jitter": levels({0.0: 0.6, 0.05: 0.12, 0.3: 0.16, 0.6: 0.1, 1.5: 0.02}),
        "stamps": levels({"true": 0.5, "false": 0.5}),
        "stale": levels({0.0: 0.72, 0.03: 0.12, 0.13: 0.16}),
        "repeats": levels({"both": 0.5, "positions": 0.25, "torques": 0.25}),
        "gaps": levels({0.0: 0.88, 0.005: 0.06, 0.03: 0.06}),
        "misfit": levels({"none": 0.8, **dict.fromkeys(MISFITS, 0.2 / len(MISFITS))}),
        "place": rng.random(count),
    }
    return [_case(1000 * seed + k, {name: column[k] for name, column in columns.items()}) for k in range(count)]


def _quota(rng: np.random.Generator, shares: dict[Any, float], count: int) -> list[Any]:
    """Levels in proportion to their shares, in random order."""
    edges = np.cumsum(list(shares.values())) / sum(shares.values())
    places = (np.arange(count) + rng.random()) / count
    made = [list(shares)[min(int(k), len(shares) - 1)] for k in np.searchsorted(edges, places)]
    return [made[k] for k in rng.permutation(count)]


def _case(seed: int, drawn: dict[str, Any]) -> Case:
    """A possible case from drawn levels: what one recorder cannot do together is changed."""
    place, (encoder, steps) = drawn.pop("place"), drawn.pop("encoder")
    device, loop = drawn["device"], drawn["loop"]
    if device not in ONE_JOINT:
        drawn["harmonics"] = max(3, drawn["harmonics"])
    if device in ("phantom", "cea"):
        drawn["gear"] = 1.0
    if loop:  # nothing but the bench's own noise, and what the recorder does to time
        drawn["motion_hz"] = float(np.clip(drawn["motion_hz"], 0.3, BENCH_HZ))
        encoder, steps, drawn["misfit"], drawn["spread"], drawn["gear"] = "none", 0.0, "none", 0.0, 1.0
        drawn["bits"], drawn["stamps"] = max(BENCH_BITS, drawn["bits"]), "false"
    if drawn["motion_hz"] > FAST_HZ:
        drawn["bits"] = max(FINE_BITS, drawn["bits"])
    if drawn["misfit"] in ("presliding", "Stribeck", "load"):
        drawn["friction"] = max(0.3, drawn["friction"])
    most = BENCH_SECONDS if loop else SECONDS[1]
    period = drawn["harmonics"] / drawn["motion_hz"]
    while PERIODS * period > most and drawn["harmonics"] > (1 if device in ONE_JOINT else 3):
        drawn["harmonics"] -= 1
        period = drawn["harmonics"] / drawn["motion_hz"]
    if PERIODS * period > most:
        drawn["motion_hz"] = PERIODS * drawn["harmonics"] / most
        period = most / PERIODS
    seconds = float(np.clip(drawn["seconds"], PERIODS * period, most))
    largest = LARGEST.get(device, SAMPLES)
    fits = [f for f in (BENCH_RATES if loop else RATES) if f >= IN_PERIOD * drawn["motion_hz"]]
    rates = [f for f in fits if f * seconds <= largest] or fits[:1]
    rate = float(rates[int(place * len(rates))])
    seconds = max(min(seconds, largest / rate), PERIODS * period)
    settings = drawn | {"rate": rate, "seconds": round(seconds, 3), "encoder": encoder, "steps": steps}
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in settings.items()}
    return Case(seed=seed, **plain)
