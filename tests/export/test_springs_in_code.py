"""Written C of elastic motors: feed-forward and torsion estimate by closed forms and laws; MJCF by the model."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

import haptid
from compiled import NAME, STRICT, compiler, run
from haptid.device.toml.reader import checked_tables, device_of
from haptid.export import CCode, export_c, export_model
from haptid.export.model.functions import code_of

J, K, D, IA, FV, FVM = 0.1, 600.0, 1.5, 0.05, 0.05, 0.1
DT, SPEED = 1e-3, 0.01
TERMS = [
    {"kind": "elastic", "motors": "all"},
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "viscous", "motors": "all"},
]
DRIVER = """
#include "dev.h"
void plan(int count, const double beta[], double q[], double qd[], double qdd[], double tau[], double theta[])
{
    dev_model model; dev_elastic state; int i;
    dev_init(&model, beta);
    (void)dev_elastic_init(&state, 100.0, DT);
    for (i = 0; i < count; i++) {
        const int at = i * DEV_COORDINATES;
        dev_elastic_plan(&model, &state, q + at, qd + at, qdd + at, tau + at);
        dev_motor_position(q + at, theta + i * MOTORS);
    }
}
void estimate(int count, const double beta[], double gain, const double theta[], const double thetad[],
              const double motor[], double torsion[], double spring[])
{
    dev_model model; dev_elastic state; int i;
    dev_init(&model, beta);
    (void)dev_elastic_init(&state, gain, DT);
    for (i = 0; i < count; i++) {
        const int at = i * MOTORS;
        dev_elastic_estimate(&model, &state, theta + at, thetad + at, motor + at, torsion + at, spring + at);
    }
}
"""


def modelled(terms: list[dict[str, object]] = TERMS, **changes: object) -> haptid.DynamicModel:
    data = {"schema": 1, "name": "dev", "gravity": [0.0, 0.0, -9.81], "joints": [{"name": "1"}], "terms": terms}
    return haptid.DynamicModel(device_of(*checked_tables({**data, **changes}, "dev.toml")))


def arm() -> tuple[haptid.DynamicModel, np.ndarray]:
    """Two links in a vertical plane with coupled motors, and base parameters of bodies that can exist."""
    joints = [{"name": "1"}, {"name": "2", "d": 0.3}]
    motors = [{"name": "a", "drives": {"1": 1.0}}, {"name": "b", "drives": {"1": 0.5, "2": 1.0}}]
    coulomb = [*TERMS, {"kind": "coulomb", "motors": "all"}, {"kind": "coulomb", "joints": ["2"]}]
    model = modelled(coulomb, gravity=[0.0, -9.81, 0.0], joints=joints, motors=motors)
    values = {"ZZ1": 0.06, "ZZ2": 0.06, "MX2": 0.15, "M2": 1.0, "KEa": 400.0, "KEb": 300.0, "DEa": 0.8, "IAMa": 0.02}
    values |= {"IAMb": 0.03, "FV1": 0.1, "FVMa": 0.05, "FVMb": 0.04, "FCMa": 0.2, "FCMb": 0.1, "FC2": 0.15, "MX1": 0.1}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    return model, model.base.of(chi)


def axis() -> tuple[haptid.DynamicModel, np.ndarray]:
    model = modelled()
    truth = {"ZZ1": J, "KE1": K, "DE1": D, "IAM1": IA, "FV1": FV, "FVM1": FVM}
    return model, np.array([truth[name] for name in model.base.names])


def library(folder: Path, model: haptid.DynamicModel, beta: np.ndarray) -> ctypes.CDLL:
    """The written code with the driver above, compiled."""
    export_c((model, beta), folder, CCode(NAME, reversal_speed=SPEED))
    defined = [f"-DMOTORS={len(model.device.motors)}", f"-DDT={DT}"]
    (folder / "driver.c").write_text(DRIVER)
    shared = ["-O1", "-shared", "-fPIC", "-o", "driven.so", "driver.c", f"{NAME}.c", "-lm"]
    run([compiler("cc"), *(flag for flag in STRICT if flag != "-Wpedantic"), *defined, *shared], folder)
    run([compiler("cc"), *STRICT, "-o", "selftest", f"{NAME}_selftest.c", f"{NAME}.c", "-lm"], folder)
    run(["./selftest"], folder)
    return ctypes.CDLL(str(folder / "driven.so"))


def pointers(*arrays: np.ndarray) -> list[ctypes.c_void_p]:
    return [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]


def waves(seconds: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Times, and complex amplitudes of sines below 8 Hz."""
    t = DT * np.arange(round(seconds / DT))
    return t, 2j * np.pi * np.array([0.7, 1.9, 4.3, 7.7])


