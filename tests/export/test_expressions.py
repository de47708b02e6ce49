"""Expressions of all functions against the Python model, on random mechanisms; and what the graph does to them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from compiled import NAME, STRICT, compiler, named, relative, run
from haptid.export import CCode, export_c
from haptid.export.expressions.factoring import factored
from haptid.export.expressions.graph import PARAMETER, Graph, cost, operations
from haptid.export.expressions.polynomial import cheapest
from haptid.export.expressions.rewriting import values_of
from haptid.export.model.functions import code_of
from haptid.export.model.moments import moments_of
from haptid.export.selftest import ReferenceValues
from mechanisms import mechanisms
from random_devices import as_device, parameters

# Beside the sums that make an entry up; sums of random mechanisms can cancel.
ROUNDING = 1e-10


@settings(max_examples=6, deadline=None)
@given(mechanisms(most=4))
def test_every_function_is_the_python_models(mechanism):
    model = as_device(mechanism)
    beta = model.base.of(parameters(mechanism, model))
    code = code_of(model, 0.05)
    reference = ReferenceValues.at_random(model, beta, 0.05, 20)
    for function in code.functions:
        sound = reference.sound(function.name)
        if not sound.any():
            continue
        kept = reference.at(np.flatnonzero(sound))
        values = named(beta, q=kept.q, qd=kept.qd, qdd=kept.qdd, tau=kept.tau)
        for (name, outputs), wanted in zip(function.outputs, kept.functions[function.name]().values(), strict=True):
            made = np.array([np.broadcast_to(x, sound.sum()) for x in values_of(code.graph, list(outputs), values)])
            tolerance = 1e-5 if function.checks else ROUNDING
            assert relative(made.T, wanted) < tolerance, (function.name, name)


@settings(max_examples=5, deadline=None)
@given(mechanisms(most=4))
def test_momentum_explains_the_torque(mechanism):
    """A law: p is M qd and the rest is what remains of C qd + g, by differences of p along a motion."""
    model = as_device(mechanism, kinds=("rotor",))
    beta = model.base.of(parameters(mechanism, model))
    code = code_of(model, 0.05)
    reference = ReferenceValues.at_random(model, beta, 0.05, 5)
    step = 1e-6

    def at(name, q, qd, qdd):
        values = named(beta, q=q, qd=qd, qdd=qdd)
        outputs = [x for _, each in code[name].outputs for x in each]
        return np.array([np.broadcast_to(x, q.shape[1]) for x in values_of(code.graph, outputs, values)])

    n = len(reference.q)
    ahead, behind = (
        at("momentum", reference.q + h * reference.qd, reference.qd + h * reference.qdd, reference.qdd)
        for h in (step, -step)
    )
    rest = at("momentum", reference.q, reference.qd, reference.qdd)[n:]
    torque = at("inverse_dynamics", reference.q, reference.qd, reference.qdd)
    np.testing.assert_allclose((ahead - behind)[:n] / (2 * step) + rest, torque, atol=1e-6 * (1 + np.abs(torque).max()))


@settings(max_examples=8, deadline=None)
@given(mechanisms(most=4))
def test_second_moments_are_as_few_as_base_parameters(mechanism):
    model = as_device(mechanism, kinds=())
    assert len(moments_of(model).factors) == len(model.base)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_rewriting_changes_no_value(seed):
    """Random sums of products of sines, cosines and rates, factored and nested."""
    rng = np.random.default_rng(seed)
    graph = Graph()
    x, v = graph.name("q[0]"), graph.name("qd[0]")
    atoms = [graph.apply("sin", x), graph.apply("cos", x), v, graph.name("p[0]", PARAMETER), graph.number(2.0)]
    outputs = []
    for _ in range(3):
        total = graph.number(0.0)
        for _ in range(6):
            product = graph.number(float(rng.integers(-2, 3)))
            for k in rng.integers(0, len(atoms), 3):
                product = product * atoms[k]
            total = total + product
        outputs.append(total)
    values = named(np.array([0.7]), q=rng.normal(size=(1, 8)), qd=rng.normal(size=(1, 8)))
    wanted = np.array([np.broadcast_to(y, 8) for y in values_of(graph, outputs, values)])
    for made in (factored(graph, outputs), cheapest(graph, outputs)):
        got = np.array([np.broadcast_to(y, 8) for y in values_of(graph, made, values)])
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12)


def test_constants_fold_and_equals_are_shared():
    graph = Graph()
    x, p = graph.name("q[0]"), graph.name("p[0]", PARAMETER)
    assert (x * 0.0).value == 0.0
    assert (x - x).value == 0.0
    assert (x + 0.0).node == x.node
    assert (x * 1.0).node == x.node
    assert (x * p).node == (p * x).node
    assert graph.apply("cos", -x).node == graph.apply("cos", x).node
    assert graph.apply("sin", -x).sign == -1
    assert (p * (p * x)).node == ((p * p) * x).node
    assert cost(graph, [p * p + 3.0]) == 0
    assert operations(graph, [p * p * x + 1.0]).arithmetic == 2


def test_large_polynomials_are_left_to_the_recursion():
    graph = Graph()
    total = graph.number(1.0)
    for k in range(9):
        total = total * (graph.name(f"q[{k}]") + 1.0)
    assert cheapest(graph, [total]) is None


@pytest.mark.parametrize("power", [0, 1, 3, 2.5, -1])
def test_powers(power):
    graph = Graph()
    made = graph.power(graph.name("q[0]"), graph.number(power))
    q = np.array([[0.3, 1.7]])
    np.testing.assert_allclose(
        *np.broadcast_arrays(values_of(graph, [made], named(np.zeros(0), q=q))[0], q[0] ** power)
    )


TERMS = """
schema = 1
name = "two links with many terms"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[lengths]
L = 0.3
[[joints]]
name = "1"
[[joints]]
name = "2"
d = "L"
[[terms]]
kind = "coulomb-by-direction"
joints = "all"
[[terms]]
kind = "stribeck"
joints = "all"
velocity = 0.4
exponent = 1.5
[[terms]]
kind = "spring"
joints = "all"
rest = 0.2
[[terms]]
kind = "offset"
joints = ["2"]
[[terms]]
kind = "counterbalance"
joints = ["1"]
crank = 0.1
base = 0.4
law = "gas"
stroke = 0.6
[[terms]]
kind = "custom"
joints = ["1"]
name = "K"
unit = "N m"
expression = "sin(q_1)*v_2**2/L - exp(-q_2/3) + abs(v_1)**1.5*tanh(-v_2) + sqrt(q_1**2 + 1) + sign(q_2)*cos(pi*q_1)"
"""


def test_every_kind_of_term(tmp_path):
    (tmp_path / "device.toml").write_text(TERMS)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    beta = np.random.default_rng(2).uniform(0.1, 1.0, len(model.base))
    code = code_of(model, 0.05)
    reference = ReferenceValues.at_random(model, beta, 0.05, 200)
    for name in ("terms", "friction"):
        outputs = list(code[name].outputs[0][1])
        made = np.array(values_of(code.graph, outputs, named(beta, q=reference.q, qd=reference.qd)))
        wanted = reference.functions[name]()["tau"].T
        assert np.abs(wanted).max() > 0.1
        np.testing.assert_allclose(made, wanted, rtol=1e-10, atol=1e-12)
    export_c((model, beta), tmp_path / "out", CCode(NAME))
    for options in (["-O1"], ["-fsanitize=undefined", "-fno-sanitize-recover=all"]):
        run([compiler("gcc"), *STRICT, *options, "dev.c", "dev_selftest.c", "-lm", "-o", "selftest"], tmp_path / "out")
        run(["./selftest"], tmp_path / "out")
