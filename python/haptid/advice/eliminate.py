"""An identification with its essential parameters alone: the reduced estimate in the place of the full one."""

from __future__ import annotations

from dataclasses import replace

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.study import Study
from haptid.study.identify import Identification, Run, held_out
from haptid.validation.validation import direct, validate


def with_reduced(found: Identification, reduced: Estimate) -> Identification:
    """The same study and logs, estimated and validated with some parameters left out.

    Rows that are held out of the fit have no part in the reduced values that predict them, nor in constants and loads.
    They had one in the choice of what to leave out; logs with the role "validate" had none.

    Args:
        found: a study walked to its end.
        reduced: of the same rows, `Elimination.reduced`; where nothing was left out, the identification's own.
    """
    if reduced is found.estimate:
        return found
    study = replace(found.study, method=reduced.method)
    fitted = [run for run in found.runs if run.entry.role == "identify"]
    filed = DynamicModel(found.model.device)
    runs = tuple(_run(study, filed, run, fitted, reduced) for run in found.runs)
    return replace(found, study=study, estimate=reduced, runs=runs)


def _run(study: Study, filed: DynamicModel, run: Run, fitted: list[Run], reduced: Estimate) -> Run:
    """A log as the reduced estimate predicts it."""
    if run.entry.role == "validate":
        return replace(run, unseen=(validate(reduced, run.observation),))
    others = [other.observation for other in fitted if other is not run]
    unseen = held_out(study, filed, run.observation, others)
    return replace(run, direct=direct(reduced, run.observation), unseen=unseen)
