"""`haptid friction`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, DataFolder, DeviceName, Quiet, StudyFile, app, compute_into, unwrapped

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel
    from haptid.log import Log
    from haptid.motion.motion import Motion

_Progress = Callable[[str, float], None]
_Read = Callable[[_Progress], "tuple[DynamicModel, Motion]"]
HELP = """\
Select a friction model for each joint from a constant-velocity test.

In the test each joint in turn moves to and fro at several constant speeds (kind = "sweep" on `haptid bench`).
Coulomb, Coulomb and viscous, viscous by direction, and Stribeck friction are compared by AICc; a larger model must be
lower by 2, and one beyond Coulomb and viscous friction significant by an F test. Writes into OUT:

- `friction.csv`: velocity, friction torque and its 95 % interval, one row for each constant velocity
- `friction.json`: every model with its parameters, intervals, AICc and error, and the selected one
- `friction.png`: plot of the curves

Exit status: 0 on success, 2 on an error; the message says what to do.

Examples:

- `haptid friction study friction-study.toml --out friction`
- `haptid friction log phantom_premium_15 sweep.csv --out friction`
"""
friction = typer.Typer(help=unwrapped(HELP), no_args_is_help=True)
app.add_typer(friction, name="friction")

_Tolerance = Annotated[
    float | None, typer.Option(min=0.001, max=0.5, help="largest relative variation of a constant velocity")
]
_Slowest = Annotated[float | None, typer.Option(help="least speed that is used, rad/s or m/s")]
_Out = Annotated[Path, typer.Option("--out", help="folder for the results")]
_FOLDER = Path("haptid-friction")


@friction.command("study", help="From a study, whose first log with the role 'identify' is the test.")
def of_study(
    study: StudyFile,
    data: DataFolder = None,
    tolerance: _Tolerance = None,
    slowest: _Slowest = None,
    out_folder: _Out = _FOLDER,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    _run(lambda progress: _of_study(study, data, progress), tolerance, slowest, out_folder, quiet, as_json)


@friction.command("log", help="From a device and a log with the channels t, q1.., tau1.. (N m at the joints).")
def of_log(
    device: DeviceName,
    log: Annotated[Path, typer.Argument(help="the log of the test", show_default=False)],
    tolerance: _Tolerance = None,
    slowest: _Slowest = None,
    out_folder: _Out = _FOLDER,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    _run(lambda progress: _of_log(device, log, progress), tolerance, slowest, out_folder, quiet, as_json)


def _run(
    read: _Read, tolerance: float | None, slowest: float | None, out_folder: Path, quiet: bool, as_json: bool
) -> None:
    """Fit the friction curves of a test, and write them."""
    from haptid.cli.outputs import output_text
    from haptid.experiment.friction_test.choice import choose_friction
    from haptid.experiment.friction_test.curve import ConstantVelocity, friction_curve
    from haptid.experiment.friction_test.files import choice_values, plot_friction, write_points

    def compute(folder: Path, progress: _Progress) -> tuple[str, str]:
        settings = {"tolerance": tolerance, "slowest": slowest}
        constant = ConstantVelocity(**{name: value for name, value in settings.items() if value is not None})
        model, motion = read(progress)
        progress("friction by velocity", 0.0)
        curve = friction_curve(model, motion, constant=constant)
        choice = choose_friction(curve)
        write_points(curve, folder / "friction.csv")
        text = output_text("friction", choice_values(choice))
        (folder / "friction.json").write_text(text, encoding="utf-8")
        plot_friction(curve, choice, f"{model.device.name}: friction test", folder / "friction.png")
        progress("friction by velocity", 1.0)
        return text, "\n".join((choice.summary(), *curve.notes))

    compute_into(out_folder, quiet, as_json, compute)


def _of_study(path: Path, data: Path | None, progress: _Progress) -> tuple[DynamicModel, Motion]:
    """Device and treated motion of the test of a study."""
    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.log import read_log
    from haptid.study import read_study

    progress("reading the log", 0.0)
    study = read_study(path)
    entry = next(log for log in study.logs if log.role == "identify")
    model = DynamicModel(read_device(study.device))
    read = read_log(Path(data or study.path.parent) / entry.path, entry.channels, entry.time_range, entry.episodes)
    return model, _treated(model, read, dict(study.treatment), progress)


def _of_log(device: str, path: Path, progress: _Progress) -> tuple[DynamicModel, Motion]:
    """Device and treated motion of a log as it is."""
    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.log import read_log

    progress("reading the log", 0.0)
    model = DynamicModel(read_device(device))
    return model, _treated(model, read_log(path), {}, progress)


def _treated(model: DynamicModel, log: Log, settings: dict[str, Any], progress: _Progress) -> Motion:
    from haptid.motion.motion import treat
    from haptid.treatment_choice.propose import propose

    progress("reading the log", 1.0)
    return treat(log, propose(model, log, **settings).treatment)
