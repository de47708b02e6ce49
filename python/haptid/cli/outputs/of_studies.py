"""`haptid check`, `advise`, `eliminate`, `fleet`, `pool`, `payload`, `poses`, `friction` and `response`."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from haptid.cli.outputs.tables import Interval, OutputTable, QuantityOutput
from haptid.results.schema import Number, ResultAdvice


class CheckedLogOutput(OutputTable):
    path: str
    role: str
    summary: str = Field(description="channels, rate, duration; empty where the log cannot be read")
    notes: list[str] = Field(description="what was mended")
    problem: str = Field(description="what has to be changed first; empty where nothing is")
    played: list[str] = Field(description="comparison with the motion of --plan")


class CheckOutput(OutputTable):
    """A study read and not fitted."""

    study: str
    device: str = Field(description="what the device has; empty where its file cannot be read")
    logs: list[CheckedLogOutput]
    treatment: list[str] = Field(description="settings with their reasons")
    steps: list[str] = Field(description="what haptid identify would do")
    problems: list[str] = Field(description="what has to be changed first; exit status 2 where there are any")


class AppliedOutput(OutputTable):
    """What --apply wrote and confirmed."""

    kinds: list[str]
    before: Number = Field(description="error on unseen rows, per cent")
    after: Number


class AdviseOutput(ResultAdvice):
    """Changes of a study and its device that are proven on its own logs, as in result.json."""

    applied: AppliedOutput | None = Field(default=None, description="with --apply, where something was confirmed")


class StepOutput(OutputTable):
    name: str
    relative_se_percent: Number
    F: Number
    p: Number
    error_percent: Number = Field(description="of the model without it")


class RefusedOutput(OutputTable):
    name: str
    p: Number


class EssentialOutput(QuantityOutput):
    change_in_se: Number = Field(description="from the full model, in its standard errors")


class TwoErrorsOutput(OutputTable):
    full: Number
    reduced: Number


class EliminationOutput(OutputTable):
    """Backward elimination to the essential parameters."""

    parameters: int = Field(description="before it")
    reason: str = Field(description="why it stopped")
    eliminated: list[StepOutput]
    refused: RefusedOutput | None = Field(description="the one whose test stopped it")
    essential: list[EssentialOutput]
    error_percent: dict[str, TwoErrorsOutput] = Field(description="of the fit, and unseen where a log validates")


class KnownOutput(OutputTable):
    mass: Number = Field(description="kg; null where it was estimated")
    com: list[float] | None = Field(description="m, in the link's frame")
    inertia: list[list[float]] | None = Field(description="3 x 3, kg m^2")


class NearestFigureOutput(OutputTable):
    name: str
    unit: str
    value: Number


class ConsistentOutput(OutputTable):
    """The nearest rigid body."""

    changed: bool
    residual_increase_percent: Number
    body: list[NearestFigureOutput]


class OnePayloadOutput(OutputTable):
    name: str
    link: str
    known: KnownOutput
    body: list[QuantityOutput] = Field(description="mass, centre of mass, inertia")
    parameters: list[QuantityOutput] = Field(
        description="as estimated: mass, first moments, inertia in the link's frame"
    )
    left_out: list[str] = Field(description="what is not determined")
    consistent: ConsistentOutput | None


class GainsOutput(OutputTable):
    motors: list[QuantityOutput] = Field(description="true gain over that of the device file")
    left_out: list[str]


class PayloadOutput(OutputTable):
    """Payloads and drive gains."""

    device: str
    payloads: list[OnePayloadOutput]
    gains: GainsOutput | None = Field(description="with --gains")
    base_parameters: list[QuantityOutput]
    residual_rms: dict[str, Number] = Field(description="by motor")
    notes: list[str]


class FleetLogOutput(OutputTable):
    device: str
    log: str
    day: float = Field(description="since 1970")
    status: str = Field(description="empty where it failed")
    error_percent: Number = Field(description="relative torque error of its fit")
    problem: str
    parameters: list[QuantityOutput]


class FleetParameterOutput(OutputTable):
    """Mean and drift of one parameter of one device."""

    name: str
    unit: str
    mean: Number
    se: Number
    between_logs: Number = Field(description="standard deviation beyond that of the estimates")
    slope: Number = Field(description="in a day")
    slope_se: Number
    p_holm: Number
    distance: Number = Field(description="from the median of the devices, robust standard deviations")


class FleetDeviceOutput(OutputTable):
    device: str
    logs: int
    parameters: list[FleetParameterOutput]


class FleetOutput(OutputTable):
    """Logs of many devices, each identified by itself."""

    study: str
    dates: str = Field(description="where the days are from")
    treatment: dict[str, Any] = Field(description="of all logs, every setting by its name in a study")
    confidence: float
    logs: list[FleetLogOutput]
    devices: list[FleetDeviceOutput]
    sentences: list[str]


class PooledFileOutput(OutputTable):
    """A file of a data set, and what the work on it took."""

    name: str
    worker: str = Field(description="host and number of the process")
    begin: float = Field(description="s since 1970")
    fetching: float = Field(description="a copy of a remote file, s")
    reading: float = Field(description="to a checked log, s")
    reducing: float = Field(description="filters and R factors, s")
    processor: float = Field(description="processor time of all three, s")
    fetched: int = Field(description="bytes of the file")
    returned: int = Field(description="bytes of its R factors")
    samples: int
    rows: int
    problem: str = Field(description="empty where it has none")


class PoolOutput(OutputTable):
    """All files of a data set identified together."""

    study: str
    treatment: dict[str, Any] = Field(description="of all files, every setting by its name in a study")
    status: str
    parameters: list[QuantityOutput]
    unseen_error_percent: Number = Field(
        description="of alternate blocks, each predicted from the others; null where these are too few"
    )
    seconds: float = Field(description="from the first file to the last")
    files: list[PooledFileOutput]
    sentences: list[str]


class PoseParameterOutput(QuantityOutput):
    grouping: str


class GravityOutput(OutputTable):
    """Whether a motor's holding torque is explained, at poses that were not fitted."""

    motor: str
    unit: str
    verdict: str
    holding_rms: Number
    left_rms: Number
    explained_percent: Number
    friction_rms: Number
    configurations: int
    p: Number


