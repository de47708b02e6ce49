"""Self-test of the C code: reference values of the Python model, and a program that compares the code with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.elastic import torsion_places
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import core_torque, mass_matrix, momentum, raw_parameters, rigid
from haptid.dynamics.kinematics import HandleMotion, handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.end_effector.momentum_observer import MomentumObserver
from haptid.experiment.bench.elastic import planned_torque
from haptid.export.expressions.dialects import DOUBLE, C
from haptid.export.expressions.emit import Function
from haptid.export.formats.c_source import CUTOFF_HZ, GAIN, STEP, Files
from haptid.export.model.passive import passive_positions, start_pose
from haptid.motion.filters import HighPass
from haptid.observation.reversals import smoothed_friction

# Distance of the positions from which loops are closed, rad or m.
_NEARBY = 1e-4
# Smallest eigenvalue of a mass matrix, relative to the largest, at which its inverse is compared.
_WORST = 1e-6


@dataclass(frozen=True, eq=False)
class ReferenceValues:
    """Reference values of the Python model at some states.

    Attributes:
        beta: its base parameters, (p,), SI.
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
        q, qd, qdd, tau: coordinates of the torque rows, their rates and torques, each (active, samples).
        motor: torques of the motors' coordinates, (motors, samples).
        before: positions of passive joints near those at q, from which loops are closed, (passive, samples).
    """

    model: DynamicModel
    beta: Array
    speed: float
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    motor: Array
    before: Array

    @staticmethod
    def at_random(model: DynamicModel, beta: Array, speed: float, samples: int, seed: int = 0) -> ReferenceValues:
        """Random states: positions in +-pi, or where loops close, rates in +-2, torques in +-1."""
        rng = np.random.default_rng(seed)
        q = np.asarray(model.device.row_map @ model.device.closure.draw(rng, samples))
        qd, qdd = rng.uniform(-2, 2, (2, *q.shape))
        return ReferenceValues.along(model, beta, speed, (q, qd, qdd), rng.uniform(-1, 1, q.shape))

    @staticmethod
    def along(
        model: DynamicModel, beta: Array, speed: float, motion: tuple[Array, Array, Array], tau: Array
    ) -> ReferenceValues:
        """At the states of a motion: q, qd and qdd."""
        z = passive_positions(model, motion[0])
        before = z + _NEARBY * np.cos(np.arange(z.size)).reshape(z.shape)
        motor = np.cos(1.0 + np.arange(len(model.device.driven) * tau.shape[1])).reshape(-1, tau.shape[1])
        return ReferenceValues(model, beta, speed, *motion, tau, motor, before)

    @property
    def functions(self) -> Mapping[str, Callable[[], dict[str, Array]]]:
        """Reference outputs of each function of the code, (samples, size)."""
        return {
            "close": lambda: {"z": self.z.T},
            "inverse_dynamics": lambda: {"tau": self._bodies(self.qd, self.qdd).T},
            "gravity": lambda: {"tau": self._bodies(self._none, self._none).T},
            "terms": lambda: {"tau": self._terms(lambda term: term.kind != "rotor").T},
            "friction": lambda: {"tau": self._terms(lambda term: term.resists).T},
            "mass_matrix": lambda: {"M": self._flat(self._M)},
            "forward_dynamics": lambda: {"qdd": self._solved(self.tau - self._bodies(self.qd, self._none))},
            "momentum": self._momentum,
            "handle_pose": lambda: {"position": self._handle.position, "rotation": self._flat(self._handle.rotation)},
            "handle_jacobian": lambda: {"J": self._flat(self._handle.row_jacobian)},
            "handle_mobility": lambda: {"mobility": self._flat(self._J @ np.linalg.solve(self._M, self._J.mT))},
            "springs": self._springs,
            "spring_torque": lambda: {"spring": self._spring_torque.T},
            "rotors": self._rotors,
            "motor_position": lambda: {"theta": self._motors(self._qa)[self.model.device.driven].T},
            "row_torque": lambda: {"tau": self.model.device.row_torque(self.q, self.motor).T},
            "motor_torque": lambda: {"motor": self.model.device.drive_torque(self.q, self.tau).T},
            "handle_force": lambda: {"force": (np.linalg.pinv(self._J.mT) @ self.tau.T[:, :, None])[:, :, 0]},
        }

    def sound(self, function: str) -> np.ndarray:
        """States at which a function is well-conditioned, (samples,)."""
        if function in ("forward_dynamics", "handle_mobility"):
            sizes = np.linalg.eigvalsh(self._M)
            return np.asarray(sizes[:, 0] > _WORST * np.abs(sizes[:, -1]))
        if function == "handle_force":
            sizes = np.linalg.svd(self._J, compute_uv=False)
            return np.asarray(sizes[:, -1] > np.sqrt(_WORST) * sizes[:, 0])
        return np.ones(self.q.shape[1], dtype=bool)

    def at(self, samples: np.ndarray) -> ReferenceValues:
        """A subset of the states."""
        arrays = {name: getattr(self, name)[:, samples] for name in ("q", "qd", "qdd", "tau", "motor", "before")}
        return replace(self, **arrays)

    @property
    def inputs(self) -> dict[str, Array]:
        """Inputs of the functions by their names, (size, samples)."""
        names = ("q", "z", "qd", "qdd", "tau", "motor", "before", "theta", "thetad")
        return {name: getattr(self, name) for name in names if len(getattr(self, name))}

    @property
    def theta(self) -> Array:
        """Positions of the motors before springs, (elastic motors, samples), rad or m."""
        elastic = [drive.load_side is not None for drive in self.model.device.drives]
        return self._motors(self._qa)[elastic]

    @property
    def thetad(self) -> Array:
        """Rates of the same."""
        return np.asarray(np.cos(np.arange(self.theta.size)).reshape(self.theta.shape))

    def _motors(self, qa: Array) -> Array:
        """Positions of all drives, (drives, samples)."""
        return np.asarray(self.model.device.drive_rows @ self.model.device.closure.follow(qa).q)

    def _springs(self) -> dict[str, Array]:
        made = {}
        for name, nature in (("stiffness", "spring"), ("damping", "viscous")):
            known = {
                term.on: value
                for term, value in zip(self.model.terms, self._chi[10 * len(self.model.device.joints) :], strict=True)
                if term.nature == nature
            }
            own = [known.get(f"elastic {drive.name}", 0.0) for drive in self.model.device.elastic]
            made[name] = np.tile(own, (self.q.shape[1], 1))
        return made

    @property
    def _spring_torque(self) -> Array:
        """Torque of the elastic motors on the same motion without torsion, less that on their rotors."""
        device, own = self.model.device, torsion_places(self.model.device)
        q, qd, qdd = (x.copy() for x in (self.q, self.qd, self.qdd))
        for x in (q, qd, qdd):
            x[own] = 0.0
        still = replace(self, q=q, qd=qd, qdd=qdd)
        rows = still._bodies(qd, qdd) + still._terms(lambda term: term.kind != "rotor")
        motors = [drive.name for drive in device.motors]
        whole = planned_torque(device, q, rows)[[motors.index(drive.name) for drive in device.elastic]]
        return np.asarray(whole - rows[own])

    def _rotors(self) -> dict[str, Array]:
        """Momentum and torque of the rotors' terms, with the links at zero."""
        own, q, qd = torsion_places(self.model.device), np.zeros_like(self.q), np.zeros_like(self.q)
        q[own], qd[own] = self.theta, self.thetad
        moving = replace(self, q=q, qd=qd)
        motors = [f"motor {drive.name}" for drive in self.model.device.elastic]
        p = core_torque(self.model, rigid(self.model, self._chi), q, np.zeros_like(qd), qd) - moving._bodies(
            np.zeros_like(qd), np.zeros_like(qd)
        )
        return {"p": p[own].T, "rest": moving._terms(lambda term: term.on in motors and term.kind != "rotor")[own].T}

    @cached_property
    def z(self) -> Array:
        """Positions of the passive joints that loops determine at every pose, (passive, samples)."""
        return passive_positions(self.model, self.q)

    @cached_property
    def _chi(self) -> Array:
        return raw_parameters(self.model, self.beta)

    @cached_property
    def _qa(self) -> Array:
        return np.asarray(np.linalg.solve(self.model.device.row_map, self.q))

    @cached_property
    def _M(self) -> Array:
        return mass_matrix(self.model, self.beta, self._qa)

    @cached_property
    def _handle(self) -> HandleMotion:
        return handle_motion(self.model, self._qa)

    @property
    def _J(self) -> Array:
        return self._handle.row_jacobian[:, :3]

    @property
    def _none(self) -> Array:
        return np.zeros_like(self.q)

    @staticmethod
    def _flat(matrices: Array) -> Array:
        return matrices.reshape(len(matrices), -1)

    def _bodies(self, qd: Array, qdd: Array) -> Array:
        return core_torque(self.model, rigid(self.model, self._chi), self.q, qd, qdd)

    def _terms(self, wanted: Callable[[TermColumn], bool]) -> Array:
        links = 10 * len(self.model.device.joints)
        kept = [False] * links + [wanted(term) for term in self.model.terms]
        chi = np.where(kept, self._chi, 0.0)
        soft = smoothed_friction(self.model, self.speed)
        own = external(soft, self.q, self.qd, self._none)
        return core_torque(soft, chi, self.q, self.qd, self._none, own)

    def _solved(self, torque: Array) -> Array:
        return np.asarray(np.linalg.solve(self._M, torque.T[:, :, None])[:, :, 0])

    def _momentum(self) -> dict[str, Array]:
        p, rest = momentum(self.model, self._chi, self.q, self.qd)
        return {"p": p.T, "rest": rest.T}


