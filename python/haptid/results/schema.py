"""The tables of `result.json`, schema 2.

Every number with a standard error has the form of `Quantities.to_json`: name, unit, value, se, dof and conf_int, at the
confidence level `estimate.level`. A number that is not finite is null.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from haptid.estimation import BetweenLogs, Parameter
from haptid.inference.gimbal import GimbalEffect
from haptid.observation.known_payload import Payload
from haptid.study import Role
from haptid.study.identify import Run
from haptid.uncertainty.quantities import LEVEL, finite_or_none

# Of a use of the model: fit for it, with care, not fit for it.
Grade = Literal["ok", "doubt", "bad"]
# A number, null where it is not finite.
Number = Annotated[float | None, BeforeValidator(lambda x: finite_or_none(x) if isinstance(x, float) else x)]


class ResultTable(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, defer_build=True)


class _PayloadTable(ResultTable):
    """A known body whose torque was subtracted from a log; inertia about its centre of mass, null of a point mass."""

    link: str
    mass: float = Field(description="kg")
    com: list[float] = Field(description="centre of mass in the link frame, m")
    inertia: list[list[float]] | None = Field(description="3 x 3, kg m^2")

    @classmethod
    def of(cls, payload: Payload) -> _PayloadTable:
        body = payload.body
        inertia = None if body.inertia is None else body.inertia.tolist()
        return cls(link=payload.link, mass=body.mass, com=body.com.tolist(), inertia=inertia)


class ResultMotor(ResultTable):
    """Torque of a redundant motor along a log, at the joint side."""

    name: str
    unit: str
    rms: Number = Field(description="of the measured torque")
    error: Number = Field(description="rms of measured minus predicted torque, by the distribution law")
    preload: Number = Field(description="mean of the measured torque that moves nothing")
    preload_rms: Number = Field(description="root mean square of it")


class ResultLog(ResultTable):
    """A log of a result."""

    path: str = Field(description="as in the study")
    sha256: str = Field(description="of the file")
    role: Role
    start: float = Field(default=0.0, description="time of the first sample used, s of the file")
    samples: int
    dt: float = Field(description="sampling period, s")
    notes: list[str] = Field(default=[], description="what was mended")
    payload: _PayloadTable | None = Field(default=None, description="subtracted from the torque")
    motors: list[ResultMotor] = Field(default=[], description="of redundant motors, by the distribution law")

    @property
    def stop(self) -> float:
        """Time of the last sample used, s of the file."""
        return self.start + (self.samples - 1) * self.dt

    @classmethod
    def of(cls, run: Run) -> ResultLog:
        read, load = run.motion.log, run.entry.payload
        assert read is not None  # a study's motions all come from logs
        return cls(
            path=run.entry.path,
            sha256=read.sha256,
            role=run.entry.role,
            start=float(read.t[0]),
            samples=len(read.t),
            dt=run.motion.dt,
            notes=list(read.notes),
            payload=None if load is None else _PayloadTable.of(load),
            motors=[ResultMotor(**asdict(motor)) for motor in run.motors],
        )


class ResultCondition(ResultTable):
    """Condition number of the stacked regressor."""

    raw: Number
    scaled: Number = Field(description="with columns of unit length")


class ResidualTable(ResultTable):
    """Serial correlation of one motor's residual from row to row of the fit: an autoregressive model."""

    motor: str
    filter: list[float] = Field(description="1, a1, a2, ..: e(t) + a1 e(t-1) + .. is white")
    white_variance: float = Field(description="of that white noise, (N m)^2 or N^2")
    variance: float = Field(description="of the residual, (N m)^2 or N^2")


class ObservationTable(ResultTable):
    """The rows of the fit."""

    rows: int
    parameters: int = Field(description="standard parameters of the device")
    rank: int = Field(description="base parameters")
    condition: ResultCondition
    no_effect: list[str] = Field(description="standard parameters without effect on the torque")
    blocks: int = Field(description="time blocks, the clusters of the standard errors")


class _Quantity(ResultTable):
    """A number with its uncertainty."""

    name: str
    unit: str
    value: float
    se: Number = Field(description="standard error; null where it cannot be estimated")
    dof: Number = Field(default=None, description="degrees of freedom of the interval; null for infinitely many")
    conf_int: tuple[Number, Number] = Field(description="confidence interval [low, high] at estimate.level")


class _Prior(ResultTable):
    """A value known before the identification."""

    value: float
    std: Number = Field(description="standard deviation; null where none is given")


