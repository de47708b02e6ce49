"""What is said of the masses that a hand feels: printed figures checked, what cannot hold, where motion is alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.branches.columns import ranged
from haptid.demos.branches.finding import Results
from haptid.demos.branches.fits import Identified

FIGURES: dict[str, Callable[[Array], float]] = {
    "greatest": lambda mass: float(mass.max()),
    "least": lambda mass: float(mass.min()),
    "variation": lambda mass: float(np.ptp(mass)),
}
WORDS = {
    "greatest": "the greatest value of the largest mass is",
    "least": "the least value of the largest mass is",
    "variation": "the largest mass varies by",
}
# A printed figure is met within this share: it is read from a plot, for lengths that are inferred.
NEAR = 0.15


def statements(found: Results) -> Iterator[str]:
    """Printed figures of the largest mass beside ours."""
    for said in found.demo.statements:
        ours = {
            one.branch.title: FIGURES[said.what](found.handles[key].sweeps[said.sweep].mass.values[:, 0])
            for key, one in found.found.items()
        }
        worst = max(abs(value / said.published - 1) for value in ours.values())
        told = ", ".join(f"{value:.2f} kg ({title.lower()})" for title, value in ours.items())
        what = WORDS[said.what]
        verdict = "so" if worst <= NEAR else "not so with these lengths"
        label = found.demo.sweep(said.sweep).label.split(",")[0]
        yield (
            f"Along {label}, {what} {told}; printed is {said.published:.2f} kg: {verdict}, {100 * worst:.0f} % away at "
            f"most."
        )


def disagreements(found: Results) -> Iterator[str]:
    """Masses whose published ranges in two sweeps have nothing in common, where ours are the same."""
    first, second = found.demo.sweeps
    for k, (one, other) in enumerate(zip(first.published, second.published, strict=True)):
        if max(one[0], other[0]) <= min(one[1], other[1]):
            continue
        for key, handle in found.handles.items():
            masses = [handle.sweeps[sweep.key].mass.values[:, k] for sweep in (first, second)]
            every, ours = np.concatenate(masses), " and ".join(ranged(mass) for mass in masses)
            yield (
                f"The published ranges of mass {k + 1} are apart in the two sweeps, {one[0]:g} .. {one[1]:g} and "
                f"{other[0]:g} .. {other[1]:g} kg. In ours ({found.found[key].branch.title.lower()}) it is {ours} kg, "
                f"the same within {100 * np.ptp(every) / every.mean():.1f} %: of one geometry both cannot be."
            )


def homogeneity(found: Results) -> Iterator[str]:
    """How much the largest mass changes in 10 degrees of each sweep."""
    rates = {}
    for sweep in found.demo.sweeps:
        masses = [handle.sweeps[sweep.key].mass.values[:, 0] for handle in found.handles.values()]
        rates[sweep.label.split(",")[0]] = max(10 * np.ptp(mass) / np.ptp(sweep.degrees) for mass in masses)
    told = ", ".join(f"{rate:.2f} kg along {label}" for label, rate in rates.items())
    low, high = sorted(rates.values())
    calm = min(rates, key=rates.__getitem__)
    yield (
        f"In 10 degrees the largest mass changes by {told}: motion along {calm} is {high / low:.1f} times as "
        f"homogeneous."
    )


def alike(found: Results) -> Iterator[str]:
    """How near the masses of each branch are to those of the first, along all sweeps."""
    first, *others = found.handles
    masses = {
        key: np.concatenate([handle.sweeps[sweep.key].mass.values for sweep in found.demo.sweeps])
        for key, handle in found.handles.items()
    }
    for key in others:
        apart = 100 * np.abs(masses[first] / masses[key] - 1)
        yield (
            f"The branches are close to each other: masses differ by {np.median(apart):.0f} % at the median, "
            f"{apart.max():.0f} % at most."
        )


def published_deviations(one: Identified) -> str:
    """Relative deviations beside the published ones."""
    ratios = {name: one.reduced[name].relative_se / one.table.figures[name, "relative"] for name in kept(one)}
    worst = max(ratios, key=ratios.__getitem__)
    return (
        f"Relative deviations are {100 * min(ratios.values()):.0f} to {100 * ratios[worst]:.0f} % of the published "
        f"ones, {worst} the nearest to its own."
    )


def kept(one: Identified) -> list[str]:
    """Published parameters that are essential here too."""
    return [name for name in one.table.rows if name in one.reduction.essential]
