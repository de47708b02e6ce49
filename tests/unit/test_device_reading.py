"""Reading device files: each fault is reported once, with the place, the finding and what to write instead."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import haptid.device
from haptid import errors
from haptid._internal.bounded_files import DEFINITION_FILE
from haptid.device import device_schema, read_device, shipped_devices

ARM = """
schema = 1
name = "arm"
gravity = [0.0, 0.0, -9.81]
[lengths]
d3 = 0.45
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "-pi/2"
[[joints]]
name = "3"
d = "d3"
limits = { position = [-1.0, 2.0] }
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = ["1", "2"]
width = 0.1
"""
REDUNDANT = "".join(f'[[motors]]\nname = "{k}"\n' for k in (1, 2, 3)) + '[[motors]]\nname = "b"\ndrives = { 3 = 1 }\n'
PASSIVE = '[[loops]]\nrelations = ["q3 = -q2"]\n'
BALANCE = '[[terms]]\nkind = "counterbalance"\njoints = ["2"]\ncrank = 0.1\nbase = 0.5\nlaw = "gas"\nstroke = 0.3\n'


def add(text: str) -> str:
    return ARM + text


def swap(old: str, new: str) -> str:
    assert old in ARM
    return ARM.replace(old, new, 1)


# One or more broken files per class: (class, file, what the sentence must hold).
BROKEN = [
    ("DeviceFileError", swap("d3 = 0.45", "d3 = "), ["line 6, column 6", "d3 ="]),
    ("DeviceFileError", add("[[joints"), ["line ", "[[joints"]),
    ("DeviceFileError", add('name = "again"\nname = "again"'), ["line ", "verwrite"]),
    ("DeviceFileError", swap("alpha", "aplha"), ["joints[1].aplha", 'Did you mean "alpha"']),
    ("DeviceFileError", swap("width", "wdith"), ["terms[1].wdith", 'Did you mean "width"']),
    ("DeviceFileError", swap("gravity = [0.0, 0.0, -9.81]", ""), ["gravity", "missing", "top of the file"]),
    ("DeviceFileError", swap('name = "2"', ""), ["joints[1].name", "missing", "[[joints]]"]),
    (
        "DeviceFileError",
        swap("limits = { position", "limits = { positon"),
        ["joints[2].limits.positon", '"position"'],
    ),
    ("DeviceFileError", add('[[terms]]\njoints = "all"'), ["terms[2].kind", "missing", "viscous"]),
    ("DeviceFileError", add('[[terms]]\nkind = "offset"'), ["terms[2]", "acts on nothing"]),
    ("DeviceFileError", add('[[terms]]\nkind = "stribeck"\njoints = ["1"]'), ["terms[2].velocity", "missing"]),
    ("DeviceFileError", add("[handel]"), ["handel", 'Did you mean "handle"']),
    ("DeviceFileError", add(BALANCE.replace("stroke = 0.3\n", "")), ["terms[2].stroke", "missing"]),
    ("DeviceFileError", add(BALANCE.replace("gas", "spring")), ["terms[2].stroke", "no meaning"]),
    (
        "DeviceFileError",
        add('[[loops]]\npassive = ["3"]\ncut = { body_a = "3", body_b = "1", frame_a = { d = 1, xyz = [0, 0, 0] } }'),
        ["loops[0].cut.frame_a", "xyz or rpy is given together with d"],
    ),
    (
        "DeviceFileError",
        swap("[0.0, 0.0, -9.81]", "[0.0, -9.81]"),
        ["gravity", "found 2 entries", "at least 3"],
    ),
    ("DeviceFileError", swap("[0.0, 0.0, -9.81]", "9.81"), ["gravity", "found 9.81", "list"]),
    ("DeviceFileError", swap("0.45", "nan"), ["lengths.d3", "found nan", "finite"]),
    ("DeviceFileError", swap("-9.81", "-inf"), ["gravity[2]", "found -inf", "finite"]),
    ("DeviceFileError", swap("0.45", "true"), ["lengths.d3", "found True", "number"]),
    ("DeviceFileError", swap("0.45", "1" + "0" * 400), ["lengths.d3", "finite"]),
    (
        "DeviceFileError",
        swap("[-1.0, 2.0]", "[2.0, -1.0]"),
        ["joints[2].limits.position", "[2, -1]", "lower"],
    ),
    (
        "DeviceFileError",
        swap("position = [-1.0, 2.0]", "velocity = 0"),
        ["joints[2].limits.velocity", "above zero"],
    ),
    ("DeviceFileError", swap('name = "2"', 'name = "2 b"'), ["joints[1].name", "'2 b'", "underscores"]),
    (
        "DeviceFileError",
        swap('name = "2"', 'name = "2"\ntype = "spherical"'),
        ["joints[1].type", "'spherical'"],
    ),
    ("DeviceFileError", swap("schema = 1", "schema = 2"), ["schema", "found 2"]),
    ("DeviceFileError", swap("schema = 1", 'convention = "mdh"'), ["convention", "'mdh'", "modified-dh"]),
    ("DeviceFileError", swap("width = 0.1", "width = -0.1"), ["terms[1].width", "-0.1", "zero"]),
    ("DeviceFileError", add('[[motors]]\nname = "1"\ngear_ratio = 0'), ["motors[0].gear_ratio", "not zero"]),
    ("DeviceFileError", add('[[symmetry]]\nreason = "x"'), ["symmetry[0]", "says nothing"]),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nequal = [["XX1", "M1"]]'),
        ["symmetry[0].equal[0]", "kg m^2"],
    ),
    (
        "DeviceFileError",
        add('[[prior.bodies]]\nlink = "1"\nmass = -1\ncom = [0, 0, 0]'),
        ["prior.bodies[0].mass"],
    ),
    (
        "DeviceFileError",
        add('[[prior.bodies]]\nlink = "1"\nmass = 1\ncom = [0, 0, 0]\ninertia = [1, 1, -3, 0, 0, 0]'),
        ["prior.bodies[0].inertia", "-3"],
    ),
    ("DeviceFileError", add("[prior]\nM1 = { value = 1, std = 0 }"), ["prior.M1.std", "above zero"]),
    ("DeviceFileError", add("[base_parameters]\ntolerance = 2"), ["base_parameters.tolerance", "found 2"]),
    ("DeviceFileError", add(BALANCE.replace("0.3", "0.2")), ["terms[2].stroke", "up to 0.2 m"]),
    ("DeviceFileError", add(BALANCE.replace("0.5", "0.1")), ["terms[2].crank", "differ"]),
    ("DeviceFileError", add(BALANCE.replace('["2"]', '["1", "2"]')), ["terms[2]", "more than one"]),
    ("DeviceFileError", add(BALANCE.replace('joints = ["2"]', 'motors = ["2"]')), ["terms[2]", "motor 2"]),
    (
        "DeviceFileError",
        'name = "p"\ngravity = [0, 0, 0]\nconvention = "placement"\n[[joints]]\nname = "1"\naxis = [0, 0, 0]',
        ["joints[0].axis", "direction"],
    ),
    (
        "DeviceFileError",
        swap('joints = ["1", "2"]', "joints = [1, 2]"),
        ["terms[1].joints[0]", "double quotes"],
    ),
    ("DeviceFileError", swap('joints = "all"', 'joints = "every"'), ["terms[0].joints", "'motorised'"]),
    ("DeviceFileError", swap('name = "2"', "name = 2"), ["joints[1].name", "found 2", "double quotes"]),
    ("DeviceFileError", add("[prior]\nM1 = true"), ["prior.M1", "found True", "number"]),
    ("DeviceFileError", add("[prior]\nM1 = { valeu = 1 }"), ["prior.M1.valeu", 'Did you mean "value"']),
    ("DeviceFileError", swap('["1", "2"]', '["1", "4"]'), ["terms[1].joints[1]", '"4"', "Known: 1, 2, 3"]),
    ("DeviceFileError", swap('"viscous"', '"viscouse"'), ["terms[0].kind", 'Did you mean "viscous"']),
    ("DeviceFileError", swap('"d3"', '"d4"'), ["joints[2].d", '"d4"', "Known: abs", "d3, hypot, pi"]),
    (
        "DeviceFileError",
        add('[[terms]]\nkind = "offset"\nmotors = ["m6"]'),
        ["terms[2].motors[0]", "no motor"],
    ),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nzero = ["MXX1"]'),
        ["symmetry[0].zero[0]", 'Did you mean "'],
    ),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nequal = [["M1", "M9"]]'),
        ["symmetry[0].equal[0][1]", "M9"],
    ),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nidentical = ["1", "9"]'),
        ["symmetry[0].identical[1]"],
    ),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nabout = { link = "9", axis = "x" }'),
        ["symmetry[0].about.link", '"9"'],
    ),
    (
        "DeviceFileError",
        add('[[symmetry]]\nreason = "x"\nmirror = { link = "1", of = "2", axes = ["x", "-x", "z"] }'),
        ["symmetry[0].mirror", "names an axis twice"],
    ),
    ("DeviceFileError", add("[prior]\nFV9 = 1"), ["prior.FV9", 'Did you mean "FV']),
    (
        "DeviceFileError",
        add('[[prior.bodies]]\nlink = "9"\nmass = 1\ncom = [0, 0, 0]'),
        ["prior.bodies[0].link"],
    ),
    ("DeviceFileError", add('[handle]\nlink = "hand"'), ["handle.link", '"hand"']),
    ("DeviceFileError", add('[base_parameters]\nkeep = ["ZZ9"]'), ["base_parameters.keep[0]", "ZZ9"]),
    ("DeviceFileError", add('[[loops]]\nrelations = ["q3 = -q9"]'), ["loops[0].relations[0]", '"q9"']),
    ("DeviceFileError", add('[[loops]]\nrelations = ["q9 = -q1"]'), ["loops[0].relations[0]", '"q9"']),
    (
        "DeviceFileError",
        add('[[loops]]\npassive = ["9"]\ncut = { body_a = "3", body_b = "1" }'),
        ["loops[0].passive[0]"],
    ),
    (
        "DeviceFileError",
        add('[[loops]]\npassive = ["3"]\ncut = { body_a = "9", body_b = "1" }'),
        ["loops[0].cut.body_a"],
    ),
    (
        "DeviceFileError",
        add('[[terms]]\nkind = "custom"\njoints = ["1"]\nname = "C1"\nunit = "N m"\nexpression = "sin(q_9)"'),
        ["terms[2].expression", '"q_9"'],
    ),
    ("DeviceFileError", swap('name = "2"', 'name = "1"'), ["joints[1].name", "joints[0]"]),
    ("DeviceFileError", swap('name = "1"', 'name = "base"'), ["joints[0].name", "the base"]),
    (
        "DeviceFileError",
        add('[[motors]]\nname = "1"\n[[motors]]\nname = "1"'),
        ["motors[1].name", "motors[0]"],
    ),
    ("DeviceFileError", add('[[motors]]\nname = "3"\ndrives = { 1 = 1 }'), ["motors", "joint 3"]),
    ("DeviceFileError", add('[[terms]]\nkind = "viscous"\njoints = ["2"]'), ["FV2"]),
    ("DeviceFileError", swap("d3 = 0.45", "d3 = 0.45\npi = 3"), ["lengths.pi"]),
    ("DeviceFileError", swap("d3 = 0.45", "d3 = 0.45\nq_2 = 3"), ["lengths.q_2", "joint 2"]),
    (
        "DeviceFileError",
        add('[[prior.bodies]]\nlink = "1"\nmass = 1\ncom = [0, 0, 0]\n' * 2),
        ["prior.bodies[1].link"],
    ),
    ("DeviceFileError", swap('name = "2"', 'name = "2"\nparent = "4"'), ["joints[1].parent", '"4"']),
    (
        "DeviceFileError",
        swap('name = "2"', 'name = "2"\nparent = "3"').replace('d = "d3"', 'parent = "1"'),
        ["joints[1].parent", "further down"],
    ),
    ("DeviceFileError", swap('name = "2"', 'name = "2"\nparent = "3"'), ["2 -> 3 -> 2", "[[loops]]"]),
    ("DeviceFileError", swap('name = "1"', 'name = "1"\nparent = "1"'), ["1 -> 1"]),
    ("DeviceFileError", swap('"-pi/2"', '"-pi/2)"'), ["joints[1].alpha", '"-pi/2)"', "not arithmetic"]),
    ("DeviceFileError", swap('"-pi/2"', '"sign(1)"'), ["joints[1].alpha", "sign", "sin"]),
    ("DeviceFileError", swap('"-pi/2"', '"1/0"'), ["joints[1].alpha", "inf"]),
    ("DeviceFileError", swap('"-pi/2"', "-90"), ["joints[1].alpha", "-90", "-1.5708", "degrees"]),
    ("DeviceFileError", add("[base]\nrpy = [180, 0, 0]"), ["base.rpy[0]", "180*pi/180"]),
    (
        "DeviceFileError",
        add('[[loops]]\nrelations = ["q3 = q2/q1"]'),
        ["loops[0].relations[0]", "divides by"],
    ),
    ("DeviceFileError", add('[[loops]]\nrelations = ["q3 + q2 = 0"]'), ["loops[0].relations[0]"]),
    (
        "DeviceFileError",
        add(PASSIVE).replace('d = "d3"', "active = true"),
        ["joints[2].active", '"3"', "passive"],
    ),
    ("DeviceFileError", swap('d = "d3"', "active = false"), ["joints[2].active", "no loop"]),
    (
        "LoopClosureError",
        add('[[loops]]\npassive = ["3"]\ncut = { body_a = "3", frame_a = { d = 0.1 }, body_b = "1" }'),
        ["loops: ", "does not close", " m "],
    ),
    (
        "LoopClosureError",
        'name = "b"\ngravity = [0, 0, 0]\n[[joints]]\nname = "1"\n[[joints]]\nname = "2"\nd = 0.2\n'
        '[[joints]]\nname = "3"\n'
        'd = 0.5\n[[loops]]\npassive = ["2", "3"]\n'
        'cut = { body_a = "3", frame_a = { d = 0.25 }, body_b = "base", frame_b = { d = 0.5 } }',
        ["loops: ", "in 2 assembly modes", "guess"],
    ),
    (
        "SingularityError",
        'name = "b"\ngravity = [0, 0, 0]\n[[joints]]\nname = "1"\n[[joints]]\nname = "2"\nd = 0.2\n'
        '[[joints]]\nname = "3"\nparent = "base"\ntype = "prismatic"\ngamma = "pi/2"\nalpha = "pi/2"\n'
        '[[loops]]\npassive = ["1", "2"]\nat = { 3 = 0.7 }\ncut = { body_a = "2", frame_a = { d = 0.5 }, '
        'body_b = "3", frame_b = { rpy = ["-pi/2", 0, 0] } }',
        ["loops: at the start pose", "3 = 0.7", "limit 0.001"],
    ),
    (
        "DeviceFileError",
        'name = "b"\ngravity = [0, 0, 0]\n[[joints]]\nname = "1"\n[[joints]]\nname = "2"\nd = 0.2\n'
        '[[joints]]\nname = "3"\nparent = "base"\nd = 0.5\n'
        '[[loops]]\npassive = ["2", "3"]\nat = { 1 = 1.5 }\nguess = { 2 = -1.3, 3 = 1.2 }\n'
        'cut = { name = "4", body_a = "2", frame_a = { d = 0.5 }, body_b = "3", frame_b = { d = 0.4 } }',
        ["loops: the cut joint 4 has a name", "(limit 1e-06)", "Remove its name"],
    ),
    (
        "DeviceFileError",
        add('[[loops]]\npassive = ["2", "3"]\ncut = { body_a = "1", body_b = "1" }'),
        ["loops: ", "determine only 0 of 2"],
    ),
    (
        "DeviceFileError",
        add('[[motors]]\nname = "m"\ndrives = { 1 = 0 }'),
        ["motors[0]", "drives no joint"],
    ),
    ("DeviceFileError", add('[[motors]]\nname = "m"'), ["motors[0].name", "no joint", "1, 2, 3"]),
    (
        "DeviceFileError",
        add(PASSIVE + '[[motors]]\nname = "3"\n[transmission]\ntorque_rows = "motor"'),
        ["transmission.torque_rows", "motor 3 drives a passive joint", "leave it out"],
    ),
    (
        "DeviceFileError",
        add(REDUNDANT + '[transmission]\ntorque_rows = "motor"'),
        ["transmission.torque_rows", "4 drives move 3 active joints", "leave it out"],
    ),
    (
        "DeviceFileError",
        add(REDUNDANT + "[transmission]\nweights = { 1 = 1 }"),
        ["transmission.weights", "motor 2 has no"],
    ),
    ("DeviceFileError", add(REDUNDANT + "[transmission]\nweights = { 1 = 0 }"), ["transmission.weights.1", "0"]),
    ("DeviceFileError", add(REDUNDANT + "[transmission]\npreload = { 9 = 1 }"), ["transmission.preload.9", "motor"]),
    (
        "DeviceFileError",
        add('[[motors]]\nname = "a"\ndrives = { 1 = 1, 2 = 1 }\n[[motors]]\nname = "b"\ndrives = { 1 = 2, 2 = 2 }'),
        ["motors: ", "rank 2, rank 3 is required"],
    ),
    (
        "DeviceFileError",
        add('[[motors]]\nname = "a"\ndrives = { 1 = 1, 2 = 1 }'),
        ["motors: ", "1 motor coordinates"],
    ),
    (
        "DeviceFileError",
        add('[targets]\na = "M1*M2"'),
        ["targets.a", '"M1*M2" is not a linear combination', "two unknowns"],
    ),
    ("DeviceFileError", add('[targets]\na = "1/M1"'), ["targets.a", "divides by one"]),
    ("DeviceFileError", add('[targets]\na = "M1 / 0"'), ["targets.a", "division by zero"]),
    ("DeviceFileError", add('[targets]\na = "1e12*1e12*M1"'), ["targets.a", "a factor beyond 1e+12"]),
    ("DeviceFileError", add('[targets]\na = "M1 + d3"'), ["targets.a", "0.45 has no parameter in it"]),
    ("DeviceFileError", add('[targets]\na = "sin(M1)"'), ["targets.a", "`sin(M1)` is not allowed here"]),
    ("DeviceFileError", add('[targets]\na = "ZZ1 + ZZ11"'), ["targets.a", 'Did you mean "ZZ1"']),
    ("DeviceFileError", add('[targets]\na = "M1 - M1"'), ["targets.a", "zero in this device"]),
    ("DeviceFileError", add('[targets]\na = "M1 + ZZ1"'), ["targets.a", "do not have a common unit (kg, kg m^2)"]),
    ("DeviceFileError", add('[targets]\na = { unit = "kg" }'), ["targets.a", "expression"]),
    (
        "DeviceFileError",
        swap("d3 = 0.45", "d3 = 0.45\nM1 = 2") + '\n[targets]\na = "M1"',
        ["lengths.M1", "a standard parameter"],
    ),
    (
        "DeviceFileError",
        swap("d3 = 0.45", "d3 = 0.45\ng = 2") + '\n[targets]\na = "M1"',
        ["lengths.g", "the magnitude of gravity"],
    ),
]


@pytest.mark.parametrize(("kind", "text", "parts"), BROKEN, ids=[f"{k}-{i}" for i, (k, _, _) in enumerate(BROKEN)])
def test_each_cause_has_its_error_and_says_what_to_do(tmp_path: Path, kind: str, text: str, parts: list[str]) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(text)
    with pytest.raises(errors.DeviceError) as caught:
        read_device(path)
    assert type(caught.value).__name__ == kind, str(caught.value)
    sentence = str(caught.value)
    assert sentence.startswith(str(path)), sentence
    for part in parts:
        assert part in sentence
    assert sentence.rstrip().endswith((".", "`")), sentence


def test_the_unbroken_file_reads(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(ARM + BALANCE)
    device = read_device(path)
    assert [joint.name for joint in device.joints] == ["1", "2", "3"]
    assert device.joints[2].position_limits == (-1.0, 2.0)
    assert device.joints[0].position_limits is None
    assert read_device(str(path)).parameters.names == device.parameters.names


def test_files_that_cannot_be_taken_in(tmp_path: Path) -> None:
    with pytest.raises(errors.DeviceFileError, match='Did you mean "staubli_tx40"'):
        read_device("staubli_tx4")
    with pytest.raises(errors.DeviceFileError, match=r"no\.toml: cannot be opened \(No such file"):
        read_device(tmp_path / "no.toml")
    with pytest.raises(errors.DeviceFileError, match="cannot be opened"):
        read_device(tmp_path)
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * (DEFINITION_FILE.value + 1))
    with pytest.raises(errors.DeviceFileError, match="at most 1 MiB are read"):
        read_device(large)
    latin = tmp_path / "latin.toml"
    latin.write_bytes('name = "Stäubli"'.encode("latin-1"))
    with pytest.raises(errors.DeviceFileError, match="byte 10 is not UTF-8"):
        read_device(latin)


def test_reading_gives_frozen_values() -> None:
    device = read_device("phantom_premium_15")
    for array in (device.gravity, device.closure.G, device.coupling, device.rates, device.parameters.S):
        assert not array.flags.writeable
    with pytest.raises(AttributeError):
        device.name = "other"  # type: ignore[misc]


def outcome(path: Path) -> str:
    """What comes of reading: "device", or the sentence of the error; any other exception is a failure."""
    try:
        return type(read_device(path)).__name__.lower()
    except errors.DeviceError as error:
        return str(error)


JUNK = st.sampled_from(
    [
        "nan",
        "-inf",
        '"pi"',
        '"q1"',
        "[]",
        "{}",
        "true",
        "1e300",
        '""',
        '"base"',
        "0",
        "-1",
        '["1", "1"]',
        '"3"',
        "[[1]]",
    ]
)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(["rx90", "staubli_tx40", "phantom_premium_15", "kuka_kr300"]),
    st.integers(0, 10_000),
    JUNK,
)
def test_a_damaged_file_is_a_device_or_one_clear_error(tmp_path: Path, name: str, line: int, junk: str) -> None:
    folder = Path(haptid.device.__file__).parent / "library"
    lines = (folder / f"{name}.toml").read_text().splitlines()
    line %= len(lines)
    lines[line] = re.sub(r"= .*", f"= {junk}", lines[line]) if "= " in lines[line] else ""
    path = tmp_path / "damaged.toml"
    path.write_text("\n".join(lines))
    assert outcome(path) == "device" or outcome(path).startswith(str(path))


def test_the_schema_knows_every_key() -> None:
    schema = device_schema()
    assert len(schema["anyOf"]) == 3
    joint = schema["$defs"]["ModifiedDHJoint"]
    assert set(joint["properties"]) >= {"name", "parent", "alpha", "d", "r", "limits"}
    assert joint["additionalProperties"] is False
    assert "body_b" in schema["$defs"]["CutTable"]["properties"]


def test_shipped_devices_are_listed() -> None:
    assert {"emps", "rx90", "sr400", "puma560", "arm7"} <= set(shipped_devices())
