"""Source of a report: an identification with its diagnosis, tracks of torque and torque decompositions."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.errors import MissingAccelerationError
from haptid.estimation import Estimate
from haptid.observation.plan import Plan
from haptid.observation.rows import chunks, gathered
from haptid.study.identify import Identification, Run
from haptid.uncertainty.figures import per_cent
from haptid.validation.prediction import Prediction
from haptid.validation.validation import Validation

# A quarter of all imports, which numbers without a report do not need: each is loaded where it is called.
if TYPE_CHECKING:
    from haptid.advice import Advice
    from haptid.end_effector.characterisation.model import GivenParameters
    from haptid.end_effector.force import HandleForce
    from haptid.end_effector.torque_decomposition import TorqueDecomposition
    from haptid.inference.diagnosis import Diagnosis, Verdict

# A log with more rows is not decomposed: memory.
LARGEST_DECOMPOSITION = 2_000_000
# Approximate number of points of the path along a log.
_TRAIL = 400


@dataclass(frozen=True, eq=False)
class Track:
    """Treated rows of one log: measured and predicted torque, positions and velocities.

    Attributes:
        name: of the log.
        seen: whether the fit used these rows.
        t: of the rows, (rows,), s.
        step: between rows, s.
        labels, units: of the motors, (motors,).
        measured, predicted: torque, (motors, rows), N m or N.
        used: whether a row is used, (motors, rows).
        position, velocity: of the motors' coordinates, (motors, rows), SI.
        coordinate_units: of the positions, (motors,).
        trail: positions of all coordinates along the log, thinned, (active, few), SI.
    """

    name: str
    seen: bool
    t: Array
    step: float
    labels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Array
    predicted: Array
    used: np.ndarray
    position: Array
    velocity: Array
    coordinate_units: tuple[str, ...]
    trail: Array

    def __post_init__(self) -> None:
        shape = (len(self.labels), self.used.shape[1])
        freeze_fields(self, "trail", t=shape[1:], measured=shape, predicted=shape, position=shape, velocity=shape)

    @property
    def t0(self) -> float:
        """Time of the first row, s."""
        return float(self.t[0])

    @property
    def prediction(self) -> Prediction:
        """The torques alone."""
        return Prediction(self.labels, self.units, self.t, self.measured, self.predicted, self.used)

    @property
    def motors_used(self) -> list[int]:
        """Indices of the motors with used rows; a motor whose joint was locked has none."""
        return np.flatnonzero(self.used.any(axis=1)).tolist()

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted, NaN where a row is not used, (motors, rows)."""
        return np.where(self.used, self.measured - self.predicted, np.nan)

    @property
    def rows(self) -> int:
        return int(self.used.shape[1])

    @property
    def kind(self) -> str:
        """Kind of the rows, as text."""
        return "rows of the fit" if self.seen else "unseen rows"

    @property
    def seconds(self) -> float:
        return self.rows * self.step


@dataclass(frozen=True, eq=False)
class HandForceData:
    """Force of a hand on the device in the base frame: estimated, and measured where there was a sensor.

    Attributes:
        name: of the log.
        t: evenly spaced, (rows,), s.
        force: estimated, (rows, 3), N; NaN where it is unknown.
        conf_int: of it, (rows, 3, 2), N; None where it was not computed.
        measured: at the same times, (rows, 3), N; None where there was no sensor.
        notes: sentences for the user.
    """

    name: str
    t: Array
    force: Array
    conf_int: Array | None = None
    measured: Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.t)
        freeze_fields(self, "t", force=(n, 3), conf_int=(n, 3, 2), measured=(n, 3))

    @staticmethod
    def of(name: str, force: HandleForce, measured: Array | None = None) -> HandForceData:
        """From the result of `estimate_force`, and a sensor's force in the base frame, (rows, 3), N."""
        return HandForceData(name, force.t, force.force, force.conf_int(), measured, force.notes)


