"""Exciting motions: what is promised of them is so, limits hold by another check, and files keep them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.dynamics.regressor import rows
from haptid.experiment import bench
from haptid.experiment.excitation import (
    AverageVariance,
    Coupling,
    FourierSeries,
    Information,
    LargestDeviation,
    Limits,
    RawCondition,
    ScaledCondition,
    Search,
    TrianglesWithSines,
    design_excitation,
    observed_motion,
    quality,
    search,
    write_experiment,
)
from motions import truth
from sampling import of_deviation
from true_parameters import true_parameters

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "phantom" / "experiment.toml"
PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
BETA = truth(PHANTOM)
WITHIN = Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0, 3.0, 3.0))
SHORT = Search(tries=150, seed=3)
FAMILIES = [FourierSeries(8.0, 0.2, 4), TrianglesWithSines(8.0)]


@pytest.fixture(scope="module")
def found():
    return design_excitation(PHANTOM, FAMILIES[0], WITHIN, beta=BETA, noise=(0.002,), search=SHORT)


def test_the_finalist_of_least_rank_is_returned():
    """The second best by the criterion, of another valley, as it is ranked first."""
    asked = []

    def rank(planned):
        asked.append(planned.kind)
        return abs(len(asked) - 2)

    settings = Search(tries=400, seed=3)
    found = design_excitation(PHANTOM, FAMILIES[0], WITHIN, beta=BETA, search=settings, rank=rank)
    assert len(asked) > 1
    assert found.kind == asked[1]
    assert found.kind != design_excitation(PHANTOM, FAMILIES[0], WITHIN, beta=BETA, search=settings).kind


@pytest.mark.parametrize("idle", [1, 1000])
def test_a_search_restarts_where_moves_bring_nothing(monkeypatch, idle):
    started = []

    class Counted(FourierSeries):
        def start(self, bounds, rng):
            started.append(1)
            return super().start(bounds, rng)

    monkeypatch.setattr(search, "_IDLE", idle)
    design_excitation(PHANTOM, Counted(8.0, 0.2, 4), WITHIN, beta=BETA, search=Search(tries=500, seed=3))
    assert (len(started) > search.STARTS) == (idle == 1)


def explicit(trajectory):
    """W, all motors' rows one above the other."""
    W = rows(PHANTOM, *(np.ascontiguousarray(x.T) for x in (trajectory.q, trajectory.qd, trajectory.qdd)))
    S = PHANTOM.device.parameters.S[:, list(PHANTOM.base.independent_columns)]
    return np.einsum("apk,pb->akb", W, S)


def test_quality_is_that_of_the_stored_matrix(found):
    made = found.trajectory(0.04)
    noise, columns = np.array([0.001, 0.002, 0.004]), tuple(range(1, len(BETA)))
    one = quality(observed_motion(PHANTOM, made), columns, BETA, noise)
    W = explicit(made)[:, :, 1:]
    stacked = W.reshape(-1, len(columns))
    assert one.raw == pytest.approx(np.linalg.cond(stacked), rel=1e-8)
    assert one.scaled == pytest.approx(np.linalg.cond(stacked / np.linalg.norm(stacked, axis=0)), rel=1e-8)
    weighted = (W / noise[:, None, None]).reshape(-1, len(columns))
    covariance = np.linalg.inv(weighted.T @ weighted)
    sizes = np.abs(BETA[1:])
    np.testing.assert_allclose(one.relative_se, 100 * np.sqrt(np.diag(covariance)) / sizes, rtol=1e-6)
    _, logdet = np.linalg.slogdet((weighted * sizes).T @ (weighted * sizes) / one.rows)
    assert one.information == pytest.approx(logdet, rel=1e-9)
    assert AverageVariance().cost(one) == pytest.approx(0.5 * np.log((one.relative_se**2).mean()))
    assert LargestDeviation().cost(one) == pytest.approx(np.log(one.relative_se.max()))
    assert Information().cost(one) == pytest.approx(-0.5 * logdet / len(columns))


def test_promised_deviations_come_true(found):
    """Noise of the promised size on the promised rows scatters the least-squares solution as promised."""
    made = found.trajectory(1 / SHORT.rows_hz)
    W = explicit(made).reshape(-1, len(BETA))
    inverse, rng = np.linalg.pinv(W), np.random.default_rng(0)
    scatter = (inverse @ (0.002 * rng.standard_normal((len(W), 400)))).std(axis=1)
    np.testing.assert_allclose(100 * scatter / np.abs(BETA), found.after.relative_se, rtol=of_deviation(400))
    assert list(found.predicted) == list(PHANTOM.base.names)


@pytest.mark.parametrize(
    ("family", "criterion"),
    [
        *((FAMILIES[0], criterion) for criterion in (ScaledCondition(), RawCondition(), Information())),
        (FAMILIES[1], LargestDeviation()),
    ],
    ids=lambda either: type(either).__name__,
)
def test_search_improves_and_the_bench_accepts_what_it_finds(family, criterion):
    wanted = replace(WITHIN, torque=(0.5,), couplings=(Coupling((0.0, 1.0, -1.0), -0.7, 0.7),))
    made = design_excitation(PHANTOM, family, wanted, criterion=criterion, beta=BETA, search=SHORT)
    assert criterion.cost(made.after) < criterion.cost(made.before)
    fine = made.trajectory(1e-3)
    bench.check_trajectory(PHANTOM, fine, true_parameters(PHANTOM))
    for x, (low, high) in zip(fine.q.T, WITHIN.position, strict=True):
        assert low <= x.min() <= x.max() <= high
    assert np.abs(fine.qd).max() < 3.0
    assert np.abs(fine.q[:, 1] - fine.q[:, 2]).max() < 0.7
    tau = haptid.inverse_dynamics(PHANTOM, BETA, fine.q.T, fine.qd.T, fine.qdd.T)
    assert np.abs(tau).max() < 0.5


