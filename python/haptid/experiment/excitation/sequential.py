"""Sequential design: the next motion, given the information of the logs so far, and the intervals it will give.

The information of a motion is that of its regressor, known before it is recorded; that of independent logs adds. Noise
is that of the logs so far, its serial correlation too (`haptid.experiment.excitation.treated`).

Source: Fedorov (1972), Theory of Optimal Experiments, chapter 4; Pronzato (2008), Automatica 44(2), section 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError, listed
from haptid.estimation.methods.constrained import indices
from haptid.experiment.excitation.criteria import LargestDeviation
from haptid.experiment.excitation.families import Family, FourierSeries
from haptid.experiment.excitation.limits import Limits
from haptid.experiment.excitation.planned import Excitation, PlannedMotion
from haptid.experiment.excitation.search import Search, design_excitation
from haptid.experiment.excitation.treated import TreatedNoise
from haptid.uncertainty.quantities import half_width

# Parameters whose torque is a smaller share than this of the whole are not essential.
_WORTH = 0.005
# Longest predicted time, over that of the motions.
_LONGEST = 100.0
# Assumed standard deviation of a torque row at one row a second where there is no log, N m s^0.5 or N s^0.5.
_NOISE = 0.002
# Relative singular values below this are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class LogInformation:
    """Information of logs on the base parameters, and the noise of their rows.

    Attributes:
        values: base parameters, (p,), SI.
        information: of all rows, each in units of its noise, (p, p), SI; zero for parameters that are not estimated.
        factor: standard error of each parameter over the one of white noise, (p,): serial correlation, misfit.
        dof: degrees of freedom of each interval, (p,).
        estimated: indices of the parameters that are estimated; the others are fixed.
        noise: standard deviation of a torque row at one row a second, (motors,), N m s^0.5 or N s^0.5.
        seconds: duration of the logs, s.
        treated: their treatment and the spectra of their residuals, for the information of planned motions; where None,
            rows of these are as they are, under white noise, and `factor` stays the same.
    """

    model: DynamicModel
    values: Array
    information: Array
    factor: Array
    dof: Array
    estimated: tuple[int, ...]
    noise: Array
    seconds: float
    treated: TreatedNoise | None = None

    def __post_init__(self) -> None:
        p, measured = len(self.model.base), sum(self.model.device.measured)
        freeze_fields(self, values=(p,), information=(p, p), factor=(p,), dof=(p,), noise=(measured,))

    @staticmethod
    def none(model: DynamicModel, beta: Array | None = None, noise: float = _NOISE) -> LogInformation:
        """No log yet: the prior values, and an assumed noise of all motors.

        Args:
            beta: base parameters, (p,), SI; the prior where None, zero for parameters without one.
            noise: standard deviation of a torque row at one row a second, N m s^0.5 or N s^0.5.
        """
        p, motors = len(model.base), sum(model.device.measured)
        values = model.prior_beta if beta is None else beta
        return LogInformation(
            model,
            values,
            np.zeros((p, p)),
            np.ones(p),
            np.full(p, np.inf),
            tuple(range(p)),
            np.full(motors, noise),
            0.0,
        )

    @property
    def valued(self) -> tuple[str, ...]:
        """Names of the estimated parameters with a value other than zero: a relative interval means something."""
        return tuple(self.model.base.names[k] for k in self.estimated if self.values[k])

    @property
    def essential(self) -> tuple[int, ...]:
        """Estimated parameters that contribute to the torque of the logs."""
        size = np.abs(self.values) * np.sqrt(np.diag(self.information))
        whole = math.sqrt(max(float(self.values @ self.information @ self.values), 0.0))
        return tuple(k for k in self.estimated if size[k] > _WORTH * whole)

    @property
    def covariance(self) -> Array | None:
        """Covariance of the errors, (p, p), SI; None where the logs do not determine every parameter."""
        which = list(self.estimated)
        own = self.information[np.ix_(which, which)]
        se = standard_errors_of(own)
        if not np.isfinite(se).all():
            return None
        scale = 1 / np.sqrt(np.diag(own))
        made, size = np.zeros_like(self.information), self.factor[which] * scale
        made[np.ix_(which, which)] = np.linalg.inv(own * scale[:, None] * scale) * size[:, None] * size
        return made

    def widths(self, more: Array | None = None, seconds: float = 0.0) -> Array:
        """Half width of each 95 % interval, (p,), SI; infinite where it is not identifiable, 0 where it is fixed.

        Args:
            more: information of a further motion, (p, p), in the same units.
            seconds: its duration; degrees of freedom grow in proportion to time.
        """
        whole = self.information if more is None else self.information + more
        dof = self.dof * (1 + seconds / self.seconds) if self.seconds else self.dof
        made, which = np.zeros(len(self.values)), list(self.estimated)
        made[which] = half_width(self.factor[which] * standard_errors_of(whole[np.ix_(which, which)]), dof[which])
        return made

    def relative_widths(self, more: Array | None = None, seconds: float = 0.0) -> Array:
        """The same in per cent of the value, (p,)."""
        size = np.maximum(np.abs(self.values), np.finfo(float).tiny)
        return np.asarray(100 * self.widths(more, seconds) / size)

    def behind(self, treated: TreatedNoise, found: PlannedMotion) -> Array:
        """Information of a motion behind a treatment, (p, p); `widths` multiplies by the factor, in its noise too."""
        return self._of_estimated(
            treated.information(self.model, found.trajectory) * self.factor[:, None] * self.factor
        )

    def of_motion(self, found: Excitation) -> Array:
        """Information of a motion on all base parameters, (p, p), in these units."""
        if self.treated is not None:
            return self.behind(self.treated, found)
        rows_hz = found.after.rows / len(self.noise) / found.seconds
        R = found.after.observation.stack(1 / (self.noise * math.sqrt(rows_hz)))[:-1, :-1]
        return self._of_estimated(R.T @ R)

    def _of_estimated(self, whole: Array) -> Array:
        """Information on the parameters that are estimated, (p, p)."""
        estimated = np.isin(np.arange(len(self.values)), self.estimated)
        return np.asarray(np.where(np.outer(estimated, estimated), whole, 0.0))

    def after(self, more: Array, seconds: float) -> LogInformation:
        """With a further motion recorded."""
        dof = self.dof * (1 + seconds / self.seconds) if self.seconds else self.dof
        return replace(self, information=self.information + more, dof=dof, seconds=self.seconds + seconds)


@dataclass(frozen=True, eq=False)
class FurtherMotions:
    """The next motions of a campaign, and the intervals that are predicted with them.

    Attributes:
        motions: found one after the other, each given those before.
        names: of the parameters that count.
        before, after: half widths of their 95 % intervals, per cent of their values, (k,) each.
        accuracy: wanted, per cent; None where none was given.
        seconds: of all motions together, s.
        needed: time of these motions until all parameters have the accuracy, repeated or cut short, s; infinite where
            `_LONGEST` times their duration would not do; None without an accuracy.
        basis: sentence on where the noise is known from, before there is a log.
    """

    motions: tuple[Excitation, ...]
    names: tuple[str, ...]
    before: Array
    after: Array
    accuracy: float | None
    seconds: float
    needed: float | None
    basis: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "before", freeze(self.before))
        object.__setattr__(self, "after", freeze(self.after))

    @property
    def reached(self) -> bool:
        """Whether the logs so far have the accuracy; there are no motions then."""
        return not self.motions

    @property
    def sentences(self) -> tuple[str, ...]:
        """The widest interval before and after, and when the accuracy is reached."""
        k, worst = int(np.argmax(self.before)), int(np.argmax(self.after))
        widest = f"{self.names[k]} +-{self.before[k]:.3g} %" if np.isfinite(self.before[k]) else "no log"
        if self.reached:
            return (f"The wanted accuracy of +-{self.accuracy:g} % is reached: the widest interval is {widest}.",)
        made = [self.basis] if self.basis else []
        made.append(
            f"Widest 95 % interval so far: {widest}; predicted after {self.seconds:.3g} s more: {self.names[worst]} "
            f"+-{self.after[worst]:.3g} %."
        )
        if self.needed is not None:
            if np.isinf(self.needed):
                late = listed([n for n, x in zip(self.names, self.after, strict=True) if x > (self.accuracy or 0)])
                made.append(
                    f"The accuracy of +-{self.accuracy:g} % is out of reach of this motion within {_LONGEST:g} times "
                    f"its duration ({late}): widen the limits, or settle for less."
                )
            else:
                made.append(
                    f"The accuracy of +-{self.accuracy:g} % is reached after {self.needed:.3g} s of this motion."
                )
        return tuple(made)

    def table(self) -> list[tuple[str, float, float]]:
        """Name, interval before and after, the widest before first, and without a log the widest after."""
        order = np.lexsort((-self.after, -self.before))
        return [(self.names[k], float(self.before[k]), float(self.after[k])) for k in order]


def next_motions(
    known: LogInformation,
    family: Family,
    limits: Limits | None = None,
    *,
    parameters: Sequence[str] | None = None,
    accuracy: float | None = None,
    count: int = 1,
    search: Search | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> FurtherMotions:
    """Find the motions that lower the largest relative interval most, given the information of the logs so far.

    Args:
        known: the logs so far.
        family: of motions.
        limits: of the motions; default: those of the device file.
        parameters: names of those that count; default: the essential ones.
        accuracy: wanted half width of every interval, per cent of the value: no motion is searched where it is reached.
        count: number of motions, each found given those before.
        search: evaluations of each motion, and seed.
        progress: called with the share of the search done, and the least cost so far.

    Raises:
        SettingError: the accuracy is not a positive number, there is no motion to find, or no parameter that counts.
        Further, see `design_excitation`.
    """
    if accuracy is not None and not 0 < accuracy < np.inf:
        raise SettingError(
            f"accuracy is {accuracy!r}; write a half width in per cent, above 0.", where="accuracy", found=accuracy
        )
    if count < 1:
        raise SettingError(f"count is {count!r}; write a whole number, 1 or more.", where="count", found=count)
    search, model = search or Search(), known.model
    which = known.essential if parameters is None else indices(model.base.names, tuple(parameters))
    fixed = [model.base.names[k] for k in which if k not in known.estimated]
    if fixed or not which:
        raise SettingError(
            f"{listed(fixed)}: fixed in the result, so that no motion makes the interval narrower."
            if fixed
            else "no parameter has a value, so that no relative interval can be made narrower.",
            where="parameters",
            found=tuple(fixed),
            advice="Name parameters that the result estimates."
            if fixed
            else "Identify a first log and continue from its result, or give prior values in the device file.",
        )
    names, chosen = tuple(model.base.names[k] for k in which), list(which)
    before = known.relative_widths()[chosen]
    if accuracy is not None and (before <= accuracy).all():
        return FurtherMotions((), names, before, before, accuracy, 0.0, 0.0)
    motions: list[Excitation] = []
    so_far = known
    for k in range(count):
        made = design_excitation(
            model,
            family,
            limits,
            criterion=LargestDeviation(_weights(so_far, chosen)),
            columns=tuple(model.base.names[j] for j in known.estimated),
            beta=known.values,
            noise=tuple((known.noise * math.sqrt(search.rows_hz)).tolist()),
            search=replace(search, seed=search.seed + k),
            information=so_far.information,
            covariance=known.covariance,
            rank=_rank(so_far, chosen),
            progress=None if progress is None else lambda share, cost, k=k: progress((k + share) / count, cost),  # type: ignore[misc]
        )
        motions.append(made)
        so_far = so_far.after(known.of_motion(made), made.seconds)
    return with_motions(known, motions, names, accuracy)


def with_motions(
    known: LogInformation, motions: Sequence[Excitation], names: Sequence[str], accuracy: float | None = None
) -> FurtherMotions:
    """What motions that are found are predicted to bring.

    Args:
        known: the logs so far.
        motions: one at least.
        names: of the parameters that count.
        accuracy: wanted half width of every interval, per cent of the value.
    """
    chosen, before = list(indices(known.model.base.names, tuple(names))), known.relative_widths()
    more = np.sum([known.of_motion(motion) for motion in motions], axis=0)
    seconds = sum(motion.seconds for motion in motions)
    needed = None
    if accuracy is not None:
        needed = _time(lambda n: bool((known.relative_widths(n * more, n * seconds)[chosen] <= accuracy).all()))
        needed *= seconds
    after = known.relative_widths(more, seconds)
    return FurtherMotions(tuple(motions), tuple(names), before[chosen], after[chosen], accuracy, seconds, needed)


def of_buffer(family: FourierSeries, samples: int, rate_hz: float) -> FourierSeries:
    """The series of the longest period that fits a buffer: whole samples, one period between two ramps.

    Ramps take a tenth of the time each, 1.5 s at most. The harmonics keep their frequencies: fewer of a longer
    fundamental period.

    Raises:
        SettingError: the buffer holds less than two periods of the highest harmonic.
    """
    seconds = (samples - 1) / rate_hz
    ramp = min(family.ramp, 0.1 * seconds)
    fundamental = 1 / (seconds - 2 * ramp)
    count = min(math.floor(family.highest_hz / fundamental + 1e-9), family.count)
    if count < 2:
        least = math.ceil(2 / 0.8 / family.highest_hz * rate_hz) + 1
        raise SettingError(
            f"a buffer of {samples} samples is {seconds:.3g} s at {rate_hz:g} Hz: too short for two periods of "
            f"{family.highest_hz:g} Hz.",
            where="buffer",
            found=samples,
            limit=least,
            advice=f"Take {least} samples or more, or a lower rate.",
        )
    return replace(family, seconds=seconds, fundamental_hz=fundamental, count=count, ramp=ramp)


def standard_errors_of(information: Array) -> Array:
    """Standard errors of unit noise from an information matrix, (k,); infinite in directions without information."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    there = scale > 0
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=there)
    values, vectors = np.linalg.eigh(information * inverse[:, None] * inverse)
    kept = values > _ROUNDING * max(values[-1], 0.0) if len(values) else np.zeros(0, dtype=bool)
    variance = (vectors[:, kept] ** 2 / values[kept]).sum(axis=1)
    lost = (vectors[:, ~kept] ** 2).sum(axis=1) > math.sqrt(_ROUNDING)
    return np.asarray(np.where(there & ~lost, inverse * np.sqrt(variance), np.inf))


def _rank(known: LogInformation, chosen: list[int]) -> Callable[[PlannedMotion], float] | None:
    """The largest interval with a motion behind the treatment of the logs; None where there is none."""
    if (treated := known.treated) is None:
        return None
    return lambda found: float(known.relative_widths(known.behind(treated, found), found.seconds)[chosen].max())


def _weights(known: LogInformation, chosen: Sequence[int]) -> tuple[float, ...]:
    """Half width over the white standard error of the essential parameters, 0 of others; of the estimated ones."""
    size = half_width(known.factor, known.dof)
    return tuple(float(size[k]) if k in chosen and known.values[k] else 0.0 for k in known.estimated)


def _time(reached: Callable[[float], bool]) -> float:
    """The smallest multiple at which a condition holds, to 1 %; infinite beyond `_LONGEST`."""
    if not reached(_LONGEST):
        return math.inf
    low, high = 0.0, _LONGEST
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high
