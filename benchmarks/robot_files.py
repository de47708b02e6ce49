"""Import every URDF and MJCF of some packages: share exact, approximate and refused, and differences from peers.

    python benchmarks/robot_files.py FOLDER --out results.csv [--every N] [--first K]

FOLDER is where the packages are installed (`pip install --no-deps --target FOLDER example-robot-data robosuite
dm-control gymnasium-robotics pybullet dexmate-urdf hello-robot-stretch-urdf openarm-mujoco`); these are too large for
the test suite. Every file is read in a process of its own, so that a crash or a hang is counted and ends nothing else.
Files that OUT has already are not read again, so that the sweep can be done in pieces.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import multiprocessing
import time
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

SECONDS = 180


def child(path: Path, packages: dict[str, str]) -> dict[str, Any]:
    """One file: what the import says, and what Pinocchio or MuJoCo say of the same file."""
    from haptid.errors import HaptidError
    from haptid.robot_files import import_robot

    made: dict[str, Any] = {"peer": _peer(path)}
    try:
        robot = import_robot(path, packages=packages)
    except HaptidError as error:
        return made | {"result": "refused", "reason": str(error).replace(str(path), "")[:300]}
    made |= {"result": "exact" if robot.is_exact else "approximate", "joints": len(robot.device.joints)}
    made |= {"torque": robot.check.torque, "gap": robot.check.gap}
    if made["peer"] == "loads":
        try:
            made["difference"] = import_robot(path, packages=packages, ask=True).check.others
        except HaptidError as error:
            made["reason"] = str(error).replace(str(path), "")[:300]
    return made


def _peer(path: Path) -> str:
    try:
        if "<mujoco" in path.read_text(errors="replace") and path.suffix == ".xml":
            import mujoco

            model = mujoco.MjModel.from_xml_path(str(path))
            return "loads" if model.njnt else "nothing moves"
        import pinocchio

        model = pinocchio.buildModelFromUrdf(str(path))
        return "loads" if model.nv else "nothing moves"
    except Exception as error:
        return f"refuses: {' '.join(str(error).split())[:100]}"


def robots(folder: Path) -> list[Path]:
    """URDF and MJCF files below a folder."""
    urdf = [path for path in folder.rglob("*.urdf") if path.is_file()]
    heads = ((path, path.read_text(errors="replace")[:20000]) for path in folder.rglob("*.xml") if path.is_file())
    return sorted([*urdf, *(path for path, head in heads if "<mujoco" in head)])


def alone(path: Path, folder: Path) -> dict[str, Any]:
    """What becomes of a file, in a process of its own."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(path, folder, theirs))
    process.start()
    theirs.close()
    try:
        row: dict[str, Any] = ours.recv() if ours.poll(SECONDS) else {"result": "too slow"}
    except EOFError:
        process.join()
        row = {"result": "traceback", "reason": f"exit code {process.exitcode}"}
    process.kill()
    process.join()
    return {key: v.replace(f"{folder}/", "") if isinstance(v, str) else v for key, v in row.items()}


def _answer(path: Path, folder: Path, link: Connection) -> None:
    with contextlib.redirect_stderr(io.StringIO()) as said:
        try:
            link.send(child(path, {"root": str(folder)}))
        except Exception as error:
            link.send({"result": "traceback", "reason": f"{error!r} {said.getvalue()}"[-300:]})


def write(out: Path, done: dict[str, dict[str, Any]]) -> None:
    """Write the table, whole after each file."""
    names = ("file", "result", "peer", "joints", "torque", "gap", "difference", "seconds", "reason")
    with out.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, names)
        writer.writeheader()
        writer.writerows(done[name] for name in sorted(done))


def main() -> None:
    """Run the sweep and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1, help="only every n-th file")
    parser.add_argument("--first", type=int, default=0, help="from this file on")
    options = parser.parse_args()
    import haptid.robot_files  # noqa: F401  (before the processes are forked, so that each has it)

    done: dict[str, dict[str, Any]] = {}
    if options.out.exists():
        with options.out.open(newline="") as stream:
            done = {row["file"]: dict(row) for row in csv.DictReader(stream)}
    for path in robots(options.folder)[options.first :: options.every]:
        name, started = str(path.relative_to(options.folder)), time.perf_counter()
        if name not in done:
            row = alone(path, options.folder)
            done[name] = {"file": name, "seconds": round(time.perf_counter() - started, 1)} | row
            write(options.out, done)
    rows = list(done.values())
    for key in ("result", "peer"):
        print(key, dict(Counter(str(row.get(key, "")).partition(":")[0] for row in rows)))
    loads = [row for row in rows if row.get("peer") == "loads"]
    read = [row for row in loads if row["result"] in ("exact", "approximate")]
    print(f"of {len(loads)} files that a peer loads, {len(read)} are imported")
    print(f"compared with the peer: {sum(bool(row.get('difference')) for row in read)}")


if __name__ == "__main__":
    main()
