"""Experiment files of the bench (TOML): planned motion, controller, instruments and true parameters.

The pydantic tables are the format, with the unit and the default of every key; `Experiment` is a checked file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid._internal.toml_tables import read_checked
from haptid.device import INERTIAL
from haptid.device.priors import PriorBody, inertial_parameters, tensor
from haptid.device.toml.reader import device_of
from haptid.device.toml.terms import AnyTerm
from haptid.dynamics.counterparts import without_sensors
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentFileError, unknown_name
from haptid.experiment.bench.mjcf import Physics, SimulatedPayload
from haptid.experiment.bench.setup import (
    Amplifiers,
    Controller,
    Encoders,
    ForceSensor,
    Push,
    Setup,
    TorqueSensors,
)
from haptid.experiment.bench.trajectories import (
    SPREAD,
    Fourier,
    Grid,
    HeldPoses,
    Multisine,
    Sweep,
    TrajectoryKind,
    Triangles,
    TrianglesAndSines,
)

_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Each = _Finite | list[_Finite]
EachPositive = _Positive | list[_Positive]
EachNotNegative = NotNegative | list[NotNegative]
_Triple = Annotated[list[_Finite], Field(min_length=3, max_length=3)]
_Pair = Annotated[list[_Positive], Field(min_length=2, max_length=2)]
_Series = Annotated[list[Annotated[list[_Finite], Field(min_length=1, max_length=100)]], Field(min_length=1)]
Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]

CENTRE = "of the active joints, rad or m; one value for all or one for each"
RAMP = "duration of the smooth start, and of the stop, s"


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class SinesTable(_Table):
    """A multisine for each joint, phases drawn from the seed."""

    amplitude: EachPositive = Field(description="maximum distance from the centre, rad or m")
    frequencies_hz: _Pair = Field([0.25, 2.4], description="lowest and highest frequency, Hz")
    count: int = Field(4, ge=1, le=100, description="number of sines per joint")
    speed: EachPositive | None = Field(None, description="maximum speed; lowers the amplitude where needed")


class MultisineTable(SinesTable):
    """A multisine."""

    kind: Literal["multisine"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    ramp: _Positive = Field(1.5, description=RAMP)
    period: _Positive | None = Field(
        None, description="s; frequencies are multiples of one over it, so that the motion repeats"
    )


class TrianglesTable(_Table):
    """Triangular motion with rounded corners (nearly constant velocity); with `sines`, plus a smaller multisine."""

    kind: Literal["triangles"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    frequency_hz: EachPositive = Field(description="of the triangle, Hz: the speed is 4 amplitude frequency")
    ramp: _Positive = Field(1.5, description=RAMP)
    sines: SinesTable | None = Field(None, description="a multisine added to it")


class FourierTable(_Table):
    """A finite Fourier series for each joint."""

    kind: Literal["fourier"]
    seconds: Seconds = Field(description="duration, s")
    centre: Each = Field(description=CENTRE)
    fundamental_hz: _Positive = Field(description="one over the period, Hz")
    sine: _Series = Field(description="amplitudes of the first, second, ... harmonic for each active joint, rad or m")
    cosine: _Series = Field(description="the same for the cosines")
    ramp: _Positive = Field(1.5, description=RAMP)
    start: Each | None = Field(None, description="pose of rest before the motion and after it; default: the centre")


class SweepTable(_Table):
    """Constant-velocity strokes in both directions, joint after joint, speed after speed."""

    kind: Literal["sweep"]
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    speeds: list[_Positive] = Field(min_length=1, max_length=100, description="velocities, rad/s or m/s")
    ramp: _Positive = Field(0.5, description="duration of every change of velocity, s")


class GridTable(_Table):
    """Static poses on a grid, one after the other."""

    kind: Literal["grid"]
    centre: Each = Field(description=CENTRE)
    amplitude: EachPositive = Field(description="rad or m")
    points: int = Field(3, ge=1, le=20, description="positions of each joint")
    dwell: _Positive = Field(1.0, description="duration of every pose, s")
    move: _Positive = Field(1.0, description="duration of every change of pose, s")
    approach: EachPositive | None = Field(
        None, description="reach every pose twice, from so far below in all joints and from so far above, rad or m"
    )


class HeldPosesTable(_Table):
    """Held poses, one after the other."""

    kind: Literal["poses"]
    poses: list[Annotated[list[_Finite], Field(min_length=1)]] = Field(
        min_length=2, description="of the active joints, rad or m; the first and the last are not held"
    )
    speed: EachPositive = Field(description="largest on the way between poses, rad/s or m/s")
    acceleration: EachPositive | None = Field(None, description="the same, rad/s^2 or m/s^2")
    dwell: _Positive = Field(1.0, description="duration of every pose, s")
    approach: EachPositive | None = Field(
        None, description="reach every pose twice, from so far below in all joints and from so far above, rad or m"
    )


class _ControllerTable(_Table):
    """PD or PID controller on the motor coordinates, at the joint side."""

    kp: EachNotNegative = Field(description="N m/rad or N/m; one value for all motors or one for each")
    kd: EachNotNegative = Field(description="N m s/rad or N s/m")
    ki: EachNotNegative = Field(0.0, description="N m/(rad s) or N/(m s)")
    gravity: bool = Field(False, description="gravity feedforward along the planned motion")
    dynamics: bool = Field(False, description="feedforward of the whole torque of the planned motion")
    rate_hz: _Positive = Field(1000.0, description="control rate, Hz")
    log_every: int = Field(1, ge=1, le=1000, description="control periods of one row of the log")
    velocity_cutoff_hz: _Positive = Field(100.0, description="of the low-pass on the position differences, Hz")
    tracking_limit: _Positive = Field(0.3, description="maximum tracking error before the run is stopped, rad or m")


class EncodersTable(_Table):
    """Position encoders; without this table positions are exact."""

    counts_per_turn: EachPositive = Field(description="of each motor's encoder after quadrature, or per metre")
    gear: EachPositive = Field(1.0, description="encoder turns per turn of the motor coordinate")
    eccentricity: EachNotNegative = Field(
        0.0, description="amplitude of an error that repeats with every turn of the encoder, rad or m"
    )
    slip: _Finite | list[_Finite] = Field(0.0, description="of each motor's cable over its capstan, rad or m")
    slip_at: NotNegative = Field(0.0, description="when, s")


class AmplifiersTable(_Table):
    """Amplifiers: actual torque from commanded torque."""

    gain: EachPositive = Field(1.0, description="actual torque per commanded torque")
    saturation: EachPositive | None = Field(None, description="maximum torque at the joint side, N m or N")
    noise: EachNotNegative = Field(0.0, description="standard deviation of the actual torque, N m or N")
    delay: NotNegative = Field(0.0, description="from reading the encoders to the torque, s")
    jitter: NotNegative = Field(0.0, description="longest further delay, uniform, new in every control period, s")
    step: EachNotNegative = Field(0.0, description="resolution of the commanded torque, N m or N; 0 for none")
    bandwidth_hz: _Positive | None = Field(None, description="of the first-order lag from command to torque, Hz")


class _PayloadTable(_Table):
    """Point mass at the handle."""

    mass: _Positive = Field(description="kg")
    com: _Triple = Field([0.0, 0.0, 0.0], description="position in the handle frame, m")


class WeightTable(_Table):
    """Point mass added to a link in this configuration: a counterweight, a gimbal, a sensor."""

    link: str = Field(description="the joint whose link carries it")
    mass: _Positive = Field(description="kg")
    com: _Triple = Field(description="position in the link frame of the device file's convention, m")


class PushTable(_Table):
    """Hand force at the handle."""

    force: _Triple = Field(description="in the base frame, N")
    frequency_hz: NotNegative = Field(0.0, description="of a sine, Hz; 0 for a constant force")
    start: NotNegative = Field(0.0, description="start time, s")
    stop: _Positive | None = Field(None, description="end time, s; default: the end of the motion")


class SensorTable(_Table):
    """Six-axis force/torque sensor at the handle, in the handle frame."""

    force_noise: NotNegative = Field(0.0, description="standard deviation of a sample, N")
    moment_noise: NotNegative = Field(0.0, description="standard deviation of a sample, N m")


class TorqueSensorsTable(_Table):
    """Torque sensors behind the springs of elastic motors, one value for all or one for each."""

    noise: EachNotNegative = Field(0.0, description="standard deviation of a sample, N m or N")
    offset: float | list[float] = Field(0.0, description="their zeros, N m or N")


class BodyTable(_Table):
    """True rigid body of a link, in the link frame of the device file's convention."""

    link: str
    mass: _Positive = Field(description="kg")
    com: _Triple = Field(description="centre of mass, m")
    inertia: Annotated[list[_Finite], Field(min_length=6, max_length=6)] = Field(
        description="about the centre of mass, XX YY ZZ XY XZ YZ, kg m^2"
    )


