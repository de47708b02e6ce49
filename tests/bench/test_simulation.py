"""The bench keeps loops closed and energy, moves as haptid's model says, and gives the parameters back."""

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment import bench
from sampling import of_deviation
from true_parameters import true_parameters
from virtual_bench import exact_identification, free_motion, phantom

CENTRES = {
    "phantom_premium_15": ((0.0, 0.2, 0.3), (0.6, 0.35, 0.4), (40.0, 35.0, 14.0), (0.5, 0.4, 0.16)),
    "cea_medical_branch": ((0.1, -1.0, 0.65 + np.pi), (1.0, 0.5, 0.5), (300.0, 150.0, 80.0), (6.0, 3.0, 1.6)),
}


def made(name="phantom_premium_15", seconds=3.0, seed=2, still=False, **settings):
    """A short multisine of a device, with whatever else is on the bench."""
    model = haptid.DynamicModel(haptid.read_device(name))
    centre, size, kp, kd = CENTRES[name]
    size = tuple(0.0 for _ in size) if still else size
    kind = bench.Multisine(seconds, centre, size, speed=(3.0,), ramp=0.8)
    settings.setdefault("controller", bench.Controller(kp, kd))
    setup = bench.Setup(model, true_parameters(model), **settings)
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(1))
    return setup, bench.simulate(setup, trajectory, np.random.default_rng(seed))


@pytest.mark.parametrize("name", CENTRES)
def test_free_motion_keeps_loops_closed_and_energy(name):
    gap, drift = free_motion(name, 2.0)
    assert gap < 1e-9
    assert drift < 1e-7


@pytest.mark.parametrize("name", CENTRES)
def test_motor_torques_are_those_of_the_model_at_the_exact_states(name):
    setup, found = made(name)
    model, active = setup.model, list(setup.model.device.active)
    q, qd, qdd = (x[:, active].T for x in (found.q, found.qd, found.qdd))
    tau = haptid.inverse_dynamics(model, model.base.of(setup.chi), q, qd, qdd).T
    moving = (np.abs(found.qd) > 0.05).all(axis=1)
    error, torque = (tau - found.torque)[moving], found.torque[moving]
    assert moving.mean() > 0.3
    assert (np.linalg.norm(error, axis=0) < 2e-5 * np.linalg.norm(torque, axis=0)).all()
    assert (np.abs(error).max(axis=0) < 1e-4 * np.abs(torque).max(axis=0)).all()
    assert found.gap < 1e-9


def test_exact_states_give_the_parameters_back():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    off = exact_identification(model, phantom(20.0, model, step=5e-4))
    assert off["torque"] < 0.01
    assert off["parameters"] < 0.05
    assert off["Coulomb"] < 0.01
    assert off["viscous"] < 0.2


def test_the_hand_is_in_the_balance_of_forces():
    """Motor torques and the hand's force on the handle together are the model's torque."""
    push = bench.Push((1.0, 0.5, -0.8), frequency_hz=2.0, start=0.2, stop=1.5)
    setup, found = made(seconds=2.0, hand=(push,), sensor=bench.ForceSensor())
    model, active = setup.model, list(setup.model.device.active)
    q, qd, qdd = (x[:, active].T for x in (found.q, found.qd, found.qdd))
    tau = haptid.inverse_dynamics(model, model.base.of(setup.chi), q, qd, qdd).T
    eps, jacobian = 1e-6, np.empty((len(found), 3, 3))
    for k in range(3):
        ahead, behind = (handle(model, q + way * eps * np.eye(3)[:, k : k + 1]) for way in (1, -1))
        jacobian[:, :, k] = (ahead - behind) / (2 * eps)
    total = found.torque + np.einsum("nik,ni->nk", jacobian, found.hand)
    moving = (np.abs(found.qd) > 0.05).all(axis=1)
    pushed = moving & (np.abs(found.hand).max(axis=1) > 0.1)
    assert pushed.sum() > 100
    np.testing.assert_allclose(total[moving], tau[moving], atol=1e-4 * np.abs(tau).max())
    assert np.abs(found.torque - tau)[pushed].max() > 0.05
    np.testing.assert_allclose(
        np.linalg.norm(found.wrench[:, :3], axis=1), np.linalg.norm(found.hand, axis=1), atol=1e-12
    )


def handle(model, qa):
    from haptid.device import poses

    at = poses(model.device, (model.device.closure.G @ qa + model.device.closure.offset[:, None]).T)[
        :, model.device.handle.link
    ]
    return at[:, :3, :3] @ model.device.handle.translation + at[:, :3, 3]


