"""One peer, in its own environment: `python run_peer.py FOLDER PEER values|times WORK...`, FOLDER having case.npz.

`values` writes FOLDER/PEER.npz, its values at the samples; `times` writes FOLDER/PEER.json, microseconds per sample.
A peer that is not installed ends with the status `LEFT_OUT` and the reason on standard error.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np

LEFT_OUT = 3


def main() -> None:
    """See the module."""
    folder, name, what, *requested = sys.argv[1:]
    case = dict(np.load(Path(folder) / "case.npz"))
    try:
        made = importlib.import_module(f"peers.{name}").works(case, Path(folder))
    except (ImportError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        raise SystemExit(LEFT_OUT) from None
    works = {work: made[work] for work in requested if work in made}
    if what == "values":
        np.savez(Path(folder) / f"{name}.npz", **{work: one.values() for work, one in works.items()})
        return
    times = {work: one.microseconds() for work, one in works.items()}
    (Path(folder) / f"{name}.json").write_text(json.dumps(times), encoding="utf-8")


if __name__ == "__main__":
    main()
