"""Long blocks are folded in pieces; the regressor is made in parts, or into a given array: the numbers are the same."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid import _core
from haptid.dynamics.model import mechanism_arguments

# More than one piece of rows, more than two parts of samples, and no whole lanes.
SAMPLES = 4999


def three_links() -> tuple[haptid.Device, list[np.ndarray], list[int]]:
    """A device, a made-up motion of it, and all its columns."""
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    rng = np.random.default_rng(3)
    n = len(model.device.active)
    motion = [rng.uniform(-1, 1, (n, SAMPLES)) for _ in range(3)]
    return model, [*motion, np.zeros((0, SAMPLES))], list(range(model.mechanism.columns))


@pytest.mark.parametrize("backend", _core.backends())
def test_a_long_block_has_the_inner_products_of_all_its_rows(backend: str) -> None:
    model, motion, columns = three_links()
    core = _core.Mechanism(*mechanism_arguments(model)._replace(backend=backend))
    tau = np.random.default_rng(4).normal(size=motion[0].shape)
    Y = core.regressor(*motion, columns)
    made = core.reduce(*motion, tau, columns, np.ones(1), 1, 0, SAMPLES, SAMPLES, np.ones_like(tau))
    for y, torque, (reached, triangles) in zip(Y, tau, made, strict=True):
        W = np.vstack([y[reached], torque])
        assert triangles.shape == (1, len(reached) + 1, len(reached) + 1)
        np.testing.assert_allclose(triangles[0].T @ triangles[0], W @ W.T, rtol=0, atol=1e-11 * np.abs(W @ W.T).max())


def test_blocks_longer_than_a_piece_keep_their_bounds() -> None:
    model, motion, columns = three_links()
    tau = np.random.default_rng(5).normal(size=motion[0].shape)
    block = 2500
    made = model.mechanism.reduce(*motion, tau, columns, np.ones(1), 1, 0, SAMPLES, block, np.ones_like(tau))
    for (_, triangles), torque in zip(made, tau, strict=True):
        power = np.linalg.norm(triangles[:, :, -1], axis=1) ** 2
        np.testing.assert_allclose(power, [np.sum(torque[:block] ** 2), np.sum(torque[block:] ** 2)], rtol=1e-12)


def test_every_sample_is_made_alike() -> None:
    model, motion, columns = three_links()
    whole = model.mechanism.regressor(*motion, columns)
    for first in (0, 1021, 2045, SAMPLES - 5):
        few = [np.ascontiguousarray(x[:, first : first + 5]) for x in motion]
        np.testing.assert_array_equal(model.mechanism.regressor(*few, columns), whole[:, :, first : first + 5])
    chi = np.zeros(model.mechanism.columns)
    chi[columns] = 1.0
    tau = model.mechanism.torque(*motion, chi)
    np.testing.assert_allclose(tau, whole.sum(axis=1), atol=1e-11)


def test_the_regressor_is_written_into_a_given_array() -> None:
    model, motion, columns = three_links()
    out = np.full((3, len(columns), SAMPLES), np.nan)
    assert model.mechanism.regressor(*motion, columns, None, out) is out
    np.testing.assert_array_equal(out, model.mechanism.regressor(*motion, columns))


@pytest.mark.parametrize("wrong", [np.zeros((3, 1, SAMPLES)), np.zeros((SAMPLES, 1, 3)).T[:, :0]])
def test_a_given_array_must_fit(wrong: np.ndarray) -> None:
    model, motion, columns = three_links()
    with pytest.raises(ValueError, match="out has shape"):
        model.mechanism.regressor(*motion, columns, None, wrong)
