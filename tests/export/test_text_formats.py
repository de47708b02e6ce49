"""JSON, LaTeX, MATLAB and Rust: read back or run, they are the Python model."""

import json
import re
import subprocess

import numpy as np
import pytest

import haptid
from compiled import compiler, relative, run
from haptid._internal.escaping import latex_text
from haptid.end_effector.force import REVERSAL_SPEED
from haptid.export import export_json, export_latex, export_matlab, export_rust
from haptid.export.formats.latex import latex_number, unit_text
from haptid.export.output import default_name
from haptid.export.selftest import ReferenceValues
from true_parameters import true_parameters

DEVICES = ["phantom_premium_15", "cea_medical_branch", "kuka_kr300", "emps"]
# What libm offers, by the standard library: no registry is needed.
LIBM = """
macro_rules! one { ($($n:ident),*) => { $(pub fn $n(x: f64) -> f64 { x.$n() })* } }
one!(sin, cos, tan, tanh, exp, sqrt);
pub fn fabs(x: f64) -> f64 { x.abs() }
pub fn fmax(x: f64, y: f64) -> f64 { x.max(y) }
pub fn fmin(x: f64, y: f64) -> f64 { x.min(y) }
pub fn pow(x: f64, y: f64) -> f64 { x.powf(y) }
"""


def other_model(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    return model, model.base.of(true_parameters(model))


def golden_of(name, samples):
    model, beta = other_model(name)
    reference = ReferenceValues.at_random(model, beta, REVERSAL_SPEED, samples)
    return reference.at(np.flatnonzero(reference.sound("forward_dynamics")))


# --- JSON -------------------------------------------------------------------------------------------------------


def test_json_has_parameters_that_regroup_into_the_identified_ones(tmp_path):
    model, beta = other_model("phantom_premium_15")
    made = export_json((model, beta), tmp_path)
    values = json.loads((tmp_path / made.files[0]).read_text())
    assert [p["value"] for p in values["parameters"]] == list(beta)
    for parameter in values["parameters"]:
        total = sum(factor * values["standard"][name] for name, factor in parameter["regroups"].items())
        assert total == pytest.approx(parameter["value"], rel=1e-9, abs=1e-15)
    assert values["covariance"] is None
    assert [c["label"] for c in values["coordinates"]] == ["motor 1", "motor 2", "motor 3"]
    assert [j["name"] for j in values["joints"] if not j["active"]] == ["a", "c"]


def test_json_says_that_no_bodies_have_the_parameters(tmp_path):
    model, beta = other_model("arm3")
    values = json.loads((tmp_path / export_json((model, -beta), tmp_path).files[0]).read_text())
    assert values["standard"] is None


# --- LaTeX ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*DEVICES, "staubli_tx40", "delta"])
def test_latex_is_balanced_and_has_every_parameter(tmp_path, name):
    model, beta = other_model(name)
    made = export_latex((model, beta), tmp_path)
    text = "".join((tmp_path / file).read_text() for file in made.files)
    plain = re.sub(r"\\[{}$%]", "", re.sub(r"^%.*$", "", text, flags=re.MULTILINE))
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    assert re.findall(r"\\begin{(\w+)}", plain) == ["document", "longtable", "longtable"]
    parameters, groupings = ((tmp_path / file).read_text() for file in made.files[1:])
    assert parameters.count(" \\\\\n") == len(beta)
    assert groupings.count(" \\\\\n") == len(beta)


def test_latex_compiles(tmp_path):
    made = export_latex(other_model("cea_medical_branch"), tmp_path)
    run([compiler("pdflatex"), "-interaction=nonstopmode", "-halt-on-error", made.files[0]], tmp_path)


def test_figures_and_text_in_latex():
    assert latex_number(-1.25e-7) == r"$-1.25 \times 10^{-7}$"
    assert latex_number(0.5) == "$0.5$"
    assert latex_number(-np.inf) == r"$-\infty$"
    assert unit_text("kg m^2") == r"kg\,m$^{2}$"
    assert latex_text("5 % of a_b") == r"5 \% of a\_b"


# --- MATLAB -----------------------------------------------------------------------------------------------------


class Vector:
    """An array that is indexed as MATLAB does."""

    def __init__(self, values):
        self.values = values

    def __call__(self, k):
        return self.values[k - 1]


FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "exp", "sqrt", "abs", "sign", "power")}
FUNCTIONS |= {"max": np.maximum, "min": np.minimum}


def interpreted(text, inputs):
    """Outputs of a function of MATLAB, by name: its assignments are Python's, once matrices are lists of rows."""
    names = dict(FUNCTIONS) | {name: Vector(values) for name, values in inputs.items()}
    outputs = {}
    for line in text.splitlines():
        if not (found := re.fullmatch(r"(\w+) = (.*);", line)) or found[1] == "sound":
            continue
        name, expression = found.groups()
        if matrix := re.fullmatch(r"\[(.*)\]", expression):
            rows = [eval(f"[{row}]", names) for row in matrix[1].split("; ")]
            outputs[name] = [entry for row in rows for entry in row]
        else:
            names[name] = eval(expression, names)
    return outputs


