"""The sampled loop: closed forms of one degree of freedom, and a device that is stepped through time."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import linalg

import haptid
from haptid import errors
from haptid.end_effector.characterisation import GivenParameters, apparent_mass
from haptid.end_effector.compensation import (
    STIFF_HAND,
    TYPICAL_HAND,
    Compensation,
    Feedback,
    HandModel,
    HandMotion,
    SampledLoop,
    design_compensation,
    filtered_difference,
    published_hands,
)
from haptid.inference.targets import target_map
from true_parameters import true_parameters

T, ONE = 1e-3, np.eye(1)
POSES = np.array([(0.0, 0.2, 0.3), (0.1, 0.7, 0.9)]).T


def wall(mass=0.1, b=0.5, K=800.0, D=0.0, delay=0.0):
    """A mass with physical damping at a virtual spring and damper."""
    parts = (Feedback(K * ONE, (1.0,)), Feedback(D * ONE, (1 / T, -1 / T)))
    return SampledLoop(mass * ONE, b * ONE, 0 * ONE, ONE, parts, T, delay)


def mass_law(mass, share, cutoffs, b=0.0, damping=0.0, delay=0.0):
    """Mass feedforward and damping injection of one degree of freedom."""
    (top, bottom), (up, down) = (filtered_difference(cutoff, T) for cutoff in cutoffs)
    parts = [Feedback(-share * mass * ONE, tuple(np.convolve(top, up)), tuple(np.convolve(bottom, down)))]
    parts.append(Feedback(damping * ONE, tuple(top), tuple(bottom)))
    return SampledLoop(mass * ONE, b * ONE, 0 * ONE, ONE, tuple(parts), T, delay)


@pytest.mark.parametrize(("K", "D"), [(0.0, 0.3), (500.0, 0.0), (500.0, 0.3), (2000.0, -0.2)])
def test_a_wall_is_passive_where_colgate_and_schenkel_say(K, D):
    """b > K T / 2 + |D|; for D < 0 the worst frequency is zero, for D > 0 that of Nyquist."""
    limit = K * T / 2 + abs(D)
    assert wall(b=1.02 * limit, K=K, D=D).passive
    assert not wall(b=0.98 * limit, K=K, D=D).passive
    assert wall(b=0.0, K=K, D=D).missing_damping().max() == pytest.approx(limit, rel=1e-3)


def test_a_delay_lowers_the_stiffness_of_a_passive_wall():
    """b > K (T / 2 + delay), of the lowest frequencies."""
    for delay in (0.4e-3, 1e-3, 2.7e-3):
        assert wall(b=0.0, delay=delay).missing_damping().max() == pytest.approx(800 * (T / 2 + delay), rel=1e-3)


def test_filtered_mass_feedforward_takes_damping_of_mass_over_the_time_constant():
    """Fast sampling, one filter: share m / t; two of them: share m / (t1 + t2)."""
    share, mass, cutoff = 0.5, 0.7, 5.0
    t = 1 / (2 * np.pi * cutoff)
    one = mass_law(mass, share, (cutoff, 1e9)).missing_damping().max()
    assert one == pytest.approx(share * mass / t, rel=0.03)
    both = mass_law(mass, share, (cutoff, 2 * cutoff)).missing_damping().max()
    assert both == pytest.approx(share * mass / (1.5 * t), rel=0.1)


def test_felt_mass_is_the_share_that_is_left_and_late_feedback_is_negative_damping():
    mass, share, f = 0.7, 0.6, np.array([1.0, 4.0])
    loop = mass_law(mass, share, (100.0, 60.0))
    law = 2 * np.pi * f
    Z = loop.impedance(f)[:, 0, 0]
    pole = [np.exp(-2 * np.pi * c * T) for c in (100.0, 60.0)]
    lag = 3 * T / 2 + sum(T * p / (1 - p) for p in pole)
    np.testing.assert_allclose(Z.imag / law, mass * (1 - share), rtol=0.06)
    np.testing.assert_allclose(Z.real, -share * mass * law**2 * lag, rtol=0.06)


@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1e-3, 2.6e-3])
@pytest.mark.parametrize("held", [True, False], ids=["held", "free"])
def test_eigenvalues_are_those_of_a_device_that_is_stepped(delay, held):
    """Plant by a matrix exponential of a twentieth of a period, controller by its difference equations."""
    mass, b, share, D, cutoffs = 0.3, 0.2, 0.5, 3.0, (80.0, 40.0)
    hand = HandModel(0.1, 5.0, 200.0, 1.0, 500.0) if held else None
    loop = mass_law(mass, share, cutoffs, b, D, delay)
    M, B, K = np.diag([mass, 0.1]), np.zeros((2, 2)), np.zeros((2, 2))
    B[0, 0] = b
    if held:
        link = np.array([[1.0, -1.0], [-1.0, 1.0]])
        B, K = B + 1.0 * link + np.diag([0, 5.0]), 500.0 * link + np.diag([0, 200.0])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, B)]])
    parts = 20
    step = linalg.expm(np.block([[A, np.array([[0, 0, 1 / mass, 0]]).T], [np.zeros((1, 5))]]) * T / parts)
    pv, pm = (np.exp(-2 * np.pi * c * T) for c in cutoffs)
    x, last, v, p, line = np.array([0.0, 0.0, 1.0, 0.0]), None, 0.0, 0.0, [0.0] * 8
    late, sizes = round(delay / T * parts), []
    for _ in range(4000):
        if last is not None:
            v = pv * v + (1 - pv) * (x[0] - last) / T
        last = x[0]
        rate = (1 - pm) / T * (mass * v - p)
        p += T * rate
        line = [share * rate - D * v, *line[:-1]]
        for part in range(parts):
            x = (step @ [*x, line[(late - part - 1) // parts + 1 if late > part else 0]])[:4]
        sizes.append(np.linalg.norm(x[2:] if not held else x))
    late = slice(1500, 4000) if held else slice(200, 500)  # a free device is soon at rest
    growth = np.exp(np.polyfit(np.arange(4000)[late], np.log(sizes[late]), 1)[0])
    assert loop.spectral_radius(hand) == pytest.approx(growth, abs=5e-5 if held else 3e-4)


def test_a_driven_device_takes_the_power_of_its_impedance():
    """Mean power of a sine force, by the stepped device: F^2 Re(1 / Z) / 2; negative: the hand gets it."""
    mass, share, cutoffs, f, b = 0.7, 0.5, (100.0, 60.0), 5.0, 6.0
    loop = mass_law(mass, share, cutoffs, b)
    parts, n = 10, 4000
    step = linalg.expm(np.array([[0, 1, 0], [0, -b / mass, 1 / mass], [0, 0, 0]]) * T / parts)
    pv, pm = (np.exp(-2 * np.pi * c * T) for c in cutoffs)
    x, last, v, p, power = np.zeros(2), 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        v, last = pv * v + (1 - pv) * (x[0] - last) / T, x[0]
        rate = (1 - pm) / T * (mass * v - p)
        p += T * rate
        for part in range(parts):
            force = np.cos(2 * np.pi * f * (k + (part + 0.5) / parts) * T)
            before, x = x[1], (step @ [*x, share * rate + force])[:2]
            power += force * (before + x[1]) / 2 * (k >= n // 2) / parts
    Z = loop.impedance(np.array([f]))[0, 0, 0]
    assert Z.real < b - 1
    assert power / (n // 2) == pytest.approx((1 / Z).real / 2, rel=0.01)


@pytest.fixture(scope="module")
def law():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return Compensation(GivenParameters(model, model.base.of(true_parameters(model))))


def test_the_loop_of_a_law_is_its_masses_friction_and_gravity(law):
    """Against the characterisation, by other ways: mass, and the stiffness that gravity has without compensation."""
    identified, q = law.identified, POSES[:, 0]
    masses = apparent_mass(identified, POSES[:, :1]).mass.values[0]
    f = np.array([3.0])
    for share in (0.0, 0.5):
        loop = Compensation(identified, share).loop(q, T)
        mobile = 1 - share * Compensation(identified, share).passed(3.0, T).real
        felt = np.linalg.eigvalsh(loop.impedance(f)[0].imag)[::-1] / (2 * np.pi * f)
        np.testing.assert_allclose(felt, mobile * masses, rtol=0.02)
    heavy = Compensation(identified, 0.0, weight=0.0).loop(q, T)
    # Gravity torques pi_7 cos(q2) and pi_8 sin(q3), pi_7 and pi_8 of the device's own targets.
    model = identified.model
    names = [target.name for target in model.device.targets]
    value = dict(zip(names, target_map(model) @ identified.beta, strict=True))
    wanted = np.diag([0.0, -value["pi_7"] * np.sin(q[1]), value["pi_8"] * np.cos(q[2])])
    np.testing.assert_allclose(heavy.stiffness, wanted, atol=1e-8)


def test_the_search_finds_what_it_promises(law):
    """Every verdict is that of the loop itself; more damping than the least is quiet too, less is not."""
    hands = (STIFF_HAND, TYPICAL_HAND, None)
    few = {"velocity_cutoffs_hz": (100.0,), "momentum_cutoffs_hz": (20.0, 60.0), "shares": (0.4, 0.7)}
    found = design_compensation(law, POSES, T, hands=hands, **few)
    assert {point.stable for point in found.points} == {True, False}
    for point in found.points:
        loops = [point.law.loop(q, T) for q in POSES.T]
        assert point.passive == all(loop.passive for loop in loops)
        assert point.stable == all(loop.stable(hands) for loop in loops)
    best = found.best(0.3)
    assert best is not None
    assert best.reduction >= 0.3
    assert best.stable
    assert best.quiet
    front = found.front("stable", "quiet")
    assert best in front
    assert all(a.reduction < b.reduction and a.added_damping < b.added_damping for a, b in pairwise(front))
    assert 0 < max(point.reduction for point in found.front("passive")) < 0.05
    assert found.required(0.3, "stable", "quiet") is best
    with pytest.raises(errors.SettingError, match=r"no point that is passive takes away 30 % .* N s/m") as raised:
        found.required(0.3, "passive")
    assert 0 < raised.value.limit < 0.05 < raised.value.found


def test_the_published_hands_are_the_corners_of_their_range():
    hands = published_hands()
    assert len(hands) == 32
    assert STIFF_HAND in hands
    low, high = min(hands, key=lambda h: h.mass), max(hands, key=lambda h: h.mass)
    assert low.mass < TYPICAL_HAND.mass < high.mass


def test_settings_that_mean_nothing(law):
    for name, make in {
        "mass": lambda: HandModel(0.0, 1.0, 1.0, 1.0, 1.0),
        "damping": lambda: HandModel(1.0, -1.0, 1.0, 1.0, 1.0),
        "speed": lambda: HandMotion(speed=0.0),
        "dt": lambda: SampledLoop(ONE, ONE, ONE, ONE, (), 0.0),
        "delay": lambda: SampledLoop(ONE, ONE, ONE, ONE, (), T, -1.0),
        "felt_hz": lambda: design_compensation(law, POSES, T, felt_hz=600.0),
        "friction_kept": lambda: design_compensation(law, POSES, T, friction_kept=2.0),
        "poses": lambda: design_compensation(law, np.array([[0.0], [0.2], [0.2 + np.pi / 2]]), T),
    }.items():
        with pytest.raises(errors.SettingError) as raised:
            make()
        assert raised.value.where == name
