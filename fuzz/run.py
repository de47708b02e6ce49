"""Run the fuzzers: `python -m fuzz.run --minutes 10 [--target NAME ...] [--tries N] [--seeds FOLDER ...]`.

Mutations of the seeds are read in a child process with limits of memory and time. An input whose outcome is new (the
class of the error and its sentence without paths and numbers) is kept as a further seed of the run, so that the search
follows behaviour and not chance alone. Anything but a result or an error of haptid is a finding: another exception, a
process that dies, more than so many seconds or bytes. Findings are written to `fuzz/findings`; exit status 1.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path

from fuzz.targets import TARGETS, Target

HERE = Path(__file__).parent
# The most processor time, and time, of one input, s; memory of the process beyond that at the start, bytes.
LONGEST, WAITED, MEMORY = 20.0, 600.0, 2**30
# Inputs that a run keeps beside the seeds, and their largest size.
MOST_KEPT, LARGEST = 400, 2**18
WORDS = [
    *(b"0", b"-1", b"1e308", b"-1e-308", b"nan", b"inf", b"1e999", b"9" * 30, b"9" * 5000, b"true", b"null", b'""'),
    *(b"[]", b"{}", b"[[]]", b'"x"', b"[" * 200, b"\xff", b"\x00", b"\xc3\xa9", b"\x1b[2J", b'"', b"\n", b"'", b"\\"),
    *(b"," * 50, b"a." * 40, b"1" * 40, b"[0.0]", b"0.5", b"2"),
]
TOKEN = re.compile(rb"[A-Za-z_][A-Za-z0-9_]*|-?[0-9][0-9.eE+-]*|\"[^\"\n]*\"|\S")


def mutated(data: bytes, other: bytes, text: bool, rng: random.Random) -> bytes:
    """An input with one to eight changes."""
    made = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        kind = rng.choice((0, 2, 3, 4, *(6,) * 12)) if text else rng.randrange(6)
        at = rng.randrange(len(made) + 1)
        size = min(rng.choice((1, 2, 4, 8, 64, 1024)), len(made) - at)
        if kind == 0 and at < len(made):
            made[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(made):
            made[at] = rng.randrange(256)
        elif kind == 2:
            del made[at : at + size]
        elif kind == 3:
            made[at:at] = made[at : at + size] * rng.choice((1, 1, 2, 50, 1, 2, 50, 5000))
        elif kind == 4:
            start = rng.randrange(len(other) + 1)
            made[at : at + size] = other[start : start + size]
        elif kind == 5:
            made[at : at + 4] = rng.choice((b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\x80"))
        else:
            tokens = [m.span() for m in TOKEN.finditer(made, at, at + 400)]
            if tokens:
                low, high = rng.choice(tokens)
                mine = [m.group() for m in TOKEN.finditer(other, *_window(len(other), rng))]
                made[low:high] = rng.choice([*WORDS, *mine])
    return bytes(made[:LARGEST])


def _window(size: int, rng: random.Random) -> tuple[int, int]:
    start = rng.randrange(size + 1)
    return start, start + 400


def outcome(target: Target, data: bytes, folder: Path) -> tuple[str, str]:
    """What an input does, without paths and numbers, and the traceback of a finding."""
    try:
        target.run(data, folder)
    except target.allowed as error:
        sentence = re.sub(r"/\S+|[-+0-9.eE]*[0-9]", "_", str(error))
        return f"{type(error).__name__}: {sentence[:120]}", ""
    except BaseException as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"finding {type(error).__name__} {Path(frame.filename).name}:{frame.name}", traceback.format_exc()
    return "read", ""


class Worker:
    """A process that reads inputs of one target; started again after it died or did not come back."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self._start()

    def _start(self) -> None:
        # Not forked: threads of Arrow and BLAS do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self.link, other = context.Pipe()
        self.process = context.Process(target=_work, args=(self.target.name, other), daemon=True)
        self.process.start()
        other.close()
        self.link.recv()

    def read(self, data: bytes) -> tuple[str, str]:
        """The outcome of an input."""
        try:
            before, end = self._used(), time.monotonic() + WAITED
            self.link.send_bytes(data)
            while self._used() < before + LONGEST and time.monotonic() < end:
                if self.link.poll(1.0):
                    found: tuple[str, str] = self.link.recv()
                    return found
            what = f"finding: more than {LONGEST:g} s"
        except (EOFError, ConnectionError):
            self.process.join(1.0)
            what = f"finding: process died, exit code {self.process.exitcode}"
        self.stop()
        self._start()
        return what, ""

    def _used(self) -> float:
        """Processor time of the process, s; its time would count what else the machine does."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.join()


def _work(name: str, link: Connection) -> None:
    (target,) = (one for one in TARGETS if one.name == name)
    target.prepare()
    # Of addresses 16 times as many: libraries reserve what a file declares, and then find that it is not there.
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + 16 * MEMORY, used + 16 * MEMORY))
    warnings.simplefilter("ignore")
    before = _peak()
    link.send("ready")
    with tempfile.TemporaryDirectory() as folder:
        while True:
            found = outcome(target, link.recv_bytes(), Path(folder))
            link.send((f"finding: {MEMORY >> 20} MiB", "") if _peak() > before + MEMORY else found)


def _peak() -> int:
    """Largest memory of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def seeds_of(target: Target, folders: list[Path]) -> list[bytes]:
    """The seeds in the repository, and files of the target's kind in other folders."""
    more = [path for folder in folders for path in sorted(folder.rglob(f"*{target.suffix}")) if path.is_file()]
    paths = [*sorted((HERE / "seeds" / target.name).iterdir()), *(x for x in more if x.stat().st_size <= LARGEST)]
    return list(dict.fromkeys(path.read_bytes() for path in paths))


