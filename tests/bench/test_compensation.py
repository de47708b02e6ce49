"""Compensation on the bench: a hand that shakes the handle, and the share at which the loop gets unstable."""

from importlib.resources import files

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import GivenParameters, apparent_mass, characterise
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration
from haptid.end_effector.compensation import (
    STIFF_HAND,
    TYPICAL_HAND,
    Compensation,
    InverseDynamics,
    judge_law,
    stable_share,
)
from haptid.experiment import bench
from true_parameters import true_parameters

pytest.importorskip("mujoco", reason="MuJoCo has no wheel for this platform")
SHAKEN_HZ, SECONDS, DT = 4.0, 1.0, 1e-3
POSES = ((0.0, 0.2, 0.3), (0.1, 0.7, 0.9), (-0.2, -0.3, 0.0))
# Two steps of the simulator in a control period.
PHYSICS = bench.Physics(5e-4)
OFF = bench.Controller((0.0,), (0.0,), tracking_limit=1.0)


def rest(pose, seconds=SECONDS):
    """A planned motion that stays where it is."""
    q = np.tile(pose, (round(seconds / DT), 1))
    return bench.Trajectory(DT, q, np.zeros_like(q), np.zeros_like(q))


def smooth(model):
    """True parameters without friction, so that what a hand feels is mass alone."""
    return true_parameters(model, FV=1e-6, FC=0.0)


def shake(model, chi, pose, law, direction, newtons=0.05):
    """Force of the hand, acceleration and velocity of the handle along a direction, (samples, 3), from 0.5 s on."""
    # A cosine: the handle goes to and fro about where it is.
    push = bench.Push(tuple(newtons * direction), SHAKEN_HZ, start=-0.25 / SHAKEN_HZ)
    setup = bench.Setup(model, chi, OFF, hand=(push,), law=law, physics=PHYSICS)
    found = bench.simulate(setup, rest(pose), np.random.default_rng(0))
    qa, qda, qdda = (x[500:, list(model.device.active)].T for x in (found.q, found.qd, found.qdd))
    J = handle_motion(model, qa).jacobian[:, :3]
    a = np.einsum("pij,jp->pi", J, qdda) + velocity_product_acceleration(model, qa, qda)[:, :3]
    v = np.einsum("pij,jp->pi", J, qda)
    return np.column_stack([x @ direction for x in (found.hand[500:], a, v)])


def shaken(model, chi, pose, law, direction):
    """Mass along a direction."""
    force, a, v = shake(model, chi, pose, law, direction).T
    return np.linalg.lstsq(np.column_stack([a, v, np.ones(len(a))]), force, rcond=None)[0][0]


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def test_the_hand_feels_the_share_that_is_left(model):
    """At three poses; and the masses differ less from pose to pose, by the same share."""
    chi = smooth(model)
    identified = GivenParameters(model, model.base.of(chi))
    law = Compensation(identified, share=0.6)
    left = 1 - 0.6 * law.passed(SHAKEN_HZ, DT).real
    bare, compensated = [], []
    for pose in POSES:
        felt = apparent_mass(identified, np.array(pose)[:, None])
        direction = felt.directions[0, 0]
        none = shaken(model, chi, pose, Compensation(identified, share=0.0), direction)
        some = shaken(model, chi, pose, law, direction)
        np.testing.assert_allclose(none, felt.mass.values[0, 0], rtol=0.02)
        np.testing.assert_allclose(some, left * none, rtol=0.03)
        bare.append(none)
        compensated.append(some)
    assert left < 0.45
    np.testing.assert_allclose(np.ptp(compensated), left * np.ptp(bare), rtol=0.1)


