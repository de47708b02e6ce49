"""Base parameters with symbolic lengths equal the numeric ones once the lengths are substituted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from device_files import device_text
from haptid.dynamics.symbolic.chain import symbolic_chain
from haptid.dynamics.symbolic.geometry import placement_value


def drawn(folder: Path, text: str) -> haptid.Device:
    path = folder / "drawn.toml"
    path.write_text(text, encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_both_methods_find_the_same(tmp_path_factory: pytest.TempPathFactory, seed: int, joints: int) -> None:
    model = drawn(tmp_path_factory.mktemp("d"), device_text(seed, joints))
    exact = model.regroupings  # raises RegroupingError where they differ
    assert exact.independent_columns == model.base.independent_columns
    assert exact.names == model.base.names


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_twist_that_is_no_quarter_turn(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    model = drawn(tmp_path_factory.mktemp("d"), device_text(seed, 3, free_angle=True))
    assert len(model.regroupings) == len(model.base)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.booleans())
def test_placements_with_symbols_have_the_values_of_those_with_numbers(
    tmp_path_factory: pytest.TempPathFactory, seed: int, joints: int, free_angle: bool
) -> None:
    model = drawn(tmp_path_factory.mktemp("d"), device_text(seed, joints, free_angle))
    chain = symbolic_chain(model.device)
    values = {symbol.name: symbol.value for symbol in chain.symbols}
    for exact, joint in zip(chain.joints, model.device.joints, strict=True):
        made = placement_value(exact.placement, values)
        np.testing.assert_allclose(made[:3, :3], joint.rotation, atol=1e-12)
        np.testing.assert_allclose(made[:3, 3], joint.translation, atol=1e-12)


# Loops that are no dyads have numeric groupings only.
NUMERIC_ONLY = {"cea_medical_interface", "delta", "slider_crank"}


@pytest.mark.parametrize("name", sorted(NUMERIC_ONLY))
def test_loops_that_are_no_dyads_say_so(name: str) -> None:
    with pytest.raises(haptid.errors.RegroupingError):
        _ = haptid.DynamicModel(haptid.read_device(name)).regroupings


@pytest.mark.parametrize("name", [name for name in haptid.shipped_devices() if name not in NUMERIC_ONLY])
def test_shipped_devices_have_both(name: str) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    np.testing.assert_allclose(model.regroupings.values, model.base.regrouping, atol=1e-9, rtol=1e-9)
    assert model.regroupings.no_effect == model.base.no_effect