# Compared states, and random states of which the best-conditioned are taken.
_SAMPLES = 12
POOL = 200
# Relative tolerances, with a margin for ill-conditioned linear systems.
TOLERANCES = {"double": "1e-9", "float": "2e-3"}
# Motion of the observer and the differentiator: amplitude, rad or m, and lowest frequency, rad/s.
AMPLITUDE, _SLOWEST = 0.2, 20.0


def selftest(files: Files) -> str:
    """Source of the self-test program."""
    reference = states(files)
    parts, calls = [], []
    read = {name for function in files.code.functions for name, _ in function.inputs}
    for name, values in reference.inputs.items():
        if name in read:
            parts.append(_table(f"in_{name}", values.T, files.dialect, inputs=True))
    for function in files.code.functions:
        if not reference.sound(function.name).all():
            calls.append(f"/* {function.name}: not compared, its matrix is singular. */")
            continue
        wanted = reference.functions[function.name]()
        parts += [_table(f"{function.name}_{name}", values, DOUBLE) for name, values in wanted.items()]
        calls += _calls(files, function, wanted)
    q, qd, tau = path(files.model)
    observed, differentiated = watched(files, q, qd, tau)
    z = passive_positions(files.model, q)
    for name, values in (("q", q), ("qd", qd), ("tau", tau)):
        parts.append(_table(f"path_{name}", values.T, files.dialect, inputs=True))
    parts.append(_table("observer_wanted", observed, DOUBLE))
    parts.append(_table("differentiator_wanted", differentiated, DOUBLE))
    parts += [_table("loops_wanted", z.T, DOUBLE)] if len(z) else []
    return files.filled(
        "selftest.c",
        samples=_SAMPLES,
        tolerance=TOLERANCES[files.dialect.real],
        values="\n\n".join(parts),
        calls="\n".join(f"        {line}" for line in calls),
        observer_scale=_scale(observed),
        differentiator_scale=_scale(differentiated),
        **(_loop_checks(files.name, z) if len(z) else {"loops_start": "", "loops_checked": "", "z": ""}),
    )


