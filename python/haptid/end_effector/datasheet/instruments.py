"""What a data sheet needs in addition to the model: control rate, delay, and motors' limits and resolutions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.force_capability import limit_of_joint
from haptid.errors import setting_error, unknown_name


@dataclass(frozen=True)
class DeviceInstruments:
    """Control rate, delay, and figures of the motors by name, in place of those in the device file.

    Attributes:
        rate_hz: control rate.
        delay: from reading positions to the torque, s.
        peak, continuous: greatest torque of a motor's coordinate for a moment and for ever, N m or N.
        torque_step: smallest change of that torque, N m or N.
        encoder_counts: of the encoder on the motor's shaft, per turn (or metre) after quadrature.
        rotor_inertia: at the motor's coordinate, kg m^2 or kg.
    """

    rate_hz: float = 1000.0
    delay: float = 0.0
    peak: Mapping[str, float] = field(default_factory=dict)
    continuous: Mapping[str, float] = field(default_factory=dict)
    torque_step: Mapping[str, float] = field(default_factory=dict)
    encoder_counts: Mapping[str, float] = field(default_factory=dict)
    rotor_inertia: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not positive(self.rate_hz):
            raise setting_error("rate_hz", self.rate_hz, "a finite number above 0")
        if not 0 <= self.delay < float("inf"):
            raise setting_error("delay", self.delay, "a finite number from 0")
        for name in ("peak", "continuous", "torque_step", "encoder_counts", "rotor_inertia"):
            for motor, value in getattr(self, name).items():
                if not positive(value):
                    raise setting_error(f"{name} of motor {motor}", value, "a finite number above 0")

    def of(self, model: DynamicModel, what: str) -> dict[str, float] | None:
        """One of the figures for every motor's coordinate; None where one of them is not known.

        Raises:
            UnknownNameError: a figure of a motor that the device does not have.
        """
        made = self.known(model, what)
        return made if len(made) == len(model.device.motors) else None

    def known(self, model: DynamicModel, what: str) -> dict[str, float]:
        """One of the figures for every motor's coordinate of which it is known.

        Figures of the device file are those of the motor's shaft: gear_ratio times a torque of it acts on the
        coordinate, and gear_ratio squared times its inertia.

        Raises:
            UnknownNameError: a figure of a motor that the device does not have.
        """
        given, names = getattr(self, what), [motor.name for motor in model.device.motors]
        for name in given:
            if name not in names:
                raise unknown_name(f"{what} is given for {name!r}, which is no motor.", name, names)
        key = {"peak": "peak_torque", "continuous": "continuous_torque"}.get(what, what)
        tables = {table.name: table for table in model.device.tables.motors}
        power = {"encoder_counts": 0, "rotor_inertia": 2}.get(what, 1)
        made: dict[str, float] = {}
        for motor in model.device.motors:
            shaft = getattr(tables.get(motor.name), key, None)
            if motor.name in given:
                made[motor.name] = given[motor.name]
            elif shaft is not None:
                made[motor.name] = shaft * abs(motor.gear_ratio) ** power
            elif what == "peak" and (limit := limit_of_joint(model, motor)) is not None:
                made[motor.name] = limit
        return made

    def position_steps(self, model: DynamicModel) -> Array | None:
        """Resolution of each motor's coordinate, (motors,), rad or m; None where an encoder is not known."""
        counts = self.of(model, "encoder_counts")
        if counts is None:
            return None
        motors = model.device.motors
        turns = [1.0 if model.device.joints[motor.first].prismatic else 2 * np.pi for motor in motors]
        return np.array([turn / (counts[m.name] * abs(m.gear_ratio)) for turn, m in zip(turns, motors, strict=True)])
