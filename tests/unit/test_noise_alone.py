"""Torque channels that show noise alone while their joint moves: named, without rows, and in no error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
import small_study
from diagnosed import log, phantom
from haptid.inference.diagnosis import diagnose
from haptid.inference.targets import targets
from haptid.log.noise_alone import noise_alone
from haptid.log.spectrum import Spectrum, bulk_bandwidth, fastest, spectra
from haptid.motion.motion import with_positions
from haptid.motion.noise_torques import rows_of_noise
from haptid.results.result import Result
from haptid.study.identify import identify
from haptid.study.read import read_study

TREATMENT = haptid.Treatment(cutoff_hz=60.0, parallel_cutoff_hz=30.0, torque_delay_s=0.0)


def changed(made: haptid.Log, torque: np.ndarray, position: np.ndarray | None = None) -> haptid.Log:
    return replace(made, torque=torque, position=made.position if position is None else position)


def with_noise(size: float, share: float = 0.0) -> haptid.Log:
    """A clean log whose third torque channel is noise of this deviation, and this share of the torque."""
    made = log(3, noise=0.0)
    torque = np.array(made.torque)
    torque[:, 2] = share * torque[:, 2] + size * np.random.default_rng(1).standard_normal(len(torque))
    return changed(made, torque)


@pytest.mark.parametrize("size", [1e-2, 1.0])
def test_a_motor_of_noise_has_no_rows_and_is_named(size: float) -> None:
    made = with_noise(size)
    assert noise_alone(made).tolist() == [False, False, True]
    rows = haptid.observe(phantom(), haptid.treat(made, TREATMENT))
    assert [motor.rows.any() for motor in rows.motors] == [True, True, False]
    (said,) = (note for note in rows.notes if "no part that follows the motion" in note)
    assert "motor 3 shows no part that follows the motion, while its joint moves: channel u3 is noise" in said
    assert f"deviation of {np.std(made.torque[:, 2]):.3g} N m" in said


def test_noise_too_small_to_matter_keeps_its_rows() -> None:
    made = with_noise(1e-4)
    assert noise_alone(made)[2]
    assert not rows_of_noise(phantom().device, made).any()


def test_where_no_motor_shows_more_all_keep_their_rows() -> None:
    made = log(3, noise=0.0)
    made = changed(made, np.random.default_rng(1).standard_normal(made.torque.shape))
    assert noise_alone(made).all()
    assert not rows_of_noise(phantom().device, made).any()
    rows = haptid.observe(phantom(), haptid.treat(made, TREATMENT))
    (said,) = (note for note in rows.notes if "follows the motion" in note)
    assert "all channels are noise, and nothing can be identified from it" in said


def test_a_noisy_torque_is_no_noise_alone() -> None:
    rms = float(np.std(log(3, noise=0.0).torque[:, 2]))
    assert not noise_alone(with_noise(3 * rms, share=1.0)).any()


def test_a_torque_that_is_switched_is_no_noise_alone() -> None:
    """As of a controller that chatters: the torque is right in the mean alone."""
    made, rng = log(3, noise=0.0), np.random.default_rng(2)
    torque = np.array(made.torque)
    limit = 2 * float(np.abs(torque[:, 2]).max())
    torque[:, 2] = limit * np.sign(torque[:, 2] / limit + rng.uniform(-1, 1, len(torque)))
    assert not noise_alone(changed(made, torque)).any()


@pytest.mark.parametrize("seed", range(8))
def test_dry_friction_alone_below_its_noise_is_no_noise_alone(seed: int) -> None:
    """A small wrist without gravity: its friction is a third of the noise of its sensor."""
    made, rng = log(3, noise=0.0), np.random.default_rng(seed)
    torque, position = np.array(made.torque), np.asarray(made.position)
    friction = np.sign(np.gradient(position[:, 2]))
    torque[:, 2] = 0.01 * (friction + 3 * rng.standard_normal(len(torque)))
    assert not noise_alone(changed(made, torque)).any()


def test_torque_of_another_motor_is_no_noise_alone() -> None:
    """Of axes that are not coupled: it follows the motion of the other joint."""
    made, rng = log(3, noise=0.0), np.random.default_rng(3)
    position = np.asarray(made.position)
    rates = np.gradient(position, made.dt, axis=0)
    torque = np.sign(rates)[:, [1, 0, 2]] + 3 * rng.standard_normal(position.shape)
    assert not noise_alone(changed(made, torque)).any()


@pytest.mark.parametrize("moves", [0.0, 0.01])
def test_a_joint_that_stands_still_may_show_noise_alone(moves: float) -> None:
    """As in logs of one axis after the other, locked joints and holds that tremble."""
    made, rng = with_noise(1e-2), np.random.default_rng(3)
    position = np.array(made.position)
    position[:, 2] = (
        position[0, 2] + moves * (position[:, 0] - position[0, 0]) + 1e-5 * rng.standard_normal(len(position))
    )
    assert not noise_alone(changed(made, np.asarray(made.torque), position)).any()


def test_a_hold_for_most_of_the_log_is_no_noise_alone() -> None:
    """Too little motion is left to find torque in it."""
    made, rng = log(3, noise=0.0), np.random.default_rng(4)
    position = np.array(made.position)
    position[400:] = position[399]
    torque = 0.01 * rng.standard_normal(position.shape)
    torque[:400] += np.asarray(made.torque)[:400]
    assert not noise_alone(changed(made, torque, position)).any()


TARGETS = '[targets]\nfriction_1 = "2*FC1"\nfriction_2 = "2*FC2"\n'


def study(folder: Path, size: float) -> Path:
    """A study of two links, whose second torque is noise of this share of the first one's RMS where it is not zero."""
    path = small_study.write_study(folder)
    (folder / "device.toml").write_text(small_study.DEVICE + TARGETS)
    if size:
        for seed, name in ((1, "log.csv"), (2, "check.csv")):
            made, rng = small_study.columns(seed), np.random.default_rng(seed)
            made["tau2"] = size * float(np.std(made["tau1"])) * rng.standard_normal(len(made["t"]))
            pyarrow.csv.write_csv(pa.table(made), folder / name)
    return path


