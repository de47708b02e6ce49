"""What the written code must give: the same values by the Python model, by other roads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import core_torque, mass_matrix, momentum, raw_parameters, rigid
from haptid.dynamics.kinematics import HandleMotion, handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.observation.reversals import softened

# Least eigenvalue of a mass matrix, relative to the largest, at which it can be inverted to some digits.
WORST = 1e-6


@dataclass(frozen=True, eq=False)
class Golden:
    """The Python model at some states.

    Attributes:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
        q, qd, qdd, tau: coordinates of the torque rows, their rates and torques, each (active, samples).
    """

    model: DynamicModel
    beta: Array
    speed: float
    q: Array
    qd: Array
    qdd: Array
    tau: Array

    @staticmethod
    def at_random(model: DynamicModel, beta: Array, speed: float, samples: int, seed: int = 0) -> Golden:
        """States over the whole circle, with rates to 2 and torques to 1."""
        rng = np.random.default_rng(seed)
        n = len(model.device.drives)
        q = rng.uniform(-np.pi, np.pi, (n, samples))
        qd, qdd = rng.uniform(-2, 2, (2, n, samples))
        return Golden(model, beta, speed, q, qd, qdd, rng.uniform(-1, 1, (n, samples)))

    @property
    def functions(self) -> Mapping[str, Callable[[], dict[str, Array]]]:
        """What each function of the code must give: by output, (samples, size)."""
        return {
            "inverse_dynamics": lambda: {"tau": self._bodies(self.qd, self.qdd).T},
            "gravity": lambda: {"tau": self._bodies(self._none, self._none).T},
            "terms": lambda: {"tau": self._terms(lambda term: term.kind != "rotor").T},
            "friction": lambda: {"tau": self._terms(lambda term: term.resists).T},
            "mass_matrix": lambda: {"M": self._flat(self._M)},
            "forward_dynamics": lambda: {"qdd": self._solved(self.tau - self._bodies(self.qd, self._none))},
            "momentum": self._momentum,
            "handle_pose": lambda: {"position": self._handle.position, "rotation": self._flat(self._handle.rotation)},
            "handle_jacobian": lambda: {"J": self._flat(self._handle.row_jacobian)},
            "handle_mobility": lambda: {"mobility": self._flat(self._J @ np.linalg.solve(self._M, self._J.mT))},
            "handle_force": lambda: {"force": (np.linalg.pinv(self._J.mT) @ self.tau.T[:, :, None])[:, :, 0]},
        }

    def sound(self, function: str) -> np.ndarray:
        """States at which a function has something to give, and to many digits, (samples,)."""
        if function in ("forward_dynamics", "handle_mobility"):
            sizes = np.linalg.eigvalsh(self._M)
            return np.asarray(sizes[:, 0] > WORST * np.abs(sizes[:, -1]))
        if function == "handle_force":
            sizes = np.linalg.svd(self._J, compute_uv=False)
            return np.asarray(sizes[:, -1] > np.sqrt(WORST) * sizes[:, 0])
        return np.ones(self.q.shape[1], dtype=bool)

    def at(self, samples: np.ndarray) -> Golden:
        """Some of the states."""
        q, qd, qdd, tau = (x[:, samples] for x in (self.q, self.qd, self.qdd, self.tau))
        return replace(self, q=q, qd=qd, qdd=qdd, tau=tau)

    @cached_property
    def _chi(self) -> Array:
        return raw_parameters(self.model, self.beta)

    @cached_property
    def _qa(self) -> Array:
        return np.asarray(np.linalg.solve(self.model.device.row_map, self.q))

    @cached_property
    def _M(self) -> Array:
        return mass_matrix(self.model, self.beta, self._qa)

    @cached_property
    def _handle(self) -> HandleMotion:
        return handle_motion(self.model, self._qa)

    @property
    def _J(self) -> Array:
        return self._handle.row_jacobian[:, :3]

    @property
    def _none(self) -> Array:
        return np.zeros_like(self.q)

    @staticmethod
    def _flat(matrices: Array) -> Array:
        return matrices.reshape(len(matrices), -1)

    def _bodies(self, qd: Array, qdd: Array) -> Array:
        return core_torque(self.model, rigid(self.model, self._chi), self.q, qd, qdd)

    def _terms(self, wanted: Callable[[TermColumn], bool]) -> Array:
        links = 10 * len(self.model.device.joints)
        kept = [False] * links + [wanted(term) for term in self.model.terms]
        chi = np.where(kept, self._chi, 0.0)
        own = external(self.model, self.q, self.qd, self._none)
        return core_torque(softened(self.model, self.speed), chi, self.q, self.qd, self._none, own)

    def _solved(self, torque: Array) -> Array:
        return np.asarray(np.linalg.solve(self._M, torque.T[:, :, None])[:, :, 0])

    def _momentum(self) -> dict[str, Array]:
        p, rest = momentum(self.model, self._chi, self.q, self.qd)
        return {"p": p.T, "rest": rest.T}
