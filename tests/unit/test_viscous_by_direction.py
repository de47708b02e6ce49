"""Viscous friction by direction: its columns, its parameters back, motors that move several joints."""

import numpy as np
import pytest

import haptid
from compiled import NAME, Library, relative
from haptid.end_effector.characterisation import GivenParameters
from haptid.end_effector.characterisation.friction import viscous_matrix
from haptid.end_effector.compensation import Compensation
from haptid.export import CCode, export_c
from haptid.export.model.functions import code_of
from haptid.export.selftest import ReferenceValues
from motions import motion
from small_study import DEVICE

BOTH = DEVICE.replace('kind = "viscous"', 'kind = "viscous-by-direction"')
COUPLED = """
schema = 1
name = "two motors on two joints"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[motors]]
name = "a"
drives = { 1 = 1 }
[[motors]]
name = "b"
drives = { 1 = -0.5, 2 = 2 }
[[terms]]
kind = "viscous-by-direction"
motors = "all"
"""


def read(folder, text):
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


def test_columns_are_the_halves_of_the_velocity(tmp_path):
    model = read(tmp_path, BOTH)
    names = model.base.names
    assert {"FVP1", "FVN1", "FVP2", "FVN2"} <= set(names)
    assert [model.base.units[names.index(n)] for n in ("FVP1", "FVN2")] == ["N m s/rad"] * 2
    beta = np.zeros(len(names))
    beta[names.index("FVP2")], beta[names.index("FVN2")] = 2.0, 3.0
    v = np.array([[0.5, -0.5], [1.5, -1.5]])
    tau = haptid.inverse_dynamics(model, beta, np.zeros((2, 2)), v, np.zeros((2, 2)))
    np.testing.assert_allclose(tau, [[0.0, 0.0], [3.0, -4.5]], atol=1e-12)


def test_both_halves_together_are_viscous_friction_by_both_methods(tmp_path):
    """Where a file declares both kinds, one of three is regrouped, with lengths as symbols too."""
    model = read(tmp_path, COUPLED + '[[terms]]\nkind = "viscous"\nmotors = "all"\n')
    found = dict(zip(model.regroupings.names, model.regroupings.formulas, strict=True))
    for motor in "ab":
        assert found[f"FVPM{motor}R"] == f"FVPM{motor} + FVM{motor}"
        assert found[f"FVNM{motor}R"] == f"FVNM{motor} + FVM{motor}"


def test_different_parameters_come_back(tmp_path):
    model = read(tmp_path, BOTH)
    beta = np.linspace(0.2, 1.0, len(model.base))
    inside = []
    for seed in range(5):
        found = haptid.estimate(
            haptid.observe(model, motion(model, beta, noise=0.05, dt=4e-3, seed=seed)), haptid.WLS()
        )
        low, high = found.conf_int().T
        inside.append((low <= beta) & (beta <= high))
    assert np.mean(inside) > 0.85


def test_the_diagnosis_names_it_where_it_is_missing(tmp_path):
    true, plain = read(tmp_path, BOTH), read(tmp_path, DEVICE)
    beta = np.full(len(true.base), 0.4)
    beta[true.base.names.index("FVN2")] = 1.2
    found = haptid.diagnose(
        haptid.estimate(haptid.observe(plain, motion(true, beta, noise=0.05, dt=4e-3)), haptid.WLS())
    )
    finding = found["viscosity by direction"]
    assert finding.status != "ok"
    assert "direction-dependent viscous friction" in finding.sentence


def test_a_motor_s_velocity_is_that_of_all_its_joints(tmp_path):
    model = read(tmp_path, COUPLED)
    names = model.base.names
    assert {"FVPMa", "FVNMb"} <= set(names)
    beta = np.zeros(len(names))
    beta[names.index("FVPMb")] = 1.0
    qd = np.array([[1.0, 1.0], [1.0, -1.0]])  # of the joints
    rate = np.array([-0.5, 2.0]) @ qd
    made = haptid.inverse_dynamics(model, beta, np.zeros((2, 2)), qd, np.zeros((2, 2)))
    np.testing.assert_allclose(made, [[0.0, 0.0], np.maximum(rate, 0)], atol=1e-12)


@pytest.fixture
def alike(tmp_path):
    """The device with plain viscous friction and the one with it by direction, and the same parameters of both."""
    made = []
    for folder, text in ((tmp_path / "plain", DEVICE), (tmp_path / "both", BOTH)):
        folder.mkdir()
        model = read(folder, text)
        sizes = {name: 0.2 + 0.1 * k for k, name in enumerate(n for n in model.base.names if n[:2] != "FV")}
        sizes |= {name: 0.3 for name in model.base.names if name[:2] == "FV"}
        made.append((model, np.array([sizes[name] for name in model.base.names])))
    return made


def test_written_friction_is_that_of_plain_viscous_friction(alike, tmp_path):
    torques = []
    for model, beta in alike:
        reference = ReferenceValues.at_random(model, beta, 0.01, 200)
        wanted = reference.functions["friction"]()["tau"]
        folder = tmp_path / f"c{len(torques)}"
        export_c((model, beta), folder, CCode(NAME, reversal_speed=0.01))
        library = Library.built(folder, code_of(model, 0.01), "double")
        got = library("friction", {x: getattr(reference, x) for x in ("q", "qd", "qdd", "tau")})["tau"]
        assert relative(got, wanted) < 1e-12
        torques.append(wanted)
    np.testing.assert_allclose(torques[1], torques[0], rtol=1e-12)


def test_compensation_and_the_handle_feel_plain_viscous_friction(alike):
    laws = [Compensation(GivenParameters.of(model, dict(zip(model.base.names, beta, strict=True))), 0.0, 0.0, 1.0)
            for model, beta in alike]  # fmt: skip
    steps = [law.begin(1e-3) for law in laws]
    path = 0.3 * np.sin(np.linspace(0, 3, 40))
    told = np.array([[step(1e-3 * k, np.array([x, -x])) for k, x in enumerate(path)] for step in steps])
    assert np.abs(told[0, 5:]).min() > 0
    np.testing.assert_allclose(told[1], told[0], rtol=1e-12)
    plain, both = (viscous_matrix(model, beta, np.zeros((len(model.device.active), 1)))[0] for model, beta in alike)
    np.testing.assert_allclose(both, plain)
    assert plain[0, 0] == 0.3


def test_it_is_viscous_friction_and_never_negative(tmp_path):
    model = read(tmp_path, BOTH)
    beta = np.full(len(model.base), 0.4)
    made = motion(model, beta, noise=0.01, dt=4e-3)
    found = haptid.estimate(haptid.observe(model, made), haptid.WLS())
    assert "viscous" in haptid.end_effector.decompose_torque(found, made).parts
    assert "own columns" not in haptid.end_effector.decompose_torque(found, made).parts
    beta[model.base.names.index("FVN1")] = -0.2
    assert not haptid.estimation.feasible_parameters(model, beta).ok
