"""Data sheets: figures against the characterisation, finite differences and stepped devices; pages; bad input."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.device.toml.reader import device_of
from haptid.device.toml.terms import ElasticTerm
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.workspace import workspace
from haptid.end_effector.characterisation import GivenParameters, characterise
from haptid.end_effector.characterisation.friction import viscous_matrix
from haptid.end_effector.compensation import TYPICAL_HAND, Compensation, SampledLoop
from haptid.end_effector.datasheet import (
    DeviceInstruments,
    StepDevice,
    data_sheet,
    passive_stiffness,
    stable_stiffness,
    stepped_stiffness,
)
from haptid.report.datasheet import comparison, sheet_cells, sheet_figure, sheet_page, write_sheet
from true_parameters import true_parameters

T, LIMITS = 1e-3, {"be": (-0.7, 0.7), "df": (-0.6, 1.1)}
TOOLS = DeviceInstruments(
    encoder_counts={"1": 53200.0, "2": 44800.0, "3": 44800.0}, torque_step={"1": 1e-3, "2": 1e-3, "3": 1e-3}
)


@pytest.fixture(scope="module")
def given():
    """True parameters with a covariance of 2 % each."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = model.base.of(true_parameters(model))
    return GivenParameters(model, beta, np.diag((0.02 * beta) ** 2))


@pytest.fixture(scope="module")
def sheet(given):
    return data_sheet(given, workspace(given.model, LIMITS), TOOLS, 216)


def test_figures_are_those_of_the_characterisation_with_its_intervals(given, sheet):
    found = characterise(given, sheet.poses)
    for name, field in {
        "largest effective mass": found.apparent_mass.values[:, 0],
        "peak force": found.greatest_force({"1": 1.716, "2": 1.445, "3": 1.445})[0].values,
        "continuous force": found.greatest_force({"1": 0.38, "2": 0.32, "3": 0.32})[0].values,
        "back-drive friction along y": found.coulomb_friction([0, 1, 0]).values[:, 1],
        "passive stiffness": found.viscous_friction.values[:, -1] * 2 / T,
    }.items():
        row = sheet[name]
        assert (row.low, row.high) == pytest.approx((field.min(), field.max()))
        assert row.low <= row.value <= row.high
        low, high = row.conf_int
        assert low < row.value < high
    row = sheet["dynamic range"]
    assert 1 < row.low < row.value


def test_the_continuous_force_is_the_published_one(given):
    """1.4 N by the maker, from the motors' torque of another source: over the nominal workspace, 10 %."""
    box = haptid.dynamics.Box((-0.19, -0.27, 0.0), (0.19, 0.0, 0.35))
    made = data_sheet(given, workspace(given.model, LIMITS, box), TOOLS, 512)
    assert made["continuous force"].value == pytest.approx(1.4, rel=0.1)
    published = {name: value for name, value, _ in made.published}
    assert published["continuous force"] == "1.4 N"


def test_resolution_is_the_motion_by_one_step(given, sheet):
    """Of each motor by a finite difference; the largest one."""
    step = 2 * np.pi / np.array([53200.0, 44800.0, 44800.0])
    start = handle_motion(given.model, sheet.poses).position
    moved = []
    for k in range(3):
        q = sheet.poses.copy()
        q[k] += step[k]
        moved.append(np.linalg.norm(handle_motion(given.model, q).position - start, axis=1))
    row, wanted = sheet["position resolution"], np.max(moved, axis=0)
    assert (row.low, row.high) == pytest.approx((wanted.min(), wanted.max()), rel=1e-3)


