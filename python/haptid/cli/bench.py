"""`haptid bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, DeviceName, Quiet, command, errors_shown, out, print_json, progress_bars

HELP = """\
Simulate a device in closed loop on the virtual bench, and write the log of its controller.

The EXPERIMENT (a TOML file) defines the motion, the controller, encoders and amplifiers, and the true parameters where
the device file has none. The motion is checked against the limits of joints, loops and motors before the simulation.
Needs MuJoCo: pip install mujoco. Channels of the log:

- `t`: time, s
- `q1..`: positions measured by the encoders, rad or m
- `command1..`: motor commands, in their own unit
- `velocity1..`: velocities computed by the controller; `target1..`: planned positions

With --truth, the true parameters go to LOG.truth.json, exact states and torques to LOG.truth.parquet. The same seed
gives the same file.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid bench phantom_premium_15 examples/phantom/experiment.toml --out sweep.parquet --truth`
"""


@command(HELP)
def bench(
    device: DeviceName,
    experiment: Annotated[Path, typer.Argument(help="the experiment file (TOML)", show_default=False)],
    out_log: Annotated[Path, typer.Option("--out", help="the log to write, a .parquet file", show_default=False)],
    truth: Annotated[bool, typer.Option("--truth", help="also write true parameters and exact states")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="seed in place of the experiment's")] = None,
    picture: Annotated[bool, typer.Option("--picture", help="draw the moving device into LOG.png")] = False,
    count: Annotated[
        int, typer.Option(min=1, help="number of logs, LOG-1, LOG-2, .., with consecutive seeds, in parallel")
    ] = 1,
    many: Annotated[
        int | None, typer.Option("--workers", min=1, help="processes for several logs (default: one per processor)")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Dask scheduler whose workers simulate the logs")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.executors import DaskExecutor, ProcessExecutor
    from haptid.experiment.bench.run import Job, make_log, make_logs, repeated, truth_paths

    with errors_shown(), progress_bars(quiet or as_json) as bars:
        task = bars.add_task("simulating", total=1.0)
        jobs = repeated(Job(device, experiment, out_log, truth, seed, picture), count)
        if len(jobs) == 1:
            make_log(jobs[0], lambda share: bars.update(task, completed=share))
        else:
            make_logs(
                jobs,
                DaskExecutor(scheduler) if scheduler else ProcessExecutor(many),
                lambda _, share: bars.update(task, completed=share),
            )
    if as_json:
        print_json(
            "bench",
            [
                {
                    "log": str(job.out),
                    "truth": [str(path) for path in truth_paths(job.out)] if truth else [],
                    "picture": str(job.strip) if picture else None,
                }
                for job in jobs
            ],
        )
    for job in () if quiet or as_json else jobs:
        also = f", truth in {' and '.join(str(path) for path in truth_paths(job.out))}" if truth else ""
        also += f", picture in {job.strip}" if picture else ""
        out.print(f"Log in {job.out}{also}")
