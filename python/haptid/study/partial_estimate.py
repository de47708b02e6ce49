"""The estimate of a study whose logs do not tell all parameters: without those that they do not, and a sentence."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError
from haptid.estimation import WLS, Estimate, FixedAtZero, estimate
from haptid.estimation.intervals.covariance import Intervals
from haptid.estimation.least_squares import unexcited
from haptid.inference.diagnosis.finding import joined_names
from haptid.log import Log
from haptid.observation.observation import Observation
from haptid.study.still_joints import still_joints
from haptid.study.study import Study

# Share of the parameters that may be left out: with fewer left, a sentence on the log is worth more than a model.
_MOST = 0.25
# Names in a sentence.
_NAMED = 6
# Kinds of parameters that accelerations and gravity excite: those of bodies and rotors.
_BODIES = frozenset({"XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "IA"})


def told_estimate(
    study: Study, model: DynamicModel, logs: Sequence[Log], rows: Observation, intervals: Intervals
) -> tuple[Study, Estimate]:
    """The estimate of a study's rows, and the study with the method that gave it.

    Where weighted least squares finds a direction that the rows do not excite, one parameter of each such direction is
    left out, at zero, and the intervals of all that share in it are unbounded: torque is predicted for motion like the
    logs', which these do not change.

    Args:
        study: with the method.
        model: of the device.
        logs: of the study; a joint that stands still in all is an error, which says how to hold it.
        rows: of the fit.
        intervals: of the estimate.

    Raises:
        IdentifiabilityError: a joint stands still, too many parameters are not told, or the method is another.
    """
    try:
        return study, estimate(rows, study.method, intervals)
    except IdentifiabilityError as error:
        told = type(study.method) is WLS and error.where in rows.base.names and not still_joints(model, logs, study)
        left_out, unknown = unexcited(rows.stack()[:-1, :-1]) if told else ((), ())
        names = rows.base.names
        by_motion = len(left_out) - len(_of_motors_without_rows(rows, left_out))
        if not (left_out and by_motion <= _MOST * len(names) and len(left_out) < len(names)):
            raise
    study = replace(study, method=FixedAtZero(tuple(names[k] for k in left_out), study.method))
    found = estimate(rows, study.method, intervals)
    own, text = found.quantities, _sentence(rows, left_out, unknown)
    if study.use == "free":
        text += ' The study\'s use = "free" is this fit, without those left out.'
    quantities = replace(own, unbounded=tuple(sorted({*own.unbounded, *unknown})))
    status = "uncertain" if found.status == "ok" else found.status
    return study, replace(found, quantities=quantities, status=status, notes=(text, *found.notes))


def _of_motors_without_rows(rows: Observation, left_out: Sequence[int]) -> list[int]:
    """Those of some parameters that act on no motor of which rows are used."""
    reached = {int(k) for motor in rows.motors if motor.rows.any() for k in motor.columns}
    return [k for k in left_out if k not in reached]


def _sentence(rows: Observation, left_out: Sequence[int], unknown: Sequence[int]) -> str:
    """What is left out, why, and what to record."""
    names, model = rows.base.names, rows.model
    gone, others = [names[k] for k in left_out], [names[k] for k in unknown if k not in left_out]
    without = joined_names([motor.label for motor in rows.motors if not motor.rows.any()])
    one, by_motor = len(gone) == 1, bool(_of_motors_without_rows(rows, left_out))
    cause = f"whose motion does not excite {'it' if one else 'them'}"
    if by_motor:
        cause = f"of which no row of {without} is used"
    text = (
        f"{joined_names(gone, most=_NAMED)} cannot be told from this log, {cause}, and {'is' if one else 'are'} left "
        "out, at zero"
    )
    if others:
        text += f"; {joined_names(others, most=_NAMED)} {'is' if len(others) == 1 else 'are'} not told apart from that"
    kinds = {model.device.parameters.kinds[rows.base.independent_columns[k]] for k in left_out}
    advice = f"Record motion with the torque of {without}." if by_motor else _advice(kinds)
    return f"{text}. Torque is predicted for motion like the log's alone. {advice}"


def _advice(kinds: Set[str]) -> str:
    """The motion to record for parameters of some kinds, in a sentence."""
    wanted = ["accelerates the links at other poses"] if kinds & _BODIES else []
    if kinds - _BODIES:  # friction, offsets and springs
        wanted.append("takes the joints both ways, at several speeds, over their range")
    return f"Record motion that {' and '.join(wanted)}."
