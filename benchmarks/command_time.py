"""Processor time of `haptid` from the command to its files, by stage: where it goes.

Each command runs in a process of its own, on one thread. A stage's time is that of its functions without those of
other stages that they call; imports are a stage too, wherever they happen, and what Python does after the command is
"end". What is left over is "rest"; "all" is the whole process.

    python benchmarks/command_time.py                        logs of the bench, 20 000 samples each
    python benchmarks/command_time.py STUDY --data FOLDER    a study of one's own
"""

from __future__ import annotations

import argparse
import builtins
import functools
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
# Stage of each function, by the module from which its caller takes it.
STAGES = {
    "reading": (
        "haptid.study.identify:read_entry",
        "haptid.study.read:read_study",
        "haptid.device.toml.reader:read_device",
    ),
    "treatment": ("haptid.study.identify:propose",),
    "observation": ("haptid.study.identify:observe_all", "haptid.study.identify:_treat"),
    "estimation": ("haptid.study.identify:told_estimate", "haptid.study.identify:with_treatment_uncertainty"),
    "model for use": ("haptid.study.identify:model_for_use",),
    "validation": ("haptid.study.identify:held_out", "haptid.study.identify:validate"),
    "diagnosis": ("haptid.inference.diagnosis:diagnose",),
    "advice": ("haptid.advice:advise",),
    "result.json": ("haptid.results.result:Result.of", "haptid.results.result:Result.write_into"),
    "report": ("haptid.report.report:report_of", "haptid.report.report:Report.write_into"),
    "pictures": ("haptid.report.run:draw_torque",),
}
COMMANDS = {
    "help": ("--help",),
    "model": ("model", "staubli_tx40"),
}


class Clock:
    """Processor time by stage, each without what other stages take within it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.open, self.since = ["rest"], 0.0  # the start of Python counts

    def change(self) -> None:
        now = time.process_time()
        self.seconds[self.open[-1]] += now - self.since
        self.since = now

    def within(self, stage: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The call, its time counted under a stage."""

        @functools.wraps(call)
        def counted(*args: Any, **settings: Any) -> Any:
            self.change()
            self.open.append(stage)
            try:
                return call(*args, **settings)
            finally:
                self.change()
                self.open.pop()

        return counted


def child(arguments: list[str], out: Path) -> None:
    """Run a command in this process, and write its seconds by stage."""
    clock = Clock()
    found, real = {name.split(":")[0] for own in STAGES.values() for name in own}, builtins.__import__
    depth = 0

    def importing(*args: Any, **settings: Any) -> Any:
        nonlocal depth
        if depth:
            return real(*args, **settings)
        depth += 1
        try:
            return clock.within("imports", real)(*args, **settings)
        finally:
            depth -= 1

    builtins.__import__ = importing
    from haptid.__main__ import program

    if arguments[0] == "identify":
        for module in found:
            clock.within("imports", importlib.import_module)(module)
        for stage, names in STAGES.items():
            for name in names:
                module, path = name.split(":")
                holder = importlib.import_module(module)
                *owner, last = path.split(".")
                for part in owner:
                    holder = getattr(holder, part)
                static = isinstance(vars(holder).get(last), staticmethod)
                counted = clock.within(stage, getattr(holder, last))
                setattr(holder, last, staticmethod(counted) if static else counted)
    sys.argv = ["haptid", *arguments]
    try:
        program()
    except SystemExit as done:
        if done.code not in (0, 1, None):  # 1: the study's criteria are not met
            raise
    clock.change()
    out.write_text(json.dumps({**clock.seconds, "all": time.process_time()}))


def measured(arguments: list[str], folder: Path) -> dict[str, float]:
    """Seconds of a command by stage, of the fastest of three runs."""
    taken: list[dict[str, float]] = []
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # with it each run compiles the package
    for _ in range(3):
        out = folder / "seconds.json"
        call = [sys.executable, str(Path(__file__).resolve()), "--child", str(out), *arguments]
        before = used()
        subprocess.run(call, check=True, env=environment, stdout=subprocess.DEVNULL)
        whole, one = used() - before, json.loads(out.read_text())
        taken.append({**one, "end": whole - one["all"], "all": whole})
    return min(taken, key=lambda one: one["all"])


def used() -> float:
    """Processor time of all children until now, s."""
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime


def bench_log(device: str, experiment: Path, joints: int, folder: Path) -> Path:
    """A study of a bench log of 20 s at 1 kHz, nothing of its treatment given."""
    folder.mkdir()
    log = folder / "log.parquet"
    call = [sys.executable, "-m", "haptid", "bench", device, str(experiment), "--out", str(log), "-q"]
    subprocess.run(call, check=True)
    channels = {kind: [f"{kind}{k}" for k in range(1, joints + 1)] for kind in ("q", "command")}
    (folder / "study.toml").write_text(f"""schema = 1
name = "{device}"
device = "{device}"

[channels]
time = "t"
position = {{ channels = {json.dumps(channels["q"])}, unit = "rad" }}
torque = {{ channels = {json.dumps(channels["command"])}, unit = "N m", side = "motor" }}

[[logs]]
path = "log.parquet"

[validation]
cross_validation = "blocks"
""")
    return folder / "study.toml"


def run() -> dict[str, float]:
    """Seconds by command and stage."""
    figures = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = {what: list(arguments) for what, arguments in COMMANDS.items()}
        for device, experiment, joints in (
            ("phantom_premium_15", HERE.parent / "examples" / "phantom" / "experiment.toml", 3),
            ("arm7", HERE / "arm7-experiment.toml", 7),
        ):
            study = bench_log(device, experiment, joints, folder / device)
            commands[f"identify {device}"] = ["identify", str(study), "--out", str(folder / device / "out"), "-q"]
        for what, arguments in commands.items():
            for stage, seconds in measured(arguments, folder).items():
                if seconds >= 0.005:
                    figures[f"{what}: {stage}, s"] = round(seconds, 3)
    return figures


def main() -> None:
    """Measure a study of one's own, or the logs of the bench."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", nargs="?", type=Path)
    parser.add_argument("--data", type=Path, help="folder of the study's logs")
    given = parser.parse_args()
    if given.study is None:
        figures = run()
    else:
        with tempfile.TemporaryDirectory() as name:
            data = [] if given.data is None else ["--data", str(given.data)]
            figures = measured(["identify", str(given.study), *data, "--out", f"{name}/out", "-q"], Path(name))
    for what, seconds in sorted(figures.items(), key=lambda one: -one[1] if given.study else 0):
        print(f"{what:45s} {seconds:8.3f}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[3:], Path(sys.argv[2]))
    else:
        main()