def test_a_study_with_a_motor_of_noise_identifies_the_others(tmp_path: Path) -> None:
    """Its error of all motors is that of the other one."""
    found = identify(read_study(study(tmp_path, 0.3)))
    clean = identify(read_study(study(tmp_path, 0.0)))
    error, right = found.unseen[0].comparable, clean.unseen[0].comparable
    assert error.motors[1].rows == 0
    assert error.relative == pytest.approx(error.motors[0].relative)
    assert error.relative < 1.2 * right.motors[0].relative
    assert {found.estimate.names[k] for k in found.estimate.zero} == {"FV2", "FC2"}
    notes = [note for note in found.estimate.notes if "no row of motor 2 is used" in note]
    assert len(notes) == 1
    assert "Record motion with the torque of motor 2" in notes[0]
    feasible = found.use.estimate.feasible
    assert feasible is not None
    assert feasible.ok
    errors = [one for one in Result.of(found).validation if one.motor == "2"]
    assert all(one.relative_error_percent is None and one.rmse is None for one in errors)
    summary = found.unseen[0].summary()
    assert "motor 2: no rows" in summary
    assert "motor 2 0.00" not in summary
    low, high = targets(found.estimate).conf_int().T
    assert np.isfinite([low[0], high[0]]).all()
    assert np.isinf([low[1], high[1]]).all()
    said = diagnose(found.estimate, found.unseen[0]).verdict
    assert said.compensation == "doubt"
    assert all("no row of motor 2 is used" in sentence for sentence in said.sentences[:3])
    assert "no row" not in str(diagnose(clean.estimate, clean.unseen[0]).verdict)


def test_a_motion_with_other_positions_is_not_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The choice of a treatment has dozens of them; its torques are the log's."""
    made = with_noise(1e-2)
    found = noise_alone(made)
    moved = with_positions(haptid.treat(made, TREATMENT), made.position + 1e-6)
    for name in ("spectra", "fastest"):
        monkeypatch.setattr(f"haptid.log.noise_alone.{name}", None)
    assert found.tolist() == noise_alone(moved.log).tolist() == [False, False, True]


def test_the_bandwidth_is_the_same_by_the_spectra_of_the_whole_log() -> None:
    made = log(3)
    assert bulk_bandwidth(spectra(made)) == fastest(made.position.T, float(made.dt))


def test_a_motor_of_noise_decides_nothing_about_rows_near_reversals(tmp_path: Path) -> None:
    """It has no rows: these counted as rows that are near reversals, and more of the others were kept for them."""
    reasons = []
    for name, size in (("clean", 0.0), ("noise", 0.3)):
        (tmp_path / name).mkdir()
        found = read_study(study(tmp_path / name, size))
        model = haptid.DynamicModel(haptid.read_device(found.device))
        made = haptid.read_log(tmp_path / name / "log.csv", found.logs[0].channels)
        reasons.append(next(one for one in haptid.propose(model, made).reasons if "reversals" in one))
    clean, noise = reasons
    assert noise.startswith(clean[:30])
    assert ", - % of the motors' rows are kept (-: its torque is noise alone)." in noise


@pytest.mark.parametrize("noise", [3e-5, 0.0])
def test_white_noise_of_a_position_is_found_above_the_motion_where_its_step_is_not_known(noise):
    """Values of a fine encoder with noise seldom recur; a coarse one has the noise of rounding."""
    step = 1e-9 if noise else 1e-3
    t = 1e-3 * np.arange(20_000)
    clean = np.sin(2 * np.pi * 0.7 * t) + noise * np.random.default_rng(3).standard_normal(len(t))
    found = Spectrum.of(step * np.round(clean / step), 1e-3)
    assert found.step == pytest.approx(0.0 if noise else step)
    assert found.white(1e-3) == pytest.approx(noise**2 or step**2 / 12, rel=0.2)
