"""More motors than degrees of freedom: B(q)' Gamma = Y beta against own Lagrangians and MuJoCo, and its estimation."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog

import haptid
from haptid import estimation
from haptid.device.priors import PriorBody
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.end_effector.characterisation import GivenParameters, characterise
from haptid.errors import IncompleteDeviceError, LogMismatchError
from haptid.estimation import TorqueNoise
from haptid.estimation.methods.gls import channel_variances
from haptid.experiment import bench
from haptid.experiment.bench.mjcf import depth_first, mjcf
from haptid.log import Channels, Log, Signal
from haptid.motion.motion import Motion
from haptid.motion.treatment import Treatment
from haptid.observation import Payload, log_without_payload, without_payload
from haptid.observation.rows import Rows
from haptid.simulation import PID, Segments, closed_loop, sensitivity, smooth
from haptid.study.draft import draft_study
from true_parameters import put

LIBRARY = Path(haptid.__file__).parent / "device" / "library"
MOTOR = '[[motors]]\nname = "{}"\ndrives = {{ {} }}\n\n'
# Shipped devices with more motors: the device, the motors added, and what has to go from the file.
DRIVEN = {
    "five_bar": [("elbow", "3 = 1")],  # a third motor between the left bars
    "delta": [("elbow", "1a = 1"), ("spare", "2 = 1")],
    "cea_medical_branch": [
        ("1", "1 = 1"),
        ("2", "2 = 1"),
        ("5", "5 = 1"),
        ("elbow", "3 = 1"),
        ("cable", "1 = 0.5, 2 = -1"),
    ],
    "four_bar": [("output", "rocker = 1")],
}


def driven(name, folder, extra="", rotors='"all"'):
    """A shipped device with the motors of `DRIVEN`."""
    text = (LIBRARY / f"{name}.toml").read_text()
    at = text.index("[[terms]]")
    text = text[:at] + "".join(MOTOR.format(*motor) for motor in DRIVEN[name]) + extra + text[at:]
    text = text.replace('kind = "rotor-inertia"\nmotors = "all"', f'kind = "rotor-inertia"\nmotors = {rotors}')
    (folder / f"{name}.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / f"{name}.toml"))


def chi_of(model, seed=3):
    """Bodies of every link, and terms of a size that matters."""
    rng, chi = np.random.default_rng(seed), np.zeros(len(model.device.parameters))
    for joint in model.device.joints:
        if joint.body:
            inertia = np.diag(rng.uniform(2e-5, 3e-5, 3))
            put(
                model,
                chi,
                joint.name,
                rng.uniform(0.03, 0.06),
                np.array([0.04, 0.005, 0.003]),
                np.diag(inertia),
                [0, 0, 0],
            )
    sizes = {"IA": 2e-5, "FV": 1e-3, "FC": 2e-3, "OFF": 1e-3}
    for k, kind in enumerate(model.device.parameters.kinds):
        chi[k] = sizes.get(kind, chi[k]) * rng.uniform(0.5, 1.5) if kind in sizes else chi[k]
    return chi


def test_a_motion_that_was_followed_before_gives_the_same():
    """Of a closure that keeps what it followed, and of a new one; at rest the rates do not change."""
    device = haptid.read_device("delta")
    rng = np.random.default_rng(5)
    qa = device.closure.draw(rng, 40)
    qda = rng.standard_normal(qa.shape)
    first = device.closure.follow(qa, qda)
    again, still = device.closure.follow(qa, qda), device.closure.follow(qa)
    fresh = haptid.read_device("delta").closure.follow(qa, qda)
    for name in ("q", "G", "Gd"):
        assert (getattr(first, name) == getattr(again, name)).all()
        assert (getattr(first, name) == getattr(fresh, name)).all()
    assert (still.G == first.G).all()
    assert not still.Gd.any()
    assert np.abs(first.Gd).max() > 0
    with pytest.raises(ValueError, match="read-only"):
        first.G[0] = 0.0


@pytest.mark.parametrize("name", DRIVEN)
def test_mujocos_actuators_load_the_coordinates_as_b(name, tmp_path):
    """The moment arms of MuJoCo's actuators, projected on the independent joints, are B."""
    model = driven(name, tmp_path)
    device, chi = model.device, chi_of(model)
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    data, order = mujoco.MjData(mj_model), list(depth_first(model))
    qa = device.closure.draw(np.random.default_rng(1), 5)
    followed, B = device.closure.follow(qa), device.drive_jacobian(qa)
    assert device.torque_rows == "joint"
    assert device.redundant
    for k in range(5):
        data.qpos[:] = followed.q[order, k]
        mujoco.mj_forward(mj_model, data)
        arms = np.zeros((mj_model.nu, mj_model.nv))
        mujoco.mju_sparse2dense(arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
        G = followed.G if followed.G.ndim == 2 else followed.G[k]
        wanted = B if B.ndim == 2 else B[k]
        np.testing.assert_allclose(arms[: len(device.motors)] @ G[order], wanted[device.driven], atol=1e-10)


class FiveBar:
    """A five-bar by hand: points from circles, energies from point masses and rotations, Lagrange's equations.

    Derivatives are central differences; nothing of haptid is used.
    """

    inner, outer, apart, g = 0.063, 0.075, 0.025, 9.81

    def __init__(self, bodies, rotors, viscous):
        self.bodies, self.rotors, self.viscous = bodies, rotors, viscous  # (mass, x, y, J about the centre) of 1 to 4

    def angles(self, q):
        """Absolute angles of the four bars."""
        base = np.array([[-self.apart / 2, 0.0], [self.apart / 2, 0.0]])
        knees = base + self.inner * np.array([[np.cos(a), np.sin(a)] for a in q])
        middle, across = knees.mean(axis=0), knees[1] - knees[0]
        half = np.linalg.norm(across) / 2
        tip = middle + np.sqrt(self.outer**2 - half**2) * np.array([-across[1], across[0]]) / (2 * half)
        a3, a4 = (np.arctan2(*(tip - knee)[::-1]) for knee in knees)
        return np.array([q[0], q[1], a3, a4]), np.array([base[0], base[1], knees[0], knees[1]])

    def centres(self, q):
        angles, origins = self.angles(q)
        x, y = np.array([b[1] for b in self.bodies]), np.array([b[2] for b in self.bodies])
        c, s = np.cos(angles), np.sin(angles)
        return origins + np.column_stack([c * x - s * y, s * x + c * y])

    def motors(self, q):
        """Coordinates of the three motors: both base angles, and the angle between the left bars."""
        angles, _ = self.angles(q)
        return np.array([angles[0], angles[1], angles[2] - angles[0]])

    def slope(self, f, q, h=1e-5):
        steps = np.eye(2) * h
        return np.stack(
            [(8 * (f(q + e) - f(q - e)) - (f(q + 2 * e) - f(q - 2 * e))) / (12 * h) for e in steps], axis=-1
        )

    def lagrangian(self, q, qd):
        v = self.slope(self.centres, q) @ qd
        w = self.slope(lambda x: self.angles(x)[0], q) @ qd
        m, J = np.array([b[0] for b in self.bodies]), np.array([b[3] for b in self.bodies])
        kinetic = 0.5 * (m @ (v**2).sum(axis=1) + J @ w**2)
        kinetic += 0.5 * self.rotors @ (self.slope(self.motors, q) @ qd) ** 2
        return kinetic - self.g * m @ self.centres(q)[:, 1]

    def momentum(self, q, qd, h=1e-2):
        """dL/dqd; L is quadratic in the rates, so that a difference is exact."""
        return np.array([(self.lagrangian(q, qd + e) - self.lagrangian(q, qd - e)) / (2 * h) for e in np.eye(2) * h])

    def torque(self, q, qd, qdd):
        """Generalised torques: d/dt dL/dqd - dL/dq, and viscous friction of the motors."""
        h = 1e-4
        ahead = [self.momentum(q + s * h * qd + 0.5 * (s * h) ** 2 * qdd, qd + s * h * qdd) for s in (1, -1, 2, -2)]
        inertial = (8 * (ahead[0] - ahead[1]) - (ahead[2] - ahead[3])) / (12 * h)
        B = self.slope(self.motors, q)
        return inertial - self.slope(lambda x: self.lagrangian(x, qd), q, 1e-4) + B.T @ (self.viscous * (B @ qd))

    def shares(self, q):
        return self.slope(self.motors, q)


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory):
    return driven("five_bar", tmp_path_factory.mktemp("five_bar"))


