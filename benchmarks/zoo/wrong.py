"""Wrong causes of the zoo: a log or a device file that is wrong in one known way, and the action that would mend it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from haptid.study.identify import Identification, identify
from haptid.study.read import read_study
from zoo.case import Array, Case
from zoo.plant import Fourier, Plant, device_text
from zoo.recording import Recorded, record, rms, write

# Of each cause the kinds of action that mend it; devices in which it can be; its range of sizes.
CAUSES: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[float, float]]] = {
    "torque sign": (("torque sign", "position sign"), ("axis", "pendulum", "arm2", "arm3", "phantom"), (1, 1)),
    "position sign": (("position sign", "torque sign"), ("pendulum", "arm2", "arm3", "phantom"), (1, 1)),
    "unit": (("unit", "gain"), ("arm2", "arm3", "phantom"), (1000, 1000)),
    "torque swap": (("torque swap",), ("arm2", "arm3", "phantom"), (1, 1)),
    "dead": (("dead torque",), ("arm2", "arm3", "phantom"), (0.7, 0.95)),
    "coarse": (("coarse torque",), ("axis", "arm2", "arm3"), (12, 24)),
    "stuck": (("stuck position",), ("axis", "pendulum", "arm2", "arm3"), (15, 40)),
    "clipping": (("clipped torque",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.005, 0.009)),
    "gain": (("gain",), ("arm2", "arm3", "phantom"), (1.15, 1.6)),
    "time shift": (("time shift",), ("pendulum", "arm2", "arm3", "phantom"), (8, 15)),
    "contact": (("contact",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.4, 1.0)),
    "spring": (("spring",), ("axis", "pendulum", "arm2", "arm3"), (0.1, 0.4)),
    "rotor inertia": (("rotor inertia",), ("arm2", "arm3"), (0.1, 0.4)),
    "stribeck": (("stribeck",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.3, 0.6)),
    "load friction": (("load friction",), ("arm2", "arm3", "phantom"), (0.1, 0.3)),
    "asymmetry": (("offset", "viscosity by direction"), ("pendulum", "arm2", "arm3"), (0.05, 0.2)),
    "ripple": (("ripple",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.05, 0.15)),
    "length": (("length",), ("arm2", "arm3"), (0.03, 0.1)),
    "angle": (("zero offset", "gravity direction"), ("pendulum", "arm2", "arm3"), (0.03, 0.1)),
    "payload": (("payload",), ("pendulum", "arm2", "arm3"), (0.1, 0.4)),
    "drift": (("drift",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.2, 0.5)),
    "degressive friction": (
        ("degressive friction", "bent viscosity"),
        ("axis", "pendulum", "arm2", "arm3", "phantom"),
        (0.5, 0.9),
    ),
    "warming": (("drift",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.1, 0.4)),
    "wandering offset": (("drift",), ("axis", "pendulum", "arm2", "arm3", "phantom"), (0.05, 0.15)),
}
# Devices on which each cause is made.
DEVICES_EACH = 3
# Waves of a ripple in a turn; Stribeck velocity and that by which degressive friction rises, over the rms speed;
# episodes of a contact and of a stuck position; steps of a random walk.
WAVES, SPEED, RISES, EPISODES, KNOTS = 18, 0.2, 0.4, 25, 400


@dataclass(frozen=True)
class WrongPlant(Plant):
    """A plant in which a cause acts that its device file does not have, or a right one where it is "none".

    Attributes:
        cause: in `CAUSES`.
    """

    cause: str = "none"

    @cached_property
    def size(self) -> float:
        low, high = CAUSES[self.cause][2]
        return float(self.case.random("size").uniform(low, high))

    @cached_property
    def motor(self) -> int:
        """The motor that it concerns; the last for what the first one's parameters would absorb."""
        motors = len(self.model.device.row_names)
        if self.cause == "rotor inertia":
            return motors - 1
        return int(self.case.random("motor").integers(motors))

    @cached_property
    def typical(self) -> Array:
        """Root mean square torque of the rows, (rows,), N m."""
        return np.array([rms(row) for row in self._modelled(self.motion.states(self._grid), self.beta)])

    def act(self, motion: Fourier, t: Array) -> tuple[tuple[Array, Array, Array], Array]:
        states, tau = super().act(motion, t)
        extra = self._torque(states, t)
        return states, tau if extra is None else tau + extra

    def _torque(self, states: tuple[Array, Array, Array], t: Array) -> Array | None:
        """Torque of the cause, (rows, samples); None where it is none of torque."""
        frame = self.model.device.row_map
        c, cd, cdd = (frame @ x for x in states)
        k, size, typical = self.motor, self.size if self.cause != "none" else 0.0, self.typical
        made, sign = np.zeros_like(c), np.tanh(cd / (1e-3 * self.speed[:, None]))
        share = t / self.case.seconds
        match self.cause:
            case "spring":
                made[k] = size * typical[k] * (c[k] - c[k].mean()) / c[k].std()
            case "rotor inertia":
                made[k] = size * typical[k] * cdd[k] / rms(cdd[k])
            case "stribeck":
                made = size * typical[:, None] * sign * np.exp(-((cd / (SPEED * self.speed[:, None])) ** 2))
            case "degressive friction":  # of the Coulomb friction, what is not there in slow motion
                slow = np.exp(-np.abs(cd) / (RISES * self.speed[:, None]))
                made = -size * self.coulomb[:, None] * sign * slow
            case "load friction":
                made = size * np.abs(self._modelled(states, self.frictionless)) * sign
            case "asymmetry":
                made[k] = size * typical[k]
            case "ripple":
                made[k] = np.sqrt(2) * size * typical[k] * np.sin(WAVES * c[k])
            case "drift":
                made = size * typical[:, None] * (share - 0.5) * sign
            case "warming":  # less friction, with a time constant of a tenth to a half of the log
                left = np.exp(-share / self.case.random("warm").uniform(0.1, 0.5))
                made = size * typical[:, None] * left * (sign + cd / self.speed[:, None])
            case "wandering offset":
                steps = self.case.random("offset").normal(size=(len(c), KNOTS))
                walk = np.cumsum(steps, axis=1) / np.sqrt(KNOTS)
                knots = np.linspace(0, 1, KNOTS)
                made = size * typical[:, None] * np.stack([np.interp(share, knots, one) for one in walk])
            case "contact":
                for start in (0.15, 0.45, 0.75):
                    inside = (share > start) & (share < start + 0.06)
                    made[:, inside] += size * typical[:, None] * np.sin(np.pi * (share[inside] - start) / 0.06)
            case "payload":
                made = size * self._point_mass(states) * (share > 0.55)
            case _:
                return None
        return made

    def _point_mass(self, states: tuple[Array, Array, Array]) -> Array:
        """Torque of a point mass at the last link, as large as the device's own, (rows, samples)."""
        chi = np.zeros(len(self.chi))
        names, link = self.model.device.parameters.names, self.model.device.joints[-1].name
        for name, value in ((f"M{link}", 1.0), (f"MX{link}", 0.2), (f"ZZ{link}", 0.04), (f"YY{link}", 0.04)):
            if name in names:
                chi[names.index(name)] = value
        made = self._modelled(states, np.asarray(self.model.base.of(chi)))
        return made * (np.linalg.norm(self.typical) / np.linalg.norm([rms(row) for row in made]))


