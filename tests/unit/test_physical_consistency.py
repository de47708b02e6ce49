"""Physically consistent estimates: the conditions hold, no feasible parameters fit better, consistent fits stay."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import haptid
from haptid.errors import ConvergenceError, IdentifiabilityError, PhysicalConsistencyError, SettingError, ShapeError
from haptid.estimation import PhysicallyConsistent, feasible_parameters, project_to_feasible, pseudo_inertia
from haptid.estimation.feasibility import conic_program
from haptid.estimation.feasibility.cone import PSEUDO, UPPER, cone, never_negative
from haptid.estimation.feasibility.feasible import BORDER, FIT_PENALTY, interior, roomy
from haptid.report.tables import parameter_cells
from haptid.results.schema import ResultParameter
from mechanisms import draw, mechanisms
from motions import motion, truth
from random_devices import as_device, parameters
from true_parameters import true_parameters

# In the units in which each link's own mass and length are one.
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def observed(model, beta, **noise):
    return haptid.observe(model, motion(model, beta, seconds=8.0, dt=2e-3, **noise))


def metric(p: int, beta: np.ndarray, seed: int) -> np.ndarray:
    """A triangle in which every parameter weighs about the same."""
    rows = np.random.default_rng(seed).normal(size=(3 * p, p))
    return np.linalg.qr(rows / (np.abs(beta) + 1e-2 * np.abs(beta).max()))[1]


def test_the_pseudo_inertia_of_points_is_the_sum_of_their_squares():
    """P = sum m (x, y, z, 1)(x, y, z, 1)', whatever the points."""
    rng = np.random.default_rng(0)
    m, p = rng.uniform(0.1, 2.0, 5), rng.normal(size=(5, 3))
    J = sum(k * (x @ x * np.eye(3) - np.outer(x, x)) for k, x in zip(m, p, strict=True))
    chi = np.array([J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2], *(m @ p), m.sum()])
    ends = np.column_stack([p, np.ones(5)])
    np.testing.assert_allclose(pseudo_inertia(chi), ends.T * m @ ends, atol=1e-13)
    with pytest.raises(ShapeError):
        pseudo_inertia(chi[:9])


@settings(max_examples=30, deadline=None)
@given(mechanisms(7))
def test_what_bodies_have_is_possible(mechanism):
    """Parameters of drawn bodies, open or closed chains: possible, and so are the bodies that come back with them."""
    model = as_device(mechanism)
    beta = model.base.of(parameters(mechanism, model))
    found = feasible_parameters(model, beta)
    assert found.ok, found.summary()
    np.testing.assert_allclose(model.base.of(found.chi), beta, atol=1e-9 * np.abs(beta).max(initial=1.0))
    assert scaled_margin(model, found) >= -ROUNDING


def test_the_bodies_of_possible_base_parameters_are_those_of_least_divergence(model):
    """Their base parameters stay, and in no direction without torque does <C^-1, P> - log det P fall."""
    conditions = roomy(model, truth(model))
    x = conditions.start(truth(model))
    found = interior(conditions, x)
    np.testing.assert_allclose(conditions.A @ found.x, conditions.A @ x, atol=1e-12 * np.abs(conditions.A).max())
    moved = 0

    def divergence(part, at):
        total = 0.0
        for block in part.blocks:
            P, C = block.matrix(at), block.matrix(block.reference(conditions.centre, conditions.ball))
            total += np.trace(np.linalg.solve(C, P)) - np.linalg.slogdet(P)[1]
        return total

    for part, margin in zip(conditions.parts, found.margins, strict=True):
        if margin > BORDER:
            for direction in part.null.T:
                step = 1e-3 * margin * direction / np.abs(direction).max()
                here, up, down = (divergence(part, found.x + k * step) for k in (0, 1, -1))
                assert min(up, down) > here - 1e-12
                assert abs(up - down) < 1e-2 * (up + down - 2 * here)  # the minimum is between them
                moved += 1
    assert moved > 10


def scaled_margin(model, found):
    conditions = cone(model, found.beta)
    return conditions.margin(found.chi / conditions.scale)


