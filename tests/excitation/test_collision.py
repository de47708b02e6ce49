"""Collision shapes: distances against Coal and by definition, slopes, motions between samples, files, the search."""

import base64
import json
import re
import tomllib
from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy import optimize
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.device.collision import world_of
from haptid.device.toml.reader import checked_tables, device_of
from haptid.experiment.collision import CollisionModel, clearance_along
from haptid.experiment.collision.clearance import LEAST_TOLERANCE
from haptid.experiment.collision.distances import nearest_of_segments
from haptid.experiment.excitation import FourierSeries, Limits, Search, design_excitation
from haptid.report.motion_page import motion_page

# Two turning joints and a sliding one, and the shapes that tests add to them.
ARM = """
name = "arm"
gravity = [0, 0, -9.81]
convention = "placement"
[[joints]]
name = "1"
xyz = [0, 0, 0.1]
limits = { position = [-2, 2], velocity = 3 }
[[joints]]
name = "2"
xyz = [0.3, 0, 0]
axis = [0, 1, 0]
limits = { position = [-2, 2], velocity = 3 }
[[joints]]
name = "3"
type = "prismatic"
xyz = [0.2, 0, 0]
axis = [1, 0, 0]
limits = { position = [-0.1, 0.1], velocity = 0.5 }
[[terms]]
kind = "viscous"
joints = "all"
"""
BAR = {"link": "3", "kind": "capsule", "radius": 0.02, "length": 0.2, "rpy": [0, "pi/2", 0], "xyz": [0.1, 0, 0]}
HULL = [[0.05, 0, 0], [-0.04, 0.06, 0], [-0.04, -0.06, 0], [0, 0, 0.09], [0, 0, 0.01]]
KINDS = {
    "sphere": {"radius": 0.08},
    "capsule": {"radius": 0.04, "length": 0.2},
    "cylinder": {"radius": 0.06, "length": 0.1},
    "box": {"size": [0.1, 0.2, 0.06]},
    "hull": {"points": HULL},
}


def arm(*shapes):
    return haptid.DynamicModel(device_of(*checked_tables(tomllib.loads(ARM) | {"collision": list(shapes)}, "arm.toml")))


def world(*shapes):
    return world_of({"collision": list(shapes)}, "world.toml")


def random_poses(seed, count=60):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * [2.0, 2.0, 0.1]


def test_nearest_points_of_segments_are_those_of_a_minimisation():
    rng = np.random.default_rng(0)
    ends = rng.uniform(-1, 1, (4, 12, 3))
    ends[1, 0] = ends[0, 0]  # a point and a segment, two points, parallel segments
    ends[1, 1], ends[3, 1] = ends[0, 1], ends[2, 1]
    ends[3, 2] = ends[2, 2] + 0.7 * (ends[1, 2] - ends[0, 2])
    p, q = nearest_of_segments(*ends)
    for k, (a, b, c, d) in enumerate(ends.transpose(1, 0, 2)):
        apart = lambda x, a=a, b=b, c=c, d=d: np.sum((a + x[0] * (b - a) - c - x[1] * (d - c)) ** 2)  # noqa: E731
        best = optimize.minimize(apart, [0.5, 0.5], bounds=[(0, 1)] * 2, options={"ftol": 1e-16, "gtol": 1e-12})
        assert np.linalg.norm(p[k] - q[k]) == pytest.approx(np.sqrt(best.fun), abs=1e-6)


@pytest.mark.parametrize(("first", "second"), list(combinations_with_replacement(KINDS, 2)))
def test_distances_are_those_of_another_program(first, second):
    coal = pytest.importorskip("coal")

    def another(kind):
        if kind == "hull":
            points = coal.StdVec_Vec3s()
            points.extend([np.array(point, dtype=float) for point in HULL])
            return coal.Convex.convexHull(points, True, "Qt") if hasattr(coal, "Convex") else None
        given = KINDS[kind]
        if kind == "box":
            return coal.Box(*given["size"])
        made = {"sphere": coal.Sphere, "capsule": coal.Capsule, "cylinder": coal.Cylinder}[kind]
        return made(*given.values())

    a, b = another(first), another(second)
    if a is None or b is None:
        pytest.skip("this Coal has no hulls")
    turned = {"xyz": [0.05, 0.1, 0.2], "rpy": [0.3, -0.5, 1.1]}
    model = arm({"link": "3", "kind": first} | KINDS[first])
    collision = CollisionModel.of(model, world({"kind": second} | KINDS[second] | turned))
    q = random_poses(1)
    at, found = collision.shape_poses(q), collision.measure(q, np.zeros(len(q), dtype=int))
    request = coal.DistanceRequest()
    wanted = []
    for pose in at:
        placed = [coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3]) for T in pose]
        wanted.append(coal.distance(a, placed[0], b, placed[1], request, coal.DistanceResult()))
    apart = np.array(wanted) > 0
    assert apart.any()
    np.testing.assert_allclose(found[apart], np.array(wanted)[apart], atol=2e-5)
    assert (found[~apart] <= 2e-5).all()


