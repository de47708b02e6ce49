"""Motions as one C99 file that plays them in a user's control loop, with soft start, limits, watchdog and recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files
from haptid._internal.late import dataclass
from haptid.errors import SettingError
from haptid.experiment.excitation.samples import MotionSamples, literal_row


@dataclass(frozen=True)
class PlayerSettings:
    """Settings of the player: limits of tracking, motion and timing, soft start, and the buffer of records.

    Attributes:
        tracking: largest distance of a joint from its reference, rad or m.
        excess: of measured positions and speeds over those of the motions, relative to their range and maximum.
        approach: speed of the way to the first pose, share of the motions' maximum of each joint.
        fade: duration in which the torque's share rises at the start, and falls after a fault, s.
        late: longest period of the loop, s.
        records: size of the ring buffer, a power of two.
    """

    tracking: float = 0.2
    excess: float = 0.1
    approach: float = 0.2
    fade: float = 0.5
    late: float = 0.02
    records: int = 8192

    def __post_init__(self) -> None:
        for name in ("tracking", "excess", "approach", "fade", "late"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise SettingError(f"{name} is {value!r}; write a number above 0.", where=name, found=value)
        if self.records < 2 or self.records & (self.records - 1):
            raise SettingError(
                f"records is {self.records!r}; write a power of two.", where="records", found=self.records
            )


def write_player(path: str | Path, motions: Sequence[MotionSamples], settings: PlayerSettings | None = None) -> Path:
    """Write one C99 file, without dependencies but math.h, that plays motions one after the other.

    Names begin with that of the file. Its first lines say how it is called.

    Raises:
        SettingError: no motion, motions of several devices, or a name that does not end in .c.
        OutputFolderError: the file cannot be written.
    """
    target, settings = Path(path), settings or PlayerSettings()
    if target.suffix != ".c":
        raise SettingError(
            f"{target}: a player is a C file.", where=str(target), advice="Write a name that ends in .c."
        )
    if len({(one.name, one.joints, one.rate_hz) for one in motions}) != 1:
        raise SettingError(
            f"a player takes motions of one device at one rate; found {len(motions)} of "
            f"{len({(one.name, one.rate_hz) for one in motions})} kinds.",
            where="motions",
            found=len(motions),
        )
    name = re.sub(r"\W", "_", target.stem, flags=re.ASCII)
    name = f"motion_{name}" if not name or name[0].isdigit() else name
    text = files(__package__ or "").joinpath("player.c").read_text(encoding="utf-8")
    text = text.replace("PLAYER", name.upper()).replace("player", name)
    text = text.replace("/* DATA */", "\n".join(_data(name, motions, settings)))
    with publishing_files(target) as folder:
        (folder / target.name).write_text(text, encoding="utf-8", newline="\n")
    return target


def _data(name: str, motions: Sequence[MotionSamples], settings: PlayerSettings) -> Iterator[str]:
    """Constants and samples."""
    upper, first = name.upper(), motions[0]
    q, qd = (np.concatenate([getattr(one, key) for one in motions]) for key in ("q", "qd"))
    low, high, fastest = q.min(axis=0), q.max(axis=0), np.abs(qd).max(axis=0)
    room = settings.excess * (high - low)
    begins = np.cumsum([0, *(len(one.q) for one in motions)])
    labels = ", ".join(re.sub(r"[^\w .-]", "_", joint, flags=re.ASCII) for joint in first.joints)
    yield f"/* Joints: {labels}; rad or m. */"
    for key, value in (("JOINTS", len(first.joints)), ("MOTIONS", len(motions)), ("SAMPLES", len(q))):
        yield f"#define {upper}_{key} {value}"
    for key, number in (
        ("RATE_HZ", first.rate_hz),
        ("TRACKING", settings.tracking),
        ("FADE", settings.fade),
        ("LATE", settings.late),
    ):
        yield f"#define {upper}_{key} {float(number)!r}"
    yield f"#ifndef {upper}_RECORDS"
    yield f"#define {upper}_RECORDS {settings.records}u /* a power of two */"
    yield "#endif"
    yield f"static const unsigned {name}_begin[{upper}_MOTIONS + 1] = {{{', '.join(map(str, begins.tolist()))}}};"
    vectors: tuple[tuple[str, Array], ...] = (
        ("low", low - room),
        ("high", high + room),
        ("fastest", (1 + settings.excess) * fastest),
        ("approach", settings.approach * fastest),
    )
    for key, values in vectors:
        yield f"static const double {name}_{key}[{upper}_JOINTS] = {{{literal_row(values)}}};"
    for key, rows in (("q", q), ("qd", qd)):
        yield f"static const double {name}_{key}[{upper}_SAMPLES][{upper}_JOINTS] = {{"
        yield from (f"  {{{literal_row(values)}}}," for values in rows)
        yield "};"
