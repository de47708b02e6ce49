"""Closed paths of loops: passive joints keep turning continuously, in every chunk of a long motion."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid import _core
from haptid.device.loops.chain import compiled

# Many pieces of samples that threads share, and no whole lanes.
SAMPLES = 3001


def test_two_turns_of_a_crank_and_back() -> None:
    model = haptid.DynamicModel(haptid.read_device("four_bar"))
    turns = model.device.closure.at[0] + 2 * np.pi * (1 - np.cos(np.linspace(0, 2 * np.pi, SAMPLES)))
    q = model.device.closure.positions(turns[None])
    assert np.abs(np.diff(q, axis=1)).max() < 0.05
    np.testing.assert_allclose(q[:, SAMPLES // 2] - q[:, 0], [4 * np.pi, -4 * np.pi, 0], atol=1e-9)
    np.testing.assert_allclose(q[:, -1], q[:, 0], atol=1e-12)
    single = np.concatenate([model.device.closure.positions(x[None]) for x in np.split(turns, [500, 1003])], axis=1)
    np.testing.assert_allclose(single, q, atol=1e-11)


def round_a_hole(at: np.ndarray) -> np.ndarray:
    """From the start once round the poses at which both elbows meet, back to the start, and a little further."""
    first = np.arccos(0.025 / 2 / 0.063)
    hole = np.array([first, np.pi - first])
    angle = np.linspace(0, 2 * np.pi, SAMPLES) - np.pi / 4
    circle = hole + 0.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    there = np.linspace(at, circle[0], 700)
    further = np.linspace(at, at + np.array([0.2, 0.1]), 700)
    return np.concatenate([there, circle, there[::-1], further]).T


def test_passive_joints_make_a_turn_round_a_hole_and_keep_it() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    way = round_a_hole(model.device.closure.at)
    q = model.device.closure.positions(way)
    assert np.abs(np.diff(q, axis=1)).max() < 0.05
    assert np.abs(model.device.closure.chain.residual(q.T)[0]).max() < 1e-13
    back = SAMPLES + 1400
    np.testing.assert_allclose(np.abs(q[2:, back - 1] - q[2:, 0]), 2 * np.pi, atol=1e-11)
    # Whole turns apart, it is where the start leads to.
    alone = model.device.closure.positions(way[:, back:])
    np.testing.assert_allclose((q[:, back:] - alone)[2:], (q[2:, back - 1] - q[2:, 0])[:, None] + np.zeros((2, 700)))
    speed = np.gradient(way, 1e-3, axis=1)
    whole = model.device.closure.follow(way, speed)
    few = model.device.closure.follow(way[:, back:], speed[:, back:])
    np.testing.assert_allclose(whole.G[back:], few.G, atol=1e-12)
    np.testing.assert_allclose(whole.Gd[back:], few.Gd, atol=1e-9)


def test_nothing_to_close_is_an_error_and_no_columns_are_none() -> None:
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    closure, n = model.device.closure, 4
    loops, rest = compiled(closure.chain), (closure.offset, closure.start)
    for active, unknown, wrong in (([], [2, 3], "active"), ([0, 1], [], "unknown")):
        some = np.zeros((n, len(active)))
        with pytest.raises(ValueError, match=f"number of {wrong} joints is 0, wanted at least one"):
            _core.Branch(loops, active, unknown, some, *rest, some.astype(bool), 1e-12, 1e-3)
    arm = haptid.DynamicModel(haptid.read_device("arm3"))
    motion = [np.zeros((3, 5)), np.zeros((3, 5)), np.zeros((3, 5)), np.zeros((0, 5))]
    assert arm.mechanism.regressor(*motion, []).shape == (3, 0, 5)
    np.testing.assert_array_equal(arm.mechanism.torque(*motion, np.zeros(arm.mechanism.columns)), np.zeros((3, 5)))
