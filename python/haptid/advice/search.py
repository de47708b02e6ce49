"""Search of actions: every candidate tried on the same rows, kept where its proof holds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from itertools import combinations
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice import columns as candidate_columns
from haptid.advice.columns import Geometry, Source
from haptid.advice.contact import contact, elsewhere, kind_of
from haptid.advice.odd_logs import odd_logs
from haptid.advice.recorder import ChannelFault, faults, rounded_rows, simulated_rows
from haptid.advice.rows import BaseRows, TrialRows
from haptid.advice.spoiled import SpoiledPart
from haptid.advice.torque_channels import TorqueChannels, channels_of_motors
from haptid.advice.trial import Bench, Gain, Setting, Trial, gain
from haptid.dynamics.model import DynamicModel
from haptid.estimation.method import FREE_SHARE
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.lack_of_fit import (
    FrictionCoordinate,
    coupled_coordinates,
    fourier_sums,
    friction_coordinates,
)
from haptid.motion.motion import Motion
from haptid.observation.plan import OUTSIDE_GUARD, Plan
from haptid.uncertainty.distributions import t_tail
from haptid.validation.validation import of_all_motors

# Least share of the unseen squared error that an action has to remove, and of its standard errors; of the latter where
# the share is above LARGE_GAIN: such a gain is no chance, and blocks differ by what happens in them.
LEAST_GAIN, LEAST_SE = 0.03, 3.0
LARGE_GAIN, LARGE_SE = 0.25, 2.0
# Terms that joints of coupled motors may have besides the motors.
_OF_A_JOINT = ("coulomb", "viscous", "spring")
# Time blocks of a log, at least.
_MANY = 24
# A channel is dead where the unseen error of its motor is this share of its torque.
DEAD_ERROR = 0.15
# A gain below this share, with this share of the channel left over, is that of a channel of something else.
_HARDLY, _UNRELATED = 0.05, 0.8
# Power of a contact's residual over the usual one, at least, where no other passage has its states, and share of the
# unseen squared error above which a term explains the residual.
_CLEAR, _EXPLAINS = 300.0, 0.5
# Share of the rows of a log from which on all of it differs, not parts.
_MOSTLY = 0.5


@dataclass(frozen=True, eq=False)
class TriedChange:
    """One change, executable on the rows.

    Attributes:
        kind: such as "spring".
        places: where, in the order of `indices`.
        setting: what is fitted.
        sources: of its columns, if it has any.
        indices: of motors (those of torque channels too), joints or friction coordinates.
        seconds: by which torques are shifted, s.
    """

    kind: str
    places: tuple[str, ...]
    setting: Setting
    sources: tuple[Source, ...] = ()
    indices: tuple[int, ...] = ()
    geometry: Geometry | None = None
    fault: ChannelFault | None = None
    seconds: float = 0.0

    @property
    def looked_at(self) -> float:
        """As of its sources."""
        return max((source.looked_at for source in self.sources), default=1.0)


@dataclass(frozen=True, eq=False)
class Proven:
    """A candidate with its proof by unseen blocks.

    Attributes:
        candidate, trial, gain: what was tried, and what came of it.
        values: parameters of each place's columns, SI.
        settings: constants of the alternative that was chosen at each place.
        figures: of rows left out: unseen error of all rows, and that of the others where the fit leaves them out, per
            cent; paired standard error of what the others' error falls by.
    """

    candidate: TriedChange
    trial: Trial
    gain: Gain
    values: tuple[Array, ...] = ()
    settings: tuple[Mapping[str, Any], ...] = ()
    figures: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Trials:
    """A log's rows with all candidates, and the trials on them.

    Attributes:
        motions: treated signals of the fit.
        beta: the estimate, (p,).
        rows: with candidate columns.
        bench: trials.
        torques: whose the torque channels are.
        candidates: all of them.
        faults: of the channels, by log.
        spoiled: parts of logs in which the model does not hold.
    """

    model: DynamicModel
    motions: tuple[Motion, ...]
    beta: Array
    rows: TrialRows
    bench: Bench
    torques: TorqueChannels
    candidates: tuple[TriedChange, ...]
    faults: tuple[tuple[int, ChannelFault], ...] = ()
    spoiled: tuple[SpoiledPart, ...] = ()

    @cached_property
    def contact(self) -> np.ndarray:
        """Rows in which something touches the device, (rows,); none of those that are spoiled anyway."""
        stuck = [(log, fault.samples) for log, fault in self.faults if fault.kind == "stuck position"]
        spoiled = [*stuck, *((part.log, part.samples) for part in self.spoiled)]
        used = self.rows.used & ~np.any([_touched(self, *one) for one in spoiled], axis=0)
        rows = replace(self.rows, used=used)
        flagged, power = contact(rows, self.bench.without_candidates())
        if not flagged.any():
            return flagged
        # States that other passages have without it speak against every term but those that go with time.
        other = ("drift",) if elsewhere(rows, flagged) else None
        if self._explained(other) or (other is None and power <= _CLEAR):
            return np.zeros_like(flagged)
        return flagged

    def _explained(self, kinds: Sequence[str] | None) -> bool:
        """Whether a term of these kinds, or of any, explains most of the error, on whatever motors it is added."""
        base, shares = self.base(), dict[str, float]()
        for one in self.candidates:
            if one.setting.terms and (kinds is None or one.kind in kinds):
                share = gain(base, self.base(one.setting)).share
                shares[one.kind] = shares.get(one.kind, 0.0) + share
        return max(shares.values(), default=0.0) > _EXPLAINS

    def places_of(self, fault: ChannelFault) -> tuple[int, ...]:
        """The position channel of a fault, or the motors into whose rows its torque channel enters."""
        return (fault.channel,) if fault.kind == "stuck position" else self.torques.motors(fault.channel)

    def base(self, setting: Setting | None = None) -> Trial:
        return self.bench.run(setting or Setting())


def search_of(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, zero: Sequence[int] = (), columns: bool = True
) -> Trials:
    """Rows and candidates of motions.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        zero: those of them that are fixed at zero.
        columns: whether there are candidates with columns of their own.
    """
    motions = tuple(finer(motion) for motion in motions)
    rows = list(model.known_rows)
    found = tuple((k, one) for k, m in enumerate(motions) if m.log is not None for one in faults(m.log))
    places = friction_coordinates(model, rows)
    base = BaseRows.of(model, motions)
    plain, torques = base.with_columns(beta), channels_of_motors(model, motions)
    sources = list(_sources(model, places, torques, plain, beta)) if columns else []
    if columns:
        of_channels = {(one.kind, one.channel): one for _, one in found}
        sources += candidate_columns.clipped_channels(model, torques, list(of_channels.values()))
    lengths = list(candidate_columns.geometry(model)) if columns else []
    added = [column for source in [*sources, *(s for _, s in lengths)] for column in source.alternatives]
    whole = base.with_columns(beta, added)
    weights = weights_of(whole, len(beta), beta)
    kept = np.array([k for k in range(len(beta)) if k not in zero])
    bench = Bench({"used": whole.grams()}, len(beta), kept, weights, _channel_factors(torques))
    if columns:
        asked = (base, motions, beta, added, whole.blocks)
        bench = replace(
            bench, artefact=cache(lambda: simulated_rows(*asked)), roundings=cache(lambda: rounded_rows(*asked))
        )
    made, at = [], 0
    for source, what in [(s, None) for s in sources] + [(s, g) for g, s in lengths]:
        own = whole.groups[at : at + len(source.alternatives)]
        at += len(source.alternatives)
        setting = Setting(terms=(own,))
        made.append(TriedChange(source.kind, (source.place,), setting, (source,), (source.index,), what))
    labels = [model.device.row_labels[k] for k in rows]
    measured = [k for k in torques.measured if torques.of(k) is not None]
    for k, label in ((k, labels[k]) for k in measured):
        made.append(TriedChange("gain", (label,), Setting(free=(k,)), (), (k,)))
    for i, j in combinations(measured, 2):
        source_of = list(range(len(rows)))
        source_of[i], source_of[j] = j, i
        if bench.channel_factors[i, j]:
            made.append(
                TriedChange("torque swap", (labels[i], labels[j]), Setting(source=tuple(source_of)), (), (i, j))
            )
    return Trials(model, motions, beta, whole, bench, torques, _of_channels_in_use(made, whole), found)


def _sources(
    model: DynamicModel,
    places: Sequence[FrictionCoordinate],
    torques: TorqueChannels,
    plain: TrialRows,
    beta: Array,
) -> Iterator[Source]:
    """Added columns that do not concern the geometry."""
    rows = list(model.known_rows)
    ranges = candidate_columns.local_ranges(places, plain.position, plain.velocity)
    yield from candidate_columns.terms(model, places, ranges)
    coupled = coupled_coordinates(model, rows, places)
    ranges = candidate_columns.local_ranges(coupled, plain.position, plain.velocity)
    yield from (one for one in candidate_columns.terms(model, coupled, ranges) if one.kind in _OF_A_JOINT)
    low, high = float(plain.t.min()), float(plain.t.max())
    yield from candidate_columns.channels(model, torques, 0.5 * (low + high), 0.5 * (high - low) or 1.0)
    yield from candidate_columns.springs_of_motors(model, torques)
    yield from candidate_columns.payload_steps(model, np.linspace(low, high, 13)[1:-1].tolist())
    residual = np.where(plain.used, plain.y - np.einsum("mrp,p->mr", plain.W, beta), 0.0)
    for k, place in enumerate(places):
        row = int(np.argmax(np.abs(place.weights[list(rows)])))
        x = place.weights @ plain.position
        if x.max() > x.min() and plain.used[row].sum() > 100:
            periods = [_period(x, residual[row], plain.block, plain.used[row] & (plain.block % 2 == h)) for h in (0, 1)]
            yield candidate_columns.ripple_columns(place, k, periods)


def _period(x: Array, e: Array, block: np.ndarray, used: np.ndarray) -> float:
    """Period of the strongest wave of a residual in position, over its spread from block to block."""
    f, sums = fourier_sums(x[used], e[used] - e[used].mean(), block[used])
    return float(1 / f[int(np.argmax(np.abs(sums.sum(axis=0)) ** 2 / (np.abs(sums) ** 2).sum(axis=0)))])


def weights_of(rows: TrialRows, base: int, beta: Array) -> Array:
    """One over the rms residual of each motor, (motors,); less where no torque is measured, as for a free joint."""
    e = np.where(rows.used, rows.y - np.einsum("mrp,p->mr", rows.W[:, :, :base], beta), 0.0)
    rms = np.sqrt((e**2).sum(axis=1) / np.maximum(rows.used.sum(axis=1), 1))
    free = ~rows.y.any(axis=1) & rows.used.any(axis=1)
    return np.asarray(np.where(free, FREE_SHARE, 1.0) / np.maximum(rms, 1e-9 * np.abs(rows.y).max()))


def finer(motion: Motion) -> Motion:
    """The motion with _MANY time blocks at least: the residual of a wrong model has a longer memory than its noise."""
    seconds = (motion.usable[1] - motion.usable[0]) * motion.dt
    treatment = motion.treatment
    return replace(motion, treatment=replace(treatment, block_s=min(treatment.block_s, seconds / _MANY)))


def _channel_factors(torques: TorqueChannels) -> Array:
    """Torque of each motor per torque of another motor if its channel were this one's; zero where rows mix channels."""
    change = torques.scales
    return np.eye(len(torques.enters)) if change is None else change[:, None] / change


