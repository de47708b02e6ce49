"""Single precision: errors stay below the bounds of the header, and the bounds are not far above the errors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from compiled import NAME, Library
from haptid.errors import SettingError
from haptid.export import CCode, export_c
from haptid.export.expressions.functions_in_intervals import Interval
from haptid.export.expressions.graph import LIBRARY, PARAMETER, RUN, Graph
from haptid.export.expressions.rewriting import NUMERICALLY, values_of
from haptid.export.expressions.rounding import UNIT, error_bounds
from haptid.export.model.functions import code_of
from haptid.export.model.ranges import Ranges
from true_parameters import true_parameters

SPEED, STATES = 0.01, 4000
# Limits of the largest bound over the largest error seen, of any output: of long chains no state at random comes near
# the worst one, in which the rates of all joints add up.
LOOSE = {"phantom_premium_15": 8, "cea_medical_branch": 15, "puma560": 120, "staubli_tx40": 260, "arm7": 230}
# Outputs whose bound is all but unrelated to their error: torques that cancel, as of gravity on a vertical axis.
CANCELLING = 1e-3


def states(model, code):
    """Random states within the ranges, and their corners, as single precision has them."""
    rng = np.random.default_rng(0)
    ranges = Ranges.of(model, code.passive, CCode())
    made = {}
    for name, ends in (
        ("q", ranges.position),
        ("qd", np.outer(ranges.rate, [-1, 1])),
        ("qdd", np.outer(ranges.acceleration, [-1, 1])),
    ):
        inside = rng.uniform(ends[:, :1], ends[:, 1:], (len(ends), STATES))
        if name != "q":
            inside[:, ::3] = np.where(rng.random(inside[:, ::3].shape) < 0.5, ends[:, :1], ends[:, 1:])
            inside[:, 1::3] *= 10 ** rng.uniform(-4, 0, inside[:, 1::3].shape)
        made[name] = np.nextafter(inside.astype(np.float32), np.float32(0)).astype(float)
    return made


@pytest.mark.parametrize("name", LOOSE)
def test_errors_are_below_the_bounds_and_the_bounds_are_not_far_above(tmp_path, name, record_property):
    model = haptid.DynamicModel(haptid.read_device(name))
    beta, code = model.base.of(true_parameters(model)), code_of(model, SPEED)
    libraries, made = [], None
    for precision in ("double", "single"):
        made = export_c((model, beta), tmp_path / precision, CCode(NAME, precision, SPEED))
        libraries.append(Library.built(tmp_path / precision, code, precision))
    arrays = states(model, code)
    compared = 0
    for function, outputs in made.error_bounds.items():
        inputs = {x for x, _ in code[function].inputs}
        if not inputs <= set(arrays) or not all(map(math.isfinite, sum(outputs.values(), ()))):
            continue
        double, single = (library(function, arrays) for library in libraries)
        for output, bounds in outputs.items():
            error = np.abs(single[output] - double[output]).max(axis=0)
            assert (error <= bounds).all(), (function, output, error, bounds)
            sized = np.abs(double[output]).max(axis=0) > CANCELLING * np.abs(double[output]).max()
            exact = (error == 0) | ~sized
            ratio = float(np.max(np.asarray(bounds)[~exact] / error[~exact], initial=0.0))
            record_property(f"{function}, {output}", ratio)
            assert ratio < LOOSE[name], (function, output)
            compared += 1
    assert compared >= 6


def evaluated(graph, outputs, values):
    """The outputs in single precision, operation by operation, from parameters prepared in double precision.

    Functions are those of double precision, rounded up or down at random: less than one unit in the last place away.
    """
    rng = np.random.default_rng(0)
    made = {}
    for node in sorted(graph.live(outputs)):
        op, args, when = graph.nodes[node]
        if when < RUN:
            made[node] = values_of(graph, [graph.at(node)], values)[0].astype(np.float32)
        elif op == "name":
            made[node] = values[args[0]].astype(np.float32)
        else:
            wide = np.float64 if op in (*LIBRARY, "pow") else np.float32
            exact = np.asarray(NUMERICALLY[op](*(made[arg].astype(wide) for arg in graph.operands(node))))
            made[node] = exact.astype(np.float32)
            if wide is np.float64:
                beyond = np.where(exact > made[node], np.inf, -np.inf).astype(np.float32)
                away = (exact != made[node]) & (rng.random(exact.shape) < 0.5) & (op in ("sin", "cos", "tanh", "exp"))
                made[node] = np.where(away, np.nextafter(made[node], beyond), made[node])
    return [out.sign * made[out.node].astype(float) for out in outputs]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_errors_of_any_expression_are_below_its_bound(seed):
    """Random sums, products, quotients and functions: a rule that leaves out an error shows in some of them."""
    rng = np.random.default_rng(seed)
    graph = Graph()
    ends = {f"q[{k}]": np.sort(rng.uniform(-4, 4, 2)).astype(np.float32).astype(float) for k in range(3)}
    parameters = {"p[0]": np.asarray(rng.uniform(-2, 2))}
    pool = [
        *(graph.name(name) for name in ends),
        graph.name("p[0]", PARAMETER),
        graph.number(float(rng.uniform(-2, 2))),
    ]
    for _ in range(25):
        kind = rng.integers(0, 9)
        a, b = (pool[k] for k in rng.integers(0, len(pool), 2))
        if kind < 3:
            pool.append((a + b, a - b, a * b)[kind])
        elif kind == 3:
            pool.append(a / (b * b + 0.5))
        elif kind == 4:
            pool.append(graph.power(graph.apply("fabs", a), graph.number(1.5)))
        elif kind < 7:
            turned = pool[rng.integers(0, 3)]
            s, c = graph.apply("sin", turned), graph.apply("cos", turned)
            pool += [c * a + s * b, c * b - s * a, c * a - s * b]
        elif a.when == RUN:
            pool.append(graph.apply(sorted(LIBRARY)[rng.integers(0, len(LIBRARY))], a))
    outputs = [x for x in pool if x.when == RUN]
    bounds = error_bounds(graph, outputs, {name: Interval(*map(float, x)) for name, x in ends.items()}, parameters)
    inside = {name: np.clip(rng.uniform(*x, 500).astype(np.float32), *x).astype(float) for name, x in ends.items()}
    with np.errstate(all="ignore"):
        wanted = values_of(graph, outputs, inside | parameters)
        got = evaluated(graph, outputs, inside | parameters)
        for x, y, bound in zip(got, wanted, bounds, strict=True):
            assert not math.isfinite(bound) or np.abs(x - y).max() <= bound


def test_turning_a_vector_again_and_again_adds_to_the_bound():
    """Twenty joints: by intervals of components alone the bound would be a thousand times as large, or more."""
    graph = Graph()
    x, y = graph.name("q[0]"), graph.name("q[1]")
    inputs = {"q[0]": Interval(-1.0, 1.0), "q[1]": Interval(-1.0, 1.0)}
    for k in range(2, 22):
        s, c = (graph.apply(wave, graph.name(f"q[{k}]")) for wave in ("sin", "cos"))
        x, y = c * x + s * y, c * y - s * x
        inputs[f"q[{k}]"] = Interval(-math.pi, math.pi)
    assert max(error_bounds(graph, [x, y], inputs, {})) < 20 * 10 * UNIT


@pytest.mark.parametrize(("sign", "most"), [(-1, math.sqrt(2)), (1, 2.0)])
def test_only_turned_vectors_keep_their_length(sign, most):
    """c x + s y with c y - s x is a turned vector; with c y + s x it can be longer by sqrt(2): a quotient shows it."""
    graph = Graph()
    x, y, *angles = (graph.name(f"q[{k}]") for k in range(4))
    (s, c), (t, d) = ((graph.apply(wave, angle) for wave in ("sin", "cos")) for angle in angles)
    turned = d * (c * x + s * y) + t * (c * y + sign * s * x)
    inputs = {f"q[{k}]": Interval(-1.0, 1.0) if k < 2 else Interval(-math.pi, math.pi) for k in range(4)}
    within, beyond = error_bounds(graph, [1.0 / (turned - 0.999 * most), 1.0 / (turned - 1.001 * most)], inputs, {})
    assert math.isinf(within)
    assert math.isfinite(beyond)


@pytest.mark.parametrize("low", [0.0, -1.0])
def test_nothing_is_claimed_of_a_quotient_by_what_can_be_zero(low):
    graph = Graph()
    x, y = graph.name("q[0]"), graph.name("q[1]")
    inputs = {"q[0]": Interval(1.0, 2.0), "q[1]": Interval(low, 1.0)}
    quotient, inverse, sign = error_bounds(graph, [x / y, y / x, graph.apply("sign", y)], inputs, {})
    assert inverse < 4 * UNIT
    assert math.isinf(quotient)
    assert math.isinf(sign)


def test_ranges_are_the_device_files_limits_and_the_settings_elsewhere():
    tx40 = haptid.DynamicModel(haptid.read_device("staubli_tx40"))
    limits = [tx40.device.joints[j] for j in tx40.device.active]
    ranges = Ranges.of(tx40, (), CCode(rate=1.0, acceleration=5.0))
    if np.array_equal(tx40.device.row_map, np.eye(6)):
        np.testing.assert_allclose(ranges.position, [joint.position_limits for joint in limits])
    assert ranges.rate[0] == pytest.approx(5.009)
    np.testing.assert_allclose(ranges.acceleration, 5 * ranges.rate)
    puma = haptid.DynamicModel(haptid.read_device("puma560"))
    ranges = Ranges.of(puma, (), CCode(rate=3.0))
    np.testing.assert_allclose(ranges.position, np.tile([-np.pi, np.pi], (6, 1)))
    np.testing.assert_allclose(ranges.rate, 3.0)
    for setting in ("rate", "acceleration"):
        with pytest.raises(SettingError) as raised:
            CCode(**{setting: 0.0})
        assert raised.value.where == setting


def test_the_header_has_the_bounds_and_says_where_there_is_none(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    source = model, model.base.of(true_parameters(model))
    made = export_c(source, tmp_path, CCode(NAME, "single"))
    header = (tmp_path / f"{NAME}.h").read_text()
    printed = next(line for line in header.splitlines() if "inverse_dynamics, tau:" in line).split(": ")[1].split()
    bounds = made.error_bounds["inverse_dynamics"]["tau"]
    assert all(bound <= float(text) <= 1.1 * bound for text, bound in zip(printed, bounds, strict=True))
    assert "No bound is known of forward_dynamics" in header
    double = export_c(source, tmp_path, CCode(NAME))
    assert double.error_bounds == {}
    assert "Single precision" not in (tmp_path / f"{NAME}.h").read_text()
