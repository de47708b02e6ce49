"""Trials: a change of the model or of the channels, fitted on half of the time blocks, its error stated on the others.

Blocks alternate between two halves. Constants (a Stribeck velocity, a gain) are chosen on the half of the fit too, so
that no block's error has been minimised. The gain is the difference of the errors block by block, and its standard
error that of these paired differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.grams import Grams
from haptid.uncertainty.distributions import f_tail, signed_rank_tail, t_tail

# Relative size of what is added to the diagonal of a scaled Gram matrix: columns more alike than this are one.
_RIDGE = 1e-11
# Factors between torque and model that are tried first, of both signs.
_FACTORS = np.geomspace(5e-4, 2e3, 23)
# Times that the grid between the neighbours of the best one is made 16 times finer.
_REFINED = 4
# Columns up to which all corners of a box are tried.
_MOST_CORNERS = 5


@dataclass(frozen=True)
class Setting:
    """What a trial fits.

    Attributes:
        terms: of each added term its alternatives, of which the fit chooses one: columns each.
        free: motors whose torque is a factor times the model's, which the fit chooses.
        factors: fixed factors by motor, others are 1.
        source: motor whose torque channel is read for each motor; each its own where empty.
        rows: which set of rows.
    """

    terms: tuple[tuple[tuple[int, ...], ...], ...] = ()
    free: tuple[int, ...] = ()
    factors: tuple[tuple[int, float], ...] = ()
    source: tuple[int, ...] = ()
    rows: str = "used"

    def plus(self, other: Setting) -> Setting:
        """Both changes together."""
        source = other.source or self.source
        if self.source and other.source:
            source = tuple(self.source[k] for k in other.source)
        return Setting(
            self.terms + tuple(term for term in other.terms if term not in self.terms),
            tuple(dict.fromkeys(self.free + other.free)),
            tuple(dict(self.factors + other.factors).items()),
            source,
            other.rows if other.rows != "used" else self.rows,
        )


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit on some blocks.

    Attributes:
        columns: that it has, base parameters first.
        chosen: alternative of each term.
        factors: of each motor, (motors,).
        theta: parameters of the columns, SI.
    """

    columns: np.ndarray
    chosen: tuple[int, ...]
    factors: Array
    theta: Array


@dataclass(frozen=True, eq=False)
class Trial:
    """Errors of a setting on blocks that its fits have not seen.

    Attributes:
        setting: what was fitted.
        errors: weighted squared errors of unseen rows, (blocks, motors).
        whole: the fit on all blocks.
    """

    setting: Setting
    errors: Array
    whole: Fitted

    @cached_property
    def total(self) -> float:
        return float(self.errors.sum())

    def added(self, base: int) -> Array:
        """Parameters of the added columns."""
        return self.whole.theta[base:]


@dataclass(frozen=True)
class Gain:
    """How much smaller the error on unseen rows is.

    Attributes:
        share: of the weighted squared error that goes away.
        se: standard error of the paired block differences, of the same share.
        dof: degrees of freedom.
        ranks: p-value of the differences' signed ranks.
    """

    share: float
    se: float
    dof: int
    ranks: float = 1.0

    @property
    def p(self) -> float:
        """One-sided p-value that there is no gain: by the mean of the differences, or by their signed ranks.

        Where a change takes all of the error away, the differences are as unlike as the blocks' errors, which says
        nothing against it: their mean may be three standard errors, and yet all of them are positive.
        """
        mean = float(t_tail(self.share / self.se, self.dof)) if self.se > 0 else float(self.share <= 0)
        return min(1.0, 2 * min(mean, self.ranks))

    @staticmethod
    def of(before: Array, after: Array) -> Gain:
        """By the squared errors of unseen blocks, (blocks,) each."""
        difference, total, blocks = before - after, float(before.sum()), len(before)
        if total <= 0:
            return Gain(0.0, 0.0, 1)
        se = float(np.sqrt(blocks) * difference.std(ddof=1)) if blocks > 1 else np.inf
        return Gain(float(difference.sum()) / total, se / total, max(blocks - 1, 1), signed_rank_tail(difference))


def gain(before: Trial, after: Trial) -> Gain:
    """The gain of one trial over another on the same blocks."""
    return Gain.of(before.errors.sum(axis=1), after.errors.sum(axis=1))


