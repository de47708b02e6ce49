"""Loops: relations given, derived, verified and refused."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid.advice import columns
from haptid.device import poses, read_device
from haptid.device.geometry import joint_poses
from haptid.device.loops import from_toml
from haptid.device.toml import reader
from haptid.errors import DeviceFileError, LoopClosureError

LENGTH = st.floats(0.05, 1.0)


def four_bar(arm: float, lever: float, coupler: float, end: float, loop: str = "") -> str:
    """Arm and lever on one axis, a forearm on the arm, a coupler on the lever, joined by the cut."""
    frames = f'frame_a = {{ d = {coupler!r} }}, body_b = "forearm", frame_b = {{ d = {end!r} }}'
    return f"""
name = "four-bar"
gravity = [0, -9.81, 0]
[[joints]]
name = "arm"
[[joints]]
name = "lever"
parent = "base"
[[joints]]
name = "forearm"
parent = "arm"
d = {arm!r}
[[joints]]
name = "coupler"
parent = "lever"
d = {lever!r}
[[loops]]
passive = ["forearm", "coupler"]
{loop or f'cut = {{ body_a = "coupler", {frames} }}'}
"""


def device_of(folder: Path, text: str):
    path = folder / "loop.toml"
    path.write_text(text)
    return read_device(path)


@settings(max_examples=15, deadline=None)
@given(LENGTH, LENGTH.filter(lambda x: x > 0.05))
def test_any_parallelogram_closes_on_random_poses(
    tmp_path_factory: pytest.TempPathFactory, arm: float, lever: float
) -> None:
    device = device_of(tmp_path_factory.mktemp("l"), four_bar(arm, lever, arm, lever))
    closure = device.closure
    assert closure.error < 1e-13
    qa = np.random.default_rng(1).uniform(-3, 3, (20, 2))
    links = poses(device, qa @ closure.G.T + closure.offset)
    cut = closure.cuts[0]
    ends = [links[:, f.link, :3, :3] @ f.translation + links[:, f.link, :3, 3] for f in (cut.frame_a, cut.frame_b)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)
    if abs(arm - lever) > 1e-3:
        assert closure.relations == ("qforearm = -qarm + qlever", "qcoupler = qarm - qlever")


def test_sliding_cut_is_solved(tmp_path: Path) -> None:
    # Two turning bars and a slider between them: the slide stays parallel to itself whatever the bar does.
    text = """