def unseen_percent(model: DynamicModel, bench: Bench, trial: Trial, motor: int | None = None) -> float:
    """Unseen relative error of a motor, or of all as a validation has it, per cent."""
    return float(100 * np.sqrt(relative_squares(model, bench, trial, motor).sum()))


def relative_squares(model: DynamicModel, bench: Bench, trial: Trial, motor: int | None = None) -> Array:
    """Each block's part of the squared unseen relative error of a motor, or of all, (blocks,)."""
    return np.asarray(trial.errors / bench.weights**2 @ _factors(model, bench, trial, motor))


def paired(model: DynamicModel, bench: Bench, before: Trial, after: Trial, motor: int | None = None) -> float:
    """Standard error of the difference of two such errors, per cent: paired by block, by the delta method."""
    difference = (before.errors - after.errors) / bench.weights**2 @ _factors(model, bench, before, motor)
    both = sum(unseen_percent(model, bench, trial, motor) for trial in (before, after))
    return float(1e4 * np.sqrt(len(difference)) * difference.std(ddof=1) / max(both, 1e-300))


def _factors(model: DynamicModel, bench: Bench, trial: Trial, motor: int | None) -> Array:
    """Factors of the motors' squared residuals in the squared relative error of a motor, or of all, (motors,)."""
    own = bench.sizes(trial)
    if motor is not None:
        return np.asarray(np.eye(len(own))[motor] / max(own[motor], np.finfo(float).tiny))
    driven = ~np.array([model.device.free_rows[k] for k in model.known_rows])
    units = [model.device.torque_units[k] for k in model.known_rows]
    return np.asarray(of_all_motors(own * driven, units) * driven)


