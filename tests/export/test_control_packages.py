"""Packages for ros2_control, CHAI3D and the dVRK compile against the interfaces, and compute what the model does."""

import dataclasses
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import haptid
from compiled import compiler, run
from haptid.dynamics.kinematics import handle_motion
from haptid.errors import ExportError, UnvalidatedModelError
from haptid.export import CCode, export_chai3d, export_dvrk, export_ros2_control
from haptid.export.formats.dvrk import law
from true_parameters import true_parameters

# What controllers use of ros2_control and other interfaces.
STUBS = Path(__file__).resolve().parents[1] / "stubs"
STRICT = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I.", "-isystem", str(STUBS)]
STATE = ("0.1, 0.2, 0.3", [0.1, 0.2, 0.3])

ROS_MAIN = """
#include "dev_controller.cpp"
#include <cstdio>
int main()
{
    dev_controller::Compensation c;
    const rclcpp_lifecycle::State now;
    c.on_init();
    if (c.on_configure(now) == controller_interface::CallbackReturn::SUCCESS) { return 1; }  // no limits
    c.node_->of["joints"].s = {"a", "b", "c"};
    c.node_->of["effort_limits"].d = {10, 10, 0.01};
    c.node_->of["gravity_share"].x = 1.0;
    if (c.on_configure(now) != controller_interface::CallbackReturn::SUCCESS) { return 2; }
    if (c.state_interface_configuration().names[3] != "b/velocity") { return 3; }
    for (double q : {@STATE@}) { c.state_interfaces_.push_back({q}); c.state_interfaces_.push_back({0.0}); }
    c.command_interfaces_.resize(3);
    c.update({}, {});
    for (const auto &one : c.command_interfaces_) { std::printf("%.17g ", one.v); }
}
"""

# What the header uses of CHAI3D.
CHAI = """
#pragma once
#include <memory>
namespace chai3d {
const int C_MAX_DOF = 16;
struct cVector3d {
    double v[3] = {}; cVector3d() {} cVector3d(double x, double y, double z) : v{x, y, z} {}
    cVector3d operator+(const cVector3d &o) const { return {v[0] + o.v[0], v[1] + o.v[1], v[2] + o.v[2]}; }
};
struct cMatrix3d {
    double m[9] = {};
    cMatrix3d() {}
    cMatrix3d(double a, double b, double c, double d, double e, double f, double g, double h, double i)
        : m{a, b, c, d, e, f, g, h, i} {}
    cVector3d operator*(const cVector3d &x) const
    {
        cVector3d y;
        for (int i = 0; i < 3; ++i) { for (int k = 0; k < 3; ++k) { y.v[i] += m[3 * i + k] * x.v[k]; } }
        return y;
    }
};
struct cHapticDeviceInfo {};
struct cPrecisionClock { static double getCPUTimeSeconds() { return 0; } };
class cGenericHapticDevice {
public:
    virtual ~cGenericHapticDevice() = default;
    virtual bool open() { return false; }
    virtual bool close() { return false; }
    virtual bool calibrate(bool = false) { return false; }
    virtual bool getPosition(cVector3d &) { return false; }
    virtual bool getRotation(cMatrix3d &) { return false; }
    virtual bool getLinearVelocity(cVector3d &) { return false; }
    virtual bool getAngularVelocity(cVector3d &) { return false; }
    virtual bool getJointAnglesRad(double[C_MAX_DOF]) { return false; }
    virtual bool getGripperAngleRad(double &) { return false; }
    virtual bool getUserSwitch(int, bool &) { return false; }
    virtual bool getUserSwitches(unsigned int &) { return false; }
    virtual bool setForceAndTorqueAndGripperForce(const cVector3d &, const cVector3d &, double) { return false; }
    cHapticDeviceInfo getSpecifications() { return {}; }
    cHapticDeviceInfo m_specifications; cVector3d m_prevForce; bool m_deviceReady = false;
};
typedef std::shared_ptr<cGenericHapticDevice> cGenericHapticDevicePtr;
}
"""
CHAI_MAIN = """
#include "dev_chai3d.h"
#include <cstdio>
struct Arm : chai3d::cGenericHapticDevice {
    chai3d::cVector3d sent;
    bool getJointAnglesRad(double a[]) override { int i = 0; for (double q : {@STATE@}) { a[i++] = q; } return true; }
    bool setForceAndTorqueAndGripperForce(const chai3d::cVector3d &f, const chai3d::cVector3d &, double) override
    { sent = f; return true; }
};
int main()
{
    auto arm = std::make_shared<Arm>();
    dev_compensated device(arm);
    device.setForceAndTorqueAndGripperForce({1, 0, 0}, {}, 0);
    std::printf("%.17g %.17g %.17g", arm->sent.v[0], arm->sent.v[1], arm->sent.v[2]);
}
"""


def phantom():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return model, model.base.of(true_parameters(model))


def gravity(model, beta, q):
    return haptid.inverse_dynamics(model, beta, q, np.zeros_like(q), np.zeros_like(q))


def numbers_of(folder, main):
    (folder / "main.cpp").write_text(main.replace("@STATE@", STATE[0]))
    run([compiler("gcc"), "-c", "dev.c", "-o", "dev.o"], folder)
    run([compiler("g++"), *STRICT, "main.cpp", "dev.o", "-lm", "-o", "main"], folder)
    return np.array(run(["./main"], folder).stdout.split(), dtype=float)


