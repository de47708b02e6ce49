"""Joint tests of several estimates: a payload, the torque at rest, the friction of a motor, and all parameters at once.

A change of the mechanism moves many parameters a little. One by one, corrected for their number, none may be
significant where all of them together are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid._internal.roots import bracketed_root
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.estimation.block_moments import Adjustment
from haptid.estimation.intervals.clusters import Clusters
from haptid.uncertainty.distributions import f_quantile, f_tail, noncentral_f_tail
from haptid.uncertainty.multiple_testing import holm_adjusted

# Most directions of a joint test, as a share of the blocks of the shorter log; power at which a change is detectable.
_MOST, DETECTION_POWER = 1 / 3, 0.8
# Least denominator degrees of freedom of a test that is worth making.
_FEWEST = 2.0
# Singular values below this share of the largest are no direction.
_RANK = 1e-6
_POSES = 40
_PAYLOAD = "payload on link "
# Draws of the block randomisation, and runs of blocks that change sign together: at least this many in a log.
_DRAWS, RUNS = 1999, 12


@dataclass(frozen=True, eq=False)
class JointTest:
    """Equality of one group of directions over all estimates.

    Attributes:
        name: "payload on link 3".
        directions: how many.
        F, dof: statistic, and its degrees of freedom.
        p: of the hypothesis that nothing has changed.
        distance: size of the difference in its own standard deviations, the square root of Hotelling's T^2.
        detectable: the least such distance that is found in 80 % of comparisons.
    """

    name: str
    directions: int
    F: float
    dof: tuple[float, float]
    p: float
    distance: float
    detectable: float


@dataclass(frozen=True, eq=False)
class JointTests:
    """Tests of groups of directions, corrected for their number (Holm), and of all parameters at once.

    Attributes:
        tests: by group.
        equality: p-value of equality of all parameters; None where it could not be tested.
        confidence: family-wise confidence level.
        notes: sentences on what was left out.
    """

    tests: tuple[JointTest, ...]
    equality: float | None
    confidence: float
    notes: tuple[str, ...] = ()

    @cached_property
    def holm(self) -> Array:
        """p-values with Holm's correction over all groups, (groups,)."""
        return holm_adjusted(np.array([test.p for test in self.tests])) if self.tests else freeze(np.zeros(0))

    @property
    def differs(self) -> tuple[str, ...]:
        """Names of the groups that differ."""
        return tuple(t.name for t, p in zip(self.tests, self.holm, strict=True) if p < 1 - self.confidence)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What differs jointly, in order of significance; equality of all parameters; the notes."""
        sentences = []
        for k in np.argsort([test.p for test in self.tests]):
            test, p = self.tests[k], self.holm[k]
            if test.name in self.differs:
                sentences.append(
                    f"Jointly different: {test.name}, by {test.distance:.3g} standard deviations (p = {p:.1e})."
                )
        if self.tests and not sentences:
            sentences.append(
                f"No group of directions differs at {100 * self.confidence:g} % confidence for all together."
            )
        if self.equality is not None:
            verdict = "differ" if self.equality < 1 - self.confidence else "do not differ significantly"
            sentences.append(f"All parameters together {verdict} (block randomisation, p = {self.equality:.2g}).")
        return (*sentences, *self.notes)


def joint_tests(
    model: DynamicModel, values: Sequence[Array], clusters: Sequence[Clusters], confidence: float
) -> JointTests:
    """Joint tests of independent estimates of one device.

    Args:
        values: base parameters of each unconstrained fit, (p,), SI.
        clusters: of each fit.
        confidence: family-wise confidence level.
    """
    groups, tests, notes = list(named_directions(model, clusters)), [], []
    most = int(_MOST * min(map(len, clusters)))
    level = (1 - confidence) / max(len(groups), 1)
    for name, C in groups:
        test = _tested(name, C, values, clusters, level) if len(C) <= most else None
        if test is None:
            # A payload on the last link loads those before it too, whose directions may be few enough for a test.
            elsewhere = " A payload there shows on other links too." if name.startswith(_PAYLOAD) else ""
            few = f"{len(C)} directions; {min(map(len, clusters))} blocks allow {most}"
            notes.append(f"Not tested: {name} ({few}).{elsewhere}")
        else:
            tests.append(test)
    equality = randomised(values, clusters) if min(map(len, clusters)) >= RUNS else None
    return JointTests(tuple(tests), equality, confidence, tuple(notes))


def named_directions(model: DynamicModel, clusters: Sequence[Clusters]) -> Iterator[tuple[str, Array]]:
    """Named groups of combinations of base parameters, (q, p) each, of full rank in q."""
    white = sum(cluster.root @ cluster.root.T for cluster in clusters)
    size = np.sqrt(np.diag(white))
    root = np.linalg.inv(np.linalg.cholesky(white / np.outer(size, size))) / size
    parameters, base = model.device.parameters, model.base
    rubbing = _friction(model)
    every = np.concatenate([np.zeros((len(base), 1)), *rubbing.values()], axis=1)
    for joint in model.device.joints:
        names = [kind + joint.name for kind in ("M", "MX", "MY", "MZ")]
        loads = [parameters.index[name] for name in names if name in parameters.index]
        C = _projection(base.regrouping[:, loads], root, every)
        if len(C):
            yield f"{_PAYLOAD}{joint.name}", C
    still = _functionals(_torque_at_rest(model))
    if len(still):
        yield "torque at rest", still
    for group, columns in rubbing.items():
        C = _functionals(columns.T)
        if len(C):
            yield f"friction of {group}", C


def _friction(model: DynamicModel) -> dict[str, Array]:
    """Base parameters of the friction on each motor or joint, as unit columns, (p, parameters)."""
    parameters, base, own = model.device.parameters, model.base, dict[str, list[Array]]()
    links = 10 * len(model.device.joints)
    for k, term in enumerate(model.terms):
        if term.nature in ("viscous", "coulomb", "coulomb+", "coulomb-", "stribeck"):
            rows = base.regrouping[:, parameters.S[links + k] != 0].any(axis=1)
            own.setdefault(term.on, []).extend(np.eye(len(base))[rows])
    return {group: np.array(rows).reshape(-1, len(base)).T for group, rows in own.items()}


def _projection(B: Array, root: Array, others: Array) -> Array:
    """Combinations that detect the columns of B, (p, r), best in a difference of precision root'root, (q, p).

    They have no part in the columns of `others`, (p, s), which may differ as well: a payload is best detected with
    friction taken as the same, and other friction then is taken for a payload.
    """
    free = linalg.null_space((root @ others / np.maximum(np.linalg.norm(root @ others, axis=0), 1e-300)).T)
    B, root = free.T @ root @ B, free.T @ root
    u, size, _ = np.linalg.svd(B / np.maximum(np.linalg.norm(B, axis=0), 1e-300), full_matrices=False)
    return np.asarray(u[:, size > _RANK * max(size.max(initial=0.0), 1e-300)].T @ root)


def _functionals(rows: Array) -> Array:
    """An orthonormal basis of the row space, (q, p)."""
    if not rows.any():
        return np.zeros((0, rows.shape[1]))
    _, size, vt = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(vt[size > _RANK * size[0]])


def _torque_at_rest(model: DynamicModel) -> Array:
    """Torque at random poses per base parameter, (rows, p)."""
    q = model.device.closure.draw(np.random.default_rng(0), _POSES)
    still = np.zeros_like(q)
    return np.array([inverse_dynamics(model, unit, q, still, still).ravel() for unit in np.eye(len(model.base))]).T


def _tested(
    name: str, C: Array, values: Sequence[Array], clusters: Sequence[Clusters], level: float
) -> JointTest | None:
    """Hotelling's T^2 of the differences, with the degrees of freedom of each covariance.

    Sources: Zhang (2012), Communications in Statistics 41(7), the approximate Hotelling T^2 of unequal covariances; for
    two estimates Krishnamoorthy and Yu (2004), Statistics and Probability Letters 66(2).
    """
    q, n = len(C), len(values)
    m = q * (n - 1)
    moved = [cluster.misfit_shifts @ C.T for cluster in clusters]
    parts = [cluster.misfit * cluster.covariance(C) + m.T @ m for cluster, m in zip(clusters, moved, strict=True)]
    contrast = np.hstack([np.ones((n - 1, 1)), -np.eye(n - 1)])
    H = [np.kron(contrast[:, [i]], np.eye(q)) for i in range(n)]
    total = sum(h @ V @ h.T for h, V in zip(H, parts, strict=True))
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    root = np.linalg.eigh(total / np.outer(size, size))
    if root[0][0] <= len(size) * np.finfo(float).eps * root[0][-1]:
        return None
    half = (root[1] / np.sqrt(root[0])).T / size
    difference = half @ sum(h @ C @ value for h, value in zip(H, values, strict=True))
    squares = 0.0
    for h, V, cluster in zip(H, parts, clusters, strict=True):
        share = half @ h @ V @ h.T @ half.T
        squares += (np.trace(share @ share) + np.trace(share) ** 2) / cluster.freedom(C)
    freedom = m * (m + 1) / squares
    rest = freedom - m + 1
    if rest < _FEWEST:
        return None
    square, factor = float(difference @ difference), rest / (freedom * m)
    return JointTest(
        name=name,
        directions=q,
        F=factor * square,
        dof=(float(m), float(rest)),
        p=float(f_tail(factor * square, m, rest)),
        distance=float(np.sqrt(square)),
        detectable=_detectable(m, rest, level),
    )


def _detectable(m: float, rest: float, level: float) -> float:
    """Distance at which an F test at a level has the wanted power, in standard deviations."""
    limit = float(f_quantile(1 - level, m, rest))

    def short(square: float) -> float:
        return float(noncentral_f_tail(limit, m, rest, square)) - DETECTION_POWER

    high = 10.0
    while short(high) < 0 and high < 1e12:
        high *= 4
    return float(np.sqrt(bracketed_root(short, 1e-9, high, 2e-12)))


def randomised(values: Sequence[Array], clusters: Sequence[Clusters]) -> float:
    """p-value of the equality of all parameters, by random signs of the scores of runs of blocks.

    The statistic is the sum of (b_i - b)'H_i (b_i - b), H_i the information of each fit and b their common fit, in the
    directions that no missing term of a model moves. The scores are those of the common fit, corrected for leverage;
    runs of neighbouring blocks change sign together: noise is correlated over more than one. Nuisances of each fit
    (delays, noise of the encoders) are drawn as normal, with their standard errors. The statistic is divided by the
    factor of misfit.

    Source: Cameron, Gelbach and Miller (2008), Review of Economics and Statistics 90(3), with the null imposed.
    """
    size = np.sqrt(sum(np.diag(cluster.information) for cluster in clusters))
    moved = np.concatenate([cluster.misfit_shifts for cluster in clusters]) * size
    C = linalg.null_space(moved).T if len(moved) else np.eye(len(size))
    information = [cluster.information / np.outer(size, size) for cluster in clusters]
    root = np.linalg.inv(np.linalg.cholesky(sum(information)))
    spread = [np.linalg.pinv(h, hermitian=True) for h in information]
    H = [np.linalg.inv(C @ V @ C.T) for V in spread]
    beta = [C @ (value * size) for value in values]
    pooled = np.linalg.inv(sum(H))
    common = pooled @ sum(h @ b for h, b in zip(H, beta, strict=True))
    T, moves, owner = 0.0, [], []
    rng = np.random.default_rng(0)
    for k, (cluster, h, b, V) in enumerate(zip(clusters, H, beta, spread, strict=True)):
        # The fit with the common values in these directions, and free in the others.
        P = root @ (np.linalg.pinv(cluster.root).T / size[:, None])
        G = P @ cluster.G @ P.T
        deviation = np.linalg.solve(root.T, V @ C.T @ h @ (b - common))
        own = np.linalg.solve(root, Adjustment.of(G).times(cluster.s @ P.T + G @ deviation).T).T @ (C @ V).T
        runs = np.arange(len(cluster)) * RUNS * max(1, len(cluster) // (4 * RUNS)) // len(cluster)
        joined = np.zeros((runs.max() + 1, own.shape[1]))
        np.add.at(joined, runs, own)
        moves.append(joined)
        owner.append(np.full(len(joined), k))
        T += float((b - common) @ h @ (b - common))
    every, whose = np.concatenate(moves), np.concatenate(owner)
    signs = rng.choice([-1.0, 1.0], (_DRAWS, len(every)))
    nuisances = [(cluster.shifts * size) @ C.T for cluster in clusters]
    terms = [
        signs[:, whose == k] @ every[whose == k] + rng.normal(size=(_DRAWS, len(own))) @ own
        for k, own in enumerate(nuisances)
    ]
    middle = sum(moved @ h for moved, h in zip(terms, H, strict=True)) @ pooled
    drawn = np.zeros(_DRAWS)
    for moved, h in zip(terms, H, strict=True):
        drawn += np.einsum("di,ij,dj->d", moved - middle, h, moved - middle)
    factor = float(np.mean([cluster.misfit for cluster in clusters]))
    return float((1 + np.sum(drawn >= T / factor)) / (1 + _DRAWS))
