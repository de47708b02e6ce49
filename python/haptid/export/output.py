"""Names, settings of generated code, and the output folder of an export."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

from haptid._internal.arrays import positive
from haptid._internal.atomic_folder import publishing
from haptid._internal.late import dataclass
from haptid.end_effector.force import REVERSAL_SPEED
from haptid.errors import SettingError, setting_error

# C99 guarantees 31 significant characters of external names (5.2.4.1), which leaves this many for the prefix.
LONGEST_NAME = 24


def check_name(name: str) -> None:
    """Raise SettingError unless the name is a valid prefix in C."""
    if not re.fullmatch(rf"[a-z][a-z0-9_]{{0,{LONGEST_NAME - 1}}}", name):
        raise SettingError(
            f"{name!r} is not a valid prefix of C names.",
            where="name",
            found=name,
            limit=LONGEST_NAME,
            advice="Write a lower-case letter, then lower-case letters, digits and underscores, at most "
            f"{LONGEST_NAME} characters.",
        )


def default_name(model: str) -> str:
    """The device's name as a valid prefix in C."""
    plain = re.sub(r"[^a-z0-9]+", "_", model.lower()).strip("_")
    plain = plain if plain[:1].isalpha() else f"device_{plain}"
    return plain[:LONGEST_NAME].rstrip("_")


Precision = Literal["double", "single"]


@dataclass(frozen=True)
class CCode:
    """Settings of generated code.

    Attributes:
        name: prefix of all names; derived from the device's name where None.
        precision: "double" or "single", in C.
        reversal_speed: below it the sign of a velocity is smoothed, tanh(v / speed), rad/s or m/s.
        rate, acceleration: largest of joints without a velocity limit, rad/s or m/s and per s, for the error bounds of
            single precision; of joints with a limit the acceleration is in the same proportion to it.
    """

    name: str | None = None
    precision: Precision = "double"
    reversal_speed: float = REVERSAL_SPEED
    rate: float = 2.0
    acceleration: float = 20.0

    def __post_init__(self) -> None:
        if self.name is not None:
            check_name(self.name)
        if self.precision not in get_args(Precision):
            raise setting_error("precision", self.precision, " or ".join(map(repr, get_args(Precision))))
        for setting, unit in (("reversal_speed", "s"), ("rate", "s"), ("acceleration", "s^2")):
            if not positive(getattr(self, setting)):
                wanted = f"a finite number above zero, rad/{unit} or m/{unit}"
                raise setting_error(setting, getattr(self, setting), wanted)


@dataclass(frozen=True)
class Simulator:
    """Settings of an exported MJCF.

    Attributes:
        step: of the integration, s.
        contacts: whether the device touches what else is in the scene; its own links never touch each other.
    """

    step: float = 1e-3
    contacts: bool = False

    def __post_init__(self) -> None:
        if not positive(self.step):
            raise setting_error("step", self.step, "a finite time above zero, s")


@dataclass(frozen=True)
class Export:
    """A written export.

    Attributes:
        folder: output folder.
        files: names of the files in it.
        verdict: on unseen motion, as in the files.
    """

    folder: Path
    files: tuple[str, ...]
    verdict: str


def write(folder: str | Path, texts: Mapping[str, str], verdict: str) -> Export:
    """Write texts by file name, atomically: existing files are replaced only if all are written.

    Raises:
        OutputFolderError: the folder cannot be written.
    """
    folder = Path(folder)
    with publishing(folder) as scratch:
        for file, text in texts.items():
            path = scratch / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return Export(folder, tuple(texts), verdict)