def test_rows_of_a_five_bar_with_three_motors_are_those_of_lagrange(five_bar):
    bodies = [
        (0.05, 0.03, 0.002, 2e-5),
        (0.045, 0.035, -0.001, 2.2e-5),
        (0.04, 0.04, 0.003, 1.8e-5),
        (0.03, 0.03, 0.001, 1.5e-5),
    ]
    rotors, viscous = np.array([2e-5, 3e-5, 8e-6]), np.array([1e-3, 2e-3, 5e-4])
    chi, index = np.zeros(len(five_bar.device.parameters)), five_bar.device.parameters.index
    for k, (m, x, y, J) in enumerate(bodies, start=1):
        chi[index[f"M{k}"]], chi[index[f"MX{k}"]], chi[index[f"MY{k}"]] = m, m * x, m * y
        chi[index[f"ZZ{k}"]] = J + m * (x**2 + y**2)
    for motor, rotor, damping in zip(("1", "2", "elbow"), rotors, viscous, strict=True):
        chi[index[f"IAM{motor}"]], chi[index[f"FVM{motor}"]] = rotor, damping
    own, rng = FiveBar(bodies, rotors, viscous), np.random.default_rng(0)
    q = np.array([2.356, 0.785])[:, None] + rng.uniform(-0.4, 0.4, (2, 6))
    qd, qdd = rng.uniform(-5, 5, (2, 6)), rng.uniform(-50, 50, (2, 6))
    found = haptid.inverse_dynamics(five_bar, five_bar.base.of(chi), q, qd, qdd)
    wanted = np.array([own.torque(*x) for x in zip(q.T, qd.T, qdd.T, strict=True)]).T
    np.testing.assert_allclose(found, wanted, atol=2e-6 * np.abs(wanted).max())
    B = np.array([own.shares(x) for x in q.T])
    np.testing.assert_allclose(five_bar.device.drive_jacobian(q), B, atol=1e-8)


