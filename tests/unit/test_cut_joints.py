"""Joints that were cut: their positions, friction at them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from changed_devices import SET_B, changed
from haptid.device import Frame, poses, read_device
from haptid.dynamics.symbolic import loop_regroupings
from haptid.errors import DeviceFileError, RegroupingError
from haptid.experiment.bench import mjcf
from haptid.experiment.bench.bodies import bodies, effects
from haptid.experiment.bench.mjcf import closed, depth_first

# Two cranks of one length, joined by a bar that was cut off the second one.
BARS = """
name = "bars"
gravity = [0, -9.81, 0]
[[joints]]
name = "1"
[[joints]]
name = "2"
parent = "base"
d = {ground!r}
[[joints]]
name = "3"
parent = "1"
d = {crank!r}
[[loops]]
passive = ["2", "3"]
guess = {{ 2 = 0, 3 = 0 }}
[loops.cut]
name = "cut"
body_a = "3"
frame_a = {{ d = {ground!r} }}
body_b = "2"
frame_b = {{ d = {crank!r}, theta = {turn!r} }}
[[terms]]
kind = "viscous"
joints = {joints}
"""
# Two slides along one line, the second twice as fast the other way.
SLIDES = """
name = "slides"
gravity = [0, 0, -9.81]
[[joints]]
name = "a"
type = "prismatic"
[[joints]]
name = "b"
parent = "base"
type = "prismatic"
[[loops]]
relations = ["qb = -2*qa"]
cut = { name = "c", type = "prismatic", body_a = "a", frame_a = { r = 0.1 }, body_b = "b", frame_b = { r = 0.4 } }
[[terms]]
kind = "coulomb"
joints = "all"
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "device.toml"
    path.write_text(text, encoding="utf-8")
    return path


def turned(model: haptid.DynamicModel, qa: np.ndarray) -> np.ndarray:
    """Angle from a frame to its twin by the poses of their links, (cuts, samples)."""
    links = poses(model.device, model.device.closure.positions(qa).T)

    def rotation(frame: Frame) -> np.ndarray:
        return (links[:, frame.link, :3, :3] if frame.link >= 0 else np.eye(3)) @ frame.rotation

    seen = [np.swapaxes(rotation(cut.frame_a), -1, -2) @ rotation(cut.frame_b) for cut in model.device.closure.cuts]
    return np.array([np.arctan2(R[:, 1, 0], R[:, 0, 0]) for R in seen])


@pytest.mark.parametrize(("changes", "half"), [((), np.pi), (SET_B, 0.0)], ids=["A", "B"])
def test_cut_joints_of_the_branch_move_as_printed(
    changes: tuple[tuple[str, str], ...], half: float, tmp_path: Path
) -> None:
    """Janot et al. (2007), equations (7) to (9), whole turns apart; half a turn less in (7) of set B."""
    model = changed("cea_medical_branch", tmp_path, *changes)
    qa = np.random.default_rng(0).uniform(-3, 3, (3, 20))
    printed = np.array([qa[2] - qa[1] - half, -qa[1], 3 * np.pi / 2 - qa[2]])
    found = np.array([cut.positions(qa) for cut in model.device.cut_joints])
    assert [cut.name for cut in model.device.cut_joints] == ["10", "11", "12"]
    for other in (printed, turned(model, qa)):
        np.testing.assert_allclose(np.exp(1j * (found - other)), 1, atol=1e-12)


def test_friction_of_the_branch_regroups_as_printed() -> None:
    found = haptid.DynamicModel(read_device("cea_medical_branch")).regroupings
    formulas = dict(zip(found.names, found.formulas, strict=True))
    for kind in ("FV", "FC"):
        wanted = {"2": "2 + _7 + _8 + _11", "3": "3 + _6 + _10", "5": "5 + _4 + _9 + _12"}
        for joint, text in wanted.items():
            assert formulas[f"{kind}{joint}R"] == f"{kind}{text.replace('_', kind)}"
    assert len(found) == 34


@settings(max_examples=10, deadline=None)
@given(st.floats(0.1, 0.5), st.floats(0.1, 0.5), st.floats(-3, 3))
def test_cut_of_any_parallelogram_turns_with_its_links(
    tmp_path_factory: pytest.TempPathFactory, ground: float, crank: float, turn: float
) -> None:
    text = BARS.format(ground=ground, crank=crank, turn=turn, joints='["cut"]')
    model = haptid.DynamicModel(read_device(written(tmp_path_factory.mktemp("bars"), text)))
    qa = np.linspace(-2, 2, 7)[None]
    (cut,) = model.device.cut_joints
    np.testing.assert_allclose(np.exp(1j * (cut.positions(qa) - turned(model, qa)[0])), 1, atol=1e-7)
    assert abs(cut.offset - turn) < 1e-7
    assert model.device.terms[0].name == "FVcut"
    np.testing.assert_array_equal(model.device.terms[0].weights, cut.row)


def test_power_lost_in_cut_joints_is_that_of_their_rates() -> None:
    """tau . qd = sum over cuts of FV rate^2 + FC |rate|, the rates by differences of the twin's angle."""
    model = haptid.DynamicModel(read_device("cea_medical_branch"))
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-1, 1, (2, 3, 30))
    step = 1e-6
    rates = np.angle(np.exp(1j * (turned(model, q + step * v) - turned(model, q - step * v)))) / (2 * step)
    values = {"FV10": 0.3, "FV11": 0.5, "FV12": 0.7, "FC10": 0.2, "FC11": 0.4, "FC12": 0.6}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    torque = haptid.inverse_dynamics(model, model.base.regrouping @ chi, q, v, np.zeros_like(q))
    lost = sum(values[f"FV{k}"] * r**2 + values[f"FC{k}"] * np.abs(r) for k, r in zip((10, 11, 12), rates, strict=True))
    np.testing.assert_allclose((torque * v).sum(axis=0), lost, rtol=1e-7)


