"""The main job from beginning to end: record a haptic device on the bench, identify it, look how near the truth it is.

python examples/demo.py --out demo
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from haptid.experiment import bench

HERE = Path(__file__).parent


def main() -> int:
    """Run the demo; its exit status is that of `haptid identify`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for logs and results")
    folder = parser.parse_args().out
    logs, out = folder / "logs", folder / "result"
    console = Console()
    console.print("[bold]1[/] haptid bench phantom_premium_15 examples/phantom/experiment.toml, twice", highlight=False)
    logs.mkdir(parents=True, exist_ok=True)
    experiment = HERE / "phantom" / "experiment.toml"
    seeds = {"sweep": 1, "check": 2}
    bench.make_logs(
        [
            bench.Job("phantom_premium_15", experiment, logs / f"{name}.parquet", truth=True, seed=seed)
            for name, seed in seeds.items()
        ]
    )
    console.print("[bold]2[/] haptid identify examples/phantom/bench-study.toml", highlight=False)
    study = str(HERE / "phantom" / "bench-study.toml")
    command = [sys.executable, "-m", "haptid", "identify", study, "--data", str(logs), "--out", str(out)]
    status = subprocess.run(command, check=False).returncode
    if (out / "result.json").exists():
        console.print("\n[bold]3[/] Against the truth the logs were made from")
        console.print(against_truth(json.loads((logs / "sweep.truth.json").read_text())["base"], out / "result.json"))
        console.print(f"Pictures: {', '.join(str(p) for p in sorted(out.glob('*.svg')))}", highlight=False)
    return status


def against_truth(truth: dict[str, float], result: Path) -> Table:
    """Parameter, truth, interval, and whether the one is in the other."""
    table = Table(box=None)
    for heading in ("parameter", "truth", "identified", "95 % interval", ""):
        table.add_column(heading, justify="right")
    for p in json.loads(result.read_text())["estimate"]["parameters"]:
        low, high = p["conf_int"]
        inside = low <= truth[p["name"]] <= high
        row = (
            f"{truth[p['name']]:.3e}",
            f"{p['value']:.3e}",
            f"{low:.3e} .. {high:.3e}",
            "inside" if inside else "outside",
        )
        table.add_row(p["name"], *row)
    return table


if __name__ == "__main__":
    sys.exit(main())
