"""`haptid friction`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import app, errors_shown, out, progress_bars, teller

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel
    from haptid.motion.treatment import Motion

HELP = """\
Select a friction model for each joint from a constant-velocity test.

In the test each joint in turn moves to and fro at several constant speeds (kind = "sweep" on `haptid bench`). WHAT is
a study, whose first log with the role "identify" is the test; or a device followed by the path of a log with the
channels t, q1.., tau1.. (N m at the joints). Coulomb, Coulomb and viscous, viscous by direction, and Stribeck friction
are compared by AICc; a larger model must be lower by 2. Writes into OUT:

  friction.csv    velocity, friction torque and its 95 % interval, one row for each constant velocity

  friction.json   every model with its parameters, intervals, AICc and error, and the selected one

  friction.png    plot of the curves

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: haptid friction friction-study.toml --out friction
"""


@app.command(help=HELP)
def friction(
    what: Annotated[str, typer.Argument(help="a study (TOML), or a device", show_default=False)],
    log: Annotated[Path | None, typer.Argument(help="the log, after a device", show_default=False)] = None,
    data: Annotated[Path | None, typer.Option(help="folder of the study's relative log paths")] = None,
    tolerance: Annotated[
        float | None, typer.Option(min=0.001, max=0.5, help="largest relative variation of a constant velocity")
    ] = None,
    slowest: Annotated[float | None, typer.Option(help="least speed that is used, rad/s or m/s")] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-friction"),
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no summary")] = False,
) -> None:
    from haptid._internal.atomic_folder import check_writable, publishing
    from haptid.experiment.friction_test.choice import choose_friction
    from haptid.experiment.friction_test.curve import ConstantVelocity, friction_curve
    from haptid.experiment.friction_test.files import choice_values, plot_friction, write_points

    with errors_shown():
        check_writable(out_folder)
        settings = {"tolerance": tolerance, "slowest": slowest}
        constant = ConstantVelocity(**{name: value for name, value in settings.items() if value is not None})
        with progress_bars(quiet) as progress, publishing(out_folder) as folder:
            tell = teller(progress)
            model, motion = _test(what, log, data, tell)
            tell("friction by velocity", 0.0)
            curve = friction_curve(model, motion, constant=constant)
            choice = choose_friction(curve)
            write_points(curve, folder / "friction.csv")
            text = json.dumps(choice_values(choice), indent=1, allow_nan=False)
            (folder / "friction.json").write_text(text + "\n", encoding="utf-8")
            plot_friction(curve, choice, f"{model.device.name}: friction test", folder / "friction.png")
            tell("friction by velocity", 1.0)
    if not quiet:
        for sentence in (*choice.summary().splitlines(), *curve.notes):
            out.print(sentence, highlight=False, soft_wrap=True)
        out.print(f"Figures in {out_folder}")


def _test(
    what: str, log: Path | None, data: Path | None, tell: Callable[[str, float], None]
) -> tuple[DynamicModel, Motion]:
    """Device and motion of the test, from a study or as given."""
    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.log import read_log
    from haptid.motion.treatment import treat
    from haptid.study import read_study
    from haptid.treatment_choice.propose import propose

    tell("reading the log", 0.0)
    if log is not None:
        model, read, asked = DynamicModel(read_device(what)), read_log(log), {}
    else:
        study = read_study(what)
        entry = next(one for one in study.logs if one.role == "identify")
        model, asked = DynamicModel(read_device(study.device)), dict(study.treatment)
        read = read_log(Path(data or study.path.parent) / entry.path, entry.channels, time_range=entry.time_range)
    tell("reading the log", 1.0)
    return model, treat(read, propose(model, read, **asked).treatment)
