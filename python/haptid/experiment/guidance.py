"""`MotionGuide`: which motion is still missing while a device is identified, in words for who moves it, with a score.

Motions that a person can make, joint by joint, are compared by the information that they would add to the rows so far.
Columns of the model give that information before the motion is made. The score is the uncertainty of the torque over
the workspace, as a share of the torque that the motors had; it falls as missing motion is made.

Source: the criterion is that of I-optimal designs (Atkinson, Donev and Tobias 2007, Optimum Experimental Designs,
section 10.6), the average variance of a prediction, over random states of the workspace.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.dynamics.workspace import Workspace, workspace
from haptid.errors import WorkspaceError, setting_error
from haptid.estimation import Estimate

# Speeds of a joint that has no limit of its own: rad/s and m/s; of slow motion, as a share.
_FAST, _SLOW = (2.0, 0.25), 0.1
# Stroke of quick motion, as a share of the range, and its highest frequency, rad/s.
_STROKE, _QUICK = 0.2, 4 * np.pi
# States of the reference, poses of the other joints, and states of a motion at each.
_STATES, _POSES, _SAMPLES = 256, 6, 16
# Time for which a motion is made before the next look, s.
_SECONDS = 5.0
# Poses of the workspace's grid.
_GRID = 4096
# Factor on standard errors for serial correlation, at most.
_LARGEST_FACTOR = 30.0
_HOW = {
    "slow": "slowly through its whole range, both ways, the others still, in several poses of theirs",
    "steady": "through its whole range both ways, now fast, now slow",
    "quick": "quickly back and forth, in several poses of the others",
    "together": "quickly back and forth at the same time",
}


@dataclass(frozen=True)
class Prompt:
    """A motion to make next.

    Attributes:
        joints: to be moved, by name.
        how: "slow", "steady", "quick" or "together".
        score: that is predicted after five seconds of it.
        parameters: whose intervals it shortens most, at most three.
    """

    joints: tuple[str, ...]
    how: str
    score: float
    parameters: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """For who moves the device."""
        named = " and ".join(self.joints)
        return f"Move joint{'s' * (len(self.joints) > 1)} {named} {_HOW[self.how]}."


@dataclass(frozen=True)
class Guidance:
    """What is known so far, and what is missing.

    Attributes:
        score: standard error of the torque over the workspace, as a share of the torque so far, 0 to 1; 1 where
            nothing is known.
        prompts: motions, the most useful first.
        widest: base parameters with what the uncertainty of each alone does to the torque, as a share, the largest
            first.
    """

    score: float
    prompts: tuple[Prompt, ...]
    widest: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A motion, and W'W of each row of known torque in the mean over its states, (known, p, p)."""

    joints: tuple[str, ...]
    how: str
    gram: Array