class PhysicsTable(_Table):
    """Settings of the simulator."""

    step: _Positive = Field(1e-4, description="integration step, s")
    tolerance: _Positive = Field(1e-10, description="of the constraint solver")
    iterations: int = Field(50, ge=1, le=10000, description="maximum iterations of the constraint solver")


class ExperimentTable(_Table):
    """An experiment file."""

    schema_: Literal[1] = Field(alias="schema", description="version of this format: 1")
    name: str = Field(min_length=1)
    seed: int = Field(0, ge=0, description="of phases and noise; --seed replaces it")
    trajectory: Annotated[
        MultisineTable | TrianglesTable | FourierTable | SweepTable | GridTable | HeldPosesTable,
        Field(discriminator="kind"),
    ] = Field(description="the planned motion")
    controller: _ControllerTable
    encoders: EncodersTable | None = None
    amplifiers: AmplifiersTable | None = None
    payload: _PayloadTable | None = None
    gravity: _Triple | None = Field(None, description="in the base frame, m/s^2; default: the device file's")
    hand: list[PushTable] = Field([], description="hand forces; they add up")
    sensor: SensorTable | None = None
    torque_sensors: TorqueSensorsTable | None = None
    physics: PhysicsTable | None = None
    parameters: dict[str, _Finite] = Field({}, description="true parameters by name, SI; default: the device's prior")
    bodies: list[BodyTable] = Field([], description="true bodies of links; default: the device's prior")
    weights: list[WeightTable] = Field([], description="point masses added to links")
    terms: list[AnyTerm] = Field(
        [], description="terms that the simulated device has and its file lacks, as [[terms]] of a device file"
    )


