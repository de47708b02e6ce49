"""Base parameters with symbolic lengths equal the numeric ones once the lengths are substituted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
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


@pytest.mark.parametrize("name", haptid.shipped_devices())
def test_shipped_devices_have_both(name: str) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    np.testing.assert_allclose(model.regroupings.values, model.base.regrouping, atol=1e-9, rtol=1e-9)
    assert model.regroupings.no_effect == model.base.no_effect


# A crank and a rocker on skew axes, joined by a bar with a universal joint and a ball: a loop in space.
SPATIAL = """
schema = 1
name = "crank and rocker in space"
gravity = [0, 0, -9.81]
convention = "placement"

[lengths]
crank = {crank}
bar = {bar}
rocker = {rocker}

[[joints]]
name = "crank"
axis = [0, 0, 1]
limits = {{ position = [-0.3, 0.3] }}

[[joints]]
name = "u"
parent = "crank"
xyz = ["crank", 0, 0]
axis = [0, 0, 1]
body = false

[[joints]]
name = "v"
parent = "u"
axis = [0, 1, 0]

[[joints]]
name = "rocker"
parent = "base"
xyz = [0.3, 0.05, 0.1]
axis = [0, 1, 0]

[[loops]]
passive = ["u", "v", "rocker"]
guess = {{ u = 0.2, v = 0.3, rocker = 1.4 }}
[loops.cut]
type = "spherical"
body_a = "v"
frame_a = {{ xyz = ["bar", 0, 0] }}
body_b = "rocker"
frame_b = {{ xyz = ["rocker", 0, 0] }}

[[terms]]
kind = "viscous"
joints = "all"
"""


@settings(max_examples=5, deadline=None, phases=(Phase.explicit, Phase.generate))
@given(st.floats(0.06, 0.1), st.floats(0.26, 0.3), st.floats(0.18, 0.22))
@example(0.0609605, 0.2665347, 0.2153367)  # kept columns of condition 6e8: coefficients of zero are 1e-7 by rounding
def test_loops_in_space_have_both(
    tmp_path_factory: pytest.TempPathFactory, crank: float, bar: float, rocker: float
) -> None:
    """The friction of passive joints stays apart, and the bar's far end is a point mass on the rocker."""
    model = drawn(tmp_path_factory.mktemp("d"), SPATIAL.format(crank=crank, bar=bar, rocker=rocker))
    exact = model.regroupings  # raises RegroupingError where they differ
    row = dict(zip(exact.names, exact.texts, strict=True))
    assert {"FVcrank", "FVu", "FVv", "FVrocker"} <= set(row)
    assert any("bar" in text for texts in row.values() for text in texts.values())


def test_a_loop_in_space_of_which_one_torque_is_measured(tmp_path: Path) -> None:
    """On a turntable without a motor, what the crank resists by centrifugal forces alone is no less independent."""
    text = SPATIAL.format(crank=0.08, bar=0.28, rocker=0.2)
    table = '[[joints]]\nname = "table"\naxis = [0, 0, 1]\n\n[[joints]]\nname = "crank"\nparent = "table"\n'
    for old, new in (
        ('[[joints]]\nname = "crank"\n', f'{table}rpy = ["pi/2", 0, 0]\n'),
        ('parent = "base"\nxyz = [0.3, 0.05, 0.1]', 'parent = "table"\nxyz = [0.3, -0.1, 0.05]\nrpy = ["pi/2", 0, 0]'),
    ):
        assert old in text
        text = text.replace(old, new)
    model = drawn(tmp_path, f'{text}\n[[motors]]\nname = "1"\ndrives = {{ crank = 1.0 }}\n')
    exact = model.regroupings  # raises RegroupingError where they differ
    assert not all(model.device.measured)
    row = dict(zip(exact.names, exact.texts, strict=True))
    assert row["XXcrankR"] == {"XXcrank": "1", "YYcrank": "-1", "Mv": "-crank^2", "MXrocker": "-crank^2/rocker"}


@pytest.mark.parametrize("tilt", ["0.3", '"atan2(crank, bar)"'])
def test_loops_in_space_with_a_named_angle(tmp_path: Path, tilt: str) -> None:
    """It turns a frame by its own value, also at other lengths."""
    text = SPATIAL.format(crank=0.08, bar=0.28, rocker=f"0.2\ntilt = {tilt}")
    turned = text.replace('name = "v"\n', 'name = "v"\nrpy = ["tilt", 0, 0]\n')
    assert turned != text
    model = drawn(tmp_path, turned)
    exact = model.regroupings  # raises RegroupingError where they differ, or where the loops do not close elsewhere
    assert exact.independent_columns == model.base.independent_columns


def test_numbers_that_loops_depend_on_have_to_be_named(tmp_path: Path) -> None:
    """Without a name the bar is a number, and so is what depends on it: no ratio of small integers."""
    unnamed = ('frame_a = { xyz = ["bar"', "frame_a = { xyz = [0.28")
    text = SPATIAL.format(crank=0.08, bar=0.3, rocker=0.2).replace(*unnamed)
    with pytest.raises(haptid.errors.RegroupingError, match=r"no formula.*Name the lengths"):
        _ = drawn(tmp_path, text).regroupings
    # A number of the size of a named length is that length, as everywhere.
    same = drawn(tmp_path, SPATIAL.format(crank=0.08, bar=0.28, rocker=0.2).replace(*unnamed)).regroupings
    named = drawn(tmp_path, SPATIAL.format(crank=0.08, bar=0.28, rocker=0.2)).regroupings
    assert same.formulas == named.formulas
