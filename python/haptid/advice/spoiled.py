"""Parts of logs in which the model does not hold, as the diagnosis finds them: slip, and limit cycles at rest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.inference.diagnosis.limit_cycle import swinging_parts
from haptid.inference.diagnosis.torsion import between_slips
from haptid.motion.channels import position_channels


@dataclass(frozen=True, eq=False)
class SpoiledPart:
    """Samples of a log in which the model does not hold.

    Attributes:
        kind: "slip": all but the longest part without one, since the springs' rest is another one behind each; or
            "limit cycle": a held joint swings within play or dry friction.
        places: where.
        log: of which motion.
        samples: which, (n,).
    """

    kind: str
    places: tuple[str, ...]
    log: int
    samples: np.ndarray


def spoiled_parts(estimate: Estimate) -> Iterator[SpoiledPart]:
    """Those of the logs of an estimate; slip in the first one alone."""
    motions, device = estimate.observation.motions, estimate.model.device
    found = between_slips(estimate)
    if found is not None and motions[0].log is not None:
        (low, high), t = found[1], np.asarray(motions[0].log.t)
        yield SpoiledPart("slip", found[0], 0, (t < low) | (t > high))
    for k, motion in enumerate(motions):
        if motion.log is None:
            continue
        channels, parts = swinging_parts(motion.log)
        if parts:
            side, t = motion.log.channels.position.side, np.asarray(motion.log.t)
            names = position_channels(device, side)
            spoiled = np.any([(t >= low) & (t < high) for low, high in parts], axis=0)
            yield SpoiledPart("limit cycle", tuple(f"{side} {names[c]}" for c in channels), k, spoiled)
