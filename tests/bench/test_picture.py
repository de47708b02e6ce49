"""Pictures of a device in motion."""

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment import bench
from haptid.experiment.bench.picture import stick_figure
from true_parameters import true_parameters

pytestmark = pytest.mark.usefixtures("full_pictures")
TIMES = [0.0, 0.5, 1.0]


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "rx90"])
def test_strip_of_stick_figures_is_drawn(name, tmp_path):
    model = haptid.DynamicModel(haptid.read_device(name))
    qa = np.random.default_rng(0).uniform(-0.5, 0.5, (3, len(model.device.active)))
    bench.draw_strip(model, qa, TIMES, tmp_path / "strip.png")
    assert (tmp_path / "strip.png").read_bytes().startswith(b"\x89PNG")


def test_handle_is_where_the_papers_state():
    """p = Ry(theta1)(L1 e2 + L2 e3) of Cavusoglu et al. (2002)."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    qa = np.random.default_rng(1).uniform(-0.6, 0.6, (10, 3))
    _, handle = stick_figure(model, qa)
    (s1, s2, s3), (c1, c2, c3) = np.sin(qa.T), np.cos(qa.T)
    reach = 0.215 * c2 + 0.17 * s3
    wanted = np.array([reach * s1, 0.215 * s2 - 0.17 * c3, reach * c1]).T
    np.testing.assert_allclose(handle, wanted, atol=1e-14)


def test_pictures_that_cannot_be_drawn(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    with pytest.raises(errors.ExperimentError, match="no instant"):
        bench.draw_strip(model, np.zeros((0, 3)), [], tmp_path / "strip.png")
    with pytest.raises(errors.ExperimentError, match="Choose"):
        bench.draw_strip(model, np.zeros((1, 3)), [0.0], tmp_path / "absent" / "strip.png")


def test_rendering_works_or_says_what_to_do(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    path = tmp_path / "strip.png"
    said = ""
    try:
        bench.render_strip(model, true_parameters(model), np.zeros((2, 3)), path)
    except errors.ExperimentError as error:
        said = str(error)
    assert path.exists() or "draw_strip" in said
