"""Device files drawn from a seed: trees and closed chains of all conventions, with terms, couplings and symmetry."""

from __future__ import annotations

import numpy as np

QUARTERS = ("-pi/2", "0", "pi/2", "pi")
GRAVITY = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (9.81, 0.0, 0.0), (3.0, -4.0, 0.0), (1.0, 2.0, 9.0))
# Distinct, and no sum or difference of two of them is a third.
SIZES = (0.11, 0.23, 0.47, 0.31, 0.19, 0.53, 0.83, 0.61, 0.71, 0.37)
TERMS = (
    'kind = "rotor-inertia"\njoints = "all"',
    'kind = "viscous"\njoints = "all"',
    'kind = "viscous-by-direction"\njoints = "all"',
    'kind = "coulomb"\njoints = "all"',
    'kind = "coulomb-by-direction"\njoints = "all"',
    'kind = "coulomb"\njoints = "all"\nwidth = 2.0\nprefix = "FW"',
    'kind = "load-friction"\njoints = "active"',
    'kind = "load-friction"\njoints = "active"\nwidth = 2.0\nprefix = "LW"',
    'kind = "stribeck"\njoints = "active"\nvelocity = 0.3',
    'kind = "offset"\njoints = "all"',
    'kind = "spring"\njoints = "all"\nrest = 0.25',
)


def device_text(seed: int, joints: int, free_angle: bool = False) -> str:
    """A file of so many joints; where `free_angle`, one of its twists is no multiple of a quarter turn."""
    rng = np.random.default_rng(seed)
    convention = ("modified-dh", "dh", "placement")[rng.integers(3)]
    gravity = GRAVITY[rng.integers(len(GRAVITY))]
    sizes = rng.permutation(SIZES).tolist()
    named = {f"L{k}": size for k, size in enumerate(sizes[:4])}
    parts = [f'name = "drawn"\nconvention = "{convention}"\ngravity = {list(gravity)}', "[lengths]"]
    parts += [f"{name} = {size}" for name, size in named.items()]
    sliding = rng.random(joints) < 0.25
    for j in range(joints):
        above = "base" if j == 0 else str(rng.integers(max(0, j - 2), j))
        kind = "prismatic" if sliding[j] else "revolute"
        parts.append(f'[[joints]]\nname = "{j}"\nparent = "{above}"\ntype = "{kind}"')
        parts.append(_geometry(rng, convention, [*named], sizes[4:], free_angle and j == joints - 1))
    parts += _loops(rng, sliding)
    parts += [f"[[terms]]\n{term}" for term in TERMS if rng.random() < 0.4]
    return "\n".join(parts)


def _length(rng: np.random.Generator, named: list[str], sizes: list[float]) -> str:
    pick = rng.random()
    if pick < 0.5:
        return "0"
    if pick < 0.8:
        return f'"{rng.choice(["", "-", "2*"])}{rng.choice(named)}"'
    return str(float(rng.choice(sizes)))


def _geometry(rng: np.random.Generator, convention: str, named: list[str], sizes: list[float], free_angle: bool) -> str:
    angle = [f'"{turn}"' for turn in rng.choice(QUARTERS, 3)]
    if free_angle:
        angle[0] = "0.4"
    length = [_length(rng, named, sizes) for _ in range(3)]
    if convention == "modified-dh":
        return f"alpha = {angle[0]}\ntheta = {angle[1]}\nd = {length[0]}\nr = {length[1]}"
    if convention == "dh":
        return f"alpha = {angle[0]}\ntheta = {angle[1]}\na = {length[0]}\nd = {length[1]}"
    axis = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0]][rng.integers(5)]
    return f"xyz = [{', '.join(length)}]\nrpy = [{', '.join(angle)}]\naxis = {axis}"


def _loops(rng: np.random.Generator, sliding: np.ndarray) -> list[str]:
    """Some joints made to follow the first two, turning ones with whole factors, sliding ones with a lead."""
    made = []
    for j in range(2, len(sliding)):
        if rng.random() > 0.3:
            continue
        k = int(rng.integers(2))
        factor = rng.choice(["", "-", "2*"]) if sliding[j] == sliding[k] else "0.07*" if sliding[j] else "1/0.07*"
        constant = "" if sliding[j] else rng.choice(["pi/2 + ", "-pi + ", ""])
        made.append(f'[[loops]]\nrelations = ["q{j} = {constant}{factor}q{k}"]')
    return made
