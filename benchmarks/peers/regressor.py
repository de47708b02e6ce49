"""The regressor of a tree by CasADi's C code and by Pinocchio, in an environment of their own.

`python regressor.py FOLDER values` writes FOLDER/values.npz, what each makes of the samples in FOLDER/case.npz;
`python regressor.py FOLDER times` writes FOLDER/times.json, microseconds per sample of the fastest of many short runs,
with the machine's own limits. `values` comes first: it also generates and compiles the code.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin

HERE = Path(__file__).parent
# Pinocchio's order of the ten parameters, m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, from XX XY XZ YY YZ ZZ MX MY MZ M.
FROM_PINOCCHIO = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]
COMPILE = ["gcc", "-O3", "-march=native", "-fPIC", "-shared"]


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


def expressions(case: dict[str, np.ndarray]) -> ca.Function:
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


def compiled(folder: Path, case: dict[str, np.ndarray]) -> None:
    """CasADi's C code, compiled with a loop over samples."""
    expressions(case).generate("entries.c", {"with_header": False})
    Path("entries.c").rename(folder / "entries.c")
    subprocess.run(
        [*COMPILE, str(folder / "entries.c"), str(HERE / "loop.c"), "-lm", "-o", str(folder / "peer.so")], check=True
    )


def main() -> None:
    """See the module."""
    folder, what = Path(sys.argv[1]), sys.argv[2]
    case = dict(np.load(folder / "case.npz"))
    if what == "values":
        compiled(folder, case)
    library = ctypes.CDLL(str(folder / "peer.so"))
    x = np.ascontiguousarray(np.concatenate([case["q"], case["qd"], case["qdd"]]).T)
    y = np.zeros((len(x), len(case["wanted"])))
    pointer = ctypes.POINTER(ctypes.c_double)

    def casadi() -> None:
        library.many(x.ctypes.data_as(pointer), y.ctypes.data_as(pointer), len(x), case["q"].shape[0], y.shape[1])

    model, columns = pinocchio_model(case), case["wanted"][:, 1]
    place = (case["wanted"][:, 0], columns // 10 * 10 + np.array(FROM_PINOCCHIO)[columns % 10])
    data = model.createData()
    samples = [np.ascontiguousarray(case[name].T) for name in ("q", "qd", "qdd")]

    def pinocchio() -> None:
        for q, v, a in zip(*samples, strict=True):
            pin.computeJointTorqueRegressor(model, data, q, v, a)

    if what == "values":
        casadi()
        theirs = [pin.computeJointTorqueRegressor(model, data, *s)[place] for s in zip(*samples, strict=True)]
        np.savez(folder / "values.npz", casadi=y, pinocchio=np.array(theirs))
        return
    scale = 1e6 / len(x)
    library.multiply_add_peak.restype = library.fill_speed.restype = ctypes.c_double
    times = {
        "CasADi C": best_of(casadi, 200) * scale,
        "Pinocchio from Python": best_of(pinocchio, 20) * scale,
        "multiply-add peak, GF/s": max(library.multiply_add_peak() for _ in range(20)),
        "memory fill, GB/s": max(library.fill_speed() for _ in range(5)),
    }
    (folder / "times.json").write_text(json.dumps(times), encoding="utf-8")


def pinocchio_model(case: dict[str, np.ndarray]) -> pin.Model:
    """The same tree, without inertia: only its regressor is asked for."""
    model = pin.Model()
    model.gravity.linear = case["gravity"]
    for k, parent in enumerate(case["parent"]):
        placement = pin.SE3(case["rotation"][k], case["translation"][k])
        model.addJoint(int(parent) + 1, pin.JointModelRZ(), placement, f"joint{k}")
    return model


def best_of(work: Callable[[], object], times: int) -> float:
    """Seconds of the fastest of many runs."""
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return min(taken)


if __name__ == "__main__":
    main()
