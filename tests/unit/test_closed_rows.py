"""Loops in space at numbers: the symbolic mechanism at other lengths, opened without finding its linear loops again."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid.device.toml.reader import resized
from haptid.dynamics.base_parameters import preference
from haptid.dynamics.symbolic import regroupings, spatial
from haptid.dynamics.symbolic.closed_rows import ClosedRows
from haptid.dynamics.symbolic.geometry import joint_placements
from haptid.dynamics.symbolic.loops import opened_tree
from haptid.dynamics.symbolic.regressor import Columns
from haptid.dynamics.symbolic.spatial import opened_chain

DEVICES = ("slider_crank", "delta", "cea_medical_interface")


def columns(model: haptid.DynamicModel) -> Columns:
    """All standard parameters' columns, in order of preference, with the loops opened."""
    S = model.device.parameters.S
    signs = [[(j, int(S[j, k])) for j in np.flatnonzero(S[:, k]).tolist()] for k in preference(model)]
    return Columns(opened_chain(model), tuple(tuple(column) for column in signs))


@pytest.mark.parametrize("name", DEVICES)
def test_placements_at_other_lengths_are_those_of_the_device_with_these_lengths(name: str) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    lengths = {n: model.device.lengths[n] * (1.03 + 0.01 * k) for k, n in enumerate(spatial.varied(model.device))}
    rows = ClosedRows.of(model, columns(model))
    placed = joint_placements(rows.chain.joints, rows._points([lengths]))
    for pose, joint in zip(placed, resized(model.device, lengths).joints, strict=True):
        np.testing.assert_allclose(pose[0, :3, :3], joint.rotation, atol=1e-14)
        np.testing.assert_allclose(pose[0, :3, 3], joint.translation, atol=1e-14)


@pytest.mark.parametrize("name", DEVICES)
def test_linear_loops_are_those_found_anew(name: str) -> None:
    device = haptid.read_device(name)
    passive = {device.joint_names[j] for j in device.closure.unknown}
    taken = opened_tree(device.tables, device.name, passive, device)
    found = opened_tree(device.tables, device.name, passive)
    assert (taken.active, taken.joint_names) == (found.active, found.joint_names)
    np.testing.assert_allclose(taken.closure.G, found.closure.G, atol=1e-12)
    # Where they are found anew, some are a turn off.
    turns = (taken.closure.offset - found.closure.offset) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert [(t.name, t.on) for t in taken.terms] == [(t.name, t.on) for t in found.terms]
    np.testing.assert_allclose([t.weights for t in taken.terms], [t.weights for t in found.terms], atol=1e-12)


def test_columns_that_do_not_suffice_at_other_lengths_are_completed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a coefficient is zero at the device's own lengths alone."""
    model = haptid.DynamicModel(haptid.read_device("delta"))
    found, made = regroupings(model), spatial._Numbers.__init__
    missing = []

    def short(numbers: spatial._Numbers, *arguments: object) -> None:
        made(numbers, *arguments)  # type: ignore[arg-type]
        missing.extend(k for k, kept in numbers._support.items() if len(kept) > 1)
        numbers._support = {k: kept[:1] for k, kept in numbers._support.items()}
        numbers.values = {place: numbers.values[place] for place in numbers._places}

    monkeypatch.setattr(spatial._Numbers, "__init__", short)
    assert regroupings(model).coefficients == found.coefficients
    assert missing
