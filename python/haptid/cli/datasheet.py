"""`haptid datasheet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel
    from haptid.end_effector.characterisation import GivenParameters

HELP = """\
Write the data sheet of an identified device: workspace, forces, friction, mass, resolution, Z-width, with intervals.

DEVICE is an output folder of `haptid identify`, or a device file or the name of a shipped device: then figures are
those of the prior in the file, without intervals. With several the page begins with a comparison.

The suffix of --out decides: .html is a page for screen and paper, .pdf has one page for each device. Limits and
resolutions of motors are those of the device file unless options give others.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid datasheet haptid-result --limit be=-0.7:0.7 --peak 1=1.7 --peak 2=1.4 --peak 3=1.4 --out sheet.pdf`
"""


@command(HELP)
def datasheet(
    devices: Annotated[
        list[str],
        typer.Argument(help="results, device files or shipped devices", show_default=False, metavar="DEVICE..."),
    ],
    page: Annotated[Path, typer.Option("--out", help="file to write, .html or .pdf")] = Path("datasheet.html"),
    limit: Annotated[
        list[str] | None, typer.Option("--limit", help="range of a joint of the workspace: NAME=LOW:HIGH")
    ] = None,
    rate: Annotated[float, typer.Option("--rate", help="of the controller, Hz")] = 1000.0,
    delay: Annotated[float, typer.Option("--delay", help="from reading positions to the torque, s")] = 0.0,
    peak: Annotated[
        list[str] | None, typer.Option("--peak", help="peak torque of a motor behind its gear: NAME=VALUE")
    ] = None,
    continuous: Annotated[
        list[str] | None, typer.Option("--continuous", help="continuous torque of a motor behind its gear: NAME=VALUE")
    ] = None,
    counts: Annotated[
        list[str] | None, typer.Option("--counts", help="encoder counts per turn of a motor's shaft: NAME=VALUE")
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option("--step", help="smallest change of a motor's torque, behind its gear: NAME=VALUE"),
    ] = None,
    poses: Annotated[int, typer.Option("--poses", min=8, help="cells of the grid over the workspace")] = 1000,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from dataclasses import asdict

    from haptid.cli.options import named, ranges, wrong_option
    from haptid.dynamics.workspace import workspace
    from haptid.end_effector.datasheet import DeviceInstruments, data_sheet
    from haptid.report.datasheet import comparison, write_sheet

    with errors_shown():
        if page.suffix not in (".html", ".pdf"):
            raise wrong_option("--out", str(page), "a file that ends in .html or .pdf")
        settings = {"peak": peak, "continuous": continuous, "encoder_counts": counts, "torque_step": step}
        tools = DeviceInstruments(
            rate, delay, **{key: named(f"--{key}", value or ()) for key, value in settings.items()}
        )
        given = [model_and_parameters(device) for device in devices]
        limits = ranges("--limit", limit or ())
        sheets = [data_sheet(parameters, workspace(model, limits), tools, poses) for model, parameters in given]
        write_sheet(sheets, page)
    if as_json:
        print_json("datasheet", {sheet.model.device.name: [asdict(row) for row in sheet.rows] for sheet in sheets})
    elif not quiet:
        from haptid.report.datasheet import sheet_cells
        from haptid.report.model_tables import table

        head, *body = comparison(sheets) if len(sheets) > 1 else sheet_cells(sheets[0])
        out.print(table("", head, [(row, False) for row in body], left=head[1:]))
        out.print(f"Data sheet in {page}", highlight=False)


def model_and_parameters(device: str) -> tuple[DynamicModel, GivenParameters | DynamicModel]:
    """The model of a result or of a device file, and its parameters; the model itself where the file has no values."""
    import numpy as np

    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.end_effector.characterisation import GivenParameters
    from haptid.results.result import Result

    if Path(device).is_dir():
        identified = Result.load(Path(device)).identified
        return identified.model, identified
    model = DynamicModel(read_device(device))
    chi = np.nan_to_num(model.device.chi_prior)
    return model, GivenParameters(model, model.base.of(chi)) if chi.any() else model
