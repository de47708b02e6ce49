"""Written C: operations, time of a call and of the writing; beside the C of CasADi and SymPyBotics in one run.

Both are no dependencies of haptid: without them the ratios are left out. All have base parameters as inputs, are
compiled with the same flags and called on the same states in turn, and what they compute is compared before any time is
taken. Times are the processor's, so that other programs take no part in them.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import haptid
from haptid.export import CCode, export_c
from haptid.export.model.functions import Code, code_of

DEVICES = ("phantom_premium_15", "cea_medical_branch", "puma560", "rx90", "arm7")
# A seven-joint arm whose axes intersect: modified Denavit-Hartenberg, alpha in quarter turns, r in m.
SEVEN = "seven intersecting axes"
ANGLES, OFFSETS = (0, -1, 1, 1, -1, -1, 1), (0.34, 0, 0.4, 0, 0.4, 0, 0)
# What a loop calls beside observer, differentiator and friction compensation: gravity, computed torque, the handle.
LOOP = ("inverse_dynamics", "terms", "gravity", "handle_pose", "handle_jacobian", "handle_force")
# Periods of a second of a control loop.
LOOP_HZ = 1000.0
# Functions that all tools write, and how much they return per number of coordinates.
COMPARED = {"inverse_dynamics": lambda n: n, "gravity": lambda n: n, "mass_matrix": lambda n: n * n}
COMPILERS = tuple((name, level) for name in ("gcc", "clang") for level in ("-O2", "-O3"))
FLAGS = ["-std=c99", "-fPIC", "-shared"]
SPEED = 0.01
STATES, BATCHES = 1024, 101

TIMING = """
#define _POSIX_C_SOURCE 200112L
#include <stdlib.h>
#include <time.h>
#include "dev.h"
#define N {n}
#define STATES {states}
#define BATCHES {batches}
#define CALLS {count}
static dev_model model;
{written}
{everything}
typedef void called(const double *s, double *out);
static called *const calls[CALLS] = {{{calls}}};
static double now(void)
{{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}}
static int smaller(const void *a, const void *b)
{{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}}
void once(int which, const double *x, double *out, int size)
{{
    dev_init(&model, dev_beta);
    for (int i = 0; i < STATES; i++) calls[which](x + 3 * N * i, out + size * i);
}}
void timed(const double *x, double *median)
{{
    static double taken[CALLS][BATCHES], out[N * N];
    for (int b = 0; b < BATCHES; b++) {{
        for (int which = 0; which < CALLS; which++) {{
            const double start = now();
            for (int i = 0; i < STATES; i++) calls[which](x + 3 * N * i, out);
            taken[which][b] = (now() - start) / STATES;
        }}
    }}
    for (int which = 0; which < CALLS; which++) {{
        qsort(taken[which], BATCHES, sizeof(double), smaller);
        median[which] = taken[which][BATCHES / 2];
    }}
}}
"""
OWN = """
static void run_haptid_inverse_dynamics(const double *s, double *out)
{ dev_inverse_dynamics(&model, s, s + N, s + 2 * N, out); }
static void run_haptid_gravity(const double *s, double *out) { dev_gravity(&model, s, out); }
static void run_haptid_mass_matrix(const double *s, double *out) { dev_mass_matrix(&model, s, out); }
"""
TICKS = """
static double sum = 0.0;
static void tick(const double *s, double *out)
{{
    static dev_observer observer;
    static dev_differentiator filter;
    static int ready = 0;
    const double *q = s, *qdd = s + 2 * N, *tau = s + N;
    double qd[N], made[N];
{declared}
    if (!ready) {{
        dev_observer_init(&observer, 40.0, 0.001);
        dev_differentiator_init(&filter, 50.0, 0.001);
        ready = 1;
    }}
    dev_differentiator_update(&filter, q, qd);
    dev_observer_update(&model, &observer, q, qd, tau, made);
    dev_friction_compensation(&model, qd, 0.9, made);
{calls}
    out[0] = sum;
}}
"""


def everything(code: Code) -> str:
    """C that does in a tick what a loop with everything on does."""
    declared, calls = [], []
    for function in (code[name] for name in LOOP if name in code):
        outputs = [f"{function.name}_{name}" for name, _ in function.outputs]
        declared += [f"    double {o}[{len(v)}];" for o, (_, v) in zip(outputs, function.outputs, strict=True)]
        inputs = ["&model"] if function.parameters else []
        arguments = [*inputs, *(name for name, _ in function.inputs), *outputs]
        calls += [f"    dev_{function.name}({', '.join(arguments)});", f"    sum += {outputs[0]}[0];"]
    return TICKS.format(declared="\n".join(declared), calls="\n".join(calls))


def device_of(name: str) -> haptid.DynamicModel:
    """A shipped device, or the arm that has no file."""
    if name != SEVEN:
        return haptid.DynamicModel(haptid.read_device(name))
    joints = "".join(
        f'[[joints]]\nname = "{k + 1}"\nalpha = "{a}*pi/2"\nr = {r}\n'
        for k, (a, r) in enumerate(zip(ANGLES, OFFSETS, strict=True))
    )
    head = 'schema = 1\nname = "seven"\ngravity = [0.0, 0.0, -9.81]\nconvention = "modified-dh"\n'
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seven.toml"
        path.write_text(head + joints)
        return haptid.DynamicModel(haptid.read_device(path))


def peers() -> dict[str, Any]:
    """Modules that write the C of other tools, of those that are installed."""
    return {
        tool: importlib.import_module(f"peers.{tool}_dynamics")
        for tool in ("casadi", "sympybotics")
        if importlib.util.find_spec(tool)
    }


class Written:
    """The C of all tools for one device, in a folder, to be compiled with different flags."""

    def __init__(self, model: haptid.DynamicModel, beta: np.ndarray, folder: Path, code: Code) -> None:
        self.folder, self.n = folder, len(model.device.drives)
        export_c((model, beta), folder, CCode("dev"))
        texts, self.sources, tools = [OWN], ["dev.c", "timing.c"], ["haptid"]
        for tool, module in peers().items():
            if tool == "casadi" or module.describes(model):
                texts += module.written(model, folder).values()
                self.sources.append(f"{tool}.c")
                tools.append(tool)
        self.calls = [(tool, function) for function in COMPARED for tool in tools]
        names = [*(f"run_{tool}_{function}" for tool, function in self.calls), "tick"]
        filled = TIMING.format(
            n=self.n,
            states=STATES,
            batches=BATCHES,
            count=len(names),
            written="\n".join(texts),
            everything=everything(code),
            calls=", ".join(names),
        )
        (folder / "timing.c").write_text(filled)

    def times(self, compiler: str, level: str) -> dict[tuple[str, str], float]:
        """Nanoseconds of a call by tool and function, and of ("haptid", "tick"), all in turn.

        Raises:
            ArithmeticError: two tools compute different numbers.
        """
        made = f"timing{level}-{compiler}.so"
        command = [compiler, *FLAGS, level, *self.sources, "-lm", "-o", made]
        subprocess.run(command, cwd=self.folder, check=True, capture_output=True)
        library = ctypes.CDLL(str(self.folder / made))
        x = np.random.default_rng(0).uniform(-2, 2, (STATES, 3 * self.n))
        wanted: dict[str, np.ndarray] = {}
        for k, (tool, function) in enumerate(self.calls):
            size = COMPARED[function](self.n)
            out = np.zeros((STATES, size))
            library.once(k, _pointer(x), _pointer(out), size)
            if tool == "haptid":
                wanted[function] = out
            elif np.abs(out - wanted[function]).max() > 1e-10 * np.abs(out).max():
                raise ArithmeticError(f"{function} of {tool} and of haptid differ")
        median = np.zeros(len(self.calls) + 1)
        library.timed(_pointer(x), _pointer(median))
        return dict(zip([*self.calls, ("haptid", "tick")], median.tolist(), strict=True))


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def beside(times: dict[tuple[str, str], float]) -> dict[str, float]:
    """Our time over the least of the other tools', by function and tool."""
    return {
        f"{function}, our time over {tool}'s": times["haptid", function] / taken
        for (tool, function), taken in times.items()
        if tool != "haptid"
    }


