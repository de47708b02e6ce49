"""The regressor of a tree by CasADi's C code, a call for each sample, compiled for this very machine."""

from __future__ import annotations

import ctypes
import json
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np

from peers.common import IN_CACHE, MANY, Case, samples
from stopwatch import Work

LOOP = Path(__file__).with_name("casadi_loop.c")
COMPILE = ["gcc", "-O3", "-march=native", "-fPIC", "-shared"]
POINTER = ctypes.POINTER(ctypes.c_double)


def cross(x: list, y: list) -> list:
    """Of two three-vectors of expressions."""
    return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]


def dot(x: list, y: list) -> ca.SX:
    """Of two three-vectors of expressions."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def turned(rotation: np.ndarray, q: ca.SX, x: list) -> list:
    """A vector of the parent's frame in that of a link that has turned by q."""
    c, s = ca.cos(q), ca.sin(q)
    t = [sum((rotation[k, i] * x[k] for k in range(3) if rotation[k, i] != 0), ca.SX(0)) for i in range(3)]
    return [c * t[0] + s * t[1], c * t[1] - s * t[0], t[2]]


def moved(link: tuple, rotation: np.ndarray, p: np.ndarray, q: ca.SX, v: ca.SX, a: ca.SX) -> tuple:
    """Angular velocity and acceleration, acceleration of the origin, and skew(wd) + skew(w)^2, from the parent's."""
    w, wd, d, b = link
    d = turned(rotation, q, [d[k] + sum((b[k][j] * p[j] for j in range(3) if p[j] != 0), ca.SX(0)) for k in range(3)])
    w, wd = turned(rotation, q, w), turned(rotation, q, wd)
    wd = [wd[0] + w[1] * v, wd[1] - w[0] * v, wd[2] + a]
    w = [w[0], w[1], w[2] + v]
    b = [
        [-(w[1] ** 2 + w[2] ** 2), w[0] * w[1] - wd[2], w[0] * w[2] + wd[1]],
        [w[0] * w[1] + wd[2], -(w[0] ** 2 + w[2] ** 2), w[1] * w[2] - wd[0]],
        [w[0] * w[2] - wd[1], w[1] * w[2] + wd[0], -(w[0] ** 2 + w[1] ** 2)],
    ]
    return w, wd, d, b


def entries(link: tuple, x: list, u: list) -> list:
    """Wrench of the ten unit parameters, contracted with an axis (angular x, linear u)."""
    w, wd, d, b = link
    h, y = cross(d, x), cross(x, w)
    tensor = [
        x[i] * wd[i] + y[i] * w[i] if i == j else x[i] * wd[j] + x[j] * wd[i] + y[i] * w[j] + y[j] * w[i]
        for i in range(3)
        for j in range(i, 3)
    ]
    return [*tensor, *(h[k] + sum(b[e][k] * u[e] for e in range(3)) for k in range(3)), dot(u, d)]


def expressions(case: Case) -> ca.Function:
    """The wanted entries of the regressor, the same recursion with axes carried forward."""
    n = len(case["parent"])
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    none = [ca.SX(0)] * 3
    base = (none, none, [ca.SX(-g) for g in case["gravity"]], [none] * 3)
    links: list[tuple] = []
    axes: list[dict[int, tuple]] = []
    made = {}
    for i, parent in enumerate(case["parent"]):
        R, p = case["rotation"][i], case["translation"][i]
        links.append(moved(links[parent] if parent >= 0 else base, R, p, q[i], v[i], a[i]))
        above = axes[parent] if parent >= 0 else {}
        shift = [ca.SX(e) for e in p]
        carried = {
            r: (turned(R, q[i], x), turned(R, q[i], [s + t for s, t in zip(u, cross(x, shift), strict=True)]))
            for r, (x, u) in above.items()
        }
        axes.append(carried | {i: ([ca.SX(0), ca.SX(0), ca.SX(1)], none)})
        made |= {(r, 10 * i + k): e for r, s in axes[i].items() for k, e in enumerate(entries(links[i], *s))}
    wanted = [made[int(r), int(c)] for r, c in case["wanted"]]
    return ca.Function("entries", [q, v, a], [ca.cse(ca.vertcat(*wanted))])


def library_of(case: Case, folder: Path) -> ctypes.CDLL:
    """CasADi's C code, compiled with a loop over samples, once for values and times."""
    library = folder / "casadi.so"
    if not library.exists():
        made = expressions(case)
        (folder / "counts.json").write_text(json.dumps({"regressor in cache: operations per sample": operations(made)}))
        code = ca.CodeGenerator("entries.c", {"with_header": False})
        code.add(made)
        written = code.generate(f"{folder}/")
        subprocess.run([*COMPILE, written, str(LOOP), "-lm", "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    library, n, entries = library_of(case, folder), len(case["parent"]), len(case["wanted"])

    def over(count: int) -> Work:
        x = np.ascontiguousarray(np.concatenate(samples(case, count, "q", "qd", "qdd"), axis=1))
        y = np.zeros((count, entries))
        arguments = (x.ctypes.data_as(POINTER), y.ctypes.data_as(POINTER), count, n, entries)
        return Work(count, lambda: library.many(*arguments), lambda _: y)

    return {"regressor in cache": over(IN_CACHE), "regressor, stored": over(MANY)}


def operations(made: ca.Function) -> int:
    """Of one sample, as CasADi counts them once common expressions are one."""
    none = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    return sum(made.instruction_id(k) not in none for k in range(made.n_instructions()))
