"""Rows without accelerations are those published for the PHANToM: Tahmasebi et al. (2005), eq. (13), two slips mended.

The first slip follows from a sign in eq. (5): the term of the arm's squared velocity in row 3 of pi_4 goes. The second:
every column passes through L(s), those of gravity and friction too.
"""

import numpy as np
import pytest
from scipy import signal

import haptid
from haptid.motion.filters import Causal
from motions import multisine

DT = 1e-3
OMEGA = 2 * np.pi * 10.0
LOW_PASS = Causal().filter(10.0, DT, differentiated=True)
L1, L3, G = 0.215, 0.0325, 9.81


def published(q, v, L):
    """Columns pi_1 to pi_14 of eq. (13), (3, 14, n), with L the low-pass of a signal."""
    (_, q2, q3), (v1, v2, v3) = q, v
    s2, c2, s3, c3, s23, c23 = np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3), np.sin(q2 - q3), np.cos(q2 - q3)

    def change(x):
        return OMEGA * (x - L(x))

    made = np.zeros((3, 14, q.shape[1]))
    for pi, factor in enumerate((np.ones_like(q2), np.cos(2 * q2), np.cos(2 * q3), c2 * s3)):
        made[0, pi] = change(v1 * factor)
    made[1, 1], made[2, 2] = L(v1**2 * np.sin(2 * q2)), L(v1**2 * np.sin(2 * q3))
    made[1, 3] = -0.5 * (OMEGA * v3 * s23 - L(OMEGA * v3 * s23 + v2 * v3 * c23 + v1**2 * s2 * s3))
    made[2, 3] = -0.5 * OMEGA * v2 * s23 + L(0.5 * (OMEGA * v2 * s23 - v1**2 * c2 * c3 - v2 * v3 * c23))
    made[1, 4], made[2, 5] = change(v2), change(v3)
    made[1, 6], made[2, 7] = L(c2), L(s3)
    for k in range(3):
        made[k, 8 + k], made[k, 11 + k] = L(v[k]), L(np.sign(v[k]))
    return made


def pi_of_beta(model):
    """The papers' fourteen parameters of the device's base parameters, from those of the links in closed form.

    Link frames have x along the bar and z on the joint; inertias are about the link's origin. Eq. (4) in them.
    """
    rows = [
        {"ZZba": 1, "Ma": L1**2 / 2, "Mc": L3**2 / 2}
        | {f"{kind}{link}": 0.5 for kind in ("XX", "YY") for link in ("be", "df", "a", "c")},
        {"YYbe": 0.5, "XXbe": -0.5, "YYc": 0.5, "XXc": -0.5, "Ma": L1**2 / 2},
        {"XXa": 0.5, "YYa": -0.5, "XXdf": 0.5, "YYdf": -0.5, "Mc": -(L3**2) / 2},
        {"MXa": 2 * L1, "MXc": 2 * L3},
        {"ZZbe": 1, "ZZc": 1, "Ma": L1**2},
        {"ZZa": 1, "ZZdf": 1, "Mc": L3**2},
        {"MXbe": G, "MXc": G, "Ma": G * L1},
        {"MXdf": G, "MXa": G, "Mc": G * L3},
        *({f"{kind}{k}": 1} for kind in ("FV", "FC") for k in (1, 2, 3)),
    ]
    P = np.array([[row.get(name, 0.0) for name in model.device.parameters.names] for row in rows])
    B = P[:, list(model.base.independent_columns)]
    np.testing.assert_allclose(B @ model.base.regrouping, P, atol=1e-9)  # the papers' set is the base's
    return B


@pytest.fixture(scope="module")
def made():
    """Columns of the device in the papers' parameters, (3, 14, n), and the motion."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    q, v, _ = multisine(3, 3.0, DT, seed=4)
    core = model.mechanism
    momentum, rest = core.momentum_regressor(q, v, np.zeros((0, q.shape[1])), list(range(core.columns)))
    rows = filtered(momentum, LOW_PASS.slope) + filtered(rest, LOW_PASS.taps)
    S = model.device.parameters.S[:, list(model.base.independent_columns)]
    W = np.einsum("ark,rp->akp", rows, S) @ np.linalg.inv(pi_of_beta(model))
    return W.transpose(0, 2, 1), q, v


def filtered(x, taps):
    return signal.oaconvolve(x, taps[::-1].reshape((1,) * (x.ndim - 1) + (-1,)), mode="valid", axes=-1)


@pytest.mark.parametrize("pi", range(14), ids=lambda k: f"pi_{k + 1}")
def test_every_column_is_the_papers(made, pi):
    W, q, v = made
    taps = LOW_PASS.taps

    def L(x):
        return np.pad(filtered(x, taps), (len(taps) - 1, 0))

    wanted = published(q, v, L)[:, pi, len(taps) - 1 :]
    np.testing.assert_allclose(W[:, pi], wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())


def test_a_recursive_filter_gives_the_same_but_for_what_was_cut(made):
    W, q, v = made
    b, a = signal.bilinear([OMEGA], [1.0, OMEGA], 1 / DT)
    wanted = published(q, v, lambda x: signal.lfilter(b, a, x))[..., -2000:]
    sizes = np.abs(wanted).max(axis=(0, 2))
    np.testing.assert_allclose(W[..., -2000:] / sizes[:, None], wanted / sizes[:, None], rtol=0, atol=2e-4)
