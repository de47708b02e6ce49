"""Standard parameters, terms and priors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from haptid.device import INERTIAL, Counterbalance, Device, read_device
from haptid.device.geometry import placed
from haptid.device.parameters import Symmetry, standard_parameters
from haptid.device.parts import Joint
from haptid.device.priors import PriorBody, body_prior, inertial_parameters
from haptid.dynamics import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import DeviceError

NAMES = [kind + joint for joint in "123" for kind in INERTIAL]
SIGNED = [*NAMES, *(f"-{name}" for name in NAMES)]
GROUPS = st.lists(st.lists(st.sampled_from(SIGNED), min_size=2, max_size=4).map(tuple), max_size=4).map(tuple)


@settings(max_examples=60)
@example((("XX1", "XY1", "-XY1"),), (), [True, False, False])
@given(
    GROUPS,
    st.lists(st.sampled_from(NAMES), max_size=4).map(tuple),
    st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_free_parameters_satisfy_every_zero_and_equality(equal: tuple, zero: tuple, bodies: list[bool]) -> None:
    rule = Symmetry("because", zero, equal)
    made = standard_parameters(list("123"), bodies, (), (rule,))
    assert made.raw == tuple(NAMES)
    raw = dict(zip(made.raw, made.S @ np.random.default_rng(0).uniform(1, 2, len(made)), strict=True))
    assert all(raw[name] == 0 for name in zero)
    raw |= {f"-{name}": -value for name, value in raw.items()}
    assert all(raw[group[0]] == raw[name] for group in equal for name in group)
    assert all(raw[kind + j] == 0 for j, body in zip("123", bodies, strict=True) if not body for kind in INERTIAL)
    assert set(np.unique(made.S)) <= {-1.0, 0.0, 1.0}
    assert (np.abs(made.S).sum(axis=1) <= 1).all()
    assert all(made.S[made.raw.index(name), k] == 1 for k, name in enumerate(made.names))
    # Nothing else left, and each is named after the first it stands for.
    assert np.linalg.matrix_rank(made.S) == len(made) if len(made) else True
    assert [members[0] for members in made.members] == list(made.names)
    assert {name for name, value in raw.items() if value and not name.startswith("-")} == set(made.index)


def test_symmetry_about_an_axis_and_identical_bodies(tmp_path: Path) -> None:
    device = read_device(
        written(
            tmp_path,
            """
[[symmetry]]
reason = "turned on a lathe"
about = { link = "2", axis = "x" }
[[symmetry]]
reason = "cut from one drawing"
identical = ["1", "3"]
""",
        )
    )
    free = device.parameters
    assert [name for name in free.names if name.endswith("2")] == ["XX2", "YY2", "MX2", "M2"]
    assert free.members[free.index["ZZ2"]] == ("YY2", "ZZ2")
    assert all(free.index[f"{kind}1"] == free.index[f"{kind}3"] for kind in INERTIAL)
    assert len(free) == 14
    assert "symmetry: XY2 = XZ2 = YZ2 = MY2 = MZ2 = 0, YY2 = ZZ2 (turned on a lathe)" in device.notes
    assert free.kinds[:3] == ("XX", "XY", "XZ")
    assert set(free.links) == {0, 1}


THREE = """
name = "three"
gravity = [0, 0, -9.81]
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "pi/2"
[[joints]]
name = "3"
type = "prismatic"
d = 0.3
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "three.toml"
    path.write_text(THREE + text)
    return path


