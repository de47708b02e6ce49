"""Planned motions begin and end at rest, their rates are their derivatives, and none leaves its limits unsaid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid import errors
from haptid.experiment import bench
from haptid.experiment.bench.trajectories import per_coordinate
from true_parameters import true_parameters

PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
CHI = true_parameters(PHANTOM)
CENTRE, SIZE = (0.0, 0.2, 0.3), (0.5, 0.3, 0.3)
TRIANGLES = bench.Triangles(6.0, CENTRE, SIZE, (0.3, 0.4, 0.5))
KINDS = [
    bench.Multisine(6.0, CENTRE, SIZE),
    TRIANGLES,
    bench.TrianglesAndSines(TRIANGLES, bench.Multisine(6.0, (0.0,), (0.05,))),
    bench.Fourier(6.0, CENTRE, 0.3, ((0.2, -0.1), (0.1, 0.0), (0.0, 0.1)), ((0.1, 0.0), (0.0, 0.1), (-0.1, 0.1))),
    bench.Sweep(CENTRE, (0.4,), (0.2, 1.0)),
    bench.Grid(CENTRE, SIZE, points=2, dwell=0.3, move=0.5),
]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: type(kind).__name__)
def test_rates_are_derivatives_and_both_ends_are_at_rest(kind):
    made = bench.plan(kind, PHANTOM, 1e-3, np.random.default_rng(0))
    for value, rate in ((made.q, made.qd), (made.qd, made.qdd)):
        slope = (value[2:] - value[:-2]) / (2 * made.dt)
        assert np.abs(slope - rate[1:-1]).max() < 1e-2 * np.abs(rate).max()
    for ends in (made.qd[[0, -1]], made.qdd[[0, -1]]):
        np.testing.assert_allclose(ends, 0, atol=1e-9)
    np.testing.assert_allclose(made.q[[0, -1]], [CENTRE, CENTRE], atol=1e-9)
    bench.check_trajectory(PHANTOM, made, CHI)


def test_sweep_runs_at_the_speeds_that_were_requested():
    made = bench.plan(bench.Sweep(CENTRE, (0.4,), (0.2, 1.0)), PHANTOM, 1e-3, np.random.default_rng(0))
    for joint in range(3):
        for speed in (0.2, 1.0, -0.2, -1.0):
            assert (np.abs(made.qd[:, joint] - speed) < 1e-9).sum() > 100
    assert (np.count_nonzero(np.abs(made.qd) > 1e-9, axis=1) <= 1).all()


def test_grid_dwells_at_every_pose():
    made = bench.plan(bench.Grid(CENTRE, SIZE, points=3), PHANTOM, 1e-2, np.random.default_rng(0))
    still = made.q[(made.qd == 0).all(axis=1)]
    assert len(np.unique(np.round(still, 6), axis=0)) == 27


def test_one_seed_is_one_motion():
    kind = KINDS[0]
    one, same, other = (bench.plan(kind, PHANTOM, 1e-3, np.random.default_rng(seed)).q for seed in (1, 1, 2))
    assert (one == same).all()
    assert np.abs(one - other).max() > 0.05


@settings(deadline=None, max_examples=40)
@given(
    kind=st.sampled_from(["multisine", "triangles", "sweep", "grid"]),
    centre=st.tuples(*[st.floats(-1.5, 1.5)] * 3),
    size=st.floats(0.05, 1.2),
    seed=st.integers(0, 1000),
)
def test_what_passes_the_check_stays_inside_every_limit(kind, centre, size, seed):
    """Positions of all joints, passive ones too, in every sample; what does not pass names a joint or the loop."""
    kinds = {
        "multisine": bench.Multisine(4.0, centre, (size,), speed=(2.0,)),
        "triangles": bench.Triangles(4.0, centre, (size,), (0.3,)),
        "sweep": bench.Sweep(centre, (size,), (1.0,)),
        "grid": bench.Grid(centre, (size,), points=2, dwell=0.1, move=0.5),
    }
    made = bench.plan(kinds[kind], PHANTOM, 5e-3, np.random.default_rng(seed))
    try:
        bench.check_trajectory(PHANTOM, made, CHI)
    except errors.TrajectoryError:
        return
    q = PHANTOM.tree(made.q.T, made.qd.T, made.qdd.T)[0]
    for joint, position in zip(PHANTOM.device.joints, q, strict=True):
        if joint.position_limits:
            assert joint.position_limits[0] <= position.min() <= position.max() <= joint.position_limits[1]
    assert bench.loop_conditioning(PHANTOM, q.T).min() > 0
    if kind == "multisine":
        assert np.abs(made.q - centre).max() <= size * (1 + 1e-12)


def check(kind, model=PHANTOM, chi=CHI, saturation=None):
    bench.check_trajectory(model, bench.plan(kind, model, 5e-3, np.random.default_rng(0)), chi, saturation)


def test_limits_of_active_and_passive_joints_are_kept():
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(4.0, CENTRE, (2.0, 0.1, 0.1)))
    assert raised.value.limit == pytest.approx(1.571, abs=1e-3)
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(4.0, (0.0, 1.0, -0.1), (0.1, 0.3, 0.1)))
    assert raised.value.limit == pytest.approx(-1.134, abs=1e-3)


def test_motors_must_be_strong_enough():
    with pytest.raises(errors.TrajectoryError) as raised:
        check(KINDS[0], saturation=np.array([1.0, 0.01, 1.0]))
    assert raised.value.where[0] == "motor 2"


def test_flat_loops_are_rejected():
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(4.0, (0.0, 0.0, 3.8), (0.3,)), model, true_parameters(model))
    assert raised.value.found < raised.value.limit
    assert (
        bench.loop_conditioning(
            model, np.array([model.device.closure.G @ [0, 0.0, 1.0] + model.device.closure.offset])
        )[0]
        < 1e-9
    )


def test_velocity_and_torque_limits_of_the_device_file_are_kept(tmp_path):
    text = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
limits = { velocity = 2.0, torque = 0.5 }
"""
    path = tmp_path / "pendulum.toml"
    path.write_text(text)
    model = haptid.DynamicModel(haptid.read_device(path))
    chi = np.zeros(len(model.device.parameters))
    chi[model.device.parameters.index["ZZ1"]] = 0.1
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(4.0, (0.0,), (1.0,)), model, chi)
    assert raised.value.limit == 2.0
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(4.0, (0.0,), (1.0,), speed=(1.9,)), model, chi)
    assert raised.value.limit == 0.5