def experiment_schema() -> dict[str, Any]:
    """JSON Schema of experiment files, for editors."""
    return ExperimentTable.model_json_schema(by_alias=True)


# Kinds of motion by the names that files have; triangles have a table of their own.
KINDS: Mapping[str, type] = {
    "multisine": Multisine,
    "fourier": Fourier,
    "sweep": Sweep,
    "grid": Grid,
    "poses": HeldPoses,
}

# Advice of errors about experiment files.
SCHEMA_ADVICE = "`haptid schema experiment` prints every key."


@dataclass(frozen=True, eq=False)
class Experiment:
    """A checked experiment file.

    Attributes:
        name: of the experiment.
        seed: of phases and noise.
        kind: of motion.
        table: the validated tables of the file.
    """

    name: str
    seed: int
    kind: TrajectoryKind
    table: ExperimentTable

    def setup(self, model: DynamicModel) -> Setup:
        """The simulated set-up of a device with these instruments, true parameters and further terms.

        Raises:
            DeviceFileError: a term that the device cannot have.
            UnknownNameError: a link, or a true parameter, that the device does not have.
            IncompleteDeviceError, ExperimentError: a setting that cannot be met.
        """
        table = self.table
        if table.terms:
            tables = model.device.tables
            model = DynamicModel(
                device_of(tables.model_copy(update={"terms": [*tables.terms, *table.terms]}), model.device.name)
            )
        settings: dict[str, Any] = {}
        if sensed := [drive.name for drive in model.device.elastic if drive.sensed is not None]:
            given = (table.torque_sensors or TorqueSensorsTable.model_validate({})).model_dump()
            settings["torque_sensors"] = TorqueSensors(tuple(sensed), **_tuples(given))
        model = without_sensors(model)
        for name, kind in (("encoders", Encoders), ("amplifiers", Amplifiers), ("physics", Physics)):
            if (given := getattr(table, name)) is not None:
                settings[name] = kind(**_tuples(given.model_dump()))
        if table.payload is not None:
            x, y, z = table.payload.com
            settings["payload"] = SimulatedPayload(table.payload.mass, (x, y, z))
        if table.sensor is not None:
            settings["sensor"] = ForceSensor(**table.sensor.model_dump())
        pushes = [push.model_dump(exclude_none=True) for push in table.hand]
        settings["hand"] = tuple(Push(**{**push, "force": tuple(push["force"])}) for push in pushes)
        controller = Controller(**_tuples(table.controller.model_dump()))
        if table.gravity is not None:
            model = model.with_gravity(table.gravity)
        return Setup(model, true_parameters(model, table), controller, **settings)


def read_experiment(path: str | Path) -> Experiment:
    """Read an experiment file.

    Raises:
        ExperimentFileError: the file cannot be read, or a key is missing, unknown or invalid.
    """
    path = Path(path)
    table = read_checked(path, ExperimentTable, ExperimentFileError, "an experiment", SCHEMA_ADVICE)
    _check(path, table)
    return Experiment(table.name, table.seed, _kind(table), table)


