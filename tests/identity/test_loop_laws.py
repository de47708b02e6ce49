"""Laws of loops that are not linear: closure, rates, energy, momentum, and linear loops by the general method."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from closed_devices import NAMES, bodies, path, poses
from haptid import _core
from haptid.device.loops.chain import Chain
from haptid.device.loops.linear import ClosureProblem
from haptid.device.loops.newton import newton_closure
from haptid.device.toml.errors_at import Place
from haptid.dynamics.inverse import (
    bias_torque,
    core_momentum,
    core_torque,
    gravity_torque,
    mass_matrix,
    raw_parameters,
    rigid,
)
from haptid.dynamics.kinematics import handle_motion, link_poses
from haptid.dynamics.model import mechanism_arguments


@pytest.fixture(scope="module", params=NAMES)
def model(request):
    return haptid.DynamicModel(haptid.read_device(request.param))


def test_loops_close_all_along_a_motion_and_nothing_jumps(model):
    q, _, _ = path(model, 2.0, 1e-3)
    tree = model.device.closure.positions(q)
    gaps, _ = model.device.closure.chain.residual(tree.T)
    assert np.abs(gaps).max() < 1e-12
    assert np.abs(np.diff(tree, axis=1)).max() < 0.1
    np.testing.assert_array_equal(tree[list(model.device.active)], q)


def test_poses_do_not_depend_on_the_way_they_are_requested(model):
    q, _, _ = path(model, 1.0, 1e-2)
    order = np.random.default_rng(0).permutation(q.shape[1])
    tree = model.device.closure.positions(q)
    np.testing.assert_allclose(model.device.closure.positions(q[:, order]), tree[:, order], atol=1e-13)
    for k in (0, 50, 99):
        np.testing.assert_allclose(model.device.closure.positions(q[:, k : k + 1])[:, 0], tree[:, k], atol=1e-13)


def test_rates_and_their_changes_are_derivatives(model):
    qa, qda, qdda = poses(model, 30)
    h, found = 1e-5, model.device.closure.follow(qa, qda)
    q, qd, qdd = model.tree(qa, qda, qdda)
    np.testing.assert_array_equal(q, found.q)
    shifted = [model.tree(qa + s * qda + s**2 / 2 * qdda, qda + s * qdda, qdda) for s in (h, -h)]
    ahead, behind = (model.device.closure.follow(qa + s * qda, qda) for s in (h, -h))
    for made, slope in (
        (qd, (shifted[0][0] - shifted[1][0]) / (2 * h)),
        (qdd, (shifted[0][1] - shifted[1][1]) / (2 * h)),
        (found.Gd, (ahead.G - behind.G) / (2 * h)),
    ):
        np.testing.assert_allclose(made, slope, atol=1e-7 * np.abs(made).max())
    for a in range(len(model.device.active)):
        step = 1e-6 * np.eye(len(model.device.active))[:, a : a + 1]
        slope = (model.device.closure.positions(qa + step) - model.device.closure.positions(qa - step)) / 2e-6
        np.testing.assert_allclose(found.G[:, :, a].T, slope, atol=1e-8 * max(1.0, np.abs(found.G).max()))


def test_the_mass_matrix_is_the_energys_and_velocity_torques_take_no_power(model):
    """qd' (dM/dt - 2 C) qd = 0."""
    qa, qda, _ = poses(model, 20)
    beta, h = model.base.of(bodies(model)), 1e-5
    M = mass_matrix(model, beta, qa)
    assert np.linalg.eigvalsh(M).min() > 0
    dM = (mass_matrix(model, beta, qa + h * qda) - mass_matrix(model, beta, qa - h * qda)) / (2 * h)
    power = 0.5 * np.einsum("as,sab,bs->s", qda, dM, qda)
    velocity = bias_torque(model, beta, qa, qda) - gravity_torque(model, beta, qa)
    np.testing.assert_allclose((qda * velocity).sum(axis=0), power, atol=1e-6 * np.abs(power).max())


