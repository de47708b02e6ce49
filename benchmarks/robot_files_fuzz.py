"""Mutations of robot descriptions: every one is imported or refused with one of haptid's own errors, in bounded time.

    python benchmarks/robot_files_fuzz.py FILE... --tries 20000

The test suite runs a few such tries; here each file is mutated `--tries` times. MJCF and xacro start a child process
for each try and take a second or so.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from haptid.errors import HaptidError
from haptid.robot_files import import_robot

WORDS = (b"nan", b"-1", b"1e308", b"0", b"", b'"', b"<", b">", b"base", b"&amp;", b"1e-320", b"\xff", b"\0", b"../")


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content with some stretches replaced, removed, doubled or exchanged."""
    made = bytearray(content)
    for _ in range(int(rng.integers(1, 3))):
        at, size = int(rng.integers(len(made) + 1)), int(rng.integers(1, 12))
        stretch = bytes(made[at : at + size])
        how = int(rng.integers(4))
        if how == 0:
            made[at : at + int(rng.integers(1, 12))] = WORDS[int(rng.integers(len(WORDS)))]
        elif how == 1:
            del made[at : at + size]
        elif how == 2:
            made[at:at] = stretch
        else:
            other = int(rng.integers(len(made) + 1))
            made[other : other + size] = stretch
    return bytes(made)


def main() -> None:
    """Run the tries, print counts and the slowest one, and keep what raised something else."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--tries", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    for file in options.files:
        content, counts, slowest = file.read_bytes(), Counter[str](), 0.0
        with tempfile.TemporaryDirectory() as folder:
            for k in range(options.tries):
                path = Path(folder) / file.name
                path.write_bytes(mutated(content, rng))
                started = time.perf_counter()
                try:
                    counts["imported" if import_robot(path).check.torque < 1e-8 else "wrong"] += 1
                except HaptidError as error:
                    counts[type(error).__name__] += 1
                except Exception:
                    counts["TRACEBACK"] += 1
                    kept = Path(f"fuzz-{file.stem}-{k}{file.suffix}")
                    kept.write_bytes(path.read_bytes())
                    print(kept, traceback.format_exc().splitlines()[-1])
                slowest = max(slowest, time.perf_counter() - started)
        print(f"{file.name}: {dict(counts)}, slowest {slowest:.1f} s")


if __name__ == "__main__":
    main()
