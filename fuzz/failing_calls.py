"""Let each file-system call of whole commands fail in turn: `python -m fuzz.failing_calls --out results.json`.

Every command runs in this process into an output that it has written before, again and again; the first time the first
call that opens, makes, renames, links or removes something fails as on a full disk, the next time the second, until
none is left. What is there must be whole, of one run; the exit status is 0 or 2, never a traceback; and after a further
run nothing is left over.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from faults import fault, full_disk
from fuzz.interruptions import state, study, wrong
from haptid._internal.escaping import write_csv
from haptid.demos import run as demos
from haptid.registry import Index
from haptid.study import identify as identification

EXPERIMENT = """schema = 1
name = "to and fro"
seed = 1
[trajectory]
kind = "multisine"
seconds = 4.0
centre = 0.1
amplitude = 0.2
frequencies_hz = [0.5, 1.0]
count = 2
speed = 1.0
[controller]
kp = 4.0
kd = 0.5
[parameters]
FV1 = 0.01
"""
OUTPUTS = {
    "identify": ["identify", "study.toml", "--out", "out", "--quiet"],
    "export": ["export", "result", "--to", "c", "--to", "json", "--out", "out", "--quiet", "--force"],
    "report": ["report", "result", "--out", "out.html", "--quiet"],
    "channels": ["channels", "log.csv", "check.csv", "--device", "device.toml", "--out", "out.toml"],
    "excite": [
        *("excite", "phantom_premium_15", "--centre", "0,0.2,0.3", "--stroke", "0.3", "--speed", "3"),
        *("--max-evaluations", "20", "--out", "out.toml"),
    ],
    "bench": ["bench", "phantom_premium_15", "experiment.toml", "--truth", "--out", "out.parquet"],
    "demo": ["demo", "phantom", "--out", "out", "--quiet"],
}


class SmallDemo:
    """Stands for a kind of demonstration whose simulations take minutes: its files are written as those of all are."""

    def __init__(self, of: Any) -> None:
        self.plan = of.plan

    def takes(self, *_: object) -> list[object]:
        return []

    def find(self, *_: object) -> dict[str, float]:
        return {"error": 1.0}

    def write_files(self, _: object, folder: Path) -> None:
        write_csv(folder / "table1.csv", [["name", "value"], *([f"p{k}", k] for k in range(30))])

    def values(self, found: dict[str, float]) -> dict[str, float]:
        return found

    def sections(self, _: object) -> list[object]:
        return []


def registry(folder: Path) -> dict[str, Any]:
    """What the index of a folder does when its calls fail: the next one over the same folder has every file."""

    def entries(index: Index) -> list[str]:
        index.refresh()
        return sorted(one.path for kind in ("device", "study", "log") for one in index.search(kind))

    root, found = folder / "registry", {"calls": 0, "failed": 0, "findings": list[str]()}
    for name, file in (("devices", "device.toml"), ("studies", "study.toml"), ("logs", "log.csv")):
        (root / name).mkdir(parents=True)
        (root / name / file).write_bytes((folder / file).read_bytes())
    with fault(0, full_disk) as count:
        index = Index(root, root / "index")
        wanted = entries(index)
        index.close()
    found["calls"] = count.calls
    for at in range(1, count.calls + 1):
        (root / "index").unlink(missing_ok=True)
        with fault(at, full_disk), contextlib.suppress(OSError):
            index = Index(root, root / "index")
            entries(index)
        (root / "devices" / "device.toml").touch()  # what could not be read counts again once it has changed
        (root / "studies" / "study.toml").touch()
        (root / "logs" / "log.csv").touch()
        index = Index(root, root / "index")
        if entries(index) != wanted:
            found["findings"].append(f"call {at}: the next index has {entries(index)}")
        index.close()
        found["failed"] += 1
    return found


def status(arguments: list[str]) -> int:
    """Exit status of a command in this process."""
    from haptid.cli import app

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            return int(app(arguments, standalone_mode=False) or 0)
        except SystemExit as end:
            return int(end.code or 0)
        except Exception as error:
            return int(getattr(error, "exit_code", 3))


def failures(name: str, folder: Path, every: int = 1) -> dict[str, Any]:
    """What one command does when its calls fail.

    Args:
        name: of the command.
        folder: with the files that `prepare` makes; it must be the current one.
        every: only every n-th call.
    """
    found: dict[str, Any] = {"calls": 0, "failed": 0, "findings": []}
    with fault(0, full_disk) as count:
        assert status(OUTPUTS[name]) == 0, name
    names, found["calls"] = set(state(folder)), count.calls
    for at in range(1, count.calls + 1, every):
        with fault(at, full_disk):
            ended = status(OUTPUTS[name])
        found["failed"] += ended != 0
        what = f"exit status {ended}" if ended not in (0, 2) else wrong(folder, names, torn=True)
        if what:
            found["findings"].append(f"call {at}: {what}")
    assert status(OUTPUTS[name]) == 0, name
    left = wrong(folder, names, torn=False)
    found["findings"] += [f"after the next run: {left}"] if left else []
    return found


def prepare(folder: Path) -> None:
    """A study, a result and an experiment."""
    study(folder)
    (folder / "experiment.toml").write_text(EXPERIMENT)
    assert status(["identify", "study.toml", "--out", "result", "--quiet"]) == 0


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which computes one result only: what fails is its writing."""
    made: list[Any] = []

    def kept(*given: Any, **options: Any) -> Any:
        if not made:
            made.append(function(*given, **options))
        return made[0]

    return kept


def main() -> int:
    """All commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--command", action="append", choices=[*OUTPUTS, "registry"])
    parser.add_argument("--every", type=int, default=1, help="only every n-th call")
    given = parser.parse_args()
    table = {}
    plain = identification.identify
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        prepare(Path(name))
        small = mock.patch.dict(demos._KINDS, {kind: SmallDemo(of) for kind, of in demos._KINDS.items()})
        with mock.patch.object(identification, "identify", once(plain)), small:
            for command in given.command or [*OUTPUTS, "registry"]:
                made = registry(Path(name)) if command == "registry" else failures(command, Path(name), given.every)
                table[command] = made
                sys.stdout.write(f"{command}: {table[command]}\n")
                sys.stdout.flush()
                for path in Path(name).glob("out*"):
                    path.rename(path.with_name(f"of-{command}-{path.name}"))
    if given.out:
        given.out.write_text(json.dumps(table, indent=1) + "\n")
    return int(any(row["findings"] for row in table.values()))


if __name__ == "__main__":
    sys.exit(main())
