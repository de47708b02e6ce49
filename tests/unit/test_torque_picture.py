"""The picture of a prediction: what is drawn, read back from the file."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from haptid.report.torque_picture import draw_torque
from haptid.validation.prediction import Prediction

SVG = "{http://www.w3.org/2000/svg}"


def prediction(t, tau, names=("motor 1",), used=None):
    measured = np.array([tau + k for k in range(len(names))])
    kept = np.ones(measured.shape, dtype=bool) if used is None else used
    return Prediction(tuple(names), ("N m",) * len(names), t.copy(), measured, 0.9 * measured, kept)


def picture(path, parts, rows, title="study: log.csv (unseen)"):
    draw_torque(parts, rows, title, path)
    return ElementTree.parse(path).getroot()


def paths(root, colour):
    """Points of each curve of a colour, (points, 2), in tenths of a pixel."""
    found = []
    for path in root.iter(f"{SVG}path"):
        if path.get("stroke") == colour and path.get("fill") == "none":
            numbers = np.array(re.findall(r"-?\d+", path.get("d")), dtype=int).reshape(-1, 2)
            found.append(np.cumsum(numbers, axis=0))
    return found


@pytest.mark.parametrize(("rows", "scale"), [(300, 1.0), (50_001, 0.02)], ids=["every row", "thinned"])
def test_a_curve_is_where_its_axes_say(tmp_path, rows, scale):
    t = np.linspace(2.0, 12.0, rows)
    tau = scale * np.sin(t)
    root = picture(tmp_path / "made.svg", [prediction(t, tau)], rows)
    (curve,) = paths(root, "#000000")
    texts = list(root.iter(f"{SVG}text"))
    place, value = np.array([(int(o.get("y")) - 40, float(o.text)) for o in texts if o.get("text-anchor") == "end"]).T
    down = np.polyfit(place, value, 1)
    below = [o for o in texts if o.get("text-anchor") == "middle" and re.fullmatch(r"[\d.]+", o.text)]
    along = np.polyfit([int(o.get("x")) for o in below], [float(o.text) for o in below], 1)
    assert len(place) >= 3
    assert len(below) >= 5
    x, y = np.polyval(along, curve[:, 0]), np.polyval(down, curve[:, 1])
    assert (x.min(), x.max()) == pytest.approx((2.0, 12.0), abs=0.01)
    assert np.abs(y - scale * np.sin(x)).max() < 0.01 * scale
    assert y.max() == pytest.approx(scale, abs=2e-3 * scale)
    assert len(curve) <= 2000


def test_a_spike_of_one_row_is_seen_in_a_long_log(tmp_path):
    t, tau = np.linspace(0.0, 1.0, 100_000), np.zeros(100_000)
    tau[77_777] = -5.0
    (curve,) = paths(picture(tmp_path / "made.svg", [prediction(t, tau)], len(t)), "#000000")
    low = curve[curve[:, 1].argmax()]
    assert low[1] - np.median(curve[:, 1]) > 1000
    assert low[0] == pytest.approx(1150 + 0.77777 * 8700, abs=10)


def test_excluded_rows_are_shaded_over_chunks(tmp_path):
    t = np.linspace(0.0, 10.0, 1001)
    used = (t < 2.0) | (t > 7.0)
    halves = [slice(0, 500), slice(500, None)]
    parts = [prediction(t[own], np.sin(t[own]), used=used[None, own].copy()) for own in halves]
    root = picture(tmp_path / "made.svg", parts, len(t))
    (shade,) = [p for p in root.iter(f"{SVG}path") if p.get("fill") == "#D9D9D9"]
    start, end = (int(re.search(pattern, shade.get("d"))[1]) for pattern in (r"^M(\d+)", r"H(\d+)"))
    assert ((start - 1150) / 870, (end - 1150) / 870) == pytest.approx((2.0, 7.0), abs=0.2)
    assert "excluded" in [one.text for one in root.iter(f"{SVG}text")]
    bare = picture(tmp_path / "bare.svg", [prediction(t, np.sin(t))], len(t))
    assert "excluded" not in [one.text for one in bare.iter(f"{SVG}text")]


def test_a_name_is_text_and_no_markup(tmp_path):
    name = "<script>alert('1')</script> & \x1b\"µ\""
    root = picture(tmp_path / "made.svg", [prediction(np.arange(9.0), np.arange(9.0), (name,))], 9, title=name)
    shown = [one.text for one in root.iter(f"{SVG}text")]
    assert shown.count("<script>alert('1')</script> & \\x1b\"µ\"") == 2
    assert not list(root.iter(f"{SVG}script"))


@pytest.mark.parametrize("tau", [np.zeros(5), np.full(5, np.nan), 1e-9 * np.arange(5), np.array([0, 1, np.nan, 2, 3])])
def test_torque_that_is_constant_unknown_or_tiny_is_drawn(tmp_path, tau):
    root = picture(tmp_path / "made.svg", [prediction(np.arange(5.0), tau, ("motor 1", "motor 2"))], 5)
    first, second = paths(root, "#000000") if np.isfinite(tau).any() else ([], [])
    assert len(first) == len(second) == np.isfinite(tau).sum()
