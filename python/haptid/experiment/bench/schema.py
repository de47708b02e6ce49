"""The format of experiment files: every key, its unit and its default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Each = Finite | list[Finite]
EachPositive = Positive | list[Positive]
EachNotNegative = NotNegative | list[NotNegative]
Triple = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Series = Annotated[list[Annotated[list[Finite], Field(min_length=1, max_length=100)]], Field(min_length=1)]
Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]

CENTRE = "of the active joints, rad or m; one figure for all or one for each"
RAMP = "duration of the smooth start, and of the stop, s"


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SinesTable(_Table):
    """A sum of sines for each joint, phases drawn from the seed."""

    amplitude: EachPositive = Field(description="greatest distance from the centre, rad or m")
    frequencies_hz: Pair = Field([0.25, 2.4], description="lowest and highest frequency, Hz")
    count: int = Field(4, ge=1, le=100, description="sines a joint")
    speed: EachPositive | None = Field(None, description="greatest speed, which lowers the amplitude where needed")


class MultisineTable(SinesTable):
    """A multisine."""

    kind: Literal["multisine"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    ramp: Positive = Field(1.5, description=RAMP)


class TrianglesTable(_Table):
    """Nearly constant velocity to and fro, corners rounded; with `sines`, a smaller multisine on top."""

    kind: Literal["triangles"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    frequency_hz: EachPositive = Field(description="of the triangle, Hz: the speed is 4 amplitude frequency")
    ramp: Positive = Field(1.5, description=RAMP)
    sines: SinesTable | None = Field(None, description="a multisine on top")


class FourierTable(_Table):
    """A finite Fourier series for each joint."""

    kind: Literal["fourier"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    fundamental_hz: Positive = Field(description="one over the period, Hz")
    sine: Series = Field(description="amplitudes of the first, second, ... harmonic for each active joint, rad or m")
    cosine: Series = Field(description="the same of the cosines")
    ramp: Positive = Field(1.5, description=RAMP)


class SweepTable(_Table):
    """Each joint in turn, to and fro at one constant velocity after the other."""

    kind: Literal["sweep"]
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    speeds: list[Positive] = Field(min_length=1, max_length=100, description="velocities, rad/s or m/s")
    ramp: Positive = Field(0.5, description="duration of every change of velocity, s")


class GridTable(_Table):
    """Poses of a grid, held still one after the other."""

    kind: Literal["grid"]
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    points: int = Field(3, ge=1, le=20, description="positions of each joint")
    dwell: Positive = Field(1.0, description="duration of every pose, s")
    move: Positive = Field(1.0, description="duration of every change of pose, s")


class ControllerTable(_Table):
    """PD or PID on the motors' coordinates, at the joint side."""

    kp: EachNotNegative = Field(description="N m/rad or N/m; one figure for all motors or one for each")
    kd: EachNotNegative = Field(description="N m s/rad or N s/m")
    ki: EachNotNegative = Field(0.0, description="N m/(rad s) or N/(m s)")
    gravity: bool = Field(False, description="feed the torque of the planned poses forward")
    rate_hz: Positive = Field(1000.0, description="control rate, and that of the log, Hz")
    velocity_cutoff_hz: Positive = Field(100.0, description="of the filter on differences of the position, Hz")
    tracking_limit: Positive = Field(0.3, description="greatest distance from the planned position, rad or m")


class EncodersTable(_Table):
    """What positions are read with; without this table they are exact."""

    counts_per_turn: EachPositive = Field(description="of each motor's encoder after quadrature, or per metre")
    gear: EachPositive = Field(1.0, description="turns of the encoder for one of the motor's coordinate")


class AmplifiersTable(_Table):
    """From the torque that is asked for to the one that acts."""

    gain: EachPositive = Field(1.0, description="torque that acts for one that is asked for")
    saturation: EachPositive | None = Field(None, description="greatest torque at the joint side, N m or N")
    noise: EachNotNegative = Field(0.0, description="deviation of the torque that acts, N m or N")
    delay: NotNegative = Field(0.0, description="from reading the encoders to the torque, s")


class PayloadTable(_Table):
    """A point mass at the handle."""

    mass: Positive = Field(description="kg")
    com: Triple = Field([0.0, 0.0, 0.0], description="where, in the handle's frame, m")


class WeightTable(_Table):
    """A point mass that belongs to the device in this mounting: a counterweight, a gimbal, a sensor."""

    link: str = Field(description="the joint whose link carries it")
    mass: Positive = Field(description="kg")
    com: Triple = Field(description="where, in the link frame of the device file's convention, m")


class PushTable(_Table):
    """A force of the hand at the handle."""

    force: Triple = Field(description="in the base frame, N")
    frequency_hz: NotNegative = Field(0.0, description="of a sine, Hz; 0 for a constant force")
    start: NotNegative = Field(0.0, description="when it begins, s")
    stop: Positive | None = Field(None, description="when it ends, s; default: with the motion")


class SensorTable(_Table):
    """A six-axis force sensor at the handle, in its frame."""

    force_noise: NotNegative = Field(0.0, description="deviation of a sample, N")
    moment_noise: NotNegative = Field(0.0, description="deviation of a sample, N m")


class BodyTable(_Table):
    """The true body of a link, in the link frame of the device file's convention."""

    link: str
    mass: Positive = Field(description="kg")
    com: Triple = Field(description="centre of mass, m")
    inertia: Annotated[list[Finite], Field(min_length=6, max_length=6)] = Field(
        description="about the centre of mass, XX YY ZZ XY XZ YZ, kg m^2"
    )


class PhysicsTable(_Table):
    """How the simulator steps."""

    step: Positive = Field(1e-4, description="s")
    tolerance: Positive = Field(1e-10, description="of the solver")
    iterations: int = Field(50, ge=1, le=10000, description="of the solver, at most")


class ExperimentTable(_Table):
    """An experiment file."""

    schema_: Literal[1] = Field(alias="schema", description="version of this format: 1")
    name: str = Field(min_length=1)
    seed: int = Field(0, ge=0, description="of phases and noise; --seed replaces it")
    trajectory: Annotated[
        MultisineTable | TrianglesTable | FourierTable | SweepTable | GridTable, Field(discriminator="kind")
    ] = Field(description="the planned motion")
    controller: ControllerTable
    encoders: EncodersTable | None = None
    amplifiers: AmplifiersTable | None = None
    payload: PayloadTable | None = None
    gravity: Triple | None = Field(None, description="in the base frame, m/s^2; default: the device file's")
    hand: list[PushTable] = Field([], description="forces of the hand, which add")
    sensor: SensorTable | None = None
    physics: PhysicsTable | None = None
    parameters: dict[str, Finite] = Field({}, description="true parameters by name, SI; default: the device's prior")
    bodies: list[BodyTable] = Field([], description="true bodies of links; default: the device's prior")
    weights: list[WeightTable] = Field([], description="point masses added to links")


def experiment_schema() -> dict[str, Any]:
    """JSON Schema of experiment files, for editors."""
    return ExperimentTable.model_json_schema(by_alias=True)
