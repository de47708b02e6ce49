"""The self-test that goes with the code: values of the Python model, and comparisons with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.end_effector.momentum_observer import MomentumObserver
from haptid.estimation.nonlinear.search import STEP
from haptid.experiment.friction_test.choice import GAIN
from haptid.export.dialects import DOUBLE, C
from haptid.export.functions import Function
from haptid.export.golden import Golden
from haptid.export.text import CUTOFF_HZ, Files
from haptid.motion.filters import HighPass

SAMPLES = 12
# States of which the best are taken.
POOL = 200
# Relative: for the functions that solve linear systems, with room for a poor condition.
TOLERANCES = {"double": "1e-9", "float": "2e-3"}
# The path of the loops: amplitude and frequencies, rad or m and rad/s.
AMPLITUDE, SLOWEST = 0.2, 20.0


def selftest(files: Files) -> str:
    """The program's source."""
    golden = states(files)
    parts, calls = [], []
    for name in ("q", "qd", "qdd", "tau"):
        parts.append(table(f"in_{name}", getattr(golden, name).T, files.dialect, inputs=True))
    for function in files.code.functions:
        if not golden.sound(function.name).all():
            calls.append(f"/* {function.name}: nothing to compare, its matrix cannot be inverted. */")
            continue
        wanted = golden.functions[function.name]()
        parts += [table(f"{function.name}_{name}", values, DOUBLE) for name, values in wanted.items()]
        calls += _calls(files, function, wanted)
    q, qd, tau = path(len(files.model.device.drives))
    observed, differentiated = watched(files, q, qd, tau)
    for name, values in (("q", q), ("qd", qd), ("tau", tau)):
        parts.append(table(f"path_{name}", values.T, files.dialect, inputs=True))
    parts.append(table("observer_wanted", observed, DOUBLE))
    parts.append(table("differentiator_wanted", differentiated, DOUBLE))
    return files.filled(
        "selftest.c",
        samples=SAMPLES,
        tolerance=TOLERANCES[files.dialect.real],
        values="\n\n".join(parts),
        calls="\n".join(f"        {line}" for line in calls),
        observer_scale=_scale(observed),
        differentiator_scale=_scale(differentiated),
    )


def states(files: Files) -> Golden:
    """Random states, at most of which every function has something to give."""
    golden = Golden.at_random(files.model, files.source.beta, files.code.speed, POOL)
    unsound = np.sum([~golden.sound(function.name) for function in files.code.functions], axis=0)
    return golden.at(np.argsort(unsound, kind="stable")[:SAMPLES])


def path(active: int) -> tuple[Array, Array, Array]:
    """Positions, rates and torques of a short motion, each (active, samples)."""
    t = STEP * np.arange(SAMPLES)
    omega = SLOWEST * (1 + np.arange(active))[:, None]
    q, qd = AMPLITUDE * np.sin(omega * t + 0.5), AMPLITUDE * omega * np.cos(omega * t + 0.5)
    return np.asarray(q), np.asarray(qd), np.asarray(np.cos(omega * t))


def watched(files: Files, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """What observer and differentiator make of a motion, each (samples, active)."""
    model = files.model
    to_joints = np.linalg.inv(model.device.row_map)
    observer = MomentumObserver(GAIN, files.code.speed)
    seen = observer.follow(model, files.source.beta, STEP, to_joints @ q, to_joints @ qd, tau)
    return seen.torque.T, HighPass(CUTOFF_HZ).velocity(q, STEP).T


def table(name: str, values: Array, dialect: C, inputs: bool = False) -> str:
    """A static array of numbers, (samples, size)."""
    rows = ",\n".join("    {" + ", ".join(dialect.literal(float(x)) for x in row) + "}" for row in values)
    real = dialect.real if inputs else "double"
    return f"static const {real} {name}[{values.shape[0]}][{values.shape[1]}] = {{\n{rows}\n}};"


def _calls(files: Files, function: Function, wanted: dict[str, Array]) -> Sequence[str]:
    """One call and its comparisons."""
    arguments = ["model"] if function.parameters else []
    arguments += [f"in_{name}[i]" for name, _ in function.inputs]
    arguments += [name for name, _ in function.outputs]
    call = f"{files.name}_{function.name}({', '.join(arguments)})"
    lines = [f"{files.name}_real {name}[{len(values)}];" for name, values in function.outputs]
    lines.append(f"failures += {call};" if function.checks else f"{call};")
    lines += [
        f'compare("{function.name}", i, {len(values)}, {name}, {function.name}_{name}[i], {_scale(wanted[name])});'
        for name, values in function.outputs
    ]
    return ["{", *(f"    {line}" for line in lines), "}"]


def _scale(values: Array) -> str:
    """The largest entry, or one where all are zero."""
    return repr(float(np.abs(values).max(initial=0.0)) or 1.0)
