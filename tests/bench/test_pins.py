"""Distance of linear loops from flat: against singular values of the loops' own Jacobian, and central differences."""

import numpy as np
import pytest

import haptid
from haptid.device.loops.chain import Chain
from haptid.device.loops.pins import Pins

# A parallelogram of two arms, each with a slide along it; a second bar couples the slides.
TELESCOPES = """
schema = 1
name = "telescopes"
gravity = [0, 0, -9.81]
convention = "placement"

[[joints]]
name = "turn"

[[joints]]
name = "bar"
xyz = [0.4, 0, 0]

[[joints]]
name = "turn2"
parent = "base"
xyz = [0, 0.3, 0.05]

[[joints]]
name = "out"
parent = "turn"
type = "prismatic"
xyz = [0.1, 0, 0.02]
rpy = [0, "pi/2", 0]

[[joints]]
name = "bar2"
rpy = [0, "-pi/2", 0]

[[joints]]
name = "out2"
parent = "turn2"
type = "prismatic"
xyz = [0.1, 0, 0.02]
rpy = [0, "pi/2", 0]

[[loops]] # turn2 = turn, bar = -turn
passive = ["bar", "turn2"]
guess = { bar = 0, turn2 = 0 }
[loops.cut]
body_a = "bar"
frame_a = { xyz = [0, 0.3, 0.05] }
body_b = "turn2"
frame_b = { xyz = [0.4, 0, 0] }

[[loops]] # out2 = out, bar2 = -turn
passive = ["bar2", "out2"]
guess = { bar2 = 0, out2 = 0 }
[loops.cut]
body_a = "bar2"
frame_a = { xyz = [0, 0.3, 0.05] }
body_b = "out2"
frame_b = { rpy = [0, "-pi/2", 0] }
"""


def device(name, folder):
    if name != "telescopes":
        return haptid.read_device(name)
    (folder / "telescopes.toml").write_text(TELESCOPES)
    return haptid.read_device(folder / "telescopes.toml")


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "sr400", "telescopes"])
def test_pins(name, tmp_path):
    made = device(name, tmp_path)
    pins, active = Pins.of(made), list(made.active)
    qa = np.random.default_rng(0).uniform(-0.9, 0.9, (len(active), 300))
    chain = Chain.of(made.joints, made.closure.cuts, made.active)
    rows = [6 * k + i for k in range(len(made.closure.cuts)) for i in range(3)]  # those of the origins of revolute cuts
    passive = [j for j in range(len(made.joints)) if j not in active]
    J = chain.residual(made.closure.positions(qa).T)[1][:, rows][:, :, passive]
    wanted = np.linalg.svd(J / np.linalg.norm(J, axis=1, keepdims=True), compute_uv=False)[:, -1]
    at = pins.at(qa)
    np.testing.assert_allclose(at.conditioning, wanted, atol=1e-8)
    level = float(np.quantile(wanted, 0.6))
    some = pins.at(qa, level)
    np.testing.assert_array_equal(some.small, wanted < level)
    np.testing.assert_allclose(some.conditioning, np.minimum(wanted, level), atol=1e-8)
    step = 1e-6
    sides = [
        [pins.at(qa + sign * step * unit[:, None]).conditioning for sign in (1, -1)] for unit in np.eye(len(active))
    ]
    slopes = np.array([(up - down) / (2 * step) for up, down in sides])
    even = wanted > 0.01  # at flat poses the distance has a corner
    np.testing.assert_allclose(at.slopes()[:, even], slopes[:, even], atol=1e-5)
    np.testing.assert_array_equal(some.slopes(), at.slopes()[:, some.small])


def test_devices_without_loops_have_no_pins():
    assert Pins.of(haptid.read_device("arm7")) is None
    assert Pins.of(haptid.read_device("delta")) is None
