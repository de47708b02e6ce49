"""Residuals row by row, and tests of them: whiteness, normality, outliers, heteroscedasticity."""

from __future__ import annotations

from collections.abc import Iterator
from weakref import WeakKeyDictionary

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid._internal.signals import fast_length
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, Status, joined_names
from haptid.inference.diagnosis.subsample import block_numbers, row_ranges
from haptid.motion.motion import Motion
from haptid.observation.plan import LEAST_BLOCKS, Plan
from haptid.observation.rows import Chunk
from haptid.uncertainty.distributions import chi2_tail, dagostino_pearson, normal_quantile, t_tail
from haptid.uncertainty.multiple_testing import holm_adjusted

# Missing rows between two ranges: more than any lag that is used.
_GAP = 400
# Frequencies up to half the sampling rate at which power is summed; twice as many as lags at least.
_FREQUENCIES = 1001
# Rows are taken as uncorrelated where the autocorrelation of the shared filter is below this.
UNCORRELATED = 0.02
# Lags of the portmanteau test.
LAGS = 10
# With a longer autocorrelation time, as a share of a block, neighbouring blocks are not independent clusters.
_LONGEST = 0.2
# Median absolute deviation of a standard normal variable.
_NORMAL_MAD = 0.6744897501960817
# Rows that a test of the distribution requires.
_FEWEST = 30
# Outliers with more than this share of the residual power distort the fit.
OUTLIER_POWER = 0.1
# Residual power at twice the mean speed or torque, relative to that at the mean, above which another weighting pays.
GROWTH = 2.0

