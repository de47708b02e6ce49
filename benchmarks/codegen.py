"""Written C: operations, time of a call and of the writing; beside CasADi's C of the same model in one run.

CasADi is large, so it is no dependency of haptid: without it the ratios are left out. Both inverse dynamics have base
parameters as inputs, are compiled with the same flags and called on the same states in turn, and their torques are
compared before any time is taken. Times are the processor's, so that other programs take no part in them.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
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
FLAGS = ["gcc", "-std=c99", "-O2", "-fPIC", "-shared"]
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
{peer}
{everything}
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
void torques(int which, const double *x, double *tau)
{{
    static dev_model model;
    static int ready = 0;
    if (!ready) {{ dev_init(&model, dev_beta); ready = 1; }}
    for (int i = 0; i < STATES; i++) {{
        const double *s = x + 3 * N * i;
        if (which == 0) dev_inverse_dynamics(&model, s, s + N, s + 2 * N, tau + N * i);
        else peer(s, dev_beta, tau + N * i);
    }}
}}
void timed(const double *x, double *tau, double *median)
{{
    static double taken[3][BATCHES];
    for (int b = 0; b < BATCHES; b++) {{
        for (int which = 0; which < 3; which++) {{
            const double start = now();
            if (which < 2) torques(which, x, tau);
            else ticks(x);
            taken[which][b] = (now() - start) / STATES;
        }}
    }}
    for (int which = 0; which < 3; which++) {{
        qsort(taken[which], BATCHES, sizeof(double), smaller);
        median[which] = taken[which][BATCHES / 2];
    }}
}}
"""
TICKS = """
double sum = 0.0;
static void ticks(const double *x)
{{
    static dev_model model;
    static dev_observer observer;
    static dev_differentiator filter;
    double qd[N], made[N];
{declared}
    dev_init(&model, dev_beta);
    dev_observer_init(&observer, 40.0, 0.001);
    dev_differentiator_init(&filter, 50.0, 0.001);
    for (int i = 0; i < STATES; i++) {{
        const double *q = x + 3 * N * i, *qdd = q + 2 * N, *tau = q + N;
        dev_differentiator_update(&filter, q, qd);
        dev_observer_update(&model, &observer, q, qd, tau, made);
        dev_friction_compensation(&model, qd, 0.9, made);
{calls}
    }}
}}
"""
NO_PEER = "static void peer(const double *s, const double *p, double *tau) { (void)s; (void)p; tau[0] = 0.0; }"
PEER = """
int inverse(const double **arg, double **res, long long *iw, double *w, int mem);
static void peer(const double *s, const double *p, double *tau)
{
    static double w[8192];
    static long long iw[64];
    const double *arg[4] = {s, s + N, s + 2 * N, p};
    double *res[1] = {tau};
    inverse(arg, res, iw, w, 0);
}
"""


def everything(code: Code) -> str:
    """C that does in a tick what a loop with everything on does."""
    declared, calls = [], []
    for function in (code[name] for name in LOOP if name in code):
        outputs = [f"{function.name}_{name}" for name, _ in function.outputs]
        declared += [f"    double {o}[{len(v)}];" for o, (_, v) in zip(outputs, function.outputs, strict=True)]
        inputs = ["&model"] if function.parameters else []
        arguments = [*inputs, *(name for name, _ in function.inputs), *outputs]
        calls += [f"        dev_{function.name}({', '.join(arguments)});", f"        sum += {outputs[0]}[0];"]
    return TICKS.format(declared="\n".join(declared), calls="\n".join(calls))


def device_of(name: str) -> haptid.Device:
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


