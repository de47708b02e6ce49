"""Several estimates: Welch's test against SciPy's, two of them as `compare` has it, drift found and nothing else."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.inference.comparison import Series, compare
from haptid.inference.drift import drift
from haptid.inference.targets import targets
from haptid.uncertainty.multiple_testing import johansen_p
from json_outputs import valid
from motions import motion
from sampling import of_share
from small_study import write_study

DEVICE = """
schema = 1
name = "two links"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
BETA = np.array([0.3, 0.9, 0.2, 0.08, 0.12, 0.4, 0.3, 0.25, 0.35, 0.2, 0.3, 0.1])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "device.toml"
    path.write_text(DEVICE)
    return haptid.DynamicModel(haptid.read_device(path))


def fitted(model, seed, method=None, seconds=8.0, **changed):
    """An estimate; `changed` is added to parameters by name."""
    beta = BETA[: len(model.base)].copy()
    for name, change in changed.items():
        beta[model.base.names.index(name)] += change
    made = motion(model, beta, seconds=seconds, dt=4e-3, seed=seed, noise=0.1, phi=0.8)
    return haptid.estimate(haptid.observe(model, made), method or haptid.WLS())


def series(value, se, dof=20.0, confidence=0.95):
    """Of a single parameter, or of columns of them."""
    value = np.atleast_2d(np.asarray(value, dtype=float).T).T
    se = np.broadcast_to(np.atleast_2d(np.asarray(se, dtype=float).T).T, value.shape)
    n, k = value.shape
    covariance = np.array([np.diag(np.where(np.isfinite(row), row, 1.0) ** 2) for row in se])
    labels, names = (tuple(f"{what}{i}" for i in range(size)) for what, size in (("r", n), ("p", k)))
    many = np.broadcast_to(np.asarray(dof, dtype=float).reshape(-1, 1), value.shape)
    return Series(labels, names, ("kg",) * k, value, se, many, covariance, confidence, ())


finite = st.floats(-5, 5)
positive = st.floats(0.2, 4)


@given(st.lists(st.tuples(st.integers(4, 30), finite, positive), min_size=2, max_size=6), st.integers(0, 1000))
def test_one_parameter_is_welchs_test_of_means(groups, seed):
    """Against SciPy's one-way analysis without equal variances."""
    rng = np.random.default_rng(seed)
    samples = [rng.normal(mean, se, n) for n, mean, se in groups]
    value = np.array([x.mean() for x in samples])
    se = np.array([np.std(x, ddof=1) / np.sqrt(len(x)) for x in samples])
    dof = np.array([len(x) - 1.0 for x in samples])
    oracle = stats.f_oneway(*samples, equal_var=False)
    assert series(value, se, dof).p[0] == pytest.approx(oracle.pvalue, rel=1e-8, abs=1e-300)


def test_two_estimates_are_compared_as_before(model):
    a, b = fitted(model, 1), fitted(model, 2, FV1=0.2)
    made, two = compare(a, b, labels=["a", "b"]), compare(a, b)
    np.testing.assert_allclose(made.holm, two.holm, rtol=1e-9)
    assert set(made.differs) == set(two.differs) == {"FV1"}
    np.testing.assert_array_equal(made.pair("a", "b").conf_int(), two.conf_int())
    lines = drift(made, [3.0, 5.0])
    np.testing.assert_allclose(lines.slope, two.difference / 2, rtol=1e-9)
    np.testing.assert_allclose(lines.conf_int(), two.conf_int() / 2, rtol=1e-9)
    np.testing.assert_allclose(lines.covariance, two.covariance / 4, rtol=1e-9)
    np.testing.assert_allclose(lines.p, two.p, rtol=1e-9)