@pytest.mark.parametrize("kind", ["capsule", "box"])
def test_slopes_are_differences_of_the_distance(kind):
    collision = CollisionModel.of(arm(BAR), world({"kind": kind, "xyz": [0.3, 0.3, 0.2]} | KINDS[kind]))
    q, step = random_poses(2), 1e-6
    found = collision.near(q, 1.0)
    slopes = collision.slopes(q, np.eye(3), found)
    apart = found.distance > 1e-3
    for j in range(3):
        way = step * np.eye(3)[j]
        ahead, behind = (collision.measure(q[found.sample] + sign * way, found.pair) for sign in (1, -1))
        np.testing.assert_allclose(slopes[apart, j], ((ahead - behind) / (2 * step))[apart], atol=2e-4)


def test_a_distance_of_a_loop_follows_its_passive_joints():
    """A ball on a passive link of a parallelogram: slopes through the closure."""
    from haptid.device.toml.reader import read_tables

    tables, name = read_tables("phantom_premium_15")
    device = device_of(tables, name)
    passive = next(j.name for k, j in enumerate(device.joints) if k not in device.active)
    table = {"link": passive, "kind": "sphere", "radius": 0.02, "xyz": [0.1, 0, 0]}
    model = haptid.DynamicModel(
        device_of(type(tables).model_validate(tables.model_dump() | {"collision": [table]}), name)
    )
    collision = CollisionModel.of(model, world({"kind": "sphere", "radius": 0.01, "xyz": [0.2, 0.2, 0.2]}))
    q = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3))
    tree = lambda q: model.device.closure.positions(np.ascontiguousarray(q.T)).T  # noqa: E731
    found, G = collision.near(tree(q), 1.0), model.device.closure.follow(np.ascontiguousarray(q.T)).G
    slopes, pairs = collision.slopes(tree(q), G, found), np.zeros(5, dtype=int)
    assert np.abs(slopes).max() > 0.05
    for j in range(3):
        way = 1e-6 * np.eye(3)[j]
        ahead, behind = (collision.measure(tree(q + sign * way), pairs) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, j], (ahead - behind) / 2e-6, atol=1e-6)


def test_nothing_tunnels_between_two_samples():
    """A bar that is on either side of a thin wall at all samples, and passes it between two."""
    collision = CollisionModel.of(arm(BAR), world({"kind": "box", "size": [1.0, 0.002, 1.0], "xyz": [0.6, 0, 0.1]}))
    q = np.zeros((8, 3))
    q[:, 0] = np.repeat([-0.4, 0.4], 4)
    sampled = collision.measure(q, np.zeros(len(q), dtype=int))
    assert sampled.min() > 0.05
    found = clearance_along(collision, q, 0.5)
    assert found.distance < 0
    assert 1.5 < found.time < 2.0
    assert "box 1 of the world" in found.pair


def test_the_bound_holds_along_a_motion():
    t = np.linspace(0, 2, 401)[:, None]
    q = np.sin(t * [3.0, 4.0, 5.0]) * [1.5, 1.2, 0.1]
    shapes = [{"link": "base", "kind": "box", "size": [0.1, 0.1, 0.1]}, BAR | {"link": "2"}, BAR]
    collision = CollisionModel.of(arm(*shapes), world({"kind": "sphere", "radius": 0.1, "xyz": [0.4, 0.5, 0.3]}))
    assert len(collision.pairs) == 4  # base with 2 and 3, the world with 2 and 3: not neighbours
    found = clearance_along(collision, q, 5e-3)
    fine = np.linspace(0, 400, 4001)
    dense = np.array([np.interp(fine, np.arange(401), x) for x in q.T]).T
    least = collision.near(dense, 10.0).distance.min()
    assert found.bound <= least
    assert found.bound <= found.distance <= least + LEAST_TOLERANCE
    assert found.distance - found.bound <= LEAST_TOLERANCE
    moment = np.array([[np.interp(found.time / 5e-3, np.arange(401), x) for x in q.T]])
    assert collision.near(moment, 10.0).distance.min() == pytest.approx(found.distance, abs=1e-9)


