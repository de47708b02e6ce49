"""A device without its terms: links alone, as if joints had no friction."""

from __future__ import annotations

from dataclasses import replace

from haptid.device.parameters import Symmetry, standard_parameters
from haptid.dynamics.model import DynamicModel


def without_terms(model: DynamicModel) -> DynamicModel:
    """The same links, loops and motors, without friction or any other term.

    Targets that need a term are left out, the others keep their factors.
    """
    joints = model.device.joints
    inertial = model.device.parameters.raw[: 10 * len(joints)]
    rules = tuple(_only(rule, inertial) for rule in model.device.symmetry)
    links = standard_parameters([j.name for j in joints], [j.body for j in joints], (), rules)
    where = [model.device.parameters.index[name] for name in links.names]
    kept = set(where)
    targets = tuple(
        replace(target, row=target.row[where])
        for target in model.device.targets
        if not any(target.row[k] for k in range(len(target.row)) if k not in kept)
    )
    bare = replace(
        model.device,
        terms=(),
        parameters=links,
        symmetry=rules,
        prior={name: value for name, value in model.device.prior.items() if name in links.raw},
        keep=tuple(name for name in model.device.keep if name in links.raw),
        targets=targets,
    )
    return DynamicModel(bare)


def _only(rule: Symmetry, names: tuple[str, ...]) -> Symmetry:
    """What a symmetry says of these raw parameters."""
    equal = (tuple(n for n in group if n in names) for group in rule.equal)
    return replace(rule, zero=tuple(n for n in rule.zero if n in names), equal=tuple(g for g in equal if len(g) > 1))