@settings(max_examples=30, deadline=None)
@given(mechanisms(6), st.integers(0, 2**32 - 1))
@example(draw(1268, 5, True), 5)  # the infimum is approached by ever heavier bodies only
def test_the_nearest_possible_parameters_are_optimal(mechanism, seed):
    """Karush, Kuhn and Tucker, without the solver's own multipliers.

    With g the gradient at the answer b of |R (b - beta)|^2 / 2 over the cone A K: g'b = 0, and A'g is in the dual
    cone: as a matrix of every link positive semidefinite, of every friction not negative, of all that is free zero.
    The penalty y - y0 on directions y without torque adds its own gradient to g'b, times the squared distance found.
    """
    model = as_device(mechanism)
    beta = model.base.of(parameters(mechanism, model))
    wrong = beta * (1 + 0.1 * np.random.default_rng(seed).normal(size=len(beta)))
    R = metric(len(beta), beta, seed)
    found = project_to_feasible(model, wrong, R)
    assert found.ok
    assert scaled_margin(model, found) >= -ROUNDING
    gradient = R.T @ (R @ (found.beta - wrong))
    size = np.linalg.norm(R @ wrong) ** 2
    conditions = roomy(model, wrong)
    y, y0 = (conditions.null.T @ x for x in (found.chi / conditions.scale, conditions.centre))
    penalty = FIT_PENALTY * np.linalg.norm(y - y0) * np.linalg.norm(y) * np.linalg.norm(R @ (found.beta - wrong)) ** 2
    # The bodies found are the most interior ones, not those of the penalised optimum: 0.8 to 4 times that was seen.
    assert abs(gradient @ found.beta) < 1e-8 * size + 10 * penalty
    assert dual_margin(model, model.base.regrouping.T @ gradient, cone(model, wrong).scale) > -1e-6 * size


def dual_margin(model, price, scale):
    """How far prices of the standard parameters, (n,), are inside of the dual cone, in scaled parameters."""
    price, links = price * scale, 10 * len(model.device.joints)
    least = [0.0]
    for j in range(len(model.device.joints)):
        vector = np.linalg.solve(PSEUDO.T, price[10 * j : 10 * j + 10])
        D = np.zeros((4, 4))
        for value, (i, k) in zip(vector, UPPER, strict=True):
            D[i, k] = D[k, i] = value / (1 if i == k else np.sqrt(2))
        least.append(np.linalg.eigvalsh(D)[0])
    for term, value in zip(model.terms, price[links:], strict=True):
        least.append(-abs(value) if term.kind in ("offset", "spring") else value)
    return min(least)


def test_a_possible_free_fit_stays_as_it_is(model):
    observation = observed(model, truth(model), noise=0.02)
    free = haptid.estimate(observation, haptid.WLS())
    held = haptid.estimate(observation, PhysicallyConsistent())
    np.testing.assert_array_equal(held.beta, free.beta)
    np.testing.assert_allclose(model.base.of(held.feasible.chi), free.beta, rtol=1e-9)
    assert held.constrained_fit.active == ()
    assert held.notes == free.notes
    assert held.status == free.status
    assert (held.conf_int()[:, 1] == free.conf_int()[:, 1]).all()


@pytest.mark.parametrize("weighting", [haptid.OLS(), haptid.WLS()])
def test_a_negative_friction_is_held_as_bounded_least_squares_would(model, weighting):
    beta = truth(model)
    beta[model.base.names.index("FV1")] = -3e-4
    beta[model.base.names.index("FV3")] = -1e-4
    observation = observed(model, beta, noise=0.02)
    found = haptid.estimate(observation, PhysicallyConsistent(weighting))
    stack = observation.stack(found.weights)
    sizes = np.linalg.norm(stack[:-1, :-1], axis=0)
    low = np.where([name.startswith("FV") for name in model.base.names], 0.0, -np.inf)
    wanted = lsq_linear(stack[:-1, :-1] / sizes, stack[:-1, -1], (low, np.inf), tol=1e-14).x / sizes
    np.testing.assert_allclose(found.beta, wanted, rtol=1e-7, atol=1e-12)
    assert found.beta[model.base.names.index("FV1")] == 0.0
    assert found.constrained_fit.active == (
        "viscous friction of motor 1 would be negative: constrained to 0",
        "viscous friction of motor 3 would be negative: constrained to 0",
    )
    assert [cost.label for cost in found.constrained_fit.costs] == ["motor 1", "motor 2", "motor 3"]
    assert all(cost.constrained >= cost.free * (1 - 1e-6) for cost in found.constrained_fit.costs[:1])
    assert found.method.name.startswith(weighting.name)


