"""Import every URDF and MJCF of some packages: share exact, approximate and refused, and differences from peers.

    python benchmarks/robot_files.py FOLDER --out results.csv [--every N]

FOLDER is where the packages are installed (`pip install --no-deps --target FOLDER example-robot-data robosuite
dm-control gymnasium-robotics pybullet dexmate-urdf hello-robot-stretch-urdf openarm-mujoco`); these are too large for
the test suite. Every file is read in a process of its own, so that a crash or a hang is counted and ends nothing else.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from collections import Counter
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


def main() -> None:
    """Run the sweep and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--child", action="store_true")
    parser.add_argument("--every", type=int, default=1, help="only every n-th file")
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.folder, {"root": str(options.out)})))
        return
    files = robots(options.folder)[:: options.every]
    rows = []
    for path in files:
        started = time.perf_counter()
        command = [sys.executable, __file__, str(path), "--out", str(options.folder), "--child"]
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
            row = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {}
            if not row:
                row = {"result": "traceback", "reason": done.stderr.decode(errors="replace")[-300:]}
        except subprocess.TimeoutExpired:
            row = {"result": "too slow"}
        rows.append({"file": str(path.relative_to(options.folder)), "seconds": time.perf_counter() - started} | row)
    names = ("file", "result", "peer", "joints", "torque", "gap", "difference", "seconds", "reason")
    with options.out.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, names)
        writer.writeheader()
        writer.writerows(rows)
    for key in ("result", "peer"):
        print(key, dict(Counter(str(row.get(key, "")).partition(":")[0] for row in rows)))
    loads = [row for row in rows if row.get("peer") == "loads"]
    read = [row for row in loads if row["result"] in ("exact", "approximate")]
    print(f"of {len(loads)} files that a peer loads, {len(read)} are imported")
    print(f"compared with the peer: {sum('difference' in row for row in read)}")


if __name__ == "__main__":
    main()
