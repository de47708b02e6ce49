"""The devices that come with haptid: they read, close, and have the base parameters that are published."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid.device
from haptid.device import poses, read_device, shipped_devices, summary_lines
from haptid.dynamics.model import DynamicModel

DRY_OR_BIAS = ("FV", "FC", "OFF", "CB")
# Base parameters: those of inertia (rotors included), and all.
COUNTS = {
    "arm3": (16, 22),
    "arm7": (48, 48),
    "cea_medical_branch": (23, 34),
    "cea_medical_interface": (62, 83),
    "delta": (34, 40),
    "emps": (1, 4),
    "five_bar": (11, 15),
    "four_bar": (8, 12),
    "kuka_kr300": (40, 59),
    "phantom_premium_10": (8, 14),
    "phantom_premium_15": (8, 14),
    "phantom_premium_15_general": (18, 24),
    "phantom_premium_30": (8, 14),
    "puma560": (36, 36),
    "rx90": (40, 40),
    "slider_crank": (6, 10),
    "sr400": (42, 42),
    "staubli_tx40": (40, 60),
}


@pytest.fixture(scope="module", params=shipped_devices())
def model(request: pytest.FixtureRequest) -> DynamicModel:
    return DynamicModel(read_device(request.param))


def test_every_shipped_device_has_its_published_number_of_base_parameters() -> None:
    assert set(COUNTS) == set(shipped_devices())
    for name, (inertial, whole) in COUNTS.items():
        base = DynamicModel(read_device(name)).base
        assert (sum(not n.startswith(DRY_OR_BIAS) for n in base.names), len(base)) == (inertial, whole), name
        assert base.is_clear


def test_the_core_and_pinocchio_agree(model: DynamicModel) -> None:
    pin = pytest.importorskip("pinocchio")
    pin_model = pin.Model()
    at: list[int] = []
    for joint in model.device.joints:
        kind = pin.JointModelPZ() if joint.prismatic else pin.JointModelRZ()
        placement = pin.SE3(np.array(joint.rotation), np.array(joint.translation))
        at.append(pin_model.addJoint(at[joint.parent] if joint.parent >= 0 else 0, kind, placement, joint.name))
    pin_model.gravity.linear = np.array(model.device.gravity)
    rng = np.random.default_rng(3)
    to_joints = np.linalg.inv(model.device.row_map)
    q = model.device.row_map @ model.device.closure.draw(rng, 1)
    v, a = rng.uniform(-2, 2, (2, *q.shape))
    external = np.ascontiguousarray(model.external(to_joints @ q, to_joints @ v, to_joints @ a))
    links = 10 * len(model.device.joints)
    made = np.asarray(model.mechanism.regressor(q, v, a, external, list(range(links)), model.loops(q, v)))[:, :, 0]
    tree = tuple(x[:, 0] for x in model.tree(to_joints @ q, to_joints @ v, to_joints @ a))
    G = model.follow(q, v).G.reshape(len(model.device.joints), -1)
    Y = np.atleast_2d(pin.computeJointTorqueRegressor(pin_model, pin_model.createData(), *tree))
    order = [
        4,
        5,
        7,
        6,
        8,
        9,
        1,
        2,
        3,
        0,
    ]  # XX XY XZ YY YZ ZZ MX MY MZ M in Pinocchio's M MX MY MZ XX XY YY XZ YZ ZZ
    want = G.T @ np.concatenate([Y[:, 10 * k + np.array(order)] for k in range(len(model.device.joints))], axis=1)
    np.testing.assert_allclose(made, want, atol=1e-12 * np.abs(want).max())


def test_loops_close(model: DynamicModel) -> None:
    assert model.device.closure.error < 1e-12
    qa = model.device.closure.draw(np.random.default_rng(0), 5).T
    q = model.device.closure.positions(qa.T).T
    np.testing.assert_array_equal(q[:, model.device.active], qa)
    assert poses(model.device, q).shape == (5, len(model.device.joints), 4, 4)


def test_summary_names_everything(model: DynamicModel) -> None:
    text = "\n".join(summary_lines(model.device))
    for name in (
        *model.device.joint_names,
        *(drive.name for drive in model.device.drives),
        *(term.name for term in model.terms),
    ):
        assert name in text
    for relation in model.device.closure.relations:
        assert relation in text
    assert not any(line != line.rstrip() for line in text.splitlines())


def test_every_file_says_what_it_is_and_whence() -> None:
    folder = Path(haptid.device.__file__).parent / "library"
    for name in shipped_devices():
        head = (folder / f"{name}.toml").read_text().split("schema = 1")[0]
        assert head.startswith("# ")
        assert "Source:" in head or "generic" in head
        assert all(len(line) <= 110 for line in head.splitlines())


def test_tx40_groupings_are_the_published_ones() -> None:
    base = DynamicModel(read_device("staubli_tx40")).base
    groupings = dict(zip(base.names, base.groupings, strict=True))
    masses = " + ".join
    assert groupings["ZZ1R"].startswith("ZZ1 + YY2 + YY3 + 0.07 MZ3 + 0.05185 M3")
    assert groupings["XZ2R"] == "XZ2 - 0.225 MZ3 - 0.007875 M3 - 0.007875 M4 - 0.007875 M5 - 0.007875 M6"
    assert groupings["MX2R"] == "MX2 + " + masses(f"0.225 M{k}" for k in (3, 4, 5, 6))
    assert groupings["XX3R"] == "XX3 - YY3 + YY4 + 0.45 MZ4 + 0.050625 M4 + 0.050625 M5 + 0.050625 M6"
    assert groupings["MY3R"] == "MY3 - MZ4 - 0.225 M4 - 0.225 M5 - 0.225 M6"
    assert groupings["MY4R"] == "MY4 + MZ5"
    assert groupings["MY5R"] == "MY5 - MZ6"
    assert groupings["IAM6"] == "IAM6"


def test_phantom_priors_give_the_torque_of_the_published_constants() -> None:
    # Corrected model of Tahmasebi et al. (2005) with Cavusoglu's constants, without friction.
    model = DynamicModel(read_device("phantom_premium_15"))
    q, v, a = (np.array([row]).T for row in ([0.3, 0.4, 0.5], [0.7, -0.5, 0.9], [1.1, -0.8, 0.6]))
    raw = list(range(len(model.device.parameters.raw)))
    Y = np.asarray(model.mechanism.regressor(q, v, a, np.zeros((0, 1)), raw))[:, :, 0]
    tau = Y @ model.device.parameters.S @ np.nan_to_num(model.device.chi_prior)
    np.testing.assert_allclose(tau, [0.00570150, -0.01611805, -0.03529287], atol=5e-9)


def test_phantom_end_point_is_the_papers() -> None:
    model = DynamicModel(read_device("phantom_premium_15"))
    t1, t2, t3 = 0.3, 0.4, 0.5
    pose = poses(model.device, np.array([[t1, t2, t3]]) @ model.device.closure.G.T + model.device.closure.offset)[0]
    handle = model.device.handle
    assert handle is not None
    reach = 0.215 * np.cos(t2) + 0.17 * np.sin(t3)
    want = [reach * np.sin(t1), 0.215 * np.sin(t2) - 0.17 * np.cos(t3), reach * np.cos(t1)]
    link = pose[handle.link]
    np.testing.assert_allclose(link[:3, :3] @ handle.translation + link[:3, 3], want, atol=1e-12)


def test_phantom_commands_are_amplifier_torques() -> None:
    for drive in DynamicModel(read_device("phantom_premium_15")).device.drives:
        assert drive.gear_ratio * drive.torque_constant * 2.73 == pytest.approx(1.0, rel=1e-14)


def test_kuka_counterbalance_is_the_authors_formula() -> None:
    model = DynamicModel(read_device("kuka_kr300"))
    q = np.zeros((6, 41))
    q[1] = np.linspace(-0.85, 1.45, 41)
    made = model.external(q, 0 * q, 0 * q)[0] * model.device.prior["CB2"].value
    D, k, area, delta = 0.8, 0.2, 0.0016689710972195777, q[1] - np.pi / 2 + np.radians(95)
    dl = np.sqrt(D**2 + k**2 - 2 * D * k * np.cos(delta)) - (D - k)
    pressure = 1.01 * 296.8 * 328 * 0.159 / (0.00096 - dl * area)
    np.testing.assert_allclose(made, np.sin(delta) * D * k / (dl + D - k) * pressure * area, rtol=1e-12, atol=1e-9)


def test_drives_match_the_logs_of_the_data() -> None:
    tx40 = DynamicModel(read_device("staubli_tx40"))
    assert [drive.gear_ratio for drive in tx40.device.drives] == [32, 32, 45, -48, 45, 32]
    np.testing.assert_array_equal(tx40.device.coupling[5], [0, 0, 0, 0, 1, 1])
    emps = DynamicModel(read_device("emps")).device.drives[0]
    assert (emps.command_unit, emps.torque_constant) == ("V", 35.15065188248547)
    gears = [256.857142857, 267.428571429, 252.333333333, 221.0, 239.619047619, 154.323134328]
    np.testing.assert_allclose(
        [drive.gear_ratio for drive in DynamicModel(read_device("kuka_kr300")).device.drives], gears, rtol=1e-11
    )
