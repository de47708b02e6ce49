"""Geometry: every convention to one normal form, and poses of links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid.device import poses, read_device
from haptid.device.geometry import least_turn, modified_dh, placed, shift, turn_x, turn_y, turn_z
from haptid.errors import ShapeError

ANGLES = st.floats(-3, 3)
HEAD = 'name = "t"\ngravity = [0, 0, -9.81]\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "t.toml"
    path.write_text(HEAD + text)
    return path


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(*[ANGLES] * 6, st.booleans()), min_size=1, max_size=4), st.integers(0, 99))
def test_modified_dh_is_khalils_product(tmp_path_factory: pytest.TempPathFactory, rows: list, seed: int) -> None:
    keys = ("gamma", "b", "alpha", "d", "theta", "r")
    text = 'convention = "modified-dh"\n' + "".join(
        f'[[joints]]\nname = "{k}"\ntype = "{"prismatic" if row[6] else "revolute"}"\n'
        + "".join(f"{key} = {value!r}\n" for key, value in zip(keys, row, strict=False))
        for k, row in enumerate(rows)
    )
    device = read_device(written(tmp_path_factory.mktemp("g"), text))
    q = np.random.default_rng(seed).uniform(-2, 2, (3, len(rows)))
    made = poses(device, q)
    for sample in range(3):
        T = np.eye(4)
        for k, (gamma, b, alpha, d, theta, r, slides) in enumerate(rows):
            x = q[sample, k]
            T = T @ modified_dh(gamma, b, alpha, d, theta + (0 if slides else x), r + (x if slides else 0))
            np.testing.assert_allclose(made[sample, k], T, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(*[ANGLES] * 4, st.booleans()), min_size=1, max_size=4), st.integers(0, 99))
def test_standard_dh_links_are_found_back(tmp_path_factory: pytest.TempPathFactory, rows: list, seed: int) -> None:
    text = 'convention = "dh"\n[base]\nrpy = [0.1, 0.2, 0.3]\nxyz = [1, 2, 3]\n' + "".join(
        f'[[joints]]\nname = "{k}"\ntype = "{"prismatic" if slides else "revolute"}"\n'
        f"theta = {theta!r}\nd = {d!r}\na = {a!r}\nalpha = {alpha!r}\n"
        for k, (theta, d, a, alpha, slides) in enumerate(rows)
    )
    device = read_device(written(tmp_path_factory.mktemp("g"), text))
    q = np.random.default_rng(seed).uniform(-2, 2, len(rows))
    made = poses(device, q[None])[0]
    T = placed([1, 2, 3], [0.1, 0.2, 0.3])
    for k, (theta, d, a, alpha, slides) in enumerate(rows):
        T = T @ turn_z(theta + (0 if slides else q[k])) @ shift(z=d + (q[k] if slides else 0))
        np.testing.assert_allclose(made[k], T, atol=1e-12)  # haptid keeps the frame on the joint axis
        T = T @ shift(x=a) @ turn_x(alpha)
        np.testing.assert_allclose(made[k] @ frame(device.joints[k]), T, atol=1e-12)


def frame(joint) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = joint.frame_rotation, joint.frame_translation
    return made


@settings(max_examples=25, deadline=None)
@given(st.tuples(*[ANGLES] * 9).filter(lambda row: np.linalg.norm(row[6:]) > 0.1), ANGLES, st.booleans())
def test_placement_turns_about_its_axis(
    tmp_path_factory: pytest.TempPathFactory, row: tuple, q: float, slides: bool
) -> None:
    xyz, rpy, axis = list(row[:3]), list(row[3:6]), np.array(row[6:])
    text = (
        'convention = "placement"\n[[joints]]\nname = "a"\n'
        f'type = "{"prismatic" if slides else "revolute"}"\n'
        f"xyz = {xyz}\nrpy = {rpy}\naxis = {axis.tolist()}\n[handle]\nlink = 'a'\nxyz = [0.1, 0.2, 0.3]\n"
    )
    device = read_device(written(tmp_path_factory.mktemp("g"), text))
    unit = axis / np.linalg.norm(axis)
    K = np.cross(np.eye(3), unit)
    motion = np.eye(4)
    if slides:
        motion[:3, 3] = q * unit
    else:
        motion[:3, :3] += np.sin(q) * K + (1 - np.cos(q)) * K @ K
    want = placed(xyz, rpy) @ motion
    made = poses(device, np.array([[q]]))[0, 0]
    np.testing.assert_allclose(made @ frame(device.joints[0]), want, atol=1e-12)
    handle = device.handle
    assert handle is not None
    tip = made[:3, :3] @ handle.translation + made[:3, 3]
    np.testing.assert_allclose(tip, (want @ [0.1, 0.2, 0.3, 1])[:3], atol=1e-12)


@given(st.tuples(ANGLES, ANGLES, ANGLES).filter(lambda a: np.linalg.norm(a) > 1e-3))
def test_least_turn_takes_z_onto_the_axis(axis: tuple[float, float, float]) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    R = least_turn(unit)[:3, :3]
    np.testing.assert_allclose(R[:, 2], unit, atol=1e-9)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.trace(R) == pytest.approx(1 + 2 * unit[2], abs=1e-9)  # turned by the angle between them, no more


def test_least_turn_of_minus_z_is_a_half_turn_about_x() -> None:
    np.testing.assert_array_equal(least_turn(np.array([0, 0, -1.0])), turn_x(np.pi))
    np.testing.assert_array_equal(least_turn(np.array([0, 0, 1.0])), np.eye(4))


def test_quarter_turns_are_exact() -> None:
    assert (turn_x(np.pi / 2) == [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]).all()
    assert (turn_y(-np.pi) == np.diag([-1, 1, -1, 1])).all()


def test_poses_need_a_position_for_every_joint() -> None:
    with pytest.raises(ShapeError, match=r"q_tree has shape \(2, 5\)"):
        poses(read_device("rx90"), np.zeros((2, 5)))
