"""Proposals that are no term of the model: another filter, another fit for use, another log, further motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from haptid.advice import advise
from haptid.advice import apply_advice as applied
from haptid.advice.more_motion import more_motion
from haptid.advice.use import other_use
from haptid.estimation import Estimate
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study
from haptid.validation.model_for_use import UseCandidate
from zoo.case import Case
from zoo.wrong import WrongPlant, written

ARM = Case(1, "arm2", 250, 12, 1.2, 3, bits=12, friction=0.3, level=0.01)


def identified(folder: Path, extra: str = "") -> Identification:
    """The study of a folder, with more at its end."""
    path = folder / "study.toml"
    path.write_text(path.read_text(encoding="utf-8") + extra, encoding="utf-8")
    return identify(read_study(path))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the study of an arm with coarse encoders."""
    folder = tmp_path_factory.mktemp("arm")
    written(WrongPlant(ARM), folder)
    return folder


def copied(folder: Path, to: Path) -> Path:
    for file in folder.iterdir():
        if file.is_file():
            (to / file.name).write_bytes(file.read_bytes())
    return to


def test_a_cut_off_far_above_the_motion_is_lowered(arm: Path, tmp_path: Path) -> None:
    found = identified(copied(arm, tmp_path), "[treatment]\ncutoff_hz = 90.0\nparallel_cutoff_hz = 40.0\n")
    made = advise(found)
    (action,) = (one for one in made.actions if one.kind == "filter")
    assert action is made.actions[0]
    assert action.after < 0.7 * action.before
    assert action.edits[0].path == ("treatment", "cutoff_hz")
    after = applied(made, found, tmp_path / "out")
    assert after is not None
    assert after.identification.study.treatment["cutoff_hz"] == action.edits[0].value < 90
    assert after.after < 0.2 * after.before


def test_the_proposed_cut_off_stays_where_it_is_given(arm: Path, tmp_path: Path) -> None:
    proposed = identified(arm).proposal.treatment.cutoff_hz
    found = identified(copied(arm, tmp_path), f"[treatment]\ncutoff_hz = {np.atleast_1d(proposed).tolist()}\n")
    assert not [action for action in advise(found).actions if action.kind == "filter"]


def with_candidates(found: Identification, monkeypatch: pytest.MonkeyPatch, excess: tuple[float, float]) -> Any:
    """The identification of a study that demands the free fit, whose held-out error is 10 % of the torque."""
    consistent = UseCandidate("consistent", None, 6.0, (0.0, 0.0), 0.0)
    free = UseCandidate("free", None, 10.0, excess, -0.6)
    chosen = SimpleNamespace(name="consistent", candidates=(consistent, free))
    monkeypatch.setattr("haptid.advice.use.model_for_use", lambda *_: chosen)
    return replace(found, study=replace(found.study, use="free"), use=replace(found.use, name="free"))


