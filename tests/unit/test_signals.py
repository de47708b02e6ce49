"""Filters and spectra against those of scipy.signal; distributions against those of scipy.stats."""

import numpy as np
import pytest
from scipy import fft, ndimage, signal, stats

from haptid._internal import signals
from haptid.observation.filtering import decimate
from haptid.uncertainty import distributions

RNG = np.random.default_rng(3)
WALK = np.cumsum(RNG.normal(size=(3, 1500)), axis=1)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 8])
@pytest.mark.parametrize("cutoff", [1e-3, 0.2, 0.9])
def test_butterworth_sections_and_both_passes(order, cutoff):
    sections, known = signals.butterworth(order, cutoff), signal.butter(order, cutoff, output="sos")
    w = np.geomspace(1e-4, 3, 50)
    assert np.allclose(signal.sosfreqz(sections, w)[1], signal.sosfreqz(known, w)[1], rtol=1e-8, atol=1e-13)
    assert signals.pole_radius(sections) == pytest.approx(
        np.abs(signal.butter(order, cutoff, output="zpk")[1]).max(), rel=1e-6
    )
    assert signals.end_padding(sections) == signals.end_padding(known)
    own, wanted = signals.both_ways(known, WALK), signal.sosfiltfilt(known, WALK)
    assert np.abs(own - wanted).max() < 1e-6 * cutoff**-0.5 * np.abs(WALK).max() * (1e-3 if cutoff > 1e-2 else 1)


def test_each_channel_may_have_a_filter_of_its_own():
    sections = np.stack([signals.butterworth(4, cutoff) for cutoff in (0.02, 0.1, 0.5)])
    for padding in (None, 0):
        own = signals.both_ways(sections, WALK, padding)
        for k, channel in enumerate(WALK):
            assert (own[k] == signals.both_ways(sections[k], channel[None], padding)[0]).all()


def test_a_constant_passes_both_ways_unchanged():
    level = np.full((1, 200), 3.7)
    assert np.allclose(signals.both_ways(signals.butterworth(4, 0.05), level), level, rtol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_polynomial_filter(order):
    x = np.cumsum(RNG.normal(size=(200, 2)), axis=0)
    assert np.allclose(signals.polynomial_filter(x, 15, 3, order), signal.savgol_filter(x, 15, 3, order, axis=0))


def test_lengths_whose_transform_is_fast():
    lengths = [*range(1, 2000), 40_001, 1_000_003]
    assert [signals.fast_length(n) for n in lengths] == [fft.next_fast_len(n, real=True) for n in lengths]


@pytest.mark.parametrize(("n", "length"), [(1, 1), (2, 1), (2, 2), (30, 7), (30, 8), (30, 30), (1500, 101)])
def test_running_mean_and_maximum(n, length):
    x = WALK[0, :n]
    assert (signals.running_maximum(x, length) == ndimage.maximum_filter1d(x, length)).all()
    assert np.allclose(signals.running_mean(x, length), ndimage.uniform_filter1d(x, length))


@pytest.mark.parametrize("length", [256, 301])
def test_spectra(length):
    x = WALK[0]
    f, power = signals.welch(x, 0.01, signals.kaiser_window(length, 14.0), line=True)
    settings = {"nperseg": length, "noverlap": length // 2}
    known = signal.welch(x, 100.0, window=("kaiser", 14.0), detrend="linear", **settings)
    assert np.allclose(f, known[0])
    assert np.allclose(power, known[1], rtol=1e-9)
    _, power = signals.welch(x, 0.01, signals.hann_window(length))
    assert np.allclose(power, signal.welch(x, 100.0, detrend="constant", **settings)[1], rtol=1e-9)
    assert np.allclose(signals.without_line(x), signal.detrend(x), atol=1e-9)


@pytest.mark.parametrize(("taps", "decimation"), [(1, 3), (7, 1), (5, 10), (101, 10), (301, 7), (1500, 4)])
def test_decimated_rows_are_weighted_sums_of_their_windows(taps, decimation):
    weights = RNG.normal(size=taps)
    rows = np.lib.stride_tricks.sliding_window_view(WALK, taps, axis=1)[:, ::decimation] @ weights
    assert np.allclose(decimate(WALK, weights, decimation), rows, rtol=1e-11, atol=1e-11 * np.abs(rows).max())


def test_tails_and_quantiles():
    x, dof = np.array([-2.0, 0.0, 1.5, 30.0]), np.array([2.5, 7.0, np.inf, 40.0])
    assert np.allclose(distributions.t_tail(x, dof), stats.t.sf(x, dof), rtol=1e-10)
    assert np.allclose(distributions.t_quantile(0.975, dof), stats.t.ppf(0.975, dof), rtol=1e-10)
    assert np.allclose(distributions.f_tail(x, 3.0, dof), stats.f.sf(x, 3, np.minimum(dof, 1e300)))
    assert distributions.f_tail(2.0, 3.0, np.inf) == pytest.approx(stats.chi2.sf(6.0, 3), rel=1e-9)
    assert distributions.f_quantile(0.95, 3, 9) == pytest.approx(stats.f.isf(0.05, 3, 9))
    assert distributions.noncentral_f_tail(4.0, 3, 9, 6.0) == pytest.approx(stats.ncf.sf(4.0, 3, 9, 6.0))
    assert np.allclose(distributions.chi2_tail(x, 4), stats.chi2.sf(x, 4))
    assert distributions.normal_quantile(0.01) == pytest.approx(stats.norm.ppf(0.01))


@pytest.mark.parametrize("draw", [RNG.normal, RNG.exponential, RNG.uniform])
def test_normality(draw):
    x = draw(size=120) + 1e3
    known = (stats.skew(x), stats.kurtosis(x), stats.normaltest(x).pvalue)
    assert distributions.dagostino_pearson(x) == pytest.approx(known, rel=1e-7)
    assert distributions.dagostino_pearson(x[:10])[2] == 1.0


@pytest.mark.parametrize("length", [128, 129])
def test_cross_spectrum_is_scipys(length):
    x, y = np.random.default_rng(0).standard_normal((2, 1000))
    f, found = signals.cross_spectrum(x, y, 1e-3, signals.hann_window(length))
    wanted_f, wanted = signal.csd(y, x, 1e3, "hann", length, noverlap=length // 2)  # SciPy conjugates the first
    np.testing.assert_allclose(f, wanted_f)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
