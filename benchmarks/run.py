"""`make bench`: every benchmark, kept under `benchmarks/results/`, and one table of all that is beside peers.

With a back end that the environment variable `HAPTID_BACKEND` demands, records have its name behind theirs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
from pathlib import Path

import bench_identification
import beside_nicegui
import characterisation
import codegen
import command_time
import coverage
import diagnosis
import dynamics
import efficiency
import estimator_benchmark
import estimators
import exciting_motion
import file_to_result
import groupings
import in_the_loop
import instructions
import kernel
import live
import long_log
import loops
import medical_study
import motion_quality
import next_motion
import noisy_columns
import past_one_machine
import payloads
import phantom_study
import simulated_coverage
import speed_report
import start_up
import virtual_bench
import workbench
import worst_case
from haptid import _core
from zoo import study as zoo_study

HERE = Path(__file__).parent
STUDIES = {
    "kernel": kernel.run,
    "dynamics": dynamics.run,
    "start-up": start_up.run,
    "command-time": command_time.run,
    "long-log": long_log.run,
    "past-one-machine": past_one_machine.run,
    "file-to-result": file_to_result.run,
    "coverage": coverage.run,
    "virtual-bench": virtual_bench.run,
    "bench-identification": bench_identification.run,
    "payloads": payloads.run,
    "phantom-study": phantom_study.run,
    "medical-study": medical_study.run,
    "groupings": groupings.run,
    "diagnosis": diagnosis.run,
    "efficiency": efficiency.run,
    "estimators": estimators.run,
    "exciting-motion": exciting_motion.run,
    "motion-quality": motion_quality.run,
    "next-motion": next_motion.run,
    "characterisation": characterisation.run,
    "codegen": codegen.run,
    "in-the-loop": in_the_loop.run,
    "instructions": instructions.run,
    "loops": loops.run,
    "noisy-columns": noisy_columns.run,
    "simulated-coverage": simulated_coverage.run,
    "estimator-benchmark": estimator_benchmark.run,
    "workbench": workbench.run,
    "worst-case": worst_case.run,
    "live": live.run,
    "beside-nicegui": beside_nicegui.run,
    "zoo": zoo_study.run,
}


def main() -> None:
    """Run what was asked for, print it, keep it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*STUDIES, []], help="which; all where none is named")
    names = parser.parse_args().names or STUDIES
    for name in names:
        figures, where = STUDIES[name](), machine()
        print(f"\n{name} ({', '.join(where.values())})")
        for what, figure in figures.items():
            print(f"  {what:75s} {figure:12.4g}")
        text = json.dumps({"where": where, "figures": figures}, indent=1)
        demanded = os.environ.get("HAPTID_BACKEND")
        record = f"{name}-{demanded}.json" if demanded else f"{name}.json"
        (HERE / "results" / record).write_text(text + "\n", encoding="utf-8")
    if not speed_report.STUDIES.isdisjoint(names):
        print("\n" + speed_report.table(speed_report.recorded()))


def machine() -> dict[str, str]:
    """What the figures were measured on, and of which commit."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE, check=False
    )
    return {
        "machine": platform.machine(),
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "backend": os.environ.get("HAPTID_BACKEND", _core.backends()[0]),
        "commit": commit.stdout.strip(),
    }


def processor() -> str:
    """Name of the model, as far as the system tells it."""
    listed = Path("/proc/cpuinfo")
    text = listed.read_text(encoding="utf-8") if listed.exists() else ""
    found = re.search(r"^model name\s*:\s*(.*)$", text, re.MULTILINE)
    return found[1] if found else platform.processor()


if __name__ == "__main__":
    main()