def test_settings_that_do_not_fit():
    with pytest.raises(errors.ExperimentError) as raised:
        check(bench.Multisine(4.0, CENTRE, (0.1, 0.2)))
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("amplitude", 2, 3)
    with pytest.raises(errors.TrajectoryError) as raised:
        check(bench.Multisine(2.0, CENTRE, SIZE))
    assert raised.value.found == pytest.approx(2.0)
    assert (per_coordinate("x", (2.0,), ["a", "b"]) == 2.0).all()


@pytest.mark.parametrize(("count", "band"), [(4, (0.3, 2.4)), (8, (0.25, 2.0)), (1, (1.0, 1.0))])
def test_a_multisine_with_a_period_repeats(count, band):
    """Between start and stop; every sine in the band has another frequency, all multiples of one over the period."""
    kind = bench.Multisine(16.0, (0.2,), (0.5,), band, count, ramp=1.0, period=4.0)
    q, _, _ = kind.motion(["1"], 1e-3, np.random.default_rng(2))
    np.testing.assert_allclose(q[2000:6000], q[6000:10000], atol=1e-9)
    lines = np.abs(np.fft.rfft(q[2000:6000, 0] - 0.2))
    found = np.flatnonzero(lines > 1e-6 * lines.max()) / 4.0
    assert len(found) == count
    assert band[0] <= found[0] <= found[-1] <= band[1]


def test_a_period_without_room_for_the_sines_is_refused():
    kind = bench.Multisine(16.0, (0.2,), (0.5,), (0.25, 2.0), 9, period=4.0)
    with pytest.raises(errors.ExperimentError, match="has 8 frequencies") as caught:
        kind.motion(["1"], 1e-3, np.random.default_rng(2))
    assert "5.15 s" in str(caught.value)
    bench.Multisine(16.0, (0.2,), (0.5,), (0.25, 2.0), 9, period=5.15).motion(["1"], 1e-3, np.random.default_rng(2))