@pytest.mark.parametrize("name", ["five_bar", "cea_medical_branch"])
def test_groupings_with_symbols_are_the_numeric_ones(name, tmp_path):
    """`regroupings` compares the two itself; friction of motors whose rates depend on each other regroups."""
    model = driven(name, tmp_path)
    assert model.regroupings.independent_columns == model.base.independent_columns
    if name == "cea_medical_branch":  # the elbow's rate is that of joint 3, q5 - q2
        names = model.base.names
        assert not any(x.startswith("FVMelbow") for x in names)


NOISE = np.array([1e-4, 1.5e-4, 2e-3])


def recorded(model, chi, seed, preload=0.0):
    """A motion of the five-bar and a log of its three motors with noise; `preload` of them is in balance."""
    t, rng = np.arange(0.0, 6.0, 2e-3), np.random.default_rng(seed)
    omega = 2 * np.pi * np.array([[0.5, 1.7], [0.7, 2.3]])[:, :, None]
    size, phase = np.array([[0.25], [0.1]])[None], rng.uniform(0, 6, (2, 2, 1))
    waves = (np.sin(omega * t + phase), omega * np.cos(omega * t + phase), -(omega**2) * np.sin(omega * t + phase))
    q, qd, qdd = ((size * wave).sum(axis=1) for wave in waves)
    q = q + np.array([[2.356], [0.785]])
    rows = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
    B, law = model.device.drive_jacobian(q), model.device.law
    motors = model.device.drive_torque(q, rows) + law.balanced(B, np.full((len(t), 3), preload) * [1, 2, -1]).T
    motors = motors + NOISE[:, None] * rng.standard_normal(motors.shape)
    channels = Channels(Signal(("q1", "q2"), "rad"), Signal(("c1", "c2", "c3"), "N m", side="motor"), rate_hz=500.0)
    log = Log(Path("made"), f"{seed} {preload}", t, q.T, motors.T, channels)
    return Motion(2e-3, q.T, motors.T, Treatment(cutoff_hz=None, block_s=0.2), log, rates=(qd.T, qdd.T))