def test_one_seed_is_one_motion(found):
    seen = []
    same = design_excitation(
        PHANTOM, FAMILIES[0], WITHIN, beta=BETA, noise=(0.002,), search=SHORT, progress=lambda *at: seen.append(at)
    )
    assert same.kind == found.kind
    assert same.tried <= SHORT.tries
    assert same.tried <= len(seen) <= same.tried + 1
    assert seen[-1][0] == 1.0
    assert seen[-1][1] == pytest.approx(Information().cost(same.after) - np.log(same.after.rows) / 2, abs=1e-6)
    assert same.history[-1][1] == seen[-1][1]
    assert [cost for _, cost in same.history] == sorted((cost for _, cost in same.history), reverse=True)


def test_only_the_parameters_that_count():
    names = ("FC1", "FC2", "FC3")
    made = design_excitation(PHANTOM, FAMILIES[0], WITHIN, columns=names, beta=BETA, search=replace(SHORT, tries=60))
    assert made.after.names == names
    assert made.after.scaled < 3
    assert "FC2" in made.summary()
    assert "3 parameters" in made.summary()


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: type(family).__name__)
def test_file_is_the_motion(family, tmp_path):
    made = design_excitation(PHANTOM, family, WITHIN, beta=BETA, search=replace(SHORT, tries=40))
    like = bench.read_experiment(EXAMPLE)
    read = bench.read_experiment(write_experiment(tmp_path / "excite.toml", made, like))
    phases = np.random.default_rng(np.random.SeedSequence(read.seed).spawn(2)[0])
    again = bench.plan(read.kind, PHANTOM, 1e-2, phases)
    np.testing.assert_array_equal(again.q, made.trajectory(1e-2).q)
    rest = {"seed", "trajectory"}
    assert read.table.model_dump(exclude=rest) == like.table.model_dump(exclude=rest)


def test_example_of_many_tables_is_kept(tmp_path, found):
    like = bench.read_experiment(EXAMPLE.parents[1] / "cea" / "experiment.toml")
    read = bench.read_experiment(write_experiment(tmp_path / "excite.toml", found, like))
    assert read.table.bodies == like.table.bodies
    assert read.table.parameters == like.table.parameters


def test_what_cannot_be_searched(tmp_path, found):
    with pytest.raises(errors.IncompleteDeviceError, match="range of positions"):
        design_excitation(haptid.DynamicModel(haptid.read_device("cea_medical_branch")), FAMILIES[0])
    with pytest.raises(errors.IncompleteDeviceError, match="maximum speed"):
        design_excitation(
            haptid.DynamicModel(haptid.read_device("cea_medical_branch")),
            FAMILIES[0],
            Limits(position=((-1.0, 1.0),) * 3),
        )
    short = replace(SHORT, tries=20)
    with pytest.raises(errors.TrajectoryError) as raised:
        design_excitation(PHANTOM, FAMILIES[0], replace(WITHIN, torque=(1e-3,)), beta=BETA, search=short)
    assert raised.value.where.startswith("the torque")
    with pytest.raises(errors.UnknownNameError, match="ZZ9R"):
        design_excitation(PHANTOM, FAMILIES[0], WITHIN, columns=("ZZ9R",))
    with pytest.raises(errors.SettingError) as raised:
        Search(tries=0)
    assert raised.value.where == "tries"
    with pytest.raises(errors.ExperimentError) as raised:
        design_excitation(PHANTOM, FAMILIES[0], replace(WITHIN, speed=(1.0, 2.0)))
    assert (raised.value.where, raised.value.found) == ("speed", 2)
    with pytest.raises(errors.OutputFolderError):
        write_experiment(tmp_path / "no" / "file.toml", found, bench.read_experiment(EXAMPLE))


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"speed": (3.0, 0.0, 3.0)}, "speed of joint be has to be above 0; found 0"),
        ({"acceleration": (-1.0,)}, "acceleration of joint ba has to be above 0; found -1"),
        ({"jerk": (float("nan"),)}, "jerk of joint ba has to be above 0; found nan"),
        ({"position": ((-0.8, 0.8), (0.2, 0.2), (-0.3, 0.9))}, "no room to move: its positions go from 0.2 to 0.2"),
        ({"handle_force": 0.0}, "handle_force has to be above 0; found 0"),
    ],
)
def test_limits_without_room_are_one_sentence(limit, words):
    with pytest.raises(errors.SettingError, match=words):
        design_excitation(PHANTOM, FAMILIES[0], replace(WITHIN, **limit), beta=BETA, search=SHORT)


@pytest.mark.parametrize(
    ("sine", "cosine", "what"),
    [(((1.0,),) * 2, ((1.0,),) * 2, "sine"), (((1.0,),) * 3, ((1.0, 2.0),) * 3, "cosine")],
)
def test_series_that_do_not_fit(sine, cosine, what):
    with pytest.raises(errors.ExperimentError, match=what):
        bench.plan(bench.Fourier(5.0, (0.0,), 0.2, sine, cosine), PHANTOM, 0.01, np.random.default_rng(0))
