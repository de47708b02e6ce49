"""Where the mass matrix of a published model is positive definite: the figures that its printed parameters give."""

import numpy as np
import pytest
from scipy import optimize

import haptid
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.workspace import Box, workspace
from haptid.end_effector.definiteness import definiteness

# Table I of Tahmasebi et al. (2005), pi_1 to pi_6, in command units: 2.73 times SI. Installations by column.
INSTALLATIONS = ("cavusoglu", "normal", "gc", "fs", "usd", "usd+gc")
TABLE = np.array(
    [
        [0.0076, 0.0039, 0.0093, 0.0028, 0.0033, 0.0083],
        [0.0030, 0.0037, 0.0121, 0.0059, 0.0044, 0.0090],
        [-0.0011, -0.0011, -0.0032, -0.0021, -0.0014, -0.0020],
        [0.0025, 0.0019, 0.0252, 0.0082, 0.0018, 0.0251],
        [0.0066, 0.0057, 0.0206, 0.0095, 0.0078, 0.0174],
        [0.0025, 0.0026, 0.0097, 0.0031, 0.0035, 0.0086],
    ]
)
WORKSPACES = {
    "A": [2.2e-3, -5.3e-4, -5.7e-3, -4.5e-3, -2.1e-3, -3.3e-3],
    "B": [2.3e-3, 2.4e-3, 3.5e-3, 3.0e-4, 2.4e-3, 1.82e-3],
    "C": [2.2e-3, -5.3e-4, -6.1e-3, -4.7e-3, -2.1e-3, -6.6e-3],
}
SHARES_OF_A = [0.0, 2.6, 10.7, 20.3, 11.7, 7.7]
ANGLES = {"normal": 69.5, "gc": 60.1, "fs": 48.4, "usd": 57.7, "usd+gc": 67.2}


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def betas(model):
    """Base parameters with the printed mass matrix: M11, M22, M33 and M23 are linear in either set."""
    q = np.random.default_rng(0).uniform(-1, 1, (3, 40))
    _, q2, q3 = q
    M = np.zeros((6, 40, 3, 3))
    M[:4, :, 0, 0] = 1 + 0 * q2, np.cos(2 * q2), np.cos(2 * q3), np.cos(q2) * np.sin(q3)
    M[3, :, 1, 2] = M[3, :, 2, 1] = -0.5 * np.sin(q2 - q3)
    M[4, :, 1, 1] = M[5, :, 2, 2] = 1
    ours = np.array([mass_matrix(model, unit, q).ravel() for unit in np.eye(len(model.base))])
    beta, *_ = np.linalg.lstsq(ours.T, M.reshape(6, -1).T @ TABLE, rcond=None)
    np.testing.assert_allclose(ours.T @ beta, M.reshape(6, -1).T @ TABLE, atol=1e-15)
    return dict(zip(INSTALLATIONS, beta.T, strict=True))


def place(model, name):
    lowered = {"be": np.radians([-40, 100]), "df": np.radians([-40, 110])}
    half, centre = np.array([0.381, 0.267, 0.191]) / 2, np.array([0.0, -0.17, 0.215])
    box = Box(tuple(centre - half), tuple(centre + half))
    return {
        "A": lambda: workspace(model, lowered),
        "B": lambda: workspace(model, {"df": np.radians([-40, 119])}, box),
        "C": lambda: workspace(model),
    }[name]()


@pytest.mark.parametrize("name", WORKSPACES)
def test_smallest_eigenvalues_are_the_published_ones(model, betas, name):
    where = place(model, name)
    for installation, wanted in zip(INSTALLATIONS, WORKSPACES[name], strict=True):
        found = definiteness(betas[installation], where)
        assert found.smallest == pytest.approx(wanted, abs=0.51e-5 if wanted == 1.82e-3 else 0.51e-4)
        assert found.positive == (wanted > 0)
        assert where.slack(found.at[:, None]).min() > -1e-9
        if wanted < 0:
            np.testing.assert_allclose(np.abs(found.direction), [1, 0, 0], atol=1e-6)
            assert "It fails along motor 1." in found.summary()
        else:
            assert found.share == 0
            assert "The mass matrix is positive definite at" in found.summary()


def test_shares_of_the_workspace_are_the_published_ones(model, betas):
    where = place(model, "A")
    for installation, wanted in zip(INSTALLATIONS, SHARES_OF_A, strict=True):
        share = 100 * definiteness(betas[installation], where).share
        assert share == pytest.approx(wanted, abs=0.3)  # cells' centres here, their corners there


def test_the_first_entry_vanishes_at_the_published_angles(model, betas):
    for installation, wanted in ANGLES.items():
        angle = optimize.brentq(
            lambda q2, beta=betas[installation]: mass_matrix(model, beta, np.array([[0.0], [q2], [0.0]]))[0, 0, 0],
            0.0,
            np.pi / 2,
        )
        assert np.degrees(angle) == pytest.approx(wanted, abs=0.1)