def test_terms_have_names_units_weights_and_settings(tmp_path: Path) -> None:
    device = read_device(
        written(
            tmp_path,
            """
[[motors]]
name = "m"
drives = { 1 = 1, 2 = -2 }
[[motors]]
name = "2"
[[terms]]
kind = "rotor-inertia"
joints = "all"
[[terms]]
kind = "viscous"
motors = "all"
[[terms]]
kind = "coulomb-by-direction"
joints = ["1"]
motors = ["m"]
width = 0.1
[[terms]]
kind = "stribeck"
joints = ["3"]
velocity = 0.2
[[terms]]
kind = "spring"
joints = ["2"]
rest = "pi/6"
prefix = "KS"
[[terms]]
kind = "offset"
joints = "motorised"
""",
        )
    )
    assert [drive.name for drive in device.drives] == ["m", "2", "3"]
    assert [drive.motorised for drive in device.drives] == [True, True, False]
    assert device.torque_units == ("N m", "N m", "N")
    np.testing.assert_array_equal(device.coupling, [[1, -2, 0], [0, 1, 0], [0, 0, 1]])
    names = [
        "IA1",
        "IA2",
        "IA3",
        "FVMm",
        "FVM2",
        "FCP1",
        "FCN1",
        "FCPMm",
        "FCNMm",
        "FS3",
        "KS2",
        "OFF1",
        "OFF2",
    ]
    assert [term.name for term in device.terms] == names
    units = dict(zip(names, (term.unit for term in device.terms), strict=True))
    assert (units["IA1"], units["IA3"], units["FS3"], units["KS2"]) == ("kg m^2", "kg", "N", "N m/rad")
    terms = {term.name: term for term in device.terms}
    # q1 = c_m + 2 c_2: a term on joint 1 is felt by both motors.
    np.testing.assert_array_equal(terms["IA1"].weights, [1, 2, 0])
    np.testing.assert_array_equal(terms["FVMm"].weights, [1, 0, 0])
    assert terms["FCP1"].for_core[0] == "coulomb+"
    assert terms["FCP1"].settings == (0.1, 0.0, 0.0)
    assert terms["FS3"].settings == (0.2, 2.0, 0.0)
    assert terms["KS2"].settings == (pytest.approx(np.pi / 6), 0.0, 0.0)
    assert [list(term.weights) for term in DynamicModel(device).coulomb_terms(0)] == [[1, 2, 0], [1, 0, 0]]
    assert [list(term.weights) for term in DynamicModel(device).coulomb_terms(1)] == [[1, 2, 0]]
    assert device.parameters.kinds[-2:] == ("OFF", "OFF")
    assert device.parameters.links[device.parameters.index["FVMm"]] == -1


def test_terms_on_passive_joints_follow_the_loop() -> None:
    device = read_device("cea_medical_branch")
    terms = {term.name: term for term in device.terms}
    np.testing.assert_array_equal(terms["FV3"].weights, [0, -1, 1])  # q3 = q5 - q2 - pi
    assert terms["FV3"].offset == -np.pi
    directions = [term.weights for term in DynamicModel(device).coulomb_terms(1)]
    assert [list(w) for w in directions] == [[0, 1, 0], [0, -1, 1]]


def test_rates_turn_coordinates_into_joints_and_drives() -> None:
    for name in ("staubli_tx40", "sr400", "phantom_premium_15"):
        device = read_device(name)
        np.testing.assert_allclose(device.rates @ device.row_map, device.closure.G, atol=1e-15)
        np.testing.assert_allclose(device.drive_rates @ device.row_map, device.coupling, atol=1e-15)


@settings(max_examples=40)
@given(st.floats(0.05, 0.5), st.floats(0.6, 1.2), st.floats(-3, 3), st.floats(-3, 3))
def test_counterbalance_is_the_slope_of_its_strut(crank: float, base: float, angle: float, q: float) -> None:
    def strut(x: float) -> float:
        return float(np.sqrt(base**2 + crank**2 - 2 * base * crank * np.cos(x + angle))) - (base - crank)

    where = np.array([[q]])
    slope = (strut(q + 1e-6) - strut(q - 1e-6)) / 2e-6
    stroke = 2 * crank + 0.3
    for force, size in (("constant", 1.0), ("linear", strut(q)), ("gas", 1 / (1 - strut(q) / stroke))):
        made = Counterbalance(0, crank, base, angle, -1.0, force, stroke).values(where)
        assert made[0] == pytest.approx(-slope * size, abs=1e-8)


def test_external_columns_are_functions_of_active_joints(tmp_path: Path) -> None:
    device = DynamicModel(
        read_device(
            written(
                tmp_path,
                """
[[terms]]
kind = "counterbalance"
law = "spring"
joints = ["2"]
crank = 0.1
base = 0.4
[[terms]]
kind = "custom"
name = "COG1"
unit = "N m"
expression = "sin(3*q_1) + sqrt(v_2) * a_3"
joints = ["1"]
""",
            )
        )
    )
    assert [term.name for term in device.externals] == ["CBF2", "CBK2", "COG1"]
    assert [term.unit for term in device.externals] == ["N", "N/m", "N m"]
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(0.1, 1, (3, 3, 7))
    made = device.external(q, v, a)
    assert made.shape == (3, 7)
    np.testing.assert_allclose(made[2], np.sin(3 * q[0]) + np.sqrt(v[1]) * a[2], rtol=1e-14)
    v[1, 4] = -1
    with pytest.raises(DeviceError) as raised:
        device.external(q, v, a)
    assert raised.value.where == ("COG1", 4)


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_a_prior_body_keeps_its_kinetic_energy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = placed(rng.normal(size=3), rng.uniform(-2, 2, 3))
    joint = Joint("1", -1, False, np.eye(3), np.zeros(3), True, None, None, None, turn[:3, :3], turn[:3, 3])
    A = rng.normal(size=(3, 3))
    body = PriorBody(rng.uniform(0.1, 5), rng.normal(size=3), A @ A.T)
    # A twist of the link frame, and the same motion seen from the convention's frame.
    v, w = rng.normal(size=(2, 3))
    wf = turn[:3, :3].T @ w
    vf = turn[:3, :3].T @ (v + np.cross(w, turn[:3, 3]))
    assert body.inertia is not None
    at_com = vf + np.cross(wf, body.com)
    energy = 0.5 * body.mass * at_com @ at_com + 0.5 * wf @ body.inertia @ wf
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = inertial_parameters(body, joint)
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert 0.5 * m * v @ v + v @ np.cross(w, [mx, my, mz]) + 0.5 * w @ J @ w == pytest.approx(energy, rel=1e-9)


