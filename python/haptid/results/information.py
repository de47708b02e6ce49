"""What a result says to the design of the next motion: information and noise of its logs."""

from __future__ import annotations

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.errors import ModelMismatchError, ResultFileError, listed
from haptid.estimation.intervals.model_based import Autoregression
from haptid.experiment.excitation import LogInformation
from haptid.experiment.excitation.sequential import standard_errors_of
from haptid.experiment.excitation.treated import TreatedNoise
from haptid.results.result import CLUSTERS, Result
from haptid.results.tables import treatment_of


def log_information(result: Result, model: DynamicModel | None = None) -> LogInformation:
    """Information and noise of the logs of a result, for `next_motions`.

    Classical standard errors have the size of the noise in them; the cluster-robust ones over these are what serial
    correlation and misfit add, and stay the same in the next log.

    Args:
        result: with its file of clusters.
        model: of the device file whose limits the motion is to keep; the result's own where None.

    Raises:
        ResultFileError: the result has no file of clusters, no standard errors or no errors of its fit.
        ModelMismatchError: the device has other base parameters than the result.
    """
    model = model or result.model
    if model.base.names != result.names:
        other = [
            name for name in (*model.base.names, *result.names) if (name in model.base.names) != (name in result.names)
        ]
        raise ModelMismatchError(
            f"the device has other base parameters than the result: they differ in {listed(other) or 'their order'}.",
            found=model.base.names,
            advice="Give the device file that the result was identified with.",
        )
    if result.clusters is None:
        raise _missing(CLUSTERS, "the information of its logs")
    parameters = result.estimate.parameters
    information = result.clusters.information
    plain = standard_errors_of(information)
    classical = np.array([np.nan if p.classical_se is None else p.classical_se for p in parameters])
    robust = np.array([np.nan if p.se is None else p.se for p in parameters])
    estimated = tuple(k for k in range(len(parameters)) if k not in result.zero and np.diag(information)[k] > 0)
    usable = [k for k in estimated if np.isfinite([plain[k], classical[k], robust[k]]).all() and plain[k] > 0]
    if not usable:
        raise _missing("estimate.parameters", "standard errors")
    # Rows of unit noise, also where the method did not weight them.
    size = float(np.median(classical[usable] / plain[usable]))
    factor = np.full(len(parameters), float(np.median(robust[usable] / (size * plain[usable]))))
    factor[usable] = robust[usable] / (size * plain[usable])
    dof = np.array([np.inf if p.dof is None else p.dof for p in parameters])
    seconds = sum(block.stop - block.start for block in result.blocks)
    return LogInformation(
        model,
        result.beta,
        information / size**2,
        factor,
        dof,
        estimated,
        _noise(result, model, seconds),
        seconds,
        _treated(result, model),
    )


def _treated(result: Result, model: DynamicModel) -> TreatedNoise | None:
    """Treatment and serial correlation of the logs; None of results of earlier versions, or where a motor has none."""
    found = {table.motor: table for table in result.residuals}
    names = [name for name, known in zip(model.device.row_names, model.device.measured, strict=True) if known]
    periods = [log.dt for log in result.logs]
    if not periods or any(name not in found or not found[name].variance > 0 for name in names):
        return None
    own = [found[name] for name in names]
    models = [Autoregression((np.array(one.filter),), np.array([one.white_variance])) for one in own]
    return TreatedNoise(treatment_of(result.treatment), periods[0], tuple(models), tuple(one.variance for one in own))


def _noise(result: Result, model: DynamicModel, seconds: float) -> np.ndarray:
    """Residual of the fit at one row a second, (motors,): rms over the root of the rows a second."""
    names = [name for name, known in zip(model.device.row_names, model.device.measured, strict=True) if known]
    squares, rows = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0)
    for fit in result.fit_errors:
        for motor in fit.motors:
            if motor.motor in squares:
                squares[motor.motor] += motor.residual**2
                rows[motor.motor] += motor.rows
    if not all(rows.values()) or seconds <= 0:
        raise _missing("validation", "the errors of the fit for every motor")
    return np.array([np.sqrt(squares[name] / rows[name]) / np.sqrt(rows[name] / seconds) for name in names])


def _missing(file: str, missing: str) -> ResultFileError:
    return ResultFileError(
        f"the result has not {missing}, on which the next motion depends.",
        where=file,
        advice="Identify again by WLS, OLS or a method with intervals, and give the whole folder.",
    )
