"""Numbers of base parameters, groupings and torques that the literature prints, found from the device files alone."""

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.dynamics.base_parameters import NO_EFFECT, random_regressor

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "IA")


def inertial(model):
    kept = model.base.independent_columns
    return [model.base.names[k] for k, index in enumerate(kept) if model.device.parameters.kinds[index] in INERTIAL]


def grouping(model, name):
    return next(g for n, g in zip(model.base.names, model.base.groupings, strict=True) if n == name)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("rx90", 40),  # Khalil and Dombre (2002): 36, and the rotors of joints 3 to 6
        ("sr400", 42),  # with 6 rotors
        ("puma560", 36),
        ("arm7", 48),  # 43, and the rotors of joints 3 to 7
        ("phantom_premium_15", 8),  # Cavusoglu et al. (2002), symmetric bodies
        ("phantom_premium_15_general", 18),
        ("cea_medical_branch", 23),  # Janot et al. (2007)
        ("emps", 1),
    ],
)
def test_number_of_inertial_base_parameters(name, count):
    model = haptid.DynamicModel(haptid.read_device(name))
    assert len(inertial(model)) == count
    assert model.base.is_clear
    # By another road: the numerical rank of the same columns, from the singular values at other random states.
    W = random_regressor(model, seed=7)
    lengths = np.linalg.norm(W, axis=0)
    W = W[:, lengths > NO_EFFECT * lengths.max()]
    singular = np.linalg.svd(W / np.linalg.norm(W, axis=0), compute_uv=False)
    assert (singular > 1e-9 * singular[0]).sum() == len(model.base)


def test_seven_joints_have_43_without_rotors():
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    assert len([name for name in inertial(model) if not name.startswith("IA")]) == 43


def test_sr400_loop_is_found_from_its_cut_joint():
    model = haptid.DynamicModel(haptid.read_device("sr400"))
    assert set(model.device.closure.relations) == {"q3 = pi/2 - q2 + q7", "q8 = q2 - q7"}
    assert model.device.closure.error < 1e-12


def test_sr400_as_a_tree_has_55(tmp_path):
    """The same file without its loop: all eight joints independent, six rotors."""
    text = Path(haptid.__file__).parent.joinpath("device/library", "sr400.toml").read_text()
    before, loop = text.split("[[loops]]")
    (tmp_path / "tree.toml").write_text(before + "[[" + loop.split("[[", 1)[1])
    tree = haptid.DynamicModel(haptid.read_device(tmp_path / "tree.toml"))
    assert len(tree.device.active) == 8
    assert len(inertial(tree)) == 55


def test_phantom_torque_is_the_published_closed_form():
    """The eight parameters and the torque of phantom eq. (5), corrected, at a golden state."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = model.prior_beta
    column = lambda *x: np.array(x)[:, None]  # noqa: E731
    tau = haptid.inverse_dynamics(model, beta, column(0.3, 0.4, 0.5), column(0.7, -0.5, 0.9), column(1.1, -0.8, 0.6))
    np.testing.assert_allclose(tau[:, 0], [0.00570150, -0.01611805, -0.03529287], atol=5e-9)


def phantom_rows(q, v, a):
    """Regressor of Tahmasebi et al. (2005), eq. (5) with the sign of pi_4 in row 3 mended, (3, 8, n)."""
    (_, q2, q3), (v1, v2, v3), (a1, a2, a3) = q, v, a
    s2, c2, s3, c3 = np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3)
    s23, c23, zero = np.sin(q2 - q3), np.cos(q2 - q3), 0 * q2
    d2, d3 = np.sin(2 * q2), np.sin(2 * q3)
    first = [
        a1,
        a1 * np.cos(2 * q2) - 2 * v1 * v2 * d2,
        a1 * np.cos(2 * q3) - 2 * v1 * v3 * d3,
        a1 * c2 * s3 - v1 * v2 * s2 * s3 + v1 * v3 * c2 * c3,
        zero, zero, zero, zero,
    ]  # fmt: skip
    second = [
        zero,
        v1**2 * d2,
        zero,
        -a3 * s23 / 2 + v1**2 * s2 * s3 / 2 + v3**2 * c23 / 2,
        a2,
        zero,
        c2,
        zero,
    ]
    third = [
        zero,
        zero,
        v1**2 * d3,
        -a2 * s23 / 2 - v1**2 * c2 * c3 / 2 - v2**2 * c23 / 2,
        zero,
        a3,
        zero,
        s3,
    ]
    return np.array([first, second, third])


def test_phantom_regressor_spans_the_papers_closed_form():
    """Not one torque more, not one less: the two sets of eight columns are linear images of each other."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 3, 50))
    unit = np.eye(len(model.base))[: len(inertial(model))]
    ours = np.array([haptid.inverse_dynamics(model, beta, q, v, a).ravel() for beta in unit]).T
    theirs = phantom_rows(q, v, a).transpose(1, 0, 2).reshape(8, -1).T
    both = np.linalg.lstsq(theirs, ours, rcond=None)[0]
    np.testing.assert_allclose(theirs @ both, ours, atol=1e-12)
    assert np.linalg.matrix_rank(both) == 8


