"""Worst-case execution time of written C: the sum that its header tells of, beside the longest call that is seen.

The longest times of single operations are measured on this machine with operands in memory, each one waiting for the
one before; those of functions of the library over the angles and velocities that occur. The least time of many
repetitions counts, so that interruptions by other programs take no part; then the longest of all states. Code and data
are in the cache.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import haptid
from haptid.export import CCode, export_c
from haptid.export.formats.worst_case import WorstCase
from haptid.export.model.functions import code_of

DEVICES = ("phantom_premium_15", "cea_medical_branch", "puma560", "arm7")
FUNCTIONS = ("inverse_dynamics", "gravity", "terms", "mass_matrix", "forward_dynamics")
STATES, REPETITIONS, CHAIN = 512, 100, 32
SPEED = 0.01
# Largest angle, rad, rate and torque of the states.
LARGEST = 20.0

TIMING = """
#define _POSIX_C_SOURCE 200112L
#include <math.h>
#include <time.h>
#include "dev.h"
#define N {n}
static dev_model model;
static double now(void)
{{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}}
typedef void called(const double *s, double *out);
{operations}
{functions}
static called *const calls[] = {{{calls}}};
/* Longest over the states of the least time of a call; {chain} at a time, each waits for the one before. */
double longest(int which, const double *s, int width, int states)
{{
    static volatile double kept;
    double out[N * N + {n}] = {{0.0}}, state[3 * N], most = 0.0;
    dev_init(&model, dev_beta);
    for (int i = 0; i < states; i++) {{
        double least = HUGE_VAL;
        for (int r = 0; r < {repetitions}; r++) {{
            const double start = now();
            for (int k = 0; k < {chain}; k++) {{
                for (int j = 0; j < width; j++) state[j] = s[width * i + j] + 0.0 * out[0];
                calls[which](state, out);
            }}
            const double taken = (now() - start) / {chain};
            kept = out[0];
            least = taken < least ? taken : least;
        }}
        most = least > most ? least : most;
    }}
    (void)kept;
    return most;
}}
"""
OPERATION = """
static void op_{name}(const double *s, double *out)
{{
    volatile double x = s[0];
    volatile double y = s[1];
    for (int i = 0; i < {many}; i++) x = {text};
    out[0] = x;
}}
"""
OPERATIONS = {"additions": "x + y", "multiplications": "x * y", "divisions": "x / y"}
LIBRARY = ("sin", "cos", "tanh")
# Operations in a call of one of them.
MANY = 1024


def source(model: haptid.DynamicModel, names: list[str]) -> str:
    """C that times operations, functions of the library and those of the model."""
    operations = [OPERATION.format(name=name, text=text, many=MANY) for name, text in OPERATIONS.items()]
    for name in LIBRARY:
        operations.append(f"static void op_{name}(const double *s, double *out) {{ out[0] = {name}(s[0]); }}\n")
    code = code_of(model, SPEED)
    functions = []
    for name in names:
        places = {"q": "s", "qd": "s + N", "qdd": "s + 2 * N", "tau": "s + N"}
        arguments = ", ".join(places[x] for x, _ in code[name].inputs)
        functions.append(
            f"static void run_{name}(const double *s, double *out) {{ dev_{name}(&model, {arguments}, out); }}"
        )
    calls = [*(f"op_{name}" for name in (*OPERATIONS, *LIBRARY)), *(f"run_{name}" for name in names)]
    return TIMING.format(
        n=len(model.device.drives),
        operations="".join(operations),
        functions="\n".join(functions),
        calls=", ".join(calls),
        chain=CHAIN,
        repetitions=REPETITIONS,
    )


def measured(model: haptid.DynamicModel, beta: np.ndarray, names: list[str]) -> dict[str, float]:
    """Longest times of operations and of functions, ns."""
    n = len(model.device.drives)
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, (STATES, 3 * n)) * LARGEST
    pairs = np.ascontiguousarray(rng.uniform(0.9999, 1.0001, (2, 2)))
    angles = np.ascontiguousarray(rng.uniform(-1, 1, (STATES, 1)) * LARGEST)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_c((model, beta), folder, CCode("dev"))
        (folder / "timing.c").write_text(source(model, names))
        made = ["gcc", "-std=c99", "-O2", "-fPIC", "-shared", "dev.c", "timing.c", "-lm", "-o", "timing.so"]
        subprocess.run(made, cwd=folder, check=True, capture_output=True)
        library = ctypes.CDLL(str(folder / "timing.so"))
        library.longest.restype = ctypes.c_double
        found = {}
        for k, what in enumerate((*OPERATIONS, *LIBRARY, *names)):
            data = pairs if what in OPERATIONS else angles if what in LIBRARY else states
            pointer = data.ctypes.data_as(ctypes.c_void_p)
            found[what] = library.longest(k, pointer, data.shape[1], len(data)) / (MANY if what in OPERATIONS else 1)
    return found


def bound(case: WorstCase, times: dict[str, float]) -> float:
    """The sum of the header's line, ns."""
    arithmetic = sum(getattr(case, name) * times[name] for name in OPERATIONS)
    return arithmetic + sum(count * times[name] for name, count in case.library.items())


def run() -> dict[str, float]:
    """Bound and longest call of every function, ns, and their ratio."""
    figures: dict[str, float] = {}
    for name in DEVICES:
        model = haptid.DynamicModel(haptid.read_device(name))
        beta = np.random.default_rng(1).uniform(0.1, 1.0, len(model.base))
        code = code_of(model, SPEED)
        names = [x for x in FUNCTIONS if x in code and code.operations[x].arithmetic]
        times = measured(model, beta, names)
        for what in (*OPERATIONS, *LIBRARY):
            figures[f"{name}: one of the {what}, ns"] = times[what]
        for what in names:
            most = bound(WorstCase.of(code.graph, code[what]), times)
            figures[f"{name}: {what}, bound, ns"] = most
            figures[f"{name}: {what}, longest call seen, ns"] = times[what]
            figures[f"{name}: {what}, bound over longest call"] = most / times[what]
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:75s} {figure:12.4g}")
