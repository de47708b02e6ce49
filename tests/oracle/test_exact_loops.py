"""Loops that are no parallelograms: groupings against numbers, closed by Newton's method and projected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.device.geometry import Reader
from haptid.device.loops.chain import Chain, close_cuts
from haptid.device.loops.from_toml import read_loops
from haptid.device.toml.errors_at import Place
from haptid.device.toml.reader import read_tables
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import rows
from haptid.dynamics.symbolic import loop_regroupings
from haptid.dynamics.symbolic.loops import opened_tree

LENGTHS = "[lengths]\nL0 = 0.2\nL1 = 0.15\nL2 = 0.22\nL3 = 0.14\nL4 = 0.25\n"
TERMS = """
[[terms]]
kind = "rotor-inertia"
joints = "active"
[[terms]]
kind = "viscous"
joints = "all"
"""
FIVE_BAR = """
[[joints]]
name = "1"
[[joints]]
name = "2"
d = "L1"
[[joints]]
name = "3"
parent = "base"
d = "L0"
[[joints]]
name = "4"
d = "L3"
[[loops]]
passive = ["2", "4"]
cut = { body_a = "2", frame_a = { d = "L2" }, body_b = "4", frame_b = { d = "L4" } }
"""
# The same linkage cut where the last bar meets the base: both passive joints in one branch.
CUT_AT_THE_BASE = """
[[joints]]
name = "1"
[[joints]]
name = "2"
d = "L1"
[[joints]]
name = "4"
d = "L2"
[[loops]]
passive = ["2", "4"]
cut = { body_a = "4", frame_a = { d = "L4" }, body_b = "base", frame_b = { d = "L0" } }
"""
# On a turntable, its plane upright, and a second dyad on the first one's arm.
TWO_DYADS = """
[[joints]]
name = "0"
[[joints]]
name = "1"
alpha = "pi/2"
[[joints]]
name = "2"
d = "L1"
[[joints]]
name = "3"
parent = "0"
alpha = "pi/2"
d = "L0"
[[joints]]
name = "4"
d = "L3"
[[joints]]
name = "5"
parent = "2"
d = "0.3"
[[joints]]
name = "6"
parent = "4"
d = "0.31"
[[loops]]
passive = ["2", "4"]
cut = { body_a = "2", frame_a = { d = "L2" }, body_b = "4", frame_b = { d = "L4" } }
[[loops]]
passive = ["5", "6"]
cut = { body_a = "5", frame_a = { d = 0.4, b = 0 }, body_b = "6", frame_b = { d = 0.45 } }
"""
# A slider in the plane in place of the first crank.
SLIDER = """
[[joints]]
name = "1"
type = "prismatic"
alpha = "pi/2"
[[joints]]
name = "2"
alpha = "-pi/2"
d = "L1"
[[joints]]
name = "3"
parent = "base"
d = "L0"
[[joints]]
name = "4"
d = "L3"
[[loops]]
passive = ["2", "4"]
cut = { body_a = "2", frame_a = { d = "L2" }, body_b = "4", frame_b = { d = "L4" } }
"""
LINKAGES = {"five-bar": FIVE_BAR, "four-bar": CUT_AT_THE_BASE, "two dyads": TWO_DYADS, "slider": SLIDER}


def written(folder: Path, linkage: str, gravity: str = "0, -9.81, 0", terms: str = TERMS) -> Path:
    path = folder / "linkage.toml"
    path.write_text(f'name = "linkage"\ngravity = [{gravity}]\n{LENGTHS}{linkage}{terms}', encoding="utf-8")
    return path


def numeric_rows(path: Path, states: int = 60) -> np.ndarray:
    """Torques of active joints by standard parameter, by Newton's method and differentiated Jacobians."""
    tables, file = read_tables(path)
    passive = [name for loop in tables.loops for name in loop.passive]
    tree = opened_tree(tables, file)
    loops = read_loops(tables.loops, tree.joints, np.eye(4), Reader(tree.lengths), Place(file))
    unknown = [tree.joint_names.index(name) for name in passive]
    active = [j for j in range(len(tree.joints)) if j not in unknown]
    chain = Chain.of(tree.joints, loops.cuts, tuple(active))
    rng = np.random.default_rng(0)
    q = close_cuts(chain, rng.uniform(-np.pi, np.pi, (states * 20, len(tree.joints))), unknown, steps=200)
    J = chain.residual(q)[1]
    good = np.abs(chain.residual(q)[0]).max(axis=1) < 1e-13
    good &= np.linalg.svd(J[:, :, unknown], compute_uv=False)[:, -1] > 0.02
    q, J = q[good][:states], J[good][:states]
    assert len(q) == states
    back = np.linalg.pinv(J[:, :, unknown])
    G = np.zeros((states, len(tree.joints), len(active)))
    G[:, active, range(len(active))] = 1.0
    G[:, unknown] = -back @ J[:, :, active]
    qda, qdda = rng.uniform(-1, 1, (2, states, len(active), 1))
    qd, qdd = G @ qda, np.zeros((states, len(tree.joints), 1))
    step = 1e-6
    ahead, behind = (chain.residual(q + sign * step * qd[..., 0])[1] for sign in (1, -1))
    qdd[:, active] = qdda
    qdd[:, unknown] = -back @ (J[:, :, active] @ qdda + (ahead - behind) / (2 * step) @ qd)
    Y = rows(DynamicModel(tree), *(np.ascontiguousarray(x) for x in (q.T, qd[..., 0].T, qdd[..., 0].T)))
    return np.einsum("njm,jpn->nmp", G, Y).reshape(-1, Y.shape[1]) @ tree.parameters.S