CEA_GROUPINGS = {
    "ZZ1R": "ZZ1 + YY2 + YY3 + 0.050625 M3 + XX4 + 0.12625 M4 + YY5 + YY6 + 0.0036 M6 + YY7 + 0.002025 M7 + XX8 + "
    "0.050625 M8 + YY9 + 0.050625 M9 + IA1",
    "MX1R": "MX1 + 0.2 MX7 - 0.045 M7",
    "MY1R": "MY1 + MZ2 + MZ3 + MZ4 + MZ5 + MZ6 + MZ7 + MZ8 + MZ9",
    "XZ2R": "XZ2 - 0.225 MZ3 - 0.225 MZ4 + XZ6 + XZ7 - 0.225 MZ8 - 0.225 MZ9",
    "ZZ2R": "ZZ2 + 0.050625 M3 + 0.050625 M4 + ZZ6 + ZZ7 + 0.050625 M8 + 0.050625 M9 + IA2",
    "XX3R": "XX3 - YY3 - 0.075625 M4 + XX5 - YY5 - 0.0036 M6 + XX9 - YY9",
    "XZ3R": "XZ3 - 0.275 MZ4 - XZ5 + 0.06 MZ6 + XZ9",
    "YZ3R": "YZ3 - YZ5 + YZ9",
    "MX3R": "MX3 + 0.275 M4 - 0.266667 MX6 + MX9",
    "MX5R": "MX5 - 0.266667 MX6 + 0.06 M6",
    "MY8R": "MY8 + 0.2 MX7",
    "FV5R": "FV5 + FV4 + FV9 + FV12",
    "FC2R": "FC2 + FC7 + FC8 + FC11",
}


def test_cea_regroupings_are_the_papers_as_corrected():
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    assert len(model.base) == 34
    for name, wanted in CEA_GROUPINGS.items():
        assert grouping(model, name) == wanted
    listed = [
        "XX1",
        "XY1",
        "XZ1",
        "YY1",
        "YZ1",
        "MZ1",
        "M1",
        "XY4",
        "XZ4",
        "YZ4",
        "ZZ4",
        "MX4",
        "XY8",
        "XZ8",
        "YZ8",
        "ZZ8",
        "MX8",
    ]
    assert set(listed) <= set(model.base.no_effect)
    assert set(model.base.no_effect) == {*listed, "M2", "M5", "YY4", "YY8"}


def test_cea_constraints_and_torque_map_are_the_printed_ones():
    """Equations (1) to (6) and (10), sign set A, from the cut joints' frames alone."""
    closure = haptid.DynamicModel(haptid.read_device("cea_medical_branch")).device.closure
    assert closure.relations == (
        "q3 = -pi - q2 + q5",
        "q4 = 3*pi/2 - q5",
        "q6 = q2 - q5",
        "q7 = q2",
        "q8 = pi/2 - q2",
        "q9 = pi/2 + q5",
    )
    printed = {2: [0, 1, 0, -1, 1, 0, 1, -1, 0], 5: [0, 0, 1, 1, -1, -1, 0, 0, 1]}
    order = [0, 1, 4, 2, 5, 3, 6, 7, 8]  # the paper's columns: 1 2 5 3 6 4 7 8 9
    assert closure.G[order, 1].tolist() == printed[2]
    assert closure.G[order, 2].tolist() == printed[5]
    assert closure.error < 1e-14


CEA_UPPER = {"ZZ1R": 0.051, "MX1R": 0.006, "MY1R": 0.03, "XX2R": -0.023, "ZZ2R": 0.029, "MX2R": -0.019,
             "XX3R": -0.011, "ZZ3R": 0.014, "MX3R": 0.039, "MX5R": 0.068}  # fmt: skip
CEA_LOWER = {"ZZ1R": 0.046, "MX1R": -0.005, "MY1R": -0.04, "XX2R": -0.021, "ZZ2R": 0.027, "MX2R": -0.023,
             "XX3R": -0.010, "ZZ3R": 0.012, "MX3R": 0.034, "MX5R": 0.067}  # fmt: skip


@pytest.mark.parametrize(
    ("table", "wanted"),
    [(CEA_UPPER, [0.270458, 0.083754, -0.202791]), (CEA_LOWER, [-0.434801, 0.121541, -0.239493])],
)
def test_cea_torque_of_the_published_parameters(table, wanted):
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    beta = [table.get(name, 0.0) for name in model.base.names]
    column = lambda *x: np.array(x)[:, None]  # noqa: E731
    q, v, a = column(0.2, -1.0, 1.0 + np.pi), column(0.5, -0.4, 0.6), column(1.0, -2.0, 1.5)
    np.testing.assert_allclose(haptid.inverse_dynamics(model, beta, q, v, a)[:, 0], wanted, atol=1e-6)
