"""Laws and oracles of estimators with weights, equality constraints or errors in the columns."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, optimize, signal

import haptid
from haptid import errors
from haptid.estimation import (
    GLS,
    IRLS,
    SUR,
    TLS,
    Bounds,
    EqualityConstraints,
    ErrorsInVariables,
    Heteroscedastic,
    Huber,
    Ridge,
    StudentT,
    Tukey,
)
from haptid.estimation.intervals.model_based import Autoregression, burg, runs_of
from haptid.estimation.least_squares import solve
from haptid.estimation.methods.errors_in_variables import smallest_generalised_eigenvalue
from haptid.estimation.methods.gls import Whitening, covariance, nearest_correlation, residual_models
from haptid.estimation.methods.regularised import RIDGE_STRENGTHS, prediction_error, strengthened
from haptid.estimation.methods.robust import robust_scales
from haptid.estimation.methods.wls import variance_function
from haptid.observation.rows import Rows
from motions import motion, multisine, truth
from sampling import FAR

BY_RESIDUAL = [SUR(), GLS(), IRLS(Huber()), IRLS(Tukey()), IRLS(StudentT())]
WEIGHING = [*BY_RESIDUAL, Heteroscedastic()]


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def observation(model):
    return haptid.observe(model, motion(model, truth(model), seconds=6.0, dt=2e-3, noise=0.1, phi=0.6))


def stacked(observation):
    """All rows in memory: W (motors, rows, p) and y (motors, rows)."""
    (rows,) = Rows(observation)
    return rows.W, rows.y


# --- what all that weigh share ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [*WEIGHING, TLS()], ids=lambda method: method.name)
def test_without_noise_the_truth_comes_back(model, method):
    beta = truth(model)
    made = haptid.observe(model, motion(model, beta, seconds=4.0, dt=2e-3))
    np.testing.assert_allclose(haptid.estimate(made, method).beta, beta, rtol=1e-6)


@pytest.mark.parametrize("method", BY_RESIDUAL, ids=lambda method: method.name)
def test_torque_of_other_parameters_added_adds_these_parameters(model, method):
    """An estimator that weighs rows by their residuals alone is equivariant: y + W c gives beta + c."""
    plain = motion(model, truth(model), seconds=4.0, dt=2e-3, noise=0.1)
    c = np.linspace(-1, 1, len(model.base)) * truth(model)
    moved = replace(plain, tau=plain.tau + haptid.inverse_dynamics(model, c, plain.q.T, *(r.T for r in plain.rates)).T)
    a, b = (haptid.estimate(haptid.observe(model, made), method) for made in (plain, moved))
    np.testing.assert_allclose(b.beta - a.beta, c, atol=5e-3 * np.abs(a.se).max(), rtol=1e-4)


@pytest.mark.parametrize("method", WEIGHING, ids=lambda method: method.name)
def test_the_unit_of_torque_does_not_matter(model, method):
    plain = motion(model, truth(model), seconds=4.0, dt=2e-3, noise=0.1)
    a, b = (haptid.estimate(haptid.observe(model, replace(plain, tau=k * plain.tau)), method) for k in (1.0, 1e3))
    np.testing.assert_allclose(b.beta, 1e3 * a.beta, atol=1e-2 * b.se.min(), rtol=1e-5)
    np.testing.assert_allclose(b.se, 1e3 * a.se, rtol=1e-3)


@pytest.mark.parametrize("method", WEIGHING, ids=lambda method: method.name)
def test_constrained_and_reduced_versions_take_the_same_rows(observation, method):
    plain = haptid.estimate(observation, method)
    np.testing.assert_allclose(
        haptid.estimate(observation, haptid.PhysicallyConsistent(method)).constrained_fit.free, plain.beta
    )
    name = observation.base.names[-1]
    less = haptid.estimate(observation, haptid.estimation.FixedAtZero((name,), method))
    assert less[name].value == 0
    equal = haptid.estimate(observation, EqualityConstraints({name: 0.0}, method))
    np.testing.assert_allclose(equal.beta, less.beta, atol=1e-12)
    np.testing.assert_allclose(equal.se, less.se, rtol=1e-6)


@pytest.mark.parametrize("method", [*WEIGHING, TLS()], ids=lambda method: method.name)
def test_a_motor_without_torque_is_rejected(model, method):
    made = motion(model, truth(model), seconds=4.0, dt=2e-3)
    with pytest.raises(errors.IdentifiabilityError):
        haptid.estimate(haptid.observe(model, replace(made, tau=made.tau * [1.0, 1.0, 0.0])), method)


# --- GLS --------------------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(st.lists(st.floats(-0.9, 0.9), min_size=1, max_size=4), st.integers(5, 60))
def test_whitening_is_the_inverse_of_the_cholesky_factor(reflections, n):
    """Of the covariance of the model: oracle scipy's Toeplitz, autocovariance from the discrete Lyapunov equation."""
    a = np.ones(1)
    power = 1.0
    filters, powers = [a], [1.0]
    for k in reflections:
        longer = np.append(filters[-1], 0.0)
        filters.append(longer + k * longer[::-1])
        power *= 1 - k**2
        powers.append(power)
    other_model = Autoregression(tuple(filters), np.array(powers))
    order = len(filters[-1]) - 1
    companion = np.vstack([-filters[-1][1:], np.eye(order)[:-1]])
    state = linalg.solve_discrete_lyapunov(companion, np.outer(np.eye(order)[0], np.eye(order)[0]) * power)
    gamma = np.array([(np.linalg.matrix_power(companion, k) @ state)[0, 0] for k in range(n)])
    white = other_model.whitened(np.linalg.cholesky(linalg.toeplitz(gamma)))
    # The factor of a nearly singular covariance is right to rounding times its condition number.
    rounding = np.finfo(float).eps * np.linalg.cond(linalg.toeplitz(gamma))
    np.testing.assert_allclose(white, np.eye(n), atol=1e-9 + 10 * n * rounding)