def test_gravity_torque_is_the_slope_of_the_height(model):
    qa, _, _ = poses(model, 10)
    chi, raw = bodies(model), model.device.parameters.S @ bodies(model)

    def potential(positions):
        at = link_poses(model, positions)
        moments = raw[: 10 * len(model.device.joints)].reshape(-1, 10)[:, 6:]
        turned = np.einsum("sjik,jk->si", at[:, :, :3, :3], moments[:, :3])
        first = turned + np.einsum("sji,j->si", at[:, :, :3, 3], moments[:, 3])
        return -first @ model.device.gravity

    h = 1e-5
    steps = h * np.eye(len(model.device.active))
    slope = [(potential(qa + s[:, None]) - potential(qa - s[:, None])) / (2 * h) for s in steps]
    found = gravity_torque(model, model.base.of(chi), qa)
    np.testing.assert_allclose(found, slope, atol=1e-7 * np.abs(found).max())


def test_torque_is_the_change_of_momentum_and_the_rest(model):
    """With rotors and friction, on passive joints too."""
    qa, qda, qdda = poses(model, 20)
    chi = raw_parameters(model, model.base.of(bodies(model)))
    h = 1e-5

    def momentum(s):
        return core_momentum(model, chi, qa + s * qda + s**2 / 2 * qdda, qda + s * qdda)

    p_dot = (momentum(h)[0] - momentum(-h)[0]) / (2 * h)
    wanted = core_torque(model, chi, qa, qda, qdda)
    np.testing.assert_allclose(p_dot + momentum(0.0)[1], wanted, atol=1e-6 * np.abs(wanted).max())
    M = mass_matrix(model, model.base.of(bodies(model)), qa)
    p, _ = core_momentum(model, rigid(model, chi), qa, qda)
    np.testing.assert_allclose(p, np.einsum("sab,bs->as", M, qda), atol=1e-10 * np.abs(p).max())


PASSIVE_ROTOR = """
[[terms]]
kind = "rotor-inertia"
joints = ["{0}"]
prefix = "IB"
[[terms]]
kind = "spring"
joints = ["{0}"]
"""


@pytest.mark.parametrize(("name", "joint"), [("four_bar", "rocker"), ("slider_crank", "slide"), ("five_bar", "4")])
def test_terms_on_passive_joints_act_through_their_rates(tmp_path, name, joint):
    text = (Path(haptid.__file__).parent / "device/library" / f"{name}.toml").read_text() + PASSIVE_ROTOR.format(joint)
    (tmp_path / "more.toml").write_text(text)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "more.toml"))
    qa, qda, qdda = poses(model, 12)
    q, _, qdd = model.tree(qa, qda, qdda)
    j, G = model.device.joint_names.index(joint), model.device.closure.follow(qa).G
    names = [term.name for term in model.terms]
    for term, moved in ((f"IB{joint}", qdd[j]), (f"K{joint}", q[j])):
        chi = np.zeros(len(model.device.parameters.raw))
        chi[10 * len(model.device.joints) + names.index(term)] = 2.0
        wanted = 2.0 * G[:, j].T * moved
        np.testing.assert_allclose(core_torque(model, chi, qa, qda, qdda), wanted, atol=1e-12)
        if term.startswith("IB"):
            h = 1e-5
            p = [core_momentum(model, chi, qa + s * qda + s**2 / 2 * qdda, qda + s * qdda)[0] for s in (h, -h)]
            rest = core_momentum(model, chi, qa, qda)[1]
            np.testing.assert_allclose((p[0] - p[1]) / (2 * h) + rest, wanted, atol=1e-6 * np.abs(wanted).max())


def test_the_handles_jacobian_is_its_derivative(model):
    qa, _, _ = poses(model, 10)
    made, h = handle_motion(model, qa), 1e-6
    for a in range(len(model.device.active)):
        step = h * np.eye(len(model.device.active))[:, a : a + 1]
        slope = (handle_motion(model, qa + step).position - handle_motion(model, qa - step).position) / (2 * h)
        np.testing.assert_allclose(made.jacobian[:, :3, a], slope, atol=1e-8)


def test_the_platform_of_a_delta_only_translates():
    model = haptid.DynamicModel(haptid.read_device("delta"))
    qa, _, _ = poses(model, 40)
    made = handle_motion(model, qa)
    np.testing.assert_allclose(made.rotation, np.broadcast_to(made.rotation[0], made.rotation.shape), atol=1e-12)
    np.testing.assert_allclose(made.jacobian[:, 3:], 0, atol=1e-12)
    at = made.position
    for k in range(3):  # each leg's rods keep their length
        turn = 2 * np.pi * k / 3
        radial = np.array([np.cos(turn), np.sin(turn), 0])
        elbow = (0.04 + 0.06 * np.cos(qa[k]))[:, None] * radial - 0.06 * np.sin(qa[k])[:, None] * [0, 0, 1]
        np.testing.assert_allclose(np.linalg.norm(at + 0.02 * radial - elbow, axis=1), 0.1, atol=1e-12)


