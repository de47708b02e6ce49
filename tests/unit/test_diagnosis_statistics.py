"""The statistics under a diagnosis, against closed forms and against doing it the long way."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import haptid
from haptid.inference.diagnosis.excitation import dependencies
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, joined_names, worst
from haptid.inference.diagnosis.influence import deletions
from haptid.inference.diagnosis.lack_of_fit import fourier_sums, wild_bootstrap
from haptid.inference.diagnosis.residuals import (
    autocorrelation,
    autocorrelation_time,
    block_jackknife,
    half_power,
    outliers,
    portmanteau,
    serial_correlation,
    standardised,
    thinned,
    whiteness,
)
from haptid.observation.plan import Block
from haptid.uncertainty.multiple_testing import holm_adjusted
from motions import motion, truth
from sampling import FAR, of_mean, of_share


def coloured(n, phi, rng):
    white = rng.standard_normal(n + 1000)
    made = np.zeros(n + 1000)
    for k in range(1, n + 1000):
        made[k] = phi * made[k - 1] + white[k]
    return made[1000:]


@given(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=8))
def test_holm_rejects_what_the_step_down_procedure_rejects(p):
    corrected = holm_adjusted(np.array(p))
    rejected = set()
    for step, k in enumerate(np.argsort(p, kind="stable")):
        if p[k] > 0.05 / (len(p) - step):
            break
        rejected.add(int(k))
    assert rejected == {k for k in range(len(p)) if corrected[k] <= 0.05}


def test_a_finding_cannot_be_changed_and_the_worst_status_wins():
    finding = Finding("a", "ok", {"p": np.float64(0.5)}, "Nothing.")
    with pytest.raises(TypeError):
        finding.figures["p"] = 0.1
    assert worst(["ok", "bad", "doubt"]) == "bad"
    assert worst([]) == "ok"
    assert joined_names(["a", "b", "c"]) == "a, b and c"
    assert joined_names(list("abcdef")) == "a, b, c, d and 2 more"


def test_memory_of_autoregressive_noise_is_its_closed_form():
    rng = np.random.default_rng(0)
    for phi in (0.0, 0.5, 0.8):
        found = np.array([autocorrelation_time(coloured(4000, phi, rng)) for _ in range(20)])
        wanted = (1 + phi) / (1 - phi)
        # The estimate is biased: over 200 draws by 4, 3 and 8 (2) % with these phi.
        assert found.mean() == pytest.approx(wanted, abs=of_mean(found) + 0.08 * wanted)


def test_half_of_the_power_of_autoregressive_noise_is_below_its_closed_form():
    rng = np.random.default_rng(1)
    for phi in (0.0, 0.6):
        # The spectrum's integral is atan((1 + phi) / (1 - phi) tan(pi f)), half of it where that is pi / 4.
        wanted = np.arctan((1 - phi) / (1 + phi)) / np.pi
        found = np.array([half_power(coloured(3000, phi, rng), 1.0) for _ in range(10)])
        assert found.mean() == pytest.approx(wanted, abs=of_mean(found))


def test_the_portmanteau_statistic_is_that_of_ljung_and_box_and_gaps_are_left_out():
    e = np.random.default_rng(2).standard_normal(300)
    x, n = e - e.mean(), len(e)
    rho = [x[k:] @ x[:-k] / (x @ x) for k in range(1, 11)]
    wanted = n * (n + 2) * sum(r**2 / (n - k) for k, r in enumerate(rho, start=1))
    assert portmanteau(e)[0] == pytest.approx(wanted)
    split = np.concatenate([e[:150], np.full(50, np.nan), e[150:]])
    pairs = autocorrelation(split, 10)[1]
    assert pairs[0] == 300
    assert pairs[3] == 2 * 147


def test_whiteness_keeps_its_level_with_rows_missing():
    rng = np.random.default_rng(3)
    p = []
    for _ in range(400):
        e = rng.standard_normal(300)
        e[rng.integers(0, 250) :][:40] = np.nan
        p.append(portmanteau(e)[1])
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=of_share(0.05, len(p)))


@pytest.mark.parametrize(("logs", "longer"), [(1, True), (20, False)])
def test_longer_blocks_are_advised_where_a_log_has_enough_of_them(logs, longer):
    """Of a log of 57 s blocks of 23.4 s were to be written, which a study then shortened to what it had."""
    rng, times = np.random.default_rng(6), range(400)
    blocks = [Block(f"{k % logs}", float(k), k + 1.0) for k in times]
    left = SimpleNamespace(e=[coloured(40_000, 0.98, rng)], filter_stride=1, step=0.01, labels=("motor 1",))
    found = whiteness(SimpleNamespace(observation=SimpleNamespace(blocks=blocks)), left)
    assert found.status == "bad"
    assert ("write block_s" in found.sentence) == longer
    assert ("record longer" in found.sentence) != longer


def test_durbin_watson_is_two_for_white_rows_and_less_for_those_that_remember():
    rng = np.random.default_rng(4)
    for phi in (0.0, 0.5):
        # 2 (1 - r), and the deviation of a first autocorrelation is sqrt((1 - phi^2) / n).
        found = serial_correlation(coloured(3000, phi, rng), 1, 1.0).durbin_watson
        assert found == pytest.approx(2 * (1 - phi), abs=2 * FAR * np.sqrt((1 - phi**2) / 3000))


def test_variance_proportions_are_the_parts_of_the_inverse():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((50, 4))
    A[:, 3] = A[:, 0] + 1e-3 * rng.standard_normal(50)
    R = np.linalg.qr(A * [1.0, 10.0, 0.1, 5.0], mode="r")
    table = dependencies(R)
    scaled = R / np.linalg.norm(R, axis=0)
    singular = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(table.index, singular[0] / singular)
    np.testing.assert_allclose(table.proportions.sum(axis=0), 1.0)
    parts = (table.directions / singular[:, None]) ** 2
    np.testing.assert_allclose(parts.sum(axis=0), np.diag(np.linalg.inv(scaled.T @ scaled)))
    assert set(np.flatnonzero(table.proportions[-1] > 0.9)) == {0, 3}


def test_regression_by_blocks_leaves_out_each_block():
    rng = np.random.default_rng(6)
    X, block = rng.standard_normal((200, 2)), np.repeat(np.arange(10), 20)
    y = X @ [1.0, -2.0] + rng.standard_normal(200)
    found = block_jackknife(X, y, block)
    whole = np.linalg.lstsq(X, y, rcond=None)[0]
    left = np.array([np.linalg.lstsq(X[block != b], y[block != b], rcond=None)[0] for b in range(10)])
    np.testing.assert_allclose(found.values, whole)
    np.testing.assert_allclose(found.se, np.sqrt(0.9 * ((left - whole) ** 2).sum(axis=0)))
    assert block_jackknife(X[:40], y[:40], block[:40]) is None


def test_deletions_are_what_refitting_without_each_block_gives():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    observation = haptid.observe(model, motion(model, truth(model), seconds=9.0, noise=0.1, phi=0.9))
    made = haptid.estimate(observation, haptid.OLS())
    index = np.arange(len(observation.blocks))
    wanted = [haptid.estimate(observation.pick(index[index != b]), haptid.OLS()).beta - made.beta for b in index]
    np.testing.assert_allclose(deletions(made).shift, wanted, rtol=1e-6, atol=1e-12)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 100))
def test_a_ripple_is_found_at_its_period(seed):
    rng = np.random.default_rng(seed)
    x = np.sin(np.linspace(0, 40, 4000)) + 0.4 * np.sin(np.linspace(0, 97, 4000))
    e, block = rng.standard_normal(4000), np.repeat(np.arange(40), 100)
    f, sums = fourier_sums(x, e + 0.5 * np.sin(2 * np.pi * x / 0.1 + 1.0), block)
    p, at = wild_bootstrap(sums)
    assert p < SIGNIFICANCE
    assert 1 / f[at] == pytest.approx(0.1, rel=0.1)


def test_no_ripple_is_found_in_noise_that_remembers():
    rng = np.random.default_rng(7)
    x, block = np.sin(np.linspace(0, 40, 2000)), np.repeat(np.arange(40), 50)
    p = [wild_bootstrap(fourier_sums(x, coloured(2000, 0.8, rng), block)[1])[0] for _ in range(60)]
    assert np.mean(np.array(p) < 0.05) < 0.17


def test_wild_rows_are_those_that_a_normal_residual_hardly_has():
    rng = np.random.default_rng(8)
    e = rng.standard_normal(2000)
    assert stats.iqr(standardised(e)) == pytest.approx(1.349, rel=0.1)
    assert outliers(e, 2000).sum() <= 1
    e[[100, 700]] = [9.0, -12.0]
    assert set(np.flatnonzero(outliers(e, 2000))) == {100, 700}
    assert len(thinned(e, 10, np.ones(len(e), dtype=bool))) <= 200
