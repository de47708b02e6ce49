"""Many motions to observations at once: by whoever works, and going on from where an interrupted run has stopped."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptid._core import __version__
from haptid._internal.arrays import Array
from haptid._internal.workers import Executor, SerialExecutor
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import check_log
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation, Plan, Reduced, assemble

# Motions of fewer samples are reduced anew sooner than their triangles are read.
LEAST_KEPT = 2**19
# Places by which a motion is told from others of its log, and samples of each: a place on disk costs a chunk.
PLACES, SAMPLES = 16, 4


@dataclass(frozen=True)
class Part:
    """Rows start..stop of one of several plans."""

    plan: int
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class Reducer:
    """Parts of some plans to triangles."""

    plans: tuple[Plan, ...]

    def __call__(self, part: Part) -> Reduced:
        return self.plans[part.plan].reduce(part.start, part.stop)


@dataclass(frozen=True)
class RFactorCache:
    """Triangles in a folder, each part's in a file of its own that is there whole or not at all.

    Attributes:
        folder: made when the first is kept.
        least: of motions of so many samples.
    """

    folder: Path
    least: int = LEAST_KEPT

    def files(self, plans: Sequence[Plan], parts: Sequence[Part]) -> list[Path | None]:
        """The file of each part; None for one that is not worth keeping."""
        long = [len(plan.motion) >= self.least and plan.motion.log is not None for plan in plans]
        names = [fingerprint(plan) if worth else None for plan, worth in zip(plans, long, strict=True)]
        return [
            self.folder / f"{names[part.plan]}-{part.start}-{part.stop}.npz" if names[part.plan] else None
            for part in parts
        ]

    def read(self, path: Path) -> Reduced | None:
        """What is in a file; None where there is none that can be read."""
        try:
            with path.open("rb") as stream, np.load(stream) as file:
                stacks = [(file[f"columns{k}"], file[f"triangles{k}"]) for k in range((len(file.files) - 1) // 2)]
                return stacks, file["rows"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def write(self, path: Path, made: Reduced) -> None:
        """Written beside its place and put there in one step."""
        stacks, rows = made
        arrays = {f"columns{k}": columns for k, (columns, _) in enumerate(stacks)}
        arrays |= {f"triangles{k}": triangles for k, (_, triangles) in enumerate(stacks)}
        buffer = io.BytesIO()
        np.savez(buffer, rows=rows, **arrays)  # type: ignore[arg-type]
        self.folder.mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=self.folder, delete=False) as file:
            file.write(buffer.getbuffer())
        os.replace(file.name, path)

    def count(self) -> int:
        """Parts that are there, of whatever run."""
        return len(list(self.folder.glob("*.npz")))

    def forget(self) -> None:
        """Nothing is kept any more."""
        shutil.rmtree(self.folder, ignore_errors=True)


def fingerprint(plan: Plan) -> str:
    """Of all that the triangles of a plan are made of: the log's bytes, channels and notes, treatment, device.

    The device is what its file says, with its terms as they are at present: constants are searched, loads are settled.
    Some positions and torques too: something may have been taken off a motion's that its log knows nothing of.
    """
    model, motion = plan.model, plan.motion
    assert motion.log is not None
    said = (
        __version__,
        model.device.tables.model_dump_json(by_alias=True),
        model.device.gravity.tolist(),
        model.base.names,
        [term.settings for term in model.terms],
        None if model.load is None else model.load.tolist(),
        [model.terms[k].constant(constant.name) for k, constant in model.device.searched],
        motion.log.sha256,
        repr(motion.log.channels),
        motion.log.notes,
        repr(motion.treatment),
        (motion.t0, motion.dt, len(motion), plan.first, plan.rows, plan.block),
        [_some(signals, plan.first) for signals in (motion.q, motion.tau)],
    )
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:24]


def _some(signals: Array, first: int) -> list[list[float]]:
    """Some samples, from the first to the last."""
    where = np.linspace(first, len(signals) - SAMPLES, PLACES, dtype=int).tolist()
    return [row for k in where for row in signals[k : k + SAMPLES].tolist()]


Progress = Callable[[Motion, float], None]


def observe_all(
    model: DynamicModel,
    motions: Sequence[Motion],
    workers: Executor | None = None,
    kept: RFactorCache | None = None,
    progress: Progress | None = None,
) -> tuple[Observation, ...]:
    """The observation of each motion, as `observe` makes it.

    Args:
        model: the dynamic model.
        motions: treated signals.
        workers: who does it, stretch by stretch; this process where None.
        kept: where triangles of long motions are kept, and taken from; nowhere where None.
        progress: called with a motion and the share of its rows that are done, 0 to 1.

    Raises:
        WorkerLostError: a stretch was lost with one worker after the other.
        HaptidError: as `observe` does.
    """
    for motion in motions:
        if motion.log:
            check_log(model.device, motion.log)
    plans = tuple(Plan.of(model, motion) for motion in motions)
    parts = [Part(k, start, stop) for k, plan in enumerate(plans) for start, stop in plan.segments()]
    rows, done = [0] * len(plans), {}
    for k, made in _reduced(plans, parts, workers or SerialExecutor(), kept):
        done[k] = made
        rows[parts[k].plan] += parts[k].stop - parts[k].start
        if progress:
            plan = plans[parts[k].plan]
            progress(plan.motion, rows[parts[k].plan] / plan.rows)
    return tuple(
        assemble(plan, [done[k] for k, part in enumerate(parts) if part.plan == which])
        for which, plan in enumerate(plans)
    )


def _reduced(
    plans: tuple[Plan, ...], parts: list[Part], workers: Executor, kept: RFactorCache | None
) -> Iterator[tuple[int, Reduced]]:
    """Index of a part and its triangles: first those that were kept, then the others as they are made."""
    files = kept.files(plans, parts) if kept else [None] * len(parts)
    missing = []
    for k, file in enumerate(files):
        found = kept.read(file) if kept and file else None
        if found is None:
            missing.append(k)
        else:
            yield k, found
    for m, made in workers.map(Reducer(plans), [parts[k] for k in missing]):
        file = files[missing[m]]
        if kept and file:
            kept.write(file, made)
        yield missing[m], made