def test_parameters_are_recovered_whatever_the_preload(five_bar):
    chi = chi_of(five_bar)
    truth = five_bar.base.of(chi)
    motion, preloaded = recorded(five_bar, chi, 0), recorded(five_bar, chi, 0, preload=0.1)
    observation = haptid.observe(five_bar, motion)
    weighted, found = (haptid.estimate(observation, method) for method in (haptid.WLS(), TorqueNoise()))
    low, high = np.array([p.conf_int() for p in found.parameters]).T
    assert ((low <= truth) & (truth <= high)).mean() > 0.8
    assert np.median(found.se / weighted.se) < 0.9
    variances = channel_variances(Rows(observation), truth)
    np.testing.assert_allclose(variances[2], NOISE[2] ** 2, rtol=0.1)
    np.testing.assert_allclose(variances[:2].sum(), (NOISE[:2] ** 2).sum(), rtol=0.3)
    other = haptid.estimate(haptid.observe(five_bar, preloaded), TorqueNoise())
    np.testing.assert_allclose(other.beta, found.beta, atol=1e-6 * np.abs(found.se).max())


@pytest.fixture(scope="module")
def controlled(five_bar):
    """The five-bar under three motors' own controllers on MuJoCo's bench, and the model along it."""
    controller, encoders = bench.Controller((3.0, 3.0, 1.0), (0.03, 0.03, 0.01)), bench.Encoders((4000.0,))
    setup = bench.Setup(five_bar, chi_of(five_bar), controller, encoders=encoders)
    kind = bench.Multisine(3.0, (2.356, 0.785), (0.3, 0.3), speed=4.0)
    trajectory = bench.plan(kind, five_bar, setup.dt, np.random.default_rng(1))
    made = bench.simulate(setup, trajectory, np.random.default_rng(2))
    channels = Channels(Signal(("q1", "q2"), "rad"), Signal(("c1", "c2", "c3"), "N m", side="motor"), time="t")
    log = Log(Path("bench"), "", made.t, made.position, made.command, channels)
    treatment = Treatment(cutoff_hz=30, decimation=10, torque_delay_s=5e-4, reversal_speed=0.05)
    law = PID((3.0, 3.0, 1.0), (0.03, 0.03, 0.01), reference=(made.target,), velocity_cutoff_hz=100)
    return made, haptid.treat(log, treatment), law


def test_simulated_controllers_of_rates_that_vary_are_those_of_the_bench(five_bar, controlled):
    """Against MuJoCo; sensitivities against differences of simulations."""
    made, motion, law = controlled
    base = np.asarray(five_bar.device.parameters.S[:, list(five_bar.base.independent_columns)])
    beta, smoothed = five_bar.base.of(chi_of(five_bar)), smooth(five_bar, [motion], 0.05)
    forward, begin = ForwardDynamics(smoothed, sets_of(five_bar, beta)), np.array([1000, 1500])
    segments = Segments(np.arange(100)[:, None] + begin, np.ones((100, 2), dtype=bool), len(motion))
    steps = closed_loop(forward, law, motion, 0, segments)
    exact = made.q[segments.sample][:, :, list(five_bar.device.active)].transpose(0, 2, 1)
    assert np.sqrt(((steps.c - exact)[50:] ** 2).mean()) < 5e-4
    # The controller's torque is constant in a control period, and the trapezoidal rule takes it at its middle.
    fast = replace(law, rate_hz=2000.0)
    steps = closed_loop(forward, fast, motion, 0, segments)
    sensitive = sensitivity(forward, fast, motion, steps, base)
    for k in range(0, len(beta), 6):
        h = 1e-4 * max(abs(beta[k]), 1e-4)
        sets = beta + h * np.array([[1.0], [-1.0]]) * np.eye(len(beta))[k]
        both = closed_loop(ForwardDynamics(smoothed, sets_of(five_bar, sets)), fast, motion, 0, segments)
        for values, found in ((both.c, sensitive.c[:, :, k]), (both.tau, sensitive.tau[:, :, k])):
            slope = (values[:: steps.per, :, :2] - values[:: steps.per, :, 2:]) / (2 * h)
            assert np.linalg.norm(found - slope) < 0.01 * np.linalg.norm(slope), five_bar.base.names[k]


