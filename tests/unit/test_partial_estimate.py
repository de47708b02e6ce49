"""The estimate of a study whose log does not tell some parameters: what is left out, and what is said of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
import small_study
from haptid.export import CCode, export_c
from haptid.study import partial_estimate
from haptid.study.identify import identify
from haptid.study.read import read_study
from motions import multisine

OFFSET = '[[terms]]\nkind = "offset"\njoints = "all"\n'


def write(folder: Path, use: str, steady: int = 1) -> Path:
    """A study of two links with offsets of the torques, one of whose joints turns at constant speed."""
    (folder / "device.toml").write_text(small_study.DEVICE + OFFSET)
    model = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    q, qd, qdd = multisine(2, 6.0, 2e-3, 3)
    t = 2e-3 * np.arange(q.shape[1])
    q[steady], qd[steady], qdd[steady] = -1.5 + 0.3 * t, 0.3, 0.0
    rng = np.random.default_rng(0)
    beta = model.base.of(rng.uniform(0.1, 0.3, len(model.device.parameters)))
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau += 0.02 * rng.standard_normal(tau.shape)
    columns = {"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}
    pyarrow.csv.write_csv(pa.table(columns), folder / "log.csv")
    end = f'[[logs]]\npath = "log.csv"\n[treatment]\ncutoff_hz = 30\ndecimation = 5\n[estimate]\nuse = "{use}"\n'
    (folder / "study.toml").write_text(small_study.HEAD + end)
    return folder / "study.toml"


@pytest.mark.parametrize(
    ("use", "said"),
    [
        ("auto", None),
        ("free", "is this fit, without those left out"),
        ("consistent", None),
    ],
)
def test_what_is_left_out_and_the_use_that_a_study_wants_are_said(tmp_path: Path, use: str, said: str | None) -> None:
    """The second joint's friction and offset are one torque; the use that the study set was dropped in silence."""
    found = identify(read_study(write(tmp_path, use)))
    names = found.estimate.observation.base.names
    left_out = {names[k] for k in found.estimate.zero}
    assert left_out
    assert left_out < {"FV2", "FC2", "OFF2"}
    (note,) = (one for one in found.estimate.notes if "cannot be told from this log" in one)
    assert "Record motion that takes the joints both ways, at several speeds" in note
    assert "the links" not in note
    assert (f'use = "{use}"' in note) == (said is not None)
    assert said is None or said in note


@pytest.mark.parametrize("steady", [0, 1])
@pytest.mark.parametrize("use", ["auto", "consistent"])
def test_the_model_for_use_is_of_bodies_and_predicts_as_the_fit_does(tmp_path: Path, steady: int, use: str) -> None:
    """It was the fit without what the log does not tell: friction of 603 and -2010 where that is told together."""
    found = identify(read_study(write(tmp_path, use, steady)))
    made, bodies = found.estimate, found.use.estimate.feasible
    assert found.use.name == "consistent"
    assert bodies is not None
    assert bodies.ok
    for inertia in bodies.pseudo_inertias:
        values = np.linalg.eigvalsh(inertia)  # the least is zero to rounding, where the constraint is active
        assert values[0] > -16 * np.finfo(float).eps * values[-1]
    assert all(made.names[k] in found.use.open for k in made.zero)
    # The weighted squared residual grows by less than that of one standard error of each parameter.
    motors = zip(made.observation.motors, made.weights, strict=True)
    grows = [weight**2 * (m.residual(found.use.beta) ** 2 - m.residual(made.beta) ** 2) for m, weight in motors]
    assert sum(grows) < len(made.beta)
    friction = [value for name, value in zip(made.names, found.use.beta, strict=True) if name[:2] in ("FV", "FC")]
    assert 0 <= min(friction) <= max(friction) < 2


def test_what_is_left_out_of_the_fit_but_not_of_the_model_for_use_is_in_the_code(tmp_path: Path) -> None:
    found = identify(read_study(write(tmp_path, "auto")))
    (k,) = found.estimate.zero
    assert found.use.beta[k] != 0
    export_c(found, tmp_path / "code", CCode("two"))
    header = (tmp_path / "code" / "two.h").read_text()
    assert f"p[{k}] {found.estimate.names[k]}: {found.use.beta[k]:.6g} " in header
    assert "not read by the code" not in header


@pytest.mark.parametrize(("kinds", "links", "both_ways"), [({"MX"}, 1, 0), ({"FV", "OFF"}, 0, 1), ({"IA", "FC"}, 1, 1)])
def test_the_motion_to_record_is_that_which_tells_what_is_left_out(kinds: set[str], links: int, both_ways: int) -> None:
    said = partial_estimate._advice(kinds)
    assert said.count("accelerates the links") == links
    assert said.count("both ways") == both_ways
