"""Traces of controllers: TwinCAT Scope and CODESYS, written after their documented layouts."""

from __future__ import annotations

import numpy as np
import pytest

from haptid import errors
from haptid.log import Channels, Signal, read_log
from haptid.log.formats.controller_trace import columns
from haptid.log.request import Request
from haptid.log.survey import survey

T = np.arange(400) * 2.0
Q = 30 * np.sin(T / 60)
TAU = np.cos(T / 60)
CHANNELS = Channels(Signal(("Axis1.ActPos",), "deg"), Signal(("Axis1.ActTorque",), "N m"), time="time", time_unit="ms")


def scope(separator: str, decimal: str = ".", late: int = 0, end: str = "") -> str:
    """TwinCAT Scope with a group for each channel; `late`: samples by which the second group starts later."""
    labels = {
        "Name": ("Axis1.ActPos", "Axis1.ActTorque"),
        "SymbolComment": ("", ""),
        "Data-Type": ("REAL64", "REAL64"),
        "SampleTime[ms]": ("2", "2"),
        "SymbolBased": ("True", "True"),
        "NetID": ("5.62.1.1.1.1", "5.62.1.1.1.1"),
        "Unit": ("° (Angle)", "Nm (Torque)"),
    }
    lines = [f"Name{separator}run{separator}", f"File{separator}C:\\run.csv{separator}", ""]
    lines += [f"Starttime of export{separator}132959733843760000{separator}Monday", "", ""]
    lines += [separator.join(cell for value in values for cell in (key, value)) for key, values in labels.items()] + [
        ""
    ]
    for k in range(T.size):
        own = (T[k], Q[k], *((T[k + late], TAU[k + late]) if k + late < T.size else (" ", " ")))
        lines.append(separator.join(str(v).replace(".", decimal) for v in own))
    return "\n".join(lines) + "\n" + end


def codesys(flags: int, unit: float) -> str:
    text = f"[key]; [value]\nVersion; 0x03050000\nName; Application.Trace\nEveryNCycles; 1\nFlags; {flags}\n"
    for k, (name, values) in enumerate((("Axis1.ActPos", Q), ("Axis1.ActTorque", TAU))):
        text += f"{k}.Variable; {name}\n{k}.Class; 14\n{k}.Data; \n"
        text += "".join(f"; {t * unit:.0f}; {v}\n" for t, v in zip(T, values, strict=True))
    return text


def codesys_xml() -> str:
    both = "".join(
        f'<TraceVariable VarName="{name}" Type="System.Double"><Values>{",".join(map(str, values))}</Values>'
        f"<Timestamps>{','.join(f'{t:.0f}' for t in T)}</Timestamps></TraceVariable>"
        for name, values in (("Axis1.ActPos", Q), ("Axis1.ActTorque", TAU))
    )
    settings = '<Single Name="MicroSeconds" Type="bool">False</Single>'
    return f'<?xml version="1.0"?><Trace>{settings}<TraceData><TraceRecord>{both}</TraceRecord></TraceData></Trace>'


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("tabs.csv", scope("\t").encode()),
        ("decimal-commas.txt", scope("\t", ",").encode()),
        ("semicolons.csv", scope(";", ",", end="EOF").encode()),
        ("utf-16.txt", scope("\t").encode("utf-16")),
        ("trace.csv", codesys(16, 1.0).encode()),
        ("utf-16.csv", codesys(16, 1.0).encode("utf-16")),
        ("run.trace", b"\xff\xfe" + codesys_xml().encode("utf-16-le")),
        ("run.xml", codesys_xml().encode()),
    ],
)
def test_every_layout_gives_the_samples_that_were_written(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    log = read_log(path, CHANNELS)
    assert np.allclose(log.t, T * 1e-3, atol=1e-9)
    assert np.allclose(np.rad2deg(log.position[:, 0]), Q, atol=1e-9)
    assert np.array_equal(log.torque[:, 0], TAU)
    table = survey(path).table
    assert 'time = "time"\ntime_unit = "ms"' in table
    assert "Axis1.ActPos" in table
    assert "Axis1.ActTorque" in table


def test_stated_units_and_how_fine_the_times_are(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(scope("\t"), encoding="utf-8")
    found = {channel.name: channel.unit for channel in survey(path).topics[0].channels}
    assert found == {"time": "ms", "Axis1.ActPos": "deg", "Axis1.ActTorque": "N m"}
    path.write_text(codesys(32, 1000.0))
    assert survey(path).topics[0].channels[0].unit == "us"


def test_groups_with_times_of_their_own_are_joined_by_them(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(scope("\t", late=3), encoding="utf-8")
    log = read_log(path, CHANNELS)
    assert any("2 groups of variables have times of their own" in note for note in log.notes)
    assert np.allclose(log.torque[:, 0], TAU[3:], atol=1e-12)
    assert np.allclose(np.rad2deg(log.position[:, 0]), Q[3:], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.xml", "<?xml version='1.0'?><robot/>", "is not a trace"),
        ("a.trace", "<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><Trace>&b;</Trace>", "DTD"),
        ("a.trace", "<?xml version='1.0'?><Trace><TraceConfiguration/></Trace>", "without samples"),
        ("a.csv", scope(" ").replace("Axis1.ActPos", "Axis 1 ActPos"), "names have blanks"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, name, text, said):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(errors.LogFileError, match=said):
        survey(tmp_path / name)


def test_a_table_in_which_no_column_is_one_of_numbers_is_not_called_damaged(tmp_path):
    rows = "".join(f"{k},a\nb,{k}\n" for k in range(200))
    (tmp_path / "a.csv").write_text("x,y\n" + rows)
    with pytest.raises(errors.LogFileError, match="none of its columns is one of numbers"):
        survey(tmp_path / "a.csv")


def test_times_that_step_back_keep_the_order_of_the_file(tmp_path):
    """The controller's clock was set: samples stay where they were recorded, and the step is refused by its time."""
    (tmp_path / "t.csv").write_text(codesys(16, 1.0).replace("; 798; ", "; 1; "))
    assert survey(tmp_path / "t.csv")
    with pytest.raises(errors.LogTimeError, match="decreases at sample 399"):
        read_log(tmp_path / "t.csv", CHANNELS)
    table = columns(tmp_path / "t.csv", ["Axis1.ActPos"], Request())
    np.testing.assert_array_equal(table["Axis1.ActPos"], Q)
