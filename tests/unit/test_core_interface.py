"""Interface of the compiled core: invalid arguments, threads and forked processes."""

import os
import subprocess
import sys

import numpy as np
import pytest

import haptid
from haptid import _core, errors
from haptid.device.loops.chain import compiled
from haptid.observation.r_factor import r_factor

EYE = np.eye(3)[None]
# What the scripts below begin with: two links, and more samples than one thread takes.
SCRIPT = """
import os
import numpy as np
from haptid import _core
n, many = 2, 4000
eye = np.repeat(np.eye(3)[None], n, 0)
core = _core.Mechanism([-1, 0], eye, np.zeros((n, 3)), [False] * n, [0, 0, -9.8], np.eye(n), np.zeros(n), [])
"""


def link(coordinates: int, *terms: tuple) -> _core.Mechanism:
    rates = np.ones((1, coordinates))
    return _core.Mechanism([-1], EYE, np.zeros((1, 3)), [False], [0, 0, -9.8], rates, np.zeros(1), list(terms))


def run(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", SCRIPT + script], capture_output=True, text=True, timeout=120)


def test_what_is_no_number_does_not_become_one():
    rows = np.array([[1.0, 2.0], [np.nan, 3.0], [1.0, 1.0]])
    assert np.isnan(r_factor(rows)[0]).all()


def test_positions_in_another_unit_are_reported_at_once():
    """Encoder counts for radians: the way there would be walked for hours."""
    with pytest.raises(errors.LoopClosureError) as raised:
        haptid.DynamicModel(haptid.read_device("four_bar")).device.closure.positions(np.array([[0.1, 1e9]]))
    assert (raised.value.where, raised.value.limit) == (1, 1e4)


def test_signals_that_lie_on_their_side_are_rejected():
    core = link(1, *(("external", np.ones(1), 0.0, 0.0, 0.0, 0.0),) * 2)
    q, own = np.zeros((1, 6)), np.arange(12.0).reshape(2, 6)
    assert core.torque(q, q, q, own, np.ones(12)).shape == (1, 6)
    with pytest.raises(ValueError, match="external has 2 samples, positions have 6"):
        core.torque(q, q, q, np.ascontiguousarray(own.T), np.ones(12))
    with pytest.raises(ValueError, match="torque has 1 samples, positions have 6"):
        core.acceleration(q, q, q.T.copy(), own, np.ones(12))


def test_a_mechanism_that_nothing_moves_has_no_rows():
    core, none = link(0, ("viscous", np.zeros(0), 0.0, 0.0, 0.0, 0.0)), np.zeros((0, 5))
    assert core.torque(none, none, none, none, np.ones(11)).shape == (0, 5)


def test_friction_that_has_all_faded_does_not_change():
    core, q = link(1, ("stribeck", np.ones(1), 0.0, 0.01, 200.0, 0.0)), np.ones((1, 5))
    assert (core.torque_slopes(q, q, q, np.zeros((0, 5)), [10], [1.0]) == 0).all()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    """Those of its parent are not there; work given to them would never be done."""
    done = run("""
q, none, columns = np.ones((n, many)), np.zeros((0, many)), np.arange(20)
wanted = core.regressor(q, q, q, none, columns)
child = os.fork()
made = core.regressor(q, q, q, none, columns)
if child == 0:
    os._exit(0 if (made == wanted).all() else 3)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
""")
    assert done.stdout.strip() == "0", done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is limited in another way here")
@pytest.mark.parametrize("rows", ["regressor(q, q, q", "momentum_regressor(q, q"])
def test_what_does_not_fit_into_memory_is_a_memory_error(rows):
    done = run(f"""
import resource
many = 4_000_000
q, none = np.zeros((n, many)), np.zeros((0, many))
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
try:
    core.{rows}, none, np.arange(20))
except MemoryError as error:
    print(error)
""")
    assert "there is no memory for" in done.stdout, done.stderr


def test_whole_numbers_that_would_never_end_are_refused():
    closure = haptid.read_device("delta").closure
    core, q = compiled(closure.chain), np.zeros((2, len(closure.chain.joints)))
    with pytest.raises(OverflowError):
        core.close(q, [0], 2**64, 0.0)
    one, still = link(1), np.zeros((1, 100))
    sizes = {"taps": np.ones(1), "decimation": 1, "first": 0, "rows": 10, "block": 5, "weights": np.ones((1, 10))}
    columns = list(range(10))
    for name in ("decimation", "first", "rows"):
        with pytest.raises((ValueError, OverflowError)):
            one.reduce(still, still, still, np.zeros((0, 100)), still, columns, *(sizes | {name: 2**62}).values())