_Part = tuple[Array, Array, Array, Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of every motor's treated torque; NaN where a row is not used.

    Attributes:
        labels, units: of the motors, (motors,).
        t: (rows,), s.
        step: between rows, s.
        e: measured minus predicted torque, (motors, rows), N m or N.
        predicted: torque of the model, (motors, rows).
        position, velocity: of the coordinates that torque rows belong to, (active, rows), SI.
        block: index into the observation's blocks, -1 for none, (rows,).
        filter_stride: distance in rows at which the shared filter leaves no correlation.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    step: float
    e: Array
    predicted: Array
    position: Array
    velocity: Array
    block: np.ndarray
    filter_stride: int

    def __post_init__(self) -> None:
        freeze_fields(self, "t", "e", "predicted", "position", "velocity")
        self.block.flags.writeable = False

    def used(self, motor: int) -> np.ndarray:
        """Whether each row is used, (rows,)."""
        return np.asarray(np.isfinite(self.e[motor]))


# Of each estimate: the diagnosis and the results ask for the same.
_RESIDUALS: WeakKeyDictionary[Estimate, Residuals] = WeakKeyDictionary()


def residuals(estimate: Estimate) -> Residuals:
    """Residuals of all blocks of an estimate, one after the other."""
    if estimate not in _RESIDUALS:
        _RESIDUALS[estimate] = _residuals(estimate)
    return _RESIDUALS[estimate]


def _residuals(estimate: Estimate) -> Residuals:
    """The same, computed."""
    motions = estimate.observation.motions
    parts = list(zip(*(part for motion in motions for part in _of(estimate, motion)), strict=True))
    # Each takes much memory of a long log: parts are given up as they are joined, and no array is copied again.
    t, e, predicted, position, velocity, block = (np.concatenate(parts.pop(0), axis=-1) for _ in range(len(parts)))
    e[:, block < 0] = np.nan
    rows = estimate.observation.motors
    return Residuals(
        labels=tuple(motor.label for motor in rows),
        units=tuple(motor.unit for motor in rows),
        t=freeze(t),
        step=motions[0].treatment.decimation * motions[0].dt,
        e=freeze(e),
        predicted=freeze(predicted),
        position=freeze(position),
        velocity=freeze(velocity),
        block=block.astype(int),
        filter_stride=max(filter_stride(motion) for motion in motions),
    )


def _of(estimate: Estimate, motion: Motion) -> Iterator[_Part]:
    """Ranges of one motion, a gap of missing rows between those that are not adjacent and at the end."""
    model, plan = estimate.model, Plan.of(estimate.model, motion)
    chi = raw_parameters(model, estimate.beta)
    wanted = estimate.observation.blocks
    index = dict(block_numbers(plan, wanted))
    known_rows = np.flatnonzero(model.device.known).tolist()
    own = [known_rows.index(row) for row in device_rows(estimate)]
    end = 0
    for start, stop in row_ranges(plan, wanted):
        chunk = Chunk.of(plan, start, stop)
        if start > end:
            yield _gap(len(own), len(chunk.c))
        measured, predicted = chunk.measured()[own], chunk.torque(chi)[own]
        e = np.where(chunk.used[own], measured - predicted, np.nan)
        block = np.array([index[row // plan.block] for row in range(start, stop)], dtype=float)
        yield chunk.t, e, predicted, chunk.centres(chunk.c), chunk.centres(chunk.cd), block
        end = stop
    yield _gap(len(own), len(model.device.row_names))


def _gap(motors: int, coordinates: int) -> _Part:
    """Missing rows."""
    e, c = (np.full((size, _GAP), np.nan) for size in (motors, coordinates))
    return np.full(_GAP, np.nan), e, e, c, c, np.full(_GAP, -1.0)


def filter_stride(motion: Motion) -> int:
    """Distance in rows at which the filter shared by torque and columns leaves no correlation."""
    treatment = motion.treatment
    taps, d = treatment.taps(motion.dt), treatment.decimation
    full = np.correlate(taps, taps, mode="full")[len(taps) - 1 :: d]
    return int(np.flatnonzero(np.abs(full) > UNCORRELATED * full[0])[-1]) + 1


# Serial correlation.


@dataclass(frozen=True)
class SerialCorrelation:
    """Serial correlation of one motor's residual.

    Attributes:
        rows: that are used.
        ljung_box: Q over LAGS lags, of rows that the filter leaves uncorrelated (Ljung and Box 1978, Biometrika 65,
            eq. 1.2).
        p: its p-value.
        durbin_watson: of the same rows (Durbin and Watson 1950, Biometrika 37): 2 if they are white.
        time: integrated autocorrelation time of all rows, 1 + 2 sum rho_k, in rows.
        effective: effective number of independent rows, rows / time.
        half_power_hz: frequency below which half of the power lies.
    """

    rows: int
    ljung_box: float
    p: float
    durbin_watson: float
    time: float
    effective: float
    half_power_hz: float


def serial_correlation(e: Array, stride: int, step: float) -> SerialCorrelation:
    """Serial correlation of one motor's residual, (rows,), NaN where a row is not used."""
    thinned_e = e[::stride]
    Q, p = portmanteau(thinned_e)
    known = thinned_e - np.nanmean(thinned_e)
    steps = np.diff(known)
    pairs = np.isfinite(steps)
    watson = float(np.mean(steps[pairs] ** 2) / np.nanmean(known**2)) if pairs.any() else np.nan
    rows, time = int(np.isfinite(e).sum()), autocorrelation_time(e)
    return SerialCorrelation(rows, Q, p, watson, time, rows / time, half_power(e, step))


def autocorrelation(e: Array, lags: int) -> tuple[Array, np.ndarray]:
    """Autocorrelations of a series with missing values (NaN), and the number of pairs at each lag, both (lags + 1,).

    Sums over the pairs present, divided by the sum of squares. Source: Parzen (1963), Sankhya A 25.
    """
    known = np.isfinite(e)
    x = np.where(known, e - np.nanmean(e), 0.0)
    lags = min(lags, len(x) - 1)
    power = max(float(x @ x), np.finfo(float).tiny)
    size = fast_length(len(x) + lags)  # so long that no lag wraps round
    spectrum = np.abs(fft.rfft(np.stack([x, known.astype(float)]), size)) ** 2
    products, pairs = fft.irfft(spectrum, size)[:, : lags + 1]
    return products / power, np.rint(pairs).astype(int)


def autocorrelation_time(e: Array) -> float:
    """Integrated autocorrelation time 1 + 2 sum rho_k, in rows, at least 1.

    The sum ends where a pair of neighbouring correlations is not positive (Geyer 1992, Statistical Science 7, section
    3.3).
    """
    rho, pairs = autocorrelation(e, min(_GAP - 1, len(e) // 4))
    scaled = rho * pairs[0] / np.maximum(pairs, 1)  # as if no row were missing
    couples = scaled[: len(scaled) // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(couples <= 0)
    return max(1.0, 2.0 * float(couples[: ends[0] if len(ends) else None].sum()) - 1.0)


def portmanteau(e: Array) -> tuple[float, float]:
    """Q of Ljung and Box and its p-value for a white series; missing values as in Stoffer and Toloi (1992)."""
    rho, pairs = autocorrelation(e, LAGS)
    n, present = pairs[0], pairs[1:] > 0
    Q = float(n * (n + 2) * np.sum(rho[1:][present] ** 2 / pairs[1:][present]))
    return Q, float(chi2_tail(Q, max(int(present.sum()), 1)))


def half_power(e: Array, step: float) -> float:
    """Frequency below which half of the power lies, Hz, from windowed correlations (Blackman and Tukey 1958)."""
    rho, pairs = autocorrelation(e, min(_GAP - 1, len(e) // 4))
    k = np.arange(1, len(rho))
    window = 0.5 * (1 + np.cos(np.pi * k / len(rho)))
    weight = rho[1:] * pairs[0] / np.maximum(pairs[1:], 1) * window
    f = np.linspace(0.0, 0.5, _FREQUENCIES)
    below = 2 * f - 2 * fft.rfft(np.append(0.0, weight / (np.pi * k)), 2 * (_FREQUENCIES - 1)).imag
    return float(f[int(np.argmax(below >= 0.5))] / step)


def _longest_log(estimate: Estimate) -> float:
    """Time that the blocks of the longest log cover, s."""
    covered: dict[str, float] = {}
    for block in estimate.observation.blocks:
        covered[block.log] = covered.get(block.log, 0.0) + block.stop - block.start
    return max(covered.values())


def whiteness(estimate: Estimate, left: Residuals) -> Finding:
    """Are the residuals white, and shorter correlated than the blocks that are the clusters?"""
    correlations = [serial_correlation(e, left.filter_stride, left.step) for e in left.e]
    p = holm_adjusted(np.array([motor.p for motor in correlations]))
    block = float(np.median([b.stop - b.start for b in estimate.observation.blocks]))
    longest = max(motor.time for motor in correlations) * left.step
    status: Status = "bad" if longest > _LONGEST * block else "ok" if p.min() >= SIGNIFICANCE else "doubt"
    coloured = [label for label, probability in zip(left.labels, p, strict=True) if probability < SIGNIFICANCE]
    rows, effective = sum(m.rows for m in correlations), sum(m.effective for m in correlations)
    sentence = (
        f"The {rows} rows are equivalent to {effective:.0f} independent ones: the residuals are serially correlated "
        f"over up to {longest:.2g} s"
    )
    if status == "bad":
        wanted = round(10 * longest, 1)
        enough = LEAST_BLOCKS * wanted <= _longest_log(estimate)
        sentence += (
            f", longer than {100 * _LONGEST:.0f} % of a block of {block:.2g} s: neighbouring blocks are dependent and "
            "the intervals too narrow. Look for a missing term"
        ) + (
            f", and write block_s = {wanted:g} under [treatment] in the study file, or Treatment(block_s={wanted:g}) "
            "in Python."
            if enough
            else f"; no log is as long as the {LEAST_BLOCKS} blocks of {wanted:g} s that would do: record longer."
        )
    elif coloured:
        sentence += (
            f". The residuals of {joined_names(coloured)} are not white, beyond the effect of the filter "
            f"(p = {p.min():.1e}, "
            f"limit {SIGNIFICANCE:g}): use the default cluster-robust intervals, not the classical ones, and look for "
            f"a missing term."
        )
    else:
        sentence += f", by the filter alone (p = {p.min():.2g}, limit {SIGNIFICANCE:g})."
    figures = {
        "rows": rows,
        "effective_rows": effective,
        "autocorrelation_time": longest,
        "block": block,
        "p": float(p.min()),
    }
    for label, motor in zip(left.labels, correlations, strict=True):
        figures |= {
            f"ljung_box {label}": motor.ljung_box,
            f"durbin_watson {label}": motor.durbin_watson,
            f"half_power_hz {label}": motor.half_power_hz,
        }
    return Finding("whiteness", status, figures, sentence)


# Distribution.


def standardised(e: Array) -> Array:
    """Residuals about their median in robust standard deviations, (rows,), NaN where a row is not used."""
    centred = e - np.nanmedian(e)
    return np.asarray(centred * _NORMAL_MAD / max(float(np.nanmedian(np.abs(centred))), np.finfo(float).tiny))


def thinned(e: Array, stride: int, clear: np.ndarray) -> Array:
    """Rows of a residual so far apart that they are nearly uncorrelated, those of them that are clear."""
    apart = slice(None, None, max(stride, int(np.ceil(autocorrelation_time(e)))))
    return np.asarray(e[apart][clear[apart] & np.isfinite(e[apart])])


def outliers(e: Array, rows: float) -> np.ndarray:
    """Rows beyond what a normal residual of that number of independent rows reaches with probability 0.01, (rows,)."""
    limit = -normal_quantile(0.5 * SIGNIFICANCE / max(rows, 1.0))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(standardised(e)) > limit)


def near_reversals(velocity: Array, rows: int) -> np.ndarray:
    """Rows that are at most so many from one where the velocity changes its sign, (rows,)."""
    turns = np.zeros(len(velocity))
    turns[1:] = np.signbit(velocity[1:]) != np.signbit(velocity[:-1])
    return np.asarray(np.convolve(turns, np.ones(2 * rows + 1), mode="same") > 0.5)


def normality(left: Residuals, velocity: Array) -> Finding:
    """Are the residuals normal (D'Agostino and Pearson 1973, Biometrika 60), and are there outliers?

    Rows whose filter reaches a reversal of their motor are not tested: when dry friction changes its sign is known
    there to some samples only, and the filter spreads that error over all rows that it reaches.

    Args:
        left: the residuals.
        velocity: of every motor's own coordinate, (motors, rows).
    """
    p, outlier_counts, at_reversals, power = [], 0, 0, 0.0
    figures: dict[str, float] = {}
    for label, e, speed in zip(left.labels, left.e, velocity, strict=True):
        near = near_reversals(speed, (left.filter_stride + 1) // 2)
        independent = thinned(e, left.filter_stride, ~near)
        if len(independent) >= _FEWEST:
            skewness, kurtosis, alone = dagostino_pearson(independent)
            p.append(alone)
            figures |= {f"skewness {label}": skewness, f"excess_kurtosis {label}": kurtosis}
        else:
            p.append(1.0)
        is_outlier = outliers(e, np.isfinite(e).sum() / autocorrelation_time(e))
        at_reversals += int((is_outlier & near).sum())
        is_outlier &= ~near
        outlier_counts += int(is_outlier.sum())
        power = max(power, float(np.sum(e[is_outlier] ** 2) / np.nansum(e**2)))
    corrected = holm_adjusted(np.array(p))
    least = float(corrected.min())
    status: Status = "ok" if least >= SIGNIFICANCE else "bad" if power > OUTLIER_POWER else "doubt"
    figures |= {"p": least, "outliers": outlier_counts, "outlier_power": power}
    figures |= {"outliers at reversals": at_reversals}
    labels = joined_names(
        [label for label, probability in zip(left.labels, corrected, strict=True) if probability < SIGNIFICANCE]
    )
    if not any(name.startswith("skewness") for name in figures):
        sentence = "Normality is not tested: the filter of nearly every row reaches a reversal of its motor."
    elif status == "ok":
        sentence = (
            f"No significant departure from normality away from reversals (p = {least:.2g}, limit {SIGNIFICANCE:g})."
        )
    elif status == "doubt":
        sentence = (
            f"The residuals of {labels} are not normal (p = {least:.1e}, limit {SIGNIFICANCE:g}): intervals are still "
            f"valid for a long log, but look for a missing term."
        )
    else:
        sentence = (
            f"The residuals of {labels} have {outlier_counts} outliers with {100 * power:.0f} % of a motor's residual "
            f"power (limit {100 * OUTLIER_POWER:.0f} %): look at the log there for contacts, end stops and lost "
            f"samples, and cut them."
        )
    return Finding("normality", status, figures, sentence)


@dataclass(frozen=True, eq=False)
class Regression:
    """Regression coefficients with block-jackknife standard errors.

    Attributes:
        values: (k,).
        se: (k,).
        dof: Satterthwaite's degrees of freedom, from the leverage of the blocks, (k,).
    """

    values: Array
    se: Array
    dof: Array


def block_jackknife(X: Array, y: Array, block: np.ndarray) -> Regression | None:
    """Least squares y = X b with standard errors from leaving out each block; None with too few blocks.

    Args:
        X: (rows, k).
        y: (rows,).
        block: of each row, (rows,).
    """
    names, place = np.unique(block, return_inverse=True)
    k, count = X.shape[1], len(names)
    A, b = np.zeros((count, k, k)), np.zeros((count, k))
    np.add.at(A, place, X[:, :, None] * X[:, None, :])
    np.add.at(b, place, X * y[:, None])
    normal_matrix = A.sum(axis=0)
    if count <= k + 2 or np.linalg.matrix_rank(normal_matrix) < k:
        return None
    inverse = np.linalg.inv(normal_matrix)
    values = inverse @ b.sum(axis=0)
    without = np.linalg.pinv(normal_matrix - A) @ (b.sum(axis=0) - b)[:, :, None]
    shift = without[:, :, 0] - values
    leverage = np.einsum("ki,bij,jk->bk", inverse, A, inverse)
    dof = leverage.sum(axis=0) ** 2 / (leverage**2).sum(axis=0) - 1.0
    return Regression(values, np.sqrt((count - 1) / count * (shift**2).sum(axis=0)), np.maximum(dof, 2.0))


def heteroscedasticity(left: Residuals, velocity: Array) -> Finding:
    """Does the residual power depend on speed or torque? Koenker's test (1981, J. Econometrics 17), by blocks.

    Args:
        left: the residuals.
        velocity: of every motor's own coordinate, (motors, rows).
    """
    p, growth, names = [], [], []
    for m, label in enumerate(left.labels):
        used = left.used(m)
        if not used.any():
            continue
        sizes = np.array([np.abs(velocity[m, used]), np.abs(left.predicted[m, used])])
        typical = sizes.mean(axis=1, keepdims=True)
        X = np.vstack([np.ones(used.sum()), sizes / np.where(typical > 0, typical, 1.0) - 1.0]).T
        if (test := block_jackknife(X, left.e[m, used] ** 2, left.block[used])) is None:
            continue
        for k, cause in ((1, "speed"), (2, "torque")):
            t = test.values[k] / test.se[k] if test.se[k] > 0 else 0.0
            p.append(float(2 * t_tail(abs(t), test.dof[k])))
            growth.append(float(1.0 + test.values[k] / test.values[0]))
            names.append(f"{label} with {cause}")
    if not p:
        return Finding("even spread", "ok", {}, "There are too few blocks for a test of heteroscedasticity.")
    corrected = holm_adjusted(np.array(p))
    first = int(np.argmin(corrected))
    figures = {"p": corrected[first], **{f"growth {name}": g for name, g in zip(names, growth, strict=True)}}
    if corrected[first] >= SIGNIFICANCE:
        text = (
            f"No significant heteroscedasticity with speed or torque (p = {corrected[first]:.2g}, limit "
            f"{SIGNIFICANCE:g})."
        )
        return Finding("even spread", "ok", figures, text)
    grows = growth[first] > 1
    text = (
        f"Heteroscedastic residuals: the power of {names[first]} {'grows' if grows else 'falls'} by "
        f"{100 * abs(growth[first] - 1):.0f} % from the mean to twice the mean (p = {corrected[first]:.1e}, limit "
        f"{SIGNIFICANCE:g}); the default cluster-robust intervals allow for it. Look for friction or backlash that the "
        f"model lacks {'there' if grows else 'at the other end'}."
    )
    return Finding("even spread", "bad" if abs(growth[first] - 1) > GROWTH - 1 else "doubt", figures, text)
