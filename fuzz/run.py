"""Run the fuzzers: `python -m fuzz.run --minutes 10 [--target NAME ...] [--seed N]`.

Mutations of the seeds are read in a child process with limits of memory and time. An input whose outcome is new (the
class of the error and its sentence without names and numbers) is kept as a further seed of the run, so that the search
follows behaviour and not chance alone. Anything but a result or an error of haptid is a finding: another exception, a
process that dies, more than so many seconds or bytes. Findings are written to `fuzz/findings`; exit status 1.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import os
import random
import re
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

from fuzz.targets import TARGETS, Target

HERE = Path(__file__).parent
# Inputs of one child process; the longest time of one input, s; memory beyond that at the start, bytes.
BATCH, LONGEST, MEMORY = 100, 20.0, 2**31
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
        kind = rng.randrange(9 if text else 6)
        at = rng.randrange(len(made) + 1)
        size = min(rng.choice((1, 2, 4, 8, 64, 1024)), len(made) - at)
        if kind == 0 and at < len(made):
            made[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(made):
            made[at] = rng.randrange(256)
        elif kind == 2:
            del made[at : at + size]
        elif kind == 3:
            made[at:at] = made[at : at + size] * rng.choice((1, 1, 2, 50))
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
    """What an input does, without names and numbers, and the traceback of a finding."""
    try:
        target.run(data, folder)
    except target.allowed as error:
        sentence = re.sub(r"\"[^\"]*\"|'[^']*'|`[^`]*`|[-+0-9.eE]*[0-9]|/\S+", "_", str(error))
        if "more memory than is available" in str(error):
            return "memory", traceback.format_exc()
        return f"{type(error).__name__}: {sentence[:120]}", ""
    except BaseException as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"finding {type(error).__name__} {Path(frame.filename).name}:{frame.name}", traceback.format_exc()
    return "read", ""


def batch(target: Target, inputs: list[bytes]) -> list[tuple[str, str]]:
    """Outcomes of inputs in a child process, up to the one at which it died or did not come back."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        _work(target, inputs, writing)
    os.close(writing)
    found: list[tuple[str, str]] = []
    rest, ended = b"", False
    while len(found) < len(inputs):
        ready, _, _ = select.select([reading], [], [], LONGEST)
        if not ready:
            found.append((f"finding: more than {LONGEST:g} s", ""))
            break
        block = os.read(reading, 2**16)
        if not block:
            ended = True
            break
        *lines, rest = (rest + block).split(b"\0\0")
        for line in lines:
            what, _, trace = line.decode("utf-8", "replace").partition("\0")
            found.append((what, trace))
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    os.close(reading)
    if ended and len(found) < len(inputs):
        found.append((f"finding: process died, status {status}", ""))
    return found


def _work(target: Target, inputs: list[bytes], writing: int) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        for data in inputs:
            what, trace = outcome(target, data, Path(name))
            os.write(writing, f"{what}\0{trace}".encode("utf-8", "replace")[: 2**15] + b"\0\0")
    time.sleep(LONGEST)  # the parent ends this process


def fuzz(target: Target, seconds: float, seed: int) -> tuple[int, int, dict[str, tuple[bytes, str]]]:
    """Inputs read, outcomes seen and findings of one target."""
    rng = random.Random(seed)
    seeds = [path.read_bytes() for path in sorted((HERE / "seeds" / target.name).iterdir())]
    corpus, seen, findings, count = list(seeds), set[str](), {}, 0
    end = time.monotonic() + seconds
    todo = list(seeds)
    while time.monotonic() < end or todo:
        while len(todo) < BATCH:
            todo.append(mutated(rng.choice(corpus), rng.choice(corpus), target.text, rng))
        found = batch(target, todo)
        for data, (what, trace) in zip(todo, found, strict=False):
            if what not in seen:
                seen.add(what)
                if what.startswith(("finding", "memory")):
                    findings[what] = (data, trace)
                elif len(corpus) < MOST_KEPT:
                    corpus.append(data)
        count += len(found)
        todo = todo[len(found) :] if time.monotonic() < end else []
    return count, len(seen), findings


def main() -> int:
    """Run all targets, or those that are named, each for its share of the time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="of all targets together")
    parser.add_argument("--target", action="append", choices=[target.name for target in TARGETS])
    parser.add_argument("--seed", type=int, default=None, help="of the random numbers (default: the time)")
    given = parser.parse_args()
    chosen = [target for target in TARGETS if not given.target or target.name in given.target]
    seed = int(time.time()) if given.seed is None else given.seed
    failed = False
    for target in chosen:
        count, outcomes, findings = fuzz(target, 60 * given.minutes / len(chosen), seed)
        sys.stdout.write(f"{target.name}: {count} inputs, {outcomes} outcomes, {len(findings)} findings, seed {seed}\n")
        for what, (data, trace) in findings.items():
            failed = True
            name = f"{target.name}-{hashlib.sha256(data).hexdigest()[:12]}"
            (HERE / "findings").mkdir(exist_ok=True)
            (HERE / "findings" / name).write_bytes(data)
            (HERE / "findings" / f"{name}.txt").write_text(f"{what}\n{trace}", encoding="utf-8")
            sys.stdout.write(f"  {what}: fuzz/findings/{name}\n")
        sys.stdout.flush()
    used = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    hours = sum(one.ru_utime + one.ru_stime for one in used) / 3600
    sys.stdout.write(f"{hours:.3f} processor-hours\n")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