def test_towards_one_mass_the_hand_feels_it_at_every_pose(model):
    chi = smooth(model)
    identified = GivenParameters(model, model.base.of(chi))
    felt = apparent_mass(identified, np.transpose(POSES))
    masses = felt.mass.values[:, 0]
    target = 0.5 * masses.min()
    law = Compensation(identified, share=0.9, towards=target)
    made = [shaken(model, chi, pose, law, d) for pose, d in zip(POSES, felt.directions[:, 0], strict=True)]
    late = law.passed(SHAKEN_HZ, DT).real
    np.testing.assert_allclose(made, masses - late * (masses - target), rtol=0.05)
    assert masses.max() / masses.min() > 1.1
    assert max(made) / min(made) < 1 + 0.4 * (masses.max() / masses.min() - 1)


def test_the_share_of_a_pose_brings_its_mass_to_the_one_that_is_requested(model):
    """Between none, where the mass is less already, and the most that is set; where it is beyond measure, the most."""
    identified = GivenParameters(model, model.base.of(smooth(model)))
    qa = np.column_stack([*POSES, (0.0, 0.2, 0.2 + np.pi / 2)])
    masses = apparent_mass(identified, qa).mass.values[:, 0]
    assert np.isnan(masses[-1])
    target = 0.7 * masses[0]
    share = Compensation(identified, share=0.99, towards=target).share_at(qa)
    np.testing.assert_allclose((1 - share[:-1]) * masses[:-1], np.minimum(target, masses[:-1]))
    assert share[-1] == 0.99
    assert (Compensation(identified, share=0.1, towards=target).share_at(qa) <= 0.1).all()
    assert (Compensation(identified, share=0.9, towards=10.0).share_at(qa[:, :-1]) == 0).all()
    assert (Compensation(identified, share=0.4).share_at(qa) == 0.4).all()


def test_weight_is_carried(model):
    """Without a hand nothing moves; without the law the device falls."""
    chi = smooth(model)
    identified = GivenParameters(model, model.base.of(chi))
    for law, far in ((Compensation(identified, share=0.5), False), (None, True)):
        setup = bench.Setup(model, chi, OFF, law=law)
        found = bench.simulate(setup, rest(POSES[0], 0.15), np.random.default_rng(0))
        moved = np.abs(found.q[-1] - found.q[0]).max()
        assert (moved > 1e-2) if far else (moved < 1e-6)


def test_friction_is_taken_off(model):
    """What the hand feels of dry friction in motion falls by the share."""
    chi = true_parameters(model, FV=1e-6)
    identified = GivenParameters(model, model.base.of(chi))
    c = characterise(identified, np.array(POSES[0])[:, None])
    direction = c.masses.directions[0, 0]
    dry = float(c.coulomb_friction(direction).values[0] @ direction)
    for share in (0.0, 0.7):
        law = Compensation(identified, share=0.0, friction=share, slow=0.005)
        found = shake(model, chi, POSES[0], law, direction, newtons=2 * dry + 0.1)
        force, a, v = found.T
        fast = np.abs(v) > 0.5 * np.abs(v).max()
        columns = np.column_stack([a, np.sign(v)])[fast]
        np.testing.assert_allclose(np.linalg.lstsq(columns, force[fast], rcond=None)[0][1], (1 - share) * dry, rtol=0.1)


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """The device, and the same with springs on its motors: a hand that holds it with stiffness and damping."""
    text = (files("haptid") / "device/library" / "phantom_premium_15.toml").read_text(encoding="utf-8")
    springs = '[[terms]]\nkind = "spring"\nmotors = "all"\nprefix = "K"\n\n[handle]'
    path = tmp_path_factory.mktemp("held") / "held.toml"
    path.write_text(text.replace("[handle]", springs, 1), encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))


STIFFNESS, DAMPING = 2.0, 0.012


def ends(held, law):
    """Greatest distance from rest at the beginning and at the end, after a short push."""
    chi = true_parameters(held, FV=DAMPING, FC=0.0)
    for k, kind in enumerate(held.device.parameters.kinds):
        if kind[0] == "K":
            chi[k] = STIFFNESS
    setup = bench.Setup(held, chi, OFF, hand=(bench.Push((0.3, 0.3, 0.3), stop=0.05),), law=law, physics=PHYSICS)
    found = bench.simulate(setup, rest((0.0, 0.0, 0.0), 2.0), np.random.default_rng(0))
    away = np.abs(found.q - found.q[0]).max(axis=1)
    return away[:500].max(), away[-500:].max()