@given(
    st.lists(st.tuples(st.floats(-9, 9), finite, positive), min_size=3, max_size=8),
    st.floats(0.1, 10),
    st.floats(-20, 20),
)
def test_a_line_is_numpys_and_does_not_know_its_clock(rows, scale, shift):
    t, value, se = np.array(rows).T
    if np.ptp(t) < 0.1:
        return
    made = drift(series(value, se, np.inf), t)
    fit, covariance = np.polyfit(t, value, 1, w=1 / se, cov="unscaled")
    np.testing.assert_allclose(made.slope[0], fit[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(made.se[0] ** 2, covariance[0, 0], rtol=1e-6)
    np.testing.assert_allclose(made.covariance[0, 0], covariance[0, 0], rtol=1e-6)
    other = drift(series(value, se, np.inf), scale * t + shift)
    np.testing.assert_allclose(other.slope * scale, made.slope, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(other.p, made.p, rtol=1e-6)


def test_slopes_have_their_interval_as_often_as_stated():
    """Deviations with ten degrees of freedom each, as drawn; the truth inside in 95 of 100, means and lines not
    found wanting in more than 5."""
    rng, runs, n, dof = np.random.default_rng(1), 3000, 5, 10
    t, true = np.array([0.0, 1.0, 2.0, 5.0, 6.0]), np.array([1.0, 2.0, 1.0, 0.5, 1.5])
    se = true[:, None] * np.sqrt(rng.chisquare(dof, (n, runs)) / dof)
    noise = true[:, None] * rng.standard_normal((n, runs))
    made = drift(series(0.3 * t[:, None] + noise, se, dof), t)
    inside = (made.conf_int()[:, 0] < 0.3) & (made.conf_int()[:, 1] > 0.3)
    # Satterthwaite's degrees of freedom are approximate: over 24000 draws the coverage was 94.5 (0.14) %.
    close = of_share(0.05, runs) + 0.005
    assert inside.mean() == pytest.approx(0.95, abs=close)
    level = np.mean(series(noise, se, dof).p < 0.05)
    assert level == pytest.approx(0.05, abs=close)
    ones = np.column_stack([np.ones(n), t])
    some = 1000
    bent = np.mean([johansen_p(noise[:, k], se[:, k], np.full(n, 10.0), ones) < 0.05 for k in range(some)])
    assert bent == pytest.approx(0.05, abs=of_share(0.05, some) + 0.005)


def test_a_drift_of_one_parameter_is_found_and_no_other(model):
    days, rate = [0.0, 1.0, 3.0, 7.0, 8.0], 0.05
    made = compare(*(fitted(model, 10 + k, FV1=rate * t) for k, t in enumerate(days)), labels=[f"d{t:g}" for t in days])
    assert made.differs == ("FV1",)
    lines = drift(made, days)
    assert lines.drifts == ("FV1",)
    assert lines.bent == ()
    k = made.names.index("FV1")
    assert lines.conf_int()[k, 0] < rate < lines.conf_int()[k, 1]
    assert lines.slope[k] == pytest.approx(rate, rel=0.3)
    assert "FV1 drifts by 0.0" in lines.summary()
    assert "in a day" in lines.summary()
    assert "FV1 differs: from 0." in made.summary()
    assert f"The other {len(made.names) - 1} do not differ" in made.summary()


def test_a_step_is_distinguished_from_a_drift():
    made = drift(series([0.0, 0.1, 10.0, 10.1], 0.2), [0, 1, 2, 3])
    assert made.bent == made.drifts == ("p0",)
    assert "Not linear in time at 95 % confidence for all 1 together: p0." in made.summary()


def test_what_one_block_alone_determines_counts_for_nothing():
    made = series([0.0, 0.1, 50.0, 0.2], [1.0, 1.0, np.inf, 1.0])
    assert not made.differs
    assert made.common[0] == pytest.approx(0.1)
    assert drift(made, [0, 1, 2, 3]).slope[0] == pytest.approx(np.polyfit([0, 1, 3], [0, 0.1, 0.2], 1)[0])
    alone = drift(series([0.0, 1.0], [1.0, np.inf]), [0, 1])
    assert np.isnan(alone.slope[0])
    assert alone.p[0] == 1.0
    assert not alone.drifts
    assert "No parameter drifts" in alone.summary()


def test_what_is_held_has_no_deviation_and_differs_where_it_differs():
    same, other = series([0.5, 0.5, 0.5], 0.0), series([0.5, 0.5, 0.6], 0.0)
    assert same.p[0] > 0.9
    assert other.differs == ("p0",)
    assert series([0.0, 0.0], 0.0).common[0] == 0.0
    assert series([0.0, 0.0], 0.0).p[0] == 1.0


def test_targets_are_compared_with_targets():
    phantom = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    made = [motion(phantom, phantom.prior_beta, seed=k, noise=0.05) for k in (1, 2, 3)]
    fits = [haptid.estimate(haptid.observe(phantom, one), haptid.WLS()) for one in made]
    found = compare(*(targets(fit) for fit in fits))
    assert found.names == targets(fits[0]).names
    assert found.labels == ("1", "2", "3")
    with pytest.raises(errors.ModelMismatchError):
        compare(fits[0], fits[2], targets(fits[1]))


def test_what_cannot_be_compared_is_rejected(model):
    a, b = fitted(model, 1), fitted(model, 2)
    for arguments, where, found in [
        (((a,), {}), "estimates", 1),
        (((a, b), {"labels": ["one"]}), "labels", 1),
        (((a, b), {"labels": ["one", "one"]}), "labels", 1),
        (((a, b), {"confidence": 95}), "confidence", 95),
    ]:
        with pytest.raises(errors.SettingError) as raised:
            compare(*arguments[0], **arguments[1])
        assert (raised.value.where, raised.value.found) == (where, found)
    with pytest.raises(errors.SharedRowsError):
        compare(a, b, a)
    made = compare(a, b, labels=["a", "b"])
    with pytest.raises(errors.SettingError) as raised:
        drift(made, [1, 2, 3])
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("times", 3, 2)
    for times in ([1.0, 1.0], [0.0, float("nan")]):
        with pytest.raises(errors.SettingError) as raised:
            drift(made, times)
        assert raised.value.where == "times"


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """Folders and estimates of two logs of the small study, each fitted by itself."""
    root = tmp_path_factory.mktemp("results")
    study = write_study(root).read_text()
    made = []
    for name, log in (("monday", "log.csv"), ("friday", "check.csv")):
        (root / f"{name}.toml").write_text(
            study.replace('path = "check.csv"\nrole = "validate"', "").replace("[[logs]]\n\n", "")
            .replace("log.csv", log).replace("[[logs]]\n[treatment]", "[treatment]")
        )  # fmt: skip
        (root / name).mkdir()
        found = haptid.identify(haptid.read_study(root / f"{name}.toml"))
        haptid.Result.of(found).save(root / name)
        made.append((root / name, found.estimate))
    return made


@pytest.fixture(scope="module")
def folders(identified):
    return [folder for folder, _ in identified]


def call(*arguments):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)])


