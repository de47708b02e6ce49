"""Mutations of logs of every format: each is read, or is one LogError, in bounded time and memory.

Run `python benchmarks/fuzz_logs.py --tries 2000 --out benchmarks/results/fuzz_logs.json`. Bytes are changed, blocks are
copied, swapped, set to 0 or 255, and files are cut. A try that raises another exception, lasts over 10 s or makes
the process grow by more than 1 GiB is a finding; its bytes are kept in the folder of --keep.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SLOWEST, LARGEST_MB = 10.0, 1024.0


def seeds(folder: Path) -> dict[str, tuple[Path, list[str]]]:
    """A small file of each format, and channels of it."""
    import h5py
    import nptdms
    import pyarrow as pa
    import scipy.io
    from pyarrow import parquet

    import recorders

    stamps, q, tau = recorders.arm(200)
    kind, names = "sensor_msgs/msg/JointState", ("a", "b", "c")

    def said(store: Any = recorders.STORE) -> Any:
        for k, stamp in enumerate(stamps):
            s = recorders.START + int(stamp)
            yield "/j", s, kind, recorders.joint_state(s, names, q[k], tau[k], store=store)

    wanted = ["/j@header", "/j.position[a]", "/j.effort[c]"]
    files = {
        "mcap": (recorders.ros2(folder / "mcap", said()), wanted),
        "db3": (recorders.ros2(folder / "db3", said(), "db3"), wanted),
        "bag": (recorders.ros1(folder / "log.bag", said(recorders.STORE1)), wanted),
        "bag, lz4": (recorders.ros1(folder / "lz4.bag", said(recorders.STORE1), "LZ4"), wanted),
    }
    texts = [json.dumps({"t": k, "j": [{"name": "a", "q": float(p)}]}).encode() for k, p in enumerate(q[:, 0])]
    sent = [("/j", int(s), text) for s, text in zip(stamps, texts, strict=True)]
    schema = {"/j": ("J", "jsonschema", b"{}", "json")}
    files["mcap, json"] = (recorders.mcap(folder / "json.mcap", sent, schema, "none"), ["/j.t", "/j.j[a].q"])
    table = {"t": stamps * 1e-9, "q1": q[:, 0], "tau1": tau[:, 0]}
    rows = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in zip(*table.values(), strict=True))
    (folder / "log.csv").write_text("t q1 tau1\n" + rows)
    parquet.write_table(pa.table(table | {"list": pa.array(q.tolist())}), folder / "log.parquet")
    np.savez_compressed(folder / "log.npz", **table)
    np.save(folder / "log.npy", q)
    scipy.io.savemat(folder / "log.mat", table, do_compression=True)
    with h5py.File(folder / "log.h5", "w") as file:
        for name, column in table.items():
            file[name] = column
    with nptdms.TdmsWriter(folder / "log.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("g", name, column) for name, column in table.items()])
    records = [{"t": k, "name": ["a", "b"], "q": [float(p), 1.0], "s": {"x": None}} for k, p in enumerate(q[:, 0])]
    (folder / "log.jsonl").write_text("\n".join(map(json.dumps, records)))
    (folder / "log.json").write_text(json.dumps({"rec": {name: column.tolist() for name, column in table.items()}}))
    (folder / "rows.txt").write_text("\n".join(" ".join([name, *map(repr, x.tolist())]) for name, x in table.items()))
    plain = {f"log.{s}": (folder / f"log.{s}", [*table]) for s in ("csv", "parquet", "npz", "mat", "h5")}
    plain["log.parquet"] = (folder / "log.parquet", ["t", "list[2]"])
    plain |= {
        "jsonl": (folder / "log.jsonl", ["t", "q[a]", "s.x"]),
        "json": (folder / "log.json", ["rec.t", "rec.q1"]),
        "rows.txt": (folder / "rows.txt", ["t", "q1"]),
    }
    return files | plain | {"npy": (folder / "log.npy", ["data[1]"]), "tdms": (folder / "log.tdms", ["g.t", "g.q1"])}


def mutated(raw: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one to six changes, and cut in a fifth of all cases."""
    changed = bytearray(raw)
    for _ in range(rng.integers(1, 7)):
        at, other = (int(k) for k in rng.integers(0, len(raw), 2))
        size = int(rng.integers(1, 17))
        how = rng.integers(5)
        if how == 0:
            changed[at : at + size] = bytes(len(changed[at : at + size]))
        elif how == 1:
            changed[at : at + size] = b"\xff" * len(changed[at : at + size])
        elif how == 2:
            changed[at : at + size] = changed[other : other + size]
        else:
            changed[at % len(changed)] = int(rng.integers(256))
    return bytes(changed[: int(rng.integers(1, len(changed)))] if rng.random() < 0.2 else changed)


def tried(action: Callable[[], Any]) -> str:
    from haptid.errors import LogError

    begin = time.perf_counter()
    try:
        action()
        found = "read"
    except LogError:
        found = "refused"
    except Exception as error:
        found = f"FINDING {type(error).__name__}: {str(error)[:100]}"
    return f"FINDING {time.perf_counter() - begin:.0f} s" if time.perf_counter() - begin > SLOWEST else found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tries", type=int, default=2000, help="of each format")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--only", nargs="*", help="formats by name; all by default")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    from haptid.log.read import format_of
    from haptid.log.request import Request

    warnings.simplefilter("ignore")
    found: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (path, wanted) in seeds(Path(folder)).items():
            if given.only and name not in given.only:
                continue
            raw, rng, counts = path.read_bytes(), np.random.default_rng(given.seed), Counter[str]()
            reader = format_of(path)
            for _ in range(given.tries):
                path.write_bytes(mutated(raw, rng))
                before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                result = tried(lambda: (reader.names(path), reader.columns(path, wanted, Request())))  # noqa: B023
                grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
                result = f"FINDING {grown:.0f} MB" if grown > LARGEST_MB else result
                counts[result] += 1
                if result.startswith("FINDING"):
                    given.keep.mkdir(exist_ok=True)
                    (given.keep / f"{len(list(given.keep.iterdir()))}{path.suffix}").write_bytes(path.read_bytes())
            found[name] = counts
            print(f"{name:12} {dict(counts)}", flush=True)
    if given.out:
        given.out.write_text(json.dumps({"tries": given.tries, "seed": given.seed, "formats": found}, indent=2) + "\n")
    return int(any(key.startswith("FINDING") for counts in found.values() for key in counts))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    sys.exit(main())
