"""Tables written as TOML are read back as they were, whatever is in their texts."""

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from haptid._internal.toml_text import toml

# Lone surrogates are in no UTF-8 file.
TEXTS = st.text(st.characters(exclude_categories=("Cs",)), max_size=12)
VALUES = st.one_of(TEXTS, st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), st.lists(TEXTS))
KEYS = st.sampled_from(["a", "b", "c_d"])


@given(st.dictionaries(KEYS, VALUES))
def test_values_are_read_back(table):
    assert tomllib.loads(toml(table)) == table


def test_nested_tables_are_read_back():
    table = {"name": 'a "b"\n\x1b[2J\x7f\\', "head": {"k": 1, "in": {"x": [1.5, 2.0]}}, "each": [{"n": 1}, {"n": 2}]}
    assert tomllib.loads(toml(table)) == table