def test_a_method_that_simulates_recovers_redundant_drives(five_bar, controlled):
    _, motion, law = controlled
    truth = five_bar.base.of(chi_of(five_bar))
    found = haptid.estimate(haptid.observe(five_bar, motion), estimation.CLIE(law))
    low, high = found.conf_int().T
    assert ((low <= truth) & (truth <= high)).mean() > 0.8
    assert (np.abs(found.beta - truth) <= 6 * found.se).all()


def test_measured_preload_is_reported_apart(five_bar):
    from haptid.validation.motor_torques import motor_torques

    chi = chi_of(five_bar)
    motion = recorded(five_bar, chi, 1, preload=0.1)
    made = motor_torques(haptid.estimate(haptid.observe(five_bar, motion), TorqueNoise()), motion)
    wanted = five_bar.device.law.balanced(five_bar.device.drive_jacobian(motion.q.T), np.array([0.1, 0.2, -0.1])).T
    noise = np.sqrt((NOISE**2).sum() / made.preload.shape[1])
    np.testing.assert_allclose(made.preload.mean(axis=1), wanted.mean(axis=1), atol=4 * noise)
    left = made.measured - made.predicted - made.preload
    assert (np.sqrt((left**2).mean(axis=1)) < 2 * NOISE.max()).all()


def test_a_payload_is_subtracted_from_the_motors_by_the_law(five_bar):
    """What the motors have with a payload, less what the law gives for it, is what they have without."""
    chi, body = chi_of(five_bar), PriorBody(0.2, np.array([0.05, 0.01, 0.0]), np.diag([0.0, 0.0, 1e-4]))
    heavier = chi.copy()
    for name, value in {"M4": 0.2, "MX4": 0.01, "MY4": 0.002, "ZZ4": 1e-4 + 0.2 * (0.05**2 + 0.01**2)}.items():
        heavier[five_bar.device.parameters.index[name]] += value
    wanted, loaded = recorded(five_bar, chi, 5, preload=0.1), recorded(five_bar, heavier, 5, preload=0.1)
    inside = slice(20, -20)
    change = np.abs(loaded.tau - wanted.tau).max(axis=0)
    free = without_payload(five_bar, loaded, "4", body)
    np.testing.assert_allclose(free.tau[inside] / change, wanted.tau[inside] / change, atol=1e-10)
    log = log_without_payload(five_bar, loaded.log, Treatment(cutoff_hz=None), Payload("4", body))
    np.testing.assert_allclose(log.torque[inside] / change, wanted.tau[inside] / change, atol=1e-3)


def test_the_law_gives_the_rows_with_the_least_weighted_squares(five_bar, tmp_path):
    weighted = driven(
        "five_bar", tmp_path, "[transmission]\nweights = { 1 = 1, 2 = 2, elbow = 9 }\npreload = { 1 = 0.3 }\n"
    )
    rng = np.random.default_rng(2)
    q = np.array([2.356, 0.785])[:, None] + rng.uniform(-0.4, 0.4, (2, 4))
    torque = rng.normal(size=(2, 4))
    for model, weights in ((five_bar, np.ones(3)), (weighted, np.array([1.0, 2.0, 9.0]))):
        device = model.device
        B, shares = device.drive_jacobian(q), device.law.shares(device.drive_jacobian(q))
        np.testing.assert_allclose(np.swapaxes(B, 1, 2) @ shares, np.broadcast_to(np.eye(2), (4, 2, 2)), atol=1e-12)
        null = np.linalg.svd(np.swapaxes(B, 1, 2))[2][:, -1]  # balance is orthogonal in the weights
        np.testing.assert_allclose(np.einsum("sd,d,sda->sa", null, weights, shares), 0.0, atol=1e-12)
        made = device.drive_torque(q, torque)
        np.testing.assert_allclose(device.row_torque(q, made), torque, atol=1e-12)
        assert np.abs(device.law.balanced(B, made.T)).max() > 1e-3 or not device.law.preload.any()