def with_masks(search: Trials) -> tuple[Trials, list[Proven]]:
    """The search on rows without those that channels or a contact spoil, where leaving them out is proven to help."""
    found: list[Proven] = []
    bench = search.bench.without_candidates()
    base = bench.run(Setting())
    kept = np.ones(search.rows.used.shape, dtype=bool)
    for one, mask in _masks(search):
        made = _masked(search, bench, base, one, mask)
        if made is not None:
            found.append(made)
            kept &= mask
    if not found:
        return search, found
    rows = replace(search.rows, used=search.rows.used & kept)
    clean = replace(search, rows=rows, bench=search.bench.with_rows("used", rows.grams()))
    return replace(clean, candidates=_of_channels_in_use(search.candidates, rows)), found


def _of_channels_in_use(candidates: Iterable[TriedChange], rows: TrialRows) -> tuple[TriedChange, ...]:
    """Candidates but for gains and exchanges of torque channels of which no row is used, of which nothing is known."""
    used = np.asarray(rows.used.any(axis=1))
    return tuple(one for one in candidates if one.kind not in ("gain", "torque swap") or used[list(one.indices)].all())


def _masked(search: Trials, whole: Bench, base: Trial, one: TriedChange, mask: np.ndarray) -> Proven | None:
    """A fit without some rows, judged on the others like the fit with them; None where that is not proven.

    A fault shows in the channel by itself, and it is enough that leaving it out does not harm the others, that it is a
    good part of the error, and that the error of the others is less: dry friction stops a joint too. A contact, slip,
    a limit cycle, another log, or a torque of noise, as of a motor with little friction, has to harm the others too.
    """
    share = 1.0 - (mask & search.rows.used).sum() / search.rows.used.sum()
    if share <= 0:
        return None
    bench = whole.with_rows("clean", search.rows.grams(mask, whole.base))
    trial, before = bench.run(Setting(rows="clean")), bench.run(Setting(), judged="clean")
    made = gain(before, trial)
    total = 1.0 - trial.total / (1.0 - share) / base.total
    shows = one.fault is not None and one.kind != "noise alone"
    harmless = shows and made.share > -LEAST_SE * made.se
    dead = one.kind == "dead torque" and _unseen(search, base)[list(one.indices)].max() > DEAD_ERROR
    helps = made.p < SIGNIFICANCE / 4 and large_enough(made)
    if not (helps or dead or (harmless and total > LEAST_GAIN)):
        return None
    error, after = unseen_percent(search.model, whole, base), unseen_percent(search.model, bench, trial)
    if not (helps or dead or after < error):  # rows of much torque, no more wrong than the others
        return None
    se = paired(search.model, bench, replace(before, setting=trial.setting), trial)
    proof = replace(made, share=max(total, made.share))
    return Proven(one, trial, proof, figures=(error, after, se))


