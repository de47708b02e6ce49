"""Joint tests: HTZ degrees of freedom and Hotelling's test against their definitions, size, a payload found, misfit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

import haptid
import small_study
from haptid.cli import app
from haptid.estimation.intervals.clusters import Clusters, alike
from haptid.inference.comparison import compare
from haptid.inference.joint_tests import named_directions, randomised
from haptid.inference.misfit import clusters_with_misfit
from motions import motion
from small_study import write_study
from true_parameters import true_parameters

SECONDS, DT = 16.0, 2e-2


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("arm3"))


def fitted(model, beta, seed, noise=0.5, extra=0.0, seconds=SECONDS):
    made = motion(model, beta, seconds=seconds, dt=DT, seed=seed, noise=noise, phi=0.5)
    if extra:  # Stribeck friction that the model lacks
        speed = made.rates[0] @ model.device.row_map.T
        size = extra * np.sqrt((made.tau**2).mean(axis=0))
        slow = 0.3 * np.sqrt((speed**2).mean(axis=0))
        made = replace(made, tau=made.tau + size * np.sign(speed) * np.exp(-((speed / slow) ** 2)))
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


def loaded(model, mass):
    """Parameters with a mass 15 cm along the last link."""
    chi, link = true_parameters(model), model.device.joint_names[-1]
    for kind, amount in {"M": 1.0, "MX": 0.15, "YY": 0.15**2, "ZZ": 0.15**2}.items():
        if kind + link in model.device.parameters.names:
            chi[model.device.parameters.index[kind + link]] += mass * amount
    return model.base.of(chi)


@pytest.fixture(scope="module")
def pairs(model):
    """Comparisons of logs of one device."""
    beta = loaded(model, 0.0)
    return [compare(fitted(model, beta, 2 * k), fitted(model, beta, 2 * k + 1)) for k in range(8)]


def clusters(seed=0, blocks=20, k=4):
    """Blocks of white rows, and their rows."""
    rng = np.random.default_rng(seed)
    W = rng.normal(size=(blocks, 6, k)) * rng.uniform(0.3, 3.0, (blocks, 1, k))
    whole = W.reshape(-1, k)
    root = np.linalg.inv(np.linalg.cholesky(whole.T @ whole).T)
    U = W @ root
    y = rng.normal(size=(blocks, 6))
    e = y - U @ np.einsum("bij,bi->j", U, y)
    made = Clusters(root, U.transpose(0, 2, 1) @ U, np.einsum("bij,bi->bj", U, e), np.zeros((0, k)), np.zeros((0, k)))
    return made, U


def test_one_direction_has_satterthwaites_freedom(model):
    made = fitted(model, loaded(model, 0.0), 3)
    for k in (0, len(made.beta) - 1):
        assert made.clusters.freedom(np.eye(len(made.beta))[[k]]) == pytest.approx(made.dof[k], rel=0.05)
    np.testing.assert_allclose(made.clusters.covariance(np.eye(len(made.beta))), made.covariance, rtol=1e-8)


def test_htz_freedom_is_that_of_simulated_covariances():
    """Law: q (q + 1) over the sum of the variances of the entries, with white rows simulated."""
    made, U = clusters()
    C = np.eye(4)[:2]
    own = np.linalg.solve(np.linalg.cholesky(C @ made.root @ made.root.T @ C.T), C)
    rng, drawn = np.random.default_rng(1), []
    for _ in range(1000):
        y = rng.normal(size=U.shape[:2])
        e = y - U @ np.einsum("bij,bi->j", U, y)
        drawn.append(
            Clusters(made.root, made.G, np.einsum("bij,bi->bj", U, e), made.shifts, made.misfit_shifts).covariance(own)
        )
    assert np.mean(drawn, axis=0) == pytest.approx(np.eye(2), abs=0.1)
    assert made.freedom(C) == pytest.approx(6 / np.var(drawn, axis=0).sum(), rel=0.2)


def test_two_single_values_have_welchs_test(pairs):
    """Law: of one direction the joint test is the single one."""
    one = pairs[0]
    t = one.joint.tests[0]
    assert t.dof[0] == t.directions
    assert t.p == pytest.approx(stats.f.sf(t.F, *t.dof))
    assert t.distance > 0
    power = stats.ncf.sf(stats.f.isf(0.05 / len(one.joint.tests), *t.dof), *t.dof, t.detectable**2)
    assert power == pytest.approx(0.8, abs=1e-6)


def test_nothing_differs_between_logs_of_one_device(pairs):
    """Size: 8 comparisons of 6 groups at 5 %; 10 and more rejections have a probability below 1e-3."""
    p = np.array([[test.p for test in one.joint.tests] for one in pairs])
    assert p.shape[1] >= 5
    assert (p < 0.05).sum() < 10
    assert np.mean([one.joint.equality < 0.05 for one in pairs]) < 0.5


def test_a_payload_is_found_that_single_parameters_miss(model):
    found = [
        compare(fitted(model, loaded(model, 0.0), 50 + k), fitted(model, loaded(model, 0.205), 80 + k)) for k in (0, 1)
    ]
    for one in found:
        assert "payload on link 3" in one.joint.differs
        assert one.joint.equality < 0.05
        assert any("payload on link 3" in sentence for sentence in one.sentences)
    jointly = sum(len(one.joint.differs) for one in found)
    assert jointly > sum(len(one.differs) for one in found)


def test_a_payload_for_which_short_logs_have_no_test_is_said_to_show_on_others(model):
    """Of a payload on the last link a sentence named the link before it, and no more."""
    short = [fitted(model, loaded(model, mass), 9 + k, seconds=8.0) for k, mass in enumerate((0.0, 0.2))]
    found = compare(*short)
    assert "payload on link 3" not in [test.name for test in found.joint.tests]
    (line,) = (line for line in found.sentences if line.startswith("Not tested: payload on link 3"))
    assert line.endswith("A payload there shows on other links too.")
    assert not any(line.endswith("too.") for line in found.sentences if "at rest" in line)


def test_a_payload_moves_its_own_direction(model):
    """The combinations of a link see a body on it, and there are as many as the body has effects."""
    own = [fitted(model, loaded(model, 0.0), k).clusters for k in (1, 2)]
    groups = dict(named_directions(model, own))
    change = loaded(model, 0.2) - loaded(model, 0.0)
    size = np.sqrt(np.diag(sum(one.root @ one.root.T for one in own)))
    C = groups["payload on link 3"]
    whole = change @ np.linalg.solve(sum(one.root @ one.root.T for one in own), change)
    assert np.sum((C @ change) ** 2) > 0.9 * whole
    assert np.linalg.matrix_rank(C * size) == len(C) <= 4
    assert {"torque at rest", "friction of motor 1"} <= set(groups)


def test_other_friction_is_no_payload(model):
    """Friction of one joint that changes was a payload too: in 7 of 18 comparisons of an arm with 10 % more."""
    own = [fitted(model, loaded(model, 0.0), k).clusters for k in (1, 2)]
    rubs = [k for k, name in enumerate(model.base.names) if name[:2] in ("FC", "FV")]
    for name, C in named_directions(model, own):
        if name.startswith("payload"):
            assert np.abs(C[:, rubs]).max() < 1e-9 * np.abs(C).max()
    beta = loaded(model, 0.0)
    more = beta.copy()
    more[rubs] *= 20
    for k in (60, 61, 62):
        found = compare(fitted(model, beta, k, noise=0.1), fitted(model, more, 30 + k, noise=0.1)).joint.differs
        assert any(name.startswith("friction") for name in found)
        assert not any(name.startswith("payload") for name in found)


def test_a_device_without_friction_has_directions_too(tmp_path):
    text = small_study.DEVICE.split("[[terms]]")[0]
    (tmp_path / "device.toml").write_text(text)
    bare = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    own = [fitted(bare, bare.base.of(true_parameters(bare)), k).clusters for k in (1, 2)]
    assert {name for name, _ in named_directions(bare, own)} == {
        "payload on link 1", "payload on link 2", "torque at rest",
    }  # fmt: skip


def test_errors_of_the_model_widen_the_comparison(model):
    beta = loaded(model, 0.0)
    right = np.array([fitted(model, beta, k).clusters.misfit for k in range(4)])
    wrong = np.array([fitted(model, beta, k, noise=0.02, extra=0.3).clusters.misfit for k in range(4)])
    assert (right >= 1).all()
    assert np.median(wrong) > 1.2 * np.median(right)
    pairs = [[fitted(model, beta, 2 * k + j, 0.02, 0.3) for j in (0, 1)] for k in range(4)]
    widened = [compare(*pair) for pair in pairs]
    assert sum(len(one.differs) for one in widened) <= 1
    assert sum(bool(one.joint.differs) for one in widened) <= 1
    (plain, _), one = pairs[0], widened[0]
    scores = clusters_with_misfit(plain)
    assert len(scores.misfit_shifts) == 3
    shifted = scores.misfit * np.diag(plain.covariance) + (scores.misfit_shifts**2).sum(axis=0)
    np.testing.assert_allclose(one.first_se, np.sqrt(shifted))
    assert any("Errors of the model count as uncertainty" in note for note in one.notes)


def test_the_shift_is_that_of_the_missing_term(model):
    """A fit with the term itself moves the parameters by as much: constant torque on one motor that the model lacks."""
    beta, bare = loaded(model, 0.0), model
    made = motion(bare, beta, seconds=SECONDS, dt=DT, seed=1, noise=0.01)
    made = replace(made, tau=made.tau + 0.5 * made.tau.std() * np.array([0.0, 1.0, 0.0]))
    found = haptid.estimate(haptid.observe(bare, made), haptid.WLS())
    moved = clusters_with_misfit(found).misfit_shifts
    away = found.beta - beta
    near = min(np.linalg.norm((away - sign * shift) / found.se) for shift in moved for sign in (1, -1))
    assert near < 0.3 * np.linalg.norm(away / found.se)


def test_equality_leaves_out_what_missing_terms_move():
    """A difference along such a shift is none; across it, it is one."""
    made = [clusters(k)[0] for k in (0, 1)]
    rng = np.random.default_rng(3)
    values = [one.root @ rng.normal(size=4) for one in made]
    shift = np.array([3.0, -1.0, 2.0, 0.5])
    far = [values[0], values[1] + 50 * shift]
    known = [replace(one, misfit_shifts=shift[None]) for one in made]
    assert randomised(far, made) < 0.01
    assert randomised(far, known) == pytest.approx(randomised(values, known), abs=1e-9)
    assert randomised([values[0], values[1] + [50.0, 0, 0, 0]], known) < 0.01


def test_blocks_of_like_motion_are_grouped():
    G = np.einsum("bi,ij->bij", np.repeat([[1.0, 5.0], [5.0, 1.0]], 6, axis=0), np.eye(2))
    group = alike(G, 4)
    assert len(set(group[:6])) == len(set(group[6:])) == 1
    assert group[0] != group[6]


def test_equality_has_its_size_on_white_blocks():
    """Two sets of blocks of the same parameters: 5 % of 60 is 3; more than 9 has a probability of 2e-3."""
    rejected = 0
    for seed in range(60):
        made = [clusters(2 * seed + k)[0] for k in (0, 1)]
        rng = np.random.default_rng(seed)
        values = [one.root @ rng.normal(size=4) for one in made]
        rejected += randomised(values, made) < 0.05
    assert rejected <= 9


def test_a_folder_keeps_the_scores(tmp_path):
    """Results that are read back have the joint tests of the estimates; without the file, single tests alone."""
    folders = []
    for k in (0, 1):
        (tmp_path / f"s{k}").mkdir()
        study = write_study(tmp_path / f"s{k}")
        if k:  # the other log is fitted
            text = study.read_text(encoding="utf-8")
            study.write_text(text.replace("check.csv", "?").replace("log.csv", "check.csv").replace("?", "log.csv"))
        folders.append(tmp_path / f"r{k}")
        run = CliRunner().invoke(app, ["identify", str(study), "--out", str(folders[-1]), "--quiet", "--no-report"])
        assert run.exit_code == 0, run.output
    run = CliRunner().invoke(app, ["compare", *map(str, folders), "--json"])
    assert run.exit_code == 0, run.output
    made = json.loads(run.output)
    assert [test["name"] for test in made["joint"]["tests"]]
    assert all(p["detectable"] > 0 for p in made["parameters"])
    assert (
        "torque at rest" in CliRunner().invoke(app, ["compare", *map(str, folders)]).output
        or made["joint"]["notes"] == []
    )
    (folders[0] / "clusters.npz").unlink()
    run = CliRunner().invoke(app, ["compare", *map(str, folders), "--json"])
    assert json.loads(run.output)["joint"] is None
    (folders[1] / "clusters.npz").write_bytes(b"no archive")
    run = CliRunner().invoke(app, ["compare", *map(str, folders)])
    assert run.exit_code == 2
    assert "clusters.npz" in " ".join(run.output.split())