@dataclass(frozen=True, eq=False)
class ReportSource:
    """Input of a report.

    Attributes:
        identification: result of `haptid.identify`.
        command: the command line that made it; empty where there was none.
        hands: estimated forces at the handle.
    """

    identification: Identification
    command: str = ""
    hands: tuple[HandForceData, ...] = field(default=())

    @property
    def estimate(self) -> Estimate:
        return self.identification.estimate

    @cached_property
    def validation(self) -> Validation | None:
        """The worst validation on unseen rows; None without any."""
        return max(self.identification.unseen, key=lambda found: found.comparable.relative, default=None)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """Diagnosis of the estimate."""
        from haptid.inference.diagnosis import diagnose

        return diagnose(self.estimate, self.validation, self.identification.study.controller)

    @cached_property
    def advice(self) -> Advice:
        """What to change, each action tried on the data."""
        from haptid.advice import advise

        return advise(self.identification, self.diagnosis)

    @cached_property
    def verdict(self) -> Verdict:
        """Of the diagnosis, with what the advice has proven."""
        from haptid.advice import verdict_with

        return verdict_with(self.diagnosis, self.advice)

    @cached_property
    def tracks(self) -> tuple[Track, ...]:
        """One per log."""
        return tuple(track(self.identification.use.estimate, run) for run in self.identification.runs)

    @cached_property
    def decompositions(self) -> tuple[TorqueDecomposition | None, ...]:
        """One per log; None where a log is too long, or its rows have no accelerations."""
        return tuple(
            self._decomposed(run, track.rows) for run, track in zip(self.identification.runs, self.tracks, strict=True)
        )

    @cached_property
    def model(self) -> GivenParameters:
        """The model for use without a covariance, for the maps."""
        from haptid.end_effector.characterisation.model import GivenParameters

        return GivenParameters(self.estimate.model, self.identification.use.beta)

    def _decomposed(self, run: Run, rows: int) -> TorqueDecomposition | None:
        from haptid.end_effector.torque_decomposition import decompose_torque

        if rows > LARGEST_DECOMPOSITION:
            return None
        try:
            return decompose_torque(self.identification.use.estimate, run.motion)
        except MissingAccelerationError:
            return None


def track(estimate: Estimate, run: Run) -> Track:
    """The treated rows of one log."""
    model, motion = estimate.model, run.motion
    chi, rows = raw_parameters(model, estimate.beta), [k for k, known in enumerate(model.device.known) if known]
    parts = (
        (s.t, s.measured(), s.torque(chi), s.used, s.centres(s.c), s.centres(s.cd)[rows]) for s in chunks(model, motion)
    )
    t, measured, predicted, used, c, velocity = gathered(parts, Plan.of(model, motion).rows)
    return Track(
        name=run.entry.path,
        seen=run.fit_errors is not None,
        t=t,
        step=motion.treatment.decimation * motion.dt,
        labels=tuple(model.device.row_labels[k] for k in rows),
        units=tuple(model.device.torque_units[k] for k in rows),
        measured=measured,
        predicted=predicted,
        used=used,
        position=c[rows],
        velocity=velocity,
        coordinate_units=tuple(model.device.coordinate_units[k] for k in rows),
        trail=c[:, :: max(1, c.shape[1] // _TRAIL)],
    )


def criterion(identification: Identification) -> str:
    """Largest error on unseen motion and the study's criterion, in a sentence."""
    from haptid.inference.diagnosis.finding import joined_names

    if not identification.unseen:
        return (
            "No unseen rows: this fit is not validated. Give the study a log with role 'validate', or another "
            "[validation]."
        )
    worst = max(identification.unseen, key=lambda v: v.comparable.relative)
    text = f"Relative torque error on unseen motion: {per_cent(worst.comparable.relative)}"
    if len(worst.comparable.motors) > 1:
        largest = worst.comparable.largest
        others = [motor.label for motor, _ in worst.comparable.small if motor.relative > largest.relative]
        reference = "of all motors (RMS of the errors by unit)" if worst.comparable.mixed else "of all motors together"
        text += f" {reference}, {per_cent(largest.relative)} of {largest.label}, the largest"
        text += f" but for {joined_names(others)} with hardly any torque" if others else ""
    text += "; all rows in motion, behind the reference filter." if worst.reference is not None else "."
    if identification.meets_criteria is None:
        return text
    limit = identification.study.largest_error
    return f"{text} The study allows {limit:g} %: {'met' if identification.meets_criteria else 'not met'}."