@dataclass(frozen=True, eq=False)
class Bench:
    """Gram matrices of a log's rows, and the trials on them.

    Attributes:
        grams: by set of rows, of every block; of rows at which candidates were not computed those of [W, y_1 .. y_m],
            and no term is fitted to these.
        base: number of base parameters; `kept` are those of them that are not fixed at zero.
        weights: of each motor's rows, (motors,).
        channel_factors: (motors, motors): factor from the torque of channel j to that of motor k.
        artefact: called for Gram matrices of the same log simulated with the model, whose candidates are zero, of one
            block or more; None: not known. Few searches ask for them.
        roundings: called for those of logs simulated with other steps of the encoders; none where these do not matter.
        known: trials whose fits are not of these matrices, by their setting.
    """

    grams: dict[str, Grams]
    base: int
    kept: np.ndarray
    weights: Array
    channel_factors: Array
    artefact: Callable[[], Grams | None] = lambda: None
    roundings: Callable[[], tuple[Grams, ...]] = tuple
    known: dict[Setting, Trial] = field(default_factory=dict)
    _sums: dict[tuple[int, bytes], tuple[Grams, Grams]] = field(default_factory=dict, init=False, repr=False)
    _pools: dict[tuple[int, bytes], tuple[Grams, Array]] = field(default_factory=dict, init=False, repr=False)
    _weighed: dict[int, tuple[Grams, Array]] = field(default_factory=dict, init=False, repr=False)
    _sources: dict[tuple[int, ...], tuple[np.ndarray, Array]] = field(default_factory=dict, init=False, repr=False)
    _trials: dict[tuple[Setting, str | None], Trial] = field(default_factory=dict, init=False, repr=False)

    @property
    def motors(self) -> int:
        return len(self.weights)

    @property
    def blocks(self) -> int:
        return len(self.grams["used"])

    def with_rows(self, name: str, grams: Grams) -> Bench:
        return replace(self, grams={**self.grams, name: grams})

    def without_candidates(self) -> Bench:
        """Of the base parameters' columns alone, where these are the only ones fitted."""
        return replace(
            self, grams={"used": self.grams["used"].first(self.base)}, artefact=lambda: None, roundings=tuple
        )

    def fit(self, setting: Setting, blocks: np.ndarray, grams: Grams | None = None) -> Fitted:
        """Least squares on some blocks; alternatives and factors are those of the least error."""
        G = self._sum(self.grams[setting.rows] if grams is None else grams, blocks)
        factors = np.ones(self.motors)
        for k, factor in setting.factors:
            factors[k] = factor
        chosen: list[int] = []
        for term in setting.terms:
            errors = [
                self._solved(G, setting, factors, (*chosen, k, *[0] * (len(setting.terms) - len(chosen) - 1)))[1]
                if len(term) > 1
                else 0.0
                for k in range(len(term))
            ]
            chosen.append(int(np.argmin(errors)))
        for k in setting.free:
            factors[k] = self._factor(G, setting, factors, tuple(chosen), k)
        theta, _, columns = self._solved(G, setting, factors, tuple(chosen))
        return Fitted(columns, tuple(chosen), factors, theta)

    def _sum(self, grams: Grams, blocks: np.ndarray) -> Grams:
        """Sum of the Gram matrices of some blocks; a hundred fits have the same few."""
        key = (id(grams), blocks.tobytes())
        if key not in self._sums:  # the matrices are kept with their sum, so that no others get their id
            self._sums[key] = (grams, grams.over(blocks))
        return self._sums[key][1]

    def _base(self, grams: Grams) -> Array:
        """W'W of the base parameters, (blocks, motors, kept, kept): in every setting, and kept apart."""
        key = (id(grams), b"base")
        if key not in self._pools:
            # The picked matrices lie block beside block, in which products with parameters take seven times as long.
            self._pools[key] = (grams, np.ascontiguousarray(grams.part(self.kept, self.kept)))
        return self._pools[key][1]

    def _pooled(self, grams: Grams, columns: np.ndarray, weights: Array) -> Array:
        """W'W of some columns, base parameters first, summed over the weighted motors, (blocks, columns, columns)."""
        n, key = len(self.kept), (id(grams), weights.tobytes())
        if key not in self._pools:
            self._pools[key] = (grams, np.tensordot(weights, self._base(grams), axes=(0, 1)))
        moved = grams.moved_by(columns[n:])
        added = np.tensordot(weights[moved], grams.part(columns[n:], columns, moved), axes=(0, 1))
        made = np.empty((len(grams), len(columns), len(columns)))
        made[:, :n, :n] = self._pools[key][1]
        made[:, n:], made[:, :n, n:] = added, added[:, :, :n].swapaxes(1, 2)
        return made

    def _factor(self, G: Grams, setting: Setting, factors: Array, chosen: tuple[int, ...], k: int) -> float:
        """The factor of motor k of the least error."""
        parts = self._normal(G, setting, self._columns(setting, chosen))
        others = factors.copy()
        others[k] = 0.0
        A, r, yy = _weighted(parts, others, self.weights**2)
        own, right = self.weights[k] ** 2 * parts[0][k], self.weights[k] ** 2 * parts[1][k]
        # A + x^2 own is diagonal for every x in the columns that whiten A + own.
        root = _whitening(A + own)
        share, turn = np.linalg.eigh(root.T @ own @ root)
        (a, b), share = np.array([r, right]) @ (root @ turn), np.clip(share, 0.0, 1.0)

        def best(x: Array) -> int:
            many = x[:, None]
            left = yy - ((a + many * b) ** 2 / (1 - share + many**2 * share)).sum(axis=1)
            return int(np.argmin(left))

        grid = np.concatenate([-_FACTORS[::-1], _FACTORS])
        at = best(grid)
        low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        if low * high < 0:
            low, high = sorted((grid[at] * 0.5, grid[at] * 2.0))
        for _ in range(_REFINED):
            grid = np.linspace(low, high, 33)
            at = best(grid)
            low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        return float(grid[at])

    def _solved(
        self, G: Grams, setting: Setting, factors: Array, chosen: Sequence[int]
    ) -> tuple[Array, float, np.ndarray]:
        """Parameters, weighted squared error and columns, from Gram matrices (motors, size, size)."""
        columns = self._columns(setting, chosen)
        if (factors == 1).all():
            w, A = self.weights**2, self._over_motors(G)[np.ix_(columns, columns)]
            r, yy = w @ self._right(G, setting, columns), float(w @ self._squares(G, setting))
        else:
            A, r, yy = _weighted(self._normal(G, setting, columns), factors, self.weights**2)
        return *_least_squares(A, r, yy), columns

    def over_motors(self) -> Array:
        """W'W of all columns of all blocks, summed over the weighted motors, (size, size)."""
        return self._over_motors(self._sum(self.grams["used"], np.arange(self.blocks)))

    def _over_motors(self, G: Grams) -> Array:
        """W'W of all columns summed over the weighted motors, (size, size): most candidates pick from the same one."""
        if id(G) not in self._weighed:  # the matrices are kept with their sum, so that no others get their id
            self._weighed[id(G)] = G, G.pooled(self.weights**2)
        return self._weighed[id(G)][1]

    def _columns(self, setting: Setting, chosen: Sequence[int]) -> np.ndarray:
        """Base parameters' columns and those of the alternatives."""
        if self.grams[setting.rows].size == self.base:  # there are none
            return self.kept
        picked = (t for term, c in zip(setting.terms, chosen, strict=True) for t in term[c])
        return np.array([*self.kept, *dict.fromkeys(picked)], dtype=int)

    def _normal(self, G: Grams, setting: Setting, columns: np.ndarray) -> tuple[Array, Array, Array]:
        """Motor by motor W'W, (motors, columns, columns), W'y and y'y, of some columns."""
        return G.part(columns, columns), self._right(G, setting, columns), self._squares(G, setting)

    def _channels(self, setting: Setting) -> tuple[np.ndarray, Array]:
        """For each motor its torque channel, and the channel's factor."""
        if setting.source not in self._sources:
            source = np.array(setting.source or range(self.motors))
            self._sources[setting.source] = source, self.channel_factors[np.arange(self.motors), source]
        return self._sources[setting.source]

    def _right(self, G: Grams, setting: Setting, columns: np.ndarray) -> Array:
        """W'y, (..., motors, columns)."""
        channels, factor = self._channels(setting)
        return np.asarray(factor[:, None] * G.right(columns, channels))

    def _squares(self, G: Grams, setting: Setting) -> Array:
        """y'y, (..., motors)."""
        channels, factor = self._channels(setting)
        return np.asarray(factor**2 * G.squares(channels))

    def squares(self, setting: Setting) -> Array:
        """Squared torque of each block and motor, (blocks, motors)."""
        return self._squares(self.grams[setting.rows], setting)

    def sizes(self, trial: Trial) -> Array:
        """What squared errors of each motor are relative to, (motors,), (N m)^2 or N^2.

        Its squared torque; where there is none, as of a free joint, half the squared terms, as `MotorRows.size`.
        """
        own, n = self.squares(trial.setting).sum(axis=0), len(self.kept)
        lengths = self.grams[trial.setting.rows].lengths.sum(axis=0)[:, self.kept]
        return np.asarray(np.where(own > 0, own, 0.5 * lengths @ trial.whole.theta[:n] ** 2))

    def errors(self, fitted: Fitted, setting: Setting, rows: str | None = None, part: slice = slice(None)) -> Array:
        """Squared errors of each block of a part and each motor, weighted, (blocks, motors)."""
        every, c, h = self.grams[rows or setting.rows], fitted.columns, fitted.factors
        n, theta, G = len(self.kept), fitted.theta, every[part]
        inner = (self._base(every)[part] @ theta[:n]) @ theta[:n]
        if len(c) > n:
            moved = G.moved_by(c[n:])
            added = G.part(c[n:], c, moved)
            inner[:, moved] += (added @ theta + added[..., :n] @ theta[:n]) @ theta[n:]
        cross = self._right(G, setting, c) @ fitted.theta
        squares = self._squares(G, setting) - 2 * h * cross + h**2 * inner
        return np.asarray(np.maximum(squares, 0.0) * self.weights**2)

    def run(self, setting: Setting, judged: str | None = None) -> Trial:
        """A trial: two fits on alternate blocks, each judged on the other half; and one on all blocks.

        Args:
            setting: what is fitted.
            judged: the rows on which errors are stated; those of the fit where None.
        """
        if judged is None and setting in self.known:
            return self.known[setting]
        asked = (setting, judged)
        if asked not in self._trials:  # the search and what it cannot tell ask for the same ones
            every = np.arange(self.blocks)
            errors = np.empty((self.blocks, self.motors))
            for half in (0, 1):
                fitted, unseen = self.fit(setting, every[half::2]), slice(1 - half, None, 2)
                errors[unseen] = self.errors(fitted, setting, judged, unseen)
            self._trials[asked] = Trial(setting, errors, self.fit(setting, every))
        return self._trials[asked]

    def base_parameters(self, made: Trial) -> Array:
        """Those of the fit on all blocks, (base,), with zeros for those that are fixed."""
        beta = np.zeros(self.base)
        beta[self.kept] = made.whole.theta[: len(self.kept)]
        return beta

    def standard_errors(self, made: Trial) -> Array:
        """Cluster-robust ones of the added columns' parameters."""
        return np.sqrt(np.diag(self._clustered(made)[0]))

    def p_value(self, made: Trial, limit: float = 1.0) -> float:
        """p-value of the cluster-robust Wald test that the added columns are zero; 1 where there are none.

        What the same columns have in the simulated log, in which they are zero, is taken from them; how that varies
        with the place of the encoders' steps is variance.

        Args:
            made: a trial of this bench.
            limit: above it the p-value is a lower bound.
        """
        theta = made.whole.theta[len(self.kept) :]
        if not len(theta):
            return 1.0
        covariance, dof = self._clustered(made)
        many = int(np.prod([len(term) for term in made.setting.terms]))
        if len(theta) <= _MOST_CORNERS:
            # What is taken off is between nothing and all: a convex function of it is largest at a corner of this box.
            corners = theta * np.array(list(product((0.0, 1.0), repeat=len(theta))))
            p = min(1.0, many * min(self._wald(corner, covariance, dof) for corner in corners))
            if p >= limit:
                return p
        left = theta - self._artefact(made.setting, made.whole)
        p = min(1.0, many * self._wald(left, covariance, dof))
        if p >= limit or len(null := self._rounded(made.setting, made.whole)) < 2:
            return p
        rounding = np.atleast_2d(np.cov(null, rowvar=False))
        whole = covariance + rounding
        # Degrees of freedom of a sum of variances: Welch and Satterthwaite.
        share = float(np.mean(np.diag(rounding) / np.maximum(np.diag(whole), np.finfo(float).tiny)))
        dof = 1 / ((1 - share) ** 2 / dof + share**2 / (len(null) - 1))
        return min(1.0, many * self._wald(left, whole, dof))

    def _clustered(self, made: Trial) -> tuple[Array, float]:
        """Covariance of the added columns' parameters, from leverage-corrected scores of the blocks, and its dof."""
        setting, fitted = made.setting, made.whole
        G, c, h = self.grams[setting.rows], fitted.columns, fitted.factors
        first, w = len(self.kept), self.weights**2
        A = self._pooled(G, c, w * h**2)
        r = np.einsum("k,bki->bi", w * h, self._right(G, setting, c))
        whole = A.sum(axis=0)
        scale = 1 / np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
        L = (scale[:, None] * linalg.pinvh(whole * scale[:, None] * scale, rtol=1e-10) * scale)[first:]
        LA = L @ A
        leverage = (LA * L).sum(axis=-1) / np.maximum(((L @ whole) * L).sum(axis=-1), 1e-300)
        scores = (r - A @ fitted.theta) @ L.T / np.maximum(1 - leverage, 0.05)
        covariance = scores.T @ scores * (self.blocks - 1) / self.blocks
        inverse = _inverse(L @ whole @ L.T)
        together = (inverse * (LA @ L.T)).sum(axis=(1, 2)) / len(L)
        return covariance, min(max(1 / max(float((together**2).sum()), 1e-300) - 1, 1.0), float(self.blocks))

    @staticmethod
    def _wald(theta: Array, covariance: Array, dof: float) -> float:
        """p-value of the test that parameters with this covariance are zero: Hotelling's T^2."""
        size = np.sqrt(np.diag(covariance))
        there = size > 0  # a column may have no effect on this device
        k = int(there.sum())
        if k == 0 or dof - k + 1 < 1:
            return 1.0
        z, own = (theta / np.where(there, size, 1.0))[there], size[there]
        correlation = covariance[np.ix_(there, there)] / np.outer(own, own)
        T2 = float(z @ _inverse(correlation) @ z)
        return float(f_tail(T2 * (dof - k + 1) / (dof * k), k, dof - k + 1))

    def _artefact(self, setting: Setting, fitted: Fitted) -> Array:
        """What the added columns have in the simulated log, no larger than in the true one."""
        found = fitted.theta[len(self.kept) :]
        if (simulated := self.artefact()) is None:
            return np.zeros(len(found))
        null = self._added_in(simulated, setting, fitted)
        if len(null) != len(found):  # two terms share a column
            return np.zeros(len(found))
        return np.where(np.sign(null) == np.sign(found), np.sign(found) * np.minimum(np.abs(null), np.abs(found)), 0.0)

    def _rounded(self, setting: Setting, fitted: Fitted) -> Array:
        """What the added columns have in each log simulated with other steps, (logs, added)."""
        return np.array([self._added_in(grams, setting, fitted) for grams in self.roundings()])

    def _added_in(self, simulated: Grams, setting: Setting, fitted: Fitted) -> Array:
        """Parameters of the added columns in a simulated log."""
        term = (tuple(t for term, c in zip(setting.terms, fitted.chosen, strict=True) for t in term[c]),)
        return self.fit(Setting((term,)), np.arange(len(simulated)), simulated).theta[len(self.kept) :]


