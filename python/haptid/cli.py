"""The command line: the same calls as the Python API."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

import haptid
from haptid import tables
from haptid.errors import HaptidError
from haptid.outputs import check_writable, publishing

EXIT_CRITERIA, EXIT_ERROR, EXIT_DEFECT = 1, 2, 3

app = typer.Typer(
    help="Dynamic models of haptic devices and robots, identified from their own motion logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Where the output is no terminal, lines are as long as the tables need, not cut at 80.
WIDE = None if sys.stdout.isatty() else 140
# What is printed comes from users' files: no markup is read in it.
out, err = Console(width=WIDE, markup=False), Console(stderr=True, markup=False)

IDENTIFY_HELP = """\
Identify a device from the logs a study names, and validate the model.

The STUDY (a TOML file) names the device, the logs and what each is for, the channels in them with their units, the
treatment, and the estimator. Writes into OUT:

  result.json      every figure: parameters with 95 % intervals, groupings, errors, conditions, notes

  parameters.csv   the table of parameters

  torque-*.png     measured against predicted torque, one picture for each log

Exit status: 0 when done (and the study's criteria, if it has any, are met), 1 when its criteria are not met, 2 when
something is wrong with the study, the device or a log; the message says what to do. 3 is a defect of haptid.

Example: haptid identify examples/emps/study.toml --data ../shared/data/emps --out emps-result
"""

BENCH_HELP = """\
Simulate a device under its controller, and write the log that the controller would write.

The EXPERIMENT (a TOML file) holds the motion, the controller, encoders and amplifiers, and the true parameters where
the device file has none. The motion is checked against the limits of joints, loops and motors before anything moves.
Needs MuJoCo: pip install mujoco. Channels of the log:

  t                in s

  q1..             positions by the encoders, rad or m

  command1..       what was sent to the motors, in their own unit

  velocity1..      as the controller computes it; target1.. as planned

With --truth, the true parameters go to LOG.truth.json, exact states and torques to LOG.truth.parquet. The same seed
gives the same file.

Exit status: 0 when done, 2 when something is wrong; the message says what to do.

Example: haptid bench phantom_premium_15 examples/phantom/experiment.toml --out sweep.parquet --truth
"""

DEMO_HELP = """\
Reproduce a published identification on the virtual bench, and do it better. Without a NAME, list the demos.

Records every mounting (in parallel), identifies the published way and with haptid's own treatment, and compares all of
it with what was published. A few minutes on two cores. Needs MuJoCo: pip install mujoco. Writes into OUT:

  report.md        everything in sentences, with tables and figures

  table1, table2   parameters and torque errors, published and found, as text and CSV

  fig*.png         the published figures, with haptid's own numbers

  result.json      every figure

  logs/            the experiments, the logs, and what is true beside them

Exit status: 0 when done, 2 when something is wrong; the message says what to do.

Example: haptid demo phantom --out phantom-demo
"""


@contextmanager
def _errors_shown() -> Iterator[None]:
    """haptid's own errors as one line, and the exit status for them."""
    try:
        yield
    except HaptidError as error:
        complain(str(error))
        raise typer.Exit(EXIT_ERROR) from None


def complain(sentence: str) -> None:
    """One line on standard error."""
    err.print(Text.assemble(("error: ", "bold red"), sentence), soft_wrap=True)


def _progress(quiet: bool) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    return Progress(*columns, TimeRemainingColumn(), console=err, transient=True, disable=quiet)


def _teller(progress: Progress) -> Callable[[str, float], None]:
    """A bar for each thing that is being done."""
    tasks: dict[str, TaskID] = {}

    def tell(what: str, share: float) -> None:
        if what not in tasks:
            tasks[what] = progress.add_task(what, total=1.0)
        progress.update(tasks[what], completed=share)

    return tell


@app.command(help=IDENTIFY_HELP)
def identify(
    study: Annotated[Path, typer.Argument(help="the study file (TOML)", show_default=False)],
    data: Annotated[
        Path | None,
        typer.Option(help="where the study's relative log paths start (default: the study's folder)"),
    ] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-result"),
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no tables")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print result.json instead of tables")] = False,
) -> None:
    from haptid.identification import identify as walk
    from haptid.observation import Plan
    from haptid.plots import plot_torque
    from haptid.prediction import predictions
    from haptid.result import finite, result, write_result
    from haptid.study import read_study

    with _errors_shown():
        check_writable(out_folder)
        plan = read_study(study)
        with _progress(quiet or as_json) as progress, publishing(out_folder) as folder:
            tell = _teller(progress)
            found = walk(plan, data, tell)
            write_result(found, folder)
            for k, run in enumerate(found.runs):
                name = f"torque-{k + 1}-{Path(run.entry.path).stem}.png"
                tell(f"drawing {name}", 0.0)
                kind = "rows of the fit" if run.direct else "unseen"
                title = f"{plan.name}: {run.entry.path} ({kind})"
                parts = predictions(found.estimate, run.motion)
                plot_torque(parts, Plan.of(found.device, run.motion).rows, title, folder / name)
                tell(f"drawing {name}", 1.0)
    if as_json:
        sys.stdout.write(json.dumps(finite(result(found)), indent=1, allow_nan=False) + "\n")
    elif not quiet:
        tables.show_identification(out, found)
        out.print(f"Results in {out_folder}")
    if found.meets_criteria is False:
        raise typer.Exit(EXIT_CRITERIA)


