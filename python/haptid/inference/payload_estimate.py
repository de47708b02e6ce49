"""Payload estimation: the inertial parameters of a tool, sensor or weight, from an estimate without and one with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device import INERTIAL
from haptid.errors import ModelMismatchError, UnknownNameError, suggestion
from haptid.estimation import Estimate
from haptid.inference.comparison import compare
from haptid.uncertainty.quantities import LEVEL, half_width

# Singular values below this share of the largest count as zero: that direction is not identifiable.
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """The standard parameters of a body added to a link, in the link frame.

    Attributes:
        link: its joint's name.
        names, units: of the link's free standard parameters, (k,).
        value: of the identifiable ones, NaN of the others, (k,), SI.
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
        """Standard errors, (k,), NaN where there is no value."""
        return freeze(np.where(np.isnan(self.value), np.nan, np.sqrt(np.diag(self.covariance))))

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals, (k, 2)."""
        half = half_width(self.se, self.dof, level)
        return freeze(np.column_stack([self.value - half, self.value + half]))

    def summary(self) -> str:
        """A line for each parameter."""
        lines = [f"Added to link {self.link}:"]
        for name, unit, value, (low, high) in zip(self.names, self.units, self.value, self.conf_int(), strict=True):
            if np.isnan(value):
                lines.append(f"  {name}: not identifiable")
            else:
                lines.append(f"  {name}: {value:.5g} {unit}, 95 % interval {low:.5g} .. {high:.5g}")
        return "\n".join(lines)


def estimate_payload(before: Estimate, after: Estimate, link: str) -> PayloadEstimate:
    """The body added to one link between two estimates of one device.

    The difference of the base parameters is a linear combination of the ten inertial parameters of the added body,
    with the columns of the regrouping matrix as factors; they are found by least squares, weighted by the covariance of
    the difference. Differences of friction are left out, since friction may have changed.

    Args:
        before, after: of the same device, from logs without common rows.
        link: name of the joint whose link carries it.

    Raises:
        ModelMismatchError: the estimates are of two devices.
        UnknownNameError: there is no such link, or it has no free parameters.
        SharedRowsError: both were made from the same rows.
    """
    model = before.model
    if not after.model.is_same_as(model):
        raise ModelMismatchError(
            f"these are of two devices, {model.device.name!r} and {after.model.device.name!r}, or of one device "
            "read twice.",
            found=(model.device.name, after.model.device.name),
            advice="Read the device once, and make every observation with it.",
        )
    device, standard = model.device, model.device.parameters
    place = device.joint_names.index(link) if link in device.joint_names else -1
    own = [k for k, of in enumerate(standard.links) if of == place and standard.kinds[k] in INERTIAL]
    if place < 0 or not own:
        raise UnknownNameError(
            f"no link {link!r} with free inertial parameters.",
            where="link",
            found=link,
            limit=tuple(device.joint_names),
            advice=suggestion(link, device.joint_names),
        )
    changed = compare(before, after)
    bodies = [k for k, kept in enumerate(model.base.independent_columns) if standard.kinds[kept] in INERTIAL]
    root = np.linalg.cholesky(changed.covariance[np.ix_(bodies, bodies)])
    columns = np.linalg.solve(root, model.base.regrouping[np.ix_(bodies, own)])
    shift = np.linalg.solve(root, changed.difference[bodies])
    value, covariance = _least_squares(columns, shift)
    return PayloadEstimate(
        link=link,
        names=tuple(standard.names[k] for k in own),
        units=tuple(standard.units[k] for k in own),
        value=value,
        covariance=covariance,
        dof=float(changed.dof[bodies].min()),
    )


def _least_squares(columns: Array, shift: Array) -> tuple[Array, Array]:
    """Values, NaN where not identifiable, and their covariance; the rows have unit noise."""
    lengths = np.linalg.norm(columns, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    u, s, vt = np.linalg.svd(columns / scale, full_matrices=False)
    kept = s > _RANK_TOLERANCE * s[0]
    inverse = (vt[kept].T / s[kept]) @ u[:, kept].T
    identifiable = (np.linalg.norm(vt[kept], axis=0) > 1 - 1e-6) & (lengths > 0)
    covariance = (inverse @ inverse.T) / np.outer(scale, scale)
    known = np.outer(identifiable, identifiable)
    return np.where(identifiable, inverse @ shift / scale, np.nan), np.where(known, covariance, 0.0)
