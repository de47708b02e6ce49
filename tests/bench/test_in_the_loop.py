"""Exported C of an identified model controls a device on the bench: weight, friction, tracking and the hand's force."""

import shutil

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment import bench
from haptid.experiment.bench.compiled_code import prototypes
from haptid.export import CCode, export_c
from haptid.export.selftest import ReferenceValues
from in_the_loop import CASES, DEVICES, rehearsed, setup_of
from true_parameters import true_parameters

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def rehearsal():
    """Of a PHANToM, at one pose, from a log of 12 s; the simulator steps twice in a control period.

    Half of the benchmark's motion is tracked, and of each stroke one period is measured.
    """
    short = {"seconds": 12.0, "tracked": 3.0, "stroke": bench.Stroke(seconds=1.0)}
    return rehearsed(DEVICES[0], places=((0.3, 0.5, 0.6),), physics=bench.Physics(5e-4), **short)


def test_gravity_compensation_leaves_little_of_the_weight(rehearsal):
    assert max(abs(felt.weight) for felt in rehearsal.bare) > 0.15
    assert rehearsal.weight_left < 0.03


def test_friction_compensation_takes_most_of_it_off_without_chatter(rehearsal):
    assert min(felt.friction for felt in rehearsal.bare) > 0.05
    assert rehearsal.friction_taken > 0.8
    assert all(felt.friction > 0 for felt in rehearsal.assisted)  # none is overcompensated
    assert rehearsal.roughness < 0.15
    assert rehearsal.restless < 1e-6


def test_mass_is_the_models(rehearsal):
    """Nothing takes it off, and the hand measures it: u' (J^-1)' M J^-1 u along every axis."""
    case = CASES[DEVICES[0]]
    setup = setup_of(case)
    pose = (np.array(case.centre) + np.array((0.3, 0.5, 0.6)) * case.amplitude)[:, None]
    beta = setup.model.base.of(setup.chi)
    J = np.linalg.inv(haptid.dynamics.handle_motion(setup.model, pose).jacobian[0, :3])
    wanted = np.diag(J.T @ haptid.dynamics.mass_matrix(setup.model, beta, pose)[0] @ J)
    for side in (rehearsal.bare, rehearsal.assisted):
        np.testing.assert_allclose([felt.mass for felt in side], wanted, rtol=0.1)


def test_the_model_tracks_better_and_sees_the_hand(rehearsal):
    assert rehearsal.better_tracking > 5
    assert rehearsal.better_force > 5


# --- the code itself --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
def test_compiled_code_is_the_python_model(tmp_path, precision):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = model.base.of(true_parameters(model))
    export_c((model, beta), tmp_path, CCode("dev", precision))
    code = bench.Compiled.of(tmp_path)
    reference = ReferenceValues.at_random(model, beta, 0.01, 3)
    close = {"rtol": 1e-9, "atol": 1e-12} if precision == "double" else {"rtol": 1e-3, "atol": 1e-5}
    for name in ("inverse_dynamics", "mass_matrix", "handle_jacobian", "momentum"):
        wanted = reference.functions[name]()
        for k in range(3):
            made = code(name, *(getattr(reference, x)[:, k] for x in code.functions[name].inputs))
            for output, values in wanted.items():
                np.testing.assert_allclose(made[output], values[k], **close)
    half = code.friction_compensation(reference.qd[:, 0], 0.5)
    np.testing.assert_allclose(half, 0.5 * reference.functions["friction"]()["tau"][0], **close)
    assert code.coordinates == 3


def test_functions_are_read_from_the_header():
    text = (
        "void m_f(const m_model *model,\n         const m_real q[2], m_real M[4]);\nint m_g(m_real x, m_real y[1]);\n"
    )
    found = prototypes(text, "m")
    assert set(found) == {"f"}  # g takes a number: it has a method of its own
    assert found["f"].inputs == {"q": 2}
    assert found["f"].outputs == {"M": 4}
    assert found["f"].takes_model


def test_folders_without_code_and_code_that_does_not_compile(tmp_path, monkeypatch):
    with pytest.raises(errors.ExportError) as raised:
        bench.Compiled.of(tmp_path)
    assert raised.value.found == []
    model = haptid.DynamicModel(haptid.read_device("emps"))
    made = export_c((model, np.ones(len(model.base))), tmp_path, CCode("dev"))
    code = bench.Compiled.of(tmp_path)
    with pytest.raises(errors.SettingError) as raised:
        code.observer(-1.0, 1e-3)
    assert raised.value.where == "gain"
    with pytest.raises(errors.SettingError) as raised:
        code.differentiator(600.0, 1e-3)
    assert raised.value.where == "cutoff_hz"
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(errors.MissingDependencyError) as raised:
        bench.Compiled.of(tmp_path)
    assert raised.value.where == "no-such-compiler"
    monkeypatch.delenv("CC")
    (made.folder / "haptid-files.json").unlink()
    (made.folder / "dev.c").write_text("this is no C")
    with pytest.raises(errors.ExportError) as raised:
        bench.Compiled.of(tmp_path)
    assert raised.value.where.name == "dev.c"
    export_c((model, np.ones(len(model.base))), tmp_path, CCode("other"))
    with pytest.raises(errors.ExportError) as raised:
        bench.Compiled.of(tmp_path)
    assert raised.value.found == ["dev.h", "other.h"]