@app.command()
def model(
    device: Annotated[
        str, typer.Argument(help="a device file (TOML) or the name of a shipped device", show_default=False)
    ],
    as_json: Annotated[bool, typer.Option("--json", help="the same as JSON")] = False,
) -> None:
    """Print a device's tree, loops, motors, base parameters and how the others regroup into them."""
    from haptid.device import read_device

    with _errors_shown():
        read = read_device(device)
        if as_json:
            sys.stdout.write(json.dumps(tables.model_values(read), indent=1) + "\n")
        else:
            tables.show_model(out, read)


@app.command()
def devices() -> None:
    """List the devices that come with haptid."""
    from haptid.device import read_device, shipped_devices

    names = shipped_devices()
    for name in names:
        out.print(f"{name:{max(map(len, names))}}  {read_device(name).description}")


@app.command(help=BENCH_HELP)
def bench(
    device: Annotated[
        str, typer.Argument(help="a device file (TOML) or the name of a shipped device", show_default=False)
    ],
    experiment: Annotated[Path, typer.Argument(help="the experiment file (TOML)", show_default=False)],
    out_log: Annotated[Path, typer.Option("--out", help="the log to write, a .parquet file", show_default=False)],
    truth: Annotated[bool, typer.Option("--truth", help="write true parameters and exact states too")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="in place of the experiment's")] = None,
    picture: Annotated[bool, typer.Option("--picture", help="draw the moving device, LOG.png")] = False,
    count: Annotated[
        int, typer.Option(min=1, help="so many logs, LOG-1, LOG-2, .. with one seed after the other, several at a time")
    ] = 1,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no summary")] = False,
) -> None:
    from haptid.bench.logs import truth_paths
    from haptid.bench.run import Job, make_log, make_logs, repeated

    with _errors_shown(), _progress(quiet) as progress:
        task = progress.add_task("simulating", total=1.0)
        jobs = repeated(Job(device, experiment, out_log, truth, seed, picture), count)
        if len(jobs) == 1:
            make_log(jobs[0], lambda share: progress.update(task, completed=share))
        else:
            make_logs(jobs, tell=lambda _, share: progress.update(task, completed=share))
    for job in () if quiet else jobs:
        beside = f", truth in {' and '.join(str(path) for path in truth_paths(job.out))}" if truth else ""
        beside += f", picture in {job.strip}" if picture else ""
        out.print(f"Log in {job.out}{beside}")


@app.command(help=DEMO_HELP)
def demo(
    name: Annotated[str | None, typer.Argument(help="of the demo", show_default=False)] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-demo"),
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no summary")] = False,
) -> None:
    from haptid.demos import demo_names, read_demo, run_demo
    from haptid.demos.columns import summary

    if name is None:
        for known in demo_names():
            out.print(f"{known:{max(map(len, demo_names()))}}  {read_demo(known).title}")
        return
    with _errors_shown():
        check_writable(out_folder)
        plan = read_demo(name)
        with _progress(quiet) as progress, publishing(out_folder) as folder:
            found = run_demo(plan, folder, _teller(progress))
    if not quiet:
        out.print(summary(found))
        out.print(f"Report in {out_folder / 'report.md'}")


@app.command()
def schema(kind: Annotated[str, typer.Argument(help="device, study or experiment", show_default=False)]) -> None:
    """Print the JSON Schema of device, study or experiment files, for editors."""
    from haptid.bench.schema import experiment_schema
    from haptid.device import device_schema
    from haptid.study import study_schema

    schemas = {"device": device_schema, "study": study_schema, "experiment": experiment_schema}
    if kind not in schemas:
        complain(f"there is no schema {kind!r}; write device, study or experiment.")
        raise typer.Exit(EXIT_ERROR)
    sys.stdout.write(json.dumps(schemas[kind](), indent=1) + "\n")


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="print the version")] = False) -> None:
    """Dynamic models of haptic devices and robots, identified from their own motion logs."""
    if show:
        out.print(f"haptid {haptid.__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point of the `haptid` command."""
    try:
        app()
    except Exception:
        traceback.print_exc()
        complain("this is a defect of haptid, not of your input. Please report it with the lines above.")
        sys.exit(EXIT_DEFECT)
