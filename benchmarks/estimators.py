"""Every estimator on three robots' public recordings: error on motion that the fit has not seen, per cent.

The studies of `examples/` as they stand, logs in `../shared/data`: EMPS is identified on one log and predicts the
pulses of the other, TX40 predicts every other half second, KR300 each of its three logs from the other two. One figure
for each robot and estimator: norm(y - y_hat) / norm(y) of all unseen rows together, and how much worse than OLS it is.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import haptid
from haptid.errors import HaptidError
from haptid.estimation import (
    GLS,
    IRLS,
    SUR,
    TLS,
    Bounds,
    ErrorsInVariables,
    Heteroscedastic,
    Huber,
    Ridge,
    StudentT,
    Tukey,
)
from haptid.observation import concatenated
from haptid.study.held_out import held_out
from haptid.validation.validation import pooled

HERE = Path(__file__).resolve().parents[1]
ROBOTS = ("emps", "kuka_kr300", "staubli_tx40")


def methods(model: haptid.Device) -> Mapping[str, haptid.estimation.Method]:
    """Those that need no controller."""
    friction = {name: (0.0, None) for name in model.base.names if name.startswith(("FV", "FC"))}
    return {
        "OLS": haptid.OLS(),
        "WLS": haptid.WLS(),
        "SUR": SUR(),
        "GLS": GLS(),
        "IRLS, Huber": IRLS(Huber()),
        "IRLS, Tukey": IRLS(Tukey()),
        "IRLS, Student t": IRLS(StudentT()),
        "heteroscedastic ML": Heteroscedastic(),
        "TLS": TLS(),
        "TLS, encoder noise": ErrorsInVariables(),
        "ridge towards the prior": Ridge(),
        "friction not negative": Bounds(friction),
        "physically consistent": haptid.PhysicallyConsistent(),
    }


def unseen(study: haptid.Study, observations: list[haptid.Observation]) -> float:
    """Relative error on all unseen rows of a study, per cent."""
    pairs = list(zip(study.logs, observations, strict=True))
    fitted = [o for entry, o in pairs if entry.role == "identify"]
    if study.cross_validation is None:
        found = haptid.estimate(concatenated(fitted), study.method)
        return pooled(*(haptid.validate(found, o) for entry, o in pairs if entry.role == "validate")).relative
    parts = held_out(study, fitted[0].model, fitted, [None] * len(fitted))
    return pooled(*(v for part in parts for v in part)).relative


def run() -> dict[str, float]:
    """Per cent, points and seconds; a method that refuses a log has no figure."""
    figures: dict[str, float] = {}
    data = HERE.parent / "shared" / "data"
    for example in ROBOTS:
        study = haptid.read_study(HERE / "examples" / example / "study.toml")
        found = haptid.identify(study, data / example)
        observations = [each.observation for each in found.runs]
        for name, method in methods(found.model).items():
            begin = time.perf_counter()
            try:
                error = unseen(replace(study, method=method), observations)
            except HaptidError:
                continue
            figures[f"{example}: {name}, unseen %"] = error
            figures[f"{example}: {name}, points above OLS"] = error - figures[f"{example}: OLS, unseen %"]
            figures[f"{example}: {name}, s"] = time.perf_counter() - begin
    return figures
