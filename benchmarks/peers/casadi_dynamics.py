"""Inverse dynamics, gravity and mass matrix of a device as C by CasADi: the recursions of the books.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 5.3 and 6.2; link frames, inertias about their
origins, then CasADi's common subexpressions.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import haptid

# Calls of the written functions from q, qd, qdd one after the other; base parameters are dev_beta.
CALL = """
int casadi_{function}(const double **arg, double **res, long long *iw, double *w, int mem);
static void run_casadi_{function}(const double *s, double *out)
{{
    static double w[16384];
    static long long iw[64];
    const double *arg[4] = {{{arguments}}};
    double *res[1] = {{out}};
    casadi_{function}(arg, res, iw, w, 0);
}}
"""
INPUTS = {
    "inverse_dynamics": ("s", "s + N", "s + 2 * N", "dev_beta"),
    "gravity": ("s", "dev_beta"),
    "mass_matrix": ("s", "dev_beta"),
}


def written(model: haptid.DynamicModel, folder: Path) -> dict[str, str]:
    """Write casadi.c; calls of its functions by their names."""
    generator = ca.CodeGenerator("casadi.c")
    for function in functions(model):
        generator.add(function)
    generator.generate(f"{folder}/")
    return {name: CALL.format(function=name, arguments=", ".join(inputs)) for name, inputs in INPUTS.items()}


def functions(model: haptid.DynamicModel) -> list[Any]:
    """The three functions, base parameters as inputs."""
    n = len(model.device.drives)
    q, qd, qdd, p = (ca.SX.sym(name, size) for name, size in zip("qvap", (n, n, n, len(model.base)), strict=True))
    S = ca.sparsify(ca.DM(model.device.parameters.S[:, list(model.base.independent_columns)]))
    links = _Links(model, q, S @ p)
    made = (
        ("inverse_dynamics", [q, qd, qdd, p], links.torque(qd, qdd)),
        ("gravity", [q, p], links.torque(ca.SX(n, 1), ca.SX(n, 1))),
        ("mass_matrix", [q, p], ca.vec(links.mass())),
    )
    return [ca.Function(f"casadi_{name}", inputs, [ca.cse(ca.densify(out))]) for name, inputs, out in made]


class _Links:
    """A tree of links: rotations and origins in their parents, inertial parameters as expressions."""

    def __init__(self, model: haptid.DynamicModel, q: Any, chi: Any) -> None:
        self.model, self.chi, self.joints = model, chi, model.device.joints
        self.rates = ca.sparsify(ca.DM(model.device.rates))
        angles = self.rates @ q + model.device.closure.offset
        self.R, self.arms = [], []
        for i, joint in enumerate(self.joints):
            c, s = ca.cos(angles[i]), ca.sin(angles[i])
            fixed = ca.sparsify(ca.DM(np.where(abs(joint.rotation) < 1e-12, 0.0, joint.rotation)))
            self.R.append(fixed @ ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
            self.arms.append(ca.sparsify(ca.DM(joint.translation)))

    def body(self, i: int) -> tuple[Any, Any, Any]:
        """Inertia about the origin, first moment, mass."""
        xx, xy, xz, yy, yz, zz, x, y, z, m = ca.vertsplit(self.chi[10 * i : 10 * i + 10])
        return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), ca.vertcat(x, y, z), m

    def torque(self, qd: Any, qdd: Any) -> Any:
        """Recursive Newton-Euler; structural zeros as rates leave gravity."""
        v, acc, z = self.rates @ qd, self.rates @ qdd, ca.DM([0, 0, 1])
        motion: list[Any] = []
        for i, joint in enumerate(self.joints):
            R, arm = self.R[i], self.arms[i]
            above = (ca.SX(3, 1), ca.SX(3, 1), -ca.DM(self.model.device.gravity))
            w, wd, a = motion[joint.parent] if joint.parent >= 0 else above
            a = R.T @ (a + ca.cross(wd, arm) + ca.cross(w, ca.cross(w, arm)))
            w, wd = R.T @ w, R.T @ wd
            motion.append((w + z * v[i], wd + z * acc[i] + ca.cross(w, z * v[i]), a))
        force, moment = ([ca.SX(3, 1) for _ in self.joints] for _ in range(2))
        felt = [ca.SX(1, 1) for _ in self.joints]
        for i in reversed(range(len(self.joints))):
            (w, wd, a), (J, h, m) = motion[i], self.body(i)
            force[i] += m * a + ca.cross(wd, h) + ca.cross(w, ca.cross(w, h))
            moment[i] += J @ wd + ca.cross(w, J @ w) + ca.cross(h, a)
            felt[i] = moment[i][2]
            parent = self.joints[i].parent
            if parent >= 0:
                force[parent] += self.R[i] @ force[i]
                moment[parent] += self.R[i] @ moment[i] + ca.cross(self.arms[i], self.R[i] @ force[i])
        return self.rates.T @ ca.vertcat(*felt) + self.rotors() @ qdd

    def mass(self) -> Any:
        """Composite rigid bodies, projected on the coordinates."""
        count, z = len(self.joints), ca.DM([0, 0, 1])
        M, composite = ca.SX(count, count), [self.body(i) for i in range(count)]
        for i in reversed(range(count)):
            J, h, m = composite[i]
            n, f, j = J @ z, ca.cross(z, h), i
            M[i, i] = n[2]
            while self.joints[j].parent >= 0:
                n, f = self.R[j] @ n, self.R[j] @ f
                n += ca.cross(self.arms[j], f)
                j = self.joints[j].parent
                M[i, j] = M[j, i] = n[2]
            above = self.joints[i].parent
            if above >= 0:
                composite[above] = tuple(
                    x + y for x, y in zip(composite[above], self._carried(i, J, h, m), strict=True)
                )
        return self.rates.T @ M @ self.rates + self.rotors()

    def _carried(self, i: int, J: Any, h: Any, m: Any) -> tuple[Any, Any, Any]:
        """A body in the frame of its link's parent, about that frame's origin."""
        R, arm = self.R[i], self.arms[i]
        h, one = R @ h, ca.DM.eye(3)
        J = R @ J @ R.T + 2 * ca.dot(arm, h) * one - arm @ h.T - h @ arm.T + m * (ca.dot(arm, arm) * one - arm @ arm.T)
        return J, h + m * arm, m

    def rotors(self) -> Any:
        """Their share of the mass matrix."""
        n = len(self.model.device.drives)
        made = ca.SX(n, n)
        for k, term in enumerate(self.model.terms):
            if term.kind == "rotor":
                weights = ca.sparsify(ca.DM(term.weights))
                made += self.chi[10 * len(self.joints) + k] * weights @ weights.T
        return made
