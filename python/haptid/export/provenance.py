"""What a model is, where it comes from, and whether it may be written out."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptid._core import __version__
from haptid._internal.arrays import Array, expect, read_only
from haptid.dynamics.model import DynamicModel
from haptid.errors import FailedValidationError, UnvalidatedError
from haptid.estimation import Estimate
from haptid.results import Result, ResultUse
from haptid.study.identify import Identification
from haptid.validation.validation import Validation

# What can be exported: an identification by a study, the same read back from its result folder, an estimate, or a
# device with base parameters from elsewhere.
IdentifiedModel = Identification | Result | Estimate | tuple[DynamicModel, ArrayLike]
# Widest of the first lines of a file, characters.
WIDTH = 112


@dataclass(frozen=True, eq=False)
class Provenance:
    """A model to write out.

    Attributes:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        intervals: 95 % intervals of them, (p, 2), or None where nothing is known.
        covariance: of them, (p, p), or None where nothing is known.
        hashes: SHA-256 of the logs that it was identified from.
        verdict: on unseen motion, a sentence.
        zero: indices of the base parameters that were left out: code does without them.
        uses: what the model is good for; empty where it was not diagnosed.
    """

    model: DynamicModel
    beta: Array
    intervals: Array | None
    covariance: Array | None
    hashes: tuple[str, ...]
    verdict: str
    zero: tuple[int, ...] = ()
    uses: tuple[ResultUse, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "beta", read_only(self.beta))

    @property
    def fitness(self) -> list[str]:
        """A sentence for each use, with a warning where the model is not fit for it."""
        return [f"WARNING: {said.sentence}" if said.grade == "bad" else said.sentence for said in self.uses]


def provenance(
    identified: IdentifiedModel, validation: Validation | None, largest_error: float | None, anyway: bool
) -> Provenance:
    """The model, if its validation lets it pass.

    Args:
        identified: what to export.
        validation: of an estimate; an identification and a result have their own.
        largest_error: criterion, per cent; an identification has that of its study where this is None.
        anyway: write a model that fails its criterion, and say so.

    Raises:
        FailedValidationError: it misses more of the torque than its criterion allows.
        UnvalidatedError: there is a criterion, and no validation.
        ShapeError: the base parameters are not as many as the device has.
    """
    validations: tuple[Validation, ...] = () if validation is None else (validation,)
    if isinstance(identified, Identification):
        validations = validations or tuple(identified.unseen)
        largest_error = identified.study.largest_error if largest_error is None else largest_error
        identified = identified.estimate
    if isinstance(identified, Result):
        validations = validations or identified.unseen
        largest_error = identified.criteria.relative_error_percent if largest_error is None else largest_error
    verdict = _verdict(validations, largest_error, anyway)
    if isinstance(identified, Result):
        used = dict.fromkeys(log.sha256 for log in identified.logs if log.role == "identify")
        known = (identified.conf_int(), identified.covariance)
        return Provenance(
            identified.model, identified.beta, *known, tuple(used), verdict, identified.zero, tuple(identified.verdict)
        )
    if isinstance(identified, Estimate):
        hashes = dict.fromkeys(motion.log.sha256 for motion in identified.observation.motions if motion.log)
        known = (identified.interval95, identified.covariance)
        return Provenance(identified.model, identified.beta, *known, tuple(hashes), verdict, identified.zero)
    model, beta = identified
    expect("beta", np.shape(beta), (len(model.base),))
    return Provenance(model, np.asarray(beta, dtype=float), None, None, (), verdict)


def _verdict(validations: tuple[Validation, ...], limit: float | None, anyway: bool) -> str:
    """A sentence on how the model predicts, or an error where it may not pass."""
    if not validations:
        if limit is not None and not anyway:
            raise UnvalidatedError(limit)
        asked = "" if limit is None else f" Its criterion, {limit:.2f} %, was not tested."
        return f"NOT VALIDATED: nothing is known of how it predicts unseen motion.{asked}"
    worst = max(validations, key=lambda found: found.relative)
    rows = "rows of its own fit" if worst.seen else "unseen motion"
    error = f"{worst.relative:.2f} % of the torque on {rows}"
    if limit is None:
        return f"Error {error}; no criterion was set."
    if worst.relative <= limit:
        return f"Error {error}; criterion {limit:.2f} %: met."
    if not anyway:
        raise FailedValidationError(worst.relative, limit)
    return f"VALIDATION FAILED: error {error}; criterion {limit:.2f} %."


def about(source: Provenance) -> list[str]:
    """The first lines of every file: the device, the verdict, the data."""
    model = source.model
    said = [
        f"{model.device.name}: dynamic model, written by haptid {__version__}.",
        *([model.device.description] if model.device.description else []),
        "",
        source.verdict,
        *source.fitness,
    ]
    return [
        *(line for sentence in said for line in textwrap.wrap(sentence, WIDTH) or [""]),
        *(f"Data, SHA-256: {sha}" for sha in source.hashes or ("none: parameters from elsewhere",)),
    ]
