"""Code for loops that are not linear: closed within its bound at every sample, then the Python model's numbers."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import closed_devices
import haptid
from compiled import NAME, STRICT, compiler, named, relative, run
from haptid.errors import ExportError
from haptid.export import CCode, export_c, export_chai3d, export_matlab, export_ros2_control, export_rust
from haptid.export.expressions.rewriting import values_of
from haptid.export.model.functions import code_of
from haptid.export.model.passive import passive_joints, passive_positions, start_positions
from haptid.export.selftest import ReferenceValues
from true_parameters import true_parameters

SPEED = 0.05
LIBRARY = Path(haptid.__file__).parent / "device" / "library"
NAMES = (*closed_devices.NAMES, "cea_medical_interface")
# Rounding of positions, rad or sizes of the mechanism: Python closes loops to 1e-12 of the size.
ROUNDING = 2e-12


@cache
def coded(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    return model, model.base.of(true_parameters(model)), code_of(model, SPEED)


def called(code, name, beta, **inputs):
    """Outputs of a function, each (size, samples)."""
    samples = np.shape(inputs["q"])[1]
    values = named(beta, **inputs)
    return {
        output: np.array([np.broadcast_to(x, samples) for x in values_of(code.graph, list(entries), values)])
        for output, entries in code[name].outputs
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_function_is_the_python_models(name):
    model, beta, code = coded(name)
    reference = ReferenceValues.at_random(model, beta, SPEED, 40)
    assert {"close", "inverse_dynamics", "momentum", "handle_jacobian"} <= set(code.operations)
    for function in code.functions:
        kept = reference.at(np.flatnonzero(reference.sound(function.name)))
        assert kept.q.shape[1] > 20
        made = called(code, function.name, beta, **kept.inputs)
        for output, wanted in kept.functions[function.name]().items():
            assert relative(made[output].T, wanted) < 1e-8, (function.name, output)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("step", "most"), [(1e-3, 1e-12), (5e-2, 1e-5)])
def test_loops_close_within_the_bound_along_a_motion(name, step, most):
    """At 1 kHz to rounding; with samples too far apart for that, within a bound that says so."""
    model, beta, code = coded(name)
    qa, qda, _ = closed_devices.path(model, 0.2 if step < 0.01 else 0.8, step, size=0.15)
    assert np.abs(qda).max() > 0.5
    q = model.device.row_map @ qa
    wanted = passive_positions(model, q)
    z, bounds = wanted[:, :1], []
    for k in range(1, q.shape[1]):
        made = called(code, "close", beta, q=q[:, k : k + 1], before=z)
        z = made["z"]
        bounds.append(made["bound"].item())
        assert np.linalg.norm(z[:, 0] - wanted[:, k]) <= bounds[-1] + ROUNDING
    assert max(bounds) < most
    if step > 1e-2 and name != "cea_medical_interface":
        assert max(bounds) > 1e-12  # the bound is put to the test beyond rounding


def test_a_delta_keeps_its_platform_upright():
    """Of ten passive joints six are found; the others follow, and the gaps of orientation vanish."""
    model, _, code = coded("delta")
    found = passive_joints(model)
    assert len(found.joints) == 10
    assert len(found.found) == len(code.passive) == 6
    q = model.device.closure.draw(np.random.default_rng(7), 50)
    known = np.vstack([q, passive_positions(model, q)])
    positions = model.device.closure.positions(q)[list(found.joints)]
    np.testing.assert_allclose(found.rates @ known + found.offset[:, None], positions, atol=1e-9)


@pytest.mark.parametrize(("name", "close", "inverse"), [("five_bar", 145, 205), ("delta", 1050, 1150)])
def test_code_stays_cheap(name, close, inverse):
    found = coded(name)[2].operations
    assert found["close"].arithmetic <= close
    assert found["inverse_dynamics"].arithmetic <= inverse


# The five-bar with a third motor between its left bars; the law has weights and a preload.
THIRD = """
[transmission]
weights = { 1 = 1.0, 2 = 4.0, elbow = 0.5 }
preload = { 1 = 0.02, 2 = 0.0, elbow = -0.01 }

[[motors]]
name = "elbow"
drives = { 3 = 1 }

