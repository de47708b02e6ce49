"""Elastic motors where the device file has rigid ones: fitted to half of a log, judged on the other half.

Near the frequency of a link on its spring the torque of the motor is that of no rigid body, whatever its parameters,
and delays, friction or lengths would be blamed. So the device with elastic motors is identified from the motors'
positions alone, as a study of it would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.edits import Edit, elastic_edits
from haptid.advice.sides import OtherAssumption
from haptid.advice.trial import Gain
from haptid.device.toml.reader import device_of
from haptid.device.toml.terms import ElasticTerm, PlainTerm
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.estimation import WLS, Estimate, estimate
from haptid.inference.diagnosis.finding import joined_names
from haptid.log.log import Log
from haptid.motion.motion import Motion, treat
from haptid.observation.observation import observe
from haptid.treatment_choice.hidden_joints import complete_logs, lacks_links
from haptid.treatment_choice.spring_bound import parameters_of
from haptid.validation.prediction import Prediction, predict
from haptid.validation.validation import of_all_motors

# Length of each half, s, at most: an error that no rigid body explains is large, and shows soon.
_SECONDS = 15.0
# Length of the blocks by which two errors are paired, s.
_BLOCK_S = 1.0


@dataclass(frozen=True, eq=False)
class OtherElasticity(OtherAssumption):
    """Motors behind springs.

    Attributes:
        motors: their names.
        stiffness: of each by the half that was fitted, N m/rad or N/m at the joint.
        edits: of the device file.
    """

    motors: tuple[str, ...]
    stiffness: tuple[float, ...]
    edits: tuple[Edit, ...]

    @property
    def places(self) -> tuple[str, ...]:
        """The motors as a report names them."""
        return tuple(f"motor {name}" for name in self.motors)


def other_elasticity(
    model: DynamicModel,
    motions: Sequence[Motion],
    tried: Sequence[Sequence[str]],
    delays: float | tuple[float, ...],
    most: float,
) -> OtherElasticity | None:
    """Motors behind springs, with the error that this leaves; None where it is not proven, or cannot be tried.

    The longest log counts, of which one half is fitted and the other predicted, by the rigid device and by the elastic
    one. Its positions have to be those of the motors, as elastic motors leave them.

    Args:
        model: of the rigid device.
        motions: treated signals of the fit.
        tried: names of motors that are elastic together; the first of these sets that does is taken.
        delays: of the torque, s, that are right for the rigid device.
        most: unseen error that springs leave at most, per cent.
    """
    log = max((m.log for m in motions if m.log is not None), key=lambda one: one.t.size, default=None)
    if log is None or model.device.elastic or model.device.sensors:
        return None
    part = log.busiest(2 * _SECONDS)
    for motors in tried:
        one = _tried(model, part, motors, delays)
        if one is not None and one.proven(len(tried)) and one.after <= most:
            return one
    return None


def _tried(
    model: DynamicModel, log: Log, motors: Sequence[str], delays: float | tuple[float, ...]
) -> OtherElasticity | None:
    """Some motors behind springs; None where the device cannot have these, or the log does not show them."""
    edits = tuple(elastic_edits(model.device, motors))
    halves = [log.between(0, log.t.size // 2), log.between(log.t.size // 2, log.t.size)]
    try:
        elastic = _with_terms(model, edits)
        if not lacks_links(elastic, log):
            return None
        (_, unseen), found = complete_logs(elastic, halves, [True, False], trial=True)
        treatment = found.observation.motions[0].treatment
        there = predict(found, treat(unseen, treatment))
        treatment = replace(treatment, torque_delay_s=delays)
        rigid = estimate(observe(model, treat(halves[0], treatment)), WLS())
        here = predict(rigid, treat(halves[1], treatment))
    except HaptidError:
        return None
    figures = _compared(here, there)
    return None if figures is None else OtherElasticity(*figures, *_stiffness(found), edits)


def _with_terms(model: DynamicModel, edits: Sequence[Edit]) -> DynamicModel:
    """The model of the device with these terms.

    Raises:
        DeviceFileError: the device cannot have them.
    """
    tables = model.device.tables
    kinds = {"elastic": ElasticTerm, "rotor-inertia": PlainTerm}
    added = [kinds[edit.value["kind"]](**edit.value) for edit in edits]
    terms = [*tables.terms, *added]
    return DynamicModel(device_of(tables.model_copy(update={"terms": terms}), model.device.name))


def _compared(here: Prediction, there: Prediction) -> tuple[Gain, float, float, float, int] | None:
    """Gain of the second prediction on the rows of both, errors, their paired standard error, and blocks.

    Errors are per cent; None where a motor of the first is not in the second, or they have no rows in common.
    """
    if not set(here.motors) <= set(there.motors):
        return None
    own = [there.motors.index(name) for name in here.motors]
    _, a, b = np.intersect1d(np.round(here.t, 6), np.round(there.t, 6), return_indices=True)
    used = here.used[:, a] & there.used[own][:, b]
    block = ((here.t[a] - here.t[0]) // _BLOCK_S).astype(int)
    measured = np.where(used, here.measured[:, a], 0.0)
    factors = of_all_motors((measured**2).sum(axis=1), here.units)
    parts: list[Array] = []
    for y, predicted in (
        (here.measured[:, a], here.predicted[:, a]),
        (there.measured[own][:, b], there.predicted[own][:, b]),
    ):
        squares = factors @ np.where(used, y - predicted, 0.0) ** 2
        parts.append(np.bincount(block, squares).astype(np.float64))
    kept = np.bincount(block, used.any(axis=0)) > 0
    first, second = (part[kept] for part in parts)
    if len(first) < 2 or not first.any():
        return None
    made = Gain.of(first, second)
    before, after = (100 * float(np.sqrt(part.sum())) for part in (first, second))
    # By the delta method: the squares differ by share of `before`, the errors by that over their sum.
    return made, before, after, made.se * before**2 / (before + after), len(first)


def stiffnesses(values: Sequence[float], travel: str) -> str:
    """Stiffnesses in words, of motors whose positions are in rad, in m, or "rad or m"."""
    units = {"rad": "N m/rad", "m": "N/m"}
    return (
        f"{joined_names([_rounded(x) for x in values], most=8)} {' or '.join(units[x] for x in travel.split(' or '))}"
    )


def _rounded(x: float) -> str:
    """A number in two digits, without an exponent."""
    return f"{float(f'{x:.2g}'):g}" if 1e-3 < abs(x) < 1e6 else f"{x:.2g}"


def _stiffness(found: Estimate) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names of the elastic motors, and the stiffness of each."""
    beta = dict(zip(found.names, found.beta.tolist(), strict=True))
    drives = found.model.device.elastic
    springs = (parameters_of(found.model, drive, "spring") for drive in drives)
    return tuple(drive.name for drive in drives), tuple(sum(beta[name] for name in own) for own in springs)