def _unseen(search: Trials, trial: Trial) -> Array:
    """Unseen error of every motor over its torque, (motors,)."""
    own = search.bench.squares(trial.setting).sum(axis=0)
    left = trial.errors.sum(axis=0) / search.bench.weights**2
    return np.asarray(np.sqrt(left / np.maximum(own, np.finfo(float).tiny)))


def _masks(search: Trials) -> Iterator[tuple[TriedChange, np.ndarray]]:
    """Rows that are left when one fault's are not used, (motors, rows)."""
    rows, model = search.rows, search.model
    for log, fault in search.faults:
        if fault.kind in ("coarse torque", "clipped torque"):
            continue
        mask, which = np.ones(rows.used.shape, dtype=bool), search.places_of(fault)
        touched = _touched(search, log, fault.samples)
        if fault.kind == "stuck position":
            mask[:, touched] = False
            labels = tuple(f"joint {model.device.joints[model.device.active[k]].name}" for k in which)
        else:
            mask[list(which)] &= ~touched
            labels = tuple(model.device.row_labels[model.known_rows[k]] for k in which)
        yield TriedChange(fault.kind, labels, Setting(rows="clean"), indices=which, fault=fault), mask
    for part in search.spoiled:
        mask = np.broadcast_to(~_touched(search, part.log, part.samples), rows.used.shape)
        yield TriedChange(part.kind, part.places, Setting(rows="clean"), indices=(part.log,)), mask
    flagged = search.contact
    for k in odd_logs(rows, search.bench):
        whole, file = rows.log == k, search.motions[k].log
        if file is None:
            continue
        one = TriedChange("other log", (file.path.name,), Setting(rows="clean"), indices=(k,))
        yield one, np.broadcast_to(~whole, rows.used.shape)
        if flagged[whole].mean() > _MOSTLY:  # what differs is not in parts of it
            flagged = flagged & ~whole
    if flagged.any():
        mask = np.broadcast_to(~flagged, rows.used.shape)
        yield TriedChange(kind_of(rows, flagged), ("the device",), Setting(rows="clean")), mask