class MotionGuide:
    """Motions that a person can make with a device, by what they would teach.

    Args:
        model: the dynamic model.
        rows_per_s: rows of each motor in a second: one over decimation times step.
        space: poses that may be reached; the limits of the device file where None.
        seed: of the states.

    Raises:
        IncompleteDeviceError: a sliding joint has no limits.
        WorkspaceError: no pose is inside all limits.
        SettingError: `rows_per_s` is not above zero.
    """

    def __init__(self, model: DynamicModel, rows_per_s: float, space: Workspace | None = None, seed: int = 1) -> None:
        if not positive(rows_per_s):
            raise setting_error("rows_per_s", rows_per_s, "a number above zero")
        self.model, self.rows_per_s = model, rows_per_s
        self._space = space or workspace(model)
        self._poses = np.asarray(self._space.grid(_GRID))
        self._seed = seed
        joints = [model.device.joints[k] for k in model.device.active]
        self._names = tuple(joint.name for joint in joints)
        self._fast = np.array([joint.velocity_limit or _FAST[joint.prismatic] for joint in joints])
        self._fast = np.minimum(self._fast, [_FAST[joint.prismatic] for joint in joints])
        self._range = np.ptp(self._poses, axis=1)
        self._range = np.maximum(self._range, 0.05 * np.ptp(self._space.limits, axis=1))

    def guidance(self, estimate: Estimate, most: int = 3) -> Guidance:
        """Score and prompts for an estimate made so far.

        Args:
            estimate: of this model, such as `RecursiveIdentification.estimate()`.
            most: prompts.
        """
        self.model.require_same(estimate.model)
        weights, torque = np.asarray(estimate.weights), self._torque(estimate)
        root, known = self._known(estimate, weights, torque)
        target = np.einsum("mij,m->ij", self._reference, 1 / torque**2) / len(torque)

        def covariance(more: Array | float) -> Array:
            factor = linalg.cho_factor(known + more)
            return np.asarray(root[:, None] * linalg.cho_solve(factor, np.eye(len(root))) * root)

        now = covariance(0.0)
        own = np.sqrt(np.maximum(np.diag(target) * np.diag(now), 0.0))
        tried = []
        for candidate in self._candidates:
            more = np.einsum("mij,m->ij", candidate.gram, weights**2) * (self.rows_per_s * _SECONDS)
            after = covariance(more)
            gained = own - np.sqrt(np.maximum(np.diag(target) * np.diag(after), 0.0))
            names = tuple(self.model.base.names[k] for k in np.argsort(-gained)[:3] if gained[k] > 0)
            tried.append(Prompt(candidate.joints, candidate.how, _score(target, after), names))
        tried.sort(key=lambda prompt: prompt.score)
        widest = tuple((self.model.base.names[k], min(1.0, float(own[k]))) for k in np.argsort(-own))
        return Guidance(_score(target, now), tuple(tried[:most]), widest)

    def _torque(self, estimate: Estimate) -> Array:
        """Root mean square of each measured torque so far, (measured,)."""
        motors = estimate.fit.observation.motors
        size = np.array([motor.size(estimate.beta) / np.sqrt(max(1, int(motor.rows.sum()))) for motor in motors])
        return np.asarray(np.maximum(size, 1e-6 * max(float(size.max()), np.finfo(float).tiny)), dtype=np.float64)

    def _known(self, estimate: Estimate, weights: Array, torque: Array) -> tuple[Array, Array]:
        """What serial correlation makes of standard errors, (p,), and the information, (p, p).

        The information includes that no parameter alone makes more than the torque that was seen.
        """
        p = len(self.model.base)
        A = np.zeros((p, p))
        for motor, weight in zip(estimate.fit.observation.motors, weights, strict=True):
            R = weight * motor.whole[:, :-1]
            A[np.ix_(motor.columns, motor.columns)] += R.T @ R
        # What was seen in one block only, or not apart from others, has no interval, and is not known.
        A[~np.isfinite(estimate.se)], A[:, ~np.isfinite(estimate.se)] = 0.0, 0.0
        sizes = np.sqrt(np.einsum("mii->mi", self._reference))
        largest = np.min(torque[:, None] / np.maximum(sizes, 1e-12 * max(sizes.max(), 1e-300)), axis=0)
        classical = np.sqrt(np.diag(estimate.classical_covariance))
        known = (classical > 0) & np.isfinite(estimate.se)
        factor = np.ones(p)
        factor[known] = np.clip(estimate.se[known] / classical[known], 1.0, _LARGEST_FACTOR)
        # One factor for all: single ones vary by chance with few clusters.
        root = np.full(p, float(np.sqrt(np.mean(factor**2))))
        return root, A + np.diag((root / largest) ** 2)

    @cached_property
    def _reference(self) -> Array:
        """W'W of each row of known torque in the mean over random states of the workspace, (known, p, p)."""
        rng = np.random.default_rng(self._seed)
        q = self._poses[:, rng.integers(0, self._poses.shape[1], _STATES)]
        qd = self._fast[:, None] * rng.uniform(-1, 1, q.shape)
        rate = self._fast / np.maximum(_STROKE * self._range, 1e-9)
        qdd = (self._fast * np.minimum(rate, _QUICK))[:, None] * rng.uniform(-1, 1, q.shape)
        return self._gram(q, qd, qdd)

    def _gram(self, q: Array, qd: Array, qdd: Array) -> Array:
        """W'W of each row of known torque in the mean over some states of the active joints, (known, p, p)."""
        S = self.model.device.parameters.S[:, list(self.model.base.independent_columns)]
        B = np.asarray(self.model.device.row_map)
        W = regressor_columns(self.model, B @ q, B @ qd, B @ qdd, S)[list(self.model.known_rows)]
        return np.asarray(W @ W.transpose(0, 2, 1) / q.shape[1], dtype=np.float64)

    @cached_property
    def _candidates(self) -> tuple[_Candidate, ...]:
        """All motions that stay inside the workspace; without couplings of a passive joint the joints' own."""
        return tuple(self._motions())

    def _motions(self) -> Iterator[_Candidate]:
        rng = np.random.default_rng(self._seed + 1)
        count, n = len(self._names), _SAMPLES
        phase = 2 * np.pi * (np.arange(n) + 0.5) / n
        poses = self._poses[:, rng.integers(0, self._poses.shape[1], _POSES)]
        low, high = self._space.limits.T
        still = np.zeros((count, n * _POSES))
        for j in range(count):
            sweep = np.repeat(poses, n, axis=1)
            sweep[j] = np.tile(low[j] + (high[j] - low[j]) * (0.5 - 0.49 * np.cos(phase)), _POSES)
            way = np.tile(np.sign(np.sin(phase)), _POSES)
            for how, speeds in (("slow", (_SLOW,)), ("steady", (_SLOW, 0.4, 1.0))):
                velocity = still.copy()
                velocity[j] = self._fast[j] * way * np.resize(speeds, n * _POSES)
                yield from self._inside(j, how, sweep, velocity, still)
        pairs = [(j, k) for j in range(count) for k in range(j + 1, count)]
        for joints in [*((j,) for j in range(count)), *pairs]:
            q, qd, qdd = np.repeat(poses, n, axis=1), still.copy(), still.copy()
            for place, j in enumerate(joints):
                stroke = _STROKE * self._range[j]
                omega = min(self._fast[j] / max(stroke, 1e-9), _QUICK)
                angle = np.tile((1 + place) * phase + 0.7 * place, _POSES)
                q[j] += stroke * np.sin(angle)
                qd[j], qdd[j] = stroke * omega * np.cos(angle), -stroke * omega**2 * np.sin(angle)
            yield from self._inside(joints, "together" if len(joints) > 1 else "quick", q, qd, qdd)

    def _inside(self, joints: int | tuple[int, ...], how: str, q: Array, qd: Array, qdd: Array) -> Iterator[_Candidate]:
        """A motion of the states that are inside the workspace, where there are some."""
        held = self._space.holds(q)
        if held.sum() < _SAMPLES // 2:
            return
        names = tuple(self._names[j] for j in ((joints,) if isinstance(joints, int) else joints))
        try:
            yield _Candidate(names, how, self._gram(q[:, held], qd[:, held], qdd[:, held]))
        except WorkspaceError:  # loops that do not close on the way
            return


def _score(target: Array, covariance: Array) -> float:
    return float(np.sqrt(min(1.0, max(0.0, float(np.sum(target * covariance))))))
