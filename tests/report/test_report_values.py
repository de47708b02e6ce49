"""What the report shows is what the values say: nothing lost by thinning, storing or typesetting."""

import base64
import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import haptid
from haptid import errors
from haptid.errors import OutputFolderError, ResultFileError
from haptid.report import HandForceData, ReportSource, make_report, read_report, sparklines, write_comparison
from haptid.report.chart import envelope, extremes, packed, quantised, shaded
from haptid.report.citations import bibtex, entries
from haptid.report.mathml import groupings, parameter
from haptid.report.report import DATA, PAGE
from haptid.report.sections.excitation import information
from haptid.report.sections.friction import model_curve
from haptid.report.sections.hand import HandSection
from haptid.report.sections.residual import binned
from haptid.report.sections.torque import ALL_BINS, MOST_BINS
from haptid.report.terminal import BARS, rms_of_bins, sparkline
from haptid.results.result import Result
from reported import found, logs, made, source

finite = st.floats(-1e6, 1e6, width=32)


def unpacked(values):
    if "f32" in values:
        return np.frombuffer(base64.b64decode(values["f32"]), dtype="<f4")
    if "u16" in values:
        levels = np.frombuffer(base64.b64decode(values["u16"]), dtype="<u2")
        return np.where(levels == 65535, np.nan, values["low"] + values["step"] * levels.astype(float))
    return values["start"] + values["step"] * np.arange(values["count"])