def test_all_instruction_sets_agree(model):
    qa, qda, qdda = poses(model, 21)
    given, loops = mechanism_arguments(model), model.loops(qa, qda)
    none, columns = np.zeros((0, 21)), list(range(model.mechanism.columns))
    made = [
        _core.Mechanism(*given._replace(backend=name)).regressor(qa, qda, qdda, none, columns, loops)
        for name in _core.backends()
    ]
    for other in made[1:]:
        np.testing.assert_allclose(other, made[0], atol=1e-12 * np.abs(made[0]).max())


def test_the_core_rejects_loops_of_another_size():
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    qa, qda, qdda = poses(model, 5)
    for loops in (None, model.loops(qa, qda)[:-1]):
        with pytest.raises(ValueError, match="loops"):
            model.mechanism.regressor(qa, qda, qdda, np.zeros((0, 5)), [0], loops)


PARALLELOGRAM = """
name = "parallelogram"
gravity = [1.0, -9.81, 2.0]
[base]
rpy = [0.3, -0.2, 0.5]
[[joints]]
name = "yaw"
alpha = "-pi/2"
[[joints]]
name = "arm"
alpha = "pi/2"
[[joints]]
name = "lever"
parent = "yaw"
alpha = "pi/2"
[[joints]]
name = "forearm"
parent = "arm"
d = {arm!r}
[[joints]]
name = "coupler"
parent = "lever"
d = {lever!r}
[[loops]]
passive = ["forearm", "coupler"]
cut = {{ body_a = "coupler", frame_a = {{ d = {arm!r} }}, body_b = "forearm", frame_b = {{ d = {lever!r} }} }}
[handle]
link = "forearm"
xyz = [0.1, 0.02, 0.03]
"""


@settings(max_examples=8, deadline=None)
@given(st.floats(0.1, 1.0), st.floats(0.1, 1.0), st.integers(0, 1000))
def test_linear_loops_by_the_general_road_are_the_same(tmp_path_factory, arm, lever, seed):
    file = tmp_path_factory.mktemp("p") / "loop.toml"
    file.write_text(PARALLELOGRAM.format(arm=arm, lever=lever))
    linear = haptid.DynamicModel(haptid.read_device(file))
    rng, at = np.random.default_rng(seed), np.array([0.0, 0.2, 1.5])
    chain = Chain.of(linear.device.joints, linear.device.closure.cuts, linear.device.active)
    guess = dict(zip((3, 4), (linear.device.closure.G @ at + linear.device.closure.offset)[3:], strict=True))
    G, offset = linear.device.closure.G, linear.device.closure.offset
    made = newton_closure(ClosureProblem(chain, G, offset, [3, 4], guess, at), {}, Place("here"))
    general = haptid.DynamicModel(replace(linear.device, closure=made))
    np.testing.assert_array_equal(general.device.varying, [[0, 0, 0]] * 3 + [[0, 1, 1]] * 2)
    qa = np.array([rng.uniform(-3, 3, 20), rng.uniform(-0.4, 0.4, 20), rng.uniform(1.0, 2.0, 20)])
    qda, qdda = rng.uniform(-2, 2, (2, 3, 20))
    found = made.follow(qa, qda)
    np.testing.assert_allclose(found.q, linear.device.closure.positions(qa), atol=1e-12)
    np.testing.assert_allclose(found.G, np.broadcast_to(linear.device.closure.G, found.G.shape), atol=1e-12)
    np.testing.assert_allclose(found.Gd, 0, atol=1e-12 * np.abs(qda).max())
    columns, none = list(range(50)), np.zeros((0, 20))
    Y = [d.mechanism.regressor(qa, qda, qdda, none, columns, d.loops(qa, qda)) for d in (linear, general)]
    np.testing.assert_allclose(Y[1], Y[0], atol=1e-12 * np.abs(Y[0]).max())
    P = [d.mechanism.momentum_regressor(qa, qda, none, columns, d.loops(qa, qda)) for d in (linear, general)]
    np.testing.assert_allclose(P[1], P[0], atol=1e-12 * np.abs(P[0]).max())
    assert general.base.names == linear.base.names
    J = [handle_motion(d, qa).jacobian for d in (linear, general)]
    np.testing.assert_allclose(J[1], J[0], atol=1e-12)