def test_folders_are_compared_as_their_estimates_are(identified, folders):
    recorded = [haptid.Result.load(folder) for folder in folders]
    made = compare(*recorded, labels=["monday", "friday"])
    alike = compare(*(estimate for _, estimate in identified))
    assert made.differs == alike.differs
    np.testing.assert_allclose(made.holm, alike.holm, rtol=1e-9)
    np.testing.assert_array_equal(made.value, [one.unconstrained.values for one in recorded])
    two = compare(*recorded)
    np.testing.assert_allclose(two.holm, made.holm, rtol=1e-9)
    np.testing.assert_allclose(recorded[0].unconstrained.correlation.diagonal(), 1.0)
    with pytest.raises(errors.SharedRowsError) as raised:
        compare(recorded[0], recorded[0])
    assert raised.value.where == (recorded[0].blocks[0].log, 0.0)


def test_the_command_prints_tables_and_json(folders):
    done = call(*folders, "--times", "2026-03-02,2026-03-06T00:00:00+00:00")
    assert done.exit_code == 0, done.output
    for part in ("monday", "friday", "differs up to", "at 95 %", "drifts up to", "in a day"):
        assert part in done.output
    values = valid(
        "compare", call(*folders, "--times", "0, 4", "--unit", "week", "--confidence", "0.9", "--json").stdout
    )
    assert values["results"] == ["monday", "friday"]
    assert values["confidence"] == 0.9
    assert values["drift"]["unit"] == "week"
    dated = json.loads(call(*folders, "--times", "2026-03-02,2026-03-06", "--json").stdout)
    for one, other, both in zip(
        values["drift"]["parameters"], dated["drift"]["parameters"], values["parameters"], strict=True
    ):
        assert one["slope"] == pytest.approx(other["slope"], rel=1e-6)
        assert one["slope"] == pytest.approx((both["value"][1] - both["value"][0]) / 4, rel=1e-9)
    assert "drift" not in valid("compare", call(*folders, "--json").stdout)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--times", "yesterday,today"], "--times is 'yesterday'"),
        (["--times", "1"], "1 times are given for 2"),
        (["--confidence", "95"], "such as 0.95"),
    ],
)
def test_a_wrong_option_is_one_line(folders, arguments, said):
    done = call(*folders, *arguments)
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())


def test_one_result_alone_is_rejected(folders):
    done = call(folders[0])
    assert done.exit_code == 2
    assert "give 2 or more" in " ".join(done.output.split())


@pytest.mark.parametrize("dof", [3.0, 8.0])
def test_the_mean_of_two_weights_has_meiers_variance(dof):
    """A line through four values at two times is the difference of two weighted means (Meier 1953, eq. for two)."""
    value, se = np.array([0.0, 0.2, 1.0, 1.1]), np.array([1.0, 2.0, 0.5, 1.5])
    made = drift(series(value, se, dof), [0, 0, 1, 1])
    wanted = 0.0
    for pair in (se[:2], se[2:]):
        share = pair**-2 / (pair**-2).sum()
        wanted += (1 + 4 * np.sum(share * (1 - share)) / dof) / (pair**-2).sum()
    assert made.se[0] ** 2 == pytest.approx(wanted, rel=1e-9)
    assert made.covariance[0, 0] == pytest.approx(wanted, rel=1e-9)
