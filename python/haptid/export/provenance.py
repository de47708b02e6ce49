"""Provenance of an exported model: parameters, data, validation verdict, and the heading of every written file."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from haptid._core import __version__
from haptid._internal.arrays import Array, expect, freeze_fields
from haptid._internal.escaping import c_comment, one_line
from haptid._internal.late import dataclass
from haptid.device import Motor
from haptid.dynamics.counterparts import parameters_on, without_sensors
from haptid.dynamics.model import DynamicModel
from haptid.errors import UnvalidatedModelError
from haptid.estimation import Estimate
from haptid.results import Result, ResultUse
from haptid.study.identify import Identification
from haptid.validation.validation import Validation

# What can be exported: the identification of a study, a result read from its folder, an estimate, or a model with
# base parameters of other origin.
ExportSource = Identification | Result | Estimate | tuple[DynamicModel, ArrayLike]


class ExportCriterion(TypedDict, total=False):
    """ExportCriterion that a model has to meet before any exporter writes it.

    Attributes:
        validation: of an estimate, on unseen motion; an identification and a result have their own.
        largest_error: largest prediction error, per cent; by default that of the study or result.
        anyway: export a model that fails its criterion or was not validated, with a note in the files.
    """

    validation: Validation | None
    largest_error: float | None
    anyway: bool


# Maximum line length of a file's heading, characters.
_WIDTH = 112


@dataclass(frozen=True, eq=False)
class Provenance:
    """A model to export.

    Attributes:
        beta: its base parameters, (p,), SI.
        intervals: their 95 % confidence intervals, (p, 2); None where unknown.
        covariance: of their errors, (p, p); None where unknown.
        hashes: SHA-256 of the logs that it was identified from.
        verdict: prediction error on unseen motion, a sentence.
        zero: indices of eliminated base parameters, which the code omits.
        uses: fitness of the model for each use; empty where it was not diagnosed.
        reason: why these parameters are the model for use, a sentence; empty where there was nothing to choose.
        unexcited: indices of base parameters whose quoted values mean nothing, since no log tells them.
    """

    model: DynamicModel
    beta: Array
    intervals: Array | None
    covariance: Array | None
    hashes: tuple[str, ...]
    verdict: str
    zero: tuple[int, ...] = ()
    uses: tuple[ResultUse, ...] = ()
    reason: str = ""
    unexcited: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        freeze_fields(self, "beta")

    @property
    def fitness(self) -> list[str]:
        """A sentence for each use, marked as a warning where the model is not fit for it."""
        return [f"WARNING: {use.sentence}" if use.grade == "bad" else use.sentence for use in self.uses]


def provenance(
    identified: ExportSource,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
    quoted: bool = False,
) -> Provenance:
    """The model with its provenance, provided that it meets its validation criterion; without its torque sensors.

    Args:
        identified: the model to export.
        validation, largest_error, anyway: see `ExportCriterion`.
        quoted: the parameters that are quoted, and not the model for use of an identification or a result.

    Raises:
        UnvalidatedModelError: the prediction error exceeds the criterion, or there is a criterion but no validation.
        ShapeError: the number of base parameters is not that of the device.
    """
    source = _identified(identified, validation, largest_error, anyway, quoted)
    return counterpart_source(source, without_sensors(source.model))


def counterpart_source(source: Provenance, model: DynamicModel) -> Provenance:
    """The same with a counterpart of the device (`haptid.dynamics.counterparts`); as it is where it is itself."""
    if model is source.model:
        return source
    T = parameters_on(source.model, model)
    # Intervals are of the parameters that are one of the source's; where one is a sum of several, none are given.
    same = [int(np.flatnonzero(row)[0]) if np.count_nonzero(row) == 1 else None for row in T]
    intervals, covariance = source.intervals, source.covariance
    places = [k for k in same if k is not None]
    return replace(
        source,
        model=model,
        beta=T @ source.beta,
        intervals=None if intervals is None or len(places) < len(same) else intervals[places],
        covariance=None if covariance is None else T @ covariance @ T.T,
        zero=tuple(same.index(k) for k in source.zero if k in same),
        unexcited=tuple(k for k, row in enumerate(T) if row[list(source.unexcited)].any()),
    )


def _identified(
    identified: ExportSource,
    validation: Validation | None,
    largest_error: float | None,
    anyway: bool,
    quoted: bool,
) -> Provenance:
    validations: tuple[Validation, ...] = () if validation is None else (validation,)
    if isinstance(identified, Identification):
        identified = Result.of(identified)
    if isinstance(identified, Result):
        validations = validations or identified.unseen
        largest_error = identified.criteria.relative_error_percent if largest_error is None else largest_error
    verdict = _verdict(validations, largest_error, anyway)
    if isinstance(identified, Result):
        used = dict.fromkeys(log.sha256 for log in identified.logs if log.role == "identify")
        return Provenance(
            identified.model,
            identified.beta if quoted else identified.beta_for_use,
            identified.conf_int() if quoted else identified.conf_int_for_use(),
            identified.unconstrained.covariance,
            tuple(used),
            verdict,
            identified.zero if quoted else identified.zero_for_use,
            tuple(identified.verdict),
            "" if quoted else identified.model_for_use.reason,
            tuple(k for k, p in enumerate(identified.estimate.parameters) if not p.excited) if quoted else (),
        )
    if isinstance(identified, Estimate):
        hashes = dict.fromkeys(motion.log.sha256 for motion in identified.observation.motions if motion.log)
        known = (identified.conf_int(), identified.covariance)
        return Provenance(
            identified.model,
            identified.beta,
            *known,
            tuple(hashes),
            verdict,
            identified.zero,
            unexcited=identified.unexcited if quoted else (),
        )
    model, beta = identified
    expect("beta", np.shape(beta), (len(model.base),))
    return Provenance(model, np.asarray(beta, dtype=float), None, None, (), verdict)


def _verdict(validations: tuple[Validation, ...], limit: float | None, anyway: bool) -> str:
    """The prediction error as a sentence; an error where the criterion is not met."""
    if not validations:
        if limit is not None and not anyway:
            raise UnvalidatedModelError(
                f"the criterion is {limit:.2f} %, but the model was not validated on unseen motion.",
                limit=limit,
                advice="Give a validation or a log with the role validate, or export it anyway (noted in the files).",
            )
        untested = "" if limit is None else f" Its criterion, {limit:.2f} %, was not tested."
        return f"NOT VALIDATED: nothing is known of how it predicts unseen motion.{untested}"
    worst = max(validations, key=lambda found: found.comparable.relative)
    size = worst.comparable.relative
    rows = "rows of its own fit" if worst.seen else "unseen motion"
    error = f"{size:.2f} % of the torque on {rows}"
    if limit is None:
        return f"Error {error}; no criterion was set."
    if size <= limit:
        return f"Error {error}; criterion {limit:.2f} %: met."
    if not anyway:
        raise UnvalidatedModelError(
            f"the prediction error is {size:.2f} % of the unseen torque; the criterion is {limit:.2f} %.",
            found=size,
            limit=limit,
            advice="Identify it again, or export it anyway (noted in the files).",
        )
    return f"VALIDATION FAILED: error {error}; criterion {limit:.2f} %."


def about(source: Provenance) -> list[str]:
    """Heading of every file: device, verdict, hashes of the data."""
    model = source.model
    sentences = [
        f"{model.device.name}: dynamic model, written by haptid {__version__}.",
        *([model.device.description] if model.device.description else []),
        "",
        source.verdict,
        *([source.reason] if source.reason else []),
        *source.fitness,
    ]
    return [
        *(line for sentence in sentences for line in textwrap.wrap(one_line(sentence), _WIDTH) or [""]),
        *(f"Data, SHA-256: {sha}" for sha in source.hashes or ("none: parameters of other origin",)),
    ]


def coordinate_lines(model: DynamicModel) -> list[str]:
    """A line for each coordinate: label, units, limits, and the command of its motor."""
    lines = []
    for k, (row, label) in enumerate(zip(model.device.row_map, model.device.row_labels, strict=True)):
        unit, torque = model.device.coordinate_units[k], model.device.torque_units[k]
        parts = [f"{label}, {unit}, {torque}"]
        moved = [(float(w), model.device.joints[j]) for w, j in zip(row, model.device.active, strict=True) if w]
        if len(moved) == 1 and moved[0][0] == 1.0:
            joint = moved[0][1]
            if joint.position_limits:
                parts.append(f"from {joint.position_limits[0]:.6g} to {joint.position_limits[1]:.6g} {unit}")
            if joint.velocity_limit:
                parts.append(f"at most {joint.velocity_limit:.6g} {unit}/s")
            if joint.torque_limit:
                parts.append(f"at most {joint.torque_limit:.6g} {torque}")
        else:
            parts.append(" ".join(f"{weight:+.6g} joint {joint.name}" for weight, joint in moved))
        drive = model.device.drives[k]
        if model.device.torque_rows == "motor" and drive.motorised:
            parts.append(_command(drive, torque))
        if model.device.free_rows[k]:
            parts.append("no motor: torque zero")
        elif not model.device.measured[k]:
            parts.append("no motor: parameters identifiable only through other rows")
        lines += textwrap.wrap(c_comment(f"q[{k}] {'; '.join(parts)}"), _WIDTH, subsequent_indent="     ")
    return lines


def _command(drive: Motor, torque: str) -> str:
    """Conversion of a torque to the motor's command."""
    factor = drive.gear_ratio * drive.torque_constant
    if factor == 1.0 and drive.command_unit == torque:
        return "command = torque"
    return f"command in {drive.command_unit} = torque / ({factor:.9g} {torque} per {drive.command_unit})"
