"""`Result`: the result file of an identification, `result.json`, as one pydantic model that is written and read."""

from __future__ import annotations

import dataclasses
import json
import math
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationError

from haptid._core import __version__
from haptid._internal.arrays import Array, freeze
from haptid._internal.atomic_folder import publishing, verified
from haptid._internal.bounded_files import RESULT_FILE, read_bounded
from haptid._internal.escaping import json_text, write_csv
from haptid.device.toml.reader import checked_tables, device_of
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.model import GivenParameters
from haptid.errors import ResultFileError, ShapeError, listed
from haptid.estimation.intervals.clusters import Clusters
from haptid.inference.misfit import clusters_with_misfit
from haptid.observation.plan import Block
from haptid.results.schema import (
    Criteria,
    ErrorTable,
    GimbalBound,
    ModelForUseTable,
    ObservationTable,
    ResidualTable,
    ResultAdvice,
    ResultCondition,
    ResultEstimate,
    ResultLog,
    ResultParameter,
    ResultTable,
    ResultUse,
)
from haptid.results.tables import (
    RELATIVE_ERROR,
    calibration_sentences,
    calibration_tables,
    constant_tables,
    constraints_table,
    device_file,
    error_tables,
    finite,
    grade_tables,
    interval,
    parameter_tables,
    residual_tables,
    target_tables,
    treatment,
    use_table,
)
from haptid.study.identify import Identification
from haptid.study.method import intervals_name, method_name
from haptid.uncertainty.quantities import Quantities
from haptid.validation.validation import MotorError, Validation

if TYPE_CHECKING:
    from haptid.advice import Advice
    from haptid.inference.diagnosis import Verdict

_SCHEMA: Literal[2] = 2
# Scores of the time blocks, beside the result file.
CLUSTERS = "clusters.npz"


