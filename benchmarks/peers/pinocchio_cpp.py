"""Pinocchio from C++: `python -m peers.pinocchio_cpp` compiles its headers, once, in minutes."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import numpy as np

from peers.common import IN_CACHE, MANY, STEP, STEPS, Case, compiled, picked, samples
from stopwatch import Work

SOURCE = Path(__file__).with_name("pinocchio_loop.cpp")
LIBRARY = Path(sys.prefix) / "pinocchio_loop.so"
# As Pinocchio's own CMake files ask for.
LIMITS = (
    "MPL_LIMIT_LIST_SIZE=30",
    "MPL_LIMIT_VECTOR_SIZE=30",
    "MPL_CFG_NO_PREPROCESSED_HEADERS",
    "FUSION_INVOKE_MAX_ARITY=12",
)
INT, REAL, POINTER = ctypes.c_int, ctypes.c_double, ctypes.c_void_p


def build() -> None:
    """Compile the loops; wheels bring the headers of Pinocchio, Boost and Eigen."""
    import pinocchio

    headers = Path(pinocchio.__file__).parents[4] / "include"
    flags = ["-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-w", "-fPIC", "-shared"]
    flags += [f"-DBOOST_{limit}" for limit in LIMITS]
    compiled(SOURCE, LIBRARY, ["g++", *flags, f"-I{headers}", f"-I{headers / 'eigen3'}"])


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    if not LIBRARY.exists():
        raise FileNotFoundError("its loops are not compiled: see `make bench`")
    library, n = ctypes.CDLL(str(LIBRARY)), len(case["parent"])
    library.make.restype = POINTER
    names = ("rotation", "translation", "gravity", "mass", "com", "inertia")
    parts = [np.ascontiguousarray(case[name], dtype=float) for name in names]
    parent, point = case["parent"].astype(np.int32), np.ascontiguousarray(case["point"], dtype=float)
    robot = POINTER(library.make(INT(n), at(parent), *map(at, parts), INT(int(case["link"])), at(point)))
    few, many = samples(case, IN_CACHE, "q", "qd", "qdd"), samples(case, MANY, "q", "qd", "qdd")
    q, v, _ = many
    (tau,) = samples(case, MANY, "tau")
    W, M, felt = np.zeros((MANY, 10 * n, n)), np.zeros((MANY, n, n)), np.zeros((MANY, 3))
    torque, acceleration = np.zeros((2, MANY, n))

    def call(name: str, count: int, *arrays: np.ndarray) -> None:
        getattr(library, name)(robot, INT(count), *map(at, arrays))

    def simulated() -> np.ndarray:
        x, rate = q.copy(), v.copy()
        library.simulate(robot, INT(MANY), INT(STEPS), REAL(STEP), at(x), at(rate), at(tau))
        return np.concatenate([x, rate], axis=1)

    def first(_: object) -> np.ndarray:
        call("regressor_stored", IN_CACHE, *few, W)
        return picked(case, np.swapaxes(W[:IN_CACHE], 1, 2))

    return {
        "regressor in cache": Work(IN_CACHE, lambda: call("regressor", IN_CACHE, *few), first),
        "regressor, stored": Work(
            MANY, lambda: call("regressor_stored", MANY, *many, W), lambda _: picked(case, np.swapaxes(W, 1, 2))
        ),
        "inverse dynamics": Work(MANY, lambda: call("inverse", MANY, *many, torque), lambda _: torque),
        "mass matrix": Work(
            MANY, lambda: call("mass", MANY, q, M), lambda _: np.tril(M) + np.swapaxes(np.tril(M, -1), 1, 2)
        ),
        "forward dynamics": Work(MANY, lambda: call("forward", MANY, q, v, tau, acceleration), lambda _: acceleration),
        "simulation step": Work(MANY * STEPS, simulated),
        "apparent masses": Work(MANY, lambda: call("felt", MANY, q, felt), lambda _: felt),
    }


def at(array: np.ndarray) -> ctypes.c_void_p:
    """Where an array's numbers are."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(POINTER)


if __name__ == "__main__":
    build()