def test_the_controller_sends_limited_gravity(tmp_path):
    model, beta = phantom()
    made = export_ros2_control((model, beta), tmp_path, CCode("dev"))
    wanted = np.clip(gravity(model, beta, np.array(STATE[1])[:, None])[:, 0], [-10, -10, -0.01], [10, 10, 0.01])
    np.testing.assert_allclose(numbers_of(tmp_path, ROS_MAIN), wanted, rtol=1e-12, atol=1e-15)
    assert ElementTree.parse(tmp_path / "package.xml").getroot().findtext("name") == "dev_controller"
    library = ElementTree.parse(tmp_path / "plugin.xml").getroot()
    assert library.find("class").get("name") == "dev_controller/Compensation"
    assert {"CMakeLists.txt", "controller.yaml", "dev_controller.cpp", "dev.c", "dev.h"} <= set(made.files)


def test_a_device_of_chai3d_carries_its_weight(tmp_path):
    model, beta = phantom()
    export_chai3d((model, beta), tmp_path, CCode("dev"))
    (tmp_path / "chai3d.h").write_text(CHAI)
    force = numbers_of(tmp_path, CHAI_MAIN) - [1, 0, 0]
    q = np.array(STATE[1])[:, None]
    J = handle_motion(model, q).jacobian[0, :3]
    np.testing.assert_allclose(J.T @ force, gravity(model, beta, q)[:, 0], rtol=1e-10, atol=1e-13)


TURNED = ("0", "pi/2", "0", "pi/2", "-pi/2", "pi/2", "-pi/2")
MTM = list(zip(TURNED, (0, 0, 0.279, 0.365, 0, 0, 0), (0, 0, 0, 0.15, 0, 0, 0), strict=True))


def manipulator(folder, limits="limits = { torque = 2.0 }"):
    """Seven joints with the axes of a Master Tool Manipulator, springs and dry friction."""
    text = 'name = "Master arm"\ngravity = [0, 0, -9.81]\n'
    for k, (alpha, d, r) in enumerate(MTM):
        text += f'[[joints]]\nname = "{k + 1}"\nalpha = "{alpha}"\nd = {d}\nr = {r}\n{limits}\n'
    text += '[[terms]]\nkind = "coulomb"\njoints = ["1", "2", "3", "4", "5", "6"]\n'
    (folder / "device.toml").write_text(text)
    model = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    chi, names = np.array(true_parameters(model)), model.device.parameters.names
    chi[[names.index("MX7"), names.index("MY7")]] = 0.0  # a balanced gripper
    return model, model.base.of(chi)


def test_the_controller_of_the_dvrk_has_the_torque_of_the_model(tmp_path):
    model, beta = manipulator(tmp_path)
    made = export_dvrk((model, beta), tmp_path / "made")
    read = json.loads((made.folder / made.files[0]).read_text())
    given = read["GC_controller"]
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (7, 50))
    for key, sign in (("gc_dynamic_params_pos", 1e-9), ("gc_dynamic_params_neg", -1e-9)):
        wanted = haptid.inverse_dynamics(model, beta, q, np.full_like(q, sign), np.zeros_like(q))
        found = np.einsum("jps,p->js", law(q), given[key])
        np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())
    assert given["safe_upper_torque_limit"] == [2.0] * 7
    assert float(read["version"]) == 2


def test_the_law_is_the_derivative_of_one_potential():
    """Gravity is conservative: the derivatives of its torques are symmetric."""
    q, h = np.random.default_rng(2).uniform(-3, 3, (7, 1)), 1e-5
    slopes = [(law(q + h * e[:, None]) - law(q - h * e[:, None]))[:, :10, 0] / (2 * h) for e in np.eye(7)]
    H = np.array(slopes)  # (by joint, of joint, parameter)
    np.testing.assert_allclose(H, H.transpose(1, 0, 2), atol=1e-7)


def test_another_arm_and_unknown_limits_are_refused(tmp_path):
    with pytest.raises(ExportError, match="limits of 1, 2"):
        export_dvrk(manipulator(tmp_path, ""), tmp_path / "x")
    with pytest.raises(ExportError, match="3 active joints"):
        export_dvrk(phantom(), tmp_path / "x")


@pytest.mark.parametrize("export", [export_chai3d, export_dvrk])
def test_a_criterion_without_validation_is_refused_and_the_verdict_is_written(tmp_path, export):
    model, beta = phantom() if export is export_chai3d else manipulator(tmp_path)
    with pytest.raises(UnvalidatedModelError):
        export((model, beta), tmp_path / "out", largest_error=5.0)
    assert not (tmp_path / "out").exists()
    made = export((model, beta), tmp_path / "out", largest_error=5.0, anyway=True)
    assert made.verdict
    assert any(made.verdict in (made.folder / file).read_text() for file in made.files)


@pytest.mark.parametrize("export", [export_chai3d, export_dvrk])
def test_a_name_cannot_leave_its_comment(tmp_path, export):
    name = "*/ int owned; /* \x1b[2J \\\n#include <x>\x00"
    model, _ = phantom() if export is export_chai3d else manipulator(tmp_path)
    model = haptid.DynamicModel(dataclasses.replace(model.device, name=name))
    beta = model.base.of(true_parameters(model)) if export is export_chai3d else manipulator(tmp_path)[1]
    made = export((model, beta), tmp_path / "out")
    for text in ((made.folder / file).read_text() for file in made.files):
        assert not any(ord(c) < 32 and c not in "\n\t" for c in text)
        assert "\nint owned" not in text
        assert "*/ int owned" not in text or text.startswith("{")
    if export is export_dvrk:
        json.loads((made.folder / made.files[0]).read_text())
    else:
        (source,) = (file for file in made.files if file.endswith(".c"))
        run([compiler("cc"), "-std=c99", "-Wall", "-Werror", "-c", source, "-o", "made.o"], made.folder)
