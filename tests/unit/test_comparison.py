"""Comparison of two estimates: no false difference, a true one is found, and the sentences state it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import haptid
from haptid import errors
from haptid.estimation.methods.constrained import PhysicallyConsistent
from haptid.inference.comparison import Comparison, compare
from haptid.inference.targets import targets
from motions import motion, truth


def fitted(model, beta, seed, other_model=None, method=None, **settings):
    made = motion(model, beta, seed=seed, **{"seconds": 12.0, "noise": 0.1, "phi": 0.95, **settings})
    return haptid.estimate(haptid.observe(other_model or model, made), method or haptid.WLS())


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def beta(model):
    return truth(model)


def comparison(first, second, se=1.0, dof=20.0, confidence=0.95):
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    sds, many = np.broadcast_to(np.asarray(se, dtype=float), first.shape), np.full(first.shape, dof)
    names = tuple(f"p{k}" for k in range(len(first)))
    variance = np.diag(2 * sds**2)
    units = ("kg",) * len(first)
    return Comparison(names, units, first, second, sds, sds, many, many, variance, confidence, ())


def test_one_parameter_is_welchs_test():
    """Against SciPy's, of two samples with unequal sizes and variances."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(0.0, 1.0, 9), rng.normal(0.8, 3.0, 23)
    se = [np.std(s, ddof=1) / np.sqrt(len(s)) for s in (x, y)]
    made = Comparison(
        ("a",), ("kg",), [x.mean()], [y.mean()], [se[0]], [se[1]], [8.0], [22.0], [[se[0]**2 + se[1]**2]], 0.9, ()
    )  # fmt: skip
    oracle = stats.ttest_ind(y, x, equal_var=False)
    assert made.p[0] == pytest.approx(oracle.pvalue, rel=1e-12)
    assert made.dof[0] == pytest.approx(oracle.df, rel=1e-12)
    low, high = oracle.confidence_interval(0.9)
    np.testing.assert_allclose(made.conf_int()[0], [low, high], rtol=1e-12)


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=12), st.sampled_from([0.9, 0.95, 0.99]))
def test_holm_rejects_step_by_step(differences, confidence):
    """By the steps of Holm (1979): the least p against 1/k of what is allowed, the next against 1/(k - 1), and on."""
    made = comparison(np.zeros(len(differences)), differences, confidence=confidence)
    rejected = set()
    for step, k in enumerate(np.argsort(made.p, kind="stable")):
        if made.p[k] * (len(differences) - step) >= 1 - confidence:
            break
        rejected.add(f"p{k}")
    assert set(made.differs) == rejected
    assert (made.holm >= made.p).all()
    assert (made.holm <= 1).all()


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=8), st.lists(st.floats(-50, 50), min_size=8, max_size=8))
def test_exchanging_the_two_changes_signs_only(first, second):
    there, back = comparison(first, second[: len(first)]), comparison(second[: len(first)], first)
    np.testing.assert_array_equal(there.holm, back.holm)
    np.testing.assert_array_equal(there.difference, -back.difference)
    assert there.flipped == back.flipped


def test_a_sign_flips_where_both_values_are_distinguished_from_zero():
    made = comparison([-10.0, 10.0, -0.5, -10.0, 10.0], [10.0, 20.0, 9.0, 30.0, 10.5])
    assert made.differs == ("p0", "p1", "p2", "p3")
    assert made.flipped == ("p0", "p3")
    text = made.summary()
    assert "p0 changes its sign, from -10 to 10 kg" in text
    assert "its magnitude does not differ" in text
    assert "p3 changes its sign, from -10 to 30 kg" in text
    assert "its magnitude differs too" in text
    assert "p1 changes from 10 to 20 kg" in text
    assert "+100 %" in text
    assert "The other 1 do not differ at 95 % confidence for all 5 together." in text


def test_nothing_can_be_found_of_a_parameter_that_one_block_alone_determines():
    made = comparison([0.0, 0.0], [50.0, 50.0], se=[1.0, np.inf])
    assert made.differs == ("p0",)
    assert made.p[1] == 1.0
    assert np.isfinite(made.dof).all()


def test_the_same_device_differs_in_about_one_comparison_of_twenty(model, beta):
    runs = 60
    pairs = ((fitted(model, beta, 2 * k), fitted(model, beta, 2 * k + 1, seconds=9.0)) for k in range(runs))
    found = sum(bool(compare(targets(a), targets(b)).differs) for a, b in pairs)
    assert found <= stats.binom.ppf(0.999, runs, 0.05)