def test_gls_is_aitkens_estimate(observation):
    """beta = (W' V^-1 W)^-1 W' V^-1 y with the covariance of the residual_models, all rows in memory."""
    found = haptid.estimate(observation, GLS(passes=1))
    W, y = stacked(observation)
    start = haptid.estimate(observation, haptid.WLS()).beta
    H, b = np.zeros((len(start),) * 2), np.zeros(len(start))
    for other_model, own, torque in zip(residual_models(Rows(observation), start, 20), W, y, strict=True):
        white, target = other_model.whitened(own), other_model.whitened(torque)
        H += white.T @ white
        b += white.T @ target
    np.testing.assert_allclose(found.beta, np.linalg.solve(H, b), rtol=1e-6)
    np.testing.assert_allclose(found.classical_covariance, np.linalg.inv(H), rtol=1e-5, atol=1e-20)


@pytest.mark.parametrize("stride", [1, 3])
def test_whitening_is_that_of_every_run_by_itself(model, stride):
    """With a stride, runs of every third row; gaps of one row, of many, and at the ends begin runs anew."""
    beta = truth(model)
    (rows,) = Rows(haptid.observe(model, motion(model, beta, seconds=6.0, dt=2e-3, noise=0.1, phi=0.6)))
    used = np.random.default_rng(0).random(rows.used.shape) < 0.9
    used[:, :5] = used[:, 100:140] = False
    gaps = rows.with_rows(rows.W * used[:, :, None], rows.y * used)
    gaps.__dict__["used"] = used
    models = [burg([own], 2) for own in rows.residual(beta)]
    white = Whitening(models, stride)(gaps)
    for k, own in enumerate(models):
        assert own.order > 0
        assert not white.y[k, ~used[k]].any()
        for run in runs_of(used[k], stride):
            np.testing.assert_allclose(white.y[k, run], own.whitened(gaps.y[k, run]), rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(white.W[k, run], own.whitened(gaps.W[k, run]), rtol=1e-9, atol=1e-12)


def test_whitening_gives_way_to_weights_where_the_model_is_wrong(model):
    """A misfit at the highest frequencies: whitened rows would fit it, and predict worse."""
    beta = truth(model)
    plain = motion(model, beta, seconds=8.0, dt=2e-3, noise=0.02, phi=0.99)
    right = haptid.estimate(haptid.observe(model, plain), GLS())
    late = replace(plain, tau=np.roll(plain.tau, 10, axis=0))  # the torque of 20 ms before
    wrong = haptid.observe(model, late)
    wls, gls = (haptid.estimate(wrong, method) for method in (haptid.WLS(), GLS()))
    assert (np.abs(gls.beta - wls.beta) < 0.01 * wls.se).all()
    assert np.median(right.se / haptid.estimate(haptid.observe(model, plain), haptid.WLS()).se) < 0.9


def test_burg_finds_order_and_coefficients():
    rng = np.random.default_rng(0)
    parts = [signal.lfilter([1.0], [1.0, -1.6, 0.8], rng.standard_normal(n)) for n in (5000, 20, 8000)]
    found = burg(parts, 20)
    assert found.order == 2
    n = sum(map(len, parts))  # deviations of both coefficients, and of a variance
    np.testing.assert_allclose(found.filters[-1], [1.0, -1.6, 0.8], atol=FAR * np.sqrt((1 - 0.8**2) / n))
    assert found.powers[-1] == pytest.approx(1.0, rel=FAR * np.sqrt(2 / n))
    assert burg([rng.standard_normal(4000)], 20).order == 0
    assert burg([np.zeros(50)], 20).order == 0


# --- SUR --------------------------------------------------------------------------------------------------------


def test_sur_is_zellners_estimate(observation):
    found = haptid.estimate(observation, SUR(passes=1))
    start = haptid.estimate(observation, haptid.WLS()).beta
    P = np.linalg.inv(covariance(Rows(observation), start))
    W, y = stacked(observation)
    H = np.einsum("irp,ij,jrq->pq", W, P, W, optimize=True)
    beta = np.linalg.solve(H, np.einsum("irp,ij,jr->p", W, P, y, optimize=True))
    np.testing.assert_allclose(found.beta, beta, rtol=1e-6)


def test_what_is_no_correlation_matrix_becomes_one():
    C = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    assert np.linalg.eigvalsh(C)[0] < 0
    made = nearest_correlation(C)
    np.testing.assert_allclose(np.diag(made), 1.0)
    assert np.linalg.eigvalsh(made)[0] > 0


# --- IRLS -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", [Huber(), Tukey(), StudentT()], ids=lambda loss: loss.name)
def test_losses_have_the_gradients_of_their_influence(loss):
    u = np.array([-6.0, -3.1, -1.0, -0.2, 0.0, 0.7, 1.2, 2.5, 4.4])
    h = 1e-6
    slope = (loss.weight(u + h) * (u + h) - loss.weight(u - h) * (u - h)) / (2 * h)
    np.testing.assert_allclose(loss.slope(u), slope, atol=1e-6)
    assert loss.weight(np.zeros(1)) == 1.0


def test_irls_minimises_hubers_loss():
    """Oracle: scipy's least_squares with its own Huber loss, at the scale that IRLS ended with."""
    plain = motion(
        haptid.DynamicModel(haptid.read_device("emps")),
        np.array([95.0, 200.0, 20.0, -3.0]),
        seconds=4.0,
        dt=2e-3,
        noise=0.2,
    )
    rng = np.random.default_rng(2)
    wild = np.where(rng.random(plain.tau.shape) < 0.2, 20.0 * plain.tau.std(), 0.0)
    observation = haptid.observe(haptid.DynamicModel(haptid.read_device("emps")), replace(plain, tau=plain.tau + wild))
    found = haptid.estimate(observation, IRLS(Huber()))
    (W,), (y,) = stacked(observation)
    e = y - W @ found.beta
    scale = np.median(np.abs(e)) / 0.67448975
    size = np.abs(found.beta)
    best = optimize.least_squares(
        lambda x: (y - W @ (size * x)) / scale, np.ones(4), loss="huber", f_scale=1.345, xtol=1e-14, gtol=1e-14
    )
    np.testing.assert_allclose(found.beta, size * best.x, rtol=1e-4)


def test_weights_reach_the_fit(observation):
    """At the end W' (w (y - W beta)) is zero over all motors in their units, and it is not without the weights."""
    for method in (IRLS(Huber()), IRLS(Tukey()), IRLS(StudentT())):
        found = haptid.estimate(observation, method)
        W, y = stacked(observation)
        e = y - W @ found.beta
        made = robust_scales(Rows(observation), method.loss, found.beta)
        unit = (made.gain / made.unit**2)[:, None]
        weighted, plain = (
            np.einsum("mrp,mr->p", W, unit * x) for x in (method.loss.weight(e / made.scale[:, None]) * e, e)
        )
        assert np.abs(weighted / plain).max() < 1e-2
        assert np.abs(weighted).max() < 1e-4 * np.abs(plain).max()


def test_outliers_cost_ols_five_times_what_they_cost_irls(model):
    beta = truth(model)
    plain = motion(model, beta, seconds=4.0, dt=2e-3, noise=0.1)
    unit = np.sqrt(np.diag(haptid.estimate(haptid.observe(model, plain), haptid.WLS()).classical_covariance))
    found = {"OLS": [], "IRLS": []}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wild = rng.random(plain.tau.shape) < 0.2
        off = plain.tau.std(axis=0) * rng.choice([-1.0, 1.0], plain.tau.shape) * rng.uniform(1, 3, plain.tau.shape)
        made = haptid.observe(model, replace(plain, tau=plain.tau + wild * off))
        for name, method in (("OLS", haptid.OLS()), ("IRLS", IRLS())):
            found[name].append((haptid.estimate(made, method).beta - beta) / unit)
    assert np.linalg.norm(found["OLS"]) > 5 * np.linalg.norm(found["IRLS"])


# --- heteroscedastic --------------------------------------------------------------------------------------------


def test_variances_that_grow_with_speed_are_found(model):
    beta = truth(model)
    plain = motion(model, beta, seconds=8.0, dt=2e-3)
    speed = np.abs(plain.rates[0])
    rng = np.random.default_rng(1)
    se = 0.01 * np.exp(0.5 * 1.5 * speed / np.sqrt(np.mean(speed**2, axis=0)))
    observation = haptid.observe(model, replace(plain, tau=plain.tau + se * rng.standard_normal(se.shape)))
    found = variance_function(Rows(observation), beta, None)
    np.testing.assert_allclose(found.a[:, 1], 1.5, atol=0.2)
    np.testing.assert_allclose(found.a[:, 2], 0.0, atol=0.2)
    wls, ml = (haptid.estimate(observation, method) for method in (haptid.WLS(), Heteroscedastic()))
    assert np.median(ml.se / wls.se) < 0.9
    assert (np.abs(ml.beta - beta) < 4 * ml.se).all()


# --- TLS and noise of encoders ----------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 99), st.integers(0, 2))
def test_least_noise_is_the_smallest_generalised_eigenvalue(seed, exact):
    rng = np.random.default_rng(seed)
    whole = np.linalg.qr(rng.normal(size=(40, 5)), mode="r")
    noisy = np.arange(5) >= exact
    C = np.diag(np.where(noisy, rng.uniform(0.5, 2, 5), 0.0))
    inverse = linalg.eigh(C, whole.T @ whole, eigvals_only=True)[-1]
    assert smallest_generalised_eigenvalue(whole, noisy, C) == pytest.approx(1 / inverse, rel=1e-9)


def test_tls_is_golub_and_van_loans_where_no_column_is_exact():
    """beta = -v / v_y of the last right singular vector of [W y], columns in their root mean square."""
    model = haptid.DynamicModel(haptid.read_device("puma560"))
    beta = np.random.default_rng(0).uniform(0.5, 1.5, len(model.base))
    made = haptid.observe(model, motion(model, beta, seconds=4.0, dt=5e-3, noise=0.01))
    found = haptid.estimate(made, TLS())
    rows = made.stack(haptid.WLS().weights(made))
    size = np.linalg.norm(rows, axis=0)
    v = np.linalg.svd(rows / size)[2][-1] / size
    np.testing.assert_allclose(found.beta, -v[:-1] / v[-1], rtol=1e-6, atol=1e-9)


def test_noise_of_encoders_is_taken_off_the_columns():
    """Coarse encoders and a poor treatment: the corrected inertia is nearer to the truth than that of WLS."""
    model = haptid.DynamicModel(haptid.read_device("emps"))
    beta = np.array([95.0, 200.0, 20.0, -3.0])
    bias = {"WLS": [], "corrected": []}
    for seed in range(4):
        q, qd, qdd = multisine(1, 20.0, 2e-3, seed)
        tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
        step = 5e-5
        coarse = haptid.Motion(2e-3, (step * np.round(q / step)).T, tau.T, haptid.Treatment(cutoff_hz=None))
        made = haptid.observe(model, coarse)
        for name, method in (("WLS", haptid.WLS()), ("corrected", ErrorsInVariables(resolution=step))):
            bias[name].append(haptid.estimate(made, method)["M1"].value / beta[0] - 1)
    assert np.mean(bias["WLS"]) < -0.2
    assert abs(np.mean(bias["corrected"])) < 0.05 * abs(np.mean(bias["WLS"]))


def test_what_encoders_cannot_resolve_is_rejected():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    exact = haptid.observe(model, motion(model, np.array([95.0, 200.0, 20.0, -3.0]), seconds=4.0, noise=0.1))
    with pytest.raises(errors.SettingError, match="no log"):
        haptid.estimate(exact, ErrorsInVariables())
    with pytest.raises(errors.SettingError, match="exact"):
        haptid.estimate(exact, ErrorsInVariables(resolution=1e-4))
    q, qd, qdd = multisine(1, 4.0, 1e-3, 0)
    tau = haptid.inverse_dynamics(model, np.array([95.0, 200.0, 20.0, -3.0]), q, qd, qdd)
    coarse = haptid.Motion(1e-3, q.T, tau.T, haptid.Treatment(cutoff_hz=None))
    with pytest.raises(errors.IdentifiabilityError) as raised:
        haptid.estimate(haptid.observe(model, coarse), ErrorsInVariables(resolution=0.1))
    assert "M1" in raised.value.where
    assert raised.value.found > raised.value.limit


# --- what is known beforehand -----------------------------------------------------------------------------------


def test_ridge_runs_from_the_rows_to_the_prior(model, observation):
    prior = {k: p[0] for k, p in enumerate(model.base_prior) if p and p[0]}
    free, weak, strong = (
        haptid.estimate(observation, method) for method in (haptid.WLS(), Ridge(strength=1e-12), Ridge(strength=1e12))
    )
    np.testing.assert_allclose(weak.beta, free.beta, rtol=1e-6)
    np.testing.assert_allclose(strong.beta[list(prior)], list(prior.values()), rtol=1e-6)


def test_ridge_is_the_mean_of_bayes(model, observation):
    found = haptid.estimate(observation, Ridge(strength=1.0))
    rows = observation.stack(found.weights)
    precision, pull = rows[:-1, :-1].T @ rows[:-1, :-1], rows[:-1, :-1].T @ rows[:-1, -1]
    for k, prior in enumerate(model.base_prior):
        if prior and prior[0]:
            weight = 1 / (0.3 * prior[0]) ** 2
            precision[k, k] += weight
            pull[k] += weight * prior[0]
    np.testing.assert_allclose(found.beta, np.linalg.solve(precision, pull), rtol=1e-6)


def test_the_strength_is_that_which_predicts_other_blocks_best(observation):
    """Against leaving out each block by fitting without it."""
    method = Ridge()
    weights, prior = method.weights(observation), strengthened(method.prior(observation.model), 1.0)
    total = 0.0
    for m, motor in enumerate(observation.motors):
        for b in range(len(motor.rows)):
            keep = np.arange(len(motor.rows)) != b
            motors = list(observation.motors)
            r_factors = np.array(motor.r_factors)
            r_factors[b] = 0.0
            motors[m] = replace(motor, r_factors=r_factors, rows=motor.rows * keep)
            beta = solve(replace(observation, motors=tuple(motors)), weights, (), prior).beta
            left = motor.r_factors[b] @ np.append(-beta[motor.columns], 1.0) * weights[m]
            total += float(left @ left)
    assert prediction_error(observation, weights, prior) == pytest.approx(total, rel=1e-6)
    tried = [
        prediction_error(observation, weights, strengthened(method.prior(observation.model), s))
        for s in RIDGE_STRENGTHS
    ]
    best = haptid.estimate(observation, Ridge(strength=RIDGE_STRENGTHS[int(np.argmin(tried))]))
    np.testing.assert_allclose(haptid.estimate(observation, method).beta, best.beta, rtol=1e-3)


def test_ridge_needs_a_prior():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    made = haptid.observe(model, motion(model, np.array([95.0, 200.0, 20.0, -3.0]), seconds=4.0, noise=0.1))
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        haptid.estimate(made, Ridge())
    assert raised.value.where == model.device.name


def test_relations_hold_and_the_rest_is_the_best_under_them(observation):
    """Oracle: the equations of Lagrange."""
    names = observation.base.names
    relations = {"FC1 - FC2": 0.001, f"2*{names[0]}": 0.01}
    found = haptid.estimate(observation, EqualityConstraints(relations))
    p = len(names)
    A = np.zeros((2, p))
    A[0, names.index("FC1")], A[0, names.index("FC2")], A[1, 0] = 1, -1, 2
    np.testing.assert_allclose(A @ found.beta, list(relations.values()), rtol=1e-9)
    rows = observation.stack(found.weights)
    H, b = rows[:-1, :-1].T @ rows[:-1, :-1], rows[:-1, :-1].T @ rows[:-1, -1]
    scale = 1 / np.sqrt(np.diag(H))
    system = np.block([[H * np.outer(scale, scale), (A * scale).T], [A * scale, np.zeros((2, 2))]])
    best = np.linalg.solve(system, np.concatenate([b * scale, list(relations.values())]))[:p] * scale
    np.testing.assert_allclose(found.beta, best, rtol=1e-6)
    assert found.se[0] == pytest.approx(0.0, abs=1e-12)


def test_relations_given_twice_are_used_once_and_others_are_rejected(observation):
    once = haptid.estimate(observation, EqualityConstraints({"FC1 - FC2": 0.0}))
    twice = haptid.estimate(observation, EqualityConstraints({"FC1 - FC2": 0.0, "2*FC2 - 2*FC1": 0.0}))
    np.testing.assert_allclose(twice.beta, once.beta, rtol=1e-9)
    with pytest.raises(errors.SettingError) as raised:
        haptid.estimate(observation, EqualityConstraints({"FC1 - FC2": 0.0, "2*FC2 - 2*FC1": 1.0}))
    assert raised.value.where == "relations"
    with pytest.raises(errors.DeviceFileError):
        haptid.estimate(observation, EqualityConstraints({"nothing": 0.0}))


def test_bounds_are_kept_and_met_only_where_they_hold(observation):
    """Oracle: scipy's bounded least squares."""
    free = haptid.estimate(observation, haptid.WLS())
    low, high = free.beta - 2 * free.se, free.beta + 2 * free.se
    k = free.base.names.index("FC2")
    low[k], high[k] = free.beta[k] + free.se[k], free.beta[k] + 3 * free.se[k]
    limits = {name: (float(low[j]), float(high[j])) for j, name in enumerate(free.base.names)}
    found = haptid.estimate(observation, Bounds(limits))
    rows = observation.stack(free.weights)
    size = free.se
    best = optimize.lsq_linear(
        rows[:-1, :-1] * size, rows[:-1, -1], (low / size, high / size), tol=1e-14, lsmr_tol="auto", method="bvls"
    )
    np.testing.assert_allclose(found.beta / size, best.x, rtol=1e-5, atol=1e-5)
    assert any("FC2" in sentence for sentence in found.constrained_fit.active)
    wide = {name: (None, float(b) + 1e3) for name, b in zip(free.base.names, free.beta, strict=True)}
    inside = haptid.estimate(observation, Bounds(wide))
    np.testing.assert_array_equal(inside.beta, free.beta)
    assert inside.status == free.status


@pytest.mark.parametrize(
    "make",
    [
        lambda: GLS(passes=0),
        lambda: GLS(most_order=-1),
        lambda: SUR(passes=0),
        lambda: IRLS(most=0),
        lambda: Huber(0.0),
        lambda: Tukey(-1.0),
        lambda: StudentT(np.inf),
        lambda: Heteroscedastic(passes=0),
        lambda: Ridge(share=0.0),
        lambda: Ridge(strength=-1.0),
        lambda: Ridge(passes=0),
        lambda: ErrorsInVariables(draws=0),
        lambda: ErrorsInVariables(resolution=0.0),
        lambda: Bounds({"FC1": (1.0, 0.0)}),
        lambda: EqualityConstraints({}, Ridge()),
        lambda: haptid.PhysicallyConsistent(haptid.estimation.FixedAtZero(("FC1",))),
        lambda: haptid.estimation.FixedAtZero(("FC1",), TLS()),
    ],
)
def test_settings_out_of_range_are_rejected(make):
    with pytest.raises(errors.SettingError):
        make()