def test_the_search_keeps_its_distance_and_needs_to():
    """The motion found without the obstacle meets it; with it, a dense sampling is clear of it."""
    family, search = FourierSeries(6.0, 0.25, 4, start_pose=(0.0, 0.0, 0.0)), Search(tries=60)
    around = world({"kind": "sphere", "radius": 0.08, "xyz": [0.55, 0.25, 0.1]})
    model = arm(BAR)
    collision = CollisionModel.of(model, around)
    beta = np.ones(len(model.base))
    free = design_excitation(model, family, Limits(), beta=beta, search=search)
    assert free.clearance is not None  # no pair of its own
    assert collision.near(free.trajectory(0.01).q, 1.0).distance.min() < 0.02
    kept = design_excitation(model, family, Limits(clearance=0.02, world=around), beta=beta, search=search)
    assert collision.near(kept.trajectory(2e-3).q, 1.0).distance.min() > 0.017
    assert kept.clearance.bound > 0.015
    assert "least distance" in kept.summary()
    the_picture_has_what_comes_nearest(kept, collision)


def the_picture_has_what_comes_nearest(kept, collision):
    """The page's scene: nearest points as far apart as the motion's clearance, shapes where they are along it."""
    drawn = re.search(r'id="drawings"[^>]*>(.*?)</script>', motion_page({"kept": kept}), re.DOTALL)
    scene = json.loads(drawn[1])["scene"]
    ((first, second),) = scene["nearest"]
    assert np.linalg.norm(np.subtract(first, second)) == pytest.approx(kept.clearance.distance, abs=1e-3)
    unpacked = {key: np.frombuffer(base64.b64decode(one["f32"]), "<f4") for key, one in scene["swept"].items()}
    ends, thick = unpacked["ends"].reshape(-1, 2, 3), unpacked["widths"] > 0
    assert len(ends) == len(thick)
    instants = kept.trajectory(kept.seconds / 800).q
    instants = instants[:: max(1, len(instants) // 120)]
    assert thick.sum() == len(instants) * len(collision.shapes)
    middles = ends[thick].mean(axis=1).reshape(len(instants), -1, 3)
    wanted = collision.shape_poses(kept.model.device.closure.positions(instants.T).T)[:, :, :3, 3]
    np.testing.assert_allclose(middles, wanted, atol=1e-6)


def test_a_start_that_cannot_be_is_said():
    model, family = arm(BAR), FourierSeries(6.0, 0.25, 2, start_pose=(0.0, 0.0, 0.0))
    around = world({"kind": "sphere", "radius": 0.1, "name": "lamp", "xyz": [0.6, 0, 0.1]})
    with pytest.raises(errors.TrajectoryError, match=r"in the start pose .*lamp overlap by") as raised:
        design_excitation(model, family, Limits(world=around), search=Search(tries=5))
    assert raised.value.found < 0
    outside = FourierSeries(6.0, 0.25, 2, start_pose=(0.0, 3.0, 0.0))
    with pytest.raises(errors.TrajectoryError, match="joint 2 at 3, outside its range"):
        design_excitation(model, outside, Limits(), search=Search(tries=5))
    with pytest.raises(errors.SettingError, match="no collision shapes on its links"):
        design_excitation(arm(), family, Limits(world=around), search=Search(tries=5))
    with pytest.raises(errors.SettingError, match="clearance"):
        Limits(clearance=-1.0)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (BAR | {"link": "4"}, 'no link is named "4"'),
        (BAR | {"ignore": ["hand"]}, 'no link is named "hand"'),
        (BAR | {"radius": -0.1}, "above zero"),
        (BAR | {"kind": "torus"}, 'no kind of shape is named "torus"'),
        ({"link": "1", "kind": "hull", "points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}, "no volume"),
        ({"link": "1", "kind": "box", "size": [1, 1]}, r"size"),
    ],
)
def test_shapes_that_cannot_be_are_refused_at_their_place(shape, said):
    with pytest.raises(errors.DeviceFileError, match=said) as raised:
        arm(BAR, shape)
    assert "collision[1]" in str(raised.value)


def test_a_world_has_no_links(tmp_path):
    with pytest.raises(errors.DeviceFileError, match=r"collision\[0\].link"):
        world(BAR)
    file = tmp_path / "world.toml"
    file.write_text('[lengths]\nh = 0.5\n[[collision]]\nkind = "box"\nsize = [1, 1, "h/5"]\nxyz = [0, 0, "-h"]\n')
    (shape,) = haptid.device.read_world(file)
    assert shape.size == (0.5, 0.5, 0.05)
    assert shape.frame.translation[2] == -0.5
    assert shape.radius == pytest.approx(np.sqrt(0.5 + 0.05**2))


def test_shapes_of_a_urdf_are_where_the_source_has_them(tmp_path):
    """The box of a link that is fixed to another stands where the chain of the file puts it."""
    geometry = "<geometry><box size='.1 .2 .3'/></geometry>"
    body = "<inertial><mass value='1'/><inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial>"
    mesh = "<collision><geometry><mesh filename='none.stl'/></geometry></collision>"
    file = tmp_path / "robot.urdf"
    file.write_text(
        f"<robot name='r'><link name='a'/><link name='b'>{body}{mesh}</link><link name='tip'><collision>"
        f"<origin xyz='0 0 .1' rpy='.1 .2 .3'/>{geometry}</collision></link>"
        "<joint name='j' type='revolute'><parent link='a'/><child link='b'/><axis xyz='0 1 0'/></joint>"
        "<joint name='f' type='fixed'><parent link='b'/><child link='tip'/><origin xyz='1 2 3' rpy='0 0 .5'/></joint>"
        "</robot>"
    )
    made = haptid.robot_files.import_robot(file)
    (shape,) = made.device.collision
    assert shape.size == (0.05, 0.1, 0.15)
    assert "meshes (or shapes without a size) are not imported, of: b" in made.text
    model, angle = haptid.DynamicModel(made.device), 0.7
    at = CollisionModel.of(model).shape_poses(np.array([[angle]]))[0, 0]
    turn = Rotation.from_euler("y", angle)
    fixed = Rotation.from_euler("z", 0.5)
    np.testing.assert_allclose(at[:3, 3], turn.apply(np.array([1, 2, 3]) + fixed.apply([0, 0, 0.1])), atol=1e-12)
    wanted = turn * fixed * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    np.testing.assert_allclose(at[:3, :3], wanted.as_matrix(), atol=1e-12)


def test_own_shapes_that_overlap_in_every_pose_are_left_out_and_named(tmp_path):
    """As about the axes of a spherical wrist; a world that always overlaps is an error of the user's and stays."""
    around = {"link": "1", "name": "housing", "kind": "sphere", "radius": 0.8}
    tip = {"link": "3", "name": "tip", "kind": "sphere", "radius": 0.02, "xyz": [0.1, 0, 0]}
    far, wide = ({"name": "far", "kind": "sphere", "radius": r, "xyz": [0.9, 0, 0.1]} for r in (0.35, 2.0))
    both = CollisionModel.of(arm(around, tip), world(far))
    assert both.overlapping == ("housing and tip",)
    assert {both.label(k) for k in range(len(both.pairs))} == {"housing and far", "tip and far"}
    assert len(CollisionModel.of(arm(around, tip), world(wide)).pairs) == 2
    alone = CollisionModel.of(arm(around, tip))
    assert (alone.pairs, alone.overlapping) == (((0, 1),), ())
    tables = "".join(
        "[[collision]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in one.items())
        for one in (around | {"radius": 0.4, "xyz": [0.3, 0, 0]}, tip, BAR | {"name": "bar"})
    )
    (tmp_path / "arm.toml").write_text(ARM + tables)
    (tmp_path / "world.toml").write_text(
        'schema = 1\n[[collision]]\nname = "far"\nkind = "sphere"\nradius = 0.1\nxyz = [0, 0.9, 0.1]\n'
    )
    call = ["excite", str(tmp_path / "arm.toml"), "--world", str(tmp_path / "world.toml"), "--max-evaluations", "60"]
    done = CliRunner().invoke(app, [*call, "--out", str(tmp_path / "x.toml")])
    assert done.exit_code == 0, done.output
    assert "left out, as they overlap in every pose: housing and tip; housing and bar" in done.stdout
