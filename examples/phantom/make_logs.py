"""Make two logs of a PHANToM Premium 1.5 as its own controller would record them, from known parameters.

The torque is the model's at the exact motion; the log has what an instrument would give: encoder counts, torque with
noise. So the truth is known, and the identification can be judged. The true parameters go beside the logs.

    python examples/phantom/make_logs.py OUT
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import haptid

RATE_HZ = 1000.0
SECONDS = 20.0
# Published constants of the device file, plus friction of the size found on it (Tahmasebi et al. 2005, table I / 2.73).
FRICTION = {"FV1": 7e-4, "FV2": 5e-4, "FV3": 4e-4, "FC1": 0.026, "FC2": 0.0092, "FC3": 0.0091}
# Encoder step and torque noise at the joint side.
STEP = 1.4e-4
NOISE = 5e-4
CENTRE = np.array([0.0, 0.2, 0.3])
FREQUENCIES_HZ = np.array([[0.31, 0.83, 1.49, 2.27], [0.37, 0.97, 1.61, 2.39], [0.29, 0.89, 1.37, 2.11]])
AMPLITUDE = np.array([0.45, 0.3, 0.35])


def motion(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), and joint positions, velocities, accelerations, each (3, n): four sines a joint, random phases."""
    t = np.arange(0.0, SECONDS, 1 / RATE_HZ)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, FREQUENCIES_HZ.shape)
    omega = 2 * np.pi * FREQUENCIES_HZ
    size = AMPLITUDE[:, None] / FREQUENCIES_HZ**0.7 / 2
    angle = omega[..., None] * t + phase[..., None]
    q = CENTRE[:, None] + np.einsum("jk,jkn->jn", size, np.sin(angle))
    qd = np.einsum("jk,jkn->jn", size * omega, np.cos(angle))
    qdd = -np.einsum("jk,jkn->jn", size * omega**2, np.sin(angle))
    return t, q, qd, qdd


def main(folder: Path) -> None:
    """Write sweep.parquet, check.parquet and truth.json."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    chi = np.nan_to_num(model.device.chi_prior)  # what is not known of a link is taken as zero
    for name, value in FRICTION.items():
        chi[model.device.parameters.index[name]] = value
    beta = model.base.of(chi)
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in ((1, "sweep"), (2, "check")):
        t, q, qd, qdd = motion(seed)
        rng = np.random.default_rng(100 + seed)
        tau = haptid.inverse_dynamics(model, beta, q, qd, qdd) + NOISE * rng.standard_normal(q.shape)
        columns = {"t": t}
        columns |= {f"q{k + 1}": STEP * np.round(q[k] / STEP) for k in range(3)}
        # The amplifier box is commanded in its own units: the device file knows its torque constant.
        drives = model.device.drives
        columns |= {
            f"command{k + 1}": tau[k] / drive.torque_constant / drive.gear_ratio for k, drive in enumerate(drives)
        }
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
    truth = dict(zip(model.base.names, beta.tolist(), strict=True))
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
