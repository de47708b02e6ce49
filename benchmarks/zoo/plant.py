"""Plants of the zoo: devices, their true parameters and motion, and the torque that acts along it."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

import haptid
from haptid.observation.reversals import smoothed_friction
from zoo.case import Array, Case

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from true_parameters import true_parameters

HERE = Path(__file__).parent
LIBRARY = Path(haptid.__file__).parent / "device/library"
FILES = {
    **{name: HERE / "devices" / f"{name}.toml" for name in ("axis", "pendulum", "arm2")},
    "arm3": LIBRARY / "arm3.toml",
    "arm7": LIBRARY / "arm7.toml",
    "phantom": LIBRARY / "phantom_premium_15.toml",
    "cea": LIBRARY / "cea_medical_branch.toml",
}
FRICTION = """
[[terms]]
kind = "viscous"
joints = "all"

[[terms]]
kind = "coulomb"
joints = "all"
"""
# Centre and largest excursion of the joints, rad.
REACH: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "axis": ((0.0,), (1.2,)),
    "pendulum": ((0.4,), (1.2,)),
    "arm2": ((0.3, -0.4), (1.1, 1.2)),
    "arm3": ((0.0, 0.7, -1.0), (1.2, 1.0, 1.1)),
    "arm7": ((0.0, 0.5, 0.0, -1.2, 0.0, 0.6, 0.0), (0.8, 0.6, 0.8, 0.6, 0.8, 0.7, 0.8)),
    "phantom": ((0.0, 0.2, 0.3), (0.9, 0.45, 0.48)),
    "cea": ((0.1, -1.0, 0.65 + np.pi), (1.0, 0.5, 0.5)),
}
# Largest speed, rad/s, and acceleration, rad/s^2.
FASTEST, HARDEST = 8.0, 60.0
# Width of the true friction's sign, as a share of the rms speed.
SOFT = 1e-3
# Share of the friction that is dry, and what it has of viscous one, over the friction's size.
DRY, VISCOUS = 0.85, 0.5
# Unmodelled effects: Stribeck excess and speed (share of rms), load share, ripple share and waves a turn, resonance
# over the motion's frequency with the motor's share of the inertia, presliding length over the joint's excursion.
EXCESS, STRIBECK, LOAD, RIPPLE, WAVES, RESONANCE, ROTOR, BREAK = 0.4, 0.2, 0.15, 0.02, 24, 15.0, 0.3, 0.01


def device_text(case: Case) -> str:
    """The device file of a case, with its gears and friction."""
    text = FILES[case.device].read_text(encoding="utf-8")
    joints = len(REACH[case.device][0])
    if case.device == "arm7":
        text += FRICTION
    if case.gear != 1.0:
        if "[[motors]]" not in text:
            text += "".join(f'\n[[motors]]\nname = "{k}"\ndrives = {{ {k} = 1 }}\n' for k in range(1, joints + 1))
        for k in range(1, joints + 1):
            text = text.replace(f"drives = {{ {k} = 1 }}", f"drives = {{ {k} = 1 }}\ngear_ratio = {case.gear:g}")
    return text


@lru_cache(maxsize=32)
def _model(text: str) -> haptid.DynamicModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.toml"
        path.write_text(text, encoding="utf-8")
        return haptid.DynamicModel(haptid.read_device(path))


class Fourier:
    """Motion q(t) = centre + sum a sin(w t + p), exactly, with its derivatives; (joints, samples)."""

    def __init__(self, rng: np.random.Generator, case: Case) -> None:
        centre, reach = map(np.array, REACH[case.device])
        many = np.arange(1, case.harmonics + 1)
        self.w = 2 * np.pi * case.motion_hz / case.harmonics * many
        a = rng.normal(size=(len(centre), case.harmonics)) / np.sqrt(many)
        a[:, -1] = np.sign(a[:, -1]) * np.maximum(np.abs(a[:, -1]), 0.3)
        bounds = [limit / (np.abs(a) * self.w**k).sum(axis=1) for k, limit in enumerate((reach, FASTEST, HARDEST))]
        self.a = a * np.min(bounds, axis=0)[:, None]
        self.p = rng.uniform(0, 2 * np.pi, a.shape)
        self.centre = centre

    def __call__(self, t: Array, order: int = 0) -> Array:
        angle = self.w[:, None] * t + 0.5 * np.pi * order
        out = np.stack([(a * self.w**order) @ np.sin(angle + p[:, None]) for a, p in zip(self.a, self.p, strict=True)])
        return out + (self.centre[:, None] if order == 0 else 0.0)

    def states(self, t: Array) -> tuple[Array, Array, Array]:
        return self(t, 0), self(t, 1), self(t, 2)

    @property
    def edge_hz(self) -> float:
        """Frequency below which 98 % of the velocity's power lies, of the joint where it is highest."""
        power = np.cumsum((self.a * self.w) ** 2, axis=1)
        return float(self.w[np.argmax(power >= 0.98 * power[:, -1:], axis=1)].max() / (2 * np.pi))


