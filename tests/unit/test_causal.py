"""The causal filters and the differentiated shared filter do to signals what their formulas say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import haptid
from haptid.errors import MissingAccelerationError, MotionTooShortError, TreatmentError
from haptid.motion.filters import Causal, HighPass, KaiserSmoother, WindowedSinc

MOMENTUM = {"formulation": "momentum"}
RAW = {
    "cutoff_hz": None,
    "velocity": HighPass(30.0),
    "parallel_cutoff_hz": 10.0,
    "parallel_shape": Causal(),
    **MOMENTUM,
}


def response(taps, before, frequency, dt):
    """Complex gain about the row's own sample."""
    offsets = dt * (np.arange(len(taps)) - before)
    return np.sum(taps * np.exp(2j * np.pi * frequency * offsets))


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-3, 0.8), st.floats(100.0, 5000.0))
def test_of_order_one_the_slope_is_omega_times_what_the_low_pass_takes_away(share, rate):
    """{d/dt x}_L = omega (x - {x}_L), to rounding, whatever was cut off the impulse response."""
    cutoff = share * rate / 2
    made = Causal().filter(cutoff, 1 / rate, differentiated=True)
    newest = np.zeros(len(made))
    newest[-1] = 1.0
    omega = 2 * np.pi * cutoff
    np.testing.assert_allclose(made.slope, omega * (newest - made.taps), rtol=0, atol=1e-12 * omega)
    assert made.taps.sum() == pytest.approx(1.0)
    assert (made.before, made.after) == (len(made) - 1, 0)


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-3, 0.1), st.integers(1, 6))
def test_the_causal_low_pass_is_butterworths_and_its_slope_s_times_that(share, order):
    rate = 1000.0
    cutoff = share * rate / 2
    made = Causal(order).filter(cutoff, 1 / rate, differentiated=True)
    for frequency in (0.3 * cutoff, cutoff, 2 * cutoff):
        # Tustin's rule at this frequency: s is 2 rate tan(pi f / rate) i.
        s = 2j * rate * np.tan(np.pi * frequency / rate)
        b, a = signal.butter(order, 2 * np.pi * cutoff, analog=True)
        wanted = np.polyval(b, s) / np.polyval(a, s)
        assert response(made.taps, made.before, frequency, 1 / rate) == pytest.approx(wanted, abs=1e-4)
        slope = response(made.slope, made.before, frequency, 1 / rate)
        assert slope == pytest.approx(s * wanted, abs=1e-4 * abs(s))
    corner = rate / np.pi * np.arctan(np.pi * cutoff / rate)
    assert abs(response(made.taps, made.before, corner, 1 / rate)) == pytest.approx(np.sqrt(0.5), abs=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 60), st.floats(0.05, 0.9), st.sampled_from([KaiserSmoother(), WindowedSinc()]))
def test_without_delay_the_slope_is_the_filter_times_the_frequency(decimation, share, shape):
    rate = 1000.0
    cutoff = share * 0.5 * rate / decimation
    made = haptid.Treatment(
        decimation=decimation, parallel_cutoff_hz=cutoff, parallel_shape=shape, formulation="momentum"
    ).parallel_filter(1 / rate)
    np.testing.assert_allclose(made.slope, -made.slope[::-1], atol=1e-9)
    assert len(made) == 2 * made.before + 1
    for frequency in (0.1 * cutoff, 0.5 * cutoff):
        omega = 2 * np.pi * frequency
        gain = response(made.taps, made.before, frequency, 1 / rate)
        slope = response(made.slope, made.before, frequency, 1 / rate)
        assert slope == pytest.approx(1j * omega * gain, abs=1e-4 * omega * abs(gain))


def test_without_a_filter_momenta_are_differentiated_as_they_are():
    made = haptid.Treatment(formulation="momentum").parallel_filter(1e-3)
    assert (len(made), made.before, made.taps.sum()) == (9, 4, 1.0)
    t = 1e-3 * np.arange(-4, 5)
    assert made.slope @ np.sin(30 * t) == pytest.approx(30.0, rel=1e-9)


def test_gradients_of_constants_are_zero_and_of_ramps_one():
    for treatment in (
        haptid.Treatment(decimation=10, formulation="momentum"),
        haptid.Treatment(parallel_cutoff_hz=8.0, parallel_shape=Causal(3), formulation="momentum"),
    ):
        made = treatment.parallel_filter(1e-3)
        assert abs(made.slope.sum()) < 1e-9
        assert made.slope @ (1e-3 * np.arange(len(made))) == pytest.approx(1.0, abs=1e-4)


def test_the_causal_filter_serves_differences_too():
    made = haptid.Treatment(parallel_cutoff_hz=8.0, parallel_shape=Causal()).parallel_filter(1e-3)
    assert made.slope is None


@settings(max_examples=40, deadline=None)
@given(st.floats(1.0, 200.0), st.floats(0.5, 20.0))
def test_the_differentiator_is_tustins_high_pass(cutoff, frequency):
    rate, omega = 1000.0, 2 * np.pi * cutoff
    n = HighPass(cutoff).memory(1 / rate) + 1000
    t = np.arange(n) / rate
    made = HighPass(cutoff).velocity(np.exp(2j * np.pi * frequency * t).real[None], 1 / rate)[0]
    s = 2j * rate * np.tan(np.pi * frequency / rate)
    wanted = (s * omega / (s + omega) * np.exp(2j * np.pi * frequency * t)).real
    np.testing.assert_allclose(made[-1000:], wanted[-1000:], rtol=0, atol=1e-9 * abs(s))