def _check(path: Path, table: ExperimentTable) -> None:
    """Raise ExperimentFileError for settings that contradict each other."""
    given, rate = table.trajectory, table.controller.rate_hz
    sines = given.sines if isinstance(given, TrianglesTable) else given
    if isinstance(sines, SinesTable):
        where = "trajectory.frequencies_hz" if sines is given else "trajectory.sines.frequencies_hz"
        low, high = sines.frequencies_hz
        if low > high:
            raise _experiment_file(path, where, f"the lowest, {low:g} Hz, is above the highest, {high:g} Hz")
        if high * (1 + SPREAD) >= rate / 2:
            what = f"{high:g} Hz is not below the Nyquist frequency {rate / 2:g} Hz of the control rate {rate:g} Hz"
            raise _experiment_file(path, where, what)
    for k, push in enumerate(table.hand):
        if push.stop is not None and push.stop <= push.start:
            raise _experiment_file(path, f"hand.{k}.stop", f"{push.stop:g} s is not after start, {push.start:g} s")


def true_parameters(model: DynamicModel, table: ExperimentTable) -> Array:
    """True free standard parameters, (p,), SI: the device's prior, then the file's bodies, parameters and weights.

    Bodies and parameters replace values, weights are added to them. Parameters given nowhere are zero.

    Raises:
        UnknownNameError: a link or parameter that the device does not have, or that its symmetries set to zero.
    """
    chi, index = np.nan_to_num(model.device.chi_prior), model.device.parameters.index
    sign = model.device.parameters.sign
    for table_of_body in table.bodies:
        body = PriorBody(table_of_body.mass, np.array(table_of_body.com), tensor(np.array(table_of_body.inertia)))
        for name, value in _body_values(model, "bodies", table_of_body.link, body).items():
            chi[index[name]] = sign[name] * value
    for name, value in table.parameters.items():
        if name not in index:
            raise unknown_name(f"the device has no free parameter {name!r}.", name, index)
        chi[index[name]] = sign[name] * value
    for weight in table.weights:
        point = PriorBody(weight.mass, np.array(weight.com), np.zeros((3, 3)))
        for name, value in _body_values(model, "weights", weight.link, point).items():
            chi[index[name]] += sign[name] * value
    return freeze(chi)


def _body_values(model: DynamicModel, table: str, link: str, body: PriorBody) -> dict[str, float]:
    """Inertial parameters of a link by name, without those that a symmetry sets to zero.

    Raises:
        UnknownNameError: no such link, or the body does not have the symmetry of the device file.
    """
    index = model.device.parameters.index
    if link not in model.device.joint_names:
        fixed = " The base is fixed: leave out what is attached to it." if link == "base" else ""
        raise unknown_name(f"[[{table}]]: the device has no link {link!r}.{fixed}", link, model.device.joint_names)
    joint = model.device.joints[model.device.joint_names.index(link)]
    values = dict(zip((kind + link for kind in INERTIAL), inertial_parameters(body, joint), strict=True))
    for name, value in values.items():
        if name not in index and value != 0:
            raise unknown_name(f"the device has no free parameter {name!r}.", name, index)
    return {name: float(value) for name, value in values.items() if name in index}


def _kind(table: ExperimentTable) -> TrajectoryKind:
    """The kind of motion of the file, with its settings."""
    given = table.trajectory
    settings = _tuples(given.model_dump(exclude={"kind", "sines"}))
    if not isinstance(given, TrianglesTable):
        made: TrajectoryKind = KINDS[given.kind](**settings)
        return made
    slow = Triangles(**settings)
    if given.sines is None:
        return slow
    fast = _tuples(given.sines.model_dump())
    return TrianglesAndSines(slow, Multisine(given.seconds, (0.0,), ramp=given.ramp, **fast))


# Scalar settings: one number, whatever the number of joints.
SCALARS: tuple[str, ...] = (
    "slip_at",
    "seconds",
    "ramp",
    "dwell",
    "move",
    "rate_hz",
    "velocity_cutoff_hz",
    "tracking_limit",
    "delay",
    "jitter",
    "bandwidth_hz",
)
SCALARS += ("fundamental_hz", "period", "step", "tolerance")


def _tuples(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with tuples in place of lists, and a tuple of one where one value stands for all joints."""

    def converted(name: str, value: Any) -> Any:
        if isinstance(value, list):
            return tuple(tuple(v) if isinstance(v, list) else v for v in value)
        return (value,) if isinstance(value, float) and name not in SCALARS else value

    return {name: converted(name, value) for name, value in given.items()}


def _experiment_file(path: object, where: str, what: str) -> ExperimentFileError:
    return ExperimentFileError(
        f"{path}, key `{where}`: {what}.", where=where, advice="`haptid schema experiment` prints every key."
    )
