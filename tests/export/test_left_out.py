"""Parameters that were left out: less code, and the same torque as the reduced model in Python."""

import json
import subprocess

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from compiled import NAME, STRICT, Library, compiler, relative, run
from haptid.advice.eliminate import with_reduced
from haptid.cli import app
from haptid.export import CCode, export_c
from haptid.export.model.functions import code_of
from haptid.export.selftest import ReferenceValues
from haptid.inference.elimination import BackwardElimination, MaxRelativeStd, eliminate, refit_without
from motions import motion, multisine, truth
from small_study import two_links, write_study

SPEED = 0.01
OUT = ("XXbeR", "FV1", "FC3")
FRICTION = ("FV1", "FC2")


@pytest.fixture(scope="module")
def reduced():
    """A PHANToM of noisy torque, with a body's and two friction parameters left out."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    made = motion(model, truth(model), seconds=6.0, dt=4e-3, noise=0.05)
    return refit_without(haptid.estimate(haptid.observe(model, made), haptid.WLS()), OUT)


def test_what_is_left_out_costs_nothing(reduced, tmp_path):
    full = code_of(reduced.model, SPEED).operations
    made = export_c(reduced, tmp_path, CCode(NAME, reversal_speed=SPEED))
    for name in ("inverse_dynamics", "terms", "friction", "mass_matrix", "momentum", "forward_dynamics"):
        assert made.operations[name].arithmetic < full[name].arithmetic, name
    assert made.operations["terms"].others == full["terms"].others - 1  # one tanh
    assert made.operations["handle_pose"] == full["handle_pose"]


@pytest.mark.parametrize("name", OUT)
def test_each_parameter_left_out_takes_operations_away(reduced, name):
    def total(code):
        return sum(cost.arithmetic for cost in code.operations.values())

    k = reduced.base.names.index(name)
    assert total(code_of(reduced.model, SPEED, [k])) < total(code_of(reduced.model, SPEED))


def test_the_code_does_not_read_what_is_left_out(reduced, tmp_path):
    made = export_c(reduced, tmp_path, CCode(NAME, reversal_speed=SPEED))
    source, header = ((made.folder / f"{NAME}.{kind}").read_text() for kind in "ch")
    source = source[source.index("_init(") :].partition("\n}")[0]
    for k, name in enumerate(reduced.base.names):
        assert (f"p[{k}]" in source) is (name not in OUT)
        assert (f"p[{k}] {name}: zero: eliminated, not read by the code" in header) is (name in OUT)


def test_c_is_the_reduced_model_in_python(reduced, tmp_path):
    export_c(reduced, tmp_path, CCode(NAME, reversal_speed=SPEED))
    library = Library.built(tmp_path, code_of(reduced.model, SPEED, reduced.zero), "double")
    reference = ReferenceValues.at_random(reduced.model, reduced.beta, SPEED, 2000)
    arrays = {x: getattr(reference, x) for x in ("q", "qd", "qdd", "tau")}
    for function in library.code.functions:
        if function.checks:
            continue
        got = library(function.name, arrays)
        for output, wanted in reference.functions[function.name]().items():
            assert relative(got[output], wanted) < 1e-12, (function.name, output)
    run([compiler("gcc"), *STRICT, f"{NAME}.c", f"{NAME}_selftest.c", "-lm", "-o", "selftest"], tmp_path)
    run(["./selftest"], tmp_path)


def test_zero_parameters_of_a_coordinate_leave_its_solution_out():
    """Without inertia there is no forward dynamics, and no division by zero."""
    model = two_links()
    inertias = [k for k, name in enumerate(model.base.names) if not name.startswith("F")]
    assert "forward_dynamics" in code_of(model, SPEED)
    assert "forward_dynamics" not in code_of(model, SPEED, inertias)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of two links, two of whose friction parameters are zero."""
    folder = tmp_path_factory.mktemp("study")
    path, model = write_study(folder), two_links()
    beta = truth(model) + 0.1
    beta[[model.base.names.index(name) for name in FRICTION]] = 0.0
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        q, qd, qdd = multisine(2, 6.0, 2e-3, seed)
        tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
        tau += 0.02 * np.random.default_rng(seed).standard_normal(tau.shape)
        t = 2e-3 * np.arange(q.shape[1])
        pa.csv.write_csv(pa.table({"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}), folder / name)
    return path


@pytest.fixture(scope="module")
def folder(study):
    """What `haptid eliminate` writes of it."""
    out = study.parent / "essential"
    done = CliRunner().invoke(app, ["eliminate", str(study), "--max-relative-std", "20", "--out", str(out), "--quiet"])
    assert done.exit_code == 0, done.output
    return out


def test_essential_writes_a_result(folder, study):
    read = haptid.Result.load(folder)
    steps = json.loads((folder / "elimination.json").read_text())["all motors"]
    assert {read.names[k] for k in read.zero} == {drop["name"] for drop in steps["eliminated"]} == set(FRICTION)
    assert (read.beta[list(read.zero)] == 0).all()
    assert [said.use for said in read.verdict] == ["predicting", "compensation", "quoting"]
    assert (read.estimate.method, read.estimate.method_description) == ("wls", "WLS without 2")
    found = haptid.identify(haptid.read_study(study))
    assert read.unseen[0].relative == pytest.approx(steps["error_percent"]["unseen"]["reduced"])
    assert read.fit_errors[0].relative == pytest.approx(steps["error_percent"]["fit"]["reduced"])
    assert read.unseen[0].relative != found.unseen[0].relative


def test_rows_held_out_are_predicted_without_what_is_left_out(study):
    path = study.parent / "alternate.toml"
    path.write_text(study.read_text().replace("[treatment]", '[validation]\ncross_validation = "blocks"\n[treatment]'))
    found = haptid.identify(haptid.read_study(path))
    made = with_reduced(found, eliminate(found.estimate, BackwardElimination(MaxRelativeStd(20.0))).reduced)
    assert len(made.runs[0].unseen) == len(found.runs[0].unseen)
    for ours, full in zip(made.runs[0].unseen, found.runs[0].unseen, strict=True):
        assert ours.relative == pytest.approx(full.relative, rel=0.05)
        assert ours.relative != full.relative
    assert with_reduced(found, found.estimate) is found


def test_the_reduced_result_is_exported_and_characterised(folder, tmp_path):
    read = haptid.Result.load(folder)
    made = export_c(read, tmp_path, CCode(NAME))
    full = code_of(read.model, SPEED).operations
    assert made.operations["terms"].arithmetic < full["terms"].arithmetic
    assert "p[" in (made.folder / f"{NAME}.c").read_text()
    subprocess.run([compiler("gcc"), *STRICT, "-c", f"{NAME}.c"], cwd=tmp_path, check=True)
    np.testing.assert_array_equal(read.identified.beta, read.beta)