def peer_function(ca: Any, model: haptid.Device) -> Any:
    """Newton-Euler as in the books, link frames and inertias about their origins, then common subexpressions."""
    n, links = len(model.device.drives), 10 * len(model.device.joints)
    q, qd, qdd, p = (ca.SX.sym(name, size) for name, size in zip("qvap", (n, n, n, len(model.base)), strict=True))
    S = ca.sparsify(ca.DM(model.device.parameters.S[:, list(model.base.independent_columns)]))
    rates = ca.sparsify(ca.DM(model.device.rates))
    chi, tree = S @ p, [rates @ x for x in (q, qd, qdd)]
    z, down = ca.DM([0, 0, 1]), -ca.DM(model.device.gravity)
    motion: list[Any] = []
    for i, joint in enumerate(model.device.joints):
        angle = tree[0][i] + model.device.closure.offset[i]
        c, s = ca.cos(angle), ca.sin(angle)
        turn = ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        fixed = ca.sparsify(ca.DM(np.where(abs(joint.rotation) < 1e-12, 0.0, joint.rotation)))
        R, arm = fixed @ turn, ca.sparsify(ca.DM(joint.translation))
        w, wd, a, *_ = motion[joint.parent] if joint.parent >= 0 else (ca.SX(3, 1), ca.SX(3, 1), down)
        a = R.T @ (a + ca.cross(wd, arm) + ca.cross(w, ca.cross(w, arm)))
        w, wd = R.T @ w, R.T @ wd
        wd = wd + z * tree[2][i] + ca.cross(w, z * tree[1][i])
        motion.append((w + z * tree[1][i], wd, a, R, arm))
    force = [ca.SX(3, 1) for _ in model.device.joints]
    moment = [ca.SX(3, 1) for _ in model.device.joints]
    felt = [ca.SX(1, 1) for _ in model.device.joints]
    for i in reversed(range(len(model.device.joints))):
        w, wd, a, R, arm = motion[i]
        xx, xy, xz, yy, yz, zz, x, y, zc, m = ca.vertsplit(chi[10 * i : 10 * i + 10])
        J, h = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), ca.vertcat(x, y, zc)
        force[i] += m * a + ca.cross(wd, h) + ca.cross(w, ca.cross(w, h))
        moment[i] += J @ wd + ca.cross(w, J @ w) + ca.cross(h, a)
        felt[i] = moment[i][2]
        parent = model.device.joints[i].parent
        if parent >= 0:
            force[parent] += R @ force[i]
            moment[parent] += R @ moment[i] + ca.cross(arm, R @ force[i])
    tau = rates.T @ ca.vertcat(*felt)
    for k, term in enumerate(model.terms):
        if term.kind == "rotor":
            weights = ca.sparsify(ca.DM(term.weights))
            tau += weights * (chi[links + k] * (weights.T @ qdd))
    return ca.Function("inverse", [q, qd, qdd, p], [ca.cse(tau)])


def measured(model: haptid.Device, beta: np.ndarray, code: Code, ca: Any | None) -> dict[str, float]:
    """Nanoseconds of an inverse dynamics, ours and the peer's, and of a tick with everything on."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_c((model, beta), folder, CCode("dev"))
        sources = ["dev.c", "timing.c"]
        if ca is not None:
            generator = ca.CodeGenerator("peer.c")
            generator.add(peer_function(ca, model))
            generator.generate(f"{folder}/")
            sources.append("peer.c")
        n = len(model.device.drives)
        text = TIMING.format(
            n=n, states=STATES, batches=BATCHES, peer=PEER if ca is not None else NO_PEER, everything=everything(code)
        )
        (folder / "timing.c").write_text(text)
        subprocess.run([*FLAGS, *sources, "-lm", "-o", "timing.so"], cwd=folder, check=True, capture_output=True)
        library = ctypes.CDLL(str(folder / "timing.so"))
        x = np.random.default_rng(0).uniform(-2, 2, (STATES, 3 * n))
        made = np.zeros((2, STATES, n))
        for which in (0, 1):
            library.torques(which, _pointer(x), _pointer(made[which]))
        if ca is not None and np.abs(made[0] - made[1]).max() > 1e-10 * np.abs(made[0]).max():
            raise ArithmeticError(f"the two codes of {model.device.name} differ")
        median = np.zeros(3)
        library.timed(_pointer(x), _pointer(made[0]), _pointer(median))
    return {"ours": float(median[0]), "peer": float(median[1]), "tick": float(median[2])}


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def run() -> dict[str, float]:
    """Operations of every function, ns of an inverse dynamics, and the ratio to CasADi's where it is there."""
    ca = importlib.import_module("casadi") if importlib.util.find_spec("casadi") else None
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
        times = measured(model, beta, code, ca)
        figures[f"{name}: inverse dynamics, ns"] = times["ours"]
        figures[f"{name}: a tick with everything on, ns"] = times["tick"]
        figures[f"{name}: a loop of 1 kHz with everything on, % of a core"] = 100 * LOOP_HZ * 1e-9 * times["tick"]
        if ca is not None:
            figures[f"{name}: CasADi's inverse dynamics, ns"] = times["peer"]
            figures[f"{name}: CasADi's time over ours"] = times["peer"] / times["ours"]
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:75s} {figure:12.4g}")
