"""An identification reduced to its essential parameters: with the reduced estimate in place of the full one."""

from __future__ import annotations

from dataclasses import replace

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.study.identify import Identification, validated
from haptid.validation.model_for_use import model_for_use


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
    runs = validated(found.runs, study, DynamicModel(found.model.device), reduced)
    return replace(found, study=study, estimate=reduced, use=model_for_use(reduced), runs=runs)