name = "slide"
gravity = [0, 0, 0]
[[joints]]
name = "1"
type = "prismatic"
[[joints]]
name = "2"
type = "prismatic"
parent = "base"
[[joints]]
name = "3"
parent = "1"
[[loops]]
passive = ["2", "3"]
[loops.cut]
type = "revolute"
body_a = "2"
frame_a = { xyz = [0, 0, 0.5] }
body_b = "1"
frame_b = { xyz = [0, 0, 0.2] }
"""
    with pytest.raises(DeviceFileError) as caught:
        device_of(tmp_path, text)
    assert (caught.value.found, caught.value.limit) == (1, 2)
    device = device_of(
        tmp_path, text.replace('["2", "3"]', '["2"]').replace('[[joints]]\nname = "3"\nparent = "1"\n', "")
    )
    assert device.closure.relations == ("q2 = -0.3 + q1",)
    text = (
        text.replace('type = "revolute"', 'type = "prismatic"')
        .replace('body_a = "2"', 'body_a = "3"')
        .replace('["2", "3"]', '["3"]')
    )
    device = device_of(tmp_path, text)  # collinear z, free along it, no turn: only joint 3 is settled
    assert device.closure.relations == ("q3 = 0",)
    assert device.active == (0, 1)


def test_relations_need_no_cut_and_may_chain(tmp_path: Path) -> None:
    loop = 'relations = ["qforearm = qlever - qarm", "qcoupler = -qforearm"]'
    device = device_of(tmp_path, four_bar(0.3, 0.1, 0.3, 0.1, loop=loop))
    np.testing.assert_array_equal(device.closure.G, [[1, 0], [0, 1], [-1, 1], [1, -1]])
    assert device.closure.error == 0.0
    assert device.closure.relations == ("qforearm = -qarm + qlever", "qcoupler = qarm - qlever")


def test_relations_are_verified_against_the_cut(tmp_path: Path) -> None:
    cut = 'cut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "forearm", frame_b = { d = 0.1 } }\n'
    good = 'relations = ["qforearm = qlever - qarm", "qcoupler = qarm - qlever"]'
    assert device_of(tmp_path, four_bar(0.3, 0.1, 0.3, 0.1, loop=cut + good)).closure.error < 1e-13
    with pytest.raises(LoopClosureError) as caught:
        device_of(
            tmp_path,
            four_bar(0.3, 0.1, 0.3, 0.1, loop=cut + good.replace("qlever - qarm", "qlever - 2*qarm")),
        )
    assert caught.value.found > 0.05


def test_one_relation_given_and_the_other_derived(tmp_path: Path) -> None:
    cut = 'cut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "forearm", frame_b = { d = 0.1 } }\n'
    device = device_of(tmp_path, four_bar(0.3, 0.1, 0.3, 0.1, loop=cut + 'relations = ["qforearm = qlever - qarm"]'))
    assert device.closure.relations[1] == "qcoupler = qarm - qlever"


def test_a_loop_that_cannot_close_says_by_how_much(tmp_path: Path) -> None:
    with pytest.raises(LoopClosureError) as caught:
        device_of(tmp_path, four_bar(0.1, 0.1, 1.0, 0.1))
    # Arm, lever and forearm reach 0.3 of the coupler's 1.0; least squares spread what is missing.
    assert 0.2 < caught.value.found < 0.71


def test_a_loop_that_is_not_linear_requires_a_guess_where_it_closes_in_several_ways(tmp_path: Path) -> None:
    with pytest.raises(LoopClosureError) as caught:
        device_of(tmp_path, four_bar(0.30, 0.10, 0.31, 0.12))
    assert (caught.value.found, caught.value.limit) == (2, 1)


def test_guess_chooses_the_turn(tmp_path: Path) -> None:
    for guess, want in ((0.1, 0.0), (-6.0, -2 * np.pi), (6.2, 2 * np.pi)):
        text = four_bar(0.3, 0.1, 0.3, 0.1) + f"guess = {{ forearm = {guess} }}\n"
        device = device_of(tmp_path, text)
        assert device.closure.offset[2] == pytest.approx(want, abs=1e-12)
        assert device.closure.offset[3] == pytest.approx(0.0, abs=1e-12)


def test_a_rhombus_closes_in_more_ways_and_says_so(tmp_path: Path) -> None:
    device = device_of(tmp_path, four_bar(0.2, 0.2, 0.2, 0.2))
    assert device.closure.error < 1e-13
    assert any("linear assembly modes" in note for note in device.notes)


@pytest.mark.parametrize(
    ("loop", "match"),
    [
        ("guess = {}", "neither relations nor a cut"),
        ('relations = ["qforearm = qlever"]', "nothing says how coupler"),
        ('relations = ["qforearm = qcoupler", "qcoupler = qforearm"]', "circular"),
        ('relations = ["qforearm = qlever", "qforearm = qarm", "qcoupler = 0"]', "already has a relation"),
        ('relations = ["qforearm = qlever", "qcoupler = 0"]\nguess = { arm = 1 }', "which no loop moves"),
    ],
)
def test_relations_must_determine_every_passive_joint(tmp_path: Path, loop: str, match: str) -> None:
    with pytest.raises(DeviceFileError, match=match):
        device_of(tmp_path, four_bar(0.3, 0.1, 0.3, 0.1, loop=loop))


def test_relations_across_loops_must_end_at_active_joints(tmp_path: Path) -> None:
    text = four_bar(0.3, 0.1, 0.3, 0.1, loop='relations = ["qforearm = qlever", "qcoupler = qtool"]')
    text = text.replace("[[loops]]", '[[joints]]\nname = "tool"\nparent = "forearm"\n[[loops]]', 1)
    text += '[[loops]]\npassive = ["tool"]\ncut = { body_a = "tool", body_b = "base" }\n'
    with pytest.raises(DeviceFileError, match="qtool, which is itself passive"):
        device_of(tmp_path, text)


def test_cuts_may_end_on_the_base(tmp_path: Path) -> None:
    # The classical parallelogram with two pivots on the base.
    text = """