def _touched(search: Trials, log: int, samples: np.ndarray) -> np.ndarray:
    """Rows of a log whose filter window has a spoiled sample, (rows,)."""
    plan = Plan.of(search.model, search.motions[log])
    back, ahead = plan.filter.main_part(OUTSIDE_GUARD)
    count = np.concatenate([[0], np.cumsum(samples)])
    middle = search.rows.sample
    high, low = np.clip(middle + ahead + 1, 0, len(samples)), np.clip(middle - back, 0, len(samples))
    return np.asarray((search.rows.log == log) & (count[high] > count[low]))


def of_no_motor(search: Trials, one: Proven) -> bool:
    """Whether a gain of next to nothing leaves the channel unexplained: it shows nothing of its motor's torque."""
    motor = one.candidate.indices[0] if one.candidate.kind == "gain" else -1
    if motor < 0 or abs(float(one.trial.whole.factors[motor])) > _HARDLY:
        return False
    return bool(_unseen(search, one.trial)[motor] > _UNRELATED)


def large_enough(made: Gain) -> bool:
    """Whether a gain is worth an action, and far enough from zero: a large one by its blocks' signed ranks too.

    Where nearly all of the error goes away, the gains of the blocks differ as their errors do.
    """
    if made.share > LARGE_GAIN:
        return made.share > LARGE_SE * made.se or made.ranks < float(t_tail(LARGE_SE, made.dof))
    return made.share > LEAST_GAIN and made.share > LEAST_SE * made.se