@pytest.mark.parametrize("even", [False, True], ids=["one share", "towards a mass"])
def test_below_the_bound_it_is_stable_and_above_it_is_not(model, held, even):
    identified = GivenParameters(model, model.base.of(smooth(model)))
    A = mass_matrix(model, identified.beta, np.zeros((3, 1)))[0]
    lag = Compensation(identified, 0.5).lag(DT)
    bound = stable_share(A, DAMPING * np.eye(3), STIFFNESS * np.eye(3), lag)
    assert 0.3 < bound < 0.8
    mass = float(apparent_mass(identified, np.zeros((3, 1))).mass.values[0, 0])

    def law(share):
        return Compensation(identified, 0.95, towards=(1 - share) * mass) if even else Compensation(identified, share)

    early, late = ends(held, law(0.9 * bound))
    assert late < early
    try:
        early, late = ends(held, law(1.15 * bound))
    except errors.SimulationError:
        return  # it ran away
    assert late > early


def test_a_hand_on_the_bench_gives_way_as_its_two_springs(model):
    """Under a constant push, in equilibrium: the grasp carries it, and so does the arm."""
    chi, hand = smooth(model), bench.GUIDE
    law = Compensation(GivenParameters(model, model.base.of(chi)), 0.0)
    push = np.array([0.5, -0.3, 0.4])
    setup = bench.Setup(
        model, chi, OFF, hand=(bench.Push(tuple(push)),), held=bench.Hand(hand), law=law, physics=PHYSICS
    )
    found = bench.simulate(setup, rest(POSES[0], 0.5), np.random.default_rng(0))
    position = handle_motion(model, found.q[[0, -1]][:, list(model.device.active)].T).position
    give = 1 / hand.grip_stiffness + 1 / hand.stiffness
    np.testing.assert_allclose(position[1] - position[0], push * give, rtol=0.01, atol=1e-7)
    np.testing.assert_allclose(found.hand[-1], 0, atol=0.005)  # the push, and the grasp against it


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_the_loop_says_which_law_a_stiff_hand_can_hold(model, damping):
    """Growth of the motion on the bench is the spectral radius; without friction, exact positions."""
    chi = smooth(model)
    law = Compensation(GivenParameters(model, model.base.of(chi)), 0.2, damping=damping)
    radius = law.loop(np.array(POSES[0]), DT).spectral_radius(STIFF_HAND)
    assert (radius < 1) == bool(damping)
    push = bench.Push((0.002, 0.002, 0.002), stop=0.02)
    setup = bench.Setup(model, chi, OFF, hand=(push,), held=bench.Hand(STIFF_HAND), law=law, physics=PHYSICS)
    found = bench.simulate(setup, rest(POSES[0], 0.6), np.random.default_rng(0))
    speed = np.linalg.norm(found.qd[:, list(model.device.active)], axis=1)
    early, late = (np.sqrt(np.mean(speed[part] ** 2)) for part in (slice(100, 200), slice(500, 600)))
    grown = (late / early) ** (1 / 400)
    assert grown == pytest.approx(radius, abs=2e-3)


