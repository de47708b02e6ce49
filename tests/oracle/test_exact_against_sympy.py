"""Regroupings against sympy: Lagrange's equations in its polynomial rings, eliminated over the field of the lengths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import haptid
from haptid.dynamics.base_parameters import preference
from haptid.dynamics.symbolic.arithmetic import Coefficient

sympy = pytest.importorskip("sympy")
QQ = sympy.QQ

# Three turning joints, axes at right angles and offsets, and a loop: joint 4 follows joints 2 and 3.
ARM = """
name = "three joints and a follower"
gravity = [0, 0, -9.81]
[lengths]
d2 = 0.21
d3 = 0.47
r3 = 0.13
d4 = 0.33
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "pi/2"
d = "d2"
[[joints]]
name = "3"
d = "d3"
r = "r3"
[[joints]]
name = "4"
parent = "1"
alpha = "pi/2"
d = "-d4"
[[loops]]
relations = ["q4 = pi/2 + q2 - q3"]
[[terms]]
kind = "rotor-inertia"
joints = "active"
"""
JOINTS = (0, 1, 2)
RING = sympy.polys.rings.ring([f"{x}{k}" for x in "csva" for k in JOINTS] + ["d2", "d3", "r3", "d4"], QQ)[0]
C, S, V, A = (RING.gens[3 * k : 3 * k + 3] for k in range(4))
LENGTHS = dict(zip(("d2", "d3", "r3", "d4"), RING.gens[12:], strict=True))


def rate(x: Any) -> Any:
    """Time derivative by the chain rule."""
    total = RING.zero
    for k in JOINTS:
        total += V[k] * by_angle(x, k) + A[k] * x.diff(V[k])
    return total


def by_angle(x: Any, k: int) -> Any:
    return x.diff(S[k]) * C[k] - x.diff(C[k]) * S[k]


def product(a: Any, b: Any) -> Any:
    return [
        [sum((x * y for x, y in zip(row, column, strict=True)), RING.zero) for column in zip(*b, strict=True)]
        for row in a
    ]


def placed(alpha: tuple[int, int], d: Any, r: Any, c: Any, s: Any) -> Any:
    """Rx(alpha) Tx(d) Rz(theta) Tz(r)."""
    (ca, sa), one = alpha, RING.one
    tilt = [[1, 0, 0, d], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]]
    spin = [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, r], [0, 0, 0, 1]]
    return product(*([[x * one for x in row] for row in matrix] for matrix in (tilt, spin)))


def energies() -> dict[str, Any]:
    """Lagrangian of each standard parameter: kinetic less potential energy of a unit of it, g = 10."""
    L = LENGTHS
    follower = (C[1] * S[2] - S[1] * C[2], C[1] * C[2] + S[1] * S[2])  # cosine and sine of pi/2 + q2 - q3
    table = {
        "1": ("", (1, 0), 0, 0, (C[0], S[0])),
        "2": ("1", (0, 1), L["d2"], 0, (C[1], S[1])),
        "3": ("2", (1, 0), L["d3"], L["r3"], (C[2], S[2])),
        "4": ("1", (0, 1), -L["d4"], 0, follower),
    }
    poses: dict[str, Any] = {"": [[RING.one * (i == k) for k in range(4)] for i in range(4)]}
    made = {}
    for name, (parent, alpha, d, r, (c, s)) in table.items():
        pose = poses[name] = product(poses[parent], placed(alpha, d, r, c, s))
        R, p = [row[:3] for row in pose[:3]], [row[3] for row in pose[:3]]
        dR, v = [[rate(x) for x in row] for row in R], [rate(x) for x in p]
        spin = product(list(zip(*R, strict=True)), dR)
        w = [spin[2][1], spin[0][2], spin[1][0]]
        for kind, i, k in (("XX", 0, 0), ("XY", 0, 1), ("XZ", 0, 2), ("YY", 1, 1), ("YZ", 1, 2), ("ZZ", 2, 2)):
            made[kind + name] = w[i] * w[k] * (QQ(1, 2) if i == k else 1)
        for axis, kind in enumerate(("MX", "MY", "MZ")):  # v . (w x axis) in the base frame: v . column of dR
            moved = sum((v[i] * dR[i][axis] for i in range(3)), RING.zero)
            made[kind + name] = moved - 10 * R[2][axis]
        made["M" + name] = sum((x * x for x in v), RING.zero) * QQ(1, 2) - 10 * p[2]
    return made | {f"IA{k + 1}": V[k] ** 2 * QQ(1, 2) for k in JOINTS}


def torque_rows(points: int) -> tuple[list[str], list[list[Any]]]:
    """Names of the parameters, and torques of each at rational points of the motion: polynomials in the lengths."""
    rng = np.random.default_rng(0)
    found = energies()
    torques = [[rate(e.diff(V[k])) - by_angle(e, k) for e in found.values()] for k in JOINTS]
    made = []
    for _ in range(points):
        t = [QQ(int(rng.integers(1, 9)), int(rng.integers(1, 9))) for _ in JOINTS]
        at = [*zip(C, ((1 - x * x) / (1 + x * x) for x in t), strict=True)]
        at += zip(S, (2 * x / (1 + x * x) for x in t), strict=True)
        at += [(x, QQ(int(rng.integers(-9, 9)), 7)) for x in (*V, *A)]
        made += [[entry.subs(at) for entry in row] for row in torques]
    return list(found), made


def exact(coefficient: Coefficient | None) -> Any:
    """A coefficient as a sympy expression."""
    if coefficient is None:
        return sympy.Integer(0)
    assert not coefficient.is_ratio
    total = sympy.Integer(0)
    for exponents, factor in coefficient.numerator.terms:
        term = sympy.Rational(factor.numerator, factor.denominator)
        for name, exponent in exponents:
            term *= sympy.Symbol(name) ** exponent
        total += term
    return total


def test_every_entry_of_the_echelon_form(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    model = haptid.DynamicModel(haptid.read_device(path))
    found = model.regroupings
    order = [model.device.parameters.names[k] for k in preference(model)]
    names, W = torque_rows(12)
    matrix = sympy.Matrix([[row[names.index(name)].as_expr() for name in order] for row in W])
    form, pivots = sympy.polys.matrices.DomainMatrix.from_Matrix(matrix).to_field().rref()
    assert {order[k] for k in pivots} == {found.standard[k] for k in found.independent_columns}
    dense = form.to_Matrix()
    compared = 0
    for row, pivot in enumerate(pivots):
        base = [found.standard[k] for k in found.independent_columns].index(order[pivot])
        for column, name in enumerate(order):
            ours = exact(found.coefficients[base].get(found.standard.index(name)))
            assert sympy.cancel(dense[row, column] - ours) == 0, (order[pivot], name)
            compared += 1
    assert compared == len(found) * len(order)
