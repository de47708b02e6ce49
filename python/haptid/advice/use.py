"""Another model for use than the one that a study demands: physically consistent, free, or with the device's priors."""

from __future__ import annotations

import numpy as np

from haptid._internal.late import dataclass
from haptid.advice.search import LEAST_GAIN, LEAST_SE
from haptid.study.identify import Identification
from haptid.validation.model_for_use import NAMES, model_for_use


@dataclass(frozen=True)
class OtherUse:
    """A fit that predicts held-out blocks better than the demanded one.

    Attributes:
        words: the fit.
        before, after, se: errors on held-out blocks, per cent, and the standard error of their difference, at most.
        share: of the squared error that goes away.
        blocks: that were held out.
    """

    words: str
    before: float
    after: float
    se: float
    share: float
    blocks: int


def other_use(found: Identification) -> OtherUse | None:
    """The fit that `use = "auto"` would choose, where its gain over the demanded one is proven; None where it is not.

    With "auto" nothing is to be advised: identifying has compared the fits already.
    """
    if found.study.use == "auto" or found.use.name == "given":
        return None
    seen = [run.reference for run in found.runs if run.entry.role == "identify" and run.reference is not None]
    chosen = model_for_use(found.estimate, seen)
    by_name = {one.name: one for one in chosen.candidates}
    if chosen.name == found.use.name or not {chosen.name, found.use.name} <= set(by_name):
        return None
    now, then = by_name[found.use.name], by_name[chosen.name]
    # Both excesses are over the consistent fit; their standard errors add at most.
    gain, se = now.excess[0] - then.excess[0], now.excess[1] + then.excess[1]
    share = gain / max((now.error / 100) ** 2, np.finfo(float).tiny)
    if gain <= LEAST_SE * se or share <= LEAST_GAIN:
        return None
    in_percent = 1e4 * se / max(now.error + then.error, np.finfo(float).tiny)
    held = seen or [found.estimate.observation]
    return OtherUse(
        NAMES[chosen.name], now.error, then.error, in_percent, share, sum(len(rows.blocks) for rows in held)
    )
