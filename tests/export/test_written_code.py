"""Written C: the same numbers as the Python model, no warning, no undefined behaviour, and no more operations."""

import ctypes
import subprocess
import tempfile
from functools import cache

import numpy as np
import pytest

import haptid
from compiled import NAME, STRICT, Library, compiler, relative, run
from haptid.end_effector.momentum_observer import MomentumObserver
from haptid.export import CCode, export_c
from haptid.export.model.functions import code_of
from haptid.export.model.moments import moments_of
from haptid.export.selftest import ReferenceValues
from haptid.motion.filters import HighPass
from true_parameters import true_parameters

SPEED = 0.01
# Of states at random: a wrong branch or sign shows in any of them; what is rare are poses close to singular ones.
STATES = 2000
DEVICES = (
    "phantom_premium_15",
    "phantom_premium_15_general",
    "cea_medical_branch",
    "puma560",
    "arm7",
    "emps",
    "kuka_kr300",
    "staubli_tx40",
    "sr400",
)
# Relative to an output's largest entry over all states.
TOLERANCE = {"double": 1e-12, "single": 1e-5}
# A seven-joint arm of the kind with seven intersecting axes, 43 base parameters.
ANGLES, OFFSETS = (0, -1, 1, 1, -1, -1, 1), (0.34, 0, 0.4, 0, 0.4, 0, 0)


