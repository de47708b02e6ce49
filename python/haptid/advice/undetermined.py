"""What a log cannot determine: changes that other parameters would absorb, and effects too small to be proven."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.search import LEAST_GAIN, LEAST_SE, Trials, TriedChange, unseen_percent
from haptid.advice.trial import Bench, Setting, Trial
from haptid.inference.diagnosis.finding import SIGNIFICANCE, joined_names
from haptid.uncertainty.distributions import normal_quantile

# Share of a column's length that the model's own columns must leave, and change of the error by a factor of 1.5, for a
# candidate to be detected at all.
_TOLD = 1e-4
# Unseen error, per cent, below which nothing needs to be said of what remains; size of an effect, per cent of the
# torque, below which it need not be detected.
_CLOSE, _SMALL = 5.0, 5.0
# An effect as large as the whole torque, per cent, would not be small.
_WHOLE = 100.0
# Power at which the smallest effect that the log can detect is stated.
_POWER = 0.8
# Kinds of which that is stated.
_EFFECTS = ("spring", "rotor inertia", "stribeck", "load friction", "offset", "viscosity by direction")


def undetermined(search: Trials, base: Trial, kinds: set[str], silent: bool) -> Iterator[str]:
    """Sentences on what cannot be determined from this log.

    Args:
        search: of the log.
        base: the trial without changes.
        kinds: of the actions that are proven.
        silent: whether no change of the model, the channels or the rows is proven.
    """
    alike = absorbed(search, base, kinds)
    if alike:
        yield (
            f"Cannot be determined from this log, because the model's other parameters would absorb it: "
            f"{joined_names(alike, most=3)}."
        )
    error = unseen_percent(search.model, search.bench, base)
    if silent and error > _CLOSE:
        yield (
            f"None of {len(search.candidates)} changes lowers the error on unseen blocks "
            f"({error:.3g} %): its cause cannot be determined from this log."
        )
    if not silent:  # what a wrong model leaves is no noise
        return
    found = [one for one in smallest_effects(search, base) if f"{one[0].kind} ({one[0].places[0]})" not in alike]
    if large := [(one, size) for one, size in found if size > _SMALL]:
        shown = [f"{one.kind} on {one.places[0]} below {size:.2g} %" for one, size in large]
        yield (
            f"Too small to be detected from this log, at {100 * _POWER:g} % power, as a share of the motor's torque "
            f"(rms): {joined_names(shown, most=3)}."
        )


def absorbed(search: Trials, base: Trial, kinds: set[str]) -> list[str]:
    """Changes that other parameters would absorb, with their places."""
    bench = search.bench
    every = np.arange(bench.blocks)
    independent = _independent(bench)
    alike = []
    for one in search.candidates:
        if len(one.setting.terms) != 1 or one.kind not in ("spring", "rotor inertia", "zero offset", "length"):
            continue
        if independent[one.setting.terms[0][0][0]] < _TOLD:
            alike.append(f"{one.kind} ({one.places[0]})")
    error = 0.0 if kinds & {"gain", "unit", "torque sign"} else bench.errors(base.whole, Setting()).sum()
    for k, row in reversed(list(enumerate(search.model.known_rows))):
        if row not in search.model.measured_rows:
            continue
        other = Setting(factors=((k, 1.5),))
        if bench.errors(bench.fit(other, every), other).sum() < 1.01 * error:
            alike.insert(0, f"gain of the torque ({search.model.device.row_labels[row]})")
    return alike


def smallest_effects(search: Trials, base: Trial) -> list[tuple[TriedChange, float]]:
    """Candidates with the smallest effect that the log can prove, rms in per cent of the torque; the largest first.

    An effect has to be significant by the test of its column over all candidates together, and its part that other
    columns do not explain has to be `LEAST_GAIN` of the unseen squared error.
    """
    bench, tests = search.bench, max(len(search.candidates), 1)
    z = max(float(-normal_quantile(0.5 * SIGNIFICANCE / tests)), LEAST_SE) + float(normal_quantile(_POWER))
    lengths, independent, made = bench.grams["used"].lengths.sum(axis=0), _independent(bench), []
    torque = bench.squares(Setting()).sum(axis=0)
    for one in search.candidates:
        if one.kind not in _EFFECTS:
            continue
        trial, column = search.bench.run(one.setting), one.setting.terms[0][0][0]
        motor = int(np.argmax(lengths[:, column]))
        weighted = float(bench.weights**2 @ lengths[:, column])
        se = search.bench.standard_errors(trial)
        if independent[column] < _TOLD or not se.any() or weighted <= 0 or torque[motor] <= 0:
            continue
        by_share = np.sqrt(LEAST_GAIN * base.total / weighted) / independent[column]
        theta = max(z * float(se[0]), by_share)
        share = float(100 * theta * np.sqrt(lengths[motor, column] / torque[motor]))
        if share < _WHOLE:
            made.append((one, share))
    return sorted(made, key=lambda each: -each[1])


def _independent(bench: Bench) -> Array:
    """Share of each column's length that the base parameters' columns leave, (columns,)."""
    A = bench.over_motors()
    scale = 1 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    A = A * scale[:, None] * scale
    cross = A[bench.kept]
    inverse = np.linalg.pinv(cross[:, bench.kept], rcond=1e-10, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(A) - (cross * (inverse @ cross)).sum(axis=0), 0.0)))
