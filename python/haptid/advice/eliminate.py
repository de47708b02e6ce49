"""An identification reduced to its essential parameters: with the reduced estimate in place of the full one."""

from __future__ import annotations

from dataclasses import replace

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.study import Study
from haptid.study.identify import Identification, Run, held_out
from haptid.validation.model_for_use import model_for_use
from haptid.validation.validation import fit_errors, validate


def with_reduced(found: Identification, reduced: Estimate) -> Identification:
    """The same study and logs, estimated and validated with some parameters eliminated.

    In cross-validation, the reduced values, nonlinear constants and load-dependent friction of each fold are estimated
    without the rows they predict. The choice of the eliminated parameters used these rows; it did not use logs with the
    role "validate".

    Args:
        found: a study carried out.
        reduced: of the same rows, `Elimination.reduced`; where nothing was eliminated, the identification's own.
    """
    if reduced is found.estimate:
        return found
    study = replace(found.study, method=reduced.method)
    fitted = [run for run in found.runs if run.entry.role == "identify"]
    filed = DynamicModel(found.model.device)
    runs = tuple(_run(study, filed, run, fitted, reduced) for run in found.runs)
    return replace(found, study=study, estimate=reduced, use=model_for_use(reduced), runs=runs)


def _run(study: Study, filed: DynamicModel, run: Run, fitted: list[Run], reduced: Estimate) -> Run:
    """A log with the validations of the reduced estimate."""
    if run.entry.role == "validate":
        return replace(run, unseen=(validate(reduced, run.observation, run.reference),))
    others = [other.observation for other in fitted if other is not run]
    unseen = held_out(study, filed, run.observation, others, run.reference)
    return replace(run, fit_errors=fit_errors(reduced, run.observation), unseen=unseen)
