"""Cache of R factors on disk, so that an interrupted run of long motions continues where it stopped."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from haptid._core import __version__
from haptid._internal.arrays import Array
from haptid._internal.kept_parts import KeptParts
from haptid._internal.late import dataclass
from haptid.observation.plan import Plan, RFactors

# Fewest samples of a motion that is cached; a shorter one is reduced again faster than its R factors are read.
LEAST_KEPT = 2**19
# Places in a motion that its fingerprint contains, and samples at each: a place in a log on disk costs reading a chunk.
_PLACES, _SAMPLES = 16, 4

# Rows start..stop of one of several plans: index of the plan, start, stop.
CachedPart = tuple[int, int, int]


@dataclass(frozen=True)
class RFactorCache(KeptParts):
    """R factors of parts of motions in a folder, one file for each part.

    Attributes:
        least: fewest samples of a motion whose parts are cached.
    """

    least: int = LEAST_KEPT

    def files(self, plans: Sequence[Plan], parts: Sequence[CachedPart]) -> list[Path | None]:
        """The file of each part; None for a part that is not cached."""
        long = [len(plan.motion) >= self.least and plan.motion.log is not None for plan in plans]
        names = [fingerprint(plan) if worth else None for plan, worth in zip(plans, long, strict=True)]
        return [self.folder / f"{names[k]}-{start}-{stop}.npz" if names[k] else None for k, start, stop in parts]

    def read(self, path: Path) -> RFactors | None:
        """The content of a file; None where there is none or it cannot be read."""
        try:
            with path.open("rb") as stream, np.load(stream) as file:
                stacks = [(file[f"columns{k}"], file[f"triangles{k}"]) for k in range((len(file.files) - 1) // 2)]
                return stacks, file["rows"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def write(self, path: Path, factors: RFactors) -> None:
        """Keep the R factors of a part."""
        stacks, rows = factors
        arrays = {f"columns{k}": columns for k, (columns, _) in enumerate(stacks)}
        arrays |= {f"triangles{k}": r_factors for k, (_, r_factors) in enumerate(stacks)}
        buffer = io.BytesIO()
        np.savez(buffer, rows=rows, **arrays)  # type: ignore[arg-type]
        self.put(path, buffer.getvalue())


def fingerprint(plan: Plan) -> str:
    """Hash of everything that a plan's R factors depend on: the log's bytes, channels and notes, treatment, device.

    The device enters as its file and with the current settings of its terms, because nonlinear constants are searched
    and friction by load is fitted. Samples of positions and torques enter because the log does not record what was
    subtracted from a motion's torque, such as a payload.
    """
    model, motion = plan.model, plan.motion
    assert motion.log is not None
    content = (
        __version__,
        model.device.tables.model_dump_json(by_alias=True),
        model.device.gravity.tolist(),
        model.base.names,
        [(term.settings, repr(term.shape) if term.historic else "") for term in model.terms],
        None if model.load is None else model.load.tolist(),
        [model.terms[k].constant(constant.name) for k, constant in model.device.searched],
        motion.log.sha256,
        repr(motion.log.channels),
        motion.log.notes,
        repr(motion.treatment),
        (motion.t0, motion.dt, len(motion), plan.first, plan.rows, plan.block),
        [_some(signals, plan.first) for signals in (motion.q, motion.tau)],
    )
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:24]


def _some(signals: Array, first: int) -> list[list[float]]:
    """Samples at PLACES places between the first and the last."""
    starts = np.linspace(first, len(signals) - _SAMPLES, _PLACES, dtype=int).tolist()
    return [row for k in starts for row in signals[k : k + _SAMPLES].tolist()]