@cache
def modelled(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    return model, model.base.of(true_parameters(model))


@cache
def code_for(name):
    return code_of(modelled(name)[0], SPEED)


@cache
def files_of(name, precision):
    """Content of every file, by its path."""
    with tempfile.TemporaryDirectory() as folder:
        made = export_c(modelled(name), folder, CCode(NAME, precision, SPEED))
        return {file: (made.folder / file).read_bytes() for file in made.files}


def written(folder, name, precision="double"):
    for file, content in files_of(name, precision).items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(content)
    return modelled(name)


@pytest.fixture(scope="module")
def seven(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "seven.toml"
    joints = "".join(
        f'[[joints]]\nname = "{k + 1}"\nalpha = "{a}*pi/2"\nr = {r}\n'
        for k, (a, r) in enumerate(zip(ANGLES, OFFSETS, strict=True))
    )
    head = 'schema = 1\nname = "seven"\ngravity = [0.0, 0.0, -9.81]\nconvention = "modified-dh"\n'
    path.write_text(head + joints)
    return haptid.DynamicModel(haptid.read_device(path))


@pytest.mark.parametrize(
    ("name", "precision"), [*((name, "double") for name in DEVICES), (DEVICES[0], "single"), (DEVICES[2], "single")]
)
def test_functions_are_the_python_models(tmp_path, name, precision):
    model, beta = written(tmp_path, name, precision)
    library = Library.built(tmp_path, code_for(name), precision)
    rounded = library.real
    reference = ReferenceValues.at_random(model, beta, SPEED, STATES)
    # The states that the code is given are those that its numbers can hold.
    arrays = {x: getattr(reference, x).astype(rounded).astype(float) for x in ("q", "qd", "qdd", "tau", "motor")}
    reference = ReferenceValues(model, beta, SPEED, **arrays, before=reference.before)
    for function in library.code.functions:
        if function.checks:
            continue
        got = library(function.name, arrays)
        for output, wanted in reference.functions[function.name]().items():
            assert relative(got[output], wanted) < TOLERANCE[precision], (function.name, output)


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "puma560", "kuka_kr300"])
def test_solutions_solve(tmp_path, name):
    """Accelerations give the torque back; mobility and force are those of a solver that pivots."""
    model, beta = written(tmp_path, name)
    library = Library.built(tmp_path, code_for(name), "double")
    reference = ReferenceValues.at_random(model, beta, SPEED, STATES)
    reference = reference.at(np.flatnonzero(reference.sound("forward_dynamics")))
    assert reference.q.shape[1] > 0.9 * STATES
    arrays = {x: getattr(reference, x) for x in ("q", "qd", "qdd", "tau")}
    qdd = library("forward_dynamics", arrays)["qdd"]
    again = library("inverse_dynamics", arrays | {"qdd": qdd.T})["tau"]
    size = np.abs(reference.tau.T) + np.abs(library("inverse_dynamics", arrays | {"qdd": 0 * qdd.T})["tau"])
    assert relative(again - reference.tau.T + size, size) < 1e-10
    for function in ("handle_mobility", "handle_force"):
        if function in library.code:
            kept = reference.at(np.flatnonzero(reference.sound(function))[: STATES // 10])
            got = library(function, {x: getattr(kept, x) for x in ("q", "tau")})
            for output, wanted in kept.functions[function]().items():
                assert relative(got[output], wanted) < 1e-9, function


def test_singular_poses_give_zeros(tmp_path):
    """An arm stretched out: no force is told, none is made up, and the caller is told."""
    written(tmp_path, "phantom_premium_15")
    library = Library.built(tmp_path, code_for("phantom_premium_15"), "double")
    q = np.array([[0.3], [0.4], [0.4 + np.pi / 2]])
    made = library("handle_force", {"q": q, "tau": np.ones((3, 1))})["force"]
    np.testing.assert_array_equal(made, 0.0)


def test_mass_that_the_hand_feels_and_the_whole_torque(tmp_path):
    """Along a direction u of any length, u'u / (u' A u); infinite where A lets nothing move."""
    model, beta = written(tmp_path, "phantom_premium_15")
    library = Library.built(tmp_path, code_for("phantom_premium_15"), "double")
    felt = library.handle.dev_apparent_mass
    felt.restype = ctypes.c_double
    reference = ReferenceValues.at_random(model, beta, SPEED, 20)
    for mobility in reference.functions["handle_mobility"]()["mobility"]:
        A, u = np.ascontiguousarray(mobility), np.array([0.3, -0.4, 1.2])
        made = felt(A.ctypes.data_as(ctypes.c_void_p), u.ctypes.data_as(ctypes.c_void_p))
        assert made == pytest.approx(u @ u / (u @ A.reshape(3, 3) @ u), rel=1e-12)
    assert felt(np.zeros(9).ctypes.data_as(ctypes.c_void_p), u.ctypes.data_as(ctypes.c_void_p)) == np.inf
    state = [np.ascontiguousarray(x[:, 0]) for x in (reference.q, reference.qd, reference.qdd)]
    tau = np.zeros(3)
    library.handle.dev_torque(library.constants, *(x.ctypes.data_as(ctypes.c_void_p) for x in (*state, tau)))
    wanted = sum(reference.functions[name]()["tau"][0] for name in ("inverse_dynamics", "terms"))
    np.testing.assert_allclose(tau, wanted, rtol=1e-12)


@pytest.mark.parametrize(("name", "precision"), [("phantom_premium_15", "single"), ("puma560", "double")])
def test_selftest_and_example_without_a_warning_or_undefined_behaviour(tmp_path, name, precision):
    written(tmp_path, name, precision)
    watched = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    for program in ("selftest", "example"):
        sources = [f"{NAME}.c", f"{NAME}_{program}.c", "-lm", "-o", program]
        run([compiler("gcc"), *STRICT, *watched, *sources], tmp_path)
        run([f"./{program}"], tmp_path)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_clang_has_no_warning_either(tmp_path, precision):
    clang = compiler("clang")
    written(tmp_path, "phantom_premium_15", precision)
    run([clang, *STRICT, f"{NAME}.c", f"{NAME}_selftest.c", "-lm", "-o", "selftest"], tmp_path)
    run(["./selftest"], tmp_path)


def test_header_is_cpp(tmp_path):
    written(tmp_path, "phantom_premium_15")
    (tmp_path / "main.cpp").write_text(f'#include "{NAME}.h"\n')
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-c"]
    run([compiler("g++"), *flags, "main.cpp", "-o", "main.o"], tmp_path)


def test_cmake_builds_and_tests(tmp_path):
    written(tmp_path, "phantom_premium_15")
    cmake = compiler("cmake")
    run([cmake, "-B", "build", "-S", "."], tmp_path)
    run([cmake, "--build", "build"], tmp_path)
    run([compiler("ctest"), "--test-dir", "build", "--output-on-failure"], tmp_path)


def test_selftest_sees_a_wrong_number(tmp_path):
    written(tmp_path, "phantom_premium_15")
    source = tmp_path / f"{NAME}.c"
    lines = source.read_text().splitlines()
    k = next(k for k, line in enumerate(lines) if "tau[0] = " in line)
    lines[k] = lines[k].replace("tau[0] = ", "tau[0] = 1.0001 * ")
    source.write_text("\n".join(lines))
    run([compiler("gcc"), source.name, f"{NAME}_selftest.c", "-lm", "-o", "selftest"], tmp_path)
    with pytest.raises(AssertionError, match="inverse_dynamics"):
        run(["./selftest"], tmp_path)


DRIVER = """
#include "dev.h"
#include <stdio.h>
int main(void)
{{
    static dev_model model;
    dev_observer observer;
    dev_differentiator filter;
    double q[{n}], qd[{n}], tau[{n}], made[{n}];
    dev_init(&model, dev_beta);
    if (dev_observer_init(&observer, {gain}, {dt}) + dev_differentiator_init(&filter, {cutoff}, {dt}) != 0) return 1;
    if (dev_observer_init(&(dev_observer){{0}}, -1.0, {dt}) != 1) return 2;
    if (dev_differentiator_init(&(dev_differentiator){{0}}, 1.0 / {dt}, {dt}) != 1) return 3;
    for (;;) {{
        for (int i = 0; i < {n}; i++) if (scanf("%lf %lf %lf", &q[i], &qd[i], &tau[i]) != 3) return 0;
        dev_observer_update(&model, &observer, q, qd, tau, made);
        for (int i = 0; i < {n}; i++) printf("%.17g ", made[i]);
        dev_differentiator_update(&filter, q, made);
        for (int i = 0; i < {n}; i++) printf("%.17g ", made[i]);
        dev_friction_compensation(&model, qd, 2.0, made);
        for (int i = 0; i < {n}; i++) printf("%.17g ", made[i]);
        puts("");
    }}
}}
"""


def test_observer_and_differentiator_follow_python_and_find_a_push(tmp_path):
    """A constant torque of the hand: seen in full, by the code as by Python."""
    model, beta = written(tmp_path, "phantom_premium_15")
    n, dt, gain, cutoff = 3, 1e-3, 60.0, 80.0
    (tmp_path / "driver.c").write_text(DRIVER.format(n=n, dt=dt, gain=gain, cutoff=cutoff))
    run([compiler("gcc"), "-std=c99", f"{NAME}.c", "driver.c", "-lm", "-o", "driver"], tmp_path)
    t, k = dt * np.arange(2000), 1 + np.arange(n)[:, None]
    omega = 3.0 * k
    q, qd, qdd = (0.3 * omega**d * np.sin(omega * t + k + d * np.pi / 2) for d in range(3))
    push = np.array([0.02, -0.01, 0.03])
    reference = ReferenceValues.along(model, beta, SPEED, (q, qd, qdd), qdd)
    tau = sum(reference.functions[name]()["tau"].T for name in ("inverse_dynamics", "terms")) - push[:, None]
    text = "\n".join(
        " ".join(repr(float(x)) for x in row) for row in np.stack([q, qd, tau], 1).transpose(2, 0, 1).reshape(-1, 9)
    )
    done = subprocess.run(["./driver"], cwd=tmp_path, input=text, capture_output=True, text=True, check=True)
    observed, differentiated, friction = np.loadtxt(done.stdout.splitlines()).reshape(-1, 3, n).transpose(1, 2, 0)
    seen = MomentumObserver(gain, SPEED).follow(model, beta, dt, q, qd, tau)
    assert relative(observed, seen.torque) < 1e-10
    assert relative(differentiated, HighPass(cutoff).velocity(q, dt)) < 1e-12
    np.testing.assert_allclose(observed[:, 500:].mean(axis=1), push, rtol=2e-3)
    np.testing.assert_allclose(
        friction, reference.functions["friction"]()["tau"].T, atol=1e-12
    )  # a share of 2 is cut to 1


# Multiplications and additions together, sines and cosines.
INVERSE = {
    "phantom_premium_15": (60, 4),
    "phantom_premium_15_general": (130, 4),
    "cea_medical_branch": (150, 6),
    "puma560": (460, 10),
    "arm7": (623, 12),
    "seven": (515, 12),
}
MASS = {"puma560": 250, "rx90": 210, "seven": 270}


@pytest.mark.parametrize("name", INVERSE)
def test_inverse_dynamics_stays_cheap(name, seven, record_property):
    found = (code_of(seven, SPEED) if name == "seven" else code_for(name)).operations["inverse_dynamics"]
    record_property("operations", str(found))
    most, angles = INVERSE[name]
    assert found.arithmetic <= most
    assert found.trigonometric <= angles
    assert found.divisions == found.others == 0


def test_inverse_dynamics_of_an_arm_with_spherical_wrist_stays_cheap():
    """36 base parameters of the bodies; four rotors that do not regroup cost two operations each."""
    model = haptid.DynamicModel(haptid.read_device("rx90"))
    found = code_of(model, SPEED).operations["inverse_dynamics"]
    rotors = len(moments_of(model).rotors)
    assert found.arithmetic <= 440 + 2 * rotors
    assert found.trigonometric <= 10


@pytest.mark.parametrize("name", MASS)
def test_mass_matrix_stays_cheap(name, seven):
    code = code_of(seven, SPEED) if name == "seven" else code_for(name)
    assert code.operations["mass_matrix"].arithmetic <= MASS[name]


def test_the_same_model_gives_the_same_files(tmp_path):
    made = [export_c(modelled("emps"), tmp_path / folder, CCode(NAME)) for folder in ("one", "two")]
    for file in made[0].files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
