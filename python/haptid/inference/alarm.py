"""`ModelAlarm`: detects when a model no longer holds along a stream, with a stated rate of false alarms.

Charts of residuals by time block (Shewhart 1931; Montgomery 2013, Introduction to Statistical Quality Control, section
6.4, charts of individual values): the logarithm of every motor's mean square residual, of one block and of the mean of
the last eight, against the blocks that the model was identified from. Residuals are divided by what the uncertainty of
the parameters adds in the block's own motion, so that motion which was never identified gives no alarm.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.errors import NoRowsError, setting_error
from haptid.estimation import Estimate
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Block
from haptid.uncertainty.distributions import t_quantile
from haptid.uncertainty.quantities import covariance_root

# Fewest blocks of the reference, and blocks whose mean is charted for slow changes.
_FEWEST, _MEAN = 12, 8
# Share of the torque predicted that is missing, and of that measured, where no torque arrives.
_MISSING, _SILENT = 0.8, 0.2
# Least share of a block's motion that its rows must have for its level to count.
_ROWS = 4
_SECONDS_IN_HOUR = 3600.0
AlarmKind = Literal["no torque", "sudden", "lasting"]
_WORDS = {
    "no torque": "its measured torque is {measured:.2g} of what the model predicts: a cable or an amplifier is broken, "
    "or the channel is another",
    "sudden": "its residual is {ratio:.2g} times that of the identification: a contact, a force of a hand, or a fault",
    "lasting": "its residual was {ratio:.2g} times that of the identification over the last {blocks} blocks: friction, "
    "load or gain have changed",
}


@dataclass(frozen=True)
class Alarm:
    """A motor whose residual is larger than chance explains.

    Attributes:
        motor: label.
        kind: "no torque", "sudden" (one block) or "lasting" (the mean of the last blocks).
        start, stop: of the block, or of the blocks, s.
        ratio: root mean square residual over that of the identification.
        sentence: for people.
    """

    motor: str
    kind: AlarmKind
    start: float
    stop: float
    ratio: float
    sentence: str


class ModelAlarm:
    """Control charts of the residuals of a model along a stream of blocks.

    The false-alarm rate holds where the logarithms of the blocks' residuals are normal and the motion is of the kind of
    the reference: the blocks are independent but for the correlation that the reference shows.

    Args:
        reference: the model, with the blocks it was identified from.
        per_hour: false alarms in an hour of motion, of all motors and both charts together.

    Raises:
        SettingError: `per_hour` is not above zero, or so large that every block may be one.
        NoRowsError: the reference has fewer than twelve blocks.
    """

    def __init__(self, reference: Estimate, per_hour: float = 0.1) -> None:
        observation = reference.fit.observation
        block_s = float(np.median([block.stop - block.start for block in observation.blocks]))
        charts = 2 * len(observation.motors)
        alpha = per_hour * block_s / _SECONDS_IN_HOUR / charts if positive(per_hour) else 0.0
        if not 0 < alpha < 0.5:
            wanted = f"above 0 and below {0.5 * charts * _SECONDS_IN_HOUR / block_s:.3g}"
            raise setting_error("per_hour", per_hour, f"a number {wanted}")
        if len(observation.blocks) < _FEWEST:
            raise NoRowsError(
                f"the reference has {len(observation.blocks)} time blocks, and {_FEWEST} are needed for what is usual.",
                found=len(observation.blocks),
                limit=_FEWEST,
                advice="Identify from a longer motion, or with shorter blocks.",
            )
        self.reference, self.per_hour = reference, per_hour
        levels = _levels(reference, observation.motors, leverage=True)
        self._charts = [_Chart.of(level[np.isfinite(level)], alpha) for level in levels]
        self._last: list[deque[tuple[float, Block]]] = [deque(maxlen=_MEAN) for _ in levels]

    def add(self, observation: Observation) -> tuple[Alarm, ...]:
        """Judge the blocks of an observation, in order of time.

        Raises:
            ModelMismatchError: it is of another model.
        """
        self.reference.model.require_same(observation.model)
        alarms: list[Alarm] = []
        levels = _levels(self.reference, observation.motors, leverage=False)
        for m, (motor, chart, last) in enumerate(zip(observation.motors, self._charts, self._last, strict=True)):
            for k, (level, block) in enumerate(zip(levels[m], observation.blocks, strict=True)):
                if not np.isfinite(level):
                    continue
                last.append((level - chart.middle, block))
                if level - chart.middle > chart.single:
                    ratio = float(np.exp(0.5 * (level - chart.middle)))
                    alarms.append(_alarm(motor, *self._silence(motor, k), block, block, ratio))
                    last.clear()  # reported; what lasts is reported of later blocks
                elif len(last) == _MEAN and (mean := float(np.mean([x for x, _ in last]))) > chart.mean:
                    alarms.append(_alarm(motor, "lasting", 1.0, last[0][1], block, float(np.exp(0.5 * mean))))
                    last.clear()
        return tuple(alarms)

    def _silence(self, motor: MotorRows, k: int) -> tuple[AlarmKind, float]:
        """Whether the torque of a block is missing, and the norm measured over that predicted."""
        T, beta = motor.r_factors[k], self.reference.beta[motor.columns]
        predicted, measured = np.linalg.norm(T[:, :-1] @ beta), np.linalg.norm(T[:, -1])
        rest = np.linalg.norm(T[:, -1] - T[:, :-1] @ beta)
        silent = rest > _MISSING * predicted and measured < _SILENT * predicted
        return ("no torque" if silent else "sudden"), float(measured / max(predicted, np.finfo(float).tiny))


@dataclass(frozen=True)
class _Chart:
    """Mean logarithm of a motor's mean square residual, and how far one block and the mean of some may be above it."""

    middle: float
    single: float
    mean: float

    @staticmethod
    def of(levels: Array, alpha: float) -> _Chart:
        """Prediction limits of a normal sample (Student t), for one value and for a mean."""
        n = len(levels)
        if n < _FEWEST:
            return _Chart(0.0, np.inf, np.inf)  # a motor with too few rows: no limits
        deviations = levels - levels.mean()
        sd, quantile = float(np.std(levels, ddof=1)), float(t_quantile(1 - alpha, float(n - 1)))
        lags = np.arange(1, _MEAN)
        # Correlations of neighbours; those of n values are too small by about 1 / n (Kendall 1954, Biometrika 41).
        rho = (
            np.array([deviations[lag:] @ deviations[:-lag] for lag in lags])
            / max(float(deviations @ deviations), 1e-300)
            + 1 / n
        )
        longer = max(1.0, 1 + 2 * float(((1 - lags / _MEAN) * rho).sum()))
        mean = quantile * sd * np.sqrt(longer * (1 / _MEAN + 1 / n))
        return _Chart(float(levels.mean()), quantile * sd * np.sqrt(1 + 1 / n), float(mean))