def fuzz(
    target: Target, seconds: float, seed: int, tries: int | None = None, folders: list[Path] | None = None
) -> tuple[int, int, dict[str, tuple[bytes, str]]]:
    """Inputs read, outcomes seen and findings of one target."""
    rng = random.Random(seed)
    seeds = seeds_of(target, folders or [])
    corpus, seen, findings, count = list(seeds), set[str](), {}, 0
    end = time.monotonic() + seconds
    worker = Worker(target)
    while (time.monotonic() < end and count != tries) or count < len(seeds):
        fresh = mutated(rng.choice(corpus), rng.choice(corpus), target.text, rng)
        data = seeds[count] if count < len(seeds) else fresh
        what, trace = worker.read(data)
        count += 1
        if what not in seen:
            seen.add(what)
            if what.startswith("finding"):
                findings[what] = (data, trace)
            elif len(corpus) < MOST_KEPT:
                corpus.append(data)
    worker.stop()
    return count, len(seen), findings


def main() -> int:
    """Run all targets, or those that are named, each for its share of the time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="of all targets together")
    parser.add_argument("--target", action="append", choices=[target.name for target in TARGETS])
    parser.add_argument("--tries", type=int, help="of each target, if its share of the time suffices")
    parser.add_argument("--seed", type=int, default=None, help="of the random numbers (default: the time)")
    parser.add_argument("--seeds", type=Path, nargs="*", default=[], help="folders with more files to start from")
    parser.add_argument("--record", type=Path, help="JSON file to whose counts those of this run are added")
    given = parser.parse_args()
    chosen = [target for target in TARGETS if not given.target or target.name in given.target]
    seed = int(time.time()) if given.seed is None else given.seed
    failed = False
    for target in chosen:
        before = hours()
        count, outcomes, findings = fuzz(target, 60 * given.minutes / len(chosen), seed, given.tries, given.seeds)
        sys.stdout.write(f"{target.name}: {count} inputs, {outcomes} outcomes, {len(findings)} findings, seed {seed}\n")
        for what, (data, trace) in findings.items():
            failed = True
            name = f"{target.name}-{hashlib.sha256(data).hexdigest()[:12]}"
            (HERE / "findings").mkdir(exist_ok=True)
            (HERE / "findings" / name).write_bytes(data)
            (HERE / "findings" / f"{name}.txt").write_text(f"{what}\n{trace}", encoding="utf-8")
            sys.stdout.write(f"  {what}: fuzz/findings/{name}\n")
        sys.stdout.flush()
        if given.record:
            kinds = len(seeds_of(target, given.seeds))
            record(given.record, target.name, count, kinds, outcomes, len(findings), hours() - before)
    sys.stdout.write(f"{hours():.3f} processor-hours\n")
    return int(failed)


def hours() -> float:
    """Processor time of this process and of those that have ended, h."""
    used = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(one.ru_utime + one.ru_stime for one in used) / 3600


def record(path: Path, name: str, count: int, seeds: int, outcomes: int, findings: int, spent: float) -> None:
    """Add one run of a target to the record: sums of inputs, findings and time, most seeds and outcomes."""
    made = json.loads(path.read_text()) if path.exists() else {}
    row = made.setdefault(name, {"inputs": 0, "seeds": 0, "outcomes": 0, "findings": 0, "processor_hours": 0.0})
    row["inputs"], row["findings"] = row["inputs"] + count, row["findings"] + findings
    row["seeds"], row["outcomes"] = max(row["seeds"], seeds), max(row["outcomes"], outcomes)
    row["processor_hours"] = round(row["processor_hours"] + spent, 4)
    path.write_text(json.dumps(made, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
