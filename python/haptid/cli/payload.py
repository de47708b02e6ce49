"""`haptid payload`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, DataFolder, Quiet, StudyFile, command, compute_into

HELP = """\
Identify payloads: mass, centre of mass and inertia of bodies fixed to links; and drive gains from known masses.

The STUDY has logs without payload and logs with one, which have payload = { link = "3" }. What is known of a payload is
given there too: mass, com, inertia; the rest is estimated. Logs of one payload share its name. With --gains the motors'
gains are taken as unknown: at least one mass must be known, and a motor that it does not load is left out. With the
table [poses] the logs are held poses, from which mass and first moments are identifiable. Writes into OUT:

- `payload.json`: payloads and gains with 95 % intervals, what is not determined, the nearest rigid bodies
- `payload.csv`: the same figures as a table

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid payload tool.toml --gains --out tool`
"""


@command(HELP)
def payload(
    study: StudyFile,
    gains: Annotated[bool, typer.Option("--gains", help="estimate the drive gains from known masses")] = False,
    shared_friction: Annotated[
        bool, typer.Option("--shared-friction", help="friction is the same with and without payload")
    ] = False,
    data: DataFolder = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-payload"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.escaping import write_csv
    from haptid.cli.outputs import output_text
    from haptid.study import read_study
    from haptid.study.payloads import study_payloads

    def compute(folder: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
        payloads = study_payloads(
            read_study(study), data, gains=gains, shared_friction=shared_friction, progress=progress
        )
        text = output_text("payload", payloads.to_json())
        (folder / "payload.json").write_text(text, encoding="utf-8")
        write_csv(folder / "payload.csv", payloads.table())
        return text, payloads.summary()

    compute_into(out_folder, quiet, as_json, compute)
