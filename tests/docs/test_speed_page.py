"""The page on speed has the tables of the records, and states of each ratio whether its target is reached."""

import re
from pathlib import Path

import speed_report

PROJECT = Path(__file__).resolve().parents[2]
MADE_UP = {
    "kernel": {
        "regressor in cache: haptid, us": 0.1,
        "regressor in cache: Pinocchio C++, us": 1.9,
        "regressor in cache: Pinocchio C++ over haptid": 19.0,
        "regressor in cache: CasADi C, us": 0.4,
        "regressor in cache: CasADi C over haptid": 4.0,
        "multiply-add peak, GF/s": 50.0,
        "memory fill, GB/s": 10.0,
        "regressor, stored: bytes per sample": 1520.0,
        "regressor, stored: GB/s": 5.0,
        "regressor, stored: share of memory fill, %": 50.0,
    },
    "file-to-result": {
        "400000 samples: haptid, s": 1.0,
        "400000 samples: haptid, peak memory, GiB": 0.4,
        "400000 samples: haptid, error of torque, %": 0.003,
        "400000 samples: figaroh's functions, s": 38.0,
        "400000 samples: figaroh's functions over haptid": 38.0,
    },
    "start-up": {"haptid --help, s": 0.2, "python without any import, s": 0.05},
}


def test_every_part_has_its_place_on_the_page():
    page = (PROJECT / "docs/speed.md").read_text(encoding="utf-8")
    assert re.findall(r"<!-- (.*) -->", page) == [*speed_report.PARTS, "Left out"]


def test_ratios_are_compared_with_their_targets():
    text = speed_report.table(MADE_UP)
    assert "| regressor in cache | 0.1 | Pinocchio C++ | 1.9 | 19 | 20, not reached |" in text
    assert "| regressor in cache | 0.1 | CasADi C | 0.4 | 4.0 | 3.5, reached |" in text
    assert "| 400000 samples | 1 | figaroh's functions | 38 | 38 | 10, reached |" in text
    assert "| 400000 samples | haptid | 1 | 0.40 | 0.003 |" in text
    assert "| `haptid --help` | 0.20 | below 0.3, reached |" in text


def test_ratios_with_a_narrower_back_end_stand_beside():
    figures = MADE_UP["kernel"] | {f"regressor in cache: Pinocchio C++ over haptid, {speed_report.NARROWER}": 12.0}
    lines = speed_report.compared(figures).splitlines()
    assert lines[0] == "| task | haptid | peer | its time | ratio | ratio, AVX2 | target |"
    assert lines[2:] == [
        "| regressor in cache | 0.1 | Pinocchio C++ | 1.9 | 19 | 12 | 20, not reached |",
        "| regressor in cache | 0.1 | CasADi C | 0.4 | 4.0 |  | 3.5, reached |",
    ]


def test_peers_without_a_figure_are_named():
    assert "Left out\n\nPinocchio Python, iDynTree, MuJoCo" in speed_report.table(MADE_UP)
