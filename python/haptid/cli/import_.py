"""`haptid import`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import (
    EXIT_CRITERIA,
    EXIT_ERROR,
    AsJson,
    command,
    complain,
    errors_shown,
    out,
    print_json,
    print_lines,
)

if TYPE_CHECKING:
    from haptid.robot_files import ImportedRobot

HELP = """\
Read a robot description, and write it as a device file.

FILE is a URDF, xacro, MJCF, SDF, USD or SYMORO file (.par), or a table of Denavit-Hartenberg parameters (.csv). The
device file says in comments what is approximate and what is left out, with lines of FILE. Its torques are compared with
those of the description itself, link by link, and its loops must close; otherwise nothing is written.

Exit status: 0 on success, 1 with --strict if anything is approximate or left out, 2 if FILE is refused.

Example: `haptid import panda.urdf --out panda.toml`
"""


@command(HELP, "import")
def import_(
    file: Annotated[Path, typer.Argument(help="a robot description", show_default=False)],
    to: Annotated[Path, typer.Option("--out", help="the device file to write", show_default=False)],
    root: Annotated[str | None, typer.Option("--root", help="link that is the base")] = None,
    tip: Annotated[
        str | None, typer.Option("--tip", help="last link of a chain; joints not on the way to it are held")
    ] = None,
    hold: Annotated[list[str] | None, typer.Option("--hold", help="JOINT=POSITION: a joint that does not move")] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", help="JOINT,JOINT,...: the joints that move; all others are held at 0")
    ] = None,
    package: Annotated[
        list[str] | None, typer.Option("--package", help="NAME=FOLDER: where FILE may read from besides its own folder")
    ] = None,
    xacro_arg: Annotated[list[str] | None, typer.Option("--xacro-arg", help="NAME=VALUE of a xacro argument")] = None,
    length: Annotated[list[str] | None, typer.Option("--length", help="NAME=VALUE of a named length, m")] = None,
    snap: Annotated[
        float, typer.Option("--snap", help="make angles nearer than this to a quarter turn exact, rad", min=0, max=0.01)
    ] = 0.0,
    no_priors: Annotated[bool, typer.Option("--no-priors", help="leave out the description's values")] = False,
    torque_constant: Annotated[
        list[str] | None,
        typer.Option("--torque-constant", help="N m/A at the joints, one or JOINT=K each: commands are currents"),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="exit status 1 if anything is not exact")] = False,
    check: Annotated[bool, typer.Option("--check", help="compare with Pinocchio or MuJoCo too")] = False,
    as_json: AsJson = False,
) -> None:
    from haptid.cli.options import named
    from haptid.robot_files import import_robot

    with errors_shown():
        imported = import_robot(
            file,
            root=root,
            tip=tip,
            hold=named("--hold", hold or ()),
            only=[name for names in only for name in names.split(",") if name] if only else None,
            packages=dict(_pairs("--package", package)),
            xacro_arguments=dict(_pairs("--xacro-arg", xacro_arg)),
            lengths=named("--length", length or ()),
            snap=snap,
            priors=not no_priors,
            torque_constant=_torque_constant(torque_constant),
            ask=check,
        )
        imported.save(to)
    if as_json:
        print_json("import", imported.to_dict())
    else:
        print_lines(*_summary(imported, to))
        out.print(f"Next: haptid excite {to} plans a motion; haptid channels LOG --device {to} drafts a study.")
    if strict and not imported.is_exact:
        raise typer.Exit(EXIT_CRITERIA)


def _summary(imported: ImportedRobot, to: Path) -> Iterator[str]:
    """What the device file has, what was approximated, and how far its torques are from the description's."""
    joints, check = len(imported.device.joints), imported.check
    yield f"{to}: {joints} joint{'' if joints == 1 else 's'}, {len(imported.device.active)} active"
    yield from (f"  {note}" for note in imported.notes)
    others = "".join(f", from {name} {size:.1e}" for name, size in check.others.items())
    if without := imported.without_rotor:
        where = "" if len(without) == len(imported.device.active) else f" of {', '.join(without)}"
        yield (
            f"Rotor inertia{where} is not included, as the description has none. It can be identified, and geared "
            f"motors need it: uncomment its term in {to.name}."
        )
    loops = f"; loops closed to {check.gap:.1e} m" if imported.source.closing else ""
    yield (
        f"Torques at {check.states} random states differ from the description's by {check.torque:.1e}{others} of the "
        f"greatest{loops}."
    )
    if imported.snapped is not None:
        yield f"Snapping angles changes torques by up to {imported.snapped:.1e} of the greatest."


def _pairs(option: str, texts: Sequence[str] | None) -> list[tuple[str, str]]:
    pairs = []
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            complain(f"{option} {text}: write NAME=VALUE.")
            raise typer.Exit(EXIT_ERROR)
        pairs.append((name, value))
    return pairs


def _torque_constant(texts: Sequence[str] | None) -> Mapping[str, float] | float | None:
    from haptid.cli.options import named, numbers

    if texts and len(texts) == 1 and "=" not in texts[0]:
        return numbers("--torque-constant", texts[0], "torque at every joint per ampere", 1)[0]
    return named("--torque-constant", texts) if texts else None