def run() -> dict[str, float]:
    """Operations of every function, ns of a call, and the ratios to the other tools' time where they are there."""
    figures: dict[str, float] = {}
    for name in (*DEVICES, SEVEN):
        model = device_of(name)
        beta = np.random.default_rng(1).uniform(0.1, 1.0, len(model.base))
        begin = time.process_time()
        code = code_of(model, SPEED)
        figures[f"{name}: writing the functions, s"] = time.process_time() - begin
        for function, found in code.operations.items():
            figures[f"{name}: {function}, mul + add + div"] = found.arithmetic
        figures[f"{name}: inverse_dynamics, sin + cos"] = code.operations["inverse_dynamics"].trigonometric
        with tempfile.TemporaryDirectory() as folder:
            written = Written(model, beta, Path(folder), code)
            for compiler, level in COMPILERS:
                if shutil.which(compiler) is None:
                    continue
                times = written.times(compiler, level)
                for what, ratio in beside(times).items():
                    figures[f"{name}, {compiler} {level}: {what}"] = ratio
                if (compiler, level) == COMPILERS[0]:
                    for function in COMPARED:
                        figures[f"{name}: {function}, ns"] = times["haptid", function]
                    tick = times["haptid", "tick"]
                    figures[f"{name}: a tick with everything on, ns"] = tick
                    figures[f"{name}: a loop of 1 kHz with everything on, % of a core"] = 100 * LOOP_HZ * 1e-9 * tick
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:75s} {figure:12.4g}")