def test_prior_deviations_are_never_zero() -> None:
    joint = Joint("1", -1, False, np.eye(3), np.zeros(3), True, None, None, None, np.eye(3), np.zeros(3))
    made = body_prior(PriorBody(2.0, np.zeros(3), np.diag([0.1, 0.2, 0.3])), joint, 10.0)
    assert made["M1"].std == pytest.approx(0.2)
    assert made["XY1"].std == pytest.approx(0.03)
    assert made["MX1"].std == pytest.approx(0.1 * np.sqrt(2.0 * 0.3))
    assert "XX1" not in body_prior(PriorBody(2.0, np.zeros(3), None), joint, None)


PAIR = """
name = "two planar arms, left and right"
gravity = [-9.81, 0.0, 0.0]
joints = [{ name = "l1" }, { name = "l2", d = 0.3 }, { name = "r1", parent = "base" }, { name = "r2", d = 0.3 }]
[[terms]]
kind = "viscous"
joints = "all"
[[symmetry]]
reason = "left and right"
mirror = { link = "r1", of = "l1", axes = ["x", "-y", "z"] }
[[symmetry]]
reason = "left and right"
mirror = { link = "r2", of = "l2", axes = ["x", "-y", "z"] }
"""


def test_mirrored_bodies_have_mirrored_torques(tmp_path: Path) -> None:
    """Arms in a plane that move as each other's images need opposite torques; exact base parameters are the same."""
    (tmp_path / "pair.toml").write_text(PAIR)
    model = DynamicModel(read_device(tmp_path / "pair.toml"))
    names = model.device.parameters.names
    assert {"MYl2", "XYl2", "YYl1"} <= set(names)
    assert not {"MYr2", "XYr2", "YYr1"} & set(names)
    rng = np.random.default_rng(2)
    chi = rng.uniform(-1, 1, len(names))
    for joint in "12":
        chi[names.index(f"FVr{joint}")] = chi[names.index(f"FVl{joint}")]
    half = rng.uniform(-2, 2, (3, 2, 20))
    torque = inverse_dynamics(model, model.base.of(chi), *np.concatenate([half, -half], axis=1))
    np.testing.assert_allclose(torque[2:], -torque[:2], atol=1e-12)
    assert sorted(model.regroupings.names) == sorted(model.base.names)


@pytest.mark.parametrize("axes", [("x", "-y", "z"), ("-z", "x", "-y"), ("y", "z", "x"), ("-x", "-y", "-z")])
def test_an_image_has_the_parameters_of_the_moved_body(tmp_path: Path, axes: tuple[str, ...]) -> None:
    P = np.array([(-1 if "-" in axis else 1) * np.eye(3)["xyz".index(axis[-1])] for axis in axes])
    A = np.random.default_rng(0).normal(size=(3, 3))
    mirror = f'mirror = {{ link = "3", of = "2", axes = {list(axes)} }}'
    device = read_device(written(tmp_path, f'[[symmetry]]\nreason = "image"\n{mirror}\n'))
    free, values = device.parameters, dict[str, float]()
    for link, c, J in (("2", A[0], A @ A.T), ("3", P @ A[0], P @ A @ A.T @ P.T)):
        body = inertial_parameters(PriorBody(1.3, c, J), device.joints[1])
        values |= dict(zip((kind + link for kind in INERTIAL), body, strict=True))
    for name, value in values.items():
        assert value == pytest.approx(free.sign[name] * values[free.names[free.index[name]]], rel=1e-12), name


def test_priors_by_name_and_what_symmetry_makes_of_them(tmp_path: Path) -> None:
    device: Device = read_device(
        written(
            tmp_path,
            """
[prior]
M1 = { value = "2*pi", std = 0.5 }
YY2 = 1.0
ZZ2 = 3.0
XY2 = 0.1
[[symmetry]]
reason = "round"
about = { link = "2", axis = "x" }
""",
        )
    )
    chi = dict(zip(device.parameters.names, device.chi_prior, strict=True))
    assert chi["M1"] == pytest.approx(2 * np.pi)
    assert chi["YY2"] == 2.0  # the mean of the two that are one
    assert np.isnan(chi["M3"])
    assert any("prior of XY2 is not used" in note for note in device.notes)
