"""Values in a TOML text are set or removed; everything else stays, comments and order too."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from haptid._internal.toml_edit import TomlEditError, rewritten, with_value

TEXT = """# A study of ours.
schema = 1
name = "two # links"  # as on the sticker

[channels]  # of the recorder
time = "t"
position = { channels = ["q1", "q2"], unit = "rad" }
torque = { channels = [
  "tau1", # shoulder
  "tau2",
], unit = "N m" }

[[logs]]
path = "a.csv"

[[logs]]
path = "b.csv"
role = "validate" # on Monday

[treatment]
# chosen by hand
decimation = 5
"""
PATHS = [
    ("name",),
    ("schema",),
    ("new",),
    ("channels", "time"),
    ("channels", "position"),
    ("channels", "position", "unit"),
    ("channels", "torque"),
    ("logs", 0, "role"),
    ("logs", 1, "role"),
    ("logs", 1, "path"),
    ("treatment", "decimation"),
    ("treatment", "cutoff_hz"),
    ("estimate", "method"),
]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 5),
    st.floats(-1e6, 1e6),
    st.text(max_size=8),
    st.lists(st.floats(-10, 10), max_size=3),
    st.dictionaries(st.sampled_from(["unit", "side"]), st.text(max_size=4), max_size=2),
)


@settings(max_examples=100, deadline=None)
@example([(("channels", "position"), {}), (("channels", "position", "unit"), {})])
@given(st.lists(st.tuples(st.sampled_from(PATHS), VALUES), min_size=1, max_size=4))
def test_only_this_value_changes(edits):
    text = TEXT
    for path, value in edits:
        before = tomllib.loads(text)
        if not isinstance(before["channels"].get("position", {}), dict) and path[1:2] == ("position",):
            continue
        text = with_value(text, path, value)
        after = tomllib.loads(text)
        for values in (before, after):
            at = values
            for key in path[:-1]:
                at = at.setdefault(key, {}) if isinstance(key, str) else at[key]
            found = at.pop(path[-1], None)
        assert found == value
        assert before == after
        lines = [line for line in TEXT.splitlines() if line.lstrip().startswith("#") or line.startswith("[")]
        assert all(line in text for line in lines)


def test_the_comment_behind_a_value_stays():
    assert '"seven"  # as on the sticker\n' in with_value(TEXT, ("name",), "seven")
    assert 'role = "identify" # on Monday\n' in with_value(TEXT, ("logs", 1, "role"), "identify")
    assert '["q1", "q2"], unit = "deg" }\n' in with_value(TEXT, ("channels", "position", "unit"), "deg")
    assert '  "tau1", # shoulder\n' in with_value(TEXT, ("channels", "torque", "unit"), "A")
    assert with_value(TEXT, ("treatment", "decimation"), 7) == TEXT.replace("decimation = 5", "decimation = 7")


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("treatment = { decimation = 5 }\n", ("treatment", "decimation")),
        ("treatment.decimation = 5\n", ("treatment", "decimation")),
        ("a = 1\n", ("a", "b")),
        ("[[logs]]\n", ("logs", 3, "path")),
        ("a = \n", ("a",)),
        ('a = """\n[b]\nc = 1\n"""\n', ("b", "c")),
    ],
)
def test_other_spellings_are_refused_or_right(text, path):
    try:
        made = with_value(text, path, 2)
    except TomlEditError:
        return
    at = tomllib.loads(made)
    for key in path:
        at = at[key]
    assert at == 2


def test_entries_of_lists_keep_their_comments():
    values = tomllib.loads(TEXT)
    del values["logs"][0]
    values["logs"][0]["exclude"] = [[1.0, 2.0]]
    values["terms"] = [{"kind": "coulomb", "joints": ["a"]}]
    made = rewritten(TEXT, values)
    assert tomllib.loads(made) == values
    assert 'path = "b.csv"\nrole = "validate" # on Monday\nexclude = [[1.0, 2.0]]\n' in made
    assert "a.csv" not in made
    assert '# chosen by hand\ndecimation = 5\n\n[[terms]]\nkind = "coulomb"\njoints = ["a"]\n' in made


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(
        VALUES, lambda inner: st.dictionaries(st.text(min_size=1, max_size=3), inner, max_size=3), max_leaves=8
    )
)
def test_any_values_are_written(value):
    wanted = tomllib.loads(TEXT) | {"channels": value, "logs": [{"a": value}, {"b": 1}], "late": [{"path": value}]}
    assert tomllib.loads(rewritten(TEXT, wanted)) == _present(wanted)


def _present(value):
    if isinstance(value, dict):
        return {key: _present(one) for key, one in value.items() if one is not None}
    return [_present(one) for one in value] if isinstance(value, list) else value
