"""Tables of a study file, and their JSON Schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from haptid.errors import StudyFileError
from haptid.log.request import MergeMethod

Role = Literal["identify", "validate"]
Use = Literal["auto", "consistent", "free"]
CrossValidation = Literal["blocks", "leave-one-log-out"]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class SignalTable(_Table):
    """Channels of the positions or torques, and their unit."""

    channels: list[str] | None = Field(
        None, min_length=1, description="one channel for each joint or motor, in the device's order; or give field"
    )
    topic: str | None = Field(None, description="topic of the messages, in an MCAP file or a bag")
    field: str | None = Field(None, description="array of the messages or of the data set, such as position")
    joints: list[str | int] | None = Field(
        None, min_length=1, description="elements of the field by name, or by number from 1, in the device's order"
    )
    unit: str | list[str] = Field(
        description="rad, deg, turn, m, mm, um, counts; N m, mN m, kN m, MN m, N, mN, kN, MN, V, mV, A, mA, counts; "
        "rad/s, deg/s, turn/s, rpm, m/s, mm/s; for all or for each channel"
    )
    side: Literal["joint", "motor"] = Field("joint", description="measured at the joint or at the motor's shaft")
    gain: _Finite | list[_Finite] = Field(1.0, description="factor on the channel, applied first")
    offset: _Finite | list[_Finite] = Field(0.0, description="added after the gain and the unit, SI")
    unwrap: bool = Field(False, description="unwrap an angle that jumps by whole turns")
    period: _Positive | None = Field(None, description="jump of a wrapped channel, in its own unit; default: one turn")
    constant_ok: bool = Field(False, description="permit a channel that is constant")
    allow_saturation: bool = Field(False, description="permit a torque held at its limit")
    sign_bit: Annotated[int, Field(ge=1, le=31)] | None = Field(
        None, description="of words of a drive: the bit of the sign, above the magnitude, such as 10 or 15"
    )
    word_bits: Literal[8, 16, 32] | None = Field(
        None, description="of words of a drive in two's complement that were read without a sign: their width"
    )


class TimeTable(_Table):
    """Stamps of the messages of a topic, in whole nanoseconds."""

    topic: str | None = Field(None, description="whose messages are the rows; default: that of merge.onto")
    stamp: Literal["header", "receive"] = Field(
        "header", description="header: as the sender wrote it; receive: when the recorder received the message"
    )


class MergeTable(_Table):
    """How a signal from another topic comes to the rows."""

    onto: Literal["position", "torque"] = Field("position", description="the signal whose messages are the rows")
    method: MergeMethod = Field("linear", description="between neighbours; hold: the value before; nearest")
    largest_gap: _Positive | None = Field(
        None, description="rows without values this close are left out, s; default: four usual steps"
    )


class ChannelsTable(_Table):
    """Channels of time, positions and torques in the log files."""

    time: str | TimeTable | None = Field(None, description="channel of the sample times; or give rate_hz")
    time_unit: str | None = Field(None, description="s, ms, us or ns; default: s, and ns of messages")
    merge: MergeTable = Field(MergeTable.model_construct(), description="of signals with stamps of their own")
    rate_hz: _Positive | None = Field(None, description="sampling rate, where the log has no times")
    sampling: Literal["auto", "stamps", "regular"] = Field(
        "auto",
        description="irregular stamps: the times of the samples, or jitter of regular ones; auto: by the positions",
    )
    stale: Literal["drop", "keep"] = Field("drop", description="rows that repeat the row before in spite of motion")
    position: SignalTable = Field(description="of the joints or motors")
    torque: SignalTable = Field(
        description="of the motors: torques, currents, a servo's load, or PWM; without them nothing is identified"
    )
    velocity: SignalTable | None = Field(
        None, description="of the positions, in their order; used where they are less noisy than differences"
    )


class PayloadTable(_Table):
    """A payload, fixed to a link during the recording.

    `haptid identify` subtracts its torque: mass and com must be given, and it is a point mass where `inertia` is left
    out. `haptid payload` estimates what is left out.
    """

    link: str = Field(description="name of the link's joint")
    name: str | None = Field(None, description="of the payload; default: the log's. Logs of one payload share it")
    mass: _Positive | None = Field(None, description="kg")
    com: list[_Finite] | None = Field(
        None, min_length=3, max_length=3, description="centre of mass in the file's link frame, m"
    )
    inertia: list[_Finite] | None = Field(
        None, min_length=6, max_length=6, description="XX YY ZZ XY XZ YZ about the centre of mass, kg m^2"
    )


class LogTable(_Table):
    """One log and its role."""

    path: str = Field(description="a file, or the folder of a bag or data set; relative to --data or the study file")
    role: Role = Field("identify", description="identify: used in the fit; validate: only predicted")
    time_range: list[_Finite] | None = Field(None, min_length=2, max_length=2, description="used part, from .. to, s")
    episodes: list[Annotated[int, Field(ge=0)]] | None = Field(
        None, min_length=1, description="of a LeRobot data set, by number; default: all"
    )
    exclude: list[Annotated[list[_Finite], Field(min_length=2, max_length=2)]] | None = Field(
        None, description="parts that are left out, [[from, to], ..], s; nothing is filtered across them"
    )
    channels: ChannelsTable | None = Field(None, description="if they differ from the study's")
    payload: PayloadTable | None = Field(None, description="payload of this recording")


class PosesTable(_Table):
    """The logs hold poses, one after the other: for `haptid poses`, and for `haptid payload` from poses."""

    table: bool = Field(False, description="the logs are tables with one row a pose, without times")
    hold_s: _Positive = Field(0.5, description="least duration of a hold, s")
    settle_s: _NotNegative = Field(0.1, description="left out at both ends of a hold, s")
    still: _Positive | list[_Positive] | None = Field(
        None,
        description="largest range of a position channel in a hold, rad or m; default: three of its smallest steps, or "
        "a thousandth of its span",
    )
    approach: list[str] = Field(
        [],
        description="of a table: channels with the direction in which each coordinate moved last, 1 or -1, 0 where not "
        "known, empty where it has not moved",
    )


class TreatmentTable(_Table):
    """Treatment of the logs; settings that are not given are proposed from the logs. See `haptid.Treatment`."""

    cutoff_hz: _Positive | list[_Positive] | Literal["none"] | None = Field(
        None, description="-3 dB of the position filter, Hz, one for all channels or one for each; or 'none'"
    )
    order: int | None = Field(None, ge=1, le=12, description="order of one pass of the Butterworth filter; default 4")
    decimation: int | None = Field(None, ge=1, description="samples per row")
    parallel_cutoff_hz: _Positive | None = Field(None, description="-3 dB of the parallel filter of torque and W, Hz")
    parallel_shape: Literal["kaiser", "sinc", "causal"] | None = Field(
        None,
        description="of that filter: kaiser (Kaiser window, default), sinc (windowed sinc), or causal",
    )
    parallel_order: int | None = Field(None, ge=1, le=12, description="of the causal filter; default 1")
    formulation: Literal["acceleration", "momentum"] | None = Field(
        None, description="acceleration: by differences of the positions (default); momentum: without accelerations"
    )
    velocity_cutoff_hz: _Positive | None = Field(
        None, description="velocity by a causal differentiator of the positions, Hz; with formulation = 'momentum'"
    )
    reversal_speed: _Finite | list[_Finite] | None = Field(
        None, description="rows below this speed are dropped, rad/s or m/s; 0 for none"
    )
    reversal_guard_s: _NotNegative | None = Field(
        None,
        description="rows this close to slow motion are dropped too, s; default: the length of the parallel filter",
    )
    block_s: _Positive | None = Field(None, description="length of a time block, s; default 1")
    torque_delay_s: _Finite | list[_Finite] | None = Field(
        None, description="by which the acting torque is earlier, s, one for all channels or one for each; 0 for none"
    )


class CalibrationTable(_Table):
    """How well the zeros of the positions and the direction of gravity are known; both are estimated then."""

    home_offset_std: _NotNegative | list[_NotNegative] = Field(
        0.0,
        description="standard deviation of the true position of a joint less the logged one, rad or m: one for all "
        "active joints, or one for each; 0: exact",
    )
    each_log: bool = Field(False, description="offsets are new in each log, as of encoders homed at every start")
    gravity_direction_std: _NotNegative = Field(
        0.0, description="standard deviation of the direction of gravity about each of two level axes, rad; 0: exact"
    )


class ReferenceTable(_Table):
    """Channels of the reference positions, in the log files."""

    channels: list[str] = Field(min_length=1, description="one channel for each active joint, in the device's order")
    unit: str = Field(description="rad, deg, turn, m, mm, um, counts")
    gain: _Finite | list[_Finite] = Field(1.0, description="factor on the channel, applied first")
    offset: _Finite | list[_Finite] = Field(0.0, description="added after the gain and the unit, SI")


class ControllerTable(_Table):
    """The controller that moved the device during the recording; one value for all motors, or one for each."""

    kp: _Finite | list[_Finite] = Field(description="proportional gain at the joint side, N m/rad or N/m")
    kd: _Finite | list[_Finite] = Field(description="derivative gain, N m s/rad or N s/m")
    ki: _Finite | list[_Finite] = Field(0.0, description="integral gain; 0 for none")
    rate_hz: _Positive | None = Field(None, description="control rate, a multiple of the log's; default: the log's")
    velocity_cutoff_hz: _Positive | None = Field(
        None, description="cut-off of the first-order filter of the differentiated positions; default: none"
    )
    saturation: _Positive | list[_Positive] | None = Field(None, description="torque limit of a motor, N m or N")
    reference: ReferenceTable | None = Field(None, description="reference positions; default: the treated ones")


class ValidationTable(_Table):
    """How rows without a log of their own are predicted."""

    cross_validation: CrossValidation | Literal["none"] = Field(
        description="blocks: two folds of every other time block; leave-one-log-out: one fold for each log; none: no "
        "cross-validation. Without this table: none with a log of role validate, else blocks"
    )


class BoundTable(_Table):
    """Bounds of a base parameter."""

    low: _Finite | None = Field(None, description="lower bound, SI")
    high: _Finite | None = Field(None, description="upper bound, SI")


class EstimateTable(_Table):
    """The estimator."""

    method: (
        Literal[
            "ols",
            "wls",
            "sur",
            "torque-noise",
            "gls",
            "irls",
            "heteroscedastic",
            "total-least-squares",
            "errors-in-variables",
            "ridge",
            "entropic",
            "iv",
            "didim",
            "clie",
            "cloe",
            "output-error",
            "motor-side",
            "ekf",
            "ukf",
        ]
        | str
        | None
    ) = Field(
        None,
        description="estimation method, or one of an installed extension; default: wls, or torque-noise where motors "
        "are redundant or on passive joints whose rates vary",
    )
    settings: dict[str, Any] | None = Field(None, description="arguments of a method of an extension")
    passes: int | None = Field(
        None, ge=1, description="iterations of the weights; only of wls, sur, gls, heteroscedastic and ridge"
    )
    loss: Literal["tukey", "huber", "student-t"] | None = Field(None, description="irls: robust loss; default: tukey")
    resolution: _Positive | list[_Positive] | None = Field(
        None,
        description="errors-in-variables: of the position channels, rad or m; default: the log's smallest step",
    )
    share: _Positive | None = Field(
        None, description="ridge: relative standard deviation of prior values that have none; default: 0.3"
    )
    strength: _Positive | None = Field(
        None, description="ridge, entropic: regularisation strength; default: by cross-validation"
    )
    intervals: Literal[
        "cluster-robust",
        "block-jackknife",
        "classical",
        "sandwich",
        "fixed-b",
        "block-bootstrap",
        "profile-likelihood",
        "cr2",
        "cr3",
    ] = Field(
        "cluster-robust",
        description="standard errors; cr2 is cluster-robust, cr3 is block-jackknife; see the page on estimators",
    )
    constraints: Literal["physical"] | None = Field(
        None, description="physical: constrain the estimate to bodies of positive mass and inertia, passive friction"
    )
    use: Use | None = Field(
        None,
        description="model for use: the physically consistent fit, unless another is better on held-out blocks (auto, "
        "default); consistent or free without a comparison; only of methods that weight rows",
    )
    bounds: dict[str, BoundTable] | None = Field(None, description="bounds of base parameters, by name")
    equality_constraints: dict[str, _Finite] | None = Field(
        None, description="combinations of parameters and their exact values"
    )


class CriteriaTable(_Table):
    """Criterion of the result; the exit status of `haptid identify` reports whether it is met."""

    relative_error_percent: _Positive | None = Field(None, description="largest relative error on unseen rows")


class StudyTable(_Table):
    """A study file."""

    schema_: Literal[1] = Field(alias="schema", description="version of this format: 1")
    name: str | None = Field(None, min_length=1, description="of results; default: the file's")
    device: str = Field(description="name of a shipped device, or path of a device file, relative to the study")
    channels: ChannelsTable | None = None
    logs: list[LogTable] = Field(min_length=1)
    treatment: TreatmentTable = TreatmentTable.model_construct()
    calibration: CalibrationTable | None = None
    validation: ValidationTable | None = None
    poses: PosesTable | None = None
    controller: ControllerTable | None = None
    estimate: EstimateTable = EstimateTable.model_validate({})
    criteria: CriteriaTable = CriteriaTable.model_construct(relative_error_percent=None)


def fault(study: Path, key: str, problem: str, found: Any = None, advice: str = "") -> StudyFileError:
    """The error for a key of a study file.

    Args:
        study: the file.
        key: with dots.
        problem: is wrong, without full stop.
        found: the value.
        advice: what to do.
    """
    return StudyFileError(f"{study}, key `{key}`: {problem}.", where=key, found=found, advice=advice)


def study_schema() -> dict[str, Any]:
    """JSON Schema of study files, for editors."""
    return StudyTable.model_json_schema(by_alias=True)
