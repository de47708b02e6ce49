"""`haptid poses`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, DataFolder, Quiet, StudyFile, command, compute_into

HELP = """\
Identify gravity, springs and friction at rest from held poses, and whether to compensate gravity.

The STUDY has a table [poses]. Its logs hold one pose after the other, each reached from both sides; the holds are found
from the stillness of the encoders. With table = true they have one row a pose instead. Parameters that the poses do not
determine are left out. Writes into OUT:

- `static.json`: static base parameters with 95 % intervals; for each motor the range of its dry friction at rest, and
  how much of its holding torque is explained at poses that were not fitted
- `poses.csv`: the poses that were found, averaged, in SI; one row each

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid poses poses.toml --out gravity`
"""


@command(HELP)
def poses(
    study: StudyFile,
    data: DataFolder = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-poses"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.escaping import write_csv
    from haptid.cli.outputs import output_text
    from haptid.study import read_study
    from haptid.study.payloads import study_poses

    def compute(folder: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
        identified = study_poses(read_study(study), data, progress)
        text = output_text("poses", identified.to_json())
        (folder / "static.json").write_text(text, encoding="utf-8")
        head, rows = identified.poses.table()
        write_csv(folder / "poses.csv", [head, *[["" if x != x else f"{x:.10g}" for x in row] for row in rows]])
        return text, identified.summary()

    compute_into(out_folder, quiet, as_json, compute)