def test_a_tool_at_the_end_of_the_forearm_is_found_and_nothing_else(model, beta):
    """20 g at the tip: eq. (4) says by how much each pi must change."""
    mass, L1, L2 = 0.020, model.device.lengths["L1"], model.device.lengths["L2"]
    chi = np.zeros(len(model.device.parameters))
    for kind, value in (("YY", L2**2), ("ZZ", L2**2), ("MX", L2), ("M", 1.0)):
        chi[model.device.parameters.index[f"{kind}a"]] = mass * value
    bare, loaded = fitted(model, beta, 1), fitted(model, beta + model.base.of(chi), 2)
    made = compare(targets(bare), targets(loaded))
    changed = {"pi_1": (L1**2 + L2**2) / 2, "pi_2": L1**2 / 2, "pi_3": -(L2**2) / 2, "pi_4": 2 * L1 * L2,
               "pi_5": L1**2, "pi_6": L2**2, "pi_7": 9.81 * L1, "pi_8": 9.81 * L2}  # fmt: skip
    assert set(made.differs) <= set(changed)
    assert {"pi_1", "pi_4", "pi_5", "pi_6", "pi_7", "pi_8"} <= set(made.differs)
    wanted = np.array([mass * changed.get(name, 0.0) for name in made.names])
    inside = (made.conf_int()[:, 0] < wanted) & (wanted < made.conf_int()[:, 1])
    assert inside.sum() >= 12
    np.testing.assert_allclose(made.covariance, targets(bare).covariance + targets(loaded).covariance)


def test_upside_down_with_the_file_unchanged_only_gravity_flips(model, beta):
    """What the paper did: one model, c2 and s3 its gravity columns, a log from the device hung upside-down."""
    down = model.with_gravity(-model.device.gravity)
    made = compare(targets(fitted(model, beta, 1)), targets(fitted(down, beta, 2, other_model=model)))
    assert set(made.differs) == set(made.flipped) == {"pi_7", "pi_8"}
    assert "pi_8 changes its sign" in made.sentences[0]
    assert "its magnitude does not differ" in made.sentences[0]


def test_upside_down_with_the_gravity_given_nothing_differs(model, beta):
    down = model.with_gravity(-model.device.gravity)
    made = compare(targets(fitted(model, beta, 1)), targets(fitted(down, beta, 2)))
    assert not made.differs
    assert made.sentences == ("No parameter differs at 95 % confidence for all 14 together.",)


def test_base_parameters_are_compared_where_they_regroup_alike(model, beta):
    """The general file has more base parameters; those of one name that regroup otherwise are another thing."""
    general = haptid.DynamicModel(haptid.read_device("phantom_premium_15_general"))
    a, b = fitted(model, beta, 1), fitted(general, truth(general), 2, seconds=20.0)
    made = compare(a, b)
    shared = {n for n in model.base.names if n in general.base.names}
    assert {"FV1", "FC3", "ZZbeR"} <= set(made.names) <= shared
    (note,) = [note for note in made.notes if note.startswith("Not compared")]
    for name in set(general.base.names) - set(made.names):
        assert name in note


def test_the_free_fit_of_a_constrained_estimate_is_compared(model, beta):
    negative = beta.copy()
    negative[model.base.names.index("FV1")] = -5e-3
    held = fitted(model, negative, 1, method=PhysicallyConsistent())
    other = fitted(model, negative, 2)
    for made in (compare(held, other), compare(targets(held), targets(other))):
        assert not made.differs
        assert made.first[made.units.index("N m s/rad")] < 0
        assert "Constraints are active in the first estimate: its unconstrained fit is compared." in made.notes


def test_single_block_parameters_are_named(model, beta):
    a, b = fitted(model, beta, 1), fitted(model, beta, 2)
    made = compare(a, replace(b, quantities=replace(b.quantities, unbounded=(8,))))
    assert made.p[8] == 1.0
    (note,) = made.notes
    assert note.startswith("FV1 excited in a single time block of the second estimate")


def test_estimates_that_share_rows_are_rejected(model, beta):
    a = fitted(model, beta, 1)
    with pytest.raises(errors.SharedRowsError):
        compare(a, haptid.estimate(a.observation, haptid.OLS()))


def test_halves_of_one_log_rarely_differ(model, beta):
    """By chance in one of twenty."""
    found = 0
    for seed in range(1, 21):
        halves = fitted(model, beta, seed).observation.alternate()
        found += bool(compare(*(haptid.estimate(half, haptid.WLS()) for half in halves), joint=False).differs)
    assert found <= 4


def test_estimates_without_a_common_parameter_are_rejected(model, beta):
    a, b = fitted(model, beta, 1), fitted(model, beta, 2)
    for one, other in ((a, targets(b)), (targets(a), targets(b).in_command())):
        with pytest.raises(errors.ModelMismatchError):
            compare(one, other)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95, float("nan")])
def test_a_confidence_is_between_none_and_all(model, beta, confidence):
    a = fitted(model, beta, 1)
    with pytest.raises(errors.SettingError) as raised:
        compare(a, a, confidence=confidence)
    assert (raised.value.where, raised.value.limit) == ("confidence", (0, 1))


def test_a_first_value_of_zero_has_no_share():
    made = comparison([0.0], [50.0])
    assert made.differs == made.names
    assert "changes from 0 to 50" in made.summary()
    assert "(p = 0.0e+00), " not in made.summary()