def test_the_passive_bound_is_that_of_the_simulated_device(sheet):
    assert sheet["passive stiffness, simulated"].value == pytest.approx(sheet["passive stiffness"].value, rel=0.1)
    assert sheet["stable stiffness, in a hand"].value > 10 * sheet["passive stiffness"].value


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_a_stepped_device_without_friction_is_stable_up_to_the_passive_bound(delay):
    """One degree of freedom: b / (T / 2 + delay), by time steps and by eigenvalues."""
    b, m = 2.0, 0.3
    bound = passive_stiffness(np.diag([b]), T, delay)
    assert bound == pytest.approx(b / (T / 2 + delay))
    one = np.eye(1)
    loop = SampledLoop(m * one, b * one, 0 * one, one, (), T, delay)
    assert stable_stiffness(loop) == pytest.approx(bound, rel=0.1)
    assert stepped_stiffness(StepDevice(m, b, 0.0, 0.0, T, delay), None) == pytest.approx(bound, rel=0.1)
    rubbed = stepped_stiffness(StepDevice(m, b, 0.5, 1e-5, T, delay), TYPICAL_HAND)
    assert rubbed > bound


@pytest.fixture(scope="module")
def interface():
    """The whole interface with a covariance, its sheet, and the handle at the sheet's poses."""
    model = haptid.DynamicModel(haptid.read_device("cea_medical_interface"))
    beta = model.base.of(true_parameters(model, FVM=0.02, FCM=0.05))
    known = GivenParameters(model, beta, np.diag((0.02 * beta) ** 2))
    motors = [motor.name for motor in model.device.motors]
    tools = DeviceInstruments(
        peak=dict.fromkeys(motors, 500.0),
        encoder_counts=dict.fromkeys(motors, 40000.0),
        torque_step=dict.fromkeys(motors, 1e-3),
    )
    return known, tools, data_sheet(known, workspace(model), tools, 64)


def test_a_spring_of_the_interface_is_passive_up_to_the_damping_that_carries_it(interface):
    """K (T / 2) J' J <= B at every pose, by the largest K in the coordinates; of the point and of the rotation."""
    known, _, sheet = interface
    J = handle_motion(known.model, sheet.poses).jacobian
    B = viscous_matrix(known.model, known.beta, sheet.poses)
    root = np.linalg.inv(np.linalg.cholesky(B))
    for name, rows in (("passive stiffness", slice(0, 3)), ("passive rotational stiffness", slice(3, 6))):
        scaled = J[:, rows] @ root.mT
        most = 1 / np.linalg.eigvalsh(scaled.mT @ scaled)[:, -1] / (T / 2)
        row = sheet[name]
        assert (row.low, row.high) == pytest.approx((most.min(), most.max()), rel=1e-6)
        assert row.conf_int[0] < row.value < row.conf_int[1]
    simulated = sheet["passive stiffness, simulated"]
    assert simulated.value == pytest.approx(sheet["passive stiffness"].value, rel=0.1)
    assert sheet["stable stiffness, in a hand"].method.endswith("rotation held")


def test_the_interface_has_figures_with_rotation(interface):
    known, tools, sheet = interface
    point, turned = (characterise(known, sheet.poses, rows) for rows in ((0, 1, 2), (3, 4, 5)))
    assert sheet["largest effective mass"].high == pytest.approx(point.apparent_mass.values[:, 0].max())
    assert sheet["largest rotational inertia"].unit == "kg m^2"
    assert sheet["peak moment"].low == pytest.approx(turned.greatest_force(dict(tools.peak))[0].values.min())
    # One step of every encoder in turn, positions of the joints by least squares: as rates, so the motors' are met.
    B = known.model.device.drive_jacobian(known.model.device.row_map @ sheet.poses)
    turn = handle_motion(known.model, sheet.poses).jacobian @ np.linalg.pinv(B) * (2 * np.pi / 40000.0)
    row = sheet["position resolution"]
    assert row.high == pytest.approx(np.linalg.norm(turn[:, :3], axis=1).max())
    assert sheet["angular resolution"].unit == "rad"
    assert sheet["moment resolution"].value > 0