def test_what_is_far_outside_of_its_interval_is_reported(model):
    beta = truth(model)
    beta[model.base.names.index("FV1")] = -1e-2
    found = haptid.estimate(observed(model, beta, noise=0.01), PhysicallyConsistent())
    assert found.status == "constrained_outside_ci"
    assert "FV1" in found.notes[-1]
    assert "does not repair it" in found.notes[-1]
    low, high = found["FV1"].conf_int()
    assert low == 0.0 < high
    np.testing.assert_allclose(found.constrained_fit.free, haptid.estimate(found.observation, haptid.WLS()).beta)
    held, other = found["FV1"], found["FC3"]
    assert held.constrained_outside_ci
    assert held.value == 0.0 > held.free
    assert parameter_cells(held)[1] == "0"
    assert parameter_cells(held)[3:5] == ["", ""]
    assert ResultParameter.of(held, 10.0, None).relative_se_percent is None
    assert ResultParameter.of(held, 10.0, None).unconstrained == held.free
    assert not other.constrained_outside_ci
    assert other.relative_se == 100 * other.se / abs(other.value)


def test_links_on_the_border_are_named():
    """Noise on a seven-joint arm: the free fit is no body's, the held one is, and costs next to nothing."""
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    beta = model.base.of(true_parameters(model))
    found = haptid.estimate(observed(model, beta, noise=0.3, phi=0.9), PhysicallyConsistent())
    assert not feasible_parameters(model, found.constrained_fit.free).ok
    assert any("its inertia is on the boundary of physical consistency" in s for s in found.constrained_fit.active)
    assert all(cost.constrained < 1.05 * cost.free for cost in found.constrained_fit.costs)
    for matrix, joint in zip(found.feasible.pseudo_inertias, model.device.joints, strict=True):
        assert np.linalg.eigvalsh(matrix)[0] >= -ROUNDING * np.trace(matrix), joint.name
    assert found.constrained_fit.active[0] in found.notes[-len(found.constrained_fit.active) - 1]


def test_intervals_stop_where_parameters_cannot_go(model):
    """The free interval cut at zero: never empty, never without the estimate, never wider than it need be."""
    beta = truth(model)
    beta[model.base.names.index("FV2")] = 2e-5
    found = haptid.estimate(observed(model, beta, noise=0.1), PhysicallyConsistent())
    low, high = found.conf_int().T
    assert (low <= found.beta).all()
    assert (found.beta <= high).all()
    bounded = never_negative(model)
    assert {name for name, b in zip(model.base.names, bounded, strict=True) if b} == {
        *(f"F{kind}{k}" for kind in "VC" for k in (1, 2, 3)),
        *("ZZbaR", "ZZbeR", "ZZdfR"),
    }
    assert (low[bounded] >= 0).all()
    free = haptid.estimate(found.observation, haptid.WLS())
    for level in (0.5, 0.99):
        low, high = free.conf_int(level).T
        high = np.where(bounded & (high < 0), high - free.beta, high)
        low = np.where(bounded, np.maximum(low, 0.0), low)
        expected = np.column_stack([np.minimum(low, found.beta), np.maximum(high, found.beta)])
        np.testing.assert_allclose(found.conf_int(level), expected, rtol=1e-9, atol=1e-12)


DRY = """
schema = 1
name = "sliding table"
gravity = [0.0, 0.0, -9.81]
convention = "modified-dh"
[[joints]]
name = "1"
type = "prismatic"
[[terms]]
kind = "coulomb-by-direction"
joints = "all"
[[terms]]
kind = "stribeck"
joints = "all"
velocity = 0.05
"""


def test_stribeck_friction_may_be_negative_but_not_the_sum(tmp_path):
    (tmp_path / "table.toml").write_text(DRY)
    table = haptid.DynamicModel(haptid.read_device(tmp_path / "table.toml"))
    names = table.device.parameters.names

    def verdict(forward, backward, more):
        chi = np.array([{"M1": 2.0, "FCP1": forward, "FCN1": backward, "FS1": more}.get(name, 0.0) for name in names])
        return feasible_parameters(table, table.base.of(chi))

    assert verdict(1.0, 2.0, 0.5).ok
    assert verdict(1.0, 2.0, -0.5).ok
    assert "friction at rest of joint 1" in " ".join(verdict(1.0, 2.0, -1.5).failing)
    assert "backward Coulomb friction of joint 1: negative" in verdict(1.0, -0.1, 0.5).failing