class BetweenLogsTable(ResultTable):
    """Scatter of a parameter between three logs or more; conf_int beside it is of the mean over these logs alone."""

    logs: float = Field(description="effective number of logs that have information on it")
    within_se: Number = Field(description="standard error from time blocks within logs")
    se: Number = Field(description="standard error from logs as clusters; null where too few have information on it")
    dof: Number = Field(description="degrees of freedom of se")
    deviation: Number = Field(description="standard deviation from log to log beyond the noise of blocks")
    p: Number = Field(description="of the hypothesis that logs scatter by the noise of their blocks alone")
    conf_int: tuple[Number, Number] = Field(description="of the mean over days, at estimate.level")
    repeat_conf_int: tuple[Number, Number] = Field(
        description="of the estimate from one more log as informative as these, on another day, at estimate.level"
    )

    @classmethod
    def each(cls, between_logs: BetweenLogs | None, count: int) -> list[BetweenLogsTable | None]:
        """One for each of so many parameters, or None."""
        if between_logs is None:
            return [None] * count
        mean, repeat = between_logs.conf_int(), between_logs.repeat_conf_int()
        return [
            cls(
                logs=float(between_logs.effective[k]),
                within_se=float(between_logs.within.se[k]),
                se=float(between_logs.across.se[k]),
                dof=float(between_logs.across.dof[k]),
                deviation=float(between_logs.deviation[k]),
                p=float(between_logs.p[k]),
                conf_int=(mean[k, 0], mean[k, 1]),
                repeat_conf_int=(repeat[k, 0], repeat[k, 1]),
            )
            for k in range(count)
        ]


class ResultParameter(_Quantity):
    """A base parameter, or a target."""

    unconstrained: float = Field(description="value of the unconstrained fit, to which se belongs")
    classical_se: Number = Field(description="standard error if the residuals were white")
    relative_se_percent: Number = Field(description="100 se / |value|; null where constrained_outside_ci")
    constrained_outside_ci: bool = Field(
        default=False, description="the constraints move it out of the unconstrained interval"
    )
    excited: bool = Field(
        default=True, description="false where the log does not tell it: the value means nothing by itself"
    )
    grouping: str = Field(description="what regroups into it, as a formula")
    eliminated: bool | None = Field(
        default=None, description="set to zero by backward elimination; null without elimination"
    )
    prior: _Prior | None = None
    between_logs: BetweenLogsTable | None = Field(default=None, description="null with fewer than three logs")

    @classmethod
    def of(
        cls, p: Parameter, dof: float, between: BetweenLogsTable | None, eliminated: bool | None = None
    ) -> ResultParameter:
        return cls(
            name=p.name,
            unit=p.unit,
            value=p.value,
            se=p.se,
            dof=float(dof),
            conf_int=p.conf_int(),
            unconstrained=p.free,
            classical_se=p.classical_se,
            relative_se_percent=p.relative_se,
            constrained_outside_ci=p.constrained_outside_ci,
            excited=p.excited,
            grouping=p.grouping,
            eliminated=eliminated,
            prior=None if p.prior is None else _Prior(value=p.prior[0], std=p.prior[1]),
            between_logs=between,
        )


class NonlinearConstant(_Quantity):
    """A constant in which the torque is nonlinear, as found by variable projection; profile likelihood interval."""

    range: tuple[float, float] = Field(description="in which it was searched")


class CalibrationQuantity(_Quantity):
    """A home offset (true position less the logged one) or a rotation of gravity, to which the logs were corrected."""

    prior_std: float = Field(description="standard deviation of its prior, about zero")


class GimbalBound(ResultTable):
    """Largest effect of an unmeasured passive gimbal, beyond that of a point mass at the handle."""

    state: str = Field(description="locked, hanging or free")
    torque_percent: dict[str, Number] = Field(description="by motor: rms bound over rms torque")
    parameters: dict[str, Number] = Field(description="largest change of each base parameter, SI")

    @classmethod
    def of(cls, effect: GimbalEffect) -> GimbalBound:
        return cls(
            state=effect.gimbal.state,
            torque_percent=dict(zip(effect.motors, effect.share.tolist(), strict=True)),
            parameters=dict(zip(effect.names, effect.parameters.tolist(), strict=True)),
        )


class ResultCost(ResultTable):
    """Relative residual of the unconstrained and of the constrained fit, per cent."""

    motor: str
    unconstrained: Number
    constrained: Number


class PhysicalConstraints(ResultTable):
    """Physical consistency: bodies with positive mass and inertia, passive friction."""

    kind: Literal["physical"] = "physical"
    margin: Number
    active: list[str]
    cost_percent: list[ResultCost]
    standard_parameters: dict[str, float]


class BoundConstraints(ResultTable):
    """Bounds on base parameters."""

    kind: Literal["bounds"] = "bounds"
    active: list[str]


class EqualityConstraintsTable(ResultTable):
    """Exact values of combinations of parameters."""

    kind: Literal["equality"] = "equality"
    values: dict[str, float] = Field(description="by expression, SI")


Constraints = Annotated[PhysicalConstraints | BoundConstraints | EqualityConstraintsTable, Field(discriminator="kind")]