def test_intervals_of_simulated_bounds_are_those_of_moved_parameters(given, sheet):
    """Slopes of an eigenvalue, against the bound itself with other parameters; dry friction moves the stepped one."""
    row = sheet["stable stiffness, linear, in a hand"]
    at = next(
        k
        for k in range(sheet.poses.shape[1])
        if stable_stiffness(_free(given, given.beta, sheet.poses[:, k]), TYPICAL_HAND)
        == pytest.approx(row.value, rel=1e-9)
    )
    variance = 0.0
    for k, size in enumerate(0.02 * given.beta):
        up, down = (
            stable_stiffness(
                _free(given, given.beta + sign * size * np.eye(len(given.beta))[k], sheet.poses[:, at]), TYPICAL_HAND
            )
            for sign in (1, -1)
        )
        variance += ((up - down) / 2) ** 2
    assert (row.conf_int[1] - row.conf_int[0]) / 2 == pytest.approx(1.96 * np.sqrt(variance), rel=0.05)
    low, high = sheet["stable stiffness, free"].conf_int
    assert low < sheet["stable stiffness, free"].value < high


def _free(known, beta, qa):
    loop = Compensation(GivenParameters(known.model, beta), 0.0, weight=0.0).loop(qa, T)
    return replace(loop, stiffness=0 * loop.stiffness)


def test_a_limit_cycle_of_one_encoder_step_is_no_rest():
    """At 4 kN/m a step of 1 mm is 4 N, without bound on the motion; a spring softer than a stable one may swing."""
    coarse, fine = (StepDevice(0.1, 0.05, 0.05, step, T) for step in (1e-3, 1e-5))
    assert stepped_stiffness(coarse, TYPICAL_HAND) < 4000.0 < stepped_stiffness(fine, TYPICAL_HAND)
    assert stepped_stiffness(fine, None) < 1e4  # 10 kN/m alone would pass


def test_a_whole_turn_of_the_joints_leaves_no_figure_out():
    """Poses at which the handle is singular do not count for the directions in which it can move."""
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    known = GivenParameters(model, model.base.of(true_parameters(model)))
    made = data_sheet(known, workspace(model), DeviceInstruments(), 216)
    assert made["back-drive friction along x"].value > 0
    assert made["passive stiffness"].value > 0


def test_motors_that_do_not_carry_the_weight_have_no_force_with_an_interval(given):
    """Relative errors of a force of zero made the intervals of its quotients no numbers."""
    weak = DeviceInstruments(peak={"1": 1e-4, "2": 1e-4, "3": 1e-4})
    made = data_sheet(given, workspace(given.model, LIMITS), weak, 216)
    row = made["peak acceleration"]
    assert row.value == 0
    assert np.isfinite(row.conf_int).all()


def test_what_is_not_known_is_said(given):
    model = given.model
    bare = data_sheet(model, workspace(model, LIMITS), poses=27)
    assert bare["effective mass"].value is None
    assert "no parameters" in bare["effective mass"].method
    assert bare["position resolution"].value is None
    assert bare["structural frequency"].method.startswith("the model is rigid")
    quiet = GivenParameters(model, model.base.of(true_parameters(model, FV=0.0, FC=0.0)))
    made = data_sheet(quiet, workspace(model, LIMITS), poses=27)
    assert made["back-drive friction"].value is None
    assert made["passive stiffness"].value is None
    with pytest.raises(errors.UnknownNameError):
        made["bandwidth of the user"]


def test_other_mechanisms_have_one():
    """Two loops that are not linear; one that turns its handle; planar ones."""
    for name, limits, axes in (("delta", {}, "xyz"), ("five_bar", {}, "xy"), ("cea_medical_interface", {}, "xyz")):
        model = haptid.DynamicModel(haptid.read_device(name))
        known = GivenParameters(model, model.base.of(true_parameters(model)))
        peak = {motor.name: 500.0 for motor in model.device.motors}
        made = data_sheet(known, workspace(model, limits), DeviceInstruments(peak=peak), 64)
        for axis in axes:
            assert made[f"effective mass along {axis}"].value > 0
            assert made[f"peak force along {axis}"].value > 0
        if name == "cea_medical_interface":
            assert made["rotational inertia about z"].unit == "kg m^2"
            assert made["peak moment about z"].unit == "N m"


