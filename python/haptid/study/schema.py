"""The tables of a study file, and their JSON Schema."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Role = Literal["identify", "validate"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SignalTable(_Table):
    """Which channels are the positions, or the torques, and in what unit."""

    channels: list[str] = Field(min_length=1, description="one channel for each joint or motor, in the device's order")
    unit: str = Field(description="rad, deg, turn, m, mm, um, counts; N m, mN m, N, V, mV, A, mA, counts")
    side: Literal["joint", "motor"] = Field("joint", description="measured at the joint or at the motor's shaft")
    gain: Finite | list[Finite] = Field(1.0, description="the channel is multiplied by this first")
    offset: Finite | list[Finite] = Field(0.0, description="added after the gain and the unit, SI")
    unwrap: bool = Field(False, description="the angle jumps by a whole turn: put the turns back")
    period: Positive | None = Field(None, description="the jump of a wrapped channel, in its own unit; one turn")
    constant_ok: bool = Field(False, description="a channel that never changes is meant to")
    allow_saturation: bool = Field(False, description="a torque held at its limit is meant to be used")


class ChannelsTable(_Table):
    """Where time, positions and torques are in the log files."""

    time: str | None = Field(None, description="channel of the sample times; or give rate_hz")
    time_unit: str = Field("s", description="s, ms, us or ns")
    rate_hz: Positive | None = Field(None, description="sampling rate, where the log has no times")
    position: SignalTable
    torque: SignalTable


class LoadTable(_Table):
    """A known body that was fixed to a link while the log was recorded; a point mass where `inertia` is left out."""

    link: str = Field(description="name of the link's joint")
    mass: Positive = Field(description="kg")
    com: list[Finite] = Field(min_length=3, max_length=3, description="centre of mass in the file's link frame, m")
    inertia: list[Finite] | None = Field(
        None, min_length=6, max_length=6, description="XX YY ZZ XY XZ YZ about the centre of mass, kg m^2"
    )


class LogTable(_Table):
    """One log and what it is for."""

    path: str = Field(description="relative to --data, or to the study file")
    role: Role = Field("identify", description="identify: the fit sees it; validate: it is only predicted")
    stretch: list[Finite] | None = Field(None, min_length=2, max_length=2, description="only from .. to, s")
    channels: ChannelsTable | None = Field(None, description="where this log's channels differ from the study's")
    load: LoadTable | None = Field(None, description="known load of this recording; its torque is taken off")


class TreatmentTable(_Table):
    """How logs become rows; what is not given is proposed from the logs. See `haptid.Treatment`."""

    cutoff_hz: Positive | Literal["none"] | None = Field(
        None, description="-3 dB of the position filter, Hz, or 'none'"
    )
    order: int | None = Field(None, ge=1, le=12, description="order of one pass of the Butterworth filter; default 4")
    decimation: int | None = Field(None, ge=1, description="one row is kept of so many samples")
    parallel_cutoff_hz: Positive | None = Field(None, description="-3 dB of the filter that torque and W share, Hz")
    parallel_shape: Literal["bell", "sharp", "causal"] | None = Field(
        None, description="of that filter: bell (default), sharp as published recipes have it, or causal"
    )
    parallel_order: int | None = Field(None, ge=1, le=12, description="of the causal filter; default 1")
    accelerations: Literal["differences", "momentum"] | None = Field(
        None, description="differences of the positions (default), or momentum: rows without accelerations"
    )
    velocity_cutoff_hz: Positive | None = Field(
        None, description="velocity by a causal differentiator of the positions, Hz; with accelerations = 'momentum'"
    )
    reversal_speed: Finite | list[Finite] | None = Field(
        None, description="rows slower than this are dropped, rad/s or m/s; 0 for none"
    )
    guard: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        None,
        description="rows this near slow motion are dropped too, s; default: all that the shared filter reaches",
    )
    block: Positive | None = Field(None, description="length of a time block, s; default 1")
    torque_delay_s: Finite | None = Field(
        None, description="the torque that acts is the channel's of so much earlier, s; 0 for none"
    )


class ReferenceTable(_Table):
    """Channels of the planned positions, in the log files."""

    channels: list[str] = Field(min_length=1, description="one channel for each active joint, in the device's order")
    unit: str = Field(description="rad, deg, turn, m, mm, um, counts")
    gain: Finite | list[Finite] = Field(1.0, description="the channel is multiplied by this first")
    offset: Finite | list[Finite] = Field(0.0, description="added after the gain and the unit, SI")


class ControllerTable(_Table):
    """The controller that moved the device while it was logged; one figure for all motors, or one for each."""

    kp: Finite | list[Finite] = Field(description="gain of the position error at the joint side, N m/rad or N/m")
    kd: Finite | list[Finite] = Field(description="gain of the velocity error, N m s/rad or N s/m")
    ki: Finite | list[Finite] = Field(0.0, description="gain of the integral of the position error; 0 for none")
    rate_hz: Positive | None = Field(None, description="control rate, a multiple of the log's; default: the log's")
    velocity_cutoff_hz: Positive | None = Field(
        None, description="of the first-order filter behind the difference of positions; none where left out"
    )
    saturation: Positive | list[Positive] | None = Field(None, description="greatest torque of a motor, N m or N")
    reference: ReferenceTable | None = Field(None, description="planned positions; the treated ones where left out")


class HoldoutTable(_Table):
    """Rows that are predicted by a fit that has not seen them."""

    pattern: Literal["alternate", "each-log"] = Field(
        description="alternate: every other time block; each-log: every log in turn"
    )


class LimitTable(_Table):
    """Between what a base parameter is held."""

    low: Finite | None = Field(None, description="least value, SI")
    high: Finite | None = Field(None, description="largest value, SI")


class EstimateTable(_Table):
    """The estimator."""

    method: Literal[
        "OLS",
        "WLS",
        "SUR",
        "GLS",
        "IRLS",
        "heteroscedastic",
        "TLS",
        "encoder noise",
        "ridge",
        "entropic",
        "IV",
        "DIDIM",
        "CLIE",
        "CLOE",
        "output error",
        "EKF",
        "UKF",
    ] = Field("WLS", description="how rows are weighted, and what is taken off or added; see the page on estimators")
    passes: int | None = Field(
        None, ge=1, description="times the weights are made anew; only of WLS, SUR, GLS, heteroscedastic and ridge"
    )
    loss: Literal["Tukey", "Huber", "Student t"] | None = Field(None, description="IRLS: what wild rows count; Tukey")
    resolution: Positive | list[Positive] | None = Field(
        None, description="encoder noise: step of the position channels, rad or m; the log's smallest"
    )
    share: Positive | None = Field(None, description="ridge: deviation of prior values that have none, as a share; 0.3")
    strength: Positive | None = Field(None, description="ridge, entropic: of the pull; the one that predicts best")
    intervals: Literal["clustered", "jackknife", "textbook", "sandwich", "fixed-b", "bootstrap", "profile"] = Field(
        "clustered", description="how deviations are made; see the page on estimators"
    )
    possible: bool = Field(False, description="hold the estimate to what bodies and passive friction can have")
    limits: dict[str, LimitTable] | None = Field(None, description="hold base parameters between limits, by name")
    relations: dict[str, Finite] | None = Field(None, description="combinations of parameters and their exact values")


class CriteriaTable(_Table):
    """What the result must meet; the exit status of `haptid identify` says whether it does."""

    relative_error_percent: Positive | None = Field(None, description="largest relative error on unseen rows")


class StudyTable(_Table):
    """A study file."""

    schema_: Literal[1] = Field(alias="schema", description="version of this format: 1")
    name: str = Field(min_length=1)
    device: str = Field(description="name of a shipped device, or path of a device file, relative to the study")
    channels: ChannelsTable | None = None
    logs: list[LogTable] = Field(min_length=1)
    treatment: TreatmentTable = TreatmentTable.model_construct()
    holdout: HoldoutTable | None = None
    controller: ControllerTable | None = None
    estimate: EstimateTable = EstimateTable.model_validate({})
    criteria: CriteriaTable = CriteriaTable.model_construct(relative_error_percent=None)


def study_schema() -> dict[str, Any]:
    """JSON Schema of study files, for editors."""
    return StudyTable.model_json_schema(by_alias=True)
