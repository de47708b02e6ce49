"""`haptid excite`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import app, errors_shown, out, progress_bars

if TYPE_CHECKING:
    from haptid.device import Device
    from haptid.experiment.excitation import Excitation, Family, Limits

HELP = """\
Optimise an exciting motion: base parameters well conditioned, within the limits of the device.

Limits are those of the DEVICE file, unless replaced by --centre with --stroke, or --speed; --acceleration adds one.
The motion is a Fourier series, or triangles with superimposed sines (--triangles). Writes:

  OUT           an experiment file for `haptid bench`

  OUT with .csv in place of .toml: samples for a real controller: t, then position, velocity and acceleration of joints

With --like, controller, instruments and true parameters are those of another experiment. Prints the
condition number of the observation matrix, raw and with columns of unit length, before and after the search.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: haptid excite phantom_premium_15 --like examples/phantom/experiment.toml --speed 3 --out excite.toml
"""


@app.command(help=HELP)
def excite(
    device: Annotated[
        str, typer.Argument(help="a device file (TOML) or the name of a shipped device", show_default=False)
    ],
    out_file: Annotated[Path, typer.Option("--out", help="the experiment to write, a .toml file", show_default=False)],
    like: Annotated[Path | None, typer.Option(help="an experiment with the controller to use")] = None,
    centre: Annotated[str | None, typer.Option(help="of the motion, rad or m: 0,0.2,0.3")] = None,
    stroke: Annotated[str | None, typer.Option(help="to either side of the centre: one, or one each")] = None,
    speed: Annotated[str | None, typer.Option(help="largest, rad/s or m/s: one, or one each")] = None,
    acceleration: Annotated[str | None, typer.Option(help="largest, rad/s^2 or m/s^2: one, or one each")] = None,
    triangles: Annotated[bool, typer.Option("--triangles", help="triangles with superimposed sines")] = False,
    seconds: Annotated[float | None, typer.Option(min=1.0, help="duration of the motion")] = None,
    keep: Annotated[
        list[str] | None, typer.Option("--parameter", help="a base parameter to excite (default: all)")
    ] = None,
    max_evaluations: Annotated[int, typer.Option(min=1, help="largest number of motions evaluated")] = 3000,
    seed: Annotated[int, typer.Option(min=0, help="of the search")] = 0,
    rate_hz: Annotated[float, typer.Option(min=1.0, help="of the samples in the CSV")] = 1000.0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no summary")] = False,
) -> None:
    from haptid.cli.options import wrong_option
    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.experiment.bench import read_experiment
    from haptid.experiment.excitation import Search, design_excitation, write_experiment
    from haptid.experiment.excitation.writing import plain_experiment

    with errors_shown():
        if out_file.suffix != ".toml":
            raise wrong_option("--out", str(out_file), "a file whose name ends in .toml")
        model = DynamicModel(read_device(device))
        other = None if like is None else read_experiment(like)
        beta = None if other is None else model.base.of(other.setup(model).chi)
        within, family = _limits(model.device, centre, stroke, speed, acceleration), _family(triangles, seconds)
        columns = tuple(keep) if keep else None
        with progress_bars(quiet) as bars:
            task = bars.add_task("searching", total=1.0)
            found = design_excitation(
                model,
                family,
                within,
                columns=columns,
                beta=beta,
                search=Search(tries=max_evaluations, seed=seed),
                progress=lambda share, cost: bars.update(task, completed=share, description=_so_far(cost)),
            )
        write_experiment(out_file, found, plain_experiment(found) if other is None else other, rate_hz)
    if not quiet:
        _show(found, out_file)


def _so_far(cost: float) -> str:
    """State of the search, for its progress bar."""
    return f"condition {math.exp(cost):.4g}" if math.isfinite(cost) else "no motion within the limits yet"


def _limits(
    device: Device, centre: str | None, stroke: str | None, speed: str | None, acceleration: str | None
) -> Limits:
    """Limits given by options, in place of the device file's."""
    from haptid.cli.options import numbers, spread, wrong_option
    from haptid.experiment.excitation import Limits

    names, count = ", ".join(device.joint_names[j] for j in device.active), len(device.active)
    if (centre is None) != (stroke is None):
        raise wrong_option("--centre without --stroke" if stroke is None else "--stroke", "alone", "both of them")
    position = None
    if centre is not None and stroke is not None:
        middle = numbers("--centre", centre, f"positions of joints {names}", count)
        reach = spread("--stroke", stroke, f"strokes of joints {names}", count)
        position = tuple((x - abs(half), x + abs(half)) for x, half in zip(middle, reach, strict=True))
    fastest = None if speed is None else spread("--speed", speed, f"speeds of joints {names}", count)
    sharpest = None if acceleration is None else spread("--acceleration", acceleration, f"those of {names}", count)
    return Limits(position=position, speed=fastest, acceleration=sharpest)


def _family(triangles: bool, seconds: float | None) -> Family:
    """The motions to search among."""
    from haptid.experiment.excitation import FourierSeries, TrianglesWithSines

    if triangles:
        return TrianglesWithSines() if seconds is None else TrianglesWithSines(seconds=seconds)
    return FourierSeries() if seconds is None else FourierSeries(seconds=seconds)


def _show(found: Excitation, path: Path) -> None:
    """Print condition numbers before and after, and the paths of the files."""
    out.print(
        f"{found.model.device.name}: {len(found.after.names)} parameters, {found.tried} motions evaluated", style="bold"
    )
    for when, one in (("first motion within the limits", found.before), ("motion found", found.after)):
        out.print(f"  {when}: condition {one.raw:.4g} raw, {one.scaled:.4g} with unit columns", highlight=False)
    weak = [name for name, se in found.predicted.items() if se > 50]
    if weak and len(weak) < len(found.after.names):
        out.print(f"  poorly identifiable at the prior values: {', '.join(weak)}", highlight=False)
    out.print(f"Experiment in {path}, samples in {path.with_suffix('.csv')}")
