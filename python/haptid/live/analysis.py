"""`LiveAnalysis`: what samples say about a device while they are recorded.

Parameters by recursive identification, the motion that is missing, measured against predicted torque, the force of the
hand, and an alarm once a model is held.
"""

from __future__ import annotations

import threading
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Device, read_device
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.force import WORST_CONDITION, lever_of
from haptid.errors import HaptidError, SettingError, StudyFileError
from haptid.estimation import Estimate, RecursiveIdentification
from haptid.experiment.guidance import Guidance, MotionGuide
from haptid.inference import Alarm, ModelAlarm
from haptid.live.recorder import SampleRun
from haptid.log import Channels, Signal
from haptid.motion import Treatment
from haptid.observation import Observation, RowStream
from haptid.observation.rows import chunks
from haptid.study import Study

# Longest gap that is interpolated linearly, samples, as a reader of the record does.
_BRIDGED = 5
# Rows that are kept for drawing, and alarms.
_ROWS_KEPT, _ALARMS_KEPT = 60, 50
# Rows of a second where the study does not say, and slowest mean motion that is no rest, rad/s or m/s.
_ROWS_PER_S, _REST = 100.0, 0.01
# Length of new rows after which parameters and prompts are renewed, s.
_RENEWED = 1.0


@dataclass(frozen=True)
class LiveSettings:
    """How samples are analysed.

    Attributes:
        rate_hz: samples in a second.
        forgetting_s: of the recursion; None for none.
        alarms_per_hour: false ones that are accepted once a model is held.
    """

    rate_hz: float = 1000.0
    forgetting_s: float | None = None
    alarms_per_hour: float = 0.1


@dataclass(frozen=True, eq=False)
class _Rows:
    """Treated torques of some rows: measured, predicted by the model of that moment, and the force of the hand."""

    t: Array
    measured: Array
    predicted: Array
    force: Array | None


