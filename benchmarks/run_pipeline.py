"""One pipeline from log to result in its own environment: `python run_pipeline.py NAME PATH SHORT`, robot next to PATH.

Prints as JSON the seconds of the processor from the file to the result, the peak memory, GiB, and the relative error of
the torque of its model on another motion, %. A first run on a short log imports everything.
A pipeline that is not installed ends with the status `LEFT_OUT`.
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

from run_peer import LEFT_OUT


def main() -> None:
    """See the module."""
    name, path, short = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    case = dict(np.load(path.with_suffix(".npz")))
    try:
        work, torque = importlib.import_module(f"pipelines.{name}").pipeline(case)
    except ImportError as error:
        print(error, file=sys.stderr)
        raise SystemExit(LEFT_OUT) from None
    work(short)
    begin = time.process_time()
    steps = work(path)
    seconds = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1) / 2**20
    off = np.linalg.norm(torque() - case["tau"]) / np.linalg.norm(case["tau"])
    print(json.dumps({"seconds": seconds, "memory": peak, "error": 100 * float(off), **steps}))


if __name__ == "__main__":
    main()