class FrictionAtRestOutput(OutputTable):
    """Range of a motor's dry friction at rest over the configurations; no interval of that in motion."""

    motor: str
    unit: str
    least: Number
    mean: Number
    greatest: Number
    configurations: int


class PosesOutput(OutputTable):
    """Gravity, springs and friction at rest from held poses."""

    device: str
    poses: int
    configurations: int
    parameters: list[PoseParameterOutput] = Field(description="without the constants of dry friction")
    friction_at_rest: list[FrictionAtRestOutput]
    status: str
    left_out: list[str]
    gravity: list[GravityOutput]
    notes: list[str]


class FrictionFitOutput(OutputTable):
    model: str
    values: dict[str, Number]
    conf_int: dict[str, Interval]
    aicc: Number
    p: Number = Field(None, description="that Coulomb and viscous friction is enough; null where it is not tested")
    relative_error_percent: Number


class JointFrictionOutput(OutputTable):
    joint: str
    chosen: str
    models: list[FrictionFitOutput]


class FrictionOutput(OutputTable):
    """Friction models compared, joint by joint."""

    criterion: str
    viscous_and_coulomb_are_enough: bool
    joints: list[JointFrictionOutput]


class ResponseEntryOutput(OutputTable):
    """Position by torque at every frequency."""

    position: str
    torque: str
    unit: str
    real: list[Number]
    imaginary: list[Number]
    radius: list[Number] = Field(description="of the circle that holds the true value at 95 %")


class SpringOutput(OutputTable):
    """Rotor, spring and link that have the frequency response of a motor, the others held; SI at the joint side."""

    motor: str
    problem: str = Field(description="why there is none; empty where there is one, and the other figures with it")
    stiffness: Number = None
    se: Number = None
    dof: Number = None
    conf_int: Interval = Field((None, None), description="95 % confidence interval of the stiffness [low, high]")
    damping: Number = None
    link: Number = Field(None, description="inertia")
    rotor: Number = Field(None, description="inertia")
    link_friction: Number = Field(None, description="viscous")
    rotor_friction: Number = Field(None, description="viscous")
    antiresonance_hz: Number = Field(None, description="of the link on its spring, the motor held")
    misfit: Number = Field(None, description="mean square of the error in standard errors")
    error_percent: Number = Field(None, description="root mean square of the error over the dynamic stiffness")


class ResponseOutput(OutputTable):
    """Frequency response from logs of a motion that repeats."""

    device: str
    period: float
    periods: list[int] = Field(description="of each log")
    f: list[float] = Field(description="frequencies, Hz")
    responses: list[ResponseEntryOutput]
    springs: list[SpringOutput]