def recorded(plant: WrongPlant) -> Recorded:
    """The log of a wrong case."""
    made, k, rng = record(plant), plant.motor, plant.case.random("fault")
    q, u, n = np.array(made.q), np.array(made.command), len(made.t)
    size = plant.size if plant.cause != "none" else 0.0
    match plant.cause:
        case "torque sign":
            u[k] *= -1
        case "position sign":
            q[k] *= -1
        case "unit" | "gain":
            u[k] *= size
        case "torque swap":
            j = (k + 1) % len(u)
            u[[k, j]] = u[[j, k]]
        case "dead":
            start = int(rng.integers(0, round(size * n) + 1))
            u[k, :start] = u[k, start + round((1 - size) * n) :] = 0.0
        case "coarse":
            step = np.ptp(u, axis=1, keepdims=True) / size
            u = step * np.round(u / step)
        case "stuck":
            length = int(size)
            for start in rng.integers(0, n - length, EPISODES):
                q[k, start : start + length] = q[k, start]
        case "clipping":
            top = np.quantile(np.abs(u), 1 - size, axis=1, keepdims=True)
            u = np.clip(u, -top, top)
        case "time shift":
            u[k] = np.roll(u[k], round(size))
            q, u = q[:, 20:], u[:, 20:]
            return Recorded(made.t[20:], q, u, made.delays)
        case "angle":
            q[k] += size
    return Recorded(made.t, q, u, made.delays)


