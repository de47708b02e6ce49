"""`haptid export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json

HELP = """\
Export an identified model for other programs.

RESULT is the output folder of haptid identify or haptid eliminate. Formats:

- `c`, `c-single`: C99 for a control loop, in double or single precision
- `rust`, `matlab`: the same functions as a no_std crate, and for MATLAB and Octave
- `mjcf`, `urdf`: the device for simulators, with bodies that have the identified parameters
- `json`: parameters, groupings and covariance for programs
- `latex`: tables for a paper
- `ros2-control`, `chai3d`: gravity and friction compensation as a controller plugin, and as a C++ header
- `dvrk`: gravity compensation of a Master Tool Manipulator for the dVRK console

Each format is written into its own folder, OUT/c and so on. A model that does not meet its study's criterion is
refused. If the diagnosis finds a model unfit for a use, all files and the summary contain a warning.

--name and --reversal-speed apply to code: c, c-single, rust, matlab, ros2-control and chai3d; --time-step and
--contacts to mjcf.

--into writes a copy of your own URDF or MJCF, in which only inertias and constants of joints are replaced.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid export first-result --to c --to mjcf --out first-model`
"""


def _formats(incomplete: str) -> list[str]:
    from haptid.export.all_formats import export_formats

    return [name for name in export_formats() if name.startswith(incomplete)]


@command(HELP)
def export(
    result: Annotated[
        Path, typer.Argument(help="output folder of haptid identify or haptid eliminate", show_default=False)
    ],
    to: Annotated[
        list[str],
        typer.Option("--to", help="a format (repeat for several)", show_default=False, autocompletion=_formats),
    ],
    folder: Annotated[Path, typer.Option("--out", help="parent of the formats' folders", show_default=False)],
    into: Annotated[
        Path | None, typer.Option("--into", help="a URDF or MJCF, of which a copy gets the identified parameters")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="export a failed model, with a warning")] = False,
    name: Annotated[
        str | None, typer.Option("--name", help="prefix of all names in code (default: from the device)")
    ] = None,
    reversal_speed: Annotated[
        float,
        typer.Option("--reversal-speed", help="below it code smooths the sign of a velocity, rad/s or m/s"),
    ] = 0.01,
    time_step: Annotated[float, typer.Option("--time-step", help="of the simulation, s")] = 1e-3,
    contacts: Annotated[
        bool, typer.Option("--contacts", help="the device touches what else is in the scene, not itself")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    import haptid.export
    from haptid.export import CCode, Simulator
    from haptid.results.result import Result

    with errors_shown():
        read = Result.load(result)
        code, simulator = CCode(name, reversal_speed=reversal_speed), Simulator(time_step, contacts)
        exported = haptid.export_model(read, folder, to, code, simulator, into=into, anyway=force)
    if as_json:
        formats = {
            name: {"folder": str(written.folder), "files": list(written.files), "verdict": written.verdict}
            for name, written in exported.items()
        }
        verdict = [{"use": grade.use, "grade": grade.grade, "sentence": grade.sentence} for grade in read.verdict]
        print_json("export", {"formats": formats, "verdict": verdict})
    if quiet or as_json:
        return
    for written in exported.values():
        out.print(f"{written.folder}: {', '.join(written.files)}", soft_wrap=True)
    out.print(next(iter(exported.values())).verdict, soft_wrap=True)
    for grade in read.verdict:
        if grade.grade == "bad":
            out.print(f"WARNING: {grade.sentence}", soft_wrap=True, highlight=False)
