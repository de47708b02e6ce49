"""`haptid demo`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json, progress_bars, progress_callback

HELP = """\
Reproduce a published identification on the virtual bench. Without a NAME, list the demos.

Simulates every log (in parallel), identifies, and compares the results with the published values and with the true
parameters. A few minutes on two cores. Needs MuJoCo: pip install mujoco. Writes into OUT:

- `paper.html`: tables and figures of the paper with haptid's own numbers, in one file
- `report.html`: phantom: the identification report of one mounting, with the hand force; see haptid identify
- `*.txt`, `*.csv`: the published tables with haptid's own columns
- `demo.json`: every number
- `logs/`: the experiments, the logs, and their ground truth

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid demo phantom --out phantom-demo`
"""


def _names(incomplete: str) -> list[str]:
    from haptid.demos import demo_names

    return [name for name in demo_names() if name.startswith(incomplete)]


@command(HELP)
def demo(
    name: Annotated[str | None, typer.Argument(help="of the demo", show_default=False, autocompletion=_names)] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-demo"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import check_writable, publishing
    from haptid.demos import demo_names, kind_of, read_demo, run_demo
    from haptid.demos.run import PAGE

    if name is None and as_json:
        print_json("demo", [{"name": known, "title": read_demo(known).title} for known in demo_names()])
        return
    if name is None:
        for known in demo_names():
            out.print(f"{known:{max(map(len, demo_names()))}}  {read_demo(known).title}")
        return
    with errors_shown():
        check_writable(out_folder)
        plan = read_demo(name)
        with progress_bars(quiet or as_json) as bars, publishing(out_folder) as folder:
            demo_results = run_demo(plan, folder, progress_callback(bars))
    if as_json:
        sys.stdout.write((out_folder / "demo.json").read_text(encoding="utf-8"))
    elif not quiet:
        out.print(kind_of(plan).summary(demo_results))
        out.print(f"Page in {out_folder / PAGE}")
