"""Whole numbers of unchecked texts: thousands of digits, and superscripts, are no numbers to any reader."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from haptid._internal.numerals import whole_number
from haptid.errors import HaptidError, LogFileError, RobotFileError
from haptid.log import read_log
from haptid.robot_files import import_robot

# More digits than `int` takes.
LONG = "1" * 5000
MJCF = """<mujoco><worldbody><replicate count="{count}"><body><joint type="hinge"/><geom size="1"/></body></replicate>
</worldbody></mujoco>"""
DH = "# convention: craig\nname,alpha_deg,a,theta_deg,d\n1,0,0,0,0\n2,-90,0,0,0.1\n3,0,0.43,0,0.15\n"


@pytest.mark.parametrize(("text", "number"), [("12", 12), (" 007\n", 7), ("²", None), (LONG, None), ("-1", None)])
def test_whole_numbers(text: str, number: int | None) -> None:
    assert whole_number(text) == number
    assert whole_number("1234", digits=3) is None


def test_a_numbered_channel_of_thousands_of_digits_is_no_position(tmp_path: Path) -> None:
    """Found by fuzzing."""
    log = tmp_path / "log.json"
    log.write_text(json.dumps([{"t": 0.01 * k, f"q{LONG}": 1.0 * k, "tau1": 2.0 * k} for k in range(9)]))
    with pytest.raises(HaptidError, match="no position channels found by name"):
        read_log(log)


@pytest.mark.parametrize("count", ["²", LONG])
def test_copies_of_mjcf_that_are_no_number(tmp_path: Path, count: str) -> None:
    robot = tmp_path / "robot.xml"
    robot.write_text(MJCF.format(count=count))
    with pytest.raises(RobotFileError, match="copies"):
        import_robot(robot)


@pytest.mark.parametrize("entry", ["NF = ²", f"NF = {LONG}", "Ant = {²}"])
def test_a_count_of_symoro_that_is_no_number(tmp_path: Path, entry: str) -> None:
    robot = tmp_path / "robot.par"
    text = "(* Robotname = 'one' *)\nNL = 1\nNJ = 1\nNF = 1\nType = 0\nAnt = {0}\nSigma = {0}\n"
    key = entry.partition(" ")[0]
    robot.write_text("".join(entry + "\n" if line.startswith(key + " ") else line for line in text.splitlines(True)))
    with pytest.raises(RobotFileError, match=r"whole number NF|antecedent"):
        import_robot(robot)


@pytest.mark.parametrize("text", [DH.replace("0.15\n", '"'), DH.replace("0.15\n", '"\n4,0,0,0,0\n5,0,0,0,"\n')])
def test_an_open_quote_in_a_dh_table_is_refused(tmp_path: Path, text: str) -> None:
    """Found by fuzzing: a cell that went on in the next line left fewer rows than lines."""
    table = tmp_path / "arm.csv"
    table.write_text(text)
    with pytest.raises(RobotFileError, match="quotes"):
        import_robot(table)


def test_the_newest_model_of_a_folder_has_a_version_of_digits(tmp_path: Path) -> None:
    folder = tmp_path / "models" / "arm"
    folder.mkdir(parents=True)
    (folder / "model.config").write_text(
        f'<model><sdf version="1.²">a.sdf</sdf><sdf version="1.{LONG}">b.sdf</sdf></model>', encoding="utf-8"
    )
    (folder / "a.sdf").write_text('<sdf version="1.7"><model name="arm"/></sdf>')
    (folder / "b.sdf").write_text('<sdf version="1.7"><model name="arm"/></sdf>')
    world = tmp_path / "robot.sdf"
    world.write_text('<sdf version="1.7"><world name="w"><include><uri>models/arm</uri></include></world></sdf>')
    with pytest.raises((RobotFileError, LogFileError)):
        import_robot(world)