@dataclass(frozen=True)
class Plant:
    """A device with true parameters, and two motions of the same kind: one for the log, and an unseen one."""

    case: Case

    @cached_property
    def model(self) -> haptid.DynamicModel:
        return _model(device_text(self.case))

    @cached_property
    def motion(self) -> Fourier:
        return Fourier(self.case.random("motion"), self.case)

    @cached_property
    def unseen(self) -> Fourier:
        return Fourier(self.case.random("unseen"), self.case)

    @cached_property
    def speed(self) -> Array:
        """Root mean square speed of the torque rows' coordinates, (rows,)."""
        qd = self.model.device.row_map @ self.motion(self._grid, 1)
        return np.sqrt(np.mean(qd**2, axis=1))

    @cached_property
    def _grid(self) -> Array:
        return np.linspace(0, min(self.case.seconds, 5 * self.case.harmonics / self.case.motion_hz), 3000)

    @cached_property
    def chi(self) -> Array:
        """True free standard parameters, (p,), SI: bodies that can exist, friction in proportion to the torque."""
        rng, model, case = self.case.random("truth"), self.model, self.case
        names, kinds = model.device.parameters.names, model.device.parameters.kinds
        chi = true_parameters(model, FC=0.0, FV=0.0, OFF=0.0) * rng.uniform(0.7, 1.4)
        if case.device not in ("phantom", "cea"):
            chi[:] = 0.0
            for name, value in _bodies(rng, len(model.device.joints)).items():
                if name in names:
                    chi[names.index(name)] = value
        rms = np.sqrt(
            np.mean(haptid.inverse_dynamics(model, model.base.of(chi), *self.motion.states(self._grid)) ** 2, axis=1)
        )
        size = case.friction / np.sqrt(1 - case.friction**2)
        rows, speed = list(model.device.row_names), self.speed
        for k, (kind, name) in enumerate(zip(kinds, names, strict=True)):
            if kind in ("FC", "FV", "OFF"):
                row = rows.index(name[len(kind) :]) if name[len(kind) :] in rows else None
                share, torque = (
                    (1.0, rms[row]) if row is not None else (0.05, rms.min())
                )  # passive joints have a little
                if kind == "FC":
                    chi[k] = DRY * size * share * torque
                elif kind == "FV":
                    chi[k] = (
                        VISCOUS
                        * rng.uniform(0.5, 1.5)
                        * max(size, 0.1)
                        * share
                        * torque
                        / (speed[row] if row is not None else speed.max())
                    )
                else:
                    chi[k] = rng.uniform(-0.1, 0.1) * torque
        return chi

    @cached_property
    def beta(self) -> Array:
        """True base parameters, (p,), SI."""
        return np.asarray(self.model.base.of(self.chi))

    @cached_property
    def coulomb(self) -> Array:
        """Coulomb friction of each row, (rows,), N m."""
        names = self.model.device.parameters.names
        return np.array([self.chi[names.index(f"FC{row}")] for row in self.model.device.row_names])

    @cached_property
    def scales(self) -> Array:
        """Torque of a row over its motor's command, (rows,)."""
        return np.array([motor.gear_ratio * motor.torque_constant for motor in self.model.device.motors])

    def act(self, motion: Fourier, t: Array) -> tuple[tuple[Array, Array, Array], Array]:
        """States that the encoders see at times t, (joints, samples), and the torque that acts, (rows, samples)."""
        if self.case.misfit == "elastic":
            return self._elastic(motion, t)
        states = motion.states(t)
        tau = self._modelled(states, self.beta)
        if self.case.misfit != "none":
            tau = tau + self._extra(motion, states, t)
        return states, tau

    def _modelled(self, states: tuple[Array, Array, Array], beta: Array) -> Array:
        soft = smoothed_friction(self.model, SOFT * float(self.speed.min()))
        return np.asarray(haptid.inverse_dynamics(soft, beta, *states))

    @cached_property
    def frictionless(self) -> Array:
        """Base parameters without friction, (p,)."""
        kinds = self.model.device.parameters.kinds
        return np.asarray(self.model.base.of(np.where(np.isin(kinds, ("FC", "FV")), 0.0, self.chi)))

    def _extra(self, motion: Fourier, states: tuple[Array, Array, Array], t: Array) -> Array:
        """Torque of the effect that the model does not have, (rows, samples)."""
        frame = self.model.device.row_map
        c, cd = frame @ states[0], frame @ states[1]
        sign = np.tanh(cd / (SOFT * self.speed[:, None]))
        dry = self.coulomb[:, None]
        match self.case.misfit:
            case "Stribeck":
                return EXCESS * dry * sign * np.exp(-((cd / (STRIBECK * self.speed[:, None])) ** 2))
            case "load":
                return LOAD * np.abs(self._modelled(states, self.frictionless)) * sign
            case "ripple":
                rms = np.sqrt(np.mean(self._modelled(motion.states(self._grid), self.beta) ** 2, axis=1))
                return np.sqrt(2) * RIPPLE * rms[:, None] * np.sin(WAVES * c)
            case _:
                return dry * (self._dahl(motion, t) - sign)

    def _dahl(self, motion: Fourier, t: Array) -> Array:
        """Dahl's friction over Coulomb's, (rows, samples): dz = (1 - z sgn(dx)) dx / length, exactly."""
        period = 1 / self.case.motion_hz
        fine = np.arange(t[0] - 2 * self.case.harmonics * period, t[-1] + period, period / 200)
        c = self.model.device.row_map @ motion(fine)
        length = BREAK * np.abs(motion.a).sum(axis=1).max()
        steps = np.diff(c, axis=1)
        decay, sign = np.exp(-np.abs(steps) / length), np.sign(steps)
        z = np.zeros_like(c)
        for k in range(steps.shape[1]):
            z[:, k + 1] = sign[:, k] + (z[:, k] - sign[:, k]) * decay[:, k]
        return np.stack([np.interp(t, fine, row) for row in z])

    def _elastic(self, motion: Fourier, t: Array) -> tuple[tuple[Array, Array, Array], Array]:
        """Motor states and torque behind springs that carry the link's torque; encoders are on the motors."""
        middle = self.model.device.row_map @ motion.centre
        inertia = np.diag(haptid.dynamics.mass_matrix(self.model, self.beta, motion.centre[:, None])[0])
        assert len(middle) == len(inertia)
        spring = inertia[:, None] * (2 * np.pi * RESONANCE * self.case.motion_hz) ** 2
        h = 2e-3 / self.case.motion_hz
        link = [self._modelled(motion.states(t + k * h), self.frictionless) for k in (-1, 0, 1)]
        bend = [tau / spring for tau in link]
        rate, acceleration = (bend[2] - bend[0]) / (2 * h), (bend[0] - 2 * bend[1] + bend[2]) / h**2
        q, qd, qdd = motion.states(t)
        to_joints = np.linalg.inv(self.model.device.row_map)
        states = (q + to_joints @ bend[1], qd + to_joints @ rate, qdd + to_joints @ acceleration)
        friction = self._modelled(states, self.beta - self.frictionless)
        return states, link[1] + friction + ROTOR * inertia[:, None] * acceleration


def _bodies(rng: np.random.Generator, joints: int) -> dict[str, float]:
    """Standard parameters of drawn bodies and rotors."""
    chi = {}
    for k in range(1, joints + 1):
        mass = rng.uniform(1, 4) * 0.7 ** (k - 1)
        com = rng.uniform(-0.12, 0.12, 3) + (np.array([0.12, 0, 0]) if joints < 7 else 0.0)
        d = mass * rng.uniform(0.02, 0.08, 3) ** 2
        inertia = np.diag([d[1] + d[2], d[0] + d[2], d[0] + d[1]]) + mass * (com @ com * np.eye(3) - np.outer(com, com))
        for name, i, j in (("XX", 0, 0), ("XY", 0, 1), ("XZ", 0, 2), ("YY", 1, 1), ("YZ", 1, 2), ("ZZ", 2, 2)):
            chi[f"{name}{k}"] = float(inertia[i, j])
        chi |= {f"MX{k}": mass * com[0], f"MY{k}": mass * com[1], f"MZ{k}": mass * com[2], f"M{k}": mass}
        chi[f"IA{k}"] = rng.uniform(0.01, 0.05)
    return chi