@pytest.mark.parametrize("gravity", ["0, -9.81, 0", "0, 0, 0"])
@pytest.mark.parametrize("name", [*LINKAGES])
def test_relations_hold_at_numeric_solutions_and_no_more_do(name: str, gravity: str, tmp_path: Path) -> None:
    path = written(tmp_path, LINKAGES[name], gravity)
    exact, W = loop_regroupings(path), numeric_rows(path)
    kept = list(exact.independent_columns)
    np.testing.assert_allclose(W[:, kept] @ exact.values, W, atol=1e-6 * np.abs(W).max())
    assert np.linalg.matrix_rank(W[:, kept] / np.linalg.norm(W[:, kept], axis=0), tol=1e-6) == len(kept)
    no_effect = [exact.standard.index(parameter) for parameter in exact.no_effect]
    assert np.abs(W[:, no_effect]).max() < 1e-6 * np.abs(W).max()


def test_groupings_of_a_five_bar(tmp_path: Path) -> None:
    """A bar's first moment along its length is a mass at its far end: MX4 / L4 at the pin, on both sides."""
    exact = loop_regroupings(written(tmp_path, FIVE_BAR))
    text = dict(zip(exact.names, exact.formulas, strict=True))
    assert text["ZZ1R"] == "ZZ1 + IA1 + M2 L1^2 + MX4 L1^2/L4"
    assert text["ZZ2R"] == "ZZ2 + MX4 L2^2/L4"
    assert text["ZZ3R"] == "ZZ3 + IA3 + M4 L3^2 - MX4 L3^2/L4"
    assert text["ZZ4R"] == "ZZ4 - MX4 L4"
    for seed in range(1, 10):
        again = loop_regroupings(tmp_path / "linkage.toml", seed)
        assert again.coefficients == exact.coefficients


def test_motors_say_which_torques_are_known(tmp_path: Path) -> None:
    """One motor of two: friction of the other joint shows only through the passive ones, and its rotor not apart."""
    one = FIVE_BAR + '[[motors]]\nname = "1"\n'
    both = loop_regroupings(written(tmp_path, FIVE_BAR + '[[motors]]\nname = "1"\n[[motors]]\nname = "3"\n'))
    alone = loop_regroupings(written(tmp_path, one, terms=TERMS.replace('"active"', '"motorised"')))
    assert len(both) > len(alone)
    assert "FV3" in alone.no_effect
    assert "IA3" not in alone.standard


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (('passive = ["2", "4"]', 'passive = ["2"]'), "1 passive joints and a turning cut"),
        (("cut = { body_a", 'cut = { type = "prismatic", body_a'), "2 passive joints and a sliding cut"),
        (('passive = ["2", "4"]', 'passive = ["2", "4", "1"]'), "3 passive joints"),
        (("cut = {", 'relations = ["q4 = q1"]\ncut = {'), "a loop has relations"),
    ],
)
def test_loops_that_are_no_dyads_are_refused(change: tuple[str, str], found: str, tmp_path: Path) -> None:
    with pytest.raises(errors.RegroupingError) as raised:
        loop_regroupings(written(tmp_path, FIVE_BAR.replace(*change)))
    assert found in raised.value.found


def test_links_that_are_not_in_one_plane(tmp_path: Path) -> None:
    skew = FIVE_BAR.replace('d = "L3"', 'd = "L3"\nalpha = "pi/2"')
    with pytest.raises(errors.RegroupingError) as raised:
        loop_regroupings(written(tmp_path, skew))
    assert "not parallel" in raised.value.found
    apart = FIVE_BAR.replace('d = "L3"', 'd = "L3"\nr = 0.05')
    with pytest.raises(errors.RegroupingError) as raised:
        loop_regroupings(written(tmp_path, apart))
    assert raised.value.where == ("2", "4")