@pytest.mark.parametrize("name", [*DEVICES, "five_bar", "delta"])
def test_matlab_is_the_python_model(tmp_path, name):
    reference = golden_of(name, 200)
    export_matlab((reference.model, reference.beta), tmp_path)
    prefix = default_name(reference.model.device.name)
    inputs = reference.inputs | {"beta": reference.beta}
    limit = 1e-8 if "z" in inputs else 1e-9  # positions of passive joints are Newton's
    with np.errstate(all="ignore"):
        for function in reference.functions:
            path = tmp_path / f"{prefix}_{function}.m"
            sound = reference.sound(function) if path.exists() else np.zeros(1, dtype=bool)
            if not sound.any():
                continue
            made = interpreted(path.read_text(), inputs)
            for output, values in reference.at(np.flatnonzero(sound)).functions[function]().items():
                got = np.stack([np.broadcast_to(x, sound.shape) for x in made[output]], axis=1)[sound]
                assert relative(got, values) < limit, (function, output)


def test_octave_runs_it(tmp_path):
    octave = compiler("octave")
    reference = golden_of("phantom_premium_15", 20)
    export_matlab((reference.model, reference.beta), tmp_path)
    state = ", ".join(
        "[" + "; ".join(map(repr, map(float, getattr(reference, x)[:, 0]))) + "]" for x in ("q", "qd", "qdd")
    )
    call = f"printf('%.17g ', phantom_premium_1_5_inverse_dynamics({state})); M = phantom_premium_1_5_mass_matrix("
    done = run([octave, "--eval", call + f"{state.split(', ')[0]}); assert(size(M), [3, 3])"], tmp_path)
    wanted = reference.functions["inverse_dynamics"]()["tau"][0]
    np.testing.assert_allclose([float(x) for x in done.stdout.split()], wanted, rtol=1e-12)


# --- Rust -------------------------------------------------------------------------------------------------------


def rust_driver(reference, functions):
    """A program that calls functions at every state and prints what they give."""
    inputs = list(reference.inputs.values())
    states = zip(*(values.T.tolist() for values in inputs), strict=True)
    rows = ", ".join(f"({', '.join(map(str, state))})" for state in states)
    kinds = ", ".join(f"[f64; {len(values)}]" for values in inputs)
    calls = "\n".join(
        f"    let made = dev::{name}({', '.join(arguments)});\n"
        + (f'    println!("{{:?}}", {"made.unwrap()" if checks else "made"});')
        for name, arguments, checks in functions
    )
    return (
        "fn main() { let model = dev::Model::new(&dev::BETA);\n"
        f"let states: [({kinds}); {reference.q.shape[1]}] = [{rows}];\n"
        f"for s in &states {{\n{calls}\n}} }}\n"
    )


@pytest.mark.parametrize("name", ["phantom_premium_15", "kuka_kr300", "five_bar", "delta"])
def test_rust_is_the_python_model(tmp_path, name):
    rustc = compiler("rustc")
    reference = golden_of(name, 20)
    export_rust((reference.model, reference.beta), tmp_path)
    (tmp_path / "libm.rs").write_text(LIBM)
    text = (tmp_path / "src" / "lib.rs").read_text()
    assert "#![no_std]" in text
    place = {"model": "&model"} | {name: f"&s.{k}" for k, name in enumerate(reference.inputs)}
    found = re.findall(r"pub fn (\w+)\((.*)\) -> (\S+)", text)
    functions = [
        (f, [place[a.split(":")[0]] for a in arguments.split(", ")], "Option" in made)
        for f, arguments, made in found
        if f != "new" and reference.sound(f).all()
    ]
    (tmp_path / "main.rs").write_text(rust_driver(reference, functions))
    library = ["--edition", "2021", "--crate-type", "rlib"]
    run([rustc, *library, "--crate-name", "libm", "libm.rs", "-o", "liblibm.rlib"], tmp_path)
    linked = ["--extern", "libm=liblibm.rlib"]
    run(
        [rustc, "-D", "warnings", *library, "--crate-name", "dev", *linked, "src/lib.rs", "-o", "libdev.rlib"], tmp_path
    )
    run([rustc, "--edition", "2021", "-L", ".", "--extern", "dev=libdev.rlib", "main.rs", "-o", "driver"], tmp_path)
    lines = iter(
        subprocess.run(["./driver"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split("\n")
    )
    wanted = {f: np.hstack(list(reference.functions[f]().values())) for f, _, _ in functions}
    limit = 1e-8 if "z" in reference.inputs else 1e-9  # positions of passive joints are Newton's
    for k in range(reference.q.shape[1]):
        for f, _, _ in functions:
            got = np.array([float(x) for x in re.findall(r"[-+0-9.e]+", next(lines))])
            got = got[: wanted[f].shape[1]]  # without the bound of `close`, which the Python model does not have
            assert np.abs(got - wanted[f][k]).max() < limit * (np.abs(wanted[f]).max() or 1.0), f
