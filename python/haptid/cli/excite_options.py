"""Options of `haptid excite`, checked and read: limits, family of motions, body of the motion with a payload."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from haptid.cli.options import numbers, one_or_each, wrong_option

if TYPE_CHECKING:
    from haptid.device import Device
    from haptid.device.priors import PriorBody
    from haptid.dynamics.model import DynamicModel
    from haptid.experiment.excitation import FourierSeries, Limits, TrianglesWithSines


def check_criterion(criterion: str | None, after: Path | None, count: int) -> None:
    """Raise OptionError for a criterion that there is not, or where the largest interval is the criterion."""
    from haptid.experiment.excitation import CRITERIA

    if criterion is not None and criterion not in CRITERIA:
        raise wrong_option("--criterion", criterion, f"one of {', '.join(CRITERIA)}")
    if criterion is not None and (after is not None or count > 1):
        other_one = "--after" if after is not None else "--motions"
        raise wrong_option("--criterion", f"{criterion} with {other_one}", "no criterion: the largest interval counts")


def check_instruments(like: Path | None, study: Path | None, after: Path | None, accuracy: float | None) -> None:
    """Raise OptionError where the noise, on which the option depends, is not known, or a treatment twice."""
    if accuracy is not None and after is None and like is None:
        wanted = "--after or --like too: the noise is that of its logs or instruments"
        raise wrong_option("--accuracy", f"{accuracy:g} without --after and --like", wanted)
    if study is not None and (like is None or after is not None):
        wanted = "--like alone beside it: --after has the treatment of its logs"
        raise wrong_option("--study", f"{study} {'with --after' if after else 'without --like'}", wanted)


def check_families(count: int, others: bool, after: Path | None, payload: str | None) -> None:
    """Raise OptionError where there is no motion to plan, or none for what is asked of it."""
    if not (count or others):
        raise wrong_option("--motions", "0 alone", "--friction-test, --poses or --reversals too")
    if not count and (after is not None or payload is not None):
        raise wrong_option("--motions", "0 with --after or --payload", "1 or more")


def check_files(out_file: Path, also: list[Path], page_file: Path | None, player: Path | None) -> None:
    """Raise OptionError for an ending that says no format."""
    from haptid.experiment.excitation.samples import SAMPLE_FORMATS

    for path in also:
        if path.suffix not in SAMPLE_FORMATS:
            raise wrong_option("--samples", str(path), f"a file whose name ends in one of {', '.join(SAMPLE_FORMATS)}")
    names = {"--out": (out_file, ".toml"), "--page": (page_file, ".html"), "--player": (player, ".c")}
    for option, (name, ending) in names.items():
        if name is not None and name.suffix != ending:
            raise wrong_option(option, str(name), f"a file whose name ends in {ending}")


def payload_option(text: str, model: DynamicModel) -> tuple[str, PriorBody]:
    """A link and the point mass on it, from LINK=KG@X,Y,Z."""
    import numpy as np

    from haptid.device.priors import PriorBody

    link, equals, body = text.partition("=")
    mass, at, com = body.partition("@")
    names = model.device.joint_names
    if not equals or not at or link not in names:
        raise wrong_option("--payload", text, f"LINK=KG@X,Y,Z, such as {names[-1]}=0.5@0,0,0.1; {names} are links")
    (kg,) = numbers("--payload", mass, "the mass in kg", 1)
    if kg <= 0:
        raise wrong_option("--payload", text, "a mass above 0 kg")
    return link, PriorBody(kg, np.array(numbers("--payload", com, "the centre of mass in m", 3)), None)


def limit_options(
    device: Device,
    centre: str | None,
    stroke: str | None,
    rates: dict[str, str | None],
    efforts: dict[str, str | None],
) -> Limits:
    """Limits given by options, in place of the device file's: of active joints, and of torque rows."""
    from haptid.experiment.excitation import Limits

    names, count = ", ".join(device.joint_names[j] for j in device.active), len(device.active)
    if (centre is None) != (stroke is None):
        raise wrong_option("--centre without --stroke" if stroke is None else "--stroke", "alone", "both of them")
    position = None
    if centre is not None and stroke is not None:
        middle = numbers("--centre", centre, f"positions of joints {names}", count)
        reach = one_or_each("--stroke", stroke, f"strokes of joints {names}", count)
        position = tuple((x - abs(half), x + abs(half)) for x, half in zip(middle, reach, strict=True))
    rows, rows_count = ", ".join(device.row_labels), len(device.row_labels)
    limits = {
        option: one_or_each(f"--{option.replace('_', '-')}", text, f"those of {owners}", size)
        for options, owners, size in ((rates, names, count), (efforts, rows, rows_count))
        for option, text in options.items()
        if text is not None
    }
    return replace(Limits(position=position), **limits)  # type: ignore[arg-type]


def family_options(
    device: Device, triangles: bool, seconds: float | None, start: str | None, buffer: tuple[int, float] | None
) -> FourierSeries | TrianglesWithSines:
    """The motions to search among; `buffer` has the most samples, and their rate, Hz."""
    from haptid.experiment.excitation import FourierSeries, TrianglesWithSines, of_buffer

    if buffer is not None and (triangles or seconds is not None):
        raise wrong_option("--buffer", f"{buffer[0]} with --triangles or --seconds", "one of them")
    family: FourierSeries | TrianglesWithSines
    if triangles:
        if start is not None:
            raise wrong_option("--start", "--triangles with it", "one of them: triangles start at their centre")
        family = TrianglesWithSines()
    else:
        names = ", ".join(device.joint_names[j] for j in device.active)
        pose = None if start is None else numbers("--start", start, f"positions of joints {names}", len(device.active))
        family = FourierSeries(start_pose=None if pose is None else tuple(pose))
        family = family if buffer is None else of_buffer(family, *buffer)
    return family if seconds is None else replace(family, seconds=seconds)