@pytest.mark.usefixtures("full_pictures")
def test_pages(sheet, tmp_path):
    big = haptid.DynamicModel(haptid.read_device("phantom_premium_30"))
    sheets = [sheet, data_sheet(big, workspace(big, LIMITS), poses=27)]
    page = sheet_page(sheets)
    for part in ("Comparison", "PHANToM Premium 1.5", "PHANToM Premium 3.0", "peak force, published", "95 % interval"):
        assert part in page
    cells = comparison(sheets)
    assert {len(row) for row in cells} == {3}
    assert next(row for row in cells if row[0] == "peak force, published")[1:] == ["8.5 N", "22 N"]
    assert {len(row) for row in sheet_cells(sheet)} == {5}
    for one in sheets:
        assert not [text.get_text() for text in sheet_figure(one).texts if text.get_text().endswith(" ..")]  # none cut
    for name in ("one.pdf", "one.html"):
        write_sheet(sheets, tmp_path / name)
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.usefixtures("full_pictures")
def test_the_command(tmp_path):
    out = tmp_path / "sheet.pdf"
    options = ["--limit", "be=-0.7:0.7", "--limit", "df=-0.6:1.1", "--poses", "27", "--out", str(out)]
    result = CliRunner().invoke(app, ["datasheet", "phantom_premium_15", *options])
    assert result.exit_code == 0, result.output
    assert "largest effective mass" in result.output
    assert out.read_bytes().startswith(b"%PDF")
    for wrong, what in ((["--peak", "9=1"], "9"), (["--out", "sheet.txt"], ".pdf"), (["--counts", "1=-4"], "above 0")):
        result = CliRunner().invoke(app, ["datasheet", "phantom_premium_15", *options, *wrong])
        assert result.exit_code == 2
        assert what in result.output


def test_settings_that_mean_nothing(given):
    with pytest.raises(errors.UnknownNameError) as raised:
        data_sheet(given, workspace(given.model, LIMITS), DeviceInstruments(peak={"9": 1.0}), 27)
    assert raised.value.where == "9"
    for wrong, where in (({"rate_hz": 0.0}, "rate_hz"), ({"delay": -1.0}, "delay")):
        with pytest.raises(errors.SettingError) as setting:
            DeviceInstruments(**wrong)
        assert setting.value.where == where


def test_rotors_behind_springs_are_in_the_mass_below_the_structural_frequency_alone():
    """Against the same arm with rigid motors, with its rotors and without them."""
    arm = haptid.read_device("arm3")
    terms = [ElasticTerm(kind="elastic", motors="all", sensor=True), *arm.tables.terms]

    def sheet(device, **sizes):
        model = haptid.DynamicModel(device)
        known = GivenParameters(model, model.base.of(true_parameters(model, **sizes)))
        return data_sheet(known, workspace(model, {"1": (-0.5, 0.5), "2": (0.3, 1.0), "3": (-1.5, -0.5)}), poses=30)

    bent = sheet(device_of(arm.tables.model_copy(update={"terms": terms}), "arm3"), IA=0.05, KE=400.0, DE=0.1)
    rigid, bare = sheet(arm, IA=0.05), sheet(arm, IA=0.0)
    for which in ("largest", "smallest"):
        below, above = (bent[f"{which} effective mass{end}"] for end in ("", " of the links alone"))
        assert below.value == pytest.approx(rigid[f"{which} effective mass"].value, rel=1e-9)
        assert above.value == pytest.approx(bare[f"{which} effective mass"].value, rel=1e-9)
        assert above.value < 0.9 * below.value
    assert 1.0 < bent["structural frequency, motors held"].value < bent["structural frequency, motors free"].value