class Result(ResultTable):
    """An identification as its result folder has it, without the logs.

    Made by `Result.of` from an identification or by `Result.load` from a folder. The fields are the keys of
    `result.json`; `model` and the arrays are made from them.
    """

    schema_: Literal[2] = Field(default=_SCHEMA, alias="schema", description="version of this format")
    haptid: str = Field(default=__version__, description="version of the program")
    device: str = Field(default="", description="its name")
    aliases: dict[str, str] = Field(default={}, description="names of joints in the robot description, by the device's")
    study: str = Field(description="its name")
    logs: list[ResultLog]
    treatment: dict[str, Any] = Field(description="every setting by its name in a study")
    treatment_reasons: list[str] = Field(default=[])
    observation: ObservationTable | None = None
    estimate: ResultEstimate
    model_for_use: ModelForUseTable
    residuals: list[ResidualTable] = Field(default=[], description="serial correlation in the fit, motor by motor")
    validation: list[ErrorTable]
    criteria: Criteria
    verdict: list[ResultUse] = Field(default=[])
    advice: ResultAdvice | None = Field(default=None, description="changes that were tried on the data, with proofs")
    notes: list[str]
    device_file: dict[str, Any] = Field(description="the device file, gravity as mounted")
    _model: DynamicModel = PrivateAttr()
    _clusters: Clusters | None = PrivateAttr(default=None)

    @classmethod
    def of(cls, identification: Identification, verdict: Verdict | None = None, advice: Advice | None = None) -> Result:
        """The result of an identification.

        Args:
            identification: a study carried out.
            verdict: of its diagnosis, if there was one; exports of the result then state it.
            advice: changes that were tried on its data, if there were any.
        """
        study, estimate, model = identification.study, identification.estimate, identification.model
        raw, scaled = estimate.observation.condition_without(estimate.zero)
        projection = identification.projection
        result = cls(
            device=model.device.name,
            aliases={joint.name: joint.alias for joint in model.device.joints if joint.alias},
            study=study.name,
            logs=[ResultLog.of(run) for run in identification.runs],
            treatment=finite(treatment(identification.proposal.treatment)),
            treatment_reasons=list(identification.proposal.reasons),
            observation=ObservationTable(
                rows=estimate.observation.rows,
                parameters=len(estimate.model.device.parameters.names),
                rank=len(estimate.base),
                condition=ResultCondition(raw=float(raw), scaled=float(scaled)),
                no_effect=list(estimate.base.no_effect),
                blocks=len(estimate.observation.blocks),
            ),
            estimate=ResultEstimate(
                method=method_name(estimate.method),
                method_description=estimate.method.name,
                status=estimate.status,
                intervals=intervals_name(estimate.intervals),
                intervals_description=interval(estimate),
                parameters=list(parameter_tables(estimate)),
                targets=list(target_tables(estimate)),
                nonlinear_constants=list(constant_tables(projection)),
                gimbal=None if identification.gimbal is None else GimbalBound.of(identification.gimbal),
                calibration=list(calibration_tables(identification.calibration)),
                load_friction_parameters=None if model.load is None else model.load.tolist(),
                constraints=constraints_table(estimate),
                covariance=estimate.covariance.tolist(),
            ),
            model_for_use=use_table(identification),
            residuals=list(residual_tables(estimate)),
            validation=[entry for run in identification.runs for entry in error_tables(run)],
            criteria=Criteria(relative_error_percent=study.largest_error, met=identification.meets_criteria),
            verdict=list(grade_tables(verdict)),
            advice=None if advice is None else ResultAdvice.model_validate(finite(advice.to_dict())),
            notes=[
                *estimate.notes,
                *(estimate.between_logs.sentences if estimate.between_logs else ()),
                RELATIVE_ERROR,
                *(projection.notes if projection else ()),
                *calibration_sentences(identification),
                *(identification.gimbal.sentences if identification.gimbal else ()),
            ],
            device_file=finite(device_file(model)),
        )
        result._model, result._clusters = model, clusters_with_misfit(estimate)
        return result

    @classmethod
    def load(cls, folder: str | Path) -> Result:
        """Read the output folder of `haptid identify` or `haptid eliminate`, or its `result.json`.

        Args:
            folder: the folder, or the file itself.

        Raises:
            ResultFileError: there is no result, it has another schema, a key is missing or wrong, or this haptid finds
                other base parameters for the device than the one that wrote it.
            DeviceError: the device in it cannot be read by this haptid.
        """
        path = Path(folder)
        path = path / "result.json" if path.is_dir() else path
        result = _validated(cls, path, _read(path))
        model = DynamicModel(device_of(*checked_tables(result.device_file, f"{path}, device_file")))
        model = model.at_constants([constant.value for constant in result.estimate.nonlinear_constants])
        if model.has_loads:
            model = _with_load_friction(path, model, result.estimate.load_friction_parameters)
        stored = [p.name for p in result.estimate.parameters]
        if tuple(stored) != model.base.names:
            raise _other_parameters(path, stored, model.base.names, result.haptid)
        size = len(stored)
        if [p.name for p in result.model_for_use.parameters] != stored:
            raise _fault(path, "key `model_for_use.parameters` has other parameters than the estimate", "model_for_use")
        if [len(row) for row in result.estimate.covariance] != [size] * size:
            raise _fault(path, f"key `estimate.covariance` is wrong (not {size} x {size})", "estimate.covariance")
        result._model, result._clusters = model, _clusters_beside(path, size)
        return result

    def save(self, folder: str | Path) -> None:
        """Write `result.json`, `clusters.npz`, `parameters.csv` and `correlation.csv` into a folder, all or none.

        Raises:
            OutputFolderError: the folder cannot be written.
        """
        with publishing(Path(folder)) as scratch:
            self.write_into(scratch)

    def write_into(self, folder: Path) -> None:
        """Write these files into a folder that a caller publishes."""
        if self._clusters is not None:
            self._clusters.save(folder / CLUSTERS)
        (folder / "result.json").write_text(self.to_json(), encoding="utf-8")
        heads = ("name", "value", "se", "ci_low", "ci_high", "relative_se_percent", "classical_se", "unit", "grouping")
        extra = ("unconstrained", "excited", "log_to_log_deviation", "repeat_low", "repeat_high")
        write_csv(folder / "parameters.csv", [(*heads, *extra), *map(_csv_row, self.estimate.parameters)])
        named = zip(self.names, self.unconstrained.correlation, strict=True)
        rows = [[name, *("" if math.isnan(r) else r for r in row)] for name, row in named]
        write_csv(folder / "correlation.csv", [["name", *self.names], *rows])

    def to_dict(self) -> dict[str, Any]:
        """The keys and values of `result.json`."""
        return self.model_dump(mode="json", by_alias=True)

    def to_json(self) -> str:
        """The text of `result.json`."""
        return json_text(self.to_dict())

    @property
    def model(self) -> DynamicModel:
        """The dynamic model, as the device file had it, at the constants that were found."""
        return self._model

    @property
    def clusters(self) -> Clusters | None:
        """Scores of the time blocks, for joint tests; None where the folder does not have their file."""
        return self._clusters

    @property
    def base(self) -> BaseParameters:
        """Names, units and groupings of the parameters."""
        return self.model.base

    @property
    def names(self) -> tuple[str, ...]:
        """Of the base parameters, (p,)."""
        return self.base.names

    @property
    def beta(self) -> Array:
        """Base parameters, (p,), SI."""
        return freeze(np.array([p.value for p in self.estimate.parameters]))

    @property
    def beta_for_use(self) -> Array:
        """Base parameters of the model for use, which predicts and is exported, (p,), SI."""
        return freeze(np.array([p.value for p in self.model_for_use.parameters]))

    @cached_property
    def unconstrained(self) -> Quantities:
        """Base parameters of the unconstrained fit, with covariance and degrees of freedom."""
        parameters = self.estimate.parameters
        values = np.array([p.unconstrained for p in parameters])
        covariance = np.array(self.estimate.covariance, dtype=float).reshape(len(parameters), -1)
        dof = _or([p.dof for p in parameters], np.inf)
        unbounded = tuple(k for k, p in enumerate(parameters) if p.se is None)
        return Quantities(self.base.names, self.base.units, values, covariance, dof, unbounded)

    @property
    def constrained(self) -> bool:
        """Whether constraints move the estimate away from the unconstrained fit."""
        return bool((self.beta != self.unconstrained.values).any())

    def conf_int(self) -> Array:
        """Confidence intervals at `estimate.level`, (p, 2)."""
        return _ends([p.conf_int for p in self.estimate.parameters])

    def conf_int_for_use(self) -> Array:
        """The same, widened to the values of the model for use, (p, 2)."""
        return _ends([p.conf_int for p in self.model_for_use.parameters])

    @property
    def zero(self) -> tuple[int, ...]:
        """Indices of the parameters that were eliminated: zero, without standard error."""
        return tuple(k for k, p in enumerate(self.estimate.parameters) if p.eliminated)

    @property
    def zero_for_use(self) -> tuple[int, ...]:
        """Those that are zero in the model for use too: it has values for what the log does not tell."""
        return tuple(k for k in self.zero if self.model_for_use.parameters[k].value == 0)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The logs of the fit, each as one block."""
        return tuple(Block(log.sha256, log.start, log.stop) for log in self.logs if log.role == "identify")

    @property
    def fit_errors(self) -> tuple[Validation, ...]:
        """Errors on the rows of the fit, log by log."""
        return tuple(_validations(self.validation, self.model, "fit"))

    @property
    def unseen(self) -> tuple[Validation, ...]:
        """Errors on held-out rows, log by log, with those on all rows behind the reference filter."""
        unseen, reference = (list(_validations(self.validation, self.model, rows)) for rows in ("unseen", "reference"))
        if len(reference) != len(unseen):
            return tuple(unseen)
        return tuple(dataclasses.replace(v, reference=w) for v, w in zip(unseen, reference, strict=True))

    @property
    def identified(self) -> GivenParameters:
        """The parameters as `characterise`, `apparent_mass` and the like take them.

        Degrees of freedom of derived quantities are the least of any parameter's: the distribution of information over
        the blocks, from which those of a combination are computed, is not in the folder.
        """
        q = self.unconstrained
        return GivenParameters(self.model, self.beta, q.covariance, float(q.dof.min(initial=np.inf)), q.unbounded)


def result_schema() -> dict[str, Any]:
    """JSON Schema of `result.json`."""
    return Result.model_json_schema(by_alias=True, mode="serialization")


def _clusters_beside(path: Path, size: int) -> Clusters | None:
    """The scores of the blocks in the folder of a result file; None without them.

    Raises:
        ResultFileError: the file cannot be read, or is of another fit.
    """
    clusters_file = path.parent / CLUSTERS
    if not clusters_file.exists():
        return None
    try:
        clusters = Clusters.load(clusters_file)
    except (OSError, ValueError, KeyError, ShapeError, zipfile.BadZipFile) as error:
        raise _fault(clusters_file, f"cannot be read ({error})") from error
    if len(clusters.root) != size:
        raise _fault(clusters_file, f"is of {len(clusters.root)} base parameters, and the result of {size}")
    return clusters


def _validations(errors: Iterable[ErrorTable], model: DynamicModel, rows: str) -> Iterator[Validation]:
    """Errors motor by motor are one validation; each ends with the entry of all motors."""
    labels = dict(zip(model.device.row_names, model.device.row_labels, strict=True))
    free = {name for name, own in zip(model.device.row_names, model.device.free_rows, strict=True) if own}
    motors: list[MotorError] = []
    for e in errors:
        if e.rows != rows:
            continue
        if e.residual is None or e.measured is None or e.count is None or e.unit is None:
            yield Validation(tuple(motors), rows == "fit")
            motors = []
        else:
            label = labels.get(e.motor, e.motor)
            motors.append(MotorError(e.motor, label, e.unit, e.residual, e.measured, e.count, e.motor in free))


def _fault(path: Path, problem: str, key: str | None = None) -> ResultFileError:
    """The error for a file that is no result of this schema."""
    advice = "Give the output folder of `haptid identify`, or identify again."
    return ResultFileError(f"{path}: {problem}.", where=key or str(path), advice=advice)


def _other_parameters(path: Path, stored: Sequence[str], present: Sequence[str], version: str) -> ResultFileError:
    lost = listed([name for name in stored if name not in present]) or "their order"
    return ResultFileError(
        f"{path}: its {len(stored)} base parameters, by haptid {version}, are not the {len(present)} of its device "
        f"here; they differ in {lost}.",
        where="estimate.parameters",
        found=tuple(stored),
        limit=tuple(present),
        advice="Identify again with this haptid.",
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(verified(path, read_bounded(path, RESULT_FILE)))
    except FileNotFoundError:
        raise _fault(path, "there is no such file") from None
    except (OSError, ValueError, RecursionError) as error:  # not readable, not UTF-8, not JSON
        raise _fault(path, f"cannot be read ({error})") from error
    if not isinstance(values, dict):
        raise _fault(path, "is not a result of haptid")
    return values


def _validated(cls: type[Result], path: Path, values: dict[str, Any]) -> Result:
    version = values.get("schema")
    if not {"study", "estimate"} & values.keys():
        raise _fault(path, "is no result of haptid identify")
    if isinstance(version, int) and version != _SCHEMA:
        raise ResultFileError(
            f"{path}: was written by haptid {values.get('haptid', '(unknown version)')} in schema {version}; this "
            f"haptid ({__version__}) reads schema {_SCHEMA}.",
            where="schema",
            found=version,
            limit=_SCHEMA,
            advice=f"Run `haptid identify` again on the study {values.get('study')!r}.",
        )
    try:
        return cls.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"]))
        problem = "is missing" if first["type"] == "missing" else f"is wrong ({first['msg']})"
        raise _fault(path, f"key `{key}` {problem}", key) from error


def _with_load_friction(path: Path, model: DynamicModel, parameters: list[float] | None) -> DynamicModel:
    """With load-dependent friction of the bodies that it was estimated with."""
    key = "estimate.load_friction_parameters"
    if parameters is None:
        raise _fault(path, f"key `{key}` is missing, of which the load-dependent friction is made", key)
    try:
        return model.with_load(parameters)
    except ShapeError as error:
        raise _fault(path, f"key `{key}` is wrong ({error})", key) from error


def _or(values: Sequence[float | None], instead: float) -> Array:
    """Numbers with another one in place of None."""
    return np.array([instead if value is None else value for value in values], dtype=float)


def _ends(intervals: Sequence[tuple[float | None, float | None]]) -> Array:
    """Intervals with infinite ends where they are null, (p, 2)."""
    low, high = (_or([end[k] for end in intervals], sign * np.inf) for k, sign in ((0, -1.0), (1, 1.0)))
    return freeze(np.column_stack([low, high]))


def _csv_row(p: ResultParameter) -> list[object]:
    low, high = p.conf_int
    ends = [-math.inf if low is None else low, math.inf if high is None else high]
    relative = math.inf if p.relative_se_percent is None else p.relative_se_percent
    shown = "" if p.constrained_outside_ci else relative
    se = math.inf if p.se is None else p.se
    between = p.between_logs
    excited = "true" if p.excited else "false"
    last = ["", "", ""] if between is None else [_cell(x) for x in (between.deviation, *between.repeat_conf_int)]
    return [p.name, p.value, se, *ends, shown, p.classical_se, p.unit, p.grouping, p.unconstrained, excited, *last]


def _cell(value: float | None) -> float | str:
    return "" if value is None else value
