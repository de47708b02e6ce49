"""What peers share: the sizes of the samples, Pinocchio's order of parameters, and the robot as URDF or MJCF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

Case = dict[str, np.ndarray]
# See `arm.py`; of the other works, so many samples, states, poses; steps of a simulation, and their length, s.
IN_CACHE, ALONE, MANY = 128, 1984, 2048
STEPS, STEP = 10, 1e-4
# Samples of a motion whose condition number is asked for.
TRAJECTORY = 200
# Order of the ten parameters, m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, from XX XY XZ YY YZ ZZ MX MY MZ M.
PINOCCHIO = np.array([4, 5, 7, 6, 8, 9, 1, 2, 3, 0])


def picked(case: Case, Y: np.ndarray, order: np.ndarray = PINOCCHIO) -> np.ndarray:
    """Wanted entries, (samples, entries), of regressors whose ten parameters have another order.

    Those of a closed chain are first projected on its coordinates: torques are G' times the tree's.
    """
    rows, columns = case["wanted"].T
    made = np.einsum("jc,sjp->scp", case["rates"], Y) if "rates" in case else Y
    return made[:, rows, columns // 10 * 10 + order[columns % 10]]


def base_columns(case: Case) -> np.ndarray:
    """Wanted columns in Pinocchio's order."""
    columns = np.unique(case["wanted"][:, 1])
    return columns // 10 * 10 + PINOCCHIO[columns % 10]


def samples(case: Case, count: int, *names: str) -> list[np.ndarray]:
    """The first samples of each, (count, n), one sample after the other."""
    return [np.ascontiguousarray(case[name][:, :count].T) for name in names]


def urdf(case: Case) -> str:
    """The robot as URDF, its base a link without mass."""
    parts = ["<robot name='arm'><link name='base'/>"]
    for k, parent in enumerate(case["parent"]):
        inertia = dict(
            zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), case["inertia"][k][np.triu_indices(3)], strict=True)
        )
        parts += [
            f"<link name='link{k}'><inertial><origin xyz='{text(case['com'][k])}'/>",
            f"<mass value='{float(case['mass'][k])}'/>",
            f"<inertia {' '.join(f'{name}={str(float(x))!r}' for name, x in inertia.items())}/></inertial></link>",
            f"<joint name='joint{k}' type='continuous'><axis xyz='0 0 1'/><child link='link{k}'/>",
            f"<parent link='{f'link{parent}' if parent >= 0 else 'base'}'/>",
            f"<origin xyz='{text(case['translation'][k])}' rpy='{text(angles(case['rotation'][k]))}'/></joint>",
        ]
    return "".join([*parts, "</robot>"])


def angles(R: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw of a rotation."""
    return np.array([np.arctan2(R[2, 1], R[2, 2]), np.arcsin(-R[2, 0]), np.arctan2(R[1, 0], R[0, 0])])


def mjcf(case: Case) -> str:
    """The robot as MJCF: no geometry, nothing but links and joints; each link follows the one before it."""
    head = f"<mujoco><option gravity='{text(case['gravity'])}' timestep='{STEP}' integrator='Euler'/>"
    parts = [head, "<compiler angle='radian' autolimits='true'/><worldbody>"]
    for k, parent in enumerate(case["parent"]):
        assert parent == k - 1, "a chain"
        R, upper = case["rotation"][k], case["inertia"][k][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        parts += [
            f"<body pos='{text(case['translation'][k])}' xyaxes='{text(np.concatenate([R[:, 0], R[:, 1]]))}'>",
            f"<inertial pos='{text(case['com'][k])}' mass='{float(case['mass'][k])}' fullinertia='{text(upper)}'/>",
            "<joint type='hinge' axis='0 0 1'/>",
        ]
    return "".join([*parts, *(["</body>"] * len(case["parent"])), "</worldbody></mujoco>"])


def text(numbers: np.ndarray) -> str:
    """Every digit."""
    return " ".join(repr(float(x)) for x in numbers)


def compiled(source: Path, library: Path, compiler: list[str]) -> None:
    """Compile a loop, once for all later runs; nothing to do where the library is newer than its source."""
    import subprocess

    if not library.exists() or library.stat().st_mtime < source.stat().st_mtime:
        subprocess.run([*compiler, str(source), "-o", str(library)], check=True)