"""


def with_a_third_motor(folder):
    text = (LIBRARY / "five_bar.toml").read_text()
    at = text.index("[[terms]]")
    (folder / "driven.toml").write_text(text[:at] + THIRD + text[at:])
    return haptid.DynamicModel(haptid.read_device(folder / "driven.toml"))


def test_redundant_motors_share_a_torque_by_the_law(tmp_path):
    """Both directions are the Python model's, and the C self-test passes."""
    model = with_a_third_motor(tmp_path)
    beta = np.linspace(0.5, 1.0, len(model.base))
    code, device = code_of(model, SPEED), model.device
    reference = ReferenceValues.at_random(model, beta, SPEED, 30)
    shared = called(code, "motor_torque", beta, **reference.inputs)["motor"]
    assert relative(shared, device.drive_torque(reference.q, reference.tau)) < 1e-12
    back = called(code, "row_torque", beta, **{**reference.inputs, "motor": shared})["tau"]
    assert relative(back, reference.tau) < 1e-12
    # Other torques with the same effect cost more, by the law's weights, beyond its preload.
    given = called(code, "row_torque", beta, **reference.inputs)["tau"]
    least = called(code, "motor_torque", beta, **{**reference.inputs, "tau": given})["motor"]
    weights, preload = device.law.weights[:, None], device.law.preload[:, None]
    costs = [(weights * (torque - preload) ** 2).sum(axis=0) for torque in (least, reference.motor)]
    assert (costs[0] < costs[1]).all()
    export_c((model, beta), tmp_path / "c", CCode(NAME))
    run([compiler("gcc"), *STRICT, f"{NAME}.c", f"{NAME}_selftest.c", "-lm", "-o", "selftest"], tmp_path / "c")
    run(["./selftest"], tmp_path / "c")


DRIVER = """
#include "dev.h"
#include <stdio.h>
int main(void)
{
    dev_loops loops;
    const double near[2] = {dev_start_q[0] + 0.01, dev_start_q[1]};
    const double away[2] = {dev_start_q[0] + 1.5, dev_start_q[1] - 2.5};
    double z[2];
    if (dev_loops_start(&loops, near) != 0 || loops.bound > 1e-12) return 1;
    z[0] = loops.z[0];
    z[1] = loops.z[1];
    if (dev_loops_update(&loops, away) != 1) return 2; /* beyond the reach */
    if (loops.z[0] != z[0] || loops.z[1] != z[1]) return 3;
    return dev_loops_start(&loops, away) == 1 ? 0 : 4;
}
"""


@pytest.mark.parametrize("precision", ["double", "single"])
def test_selftest_and_example_without_a_warning(tmp_path, precision):
    model, beta, _ = coded("five_bar")
    export_c((model, beta), tmp_path, CCode(NAME, precision, SPEED))
    for program in ("selftest", "example"):
        run([compiler("gcc"), *STRICT, f"{NAME}.c", f"{NAME}_{program}.c", "-lm", "-o", program], tmp_path)
        run([f"./{program}"], tmp_path)


def test_poses_out_of_reach_are_told_and_the_state_is_kept(tmp_path):
    model, beta, _ = coded("five_bar")
    export_c((model, beta), tmp_path, CCode(NAME))
    (tmp_path / "driver.c").write_text(DRIVER)
    run([compiler("gcc"), *STRICT, f"{NAME}.c", "driver.c", "-lm", "-o", "driver"], tmp_path)
    run(["./driver"], tmp_path)


def test_rust_and_matlab_have_the_start_pose(tmp_path):
    model, beta, _ = coded("slider_crank")
    rust = export_rust((model, beta), tmp_path / "rust", CCode(NAME))
    text = (rust.folder / "src/lib.rs").read_text()
    assert f"pub const START_Z: [f64; 2] = [{', '.join(map(repr, start_positions(model).tolist()))}];" in text
    assert "pub fn close(q: &[f64; 1], before: &[f64; 2]) -> Option<([f64; 2], [f64; 1])>" in text
    matlab = export_matlab((model, beta), tmp_path / "matlab", CCode(NAME))
    assert {f"{NAME}_start.m", f"{NAME}_close.m"} <= set(matlab.files)
    assert "if ~sound, z(:) = before; end" in (matlab.folder / f"{NAME}_close.m").read_text()


@pytest.mark.parametrize("export", [export_ros2_control, export_chai3d])
def test_packages_without_loops_refuse_such_a_device(tmp_path, export):
    model, beta, _ = coded("four_bar")
    with pytest.raises(ExportError, match="loops_update") as raised:
        export((model, beta), tmp_path)
    assert raised.value.found == ["coupler", "rocker"]