def real(amplitude: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.asarray((amplitude[:, None] * np.exp(s[:, None] * t)).real.sum(axis=0))


def closed_form() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Motion and torques of the axis along sines of its link."""
    t, s = waves()
    Q = 1.0 / np.abs(s)
    motor = Q * (J * s**2 + (FV + D) * s + K) / (D * s + K)
    spring = (K + D * s) * (motor - Q)
    torque = motor * (IA * s**2 + FVM * s) + spring
    named = {"q": Q, "qd": s * Q, "qdd": s**2 * Q, "theta": motor, "thetad": s * motor, "tau": torque, "spring": spring}
    return {name: real(x, s, t) for name, x in named.items()}, t


def test_feed_forward_of_one_axis_is_the_closed_form(tmp_path):
    model, beta = axis()
    true, t = closed_form()
    made, torsions = library(tmp_path, model, beta), 0  # the torsion is the first coordinate
    q, qd, qdd, tau = (np.zeros((len(t), 2)) for _ in range(4))
    for array, name in ((q, "q"), (qd, "qd"), (qdd, "qdd")):
        array[:, 1] = true[name]
    theta = np.zeros((len(t), 1))
    made.plan(len(t), *pointers(np.ascontiguousarray(beta), q, qd, qdd, tau, theta))
    settled = t > 0.1
    bent = true["theta"] - true["q"]
    # Linear between samples: (w dt)^2 / 12 of the torsion; its acceleration is half a sample late.
    w = 2 * np.pi * 7.7
    assert np.abs(q[settled, torsions] - bent[settled]).max() < (w * DT) ** 2 / 12 * np.abs(bent).max()
    assert np.abs(theta[settled, 0] - true["theta"][settled]).max() < 1e-3 * np.abs(bent).max()
    late = IA * np.abs(bent).max() * w**2 * (w * DT)
    assert np.abs(tau[settled, 1] - true["tau"][settled]).max() < late
    assert late < 0.02 * np.abs(true["tau"]).max()


def test_torsion_is_estimated_from_the_motor_alone(tmp_path):
    model, beta = axis()
    true, t = closed_form()
    made, gain = library(tmp_path, model, beta), 500.0
    theta, thetad, tau = (np.ascontiguousarray(true[name]) for name in ("theta", "thetad", "tau"))
    torsion, spring = np.zeros_like(theta), np.zeros_like(theta)
    arguments = pointers(np.ascontiguousarray(beta))
    made.estimate(len(t), *arguments, ctypes.c_double(gain), *pointers(theta, thetad, tau, torsion, spring))
    # The estimate is the truth behind gain / (s + gain).
    times, s = waves()
    Q = 1.0 / np.abs(s)
    motor = Q * (J * s**2 + (FV + D) * s + K) / (D * s + K)
    behind = (motor - Q) * gain / (s + gain)
    wanted, settled = real(behind, s, times), times > 0.1
    assert np.abs(torsion[settled] - wanted[settled]).max() < 0.01 * np.abs(wanted).max()


def test_feed_forward_of_an_arm_leaves_no_torque_on_the_links(tmp_path):
    """Motors and springs alone act: the rows' torques, on the joints, vanish at those that springs move."""
    model, beta = arm()
    made, (t, s) = library(tmp_path, model, beta), waves(0.5)
    states = [np.array([real(s**k * a / s**2, s, t) for a in (3.0 + 0j * s, 2j + 0 * s)]) for k in range(3)]
    q, qd, qdd, tau = (np.zeros((len(t), 4)) for _ in range(4))
    for array, x in zip((q, qd, qdd), states, strict=True):
        array[:, 2:] = x.T
    theta = np.zeros((len(t), 2))
    made.plan(len(t), *pointers(np.ascontiguousarray(beta), q, qd, qdd, tau, theta))
    joints = model.device.row_map.T @ tau.T
    links = [k for k, j in enumerate(model.device.active) if model.device.joints[j].name in "12"]
    assert np.abs(joints[links]).max() < 1e-12 * np.abs(joints).max()
    load = np.array([[1.0, 0.0], [0.5, 1.0]]) @ states[0]
    np.testing.assert_allclose(theta.T, load + q[:, :2].T, atol=1e-12)


def test_springs_sag_under_gravity_at_rest(tmp_path):
    """Held still, each torsion is the static torque of its spring over the stiffness."""
    model, beta = arm()
    made, count = library(tmp_path, model, beta), 400
    q, qd, qdd, tau = (np.zeros((count, 4)) for _ in range(4))
    q[:, 2:] = 0.4, -0.7
    made.plan(count, *pointers(np.ascontiguousarray(beta), q, qd, qdd, tau, np.zeros((count, 2))))
    # Static torque of the links by hand: masses at (0.1, 0) and (0.15, 0) with 1 kg at the second, 0.3 m long link.
    g, (q1, q2) = 9.81, (0.4, -0.7)
    beyond = 0.15 * g * np.cos(q1 + q2)
    joints = np.array([(0.1 + 0.3 * 1.0) * g * np.cos(q1) + beyond, beyond])
    motors = np.linalg.solve(np.array([[1.0, 0.5], [0.0, 1.0]]), joints)  # B' Gamma = torque of the joints
    np.testing.assert_allclose(q[-1, :2], motors / [400.0, 300.0], rtol=1e-6)


def test_code_of_springs_with_play_has_no_torsions():
    """Play has no inverse: the functions of springs are left out, all others stay."""
    loose = modelled([{**TERMS[0], "play": 0.01}, *TERMS[1:]])
    names = [function.name for function in code_of(loose, SPEED).functions]
    assert "inverse_dynamics" in names
    assert not {"springs", "spring_torque", "rotors"} & set(names)


def test_an_exported_mjcf_bends_as_the_model(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model, beta = arm()
    smooth = beta * [not name.startswith("FC") for name in model.base.names]
    made = export_model((model, smooth), tmp_path, ["mjcf"])["mjcf"]
    simulated = mujoco.MjModel.from_xml_path(str(made.folder / made.files[0]))
    data, rng = mujoco.MjData(simulated), np.random.default_rng(0)
    names = [mujoco.mj_id2name(simulated, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(simulated.njnt)]
    order = [names.index(model.device.joints[j].name) for j in model.device.active]
    for _ in range(5):
        data.qpos[:], data.qvel[:], data.ctrl[:] = (rng.uniform(-1, 1, n) for n in (4, 4, 2))
        mujoco.mj_forward(simulated, data)
        states = (x[order][:, None] for x in (data.qpos, data.qvel, data.qacc))
        rows = haptid.inverse_dynamics(model, smooth, *states)[:, 0]
        joints = model.device.row_map.T @ rows
        motors = [model.device.joints[j].name.startswith("rotor") for j in model.device.active]
        np.testing.assert_allclose(joints[motors], data.ctrl, atol=1e-8)
        np.testing.assert_allclose(joints[np.logical_not(motors)], 0.0, atol=1e-8)


def test_a_urdf_has_stiff_springs(tmp_path):
    """Rotors are of the joints that the motors drive, and the file says so."""
    model, beta = arm()
    made = export_model((model, beta), tmp_path, ["urdf"])["urdf"]
    text = (made.folder / made.files[0]).read_text()
    assert "motors are rigid, as below the resonances" in text
    assert 'joint name="rotor' not in text
