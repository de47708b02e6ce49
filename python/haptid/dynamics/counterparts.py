"""The same device with stiff springs or without torque sensors, and its base parameters by those of the first one.

Terms keep their names, so that parameters of both mean the same; only what they are grouped into may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.toml.reader import device_of
from haptid.device.toml.terms import AnyTerm, ElasticTerm
from haptid.dynamics.model import DynamicModel


def without_sensors(model: DynamicModel) -> DynamicModel:
    """The device without torque sensors, which can be simulated and controlled; the model itself where it has none."""
    if not model.device.sensors:
        return model
    terms = [t.model_copy(update={"sensor": False}) if isinstance(t, ElasticTerm) else t for t in _terms(model)]
    return _with_terms(model, terms, ("sensor ",))


def with_stiff_springs(model: DynamicModel) -> DynamicModel:
    """The device with rigid motors: as below the resonances; the model itself where no motor is elastic."""
    if not model.device.elastic:
        return model
    terms = [term for term in _terms(model) if not isinstance(term, ElasticTerm)]
    return _with_terms(model, terms, ("sensor ", "elastic "))


def _terms(model: DynamicModel) -> Sequence[AnyTerm]:
    return model.device.tables.terms


def _with_terms(model: DynamicModel, terms: Sequence[AnyTerm], gone: tuple[str, ...]) -> DynamicModel:
    """The model of a device file with other terms, at the same constants, without what names those that are gone."""
    device, tables = model.device, model.device.tables
    lost = {term.name for term in model.terms if term.on.startswith(gone)}
    rules = [
        rule.model_copy(
            update={
                "zero": [name for name in rule.zero if name not in lost],
                "equal": [group for group in rule.equal if lost.isdisjoint(name.lstrip("-+ ") for name in group)],
            }
        )
        for rule in tables.symmetry
    ]
    prior: dict[str, Any] = {name: value for name, value in tables.prior.parameters.items() if name not in lost}
    keep = [name for name in tables.base_parameters.keep if name not in lost]
    changed = {
        "terms": list(terms),
        "symmetry": [rule for rule in rules if rule.zero or rule.equal or rule.about or rule.identical or rule.mirror],
        "prior": type(tables.prior)(bodies=tables.prior.bodies, **prior),
        "base_parameters": tables.base_parameters.model_copy(update={"keep": keep}),
        "targets": {},
    }
    other = DynamicModel(device_of(tables.model_copy(update=changed), device.name))
    known = {(model.terms[k].name, c.name): model.terms[k].constant(c.name) for k, c in device.searched}
    other = other.at_constants([known[other.terms[k].name, c.name] for k, c in other.device.searched])
    same = np.array_equal(other.device.gravity, device.gravity)
    return other if same else other.with_gravity(device.gravity)


def parameters_on(model: DynamicModel, other: DynamicModel) -> Array:
    """Base parameters of a counterpart by those of the model, a matrix (p of the counterpart, p).

    Parameters that the counterpart does not have are left out.
    """
    ours, theirs = model.device.parameters, other.device.parameters
    raw = ours.S[:, list(model.base.independent_columns)]
    moved = np.zeros((len(theirs.raw), raw.shape[1]))
    places = {name: k for k, name in enumerate(ours.raw)}
    for k, name in enumerate(theirs.raw):
        if name in places:
            moved[k] = raw[places[name]]
    return np.asarray(other.base.regrouping @ np.linalg.lstsq(theirs.S, moved, rcond=None)[0])