def test_greatest_forces_are_those_of_a_linear_programme(tmp_path):
    five_bar = driven("five_bar", tmp_path, rotors='["1", "2"]')  # at the handle, rotors only with constant rates
    rng, limits = np.random.default_rng(4), {"1": 0.2, "2": 0.3, "elbow": 0.1}
    q = np.array([2.356, 0.785])[:, None] + rng.uniform(-0.3, 0.3, (2, 3))
    identified = GivenParameters(five_bar, five_bar.base.of(chi_of(five_bar)))
    made = characterise(identified, q, rows=(0, 1))
    d = np.array([0.6, -0.8])
    found, worst = made.force_along(d, limits).values, made.greatest_force(limits)[0].values
    held = haptid.inverse_dynamics(five_bar, identified.beta, q, np.zeros_like(q), np.zeros_like(q))
    B, size = five_bar.device.drive_jacobian(q), np.array(list(limits.values()))
    for k in range(3):
        by_programme = []
        for a in [np.arctan2(d[1], d[0]), *np.linspace(0, 2 * np.pi, 90)]:
            load = made.handle.jacobian[k].T @ [np.cos(a), np.sin(a)]
            # largest f with B' Gamma = held + J' d f and |Gamma| <= limits
            answer = linprog(
                [0, 0, 0, -1],
                A_eq=np.column_stack([B[k].T, -load]),
                b_eq=held[:, k],
                bounds=[*((-s, s) for s in size), (0, None)],
            )
            by_programme.append(answer.x[-1])
        np.testing.assert_allclose(found[k], by_programme[0], rtol=1e-6)
        assert 0.98 * min(by_programme) < worst[k] <= min(by_programme) * (1 + 1e-6)


def test_bad_input_is_refused_with_what_to_do(tmp_path):
    mixed = (LIBRARY / "slider_crank.toml").read_text()
    slide = next(
        line.split('"')[1] for line in mixed[: mixed.index("prismatic")].splitlines()[::-1] if line.startswith("name")
    )
    at = mixed.index("[[terms]]")
    (tmp_path / "mixed.toml").write_text(mixed[:at] + MOTOR.format("push", f"{slide} = 1") + mixed[at:])
    device = haptid.read_device(tmp_path / "mixed.toml")
    with pytest.raises(IncompleteDeviceError, match=r"no law says .* weights"):
        device.drive_torque(device.closure.at[:, None], np.ones((1, 1)))
    model = driven("five_bar", tmp_path)
    t = np.arange(0.0, 1.0, 1e-3)
    channels = Channels(Signal(("q1", "q2"), "rad"), Signal(("c1", "c2"), "N m", side="motor"), rate_hz=1000.0)
    short = Log(Path("made"), "", t, np.tile([2.356, 0.785], (len(t), 1)), np.zeros((len(t), 2)), channels)
    with pytest.raises(LogMismatchError, match="2 torque channels, and the device requires 3: 1, 2, elbow"):
        haptid.observe(model, haptid.treat(short, Treatment(cutoff_hz=None)))


def test_a_draft_of_a_study_has_the_channels_of_all_motors(five_bar, tmp_path):
    """In their order, that of a motor on a passive joint too."""
    head = "time,position[2],position[1],effort[elbow],effort[2],effort[1]"
    rows = np.sin(np.outer(np.arange(50) * 0.1, np.arange(6)))
    rows[:, 0] = np.arange(50) * 1e-3
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=head, comments="")
    study, _ = draft_study([tmp_path / "log.csv"], five_bar.device, str(tmp_path / "five_bar.toml"), tmp_path)
    assert 'field = "position", joints = [1, 2]' in study
    assert 'field = "effort", joints = [1, 2, "elbow"]' in study