@pytest.mark.parametrize("natural_hz", [5.0, 60.0])
def test_inverse_dynamics_in_a_stiff_hand(model, natural_hz):
    """Growth on the bench is the spectral radius; felt are the mass, 2 zeta w M and w^2 M where filters are fast."""
    chi = smooth(model)
    identified = GivenParameters(model, model.base.of(chi))
    law, pose = InverseDynamics(identified, natural_hz, velocity_cutoff_hz=100.0), np.array(POSES[0])
    radius = law.loop(pose, DT).spectral_radius(STIFF_HAND)
    push = bench.Push((0.02, 0.02, 0.02), stop=0.02)
    setup = bench.Setup(model, chi, OFF, hand=(push,), held=bench.Hand(STIFF_HAND), law=law, physics=PHYSICS)
    found = bench.simulate(setup, rest(POSES[0], 0.6), np.random.default_rng(0))
    speed = np.linalg.norm(found.qd[:, list(model.device.active)], axis=1)
    early, late = (np.sqrt(np.mean(speed[part] ** 2)) for part in (slice(100, 200), slice(500, 600)))
    assert (late / early) ** (1 / 400) == pytest.approx(radius, abs=6e-3)
    point = judge_law(law, pose[:, None], DT, hands=(STIFF_HAND, TYPICAL_HAND, None))
    assert point.stable == (point.spectral_radius < 1)
    w, mass = 2 * np.pi * natural_hz, apparent_mass(identified, pose[:, None]).mass.values[0].max()
    assert point.stiffness == pytest.approx(w**2 * mass, rel=1e-3)
    if natural_hz == 5.0:
        assert point.stable
        assert point.quiet
        assert not point.passive
        assert point.added_damping == pytest.approx(2 * w * mass, rel=0.02)


def test_inverse_dynamics_follows_a_plan(model):
    """With the true parameters and dry friction fed forward; without it friction over w^2 M is left."""
    chi = true_parameters(model)
    identified = GivenParameters(model, model.base.of(chi))
    t = np.arange(1000) * DT
    phase = 2 * np.pi * t
    q, qd, qdd = (
        np.outer(x, [0.2, 0.1, 0.15])
        for x in (1 - np.cos(phase), 2 * np.pi * np.sin(phase), 4 * np.pi**2 * np.cos(phase))
    )
    planned = bench.Trajectory(DT, q + POSES[0], qd, qdd)

    def missed(friction):
        def plan(t):
            k = min(round(t / DT), len(planned) - 1)
            return planned.q[k], planned.qd[k], planned.qdd[k]

        law = InverseDynamics(identified, 8.0, friction=friction, plan=plan)
        found = bench.simulate(
            bench.Setup(model, chi, OFF, law=law, physics=PHYSICS), planned, np.random.default_rng(0)
        )
        return np.abs(found.q[:, list(model.device.active)] - planned.q).max()

    assert missed(1.0) < 0.3 * missed(0.0)
    assert missed(1.0) < 0.01


def test_the_bound_by_hand():
    one = np.eye(1)
    assert stable_share(2 * one, 0.5 * one, 10 * one, 0.01) == pytest.approx(1 / 1.2)
    assert stable_share(2 * one, 0.5 * one, 10 * one, 0.01, hand=one) == pytest.approx(1.5 / 1.2)
    assert stable_share(one, 0 * one, 0 * one, 0.01) == 1.0
    assert stable_share(one, 0 * one, one, 0.01) == 0.0
    # The roots of the cubic: on the left below the bound, on the right above.
    a, b, k, T = 2.0, 0.5, 10.0, 0.01
    for share, stable in ((0.99 / 1.2, True), (1.01 / 1.2, False)):
        roots = np.roots([share * a * T, (1 - share) * a, b, k])
        assert (roots.real.max() < 0) == stable


def test_settings_that_mean_nothing(model):
    identified = GivenParameters(model, model.base.of(smooth(model)))
    for wrong in ({"share": 1.0}, {"share": -0.1}, {"weight": 1.1}, {"friction": np.nan}, {"slow": 0.0}):
        with pytest.raises(errors.SettingError) as raised:
            Compensation(identified, **wrong)
        assert raised.value.where == next(iter(wrong))
    with pytest.raises(errors.SettingError) as raised:
        Compensation(identified, towards=-1.0)
    assert raised.value.where == "towards"
    with pytest.raises(errors.SettingError) as raised:
        Compensation(identified, velocity_cutoff_hz=-1.0)
    assert raised.value.where == "velocity_cutoff_hz"
    with pytest.raises(errors.ShapeError):
        stable_share(np.eye(2), np.eye(1), np.eye(2), 0.01)