@given(arrays(np.float64, st.integers(1, 300), elements=finite), st.integers(1, 40))
def test_no_peak_is_lost_by_thinning(y, each):
    low, high = extremes(y, each)
    assert len(low) == -(-len(y) // each)
    assert low.min() == y.min()
    assert high.max() == y.max()
    for k in range(len(low)):
        assert low[k] == y[each * k : each * (k + 1)].min()


@given(arrays(np.float64, st.integers(1, 200), elements=finite))
def test_packed_numbers_are_read_as_they_were(y):
    np.testing.assert_array_equal(unpacked(packed(y)), y.astype("f4"))


@given(arrays(np.float64, st.integers(1, 200), elements=finite), st.integers(0, 200))
def test_quantised_numbers_are_right_to_half_a_level(y, missing):
    y[missing : missing + 3] = np.nan
    again = unpacked(quantised(y))
    np.testing.assert_array_equal(np.isnan(again), np.isnan(y))
    if np.isfinite(y).any():
        span = np.nanmax(y) - np.nanmin(y)
        assert np.nanmax(np.abs(again - y)) <= 0.5 * span / 65534 + 4e-16 * np.nanmax(np.abs(y))


def test_an_envelope_spans_the_time_of_its_rows():
    y = np.sin(np.arange(10_000) / 50)
    curve = envelope("y", "blue", 5.0, 1e-3, y, 500)
    t = unpacked(curve["x"])
    assert curve["style"] == "envelope"
    assert len(t) == 500
    assert t[0] - 0.5 * (t[1] - t[0]) == pytest.approx(5.0 - 5e-4)
    assert t[-1] + 0.5 * (t[1] - t[0]) == pytest.approx(15.0 - 5e-4)
    assert envelope("y", "blue", 5.0, 1e-3, y[:1000], 500)["style"] == "line"


def test_missing_values_do_not_hide_their_neighbours():
    low, high = extremes(np.array([np.nan, 3.0, np.nan, np.nan]), 2)
    assert (low[0], high[0]) == (3.0, 3.0)
    assert np.isnan(low[1])


def test_rows_that_do_not_count_are_shaded_where_they_are():
    out = np.zeros(100, dtype=bool)
    out[20:40] = True
    assert shaded(1.0, 0.1, out, 1000) == [[pytest.approx(2.95), pytest.approx(4.95)]]


def test_a_million_samples_stay_small():
    # Three curves of two float32 in base64 for each bin, at most so many bins in all: below 3 MB whatever the logs.
    y = np.random.default_rng(0).standard_normal(5_000_000)
    curve = envelope("y", "blue", 0.0, 1e-3, y, MOST_BINS)
    assert len(json.dumps(curve)) < 11 * MOST_BINS
    assert 3 * 11 * ALL_BINS < 3e6


def test_bin_means_are_of_the_rows_in_them():
    x = np.repeat([0.0, 1.0, 2.0, 3.0], 10)
    centres, means = binned(x, x**2, bins=4)
    np.testing.assert_allclose(means, [0, 1, 4, 9])
    np.testing.assert_allclose(centres, 0.375 + 0.75 * np.arange(4))


def test_information_adds_up_to_one():
    estimate = found().estimate
    by_motor, by_block = information(estimate)
    np.testing.assert_allclose(by_motor.sum(axis=1), 1)
    np.testing.assert_allclose(by_block.sum(axis=1), 1)
    # Friction of motor 1 acts on no other.
    assert by_motor[estimate.base.names.index("FV1"), 0] > 0.99


def test_information_is_of_the_column_given_all_others():
    # The residual of a regression of one column on the others, motor by motor: Frisch and Waugh's theorem.
    estimate = found().estimate
    W = []
    for weight, motor in zip(estimate.weights, estimate.observation.motors, strict=True):
        wide = np.zeros((len(motor.whole), len(estimate.beta)))
        wide[:, motor.columns] = weight * motor.whole[:, :-1]
        W.append(wide)
    stacked = np.concatenate(W)
    for k in (0, 5, 11):
        others = np.delete(stacked, k, axis=1)
        left = stacked[:, k] - others @ np.linalg.lstsq(others, stacked[:, k])[0]
        ends = np.cumsum([len(part) for part in W])[:-1]
        each = np.array([(part**2).sum() for part in np.split(left, ends)])
        np.testing.assert_allclose(information(estimate)[0][k], each / each.sum(), rtol=1e-6, atol=1e-9)


def test_the_friction_curve_is_the_model_s():
    estimate = found().estimate
    speed, torque = model_curve(source(), 0, 2.0)
    expected = estimate["FV1"].value * speed + estimate["FC1"].value * np.sign(speed)
    np.testing.assert_allclose(torque, expected, rtol=1e-9)


def value_of(element, names):
    """What a MathML element comes to, its parameters and lengths given by name."""
    kind, parts = element.tag, list(element)
    if kind in ("mi", "mn"):
        return names[element.text] if element.text in names else Fraction(element.text)
    if kind == "msub":
        return names[parts[0].text + parts[1].text]
    if kind in ("msup", "msubsup"):
        base = names[parts[0].text + (parts[1].text if kind == "msubsup" else "")]
        return base ** int(parts[-1].text)
    if kind == "mfrac":
        return value_of(parts[0], names) / value_of(parts[1], names)
    return summed(parts, names)


def summed(parts, names):
    """A row: products, sums and brackets, by the grammar that a reader has in mind."""
    tokens = [p.text if p.tag == "mo" else value_of(p, names) for p in parts]
    text = " ".join({"\u2212": "-"}.get(t, t) if isinstance(t, str) else f"* {float(t)!r}" for t in tokens)
    text = text.replace("(", "* (")
    for sign in "+-(":
        text = text.replace(f"{sign} *", sign)
    return eval(text.removeprefix("* "), {})  # the test's own text


@pytest.mark.parametrize("name", ["phantom_premium_15", "puma560", "sr400", "arm7"])
def test_typeset_groupings_have_the_value_of_the_numbers(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    exact = model.regroupings
    rng = np.random.default_rng(3)
    chi = rng.uniform(0.5, 2.0, len(exact.standard))
    names = dict(zip(exact.standard, chi, strict=True)) | {s.name: s.value for s in exact.symbols}
    values = exact.values @ chi
    for mathml, value in zip(groupings(model.base, exact), values, strict=True):
        parts = [part for math in ET.fromstring(f"<all>{mathml}</all>") for part in math]
        assert summed(parts, names) == pytest.approx(value)


def test_groupings_in_numbers_and_names_of_a_user_s_own():
    base = haptid.DynamicModel(haptid.read_device("puma560")).base
    for mathml in groupings(base, None):
        ET.fromstring(f"<all>{mathml}</all>")
    assert parameter("pi_1") == "<math><msub><mi>&#x3c0;</mi><mi>1</mi></msub></math>"
    assert parameter("ZZ1R") == "<math><msub><mi>ZZ</mi><mi>1R</mi></msub></math>"
    assert "<" not in parameter("a<b").replace("<m", "").replace("</m", "")


def test_sparklines_show_where_the_residual_is():
    y = np.concatenate([np.full(50, 0.1), np.full(50, 1.0), np.full(50, np.nan)])
    line = sparkline(rms_of_bins(y, 3))
    assert line == f"{BARS[0]}{BARS[-1]} "
    lines = sparklines(source())
    assert len(lines) == 8
    assert all("up to" in line for line in lines if line.startswith("  "))


def test_every_method_has_its_paper():
    text = bibtex(source())
    for key in ("gautier1991", "khalil1995", "gautier2013", "gautier2001", "bell2002", "janot2007"):
        assert f"{{{key}," in text
    assert all(entry.count("{") == entry.count("}") for entry in entries().values())


def test_a_report_is_kept_and_made_again(tmp_path):
    made().write(tmp_path)
    again = read_report(tmp_path)
    assert again.html() == made().html() == (tmp_path / PAGE).read_text(encoding="utf-8")
    assert (tmp_path / PAGE).stat().st_size < 2e6


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b"not gzip"), "not the data of a report"),
        (lambda path: path.write_bytes(path.read_bytes()[:1000]), "not the data of a report"),
    ],
)
def test_data_that_cannot_be_read_is_rejected(tmp_path, spoil, word):
    made().write_into(tmp_path)
    spoil(tmp_path / DATA)
    with pytest.raises(ResultFileError, match=word):
        read_report(tmp_path)
    assert issubclass(ResultFileError, errors.HaptidError)


