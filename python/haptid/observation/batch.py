"""Observations of several motions by parallel workers, continued from a cache where a run was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.executors import Executor, SerialExecutor
from haptid.motion.channels import check_log
from haptid.motion.motion import Motion
from haptid.observation.cache import CachedPart, RFactorCache
from haptid.observation.observation import Observation, assemble
from haptid.observation.plan import Plan, RFactors

_Progress = Callable[[Motion, float], None]


@dataclass(frozen=True, eq=False)
class Reducer:
    """Reduces parts of some plans to R factors; each worker receives it once."""

    plans: tuple[Plan, ...]

    def __call__(self, part: CachedPart) -> RFactors:
        plan, start, stop = part
        return self.plans[plan].reduce(start, stop)


def observe_all(
    model: DynamicModel,
    motions: Sequence[Motion],
    workers: Executor | None = None,
    cache: RFactorCache | None = None,
    progress: _Progress | None = None,
) -> tuple[Observation, ...]:
    """The observation of each motion, as by `observe`, computed part by part by workers.

    Args:
        motions: treated signals.
        workers: that reduce the parts; this process where None.
        cache: cache of long motions' R factors; none where None.
        progress: called with a motion and the share of its rows that are done, 0 to 1.

    Raises:
        ExecutorError: a part was lost with one worker after the other.
        HaptidError: as `observe`.
    """
    for motion in motions:
        if motion.log:
            check_log(model.device, motion.log)
    plans = tuple(Plan.of(model, motion) for motion in motions)
    parts = [(k, start, stop) for k, plan in enumerate(plans) for start, stop in plan.segments()]
    rows, done = [0] * len(plans), {}
    for k, factors in _reduced(plans, parts, workers or SerialExecutor(), cache):
        done[k] = factors
        plan_index, start, stop = parts[k]
        rows[plan_index] += stop - start
        if progress:
            progress(plans[plan_index].motion, rows[plan_index] / plans[plan_index].rows)
    return tuple(
        assemble(plan, [done[k] for k, part in enumerate(parts) if part[0] == plan_index])
        for plan_index, plan in enumerate(plans)
    )


def _reduced(
    plans: tuple[Plan, ...], parts: list[CachedPart], workers: Executor, cache: RFactorCache | None
) -> Iterator[tuple[int, RFactors]]:
    """Index of a part and its R factors: first those from the cache, then the others as workers finish them."""
    files = cache.files(plans, parts) if cache else [None] * len(parts)
    missing = []
    for k, file in enumerate(files):
        cached = cache.read(file) if cache and file else None
        if cached is None:
            missing.append(k)
        else:
            yield k, cached
    for m, factors in workers.map(Reducer(plans), [parts[k] for k in missing]):
        file = files[missing[m]]
        if cache and file:
            cache.write(file, factors)
        yield missing[m], factors