def written(plant: WrongPlant, folder: Path) -> Path:
    """The study of a wrong case."""
    study = write(plant, recorded(plant), folder)
    if plant.cause == "length":
        text = device_text(plant.case)
        value = _length(tomllib.loads(text))
        key, number = value
        assert f"{key} = {number}" in text
        changed = text.replace(f"{key} = {number}", f"{key} = {number * (1 + plant.size)!r}", 1)
        (folder / "device.toml").write_text(changed, encoding="utf-8")
    return study


def _length(tables: dict) -> tuple[str, float]:  # type: ignore[type-arg]
    """The first length of a device file, and its key."""
    for name, value in tables.get("lengths", {}).items():
        return name, value
    for joint in tables["joints"]:
        for key in ("d", "r", "a"):
            if isinstance(joint.get(key), float) and joint[key]:
                return key, joint[key]
    raise AssertionError("a device without lengths")


def wrong_cases(each: int, seed: int) -> Iterator[WrongPlant]:
    """So many cases of every cause on every one of up to `DEVICES_EACH` devices that can have it."""
    rng = np.random.default_rng([seed, 15])
    number = 0
    for cause, (_, devices, _) in CAUSES.items():
        for device in rng.permutation(devices)[:DEVICES_EACH]:
            for _ in range(each):
                number += 1
                yield WrongPlant(_case(rng, str(device), 1000 * seed + number), cause)


def right_cases(count: int, seed: int) -> Iterator[WrongPlant]:
    """Right models: a third with noise inside the loop, a third with coarse encoders."""
    rng = np.random.default_rng([seed, 16])
    for k in range(count):
        case = _case(rng, str(rng.choice(["axis", "pendulum", "arm2", "arm3", "phantom"])), 1000 * seed + 500_000 + k)
        if k % 3 == 1:
            case = replace(case, bits=int(rng.integers(11, 13)))
        if k % 3 == 2:
            case = replace(case, loop=True, rate=500.0, seconds=12.0, delay=1.0, level=float(rng.uniform(0.003, 0.02)))
        yield WrongPlant(case)


def _case(rng: np.random.Generator, device: str, seed: int) -> Case:
    motion = float(np.exp(rng.uniform(np.log(0.6), np.log(2.5))))
    return Case(
        seed=seed,
        device=device,
        rate=float(rng.choice([250, 500, 1000])),
        seconds=float(rng.choice([12, 20, 30])),
        motion_hz=motion,
        harmonics=int(rng.integers(3, 6)),
        bits=int(rng.integers(14, 19)),
        friction=float(rng.choice([0.1, 0.3, 0.5])),
        noise=str(rng.choice(["white", "AR"])),
        level=float(np.exp(rng.uniform(np.log(0.004), np.log(0.03)))),
        delay=float(rng.choice([0.0, 0.5, 1.0])),
    )


def identified(plant: WrongPlant, folder: Path) -> Identification:
    """The study of a case, carried out."""
    return identify(read_study(written(plant, folder)))
