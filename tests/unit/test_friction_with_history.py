"""Friction with presliding and warming: laws, recovery of constants, bench, code, and what a device file may say."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import haptid
from compiled import NAME, STRICT, compiler, run
from haptid import errors
from haptid.advice.proof import proven
from haptid.advice.ranking import in_order, stated
from haptid.advice.search import search_of
from haptid.device.terms.presliding import Presliding
from haptid.estimation import EKF, OutputErrorMethod
from haptid.estimation.nonlinear import variable_projection
from haptid.experiment import bench
from haptid.export import CCode, export_c
from haptid.observation.rows import chunks

AXIS = """
name = "axis"
gravity = [0.0, 0.0, -9.81]

[[joints]]
name = "1"

[[terms]]
kind = "viscous"
joints = "all"
"""


def model_of(tmp_path, *terms):
    """An axis with viscous friction and other terms."""
    tables = "".join(f"\n[[terms]]\njoints = 'all'\n{term}\n" for term in terms)
    path = tmp_path / "axis.toml"
    path.write_text(AXIS + tables, encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))


def path(samples=4000, dt=1e-3):
    """Positions, velocities and accelerations of two sines, (samples,) each."""
    t = dt * np.arange(samples)
    parts = [(0.5, 2 * np.pi * 0.7, 0.3), (0.15, 2 * np.pi * 2.3, 1.0)]
    q = sum(a * np.sin(w * t + p) for a, w, p in parts)
    qd = sum(a * w * np.cos(w * t + p) for a, w, p in parts)
    qdd = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in parts)
    return t, q, qd, qdd


def motion_of(model, beta, noise=0.0, samples=16_000):
    """A motion of the axis with exact rates, its torque that of the model, with the history of friction."""
    t, *rates = path(samples)
    history = model.history(rates[0][None], rates[1][None], t)
    own = {name: column * beta[model.base.names.index(name)] for name, column in history.items()}
    tau = haptid.inverse_dynamics(model, beta, *(x[None] for x in rates))[0]
    steady = model.history(*np.zeros((2, 1, 1)), np.zeros(1))
    for term in model.terms:
        if term.name in steady:
            slides = term.shape.sliding(rates[1]) if isinstance(term.shape, Presliding) else 0.0
            tau = tau + own[term.name] - beta[model.base.names.index(term.name)] * slides
    tau = tau + noise * np.random.default_rng(3).standard_normal(samples)
    q, qd, qdd = (x[:, None] for x in rates)
    return haptid.Motion(1e-3, q, tau[:, None], haptid.Treatment(cutoff_hz=None), rates=(qd, qdd))


def test_dahl_and_lugre_follow_their_differential_equations():
    t, q, qd, _ = path()
    for shape in (Presliding("dahl", 0.02), Presliding("lugre", 0.02, 0.8, 1.6)):

        def rate(time, h, shape=shape):
            v = np.interp(time, t, qd)
            level = abs(shape.sliding(np.array([v]))[0]) if shape.law == "lugre" else 1.0
            return (v - abs(v) * h / (level or 1.0)) / shape.distance

        solved = solve_ivp(rate, (0, t[-1]), [0.0], t_eval=t, max_step=1e-3, rtol=1e-8, atol=1e-10).y[0]
        assert np.abs(shape.along(q, qd) - solved).max() < 5e-3  # the velocity is held for a sample


def test_maxwell_slip_is_a_spring_that_slips():
    _, q, qd, _ = path()
    shape, h, wanted = Presliding("maxwell-slip", 0.1), 0.0, [0.0]
    for step in np.diff(q):
        h = float(np.clip(h + step / 0.1, -1, 1))
        wanted.append(h)
    np.testing.assert_allclose(shape.along(q, qd), wanted, atol=1e-12)


def test_a_dahl_loop_dissipates_what_its_integral_says():
    """In a stroke of length L the column is 1 - 2 e^{-u/d} / (1 + e^{-L/d}) once the cycle has settled."""
    stroke, d = np.linspace(-1, 1, 4001), 0.5
    x = np.concatenate([stroke, *[stroke[::-1][1:], stroke[1:]] * 6])
    h = Presliding("dahl", d).along(x, np.zeros_like(x))
    last = slice(-8001, None)
    wanted = 2 * (2 - 2 * d * np.tanh(1 / d))
    assert np.trapezoid(h[last], x[last]) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("law", ["dahl", "maxwell-slip", "lugre"])
def test_one_step_after_another_is_the_whole_path(law):
    _, q, qd, _ = path(500)
    shape, made = Presliding(law, 0.03, 0.5, 1.4), [0.0]
    for step, v in zip(np.diff(q), 0.5 * (qd[1:] + qd[:-1]), strict=True):
        made.append(shape.after(made[-1], step, v))
    np.testing.assert_allclose(shape.along(q, qd), made, atol=1e-12)


def test_far_from_a_reversal_the_column_is_that_of_sliding():
    _, q, qd, _ = path()
    for law in ("dahl", "maxwell-slip"):
        column = Presliding(law, 1e-9).along(q, qd)
        assert (np.abs(column - np.sign(qd))[5:] < 1e-6).mean() > 0.99


@pytest.mark.parametrize(
    ("term", "true"),
    [
        ("kind = 'dahl'\ndistance = { start = 0.02, low = 0.001, high = 0.3 }", {"FD1.distance": 0.05}),
        ("kind = 'maxwell-slip'\ndistances = [{ start = 0.02, low = 0.001, high = 0.3 }]", {"FM1.distance": 0.05}),
        (
            "kind = 'lugre'\ndistance = { start = 0.02, low = 0.001, high = 0.3 }\n"
            "velocity = { start = 0.3, low = 0.03, high = 3.0 }\nbreakaway = { start = 1.0, low = 0.3, high = 3.0 }",
            {"FG1.distance": 0.05, "FG1.velocity": 0.6, "FG1.breakaway": 1.5},
        ),
        (
            "kind = 'warming'\ntime = { start = 10.0, low = 0.5, high = 100.0 }",
            {"FT1.time": 3.0},
        ),
    ],
)
def test_constants_are_recovered_within_their_intervals(tmp_path, term, true):
    model = model_of(tmp_path, term)
    beta = np.array([{"FV": 0.4, "FT": 0.5, "ZZ": 0.3}.get(name[:2], 0.8) for name in model.base.names])
    motion = motion_of(model.at_constants(list(true.values())), beta, noise=0.02)
    found = variable_projection(model, [motion])
    for constant in found.constants:
        low, high = constant.conf_int(0.99)
        assert low < true[constant.name] < high
        assert high - low < 0.6 * true[constant.name]
    made = haptid.estimate(haptid.observe(found.model, motion), haptid.WLS(), found.intervals)
    low, high = made.conf_int(0.999).T
    assert ((low < beta) & (beta < high)).all()


def test_reversals_give_rows(tmp_path):
    """Rows near reversals are kept with presliding friction, and dropped with Coulomb friction."""
    kept = []
    for term in ("kind = 'coulomb'", "kind = 'dahl'\ndistance = 0.05"):
        model = model_of(tmp_path, term)
        t, q, qd, qdd = path()
        treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=0.2)
        motion = haptid.Motion(1e-3, q[:, None], qd[:, None], treatment, rates=(qd[:, None], qdd[:, None]))
        kept.append(sum(int(chunk.used.sum()) for chunk in chunks(model, motion)))
        assert len(t) >= kept[-1]
    assert kept[1] > 1.05 * kept[0]


def test_elements_with_different_distances_are_parameters_of_their_own(tmp_path):
    model = model_of(tmp_path, "kind = 'maxwell-slip'\ndistances = [0.01, 0.1, 0.5]", "kind = 'coulomb'")
    assert [name for name in model.base.names if name.startswith("F")] == ["FV1", "FMA1", "FMB1", "FMC1", "FC1"]
    assert {term.nature for term in model.terms} == {"viscous", "coulomb"}


def test_the_bench_has_what_the_model_has(tmp_path):
    model = model_of(
        tmp_path,
        "kind = 'lugre'\ndistance = 0.02\nvelocity = 0.5\nbreakaway = 1.5",
        "kind = 'maxwell-slip'\ndistances = [0.05]",
        "kind = 'warming'\ntime = 0.5",
        "kind = 'ripple'\nperiod = '2*pi/24'\nharmonics = 2",
        "kind = 'stribeck'\nvelocity = 0.4\nwidth = 0.05",
    )
    given = {"ZZ1": 0.1, "FV1": 0.3, "FG1": 0.6, "FM1": 0.3, "FT1": 0.4, "RS_1": 0.2, "RC2_1": 0.1, "FS1": 0.2}
    chi = np.array([given.get(name, 0.0) for name in model.device.parameters.names])
    setup = bench.Setup(model, chi, bench.Controller((60.0,), (1.0,)))
    kind = bench.Multisine(1.5, (0.0,), (0.4,), speed=(2.0,), ramp=0.4)
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(1))
    found = bench.simulate(setup, trajectory, np.random.default_rng(2))
    motion = haptid.Motion(
        setup.dt, found.q, found.torque, haptid.Treatment(cutoff_hz=None), rates=(found.qd, found.qdd)
    )
    beta, (chunk,) = model.base.of(chi), chunks(model, motion)
    assert np.linalg.norm(chunk.residual(beta)) < 0.01 * np.linalg.norm(chunk.y)
    without = np.where([name in ("FG1", "FM1", "FT1", "RS_1", "RC2_1", "FS1") for name in model.base.names], 0, beta)
    assert np.linalg.norm(chunk.residual(without)) > 0.2 * np.linalg.norm(chunk.y)


def test_what_a_file_may_say(tmp_path):
    for term, found in (
        ("kind = 'dahl'\ndistance = 0.0", "found 0"),
        ("kind = 'maxwell-slip'\ndistances = []", "distances"),
        ("kind = 'lugre'\ndistance = 0.1\nvelocity = 0.1", "breakaway"),
        ("kind = 'warming'\ntime = -1", "found -1"),
        ("kind = 'ripple'\nperiod = 0", "found 0"),
        ("kind = 'dahl'\ndistance = { start = 0.1, low = 0.0, high = 1.0 }", "low"),
    ):
        with pytest.raises(errors.DeviceFileError, match=found):
            model_of(tmp_path, term)


def coulomb_fit(tmp_path, model, beta):
    """Search of actions on a motion of a model, fitted with Coulomb friction."""
    plain = model_of(tmp_path, "kind = 'coulomb'")
    motion = motion_of(model, beta, noise=0.05)
    made = haptid.estimate(haptid.observe(plain, motion), haptid.WLS())
    return search_of(plain, [motion], made.beta)


def test_advice_finds_presliding_where_it_is_and_not_where_it_is_not(tmp_path):
    model = model_of(tmp_path, "kind = 'dahl'\ndistance = 0.02")
    beta = np.array([{"FV": 0.4, "ZZ": 0.3}.get(name[:2], 0.8) for name in model.base.names])
    search = coulomb_fit(tmp_path, model, beta)
    base = search.base()
    first = in_order([(one, stated(search, base, one.trial)) for one in proven(search)])[0]
    assert first.candidate.kind == "presliding"
    assert 0.3 < first.settings[0]["distance"] / 0.02 < 3 if first.settings else True
    plain = model_of(tmp_path, "kind = 'coulomb'")
    assert not proven(coulomb_fit(tmp_path, plain, beta))


def test_methods_that_simulate_refuse(tmp_path):
    model = model_of(tmp_path, "kind = 'dahl'\ndistance = 0.05")
    motion = motion_of(model, np.full(len(model.base), 0.5), samples=2000)
    observation = haptid.observe(model, motion)
    for method in (OutputErrorMethod(), EKF()):
        with pytest.raises(errors.SettingError, match="FD1 depend on the motion before"):
            haptid.estimate(observation, method)


def test_code_has_the_friction_of_sliding(tmp_path):
    """The written self-test compares the compiled functions with this model's torque."""
    model = model_of(
        tmp_path,
        "kind = 'lugre'\ndistance = 0.02\nvelocity = 0.5\nbreakaway = 1.5",
        "kind = 'maxwell-slip'\ndistances = [0.05]",
        "kind = 'warming'\ntime = 0.5",
        "kind = 'ripple'\nperiod = 0.3",
    )
    export_c((model, np.linspace(0.3, 0.9, len(model.base))), tmp_path, CCode(NAME, "double", 0.01))
    run([compiler("gcc"), *STRICT, f"{NAME}.c", f"{NAME}_selftest.c", "-lm", "-o", "selftest"], tmp_path)
    run(["./selftest"], tmp_path)