def test_a_verdict_does_not_depend_on_units(model):
    beta = truth(model)
    verdicts = [feasible_parameters(model, size * beta) for size in (1e-4, 1.0, 1e4)]
    assert all(verdict.ok for verdict in verdicts)
    np.testing.assert_allclose([v.margin for v in verdicts], verdicts[1].margin, rtol=1e-4)
    assert "margin" in verdicts[1].summary()
    assert "Not physically consistent" in feasible_parameters(model, -beta).summary()


def test_nothing_is_a_border_case(model):
    assert feasible_parameters(model, np.zeros(len(model.base))).ok


ROD = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[symmetry]]
reason = "a rod along x"
zero = ["XX1"]
"""


def test_symmetries_that_no_body_of_volume_has(tmp_path):
    (tmp_path / "rod.toml").write_text(ROD)
    rod = haptid.DynamicModel(haptid.read_device(tmp_path / "rod.toml"))
    with pytest.raises(PhysicalConsistencyError) as raised:
        feasible_parameters(rod, np.ones(len(rod.base)))
    assert raised.value.where == "link 1"
    assert raised.value.found < raised.value.limit


def test_questions_that_mean_nothing(model):
    beta, p = truth(model), len(model.base)
    with pytest.raises(SettingError) as nan:
        feasible_parameters(model, np.where(np.arange(p) == 1, np.nan, beta))
    assert nan.value.where == "XXbeR"
    with pytest.raises(ShapeError):
        feasible_parameters(model, beta[:3])
    with pytest.raises(ShapeError):
        project_to_feasible(model, beta, np.eye(3))
    R = np.eye(p)
    R[2, 2] = 0.0
    with pytest.raises(IdentifiabilityError) as zero:
        project_to_feasible(model, beta, R)
    assert (zero.value.where, zero.value.found) == ("ZZbeR", 0.0)
    R[1:3, 2] = 1.0, 1e-14
    with pytest.raises(IdentifiabilityError) as small:
        project_to_feasible(model, beta, R)
    assert 0 < small.value.found < small.value.limit


def test_a_solver_that_gives_up_is_an_error(model, monkeypatch):
    whole = conic_program.settings

    def short(*chosen):
        made = whole(*chosen)
        made.max_iter = 1
        return made

    monkeypatch.setattr(conic_program, "settings", short)
    with pytest.raises(ConvergenceError) as raised:
        feasible_parameters(model, truth(model))
    assert raised.value.found == "MaxIterations"


def test_a_panic_of_the_solver_is_one_way_to_stall(model, monkeypatch):
    whole, tried = conic_program.clarabel.DefaultSolver, []

    class PanicException(BaseException):
        pass

    class Panics:
        def __init__(self, *problem):
            self.problem = problem

        def solve(self):
            tried.append(self)
            if len(tried) % 2:
                raise PanicException("Eigval error: Eigen(1)")
            return whole(*self.problem).solve()

    beta = truth(model)
    right = feasible_parameters(model, beta).beta
    monkeypatch.setattr(conic_program.clarabel, "DefaultSolver", Panics)
    np.testing.assert_allclose(feasible_parameters(model, beta).beta, right, rtol=1e-6)
    assert len(tried) > 1
    monkeypatch.setattr(Panics, "solve", lambda _: (_ for _ in ()).throw(PanicException("Eigval error: Eigen(1)")))
    with pytest.raises(ConvergenceError) as raised:
        feasible_parameters(model, beta)
    assert raised.value.found == "Eigval error: Eigen(1)"


def test_numbers_that_overflow_are_an_error_without_a_trace(capfd):
    q = -np.ones(10)
    q[3] = 1e300
    with pytest.raises(ConvergenceError, match="numbers that overflow"):
        conic_program.minimise(np.eye(10), q, [conic_program.ConeCondition(PSEUDO, np.zeros(10), True)])
    assert capfd.readouterr().err == ""


def test_arrays_of_the_answers_are_read_only(model):
    found = feasible_parameters(model, truth(model))
    for array in (found.beta, found.chi):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert found.pseudo_inertias.shape == (len(model.device.joints), 4, 4)