def _levels(reference: Estimate, motors: tuple[MotorRows, ...], leverage: bool) -> Array:
    """Logarithm of the mean square residual of every block, (motors, blocks); NaN where a block has few rows.

    Args:
        reference: the model.
        motors: rows.
        leverage: whether these are the rows of the fit, whose residuals are smaller by their leverage; others' are
            larger by what the parameters' uncertainty adds.
    """
    spread = covariance_root(reference.covariance)
    levels = np.full((len(motors), len(motors[0].rows)), np.nan)
    own = {motor.name: k for k, motor in enumerate(reference.fit.observation.motors)}
    for m, motor in enumerate(motors):
        weight = float(reference.weights[own[motor.name]])
        T = motor.r_factors
        e2 = ((T[:, :, -1] - T[:, :, :-1] @ reference.beta[motor.columns]) ** 2).sum(axis=1)
        if leverage:
            taken = ((weight * T[:, :, :-1] @ reference.fit.solution.root[motor.columns]) ** 2).sum(axis=(1, 2))
            expected = np.maximum(motor.rows - taken, 1.0)
        else:
            added = ((T[:, :, :-1] @ spread[motor.columns]) ** 2).sum(axis=(1, 2)) * weight**2
            expected = motor.rows + added
        used = (motor.rows >= _ROWS) & (e2 > 0)
        levels[m, used] = np.log(e2[used] / expected[used])
    return levels


def _alarm(motor: MotorRows, kind: AlarmKind, measured: float, first: Block, last: Block, ratio: float) -> Alarm:
    words = _WORDS[kind].format(ratio=ratio, measured=measured, blocks=_MEAN)
    sentence = f"{motor.label}, {first.start:.1f} to {last.stop:.1f} s: {words}."
    return Alarm(motor.label, kind, first.start, last.stop, ratio, sentence)
