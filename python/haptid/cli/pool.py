"""`haptid pool`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, DataFolder, Quiet, StudyFile, command, compute_into, err

if TYPE_CHECKING:
    from haptid.study.pool import Pool
    from haptid.study.pool_parts import FileWork

HELP = """\
Identify one device from all log files of a data set together, however many there are.

SOURCE is a folder of Parquet files or other logs, or the URL of one that fsspec knows (s3://, gs://, memory://). Each
file is read, checked, filtered and reduced by itself, by processes or the workers of a cluster; memory grows with the
largest file and not with their number. Channels, device and method are the STUDY's; what it leaves open of the
treatment is proposed from its own logs. A file that cannot be read is listed with its problem; of copies of one file
one counts. Writes into OUT:

- `pool.json`: parameters with 95 % intervals, errors on unseen blocks, work on every file
- `parameters.csv`: the parameters
- `files.csv`: every file: worker, seconds of fetching, reading and reducing, bytes, samples, rows, problem; where
  the files give no estimate it is alone in `OUT-failed`, and an earlier result in OUT stays

What single files give is kept in .OUT.partial next to OUT until all are there: the same command after an interruption
computes the others, and those whose file, study or device has changed.

Exit status: 0 on success, 2 on an error in the study, in its own logs, or where no file can be used.

Example: `haptid pool study.toml s3://robot/runs --scheduler tcp://host:8786 --out pool`
"""


@command(HELP)
def pool(
    study: StudyFile,
    source: Annotated[str, typer.Argument(help="folder of log files, or its URL", show_default=False)],
    data: DataFolder = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-pool"),
    count: Annotated[int, typer.Option("--workers", min=1, help="processes that reduce files")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler whose workers reduce files, tcp://host:8786")
    ] = None,
    no_resume: Annotated[
        bool, typer.Option("--no-resume", help="start again, not from an interrupted run's files")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import publishing
    from haptid._internal.escaping import write_csv
    from haptid.cli.outputs import output_text
    from haptid.cli.work import interruptible, resumed, workers
    from haptid.log.formats.folders import natural
    from haptid.study import read_study
    from haptid.study.pool import identify_pool, work_table
    from haptid.study.pool_parts import PoolParts

    works: list[FileWork] = []
    kept = resumed(PoolParts.beside(out_folder), no_resume, quiet or as_json)

    def compute(folder: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
        executor = workers(count, scheduler)
        found = identify_pool(read_study(study), source, data, progress, executor, works.append, kept)
        made = values(found)
        text = output_text("pool", made)
        (folder / "pool.json").write_text(text, encoding="utf-8")
        rows = [[one["name"], one["unit"], one["value"], one["se"], *one["conf_int"]] for one in made["parameters"]]
        write_csv(folder / "parameters.csv", [["name", "unit", "value", "se", "low", "high"], *rows])
        write_csv(folder / "files.csv", found.file_table())
        return text, found.summary()

    with interruptible(kept):
        try:
            compute_into(out_folder, quiet, as_json, compute)
        except Exception:
            if works:
                failed = out_folder.with_name(f"{out_folder.name}-failed")
                with publishing(failed) as folder:
                    write_csv(folder / "files.csv", work_table(sorted(works, key=lambda one: natural(one.name))))
                err.print(f"Work on every file, with its problem, in {failed / 'files.csv'}", soft_wrap=True)
            raise
    kept.forget()


def values(found: Pool) -> dict[str, Any]:
    """All figures as JSON values."""
    from dataclasses import asdict

    from haptid.results.tables import treatment

    one = found.estimate
    names, units = one.base.names, one.base.units
    columns = (names, units, one.beta.tolist(), one.se.tolist(), one.dof.tolist(), one.conf_int().tolist())
    keys = ("name", "unit", "value", "se", "dof", "conf_int")
    return {
        "study": found.name,
        "treatment": treatment(found.treatment),
        "status": one.status,
        "parameters": [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)],
        "unseen_error_percent": found.unseen and found.unseen.relative,
        "seconds": found.seconds,
        "files": [asdict(file) for file in found.files],
        "sentences": list(found.sentences),
    }