def _loop_checks(name: str, z: Array) -> dict[str, str]:
    """Statements that follow the loops along the path, and compare their positions."""
    start = f"    {name}_loops loops;\n    failures += {name}_loops_start(&loops, path_q[0]);\n"
    update = f"        failures += {name}_loops_update(&loops, path_q[i]);\n"
    compared = f'        compare("loops", i, {len(z)}, loops.z, loops_wanted[i], {_scale(z)});\n'
    return {"loops_start": start, "loops_checked": update + compared, "z": "loops.z, "}


def states(files: Files) -> ReferenceValues:
    """Random states, chosen so that as many functions as possible are well-conditioned."""
    reference = ReferenceValues.at_random(files.model, files.source.beta, files.code.speed, POOL)
    unsound = np.sum([~reference.sound(function.name) for function in files.code.functions], axis=0)
    return reference.at(np.argsort(unsound, kind="stable")[:_SAMPLES])


def path(model: DynamicModel) -> tuple[Array, Array, Array]:
    """Positions, rates and torques of a short motion about the start pose, each (active, samples)."""
    t = STEP * np.arange(_SAMPLES)
    start = start_pose(model)
    omega = _SLOWEST * (1 + np.arange(len(start)))[:, None]
    q, qd = AMPLITUDE * np.sin(omega * t + 0.5), AMPLITUDE * omega * np.cos(omega * t + 0.5)
    return np.asarray(start[:, None] + q), np.asarray(qd), np.asarray(np.cos(omega * t))


def watched(files: Files, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Reference outputs of observer and differentiator along a motion, each (samples, active)."""
    model = files.model
    to_joints = np.linalg.inv(model.device.row_map)
    observer = MomentumObserver(GAIN, files.code.speed)
    seen = observer.follow(model, files.source.beta, STEP, to_joints @ q, to_joints @ qd, tau)
    return seen.torque.T, HighPass(CUTOFF_HZ).velocity(q, STEP).T


def _table(name: str, values: Array, dialect: C, inputs: bool = False) -> str:
    """A static array of numbers, (samples, size)."""
    rows = ",\n".join("    {" + ", ".join(dialect.literal(float(x)) for x in row) + "}" for row in values)
    real = dialect.real if inputs else "double"
    return f"static const {real} {name}[{values.shape[0]}][{values.shape[1]}] = {{\n{rows}\n}};"


def _calls(files: Files, function: Function, wanted: dict[str, Array]) -> Sequence[str]:
    """A call of a function and the comparisons of its outputs."""
    arguments = ["model"] if function.parameters else []
    arguments += [f"in_{name}[i]" for name, _ in function.inputs]
    arguments += [name for name, _ in function.outputs]
    call = f"{files.name}_{function.name}({', '.join(arguments)})"
    lines = [f"{files.name}_real {name}[{len(values)}];" for name, values in function.outputs]
    lines.append(f"failures += {call};" if function.checks else f"{call};")
    lines += [
        f'compare("{function.name}", i, {len(values)}, {name}, {function.name}_{name}[i], {_scale(wanted[name])});'
        for name, values in function.outputs
        if name in wanted
    ]
    return ["{", *(f"    {line}" for line in lines), "}"]


def _scale(values: Array) -> str:
    """The largest magnitude, or one where all are zero."""
    return repr(float(np.abs(values).max(initial=0.0)) or 1.0)