class ResultEstimate(ResultTable):
    """The estimate."""

    method: str = Field(description="as in a study: ols, wls, ..")
    method_description: str = Field(default="", description="with its settings and constraints")
    status: str = Field(description="ok, uncertain, noisy_positions or constrained_outside_ci; the notes say why")
    intervals: str = Field(description="as in a study: cluster-robust, ..")
    intervals_description: str = Field(default="", description="how they were made, and where they were cut or widened")
    level: float = Field(default=LEVEL, description="confidence level of every conf_int")
    parameters: list[ResultParameter] = Field(description="base parameters")
    targets: list[ResultParameter] = Field(default=[], description="combinations that the device file names")
    nonlinear_constants: list[NonlinearConstant] = []
    gimbal: GimbalBound | None = Field(default=None, description="null where the device has none")
    calibration: list[CalibrationQuantity] = Field(default=[], description="home offsets and direction of gravity")
    load_friction_parameters: list[float] | None = Field(
        default=None,
        description="parameters of links, then of rotors, of which the load-dependent friction is made, SI",
    )
    constraints: Constraints | None = None
    covariance: list[list[Number]] = Field(description="of the unconstrained base parameters, SI")


class CandidateTable(ResultTable):
    """A fit that was compared for the model for use."""

    name: str = Field(description="consistent, free, ridge or entropic")
    strength: float | None = Field(description="of its prior, the best of those tried")
    error_percent: Number = Field(description="relative error of all motors on held-out blocks")
    excess: Number = Field(description="squared relative error less that of the consistent fit")
    excess_se: Number = Field(description="its standard error over the blocks")


class UseParameter(ResultTable):
    """A base parameter of the model for use, SI."""

    name: str
    value: float
    conf_int: tuple[Number, Number] = Field(description="of the unconstrained fit, widened to the value")


class ModelForUseTable(ResultTable):
    """The fit that predicts, compensates and is exported; parameters are quoted from `estimate`."""

    name: str = Field(description="consistent, free, ridge, entropic, or given: the estimate itself")
    method_description: str
    reason: str = Field(description="why, with the figures")
    parameters: list[UseParameter]
    candidates: list[CandidateTable] = []


class ErrorTable(ResultTable):
    """Prediction error of one motor on one log, or of all its motors together."""

    log: str
    rows: Literal["fit", "unseen", "reference"] = Field(
        description="in the sample of the fit, held out, or held out and in motion, behind the reference filter"
    )
    motor: str = Field(description="name of the motor, or all")
    relative_error_percent: Number = Field(description="null for a motor of which no row is used")
    rmse: Number
    unit: str | None
    residual: Number = Field(description="norm of the residual; null for all")
    measured: Number = Field(description="norm of the measured torque; null for all")
    count: int | None = Field(description="rows")


class Criteria(ResultTable):
    """The study's criterion."""

    relative_error_percent: float | None
    met: bool | None


class ResultEdit(ResultTable):
    """A change of a study or device file."""

    file: Literal["study", "device"]
    operation: str = Field(description="append, set, add, multiply, exchange, exclude or remove")
    path: list[str | int] = Field(description="keys from the top of the file; channels: every table of channels")
    index: int | None = Field(description="entry of a list with one number for each channel")
    value: Any


class ResultAction(ResultTable):
    """A change that was carried out on the data, and its proof."""

    kind: str
    places: list[str]
    change: str
    proof: Literal["unseen error", "consistent fit", "possible bodies", "prior bodies"]
    before: float = Field(description="error on unseen rows, per cent; standard errors; or ratio to the prior bodies")
    after: float
    se: Number = Field(description="paired standard error of before - after; null where the error is not the proof")
    share: float = Field(description="of the weighted squared unseen error that goes away")
    adds: bool = Field(description="part of the best combination")
    blocks: int = Field(description="unseen time blocks on which the errors are stated")
    rivals: list[str] = Field(description="changes whose gain is the same by paired block errors")
    motor: str = Field(description="whose error is stated; empty for that of all")
    sentence: str
    edits: list[ResultEdit]


class ResultMotion(ResultTable):
    """A further motion and the intervals that are predicted with it."""

    stroke: float = Field(description="over that of the log")
    speed: float = Field(description="over that of the log")
    seconds: float
    same_motion_seconds: Number = Field(description="of the log's own motion; null where it would take too long")
    torque: float = Field(description="largest torque over that of the log")
    parameters: list[str]
    before_percent: list[float] = Field(description="half width of the 95 % interval over the value")
    after_percent: list[float]
    sentence: str


class ResultAdvice(ResultTable):
    """What to change, by proven gain."""

    tried: int = Field(description="number of changes that were tried")
    unseen_error_percent: float
    combined_error_percent: float = Field(description="with the best combination")
    actions: list[ResultAction]
    undetermined: list[str] = Field(description="what cannot be determined from the log")
    more_motion: ResultMotion | None = Field(description="further motion that would make wide intervals narrow")


class ResultUse(ResultTable):
    """What the diagnosis says of one use of the model."""

    use: str = Field(description="predicting, compensation or quoting")
    grade: Grade
    sentence: str
