"""Results of payload identification: each payload, the drive gains, the bare device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import index_of
from haptid.inference.payloads.body import FIGURE_UNITS, FIGURES, AttachedBody, ConsistentPayload
from haptid.uncertainty.figures import with_digits
from haptid.uncertainty.quantities import Quantities


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """An identified payload.

    Attributes:
        payload: what was known.
        parameters: the inertial parameters that the logs determine, in the frame of the link (`MX3`, `M3`).
        body: mass, centre of mass and inertia about it, in the link frame of the device file's convention, as far as
            they are determined; standard errors to first order.
        left_out: sentences on what the logs do not determine.
        consistent: the nearest rigid body; None where the logs do not determine the mass.
    """

    payload: AttachedBody
    parameters: Quantities
    body: Quantities
    left_out: tuple[str, ...]
    consistent: ConsistentPayload | None

    @property
    def name(self) -> str:
        return self.payload.name

    @property
    def link(self) -> str:
        return self.payload.link

    def __getitem__(self, name: str) -> float:
        """A figure of the body by name, such as "mass" or "com x"."""
        return float(self.body.values[index_of(name, self.body.names, "figure of the body")])

    def summary(self) -> str:
        """Table of the body, or of the parameters where no mass is determined; then the sentences."""
        shown = self.body if len(self.body) else self.parameters
        lines = [f"Payload {self.name} on link {self.link}:", shown.table()]
        if self.consistent is not None and self.consistent.changed:
            figures = dict(zip(FIGURES, self.consistent.body, strict=True))
            values = ", ".join(f"{name} {figures[name]:.4g}" for name in self.body.names)
            lines.append(
                f"No rigid body has exactly these figures. The nearest: {values} (SI), with a residual larger by "
                f"{self.consistent.worse:.2g} %."
            )
        return "\n".join([*lines, *self.left_out])

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        consistent = self.consistent
        return {
            "name": self.name,
            "link": self.link,
            "known": {
                "mass": self.payload.mass,
                "com": None if self.payload.com is None else self.payload.com.tolist(),
                "inertia": None if self.payload.inertia is None else self.payload.inertia.tolist(),
            },
            "body": self.body.to_json(),
            "parameters": self.parameters.to_json(),
            "left_out": list(self.left_out),
            "consistent": None
            if consistent is None
            else {
                "changed": consistent.changed,
                "residual_increase_percent": consistent.worse,
                "body": [
                    {"name": name, "unit": unit, "value": None if np.isnan(value) else float(value)}
                    for name, unit, value in zip(FIGURES, FIGURE_UNITS, consistent.body, strict=True)
                ],
            },
        }


@dataclass(frozen=True, eq=False)
class DriveGains:
    """True gain of motors over that of the device file.

    Attributes:
        quantities: factors of the motors whose gain the known masses determine, by label.
        left_out: sentences on the other motors.
    """

    quantities: Quantities
    left_out: tuple[str, ...]

    @property
    def values(self) -> Array:
        """True gain over the file's, (gains,)."""
        return self.quantities.values

    def summary(self) -> str:
        """A line for each motor."""
        quantities = self.quantities
        lines = [
            f"{label}: {with_digits(value, se)} of the file's gain, "
            f"95 % interval {with_digits(low, se)} .. {with_digits(high, se)}"
            for label, value, se, (low, high) in zip(
                quantities.names, quantities.values, quantities.se, quantities.conf_int(), strict=True
            )
        ]
        return "\n".join([*lines, *self.left_out])


@dataclass(frozen=True, eq=False)
class PayloadIdentification:
    """Payloads, and drive gains on request, from logs of the bare device and logs with payloads.

    Attributes:
        payloads: one for each, in the order given.
        gains: None where the file's were taken as right.
        base: base parameters of the bare device, as far as the logs determine them, at the gains found; friction is
            that of the bare logs.
        residual: root mean square residual of each motor used, at its file's gain, by label, N m or N.
        notes: sentences for the user.
    """

    model: DynamicModel
    payloads: tuple[PayloadEstimate, ...]
    gains: DriveGains | None
    base: Quantities
    residual: Mapping[str, float]
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> PayloadEstimate:
        return self.payloads[index_of(name, [payload.name for payload in self.payloads], "payload")]

    def summary(self) -> str:
        """All payloads, gains and notes as text."""
        parts = [payload.summary() for payload in self.payloads]
        if self.gains is not None:
            parts.append("Drive gains:\n" + self.gains.summary())
        return "\n\n".join(parts + (["\n".join(self.notes)] if self.notes else []))

    def table(self) -> list[list[str | float]]:
        """Rows of a table: payload or motor, figure, unit, value, standard error, 95 % interval; a header first."""
        rows: list[list[str | float]] = [["of", "name", "unit", "value", "se", "low95", "high95"]]
        groups = [(payload.name, payload.body) for payload in self.payloads] + [
            (payload.name, payload.parameters) for payload in self.payloads
        ]
        groups += [] if self.gains is None else [("gain", self.gains.quantities)]
        for owner, q in groups:
            numbers = zip(q.names, q.units, q.values, q.se, q.conf_int(), strict=True)
            rows += [[owner, name, unit, float(x), float(se), *map(float, ends)] for name, unit, x, se, ends in numbers]
        return rows

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        gains = self.gains
        return {
            "device": self.model.device.name,
            "payloads": [payload.to_json() for payload in self.payloads],
            "gains": None
            if gains is None
            else {"motors": gains.quantities.to_json(), "left_out": list(gains.left_out)},
            "base_parameters": self.base.to_json(),
            "residual_rms": dict(self.residual),
            "notes": list(self.notes),
        }
