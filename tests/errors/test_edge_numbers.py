"""Numbers at the edge of what can be computed: a result that is right, or an error with a sentence."""

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


@pytest.mark.parametrize("length", ["1e30", "1e13", "-1e160", "inf", "nan"])
def test_impossible_lengths(tmp_path, length):
    with pytest.raises(HaptidError, match=r"limit 1e\+12|finite"):
        identified(tmp_path, columns(1, 3.0), DEVICE.replace("d = 0.3", f"d = {length}"))


@pytest.mark.parametrize(
    "setting",
    ["torque_delay_s = 1e9", "torque_delay_s = 5", "reversal_speed = 1e300", "torque_delay_s = [1e9, 0]"],
)
def test_impossible_settings(tmp_path, setting):
    with pytest.raises(HaptidError, match=r"at most a tenth of the log|slower than reversal_speed"):
        identified(tmp_path, columns(1, 3.0), study=f"{STUDY}{setting}\n")


def test_devices_of_many_joints(tmp_path):
    joints = "".join(f'[[joints]]\nname = "{k}"\nd = 0.1\nalpha = "{("0", "pi/2")[k % 2]}"\n' for k in range(1, 41))
    text = 'schema = 1\nname = "snake"\nconvention = "modified-dh"\ngravity = [0.0, 0.0, -9.81]\n'
    (tmp_path / "snake.toml").write_text(text + joints)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "snake.toml"))
    assert len(model.base) > 100
    with pytest.raises(HaptidError, match="has 40 joints; lengths are symbols up to 24"):
        _ = model.regroupings
    (tmp_path / "snake.toml").write_text(text + joints.replace('"1"', '"0"') * 6)
    with pytest.raises(HaptidError, match="200"):
        haptid.read_device(tmp_path / "snake.toml")