def test_a_consistent_fit_that_predicts_better_is_advised_with_its_proof(
    arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = identified(arm)
    assert other_use(found) is None
    better = other_use(with_candidates(found, monkeypatch, (0.0064, 0.001)))
    assert better is not None
    assert (better.before, better.after) == (10.0, 6.0)
    assert better.share == pytest.approx(0.64)
    assert better.se == pytest.approx(100 * 0.001 / (0.10 + 0.06))  # of the difference of roots, by the delta method
    assert other_use(with_candidates(found, monkeypatch, (0.0064, 0.003))) is None  # two standard errors


def three_logs(folder: Path, others: dict[int, WrongPlant]) -> Identification:
    """Three logs of different motions of the arm; some are of other plants."""
    logs = []
    for k in range(3):
        part = folder / f"{k}"
        part.mkdir()
        # The seed of the motion differs; bodies and friction are those of the arm.
        plant = others.get(k, WrongPlant(ARM))
        made = OtherMotion(plant.case, plant.cause, number=k)
        written(made, part)
        logs.append(f'[[logs]]\npath = "{k}/log.csv"\n')
    (folder / "device.toml").write_bytes((folder / "0" / "device.toml").read_bytes())
    text = (folder / "0" / "study.toml").read_text(encoding="utf-8").replace('[[logs]]\npath = "log.csv"\n', "")
    text = text.replace("[validation]", "".join(logs) + "[validation]").replace('"blocks"', '"leave-one-log-out"')
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return identify(read_study(folder / "study.toml"))


class OtherMotion(WrongPlant):
    """The same plant in another motion."""

    def __init__(self, case: Case, cause: str, number: int) -> None:
        super().__init__(case, cause)
        object.__setattr__(self, "number", number)
        from zoo.plant import Fourier

        WrongPlant(case).chi  # noqa: B018 - as computed with its own motion
        object.__setattr__(self, "chi", WrongPlant(case).chi)
        object.__setattr__(self, "speed", WrongPlant(case).speed)
        object.__setattr__(self, "motion", Fourier(np.random.default_rng([case.seed, number]), case))


def test_the_log_of_another_device_is_named_and_removed(tmp_path: Path) -> None:
    heavier = replace(ARM, friction=0.8)
    found = three_logs(tmp_path, {1: WrongPlant(heavier)})
    made = advise(found)
    (action,) = (one for one in made.actions if one.kind == "other log")
    assert made.actions[0] is action
    after = applied(made, found, tmp_path / "out")
    assert after is not None
    assert [Path(log.path).parent.name for log in after.identification.study.logs] == ["0", "2"]
    assert after.after < 0.5 * after.before


def test_three_logs_of_one_device_are_kept(tmp_path: Path) -> None:
    assert not advise(three_logs(tmp_path, {})).actions


def test_predicted_intervals_are_those_of_the_motion_recorded(tmp_path: Path) -> None:
    weak = Case(5, "arm3", 250, 12, 0.8, 3, bits=14, friction=0.3, level=0.03)
    written(WrongPlant(weak), tmp_path)
    found = identify(read_study(tmp_path / "study.toml"))
    made = more_motion(found.estimate)
    assert made is not None
    assert made.seconds <= made.same
    assert all(after < before for after, before in zip(made.after, made.before, strict=True))
    speed = made.speed
    there = tmp_path / "more"
    there.mkdir()
    plant = WrongPlant(weak)
    object.__setattr__(plant, "chi", plant.chi)
    object.__setattr__(plant, "motion", Changed(plant.motion, made.stroke, speed))
    object.__setattr__(plant, "case", replace(weak, seconds=made.seconds, motion_hz=weak.motion_hz * speed))
    written(plant, there)
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    both = text.replace("[validation]", '[[logs]]\npath = "more/log.csv"\n[validation]')
    (tmp_path / "both.toml").write_text(both, encoding="utf-8")
    estimate = identify(read_study(tmp_path / "both.toml")).estimate
    which = [found.model.base.names.index(name) for name in made.names]
    ratio = spread(estimate, found)[which] / spread(found.estimate, found)[which]
    predicted = [after / before for after, before in zip(made.after, made.before, strict=True)]
    np.testing.assert_allclose(ratio, predicted, rtol=0.3)


def spread(estimate: Estimate, of: Identification) -> np.ndarray:
    """Standard errors by the information of the recorded rows, with the same noise in each second."""
    motion = estimate.observation.motions[0]
    T = estimate.observation.stack(of.estimate.weights)[:, :-1]
    return np.sqrt(np.diag(np.linalg.inv(T.T @ T)) / (motion.treatment.decimation * motion.dt))


class Changed:
    """A motion along the same path, with larger strokes or at another speed."""

    def __init__(self, motion: Any, stroke: float, speed: float) -> None:
        self.own, self.stroke, self.speed, self.centre = motion, stroke, speed, motion.centre

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        middle = self.centre[:, None] if order == 0 else 0.0
        return np.asarray(middle + self.stroke * (self.own(t * self.speed, order) * self.speed**order - middle))

    def states(self, t: np.ndarray) -> tuple[np.ndarray, ...]:
        return self(t, 0), self(t, 1), self(t, 2)
