"""A motion as samples for the controllers that play it: CSV, ROS 2, C arrays, MATLAB and LeRobot actions.

Time may be scaled: a slow rehearsal passes the same points at a share of the speed, so that it meets the same
obstacles.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files
from haptid._internal.escaping import write_csv
from haptid._internal.late import dataclass
from haptid.errors import SettingError
from haptid.experiment.bench.trajectories import Fourier
from haptid.experiment.excitation.mcap import trajectory_file
from haptid.experiment.excitation.planned import PlannedMotion

# Numbers of text formats that a program reads: relative rounding of 1e-12.
_DIGITS = ".13g"


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """A motion sampled for a controller.

    Attributes:
        name: of the device.
        joints: names of the active joints.
        source_joints: their names in the robot description that they were imported from, else the same.
        prismatic: which joints slide.
        rate_hz: samples per second.
        q, qd, qdd: position, velocity and acceleration, each (n, active), SI.
    """

    name: str
    joints: tuple[str, ...]
    source_joints: tuple[str, ...]
    prismatic: tuple[bool, ...]
    rate_hz: float
    q: Array
    qd: Array
    qdd: Array

    @staticmethod
    def of(found: PlannedMotion, rate_hz: float, speed: float = 1.0) -> MotionSamples:
        """The samples of a motion.

        Args:
            found: the motion.
            rate_hz: samples per second.
            speed: share of the planned speed, above 0 and up to 1.

        Raises:
            SettingError: rate or speed is out of range, or samples are too few for the harmonics.
        """
        for what, value, most in (("rate_hz", rate_hz, np.inf), ("speed", speed, 1.0)):
            if not 0 < value <= most or not np.isfinite(value):
                limit = "" if np.isinf(most) else f", {most:g} at most"
                raise SettingError(f"{what} is {value!r}; write a number above 0{limit}.", where=what, found=value)
        fastest = found.kind.highest_hz if isinstance(found.kind, Fourier) else 0.0
        if rate_hz < 2 * speed * fastest:
            raise SettingError(
                f"{rate_hz:g} samples per second are too few for a motion of up to {speed * fastest:g} Hz; at least "
                f"{2 * speed * fastest:g} are needed.",
                where="rate_hz",
                found=rate_hz,
                limit=2 * speed * fastest,
            )
        made = found.trajectory(speed / rate_hz)
        device = found.model.device
        joints = [device.joints[j] for j in device.active]
        names = tuple(joint.name for joint in joints)
        aliases = tuple(joint.alias or joint.name for joint in joints)
        slides = tuple(joint.prismatic for joint in joints)
        return MotionSamples(device.name, names, aliases, slides, rate_hz, made.q, speed * made.qd, speed**2 * made.qdd)

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return np.asarray(np.arange(len(self.q)) / self.rate_hz)


def write_motion(path: str | Path, samples: MotionSamples) -> Path:
    """Write the samples in the format that the path's ending names; an existing file is replaced in one step.

    `.csv`: t, then q, qd, qdd of each joint, SI. `.yaml`: a ROS 2 `trajectory_msgs/JointTrajectory`. `.mcap`: the same
    as a bag of one message. `.h`: arrays in C (C99 and C++, as CHAI3D needs). `.m`: a MATLAB script that makes
    timeseries. `.json`: a sequence of actions as LeRobot's `send_action` takes, in degrees and m.

    Raises:
        SettingError: no format has this ending.
        OutputFolderError: the file cannot be written.
    """
    target = Path(path)
    write = SAMPLE_FORMATS.get(target.suffix)
    if write is None:
        raise SettingError(
            f"{target}: no format of samples has the ending {target.suffix!r}.",
            where=str(target),
            found=target.suffix,
            limit=tuple(SAMPLE_FORMATS),
            advice=f"Write one of {', '.join(SAMPLE_FORMATS)}.",
        )
    with publishing_files(target) as folder:
        write(folder / target.name, samples)
    return target


def _csv(path: Path, made: MotionSamples) -> None:
    heads = ["t", *(f"{prefix}{name}" for prefix in ("q", "qd", "qdd") for name in made.joints)]
    write_csv(path, [heads, *np.column_stack([made.t, made.q, made.qd, made.qdd]).tolist()])


def _ros(path: Path, made: MotionSamples) -> None:
    def lines() -> Iterator[str]:
        yield f"joint_names: {json.dumps(made.source_joints)}"
        yield "points:"
        for k, row in enumerate(zip(made.q, made.qd, made.qdd, strict=True)):
            nanoseconds = round(1e9 * k / made.rate_hz)
            for mark, name, values in zip("-  ", ("positions", "velocities", "accelerations"), row, strict=True):
                yield f"{mark} {name}: [{literal_row(values)}]"
            yield f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}"

    _write(path, lines())


def _mcap(path: Path, made: MotionSamples) -> None:
    path.write_bytes(trajectory_file(made.source_joints, made.t, made.q, made.qd, made.qdd))


def _c(path: Path, made: MotionSamples) -> None:
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    name = f"motion_{name}" if not name or name[0].isdigit() else name
    upper = name.upper()

    def lines() -> Iterator[str]:
        labels = ", ".join(made.joints)
        yield "/* An exciting motion: position, velocity and acceleration of the active joints, SI."
        yield f"   Joints: {labels}. */"
        yield f"#ifndef {upper}_H"
        yield f"#define {upper}_H"
        yield f"#define {upper}_SAMPLES {len(made.q)}"
        yield f"#define {upper}_JOINTS {len(made.joints)}"
        yield f"#define {upper}_RATE_HZ {made.rate_hz!r}"
        for key in ("q", "qd", "qdd"):
            yield f"static const double {name}_{key}[{upper}_SAMPLES][{upper}_JOINTS] = {{"
            yield from (f"  {{{literal_row(values)}}}," for values in getattr(made, key))
            yield "};"
        yield "#endif"

    _write(path, lines())


def _matlab(path: Path, made: MotionSamples) -> None:
    def lines() -> Iterator[str]:
        text = ", ".join(f"'{joint}'" for joint in made.joints)
        yield "% An exciting motion: timeseries of position, velocity and acceleration of the active joints, SI."
        yield f"joints = {{{text}}};"
        yield f"t = (0:{len(made.q) - 1})' / {made.rate_hz!r};"
        for key in ("q", "qd", "qdd"):
            yield f"{key} = ["
            yield from (literal_row(values).replace(",", "") + ";" for values in getattr(made, key))
            yield "];"
            yield f"{key} = timeseries({key}, t, 'Name', '{key}');"

    _write(path, lines())


def _lerobot(path: Path, made: MotionSamples) -> None:
    units = [1.0 if slides else 180 / np.pi for slides in made.prismatic]
    keys = [f"{joint}.pos" for joint in made.source_joints]
    actions = [dict(zip(keys, row, strict=True)) for row in (made.q * units).tolist()]
    path.write_text(json.dumps({"fps": made.rate_hz, "actions": actions}, indent=0), encoding="utf-8")


def literal_row(values: Array) -> str:
    """Numbers with commas between them, as C and MATLAB read them."""
    return ", ".join(f"{value:{_DIGITS}}" for value in values.tolist())


def _write(path: Path, lines: Iterator[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


SAMPLE_FORMATS: Mapping[str, Callable[[Path, MotionSamples], None]] = {
    ".csv": _csv,
    ".yaml": _ros,
    ".mcap": _mcap,
    ".h": _c,
    ".m": _matlab,
    ".json": _lerobot,
}
