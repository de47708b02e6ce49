"""An experiment on the bench, written down as TOML: motion, controller, instruments, and what is true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.toml_tables import read_checked
from haptid.device import INERTIAL
from haptid.device.priors import Body, inertial_parameters, tensor
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentFileError, LinkNameError, ParameterNameError
from haptid.experiment.bench.mjcf import Payload, Physics
from haptid.experiment.bench.schema import ExperimentTable, SinesTable, TrianglesTable
from haptid.experiment.bench.setup import Amplifiers, Controller, Encoders, ForceSensor, Push, Setup
from haptid.experiment.bench.trajectories import (
    SPREAD,
    Fourier,
    Grid,
    Kind,
    Multisine,
    Sweep,
    Triangles,
    TrianglesAndSines,
)

KINDS: Mapping[str, type] = {"multisine": Multisine, "fourier": Fourier, "sweep": Sweep, "grid": Grid}

# Advice of errors about experiment files.
SCHEMA_ADVICE = "`haptid schema experiment` prints every key."


@dataclass(frozen=True, eq=False)
class Experiment:
    """An experiment file, read and checked.

    Attributes:
        name: of the experiment.
        seed: of phases and noise.
        kind: of motion.
        table: the file as it was read.
    """

    name: str
    seed: int
    kind: Kind
    table: ExperimentTable

    def setup(self, model: DynamicModel) -> Setup:
        """What is on the bench.

        Raises:
            LinkNameError, ParameterNameError: a link, or a true parameter, that the device does not have.
            NoHandleError, TimingError: a setting that cannot be met.
        """
        table = self.table
        settings: dict[str, Any] = {}
        for name, kind in (("encoders", Encoders), ("amplifiers", Amplifiers), ("physics", Physics)):
            if (given := getattr(table, name)) is not None:
                settings[name] = kind(**_figures(given.model_dump()))
        if table.payload is not None:
            x, y, z = table.payload.com
            settings["payload"] = Payload(table.payload.mass, (x, y, z))
        if table.sensor is not None:
            settings["sensor"] = ForceSensor(**table.sensor.model_dump())
        pushes = [push.model_dump(exclude_none=True) for push in table.hand]
        settings["hand"] = tuple(Push(**{**push, "force": tuple(push["force"])}) for push in pushes)
        controller = Controller(**_figures(table.controller.model_dump()))
        if table.gravity is not None:
            model = model.with_gravity(table.gravity)
        return Setup(model, true_parameters(model, table), controller, **settings)


def read_experiment(path: str | Path) -> Experiment:
    """Read an experiment file.

    Raises:
        ExperimentFileError: the file cannot be read, or a key in it is missing, unknown or wrong; says which.
    """
    path = Path(path)
    table = read_checked(path, ExperimentTable, ExperimentFileError, "an experiment", SCHEMA_ADVICE)
    _check(path, table)
    return Experiment(table.name, table.seed, _kind(table), table)


def _check(path: Path, table: ExperimentTable) -> None:
    """Raise ExperimentFileError for settings that mean nothing together."""
    given, rate = table.trajectory, table.controller.rate_hz
    sines = given.sines if isinstance(given, TrianglesTable) else given
    if isinstance(sines, SinesTable):
        where = "trajectory.frequencies_hz" if sines is given else "trajectory.sines.frequencies_hz"
        low, high = sines.frequencies_hz
        if low > high:
            raise ExperimentFileError(path, where, f"the lowest, {low:g} Hz, is above the highest, {high:g} Hz")
        if high * (1 + SPREAD) >= rate / 2:
            what = f"{high:g} Hz is more than a control rate of {rate:g} Hz carries, which is below {rate / 2:g} Hz"
            raise ExperimentFileError(path, where, what)
    for k, push in enumerate(table.hand):
        if push.stop is not None and push.stop <= push.start:
            raise ExperimentFileError(path, f"hand.{k}.stop", f"{push.stop:g} s is not after start, {push.start:g} s")


def true_parameters(model: DynamicModel, table: ExperimentTable) -> Array:
    """Free standard parameters, (p,), SI: the device's prior, then the experiment's bodies, parameters and weights.

    Bodies and parameters take the place of what was there, weights are added to it. What none of them says is zero.

    Raises:
        LinkNameError: a link that the device does not have.
        ParameterNameError: a name that the device does not have, or that its symmetries set to zero.
    """
    chi, index = np.nan_to_num(model.device.chi_prior), model.device.parameters.index
    for table_of_body in table.bodies:
        body = Body(table_of_body.mass, np.array(table_of_body.com), tensor(np.array(table_of_body.inertia)))
        for name, value in _body_values(model, "bodies", table_of_body.link, body).items():
            chi[index[name]] = value
    for name, value in table.parameters.items():
        if name not in index:
            raise ParameterNameError(name, index)
        chi[index[name]] = value
    for weight in table.weights:
        point = Body(weight.mass, np.array(weight.com), np.zeros((3, 3)))
        for name, value in _body_values(model, "weights", weight.link, point).items():
            chi[index[name]] += value
    return freeze(chi)


def _body_values(model: DynamicModel, table: str, link: str, body: Body) -> dict[str, float]:
    """The parameters of a link by name, without those that a symmetry sets to zero, as they are.

    Raises:
        LinkNameError: no such link.
        ParameterNameError: the body is not as symmetric as the device file says.
    """
    index = model.device.parameters.index
    if link not in model.device.joint_names:
        raise LinkNameError(table, link, model.device.joint_names)
    joint = model.device.joints[model.device.joint_names.index(link)]
    values = dict(zip((kind + link for kind in INERTIAL), inertial_parameters(body, joint), strict=True))
    for name, value in values.items():
        if name not in index and value != 0:
            raise ParameterNameError(name, index)
    return {name: float(value) for name, value in values.items() if name in index}


def _kind(table: ExperimentTable) -> Kind:
    """The kind of motion that the file asks for."""
    given = table.trajectory
    settings = _figures(given.model_dump(exclude={"kind", "sines"}))
    if not isinstance(given, TrianglesTable):
        made: Kind = KINDS[given.kind](**settings)
        return made
    slow = Triangles(**settings)
    if given.sines is None:
        return slow
    fast = _figures(given.sines.model_dump())
    return TrianglesAndSines(slow, Multisine(given.seconds, (0.0,), ramp=given.ramp, **fast))


# Settings that are one figure, whatever the number of joints.
SINGLE: tuple[str, ...] = (
    "seconds",
    "ramp",
    "dwell",
    "move",
    "rate_hz",
    "velocity_cutoff_hz",
    "tracking_limit",
    "delay",
    "fundamental_hz",
)
SINGLE += ("step", "tolerance")


def _figures(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as the values take them: lists as tuples, and one figure for all as a tuple of one."""

    def figures(name: str, value: Any) -> Any:
        if isinstance(value, list):
            return tuple(tuple(v) if isinstance(v, list) else v for v in value)
        return (value,) if isinstance(value, float) and name not in SINGLE else value

    return {name: figures(name, value) for name, value in given.items()}