def test_the_differentiator_lags_a_ramp_of_velocity_by_one_over_omega():
    t = 1e-3 * np.arange(3000)
    q = (0.5 * t**2)[:, None]
    motion = haptid.Motion(1e-3, q, q, haptid.Treatment(**RAW))
    low, high = motion.usable
    assert high == len(t)
    np.testing.assert_allclose(motion.qd[low:, 0], t[low:] - 1 / (2 * np.pi * 30.0), atol=2e-3)
    np.testing.assert_array_equal(motion.q, q)


@pytest.mark.parametrize("bounds", [(200, 2000), (1000, 1001), (37, 38), (0, 2000)])
def test_velocity_of_a_segment_is_that_of_the_whole(bounds):
    q = np.cumsum(np.random.default_rng(0).normal(size=(2000, 3)), axis=0)
    motion = haptid.Motion(1e-3, q, q, haptid.Treatment(**RAW))
    _, qd = motion.state(*bounds)
    np.testing.assert_allclose(qd, motion.qd[slice(*bounds)].T, rtol=0, atol=1e-11 * np.abs(motion.qd).max())


def test_no_acceleration_is_made_of_a_lagging_velocity():
    with pytest.raises(MissingAccelerationError) as raised:
        haptid.Treatment(cutoff_hz=None, velocity=HighPass(30.0))
    assert "'momentum'" in raised.value.advice
    q = np.zeros((500, 1))
    motion = haptid.Motion(1e-3, q, q, haptid.Treatment(**RAW))
    with pytest.raises(MissingAccelerationError):
        motion.qdd  # noqa: B018


@pytest.mark.parametrize(
    ("settings_", "name"),
    [
        ({"formulation": "none"}, "formulation"),
        ({"parallel_shape": "causal"}, "parallel_shape"),
        ({"velocity": 30.0}, "velocity"),
        (RAW | {"cutoff_hz": 40.0}, "cutoff_hz"),
    ],
)
def test_settings_that_contradict_each_other_are_rejected(settings_, name):
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(**settings_)
    assert raised.value.where == name


@pytest.mark.parametrize("cutoff", [0.0, -1.0, float("nan"), float("inf"), "10"])
def test_cutoffs_out_of_range_are_rejected(cutoff):
    with pytest.raises(TreatmentError) as raised:
        HighPass(cutoff)
    assert raised.value.where == "velocity.cutoff_hz"


@pytest.mark.parametrize("order", [0, 13, 1.5, True])
def test_orders_out_of_range_are_rejected(order):
    with pytest.raises(TreatmentError) as raised:
        Causal(order)
    assert raised.value.where == "parallel_shape.order"


def test_cutoffs_the_rate_cannot_carry_are_rejected():
    for treatment in (
        haptid.Treatment(parallel_cutoff_hz=60.0, parallel_shape=Causal(), decimation=10),
        haptid.Treatment(parallel_cutoff_hz=600.0, parallel_shape=Causal()),
    ):
        with pytest.raises(TreatmentError) as raised:
            treatment.parallel_filter(1e-3)
        assert raised.value.where == "parallel_cutoff_hz"
        assert raised.value.found > raised.value.limit
    with pytest.raises(TreatmentError) as raised:
        HighPass(600.0).coefficients(1e-3)
    assert raised.value.where == "velocity.cutoff_hz"
    assert raised.value.limit == 500
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(parallel_cutoff_hz=1e-6, parallel_shape=Causal()).parallel_filter(1e-3)
    assert raised.value.where == "parallel_cutoff_hz"
    with pytest.raises(TreatmentError) as raised:
        HighPass(1e-6).coefficients(1e-3)
    assert raised.value.where == "velocity.cutoff_hz"


def test_a_cutoff_at_which_nothing_is_remembered_is_no_trouble():
    """Tustin's pole at zero: 2 / omega is the sampling step."""
    rate = 100.0
    cutoff = 2 * rate / (2 * np.pi)
    assert len(Causal().filter(cutoff, 1 / rate, differentiated=True)) == 3
    assert HighPass(cutoff).memory(1 / rate) == 1


def test_a_motion_shorter_than_the_differentiators_start_is_rejected():
    q = np.zeros((20, 1))
    with pytest.raises(MotionTooShortError, match="differentiator"):
        haptid.Motion(1e-3, q, q, haptid.Treatment(**RAW)).usable  # noqa: B018


COLUMN = """
schema = 1
name = "a pendulum with a column of its own"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[terms]]
kind = "custom"
name = "{name}"
unit = "N m"
joints = ["1"]
expression = "{expression}"
"""


def test_a_column_made_of_accelerations_is_rejected_without_them(tmp_path):
    treatment = haptid.Treatment(decimation=5, formulation="momentum")
    t = 1e-3 * np.arange(3000)
    motion = haptid.Motion(1e-3, np.sin(9 * t)[:, None], np.cos(t)[:, None], treatment)
    for name, expression in (("SIN", "sin(3 * q_1) * v_1"), ("JERKY", "abs(a_1)")):
        (tmp_path / f"{name}.toml").write_text(COLUMN.format(name=name, expression=expression))
        model = haptid.DynamicModel(haptid.read_device(tmp_path / f"{name}.toml"))
        if name == "SIN":
            assert haptid.observe(model, motion).rows > 500
        else:
            with pytest.raises(MissingAccelerationError, match="column JERKY reads accelerations"):
                haptid.observe(model, motion)