class LiveAnalysis:
    """Takes runs of samples, in the units of the channels, and knows what they say so far.

    `take` is called by one thread, the others may be by any.

    Args:
        device: the mechanism.
        channels: what the samples are.
        treatment: of the samples.
        settings: of the analysis.

    Raises:
        SettingError: positions that jump by their period.
        HaptidError: as for `RowStream`.
    """

    def __init__(self, device: Device, channels: Channels, treatment: Treatment, settings: LiveSettings) -> None:
        if channels.position.unwrap:
            raise SettingError(
                "positions that jump by their period (unwrap) are not analysed live.",
                where="unwrap",
                advice="Send positions that go on over a turn.",
            )
        self.model, self.channels, self.settings = DynamicModel(device), channels, settings
        self.stream = RowStream(self.model, channels, 1 / settings.rate_hz, treatment)
        self.recursion = RecursiveIdentification(self.model, settings.forgetting_s)
        self.trouble = ""
        self.guide: MotionGuide | None = None
        try:
            self.guide = MotionGuide(self.model, settings.rate_hz / treatment.decimation)
        except HaptidError as error:
            self.trouble = str(error)
        self._lock = threading.Lock()
        self._estimate: Estimate | None = None
        self._guidance: Guidance | None = None
        self._held: Estimate | None = None
        self._alarm: ModelAlarm | None = None
        self.alarms: deque[Alarm] = deque(maxlen=_ALARMS_KEPT)
        self._rows: deque[_Rows] = deque(maxlen=_ROWS_KEPT)
        self._since = 0.0
        self._last: tuple[Array, Array] | None = None
        self.scores: list[tuple[float, float]] = []

    def take(self, run: SampleRun) -> None:
        """The next samples, after a gap where the run has one."""
        q = self._in_si(self.channels.position, run.position, "position")
        tau = self._in_si(self.channels.torque, run.torque, "torque")
        made: list[Observation] = []
        missing = round(run.gap * self.settings.rate_hz)
        if missing and self._last is not None and missing <= _BRIDGED:
            share = np.arange(1, missing + 1)[:, None] / (missing + 1)
            bridges = [a + share * (b[0] - a) for a, b in zip(self._last, (q, tau), strict=True)]
            made += self.stream.push(*bridges)
        elif missing:
            made += self.stream.gap(run.gap)
        made += self.stream.push(q, tau)
        self._last = q[-1], tau[-1]
        for rows in made:
            self._learn(rows)

    def hold(self, held: bool) -> None:
        """Keep the parameters as they are known now as the model that torques and alarms are of, or let them move.

        Raises:
            HaptidError: they are not known well enough for an alarm.
        """
        with self._lock:
            if not held:
                self._held = self._alarm = None
                return
            made = self.recursion.estimate()
            if made.quantities.unbounded:
                names = ", ".join(made.names[k] for k in made.quantities.unbounded[:6])
                raise SettingError(
                    f"the model cannot be held yet: {names} are not known.", advice="Make the motion that is named."
                )
            self._alarm, self._held = ModelAlarm(made, self.settings.alarms_per_hour), made
            self.alarms.clear()

    @property
    def held(self) -> bool:
        """Whether a model is held."""
        return self._held is not None

    def known(self) -> tuple[Estimate | None, Guidance | None]:
        """The latest parameters and prompts."""
        with self._lock:
            return self._estimate, self._guidance

    def rows_since(self, t: float) -> list[_Rows]:
        """Rows after a time, s."""
        with self._lock:
            return [rows for rows in self._rows if rows.t[-1] > t]

    def to_json(self) -> dict[str, Any]:
        """What a page shows: parameters, score, prompts, alarms."""
        estimate, guidance = self.known()
        parameters = [] if estimate is None else estimate.quantities.to_json()
        return {
            "parameters": parameters,
            "seconds": self.recursion.seconds,
            "clusters": len(self.recursion),
            "score": guidance and guidance.score,
            "scores": self.scores[-600:],
            "prompts": [
                {"sentence": p.sentence, "score": p.score, "parameters": list(p.parameters), "joints": list(p.joints)}
                for p in (guidance.prompts if guidance else ())
            ],
            "held": self.held,
            "alarms": [{"sentence": a.sentence, "kind": a.kind, "motor": a.motor, "t": a.stop} for a in self.alarms],
            "trouble": self.trouble,
        }

    def _in_si(self, signal: Signal, raw: Array, quantity: str) -> Array:
        factors = np.array(signal.scales("position" if quantity == "position" else "torque"))
        return np.asarray(factors * np.array(signal.gain) * raw + np.array(signal.offset), dtype=np.float64)

    def _learn(self, rows: Observation) -> None:
        with self._lock:
            alarm, self._since = self._alarm, self._since + sum(b.stop - b.start for b in rows.blocks)
            if alarm is not None:
                self.alarms.extend(alarm.add(rows))
            else:
                self.recursion.add(rows)
            try:
                if self._estimate is None or (self._since >= _RENEWED and alarm is None):
                    self._since = 0.0
                    self._estimate = self.recursion.estimate()
                    if self.guide is not None:
                        self._guidance = self.guide.guidance(self._estimate)
                        self.scores.append((rows.blocks[-1].stop, self._guidance.score))
                self.trouble = self.trouble if self.guide is None else ""
            except HaptidError as error:
                self.trouble = str(error)
            model = self._held or self._estimate
            if model is not None:
                self._rows.extend(self._shown(rows, model))

    def _shown(self, rows: Observation, model: Estimate) -> list[_Rows]:
        """Torques of the new rows, and the force of the hand with a model that is held."""
        chi, made = raw_parameters(self.model, model.beta), []
        start, stop = rows.blocks[0].start, rows.blocks[-1].stop
        for s in chunks(self.model, rows.motions[0]):
            here = (s.t >= start) & (s.t < stop)
            if not here.any():
                continue
            measured, predicted = s.measured(), s.torque(chi)
            force = self._force(model, s.centres(s.c)[:, here], (predicted - measured)[:, here])
            made.append(_Rows(s.t[here], measured[:, here], predicted[:, here], force))
        return made

    def _force(self, model: Estimate, c: Array, external: Array) -> Array | None:
        """Force of the hand in the base frame, (3, rows), N; NaN at poses that are not usable."""
        if not self.held or self.model.device.handle is None:
            return None
        weights = np.asarray(model.weights)
        noise = 1 / np.maximum(weights, np.finfo(float).tiny)
        found = lever_of(model, np.linalg.inv(self.model.device.row_map) @ c, noise, False, WORST_CONDITION)
        return np.where(found.usable, found.wrench(external)[:3], np.nan)


def analysed_study(study: Study, settings: LiveSettings) -> LiveAnalysis:
    """The analysis of what a study describes: its device, channels and treatment.

    Raises:
        StudyFileError: the study names no channels.
        HaptidError: as for `read_device` and `LiveAnalysis`.
    """
    channels = study_channels(study)
    given: dict[str, Any] = {"decimation": max(1, round(settings.rate_hz / _ROWS_PER_S)), "rest_speed": _REST}
    treatment = Treatment(**(given | dict(study.treatment)))
    return LiveAnalysis(read_device(study.device), channels, treatment, settings)


def study_channels(study: Study) -> Channels:
    """The channels of a study's first log.

    Raises:
        StudyFileError: it names none.
    """
    for entry in study.logs:
        if entry.channels is not None:
            return entry.channels
    raise StudyFileError(
        f"{Path(study.path).name} names no channels.",
        where="channels",
        advice="Write [channels] with position and torque: what the sender sends.",
    )