def _weighted(parts: tuple[Array, Array, Array], factors: Array, w: Array) -> tuple[Array, Array, float]:
    """Sums of W'W, W'y and y'y over the motors, whose rows of W have these factors."""
    return np.tensordot(w * factors**2, parts[0], axes=1), (w * factors) @ parts[1], float(w @ parts[2])


def _inverse(M: Array) -> Array:
    """Pseudo-inverse of a symmetric matrix; most are numbers."""
    if M.shape == (1, 1) and M[0, 0] != 0:
        return 1 / M
    return np.asarray(np.linalg.pinv(M, hermitian=True))


def _whitening(A: Array) -> Array:
    """X with X'AX = 1, or zero in directions in which A is zero to rounding."""
    scale = 1 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(A * scale[:, None] * scale)
    return np.asarray(scale[:, None] * vectors / np.sqrt(np.maximum(values, 0.0) + _RIDGE))


def _least_squares(A: Array, r: Array, yy: float) -> tuple[Array, float]:
    """Solution of A theta = r for scaled columns, and the squared error."""
    scale = 1 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    scaled = A * scale[:, None] * scale
    scaled.ravel()[:: len(A) + 1] += _RIDGE
    factor, failed = linalg.lapack.dpotrf(scaled, lower=1)
    if failed:  # rounding errors larger than the ridge
        theta = linalg.solve(scaled, scale * r, assume_a="sym", check_finite=False)
    else:
        theta, _ = linalg.lapack.dpotrs(factor, scale * r, lower=1)
    theta *= scale
    return theta, float(yy - 2 * theta @ r + theta @ A @ theta)