def test_cut_that_slides(tmp_path: Path) -> None:
    model = haptid.DynamicModel(read_device(written(tmp_path, SLIDES)))
    (cut,) = model.device.cut_joints
    assert cut.relation == "qc = 0.3 - 3*qa"
    np.testing.assert_allclose(cut.positions(np.array([[0.0, 0.1]])), [0.3, 0.0], atol=1e-15)
    assert [term.unit for term in model.terms] == ["N"] * 3
    assert model.regroupings.formulas[-1] == "FCa + 2 FCb + 3 FCc"


def test_spring_at_a_cut_has_one_rest_everywhere(tmp_path: Path) -> None:
    """Its torque is that of its own angle, by the regressor and by both roads to base parameters."""
    spring = '[[terms]]\nkind = "spring"\njoints = ["{}"]\nrest = 0\n'
    springs = spring.format("10") + spring.format("3")
    model = changed("cea_medical_branch", tmp_path, ("[handle]", springs + "[handle]"))
    qa = np.array([[0.1, 0.2], [0.3, -0.4], [0.5, 0.7]])
    chi = (np.array(model.device.parameters.names) == "K10").astype(float)
    still = np.zeros_like(qa)
    torque = haptid.inverse_dynamics(model, model.base.regrouping @ chi, qa, still, still)
    (cut, *_) = model.device.cut_joints
    np.testing.assert_allclose(torque, cut.row[:, None] * cut.positions(qa), atol=1e-9)
    assert len(model.regroupings) == len(model.base)


def test_unnamed_cuts_stay_out_of_all_joints(tmp_path: Path) -> None:
    model = changed("cea_medical_branch", tmp_path, *((f'name = "{k}", ', "") for k in (10, 11, 12)))
    assert model.device.cut_joints == ()
    assert not {"FV10", "FC11"} & set(model.device.parameters.names)
    assert len(model.base) == 34


@pytest.mark.parametrize(
    ("name", "first"), [("2", "one of joints"), ("base", "the base"), ("11", "the cut of an earlier loop")]
)
def test_name_that_is_taken(name: str, first: str, tmp_path: Path) -> None:
    old = "12" if name == "11" else "10"
    with pytest.raises(DeviceFileError, match=rf'cut\.name: the joint "{name}" is already taken by {first}'):
        changed("cea_medical_branch", tmp_path, (f'name = "{old}"', f'name = "{name}"'))


def test_other_rejections(tmp_path: Path) -> None:
    term = '[[terms]]\nkind = "viscous"\nprefix = "D"\njoints = ["13"]\n[handle]'
    with pytest.raises(DeviceFileError, match='no joint is named "13"'):
        changed("cea_medical_branch", tmp_path, ("[handle]", term))
    text = BARS.format(ground=0.3, crank=0.2, turn=0.0, joints='"all"')
    with pytest.raises(RegroupingError, match="cut joint cut has a name"):
        loop_regroupings(written(tmp_path, text))


def test_simulated_device_has_what_acts_on_its_cuts() -> None:
    """A cut that two motors turn is a tendon of its own; one that follows a single motor loads that motor's joint."""
    model = haptid.DynamicModel(read_device("cea_medical_branch"))
    values = {"FV10": 0.3, "FC11": 0.4}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    chi[[k for k, kind in enumerate(model.device.parameters.kinds) if kind in ("XX", "YY", "ZZ", "M")]] = 1e-2
    acts = {act.name: act for act in effects(model, chi, bodies(model, chi))}
    tendon = acts["cut 10"]
    assert (tendon.viscous, tendon.coulomb) == (0.3, 0.0)
    np.testing.assert_array_equal(tendon.joints[list(model.device.active)], [0, -1, 1])
    assert acts["2"].coulomb == 0.4
    assert not {"cut 11", "cut 12"} & set(acts)


def test_mujoco_feels_friction_and_springs_at_cuts_as_the_model_does(tmp_path: Path) -> None:
    """One cut that two motors turn, and one that follows a single motor, each with damper and spring."""
    mujoco = pytest.importorskip("mujoco")
    springs = "".join(f'[[terms]]\nkind = "spring"\njoints = ["{k}"]\nrest = 0.2\n' for k in (10, 12))
    model = changed("cea_medical_branch", tmp_path, ("[handle]", springs + "[handle]"))
    values = {"FV10": 0.3, "FV12": 0.5, "K10": 0.7, "K12": 0.9}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    chi[[k for k, kind in enumerate(model.device.parameters.kinds) if kind in ("XX", "YY", "ZZ", "M")]] = 1e-2
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, order = mujoco.MjData(mj_model), list(depth_first(model))
    q, v = np.random.default_rng(2).uniform(-1, 1, (2, 3, 5))
    found = np.empty_like(q)
    for k in range(q.shape[1]):
        data.qpos[:], data.qvel[:] = closed(model, q[:, k]), model.device.closure.constant[order] @ v[:, k]
        mujoco.mj_forward(mj_model, data)
        found[:, k] = -model.device.rates[order].T @ data.qfrc_passive
    terms = model.base.regrouping @ np.where(np.isin(model.device.parameters.names, list(values)), chi, 0.0)
    np.testing.assert_allclose(found, haptid.inverse_dynamics(model, terms, q, v, np.zeros_like(q)), atol=1e-9)
