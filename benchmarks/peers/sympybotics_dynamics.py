"""Inverse dynamics, gravity and mass matrix of a serial arm as C by SymPyBotics: its recursion, its subexpressions.

SymPyBotics (C. D. Sousa, github.com/cdsousa/SymPyBotics, at 5d4613a) describes serial chains by Denavit-Hartenberg
parameters. Its inertial parameters are here those combinations of base parameters that the model has, zeros included.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import sympy
from sympybotics import RobotDef
from sympybotics.dynamics import rne
from sympybotics.geometry import Geometry
from sympybotics.symcode import Subexprs
from sympybotics.symcode.generation import code_to_func

import haptid

CALL = """
void sympybotics_{function}(double *out, {declared});
static void run_sympybotics_{function}(const double *s, double *out)
{{
    sympybotics_{function}(out, {arguments});
}}
"""
VECTORS = {"q": "s", "dq": "s + N", "ddq": "s + 2 * N", "p": "dev_beta"}
INPUTS = {"inverse_dynamics": ("p", "q", "dq", "ddq"), "gravity": ("p", "q"), "mass_matrix": ("p", "q")}
MAKERS = {"inverse_dynamics": rne.rne, "gravity": rne.gravityterm, "mass_matrix": rne.inertiamatrix}


def describes(model: haptid.DynamicModel) -> bool:
    """Whether the device is a serial chain of revolute joints that are the coordinates."""
    joints = model.device.joints
    chain = all(joint.parent == i - 1 and not joint.prismatic for i, joint in enumerate(joints))
    return chain and np.array_equal(model.device.rates, np.eye(len(joints)))


def written(model: haptid.DynamicModel, folder: Path) -> dict[str, str]:
    """Write sympybotics.c; calls of its functions by their names."""
    robot = _robot(model)
    geometry = Geometry(robot)
    names = {sympy.Symbol(f"p_{k}", real=True): f"p[{k}]" for k in range(len(model.base))}
    for vector, symbols in (("ddq", robot.ddq), ("dq", robot.dq), ("q", robot.q)):
        names |= {symbol: f"{vector}[{k}]" for k, symbol in enumerate(symbols)}
    texts, calls = ["#include <math.h>\n"], {}
    for function, inputs in INPUTS.items():
        found = Subexprs()
        made = MAKERS[function](robot, geometry, found.collect)
        text = code_to_func("C", found.get(made), ["out"], f"sympybotics_{function}", list(inputs), names)
        texts.append(text.replace("\n//\n", "\n"))
        calls[function] = CALL.format(
            function=function,
            declared=", ".join(f"const double *{x}" for x in inputs),
            arguments=", ".join(VECTORS[x] for x in inputs),
        )
    (folder / "sympybotics.c").write_text("\n".join(texts))
    return calls


def _robot(model: haptid.DynamicModel) -> RobotDef:
    """The arm with the base parameters as its inertial parameters."""
    device = model.device
    rows = [
        _modified_dh(joint, float(offset)) for joint, offset in zip(device.joints, device.closure.offset, strict=True)
    ]
    robot = RobotDef(device.name, rows, dh_convention="modified")
    robot.gravityacc = sympy.Matrix([_exact(x) for x in device.gravity])
    S = device.parameters.S[:, list(model.base.independent_columns)]
    base = [sympy.Symbol(f"p_{k}", real=True) for k in range(len(model.base))]
    chi = [sum((_exact(x) * p for x, p in zip(row, base, strict=True) if x), sympy.Integer(0)) for row in S]
    for i in range(robot.dof):
        robot.Le[i], robot.l[i], robot.m[i] = (
            chi[10 * i : 10 * i + 6],
            sympy.Matrix(chi[10 * i + 6 : 10 * i + 9]),
            chi[10 * i + 9],
        )
    robot.driveinertiamodel = "simplified"
    robot.Ia[:] = [sympy.Integer(0)] * robot.dof
    for k, term in enumerate(model.terms):
        if term.kind == "rotor":
            robot.Ia[int(np.flatnonzero(term.weights)[0])] = chi[10 * robot.dof + k]
    return robot


def _modified_dh(joint: haptid.device.parts.Joint, offset: float) -> tuple[sympy.Expr, ...]:
    """alpha, a, d and theta of a joint; haptid's frames have the same convention."""
    R, t = joint.rotation, joint.translation
    alpha = np.arctan2(R[2, 1], R[2, 2])
    plain = np.array([[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]])
    if np.abs(R - plain).max() > 1e-12:
        raise ValueError("the joint's frame is not that of modified Denavit-Hartenberg parameters")
    along = -np.sin(alpha) * t[1] + np.cos(alpha) * t[2]
    return _turns(alpha), _exact(t[0]), _exact(along), sympy.Symbol("q", real=True) + _turns(offset)


def _turns(angle: float) -> sympy.Expr:
    """An angle, exact where it is a multiple of a right angle."""
    quarters = round(angle / (np.pi / 2))
    near = abs(angle - quarters * np.pi / 2) < 1e-12
    return sympy.pi * quarters / 2 if near else sympy.Float(angle, 17)


def _exact(value: float) -> sympy.Expr:
    """A number, an integer where it is one."""
    near = round(value)
    return sympy.Integer(near) if abs(value - near) < 1e-12 else sympy.Float(float(value), 17)
