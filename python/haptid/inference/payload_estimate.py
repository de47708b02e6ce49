"""What was added to a link: a tool, a sensor or a weight, from an estimate before and one after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device import INERTIAL
from haptid.errors import DifferentModelError, UnknownLinkError
from haptid.estimation import Estimate
from haptid.inference.comparison import compare
from haptid.inference.targets import free_fit

# A direction of the added parameters that shows less than this, beside the one that shows most, is not known.
SHOWN = 1e-9


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """The standard parameters of what was added to a link, in the link frame.

    Attributes:
        link: its joint's name.
        names, units: of the link's free standard parameters, (k,).
        value: of each that the torques tell, NaN of the others, (k,), SI.
        covariance: of these, (k, k), zero where there is no value.
        dof: degrees of freedom of the intervals: the least of any base parameter's difference.
    """

    link: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    covariance: Array
    dof: float

    def __post_init__(self) -> None:
        for name in ("value", "covariance"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        expect("value", self.value.shape, (len(self.names),))
        expect("covariance", self.covariance.shape, (len(self.names), len(self.names)))

    @cached_property
    def se(self) -> Array:
        """Deviations, (k,), NaN where there is no value."""
        return freeze(np.where(np.isnan(self.value), np.nan, np.sqrt(np.diag(self.covariance))))

    @cached_property
    def interval95(self) -> Array:
        """95 % intervals, (k, 2)."""
        half = stats.t.ppf(0.975, self.dof) * self.se
        return freeze(np.column_stack([self.value - half, self.value + half]))

    def summary(self) -> str:
        """A line for each parameter."""
        lines = [f"Added to link {self.link}:"]
        for k, name in enumerate(self.names):
            if np.isnan(self.value[k]):
                lines.append(f"  {name}: the torques do not tell it")
            else:
                low, high = self.interval95[k]
                lines.append(f"  {name}: {self.value[k]:.5g} {self.units[k]}, 95 % interval {low:.5g} .. {high:.5g}")
        return "\n".join(lines)


def estimate_payload(before: Estimate, after: Estimate, link: str) -> PayloadEstimate:
    """What was added to one link between two estimates of one device.

    The difference of the base parameters is a combination of the ten parameters of what was added, by the columns of
    the regrouping; those are found by least squares, weighted by the covariance of the difference. Friction may be
    another one: its differences are left out.

    Args:
        before, after: of the same device, from logs without common rows.
        link: name of the joint whose link carries it.

    Raises:
        DifferentModelError: the estimates are of two devices.
        UnknownLinkError: there is no such link, or it has no free parameters.
        DependentEstimatesError: both were made from the same rows.
    """
    model = before.model
    if not after.model.is_same_as(model):
        raise DifferentModelError(model.device.name, after.model.device.name)
    place = model.device.joint_names.index(link) if link in model.device.joint_names else -1
    own = [
        k
        for k, of in enumerate(model.device.parameters.links)
        if of == place and model.device.parameters.kinds[k] in INERTIAL
    ]
    if place < 0 or not own:
        raise UnknownLinkError(link, model.device.joint_names)
    changed, kinds = compare(before, after), model.device.parameters.kinds
    bodies = [k for k, kept in enumerate(model.base.independent_columns) if kinds[kept] in INERTIAL]
    root = np.linalg.cholesky(changed.covariance[np.ix_(bodies, bodies)])
    columns = np.linalg.solve(root, model.base.regrouping[np.ix_(bodies, own)])
    shift = np.linalg.solve(root, (free_fit(after) - free_fit(before))[bodies])
    value, covariance = _least_squares(columns, shift)
    return PayloadEstimate(
        link=link,
        names=tuple(model.device.parameters.names[k] for k in own),
        units=tuple(model.device.parameters.units[k] for k in own),
        value=value,
        covariance=covariance,
        dof=float(changed.dof[bodies].min()),
    )


def _least_squares(columns: Array, shift: Array) -> tuple[Array, Array]:
    """Values, NaN where the columns do not tell them, and their covariance; columns and shift have unit noise."""
    lengths = np.linalg.norm(columns, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    u, s, vt = np.linalg.svd(columns / scale, full_matrices=False)
    kept = s > SHOWN * s[0]
    inverse = (vt[kept].T / s[kept]) @ u[:, kept].T
    told = (np.linalg.norm(vt[kept], axis=0) > 1 - 1e-6) & (lengths > 0)
    covariance = (inverse @ inverse.T) / np.outer(scale, scale)
    return np.where(told, inverse @ shift / scale, np.nan), np.where(np.outer(told, told), covariance, 0.0)
