"""`haptid redesign`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json

if TYPE_CHECKING:
    from haptid.end_effector.redesign import Counterweight, DriveChange, MotorOption, Redesign, WeightPlace

HELP = """\
Redesign an identified device: counterweights that null gravity, and motors, gears and lengths for a mass or a force.

DEVICE is an output folder of `haptid identify`, or a device file or the name of a shipped device: then the parameters
are those of the prior in the file. Writes one page: the front of static torque against effective mass with its
weights, what each parameter pays, and the front of force against effective mass with its changes.

Places of weights and rotor inertias are those of the device file ([[counterweights]], rotor_inertia of [[motors]])
unless options give them. What is not known leaves its chapter out, with the reason.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid redesign phantom_premium_15 --limit be=-0.7:0.7 --limit df=-0.6:1.1 --most-mass 0.09 --least-force 10`
"""


@command(HELP)
def redesign(
    device: Annotated[str, typer.Argument(help="result, device file or shipped device", show_default=False)],
    page: Annotated[Path, typer.Option("--out", help="file to write, .html")] = Path("redesign.html"),
    limit: Annotated[
        list[str] | None, typer.Option("--limit", help="range of a joint of the workspace: NAME=LOW:HIGH")
    ] = None,
    poses: Annotated[int, typer.Option("--poses", min=1, help="cells of the grid over the workspace")] = 125,
    most_mass: Annotated[float | None, typer.Option("--most-mass", help="wanted effective mass, kg")] = None,
    least_force: Annotated[float | None, typer.Option("--least-force", help="wanted worst-case force, N")] = None,
    place: Annotated[
        list[str] | None, typer.Option("--place", help="of a weight, kg and m: LINK=MOST:x,y,z:x,y,z")
    ] = None,
    weight: Annotated[
        list[str] | None, typer.Option("--weight", help="try this weight instead, kg and m: LINK=MASS:x,y,z")
    ] = None,
    rotor: Annotated[
        list[str] | None, typer.Option("--rotor", help="inertia of a motor's rotor at its coordinate: NAME=VALUE")
    ] = None,
    peak: Annotated[
        list[str] | None, typer.Option("--peak", help="peak torque of a motor behind its gear: NAME=VALUE")
    ] = None,
    motor: Annotated[
        list[str] | None, typer.Option("--motor", help="other motors, factors of the present: NAME=TORQUE:INERTIA")
    ] = None,
    each: Annotated[bool, typer.Option("--each", help="a ratio for each motor, not one for all")] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.cli.datasheet import model_and_parameters
    from haptid.cli.options import named, ranges, wrong_option
    from haptid.dynamics.model import DynamicModel
    from haptid.dynamics.workspace import workspace
    from haptid.end_effector.redesign import Wishes, redesigned
    from haptid.errors import IncompleteDeviceError
    from haptid.report.redesign import redesign_sections, write_redesign

    with errors_shown():
        if page.suffix != ".html":
            raise wrong_option("--out", str(page), "a file that ends in .html")
        wishes = Wishes(
            float("inf") if most_mass is None else most_mass,
            0.0 if least_force is None else least_force,
            tuple(_place(text) for text in place or ()) or None,
            tuple(_weight(text) for text in weight or ()),
            named("--rotor", rotor or ()),
            named("--peak", peak or ()),
            tuple(_motor(text) for text in motor or ()),
            each,
        )
        model, parameters = model_and_parameters(device)
        if isinstance(parameters, DynamicModel):
            raise IncompleteDeviceError(
                f"no parameters of {model.device.name} are known.",
                where=device,
                advice="Give a result of haptid identify, or a device file with a prior.",
            )
        found = redesigned(parameters, workspace(model, ranges("--limit", limit or ())).grid(poses), wishes)
        write_redesign(found, page)
    if as_json:
        print_json("redesign", _values(found))
    elif not quiet:
        from haptid.report.model_tables import table

        for section in redesign_sections(found):
            for paragraph in section.text:
                out.print(paragraph, highlight=False)
            for one in section.tables:
                head, *body = one.cells
                out.print(table(one.title, list(head), [(list(row), False) for row in body], left=head[-1:]))
        out.print(f"Page in {page}", highlight=False)


def _triple(option: str, text: str) -> tuple[float, float, float]:
    from haptid.cli.options import numbers

    x, y, z = numbers(option, text, "x, y, z in m", 3)
    return x, y, z


def _place(text: str) -> WeightPlace:
    """`LINK=MOST:x,y,z:x,y,z`."""
    from haptid.cli.options import numbers, wrong_option
    from haptid.end_effector.redesign import WeightPlace

    link, equals, rest = text.partition("=")
    if not equals or rest.count(":") != 2:
        raise wrong_option("--place", text, "LINK=MOST:x,y,z:x,y,z, such as be=0.4:-0.1,0,0:0.1,0,0")
    most, low, high = rest.split(":")
    return WeightPlace(link, numbers("--place", most, "kg", 1)[0], _triple("--place", low), _triple("--place", high))


def _weight(text: str) -> Counterweight:
    """`LINK=MASS:x,y,z`."""
    from haptid.cli.options import numbers, wrong_option
    from haptid.end_effector.redesign import Counterweight

    link, equals, rest = text.partition("=")
    if not equals or rest.count(":") != 1:
        raise wrong_option("--weight", text, "LINK=MASS:x,y,z, such as be=0.3:-0.06,0,0")
    mass, com = rest.split(":")
    return Counterweight(link, numbers("--weight", mass, "kg", 1)[0], _triple("--weight", com))


def _motor(text: str) -> MotorOption:
    """`NAME=TORQUE:INERTIA`."""
    from haptid.cli.options import numbers, wrong_option
    from haptid.end_effector.redesign import MotorOption

    name, equals, rest = text.partition("=")
    if not equals or rest.count(":") != 1:
        raise wrong_option(
            "--motor", text, "NAME=TORQUE:INERTIA, factors of the present motors, such as longer=1.4:1.4"
        )
    torque, inertia = numbers("--motor", rest.replace(":", ","), "factors of torque and rotor inertia", 2)
    return MotorOption(name, torque, inertia)


def _values(found: Redesign) -> dict[str, Any]:
    """What --json prints."""
    from dataclasses import asdict

    def drive(one: DriveChange) -> dict[str, Any]:
        return {**asdict(one), "ratios": list(one.ratios)}

    balances = [
        {
            "price": one.price,
            "weights": [{**asdict(weight), "com": list(weight.com)} for weight in one.weights],
            "static_before": one.static_before,
            "static_after": one.static_after,
            "mass_before": one.mass_before,
            "mass_after": one.mass_after,
        }
        for one in found.balances
    ]
    return {
        "counterweights": balances,
        "present": None if found.present is None else drive(found.present),
        "front": [drive(one) for one in found.front],
        "chosen": None if found.chosen is None else drive(found.chosen),
        "missing": list(found.missing),
    }