def test_encoders_have_steps_and_velocity_is_their_filtered_difference():
    encoders = bench.Encoders((4000.0,), gear=(13.3, 11.2, 11.2))
    setup, found = made(seconds=2.0, encoders=encoders)
    steps = 2 * np.pi / (4000 * np.array([13.3, 11.2, 11.2]))
    counts = found.position / steps
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    exact = found.q[:, list(setup.model.device.active)]
    assert (np.abs(found.position - exact).max(axis=0) <= 0.500001 * steps).all()
    keep, velocity = np.exp(-2 * np.pi * 100 * found.dt), np.zeros(3)
    for before, here, shown in zip(found.position[:-1], found.position[1:], found.velocity[1:], strict=True):
        velocity = keep * velocity + (1 - keep) * (here - before) / found.dt
        np.testing.assert_allclose(shown, velocity, atol=1e-9)


def test_amplifiers_have_gain_delay_noise_and_saturation():
    amplifiers = bench.Amplifiers(gain=(1.02, 0.97, 1.0), delay=1.3e-3)
    setup, found = made(seconds=2.0, amplifiers=amplifiers)
    asked = found.command * [drive.torque_constant for drive in setup.model.device.motors]
    # 1.3 ms late: at the beginning of a period the command of two periods before still acts.
    np.testing.assert_allclose(found.torque[2:], [1.02, 0.97, 1.0] * asked[:-2], rtol=1e-12, atol=1e-15)
    _, noisy = made(seconds=2.0, amplifiers=bench.Amplifiers(noise=(2e-3,)))
    rough = noisy.torque - noisy.command / 2.73
    assert rough.std() == pytest.approx(2e-3, rel=of_deviation(rough.size))
    _, held = made(seconds=2.0, amplifiers=bench.Amplifiers(saturation=(0.08,)))
    assert np.abs(held.command).max() <= 0.08 * 2.73 + 1e-12


def test_gravity_feed_forward_and_integral_hold_better_than_pd():
    reach = {}
    for what, extra in (("pd", {}), ("gravity", {"gravity": True}), ("pid", {"ki": (20.0, 20.0, 10.0)})):
        controller = bench.Controller((8.0, 7.0, 3.0), (0.2, 0.15, 0.08), **extra)
        setup, found = made(seconds=2.0, still=True, controller=controller)
        reach[what] = np.abs(found.q[-1, list(setup.model.device.active)] - found.target[-1]).max()
    assert reach["gravity"] < 1e-6
    assert reach["pid"] < reach["pd"]


def test_payload_is_felt_by_the_motors():
    _, bare = made(seconds=2.0, still=True)
    _, laden = made(seconds=2.0, still=True, payload=bench.SimulatedPayload(0.05))
    arm, forearm = 0.215 * np.cos(0.2), 0.17 * np.sin(0.3)
    more = 0.05 * 9.81 * np.array([arm, forearm])
    friction = 0.02 / more.min()  # stiction may hold some of it
    np.testing.assert_allclose((laden.torque - bare.torque)[-1, 1:], more, rtol=friction)


def test_a_device_that_runs_away_is_an_error():
    with pytest.raises(errors.SimulationError) as raised:
        made(seconds=2.0, controller=bench.Controller((40.0, 35.0, 14.0), (500.0,), tracking_limit=1e9))
    joint, time = raised.value.where
    assert joint in ("ba", "be", "df", "a", "c")
    assert time < 2.0
    assert not abs(raised.value.found) <= raised.value.limit  # NaN too


def test_a_device_that_does_not_follow_is_an_error():
    with pytest.raises(errors.SimulationError) as raised:
        made(seconds=2.0, controller=bench.Controller((0.01,), (0.001,), tracking_limit=0.1))
    assert raised.value.where[0] in ("be", "df")


def test_a_joint_at_its_stop_is_an_error():
    push = bench.Push((60.0, 0.0, 0.0), start=0.1)
    with pytest.raises(errors.SimulationError) as raised:
        made(seconds=2.0, hand=(push,), still=True, controller=bench.Controller((4.0,), (0.2,), tracking_limit=3.0))
    assert raised.value.limit[0] < raised.value.limit[1]


def test_a_loop_that_opens_is_an_error(monkeypatch):
    monkeypatch.setattr("haptid.experiment.bench.simulation.WIDEST_GAP", 1e-13)
    with pytest.raises(errors.SimulationError) as raised:
        made(seconds=2.0)
    assert raised.value.found > raised.value.limit == 1e-13


def test_periods_are_whole_numbers_of_steps():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    chi = true_parameters(model)
    with pytest.raises(errors.ExperimentError) as raised:
        bench.Setup(model, chi, bench.Controller((1.0,), (1.0,), rate_hz=3000.0))
    assert raised.value.where == "the control period"
    with pytest.raises(errors.ExperimentError) as raised:
        bench.Setup(model, chi, bench.Controller((1.0,), (1.0,)), amplifiers=bench.Amplifiers(delay=1.5e-5))
    assert raised.value.where == "the delay"


def test_a_hand_needs_a_handle():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        bench.Setup(model, np.ones(4), bench.Controller((1.0,), (1.0,)), hand=(bench.Push((1.0, 0, 0)),))
    assert raised.value.where == "hand"


def test_without_mujoco_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(errors.MissingDependencyError) as raised:
        made(seconds=2.0)
    assert raised.value.where == "mujoco"
