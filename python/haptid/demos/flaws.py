"""The same identification with the flaws of a real device on the bench, and by how much each figure grows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from haptid._internal.late import dataclass
from haptid.demos.accuracy import accuracy
from haptid.demos.recordings import BenchRecording
from haptid.estimation import Estimate
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.rigid_range import frequency_ranges, rigid_range
from haptid.inference.targets import Targets
from haptid.motion.motion import Motion
from haptid.report.document import DocumentSection, TextTable
from haptid.validation.validation import validate

_WITHOUT = "intervals without the true value, %"


@dataclass(frozen=True, eq=False)
class FlawedDevice:
    """Figures of one identification without and with flaws, by name; the model is the rigid one of the device file.

    Attributes:
        title: of the mounting or branch.
        ideal, flawed: errors, per cent.
        range: up to which frequency the rigid model explains the torque with flaws, a sentence.
    """

    title: str
    ideal: Mapping[str, float]
    flawed: Mapping[str, float]
    range: str

    @property
    def cells(self) -> list[list[str]]:
        """Figure, both values and their ratio; those that are zero without flaws have none."""
        rows = [["figure", "without flaws", "with the flaws of a real device", "times"]]
        for name, before in self.ideal.items():
            after = self.flawed[name]
            if before or after:
                times = after / before if before else 0.0
                rows.append([name, f"{before:.3g}", f"{after:.3g}", f"{times:.{int(times < 10)}f}" if before else ""])
        return rows


def figures(
    found: Targets | Estimate, unseen: Motion, recording: BenchRecording, time_range: tuple[float, float]
) -> dict[str, float]:
    """Errors on unseen motion and against the truth, per cent.

    Args:
        found: targets, or all base parameters.
        unseen: the motion that validates.
        recording: its recording, with the truth.
        time_range: that the exact torques are compared in, s.
    """
    estimate = found.estimate if isinstance(found, Targets) else found
    near = accuracy(found, recording, time_range)
    everywhere = replace(unseen, treatment=replace(unseen.treatment, reversal_speed=0.0))
    return {
        "unseen torque, rows clear of reversals, %": validate(estimate, unseen).relative,
        "unseen torque, all rows, %": validate(estimate, everywhere).relative,
        "exact torque of the rigid device, worst motor, %": float(near.torque.max()),
        "inertial and gravity parameters, worst, %": near.worst("body"),
        "Coulomb friction, worst, %": near.worst("Coulomb"),
        "viscous friction, worst, %": near.worst("viscous"),
        _WITHOUT: 100 * float((~near.inside).mean()),
    }


def range_sentence(estimate: Estimate) -> str:
    """Up to which frequency the rigid model explains the torque of an estimate's own rows."""
    return rigid_range(frequency_ranges(estimate, residuals(estimate))).sentence


def flaws_section(flawed: FlawedDevice) -> DocumentSection:
    """Both columns, and what the diagnosis says."""
    text = (
        f"{flawed.title}: the same bodies, motion, noise and treatment, and cables that stretch between motors and "
        "joints (the encoders are on the motors), eccentric capstans and encoders, Stribeck friction, a drive that "
        "warms up, current loops with a bandwidth and steps, commands with jitter, a softer controller, and a log of "
        "every second control period. The model is the rigid one, without a term for any of it."
        " Parameters are compared "
        "with those of the rigid part.",
        f"The diagnosis of that fit: {flawed.range}",
    )
    return DocumentSection("flaws", "With the flaws of a real device", text, (TextTable("", flawed.cells),))