name = "based"
gravity = [0, -9.81, 0]
[base]
rpy = [0.3, 0, 0]
[[joints]]
name = "crank"
[[joints]]
name = "rod"
d = 0.2
[[joints]]
name = "rocker"
d = 0.5
[[loops]]
passive = ["rod", "rocker"]
cut = { body_a = "rocker", frame_a = { d = 0.2 }, body_b = "base", frame_b = { xyz = [0.5, 0, 0] } }
"""
    device = device_of(tmp_path, text)
    assert device.closure.relations == ("qrod = -qcrank", "qrocker = pi + qcrank")


def test_jacobian_of_the_gap_is_its_derivative() -> None:
    from haptid.device.loops.chain import Chain
    from haptid.device.parts import Cut, Frame

    device = read_device("sr400")
    rng = np.random.default_rng(5)
    turn = joint_poses(device.joints, rng.normal(size=(1, 8)))[0, 7, :3, :3]
    frames = Frame(7, turn, rng.normal(size=3)), Frame(5, turn.T, rng.normal(size=3))
    for kind, gaps in (("revolute", 6), ("prismatic", 8), ("spherical", 3)):
        chain = Chain.of(device.joints, (Cut(kind, *frames),), device.active)
        q = rng.normal(size=(4, 8))
        r, J = chain.residual(q)
        for k in range(8):
            ahead = q.copy()
            ahead[:, k] += 1e-6
            behind = q.copy()
            behind[:, k] -= 1e-6
            slope = (chain.residual(ahead)[0] - chain.residual(behind)[0]) / 2e-6
            np.testing.assert_allclose(J[:, :, k], slope, atol=1e-8)
        assert r.shape == (4, gaps)


def test_loops_that_leave_nothing_to_move_are_refused(tmp_path: Path) -> None:
    """Found by fuzzing an imported structure; the search for linear motions had nothing to take the greatest of."""
    text = four_bar(0.3, 0.1, 0.3, 0.1).replace('passive = ["forearm"', 'passive = ["arm", "lever", "forearm"')
    with pytest.raises(DeviceFileError, match="all joints are passive"):
        device_of(tmp_path, text)


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "sr400", "five_bar", "delta"])
def test_a_closure_that_closes_loops_of_other_lengths_is_theirs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    device = read_device(name)
    others = [columns.changed(device.tables, what.key, what.step) for what, _ in columns._lengths(device.tables)]
    searched = [reader.device_of(tables, name) for tables in others]
    monkeypatch.delattr(from_toml, "find_linear_motions")
    closing = partial(from_toml.close_as, device.closure)
    qa = 0.1 * np.random.default_rng(0).uniform(-1, 1, (len(device.active), 20))
    qa += getattr(device.closure, "at", np.zeros(len(device.active)))[:, None]
    for tables, expected in zip(others, searched, strict=True):
        closure, known = reader.device_of(tables, name, closing).closure, expected.closure
        # By Newton's method from another start: a few roundings.
        np.testing.assert_allclose(closure.follow(qa).q, known.follow(qa).q, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(closure.varying, known.varying)
        assert closure.error == pytest.approx(known.error, abs=1e-15)
        assert closure.relations == known.relations
        assert closure.cuts is not device.closure.cuts
        if not known.varying.any():
            np.testing.assert_array_equal(closure.constant, known.constant)
            np.testing.assert_array_equal(closure.offset, known.offset)


def test_a_closure_that_closes_them_no_more_is_not(tmp_path: Path) -> None:
    """One bar of a parallelogram is longer: its passive joints no longer move at constant rates."""
    guess = 'guess = { forearm = 0.3 }\ncut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "forearm", '
    loop = f"{guess}frame_b = {{ d = 0.2 }} }}"
    device = device_of(tmp_path, four_bar(0.3, 0.2, 0.3, 0.2, loop))
    longer = columns.changed(device.tables, ("joints", 2, "d"), 1e-3)
    closing = partial(from_toml.close_as, device.closure)
    assert reader.device_of(longer, "loop", closing).closure.varying.any()