def test_a_page_that_cannot_be_written_is_an_error(tmp_path):
    with pytest.raises(OutputFolderError):
        made().write_page(tmp_path / "no" / "such" / "folder.html")


def folder_of(identification, path):
    path.mkdir()
    Result.of(identification).save(path)
    return path


def test_results_are_compared_as_their_estimates_are(tmp_path):
    study = haptid.read_study(source().identification.study.path)
    first = found()
    swapped = tuple(
        type(log)(log.path, "validate" if log.role == "identify" else "identify", log.time_range, log.channels)
        for log in study.logs
    )
    second = haptid.identify(replace(study, logs=swapped), logs())
    folders = [folder_of(first, tmp_path / "monday"), folder_of(second, tmp_path / "tuesday")]
    one, other = (haptid.Result.load(folder) for folder in folders)
    ours = haptid.compare(one, other, independent=False)
    theirs = haptid.compare(first.estimate, second.estimate)
    assert ours.names == theirs.names
    np.testing.assert_allclose(ours.holm, theirs.holm, rtol=1e-6)
    np.testing.assert_allclose(ours.conf_int(), theirs.conf_int(), rtol=1e-6)
    section = write_comparison(folders, tmp_path / "page.html")
    assert [r["name"] for r in section.results] == ["monday", "tuesday"]
    assert "tuesday compared with monday" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_the_force_of_a_hand_is_shown_with_the_sensor():
    force = haptid.estimate_force(found().estimate, found().runs[1].motion)
    sensor = np.nan_to_num(force.force)
    section = HandSection.of(ReportSource(found(), hands=(HandForceData.of("pushed", force, sensor),)))
    assert section is not None
    assert len(section.charts) == 3
    assert "RMS difference 0 N" in section.charts[0].caption
    assert HandSection.of(source()) is None
    whole = make_report(found(), hands=(HandForceData.of("pushed", force),))
    assert "hand" in whole.sections


@settings(max_examples=20)
@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=60))
def test_a_sparkline_has_a_character_for_each_level(levels):
    assert len(sparkline(np.array(levels))) == len(levels)
