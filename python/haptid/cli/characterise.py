"""`haptid characterise`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json, progress_bars, progress_callback

HELP = """\
Characterise the end-effector of an identified device: apparent (effective) mass, friction, weight and forces at the
handle, with confidence intervals.

RESULT is the output folder of `haptid identify`. Poses: one or more --at, one --sweep, or a --grid over the joints'
ranges (default: a grid). Writes into OUT:

- `figures.csv`: a row for each pose: joints, handle, condition number, figures with 95 % intervals
- `masses.png`: apparent masses along the sweep, or the largest one over two joints of the grid

Poses at which the handle's Jacobian is nearly singular are left out; the summary counts them.
Positions are in rad or m, in the order of the active joints; see `haptid model`.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid characterise haptid-result --sweep 0,-0.2,0.3 0,0.8,0.3 --along 0,0,1`
"""


@command(HELP)
def characterise(
    result: Annotated[Path, typer.Argument(help="output folder of `haptid identify`", show_default=False)],
    at: Annotated[list[str] | None, typer.Option("--at", help="a pose: 0,0.2,0.3")] = None,
    sweep: Annotated[
        tuple[str, str] | None, typer.Option("--sweep", help="two poses, joined by a straight line")
    ] = None,
    grid: Annotated[int | None, typer.Option("--grid", min=1, help="number of poses over the joints' ranges")] = None,
    limit: Annotated[
        list[str] | None, typer.Option("--limit", help="range of a joint for the grid: NAME=LOW:HIGH")
    ] = None,
    along: Annotated[str | None, typer.Option("--along", help="direction of motion in the base frame: x,y,z")] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", help="of the handle, m/s: largest velocity-dependent force")
    ] = None,
    stiffness: Annotated[str | None, typer.Option("--stiffness", help="of the joints: one, or one each")] = None,
    torque: Annotated[
        list[str] | None, typer.Option("--torque", help="limit of a motor's torque behind its gear: NAME=VALUE")
    ] = None,
    max_condition: Annotated[
        float | None, typer.Option(help="largest condition number of a pose (default: 30)")
    ] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the figures")] = Path("haptid-handle"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import check_writable, publishing
    from haptid.cli.handle import chosen, draw, figures, show, table_request
    from haptid.dynamics.counterparts import with_stiff_springs
    from haptid.end_effector.characterisation.characterise import characterise as compute
    from haptid.end_effector.characterisation.model import on_counterpart
    from haptid.end_effector.characterisation.table import table_columns, write_columns
    from haptid.end_effector.force import WORST_CONDITION
    from haptid.results.result import Result

    with errors_shown():
        check_writable(out_folder)
        read = Result.load(result).identified
        known = on_counterpart(read, with_stiff_springs(read.model))  # what a hand feels below resonances
        poses = chosen(known.model, at or (), sweep, grid, limit or ())
        wanted = table_request(known.model.device, along, speed, stiffness, torque or ())
        with progress_bars(quiet or as_json) as bars, publishing(out_folder) as folder:
            progress = progress_callback(bars)
            progress("figures", 0.0)
            characterisation = compute(
                known, poses.qa, worst_condition=WORST_CONDITION if max_condition is None else max_condition
            )
            columns = table_columns(characterisation, wanted)
            write_columns(characterisation, columns, folder / "figures.csv")
            progress("figures", 1.0)
            draw(poses, characterisation, folder / "masses.png", progress)
    if as_json:
        print_json("characterise", figures(characterisation, columns))
    elif not quiet:
        show(out, characterisation, columns)
        out.print(f"Figures in {out_folder}")
