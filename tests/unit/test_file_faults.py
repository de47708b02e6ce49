"""What is wrong with a study or an experiment file: where, what was found, what may stand there; never a crash."""

import copy
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import haptid
from haptid import errors
from haptid._internal.bounded_files import DEFINITION_FILE
from haptid._internal.toml_tables import Fault
from haptid.device.toml.schema import ModifiedDHDevice
from haptid.experiment import bench
from haptid.experiment.bench.experiment import ExperimentTable
from haptid.study.schema import StudyTable
from small_study import DEVICE, STUDY

EXPERIMENT = """
schema = 1
name = "to and fro"
[trajectory]
kind = "multisine"
seconds = 1.0
centre = 0.1
amplitude = 0.2
[controller]
kp = 40.0
kd = 0.5
[[hand]]
force = [0.0, 0.0, 1.0]
"""
WRONG_STUDIES = [
    ("cutoff_hz = 30", "cutoff = 30", "key `treatment.cutoff`", '(found 30). Did you mean "cutoff_hz"? Keys here: cut'),
    ('path = "log.csv"', 'pth = "log.csv"', "key `logs.0.pth`", 'Did you mean "path"? Keys here: path, role'),
    ("[treatment]", "[estimate.bounds.FC1]\nloww = 1\n[treatment]", "key `estimate.bounds.FC1.loww`", "low, high."),
    (
        "[treatment]",
        "[estimate.equality_constraints]\na = 'b'\n[treatment]",
        "key `estimate.equality_constraints.a`",
        "equality_constraints is",
    ),
    (
        "[treatment]",
        "[estimate]\nconstraints = 'yes'\n[treatment]",
        "key `estimate.constraints`",
        "Input should be 'physical'",
    ),
    ('path = "log.csv"', "path = 3", "key `logs.0.path`", "Write a text in double quotes"),
    ("cutoff_hz = 30", "order = 13", "key `treatment.order`", "12 (found 13); order is order of one pass"),
    ("schema = 1", "", "key `schema`", "this key is missing; schema is version of this format"),
    ("schema = 1", "schema = ", "line 2, column 10", "not TOML: Invalid value, in `schema =`"),
    ("schema = 1", "a = " + 3000 * "[", "not TOML", "recursion"),
    ("schema = 1", "#" + DEFINITION_FILE.value * " " + "\nschema = 1", "1 MiB", "DEFINITION_FILE"),
]
WRONG_EXPERIMENTS = [
    ("kp = 40.0", "kq = 40.0", "key `controller.kq`", "Keys here: kp, kd, ki"),
    ("centre = 0.1", "center = 0.1", "key `trajectory.center`", 'Did you mean "centre"? Keys here: amplitude'),
    ("centre = 0.1", "centre = 0.1\ncount = 'a'", "key `trajectory.count`", "count is number of sines per joint"),
    ('"multisine"', '"sine"', "key `trajectory.kind`", """no kind 'sine'; write one of "multisine", "triangles","""),
    ("force = [0.0, 0.0, 1.0]", "force = [0.0]", "key `hand.0.force`", "force is in the base frame, N"),
    ("schema = 1", "schema = ", "line 2, column 10", "`haptid schema experiment` prints every key"),
]


@pytest.mark.parametrize(("old", "new", "where", "what"), WRONG_STUDIES)
def test_a_study_says_where_and_what(tmp_path, old, new, where, what):
    check(haptid.read_study, errors.StudyFileError, tmp_path / "study.toml", STUDY, (old, new, where, what))


@pytest.mark.parametrize(("old", "new", "where", "what"), WRONG_EXPERIMENTS)
def test_an_experiment_says_where_and_what(tmp_path, old, new, where, what):
    check(bench.read_experiment, errors.ExperimentFileError, tmp_path / "e.toml", EXPERIMENT, (old, new, where, what))


def check(read, kind, path, text, wrong):
    old, new, where, what = wrong
    assert old in text
    path.write_text(text)
    read(path)
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(kind) as caught:
        read(path)
    assert where in str(caught.value)
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("read", "kind", "noun"),
    [
        (haptid.read_study, errors.StudyFileError, "a study"),
        (bench.read_experiment, errors.ExperimentFileError, "an experiment"),
    ],
)
def test_what_cannot_be_opened(tmp_path, read, kind, noun):
    with pytest.raises(kind, match=f"no such file; give the path of the TOML file of {noun}"):
        read(tmp_path / "absent.toml")
    with pytest.raises(kind, match="cannot be opened"):
        read(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(kind, match="byte 5 is not UTF-8"):
        read(tmp_path / "latin.toml")


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 9),
    st.floats(),
    st.sampled_from(["a", "all", "multisine", "triangles", "custom", "", "0.1"]),
    st.just([]),
    st.just({}),
    st.lists(st.one_of(st.integers(), st.just({}), st.just("a")), max_size=3),
    st.dictionaries(st.sampled_from(["a", "kind", "start", "low", "d", "value"]), st.integers(), max_size=3),
)


@pytest.mark.parametrize(
    ("model", "text"), [(StudyTable, STUDY), (ExperimentTable, EXPERIMENT), (ModifiedDHDevice, DEVICE)]
)
@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_a_fault_names_its_place(model, text, data):
    """A fault's steps lead to something in the data, or to one key that it lacks."""
    tables = copy.deepcopy(tomllib.loads(text))
    here = tables
    while isinstance(here, dict | list) and here:
        key = data.draw(st.sampled_from(sorted(here) if isinstance(here, dict) else range(len(here))))
        if not isinstance(here[key], dict | list) or not here[key] or data.draw(st.booleans()):
            here[data.draw(st.sampled_from([key, "else"])) if isinstance(here, dict) else key] = data.draw(JUNK)
            break
        here = here[key]
    try:
        model.model_validate(tables)
    except ValidationError as error:
        fault = Fault.of(error, model, tables)
        lacks = fault.kind == "missing" or bool(fault.kinds)
        found = tables
        for step in fault.steps[:-1] if lacks else fault.steps:
            found = found[step]
        assert not lacks or fault.steps[-1] not in found or fault.steps[-1] == "kind"
        assert fault.sentence
