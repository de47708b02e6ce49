"""Numbers at the edge of what can be computed: a result that is right, or an error with a sentence."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
from haptid.errors import HaptidError, LogDataError
from small_study import DEVICE, STUDY, columns

# Torques whose parameters scale with them, and those that are refused.
RIGHT, REFUSED = (1e-29, 1e-9, 1e9), (1e-300, 1e-160, 1e14, 1e160)


def identified(folder: Path, made: dict[str, np.ndarray], device: str = DEVICE, study: str = STUDY):
    (folder / "device.toml").write_text(device)
    (folder / "study.toml").write_text(study)
    for name in ("log.csv", "check.csv"):
        pyarrow.csv.write_csv(pa.table(made), folder / name)
        made = {**made, "tau1": made["tau1"] * 0.999, "tau2": made["tau2"] * 0.999}
    return haptid.identify(haptid.read_study(folder / "study.toml"))


def scaled(prefix: str, factor: float) -> dict[str, np.ndarray]:
    return {name: column * factor if name.startswith(prefix) else column for name, column in columns(1, 3.0).items()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return identified(tmp_path_factory.mktemp("plain"), columns(1, 3.0)).estimate


@pytest.mark.parametrize("factor", RIGHT)
def test_scaled_torques_scale_the_parameters(tmp_path, plain, factor):
    found = identified(tmp_path, scaled("tau", factor)).estimate
    # Stamps and decisions are the same; the estimate is linear in the torque, up to the digits of the text.
    assert np.allclose(found.beta, factor * plain.beta, rtol=1e-3, atol=1e-3 * factor * np.abs(plain.beta).max())
    assert np.allclose(found.se, factor * plain.se, rtol=0.05)


@pytest.mark.parametrize("prefix", ["tau", "q"])
@pytest.mark.parametrize("factor", REFUSED)
def test_what_cannot_be_computed_is_refused(tmp_path, prefix, factor):
    with pytest.raises(LogDataError, match=r"in SI units|beyond 1e"):
        identified(tmp_path, scaled(prefix, factor))


@pytest.mark.parametrize("factor", [1e-300, 1e-160, 1e-12, 1e9, 1e160])
def test_clocks_in_impossible_units(tmp_path, factor):
    made = columns(1, 3.0)
    with pytest.raises(HaptidError, match=r"sampling period|equal the one before|beyond 1e|coarser"):
        identified(tmp_path, {**made, "t": made["t"] * factor})


@pytest.mark.parametrize("count", [0, 1, 2, 3, 50, 60])
def test_very_short_logs(tmp_path, count):
    with pytest.raises(HaptidError, match=r"no rows|below the limit of 50|the motion lasts"):
        identified(tmp_path, {name: column[:count] for name, column in columns(1, 3.0).items()})


def test_denormal_torque(tmp_path):
    made = columns(1, 3.0)
    with pytest.raises(LogDataError, match="in SI units"):
        identified(tmp_path, {**made, "tau1": 5e-324 * np.arange(len(made["t"]))})


def with_body(**given: str) -> str:
    body = {"mass": "1.0", "com": "[0.1, 0, 0]", "inertia": "[0.01, 0.01, 0.01, 0, 0, 0]"} | given
    return DEVICE + "\n[[prior.bodies]]\nlink = '2'\n" + "".join(f"{key} = {x}\n" for key, x in body.items())


def with_motor(line: str) -> str:
    return f"{DEVICE}\n[[motors]]\nname = '1'\n{line}\n[[motors]]\nname = '2'\n"


def chain(joints: int) -> str:
    """A device of `joints` joints in a row, with friction."""
    rows = "".join(
        f"[[joints]]\nname = '{k}'\nalpha = {(-1) ** k * np.pi / 2}\nr = 0.1\n" for k in range(1, joints + 1)
    )
    return DEVICE[: DEVICE.index("[[joints]]")] + rows + DEVICE[DEVICE.index("[[terms]]") :]


# Devices at the edge, and what is said of them; None: they have a result, finite and without a warning.
AT_THE_EDGE = {
    **{f"d = {x}": (DEVICE.replace("d = 0.3", f"d = {x}"), r"limit 1e\+12|finite") for x in ("1e30", "-1e160", "nan")},
    **{f"d = {x}": (DEVICE.replace("d = 0.3", f"d = {x}"), None) for x in ("5e-324", "1e-160", "1e11")},
    "angle": (DEVICE.replace("d = 0.3", "d = 0.3\nalpha = 1e300"), r"limit 1e\+12"),
    "negative mass": (with_body(mass="-1.0"), "zero or a number above it"),
    "no mass": (with_body(mass="0.0"), None),
    "denormal mass": (with_body(mass="5e-324"), None),
    "huge mass": (with_body(mass="1e300"), r"limit 1e\+12"),
    "negative inertia": (with_body(inertia="[-0.01, 0.01, 0.01, 0, 0, 0]"), "least principal moment is -0.01"),
    "far centre of mass": (with_body(com="[1e30, 0, 0]"), r"limit 1e\+12"),
    "negative prior mass": (DEVICE + "[prior]\nM2 = -3.0\n", None),
    "negative prior friction": (DEVICE + "[prior]\nFC1 = -3.0\n", None),
    "prior nan": (DEVICE + "[prior]\nZZ1 = nan\n", "finite"),
    "no gravity": (DEVICE.replace("-9.81", "0.0"), None),
    "denormal gravity": (DEVICE.replace("-9.81", "-1e-320"), None),
    "huge gravity": (DEVICE.replace("-9.81", "-1e300"), r"limit 1e\+12"),
    "limits reversed": (DEVICE.replace("[-2.0, 2.0]", "[2.0, -2.0]"), "lower limit first"),
    "no gear": (with_motor("gear_ratio = 0"), "not zero"),
    "huge gear": (with_motor("gear_ratio = 1e300"), r"limit 1e\+12"),
    "torque constant nan": (with_motor("torque_constant = nan"), "finite"),
    "60 joints": (chain(60), "has 5[0-9]{2} base parameters, more than the 400"),
    "200 joints": (chain(200), "at most 120"),
    "spring far away": (DEVICE + "[[terms]]\nkind = 'spring'\njoints = ['1']\nrest = 1e300\n", r"limit 1e\+12"),
}


@pytest.mark.parametrize("case", AT_THE_EDGE)
@pytest.mark.filterwarnings("error")
def test_devices_at_the_edge(tmp_path, case):
    device, said = AT_THE_EDGE[case]
    if said is None:
        found = identified(tmp_path, columns(1, 3.0), device).estimate
        assert np.isfinite([found.beta, found.se]).all()
    else:
        with pytest.raises(HaptidError, match=said):
            identified(tmp_path, columns(1, 3.0), device)


def changed(name: str, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    made = columns(1, 3.0)
    return {**made, name: change(made[name])}


LOGS_AT_THE_EDGE = {
    "constant position": ("q1", lambda x: 0 * x, "not connected, or nothing moved"),
    "constant torque": ("tau1", lambda x: 0 * x + 3, "not connected, or nothing moved"),
    "negative zeros": ("tau1", lambda x: -0.0 * x, "not connected, or nothing moved"),
    "denormal positions": ("q1", lambda x: 5e-324 * np.round(1e3 * x), "in SI units"),
    "all missing": ("q1", lambda x: np.nan * x, "missing, infinite or beyond"),
    "one infinite": ("tau1", lambda x: np.where(np.arange(x.size) == 50, np.inf, x), "1 sample, first at sample 50"),
    "time stands still": ("t", lambda x: 0 * x, "coarser than the sampling"),
    "time reversed": ("t", lambda x: x[::-1], "out of order"),
    "time of the epoch in attoseconds": ("t", lambda x: x + 1e18, "coarser than the sampling"),
}


@pytest.mark.parametrize("case", LOGS_AT_THE_EDGE)
def test_logs_at_the_edge(tmp_path, case):
    name, change, said = LOGS_AT_THE_EDGE[case]
    with pytest.raises(HaptidError, match=said):
        identified(tmp_path, changed(name, change))


@pytest.mark.parametrize(
    "setting",
    [
        *("torque_delay_s = 1e9", "torque_delay_s = 5", "reversal_speed = 1e300", "torque_delay_s = [1e9, 0]"),
        *("cutoff_hz = 5e-324", "cutoff_hz = 1e300", "decimation = 99999999999999999999"),
    ],
)
def test_impossible_settings(tmp_path, setting):
    key = setting.partition(" =")[0]
    kept = [line for line in STUDY.splitlines() if not line.startswith(f"{key} =")]
    with pytest.raises(HaptidError, match=r"tenth of the log|slower than|write at least|well below|filters' ends"):
        identified(tmp_path, columns(1, 3.0), study="\n".join([*kept, setting]) + "\n")


def test_devices_of_many_joints(tmp_path):
    joints = "".join(f'[[joints]]\nname = "{k}"\nd = 0.1\nalpha = "{("0", "pi/2")[k % 2]}"\n' for k in range(1, 41))
    text = 'schema = 1\nname = "snake"\nconvention = "modified-dh"\ngravity = [0.0, 0.0, -9.81]\n'
    (tmp_path / "snake.toml").write_text(text + joints)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "snake.toml"))
    assert len(model.base) > 100
    with pytest.raises(HaptidError, match="has 40 joints; lengths are symbols up to 24"):
        _ = model.regroupings
    (tmp_path / "snake.toml").write_text(text + joints.replace('"1"', '"0"') * 4)
    with pytest.raises(HaptidError, match="120"):
        haptid.read_device(tmp_path / "snake.toml")
