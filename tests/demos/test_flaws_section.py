"""The column with the flaws of a real device: what is true of its rigid part, and a small run."""

import numpy as np
import pytest

import haptid
from haptid.demos import read_demo
from haptid.demos.accuracy import accuracy
from haptid.demos.flaws import flaws_section
from haptid.demos.phantom_configurations.fits import fitted
from haptid.demos.phantom_configurations.results import flawed
from haptid.demos.recordings import Take, as_in_file, read_recording, record
from haptid.experiment.bench import read_experiment
from haptid.treatment_choice.propose import propose


def truths(name, key, folder):
    """The model of the file, and true base parameters without flaws and of the rigid part with them."""
    demo = read_demo(name)
    model = haptid.DynamicModel(haptid.read_device(demo.device))
    plain, real = (read_experiment(demo.write_experiment(one, folder)).setup(model) for one in (key, demo.flawed.fit))
    assert real.model.device.elastic
    return model, model.base.of(plain.chi), as_in_file(model, real.model, real.model.base.of(real.chi))


def test_rotors_behind_cables_are_inertia_of_the_joints_that_they_drive(tmp_path):
    model, plain, rigid = truths("phantom", "normal", tmp_path)
    rotors = {"ZZbaR": 2e-4, "ZZbeR": 1.5e-4, "ZZdfR": 1.5e-4}
    wanted = plain + np.array([rotors.get(name, 0.0) for name in model.base.names])
    np.testing.assert_allclose(rigid, wanted, atol=1e-9 * np.abs(wanted).max())


def test_a_branch_whose_rotors_were_at_the_joints_has_the_same_rigid_part(tmp_path):
    _, plain, rigid = truths("medical", "upper", tmp_path)
    np.testing.assert_allclose(rigid, plain, atol=1e-9 * np.abs(plain).max())


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Seven seconds of the first mounting, without flaws and with them, by coarse steps."""
    pytest.importorskip("mujoco")
    demo, folder, made = read_demo("phantom"), tmp_path_factory.mktemp("flaws"), []
    model = haptid.DynamicModel(haptid.read_device(demo.device))
    for key in ("normal", demo.flawed.fit):
        take = demo.take(key, folder)
        text = take.experiment.read_text(encoding="utf-8").replace("seconds = 40.0", "seconds = 7.0")
        take.experiment.write_text(text, encoding="utf-8")
        record(Take(take.device, take.experiment, take.out, step=5e-4))
        made.append(read_recording(model, take.experiment, take.out))
    stretch = demo.stretch.model_copy(update={"start": 0.8, "middle": 3.8, "stop": 6.4})
    return demo.model_copy(update={"stretch": stretch}), *made


def test_flaws_make_figures_grow(recordings):
    demo, ideal, real = recordings
    halves = (demo.stretch.fit, demo.stretch.unseen)
    treatment = propose(ideal.model, ideal.log(halves[0])).treatment
    ours = fitted("", ideal.model, [ideal.motion(half, treatment) for half in halves])
    found = flawed(demo, ours, ideal, real)
    near = accuracy(ours.targets, ideal, halves[1])
    assert found.ideal["viscous friction, worst, %"] == near.worst("viscous")
    for name in ("exact torque of the rigid device, worst motor, %", "Coulomb friction, worst, %"):
        assert found.flawed[name] > 3 * found.ideal[name], name
    (table,) = flaws_section(found).tables
    assert len(table.cells) == 1 + len(found.ideal)
    before, after, times = (float(cell) for cell in table.cells[1][1:])
    assert times == pytest.approx(after / before, rel=0.05)
