"""Dataclasses that are made at their first use: whatever is asked of them first, they answer as standard ones do."""

import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re
import subprocess
import sys
import threading
from types import ModuleType
from typing import Any

import pytest

import haptid
from haptid._internal import late
from haptid.motion.treatment import Treatment

CLASSES = '''
from __future__ import annotations
from abc import ABC, abstractmethod
from collections.abc import Hashable
from copy import copy, deepcopy
from dataclasses import *
from functools import cached_property
from inspect import getmembers, signature
from pydoc import plain, render_doc
from typing import ClassVar, Generic, Protocol, TypeVar
from DECORATOR import dataclass

T = TypeVar("T")
told = []

@dataclass(frozen=True)
class Point:
    """A point."""

    x: float
    y: float = 2.0
    tags: list[str] = field(default_factory=list, compare=False)
    count: ClassVar[int] = 3
    scale: InitVar[float] = 1.0
    _: KW_ONLY
    name: str = field(default="p", metadata={"unit": "m"})

    def __post_init__(self, scale):
        object.__setattr__(self, "x", self.x * scale)

    @cached_property
    def norm(self):
        return (self.x**2 + self.y**2) ** 0.5

@dataclass(frozen=True, eq=False)
class Labelled(Point):
    """A point with a label."""

    label: str = "l"

class Plain(Labelled):
    """A class of its own, which is no dataclass."""

    def __init__(self, x):
        super().__init__(x, name="plain")
        object.__setattr__(self, "__weight", 1)

@dataclass(frozen=True)
class Bare:
    x: float = 0.0

@dataclass(frozen=True, kw_only=True, repr=False, match_args=False)
class Named:
    """A name."""

    name: str
    other: str = ""

@dataclass(frozen=True, init=False)
class Own:
    """A class that says how it is made."""

    x: float

    def __init__(self, text):
        object.__setattr__(self, "x", float(text))

@dataclass(frozen=True)
class Compared:
    """A class that compares itself."""

    x: float

    def __eq__(self, other):
        return True

@lambda cls: (setattr(cls, "__repr__", lambda self: "shown"), setattr(cls, "__hash__", lambda self: 7), cls)[2]
@dataclass(frozen=True)
class Shown:
    """A class of which another decorator replaces what this one writes."""

    x: float = 1.0

def without_text():
    del Bare.__repr__
    return repr(Bare(2.0)), Bare() == Bare()

@dataclass
class Free:
    """Not frozen."""

    x: float = 1.0

@dataclass(frozen=True, order=True)
class Ordered:
    """Ordered."""

    x: float = 1.0

@dataclass(frozen=True, slots=True)
class Slotted:
    """With slots."""

    x: float = 1.0

@dataclass(frozen=True)
class Abstract(ABC):
    """A base."""

    x: float

    @abstractmethod
    def f(self): ...

@dataclass(frozen=True)
class Concrete(Abstract):
    """Of a base."""

    y: float = 1.0

    def f(self):
        return self.x + self.y

@dataclass(frozen=True)
class Halfway(Abstract):
    """Still abstract, but for what the decorator writes."""

    y: float = 1.0

class Textual(ABC):
    """A base that asks for a text."""

    @abstractmethod
    def __repr__(self): ...

@dataclass(frozen=True)
class Text(Textual):
    """Has one."""

    x: float = 1.0

class Meta(type):
    """A metaclass."""

@dataclass(frozen=True)
class Made(metaclass=Meta):
    """By it."""

    x: float = 1.0

@dataclass(frozen=True)
class Box(Generic[T]):
    """A generic class."""

    x: T

class Told:
    """A base that is told of subclasses."""

    def __init_subclass__(cls, **settings):
        told.append(cls.__name__)

@dataclass(frozen=True)
class Below(Told):
    """One of them."""

    x: float = 1.0

class Law(Protocol):
    """A protocol."""

    def f(self) -> float: ...

@dataclass(frozen=True)
class Obeying(Law):
    """Obeys it."""

    x: float = 1.0

    def f(self):
        return self.x

def matched(point):
    match point:
        case Point(x, y):
            return x, y

def without_init(cls):
    made = object.__new__(cls)
    made.__dict__.update(x=1.0, y=2.0, tags=[], name="n", label="l")
    return made

def bad(**settings):
    @dataclass(**settings)
    class Bad(Free):
        """Frozen, of one that is not."""
    return Bad
'''
# Each is the first thing that a program asks.
LOOKS = """
Point(1.0)
Point(1.0, scale=3.0, name="q").norm
Point()
Point(1.0, 2.0, [], 1.0, "p")
repr(Point(1.0))
Point(1.0) == Point(1.0), Point(1.0) == Point(2.0), Point(1.0) == Labelled(1.0), Labelled(1.0) == Labelled(1.0)
hash(Point(1.0)) == hash(Point(1.0)), hash(Bare()) == hash((0.0,))
{Point(1.0), Point(1.0)}
[(f.name, f.type, f.default, f.init, f.compare, f.kw_only, dict(f.metadata)) for f in fields(Point)]
[f.name for f in fields(Labelled)]
sorted(f.name for f in Plain.__dataclass_fields__.values())
is_dataclass(Point), is_dataclass(Plain), is_dataclass(Told)
Point.__match_args__, Labelled.__match_args__, hasattr(Named, "__match_args__")
Point.__dataclass_params__
signature(Point), signature(Labelled), signature(Plain), signature(Own)
signature(Point.__init__).parameters["y"].default
replace(Point(1.0), y=3.0, scale=1.0)
replace(Labelled(1.0, label="b"), y=3.0, scale=1.0)
replace(Point(1.0), z=3.0, scale=1.0)
asdict(Labelled(1.0)), astuple(Labelled(1.0))
without_init(Labelled) == copy(without_init(Labelled)), without_init(Point) == deepcopy(without_init(Point))
repr(without_init(Labelled))
fields(without_init(Labelled))[0].name
replace(without_init(Labelled), x=2.0, scale=1.0)
hash(without_init(Point))
setattr(without_init(Point), "x", 1.0)
setattr(without_init(Point), "z", 1.0)
setattr(Labelled(1.0), "label", 1.0)
setattr(Point(1.0), "z", 1.0)
setattr(Plain(1.0), "x", 1.0)
setattr(Plain(1.0), "z", 1.0)
delattr(without_init(Point), "x")
delattr(Point(1.0), "z")
Plain(1.0).name, Plain(1.0)
matched(Point(1.0)), matched(Labelled(2.0, 3.0)), matched(1.0)
Point.name, Point.y, Point.count, hasattr(Point, "tags"), hasattr(Point, "x"), hasattr(Point, "scale")
Point.tags
Point.__doc__, Bare.__doc__, Bare().__doc__
render_doc(Point, renderer=plain)
render_doc(Labelled, renderer=plain)
[name for name, _ in getmembers(Point)]
Point.__init__.__qualname__, Point.__eq__.__qualname__, Point.__module__, Point.__init__.__annotations__
isinstance(Point(1.0), Hashable), isinstance(Free(), Hashable), issubclass(Named, Hashable)
Named(name="a"), Named("a")
Named(name="a") == Named(name="a")
Own("3"), Own("3") == Own("3")
Compared(1.0) == Compared(2.0), hash(Compared(1.0)) == hash((1.0,))
Shown(), Shown() == Shown(), hash(Shown()), Shown.__dataclass_params__
Shown() == Shown(), hash(Shown()), Shown()
hash(Shown()), Shown(), Shown() == Shown(2.0)
without_text()
Free() == Free(2.0), Free()
hash(Free())
Ordered() < Ordered(2.0)
Point(1.0) < Point(2.0)
Slotted().__slots__, hasattr(Slotted(), "__dict__")
Abstract(1.0)
Concrete(1.0).f(), Concrete(1.0)
Concrete(1.0) == Concrete(1.0), isinstance(Concrete(1.0), Abstract), isinstance(1.0, Concrete)
Halfway(1.0)
Halfway.__abstractmethods__, Text.__abstractmethods__
Text(), setattr(Concrete(1.0), "x", 2.0)
setattr(Concrete(1.0), "z", 2.0)
Made() == Made(), Made()
Box[int](1), Box(1) == Box(1)
told, Below(), told
Obeying(2.0).f()
bad()
bad(frozen=True)()
Point.__mro__, Labelled.__bases__, Point.__subclasses__()
(Labelled(1.0), Labelled.__dataclass_params__, sorted({*vars(Labelled)} - {"__annotations_cache__"}))
(Bare(), Bare.__dataclass_params__, Bare.__doc__, sorted({*vars(Bare)} - {"__annotations_cache__"}))
""".strip().splitlines()


def first_look(look: str, decorator: str) -> str:
    """What a program gets that makes the classes and asks this first; an error as its text."""
    module = ModuleType("classes")
    sys.modules["classes"] = module
    try:
        exec(CLASSES.replace("DECORATOR", decorator), vars(module))
        return re.sub(r"0x[0-9a-f]+", "", repr(eval(look, vars(module))))
    except (TypeError, AttributeError) as error:  # a FrozenInstanceError is one
        return f"{type(error).__name__}: {error}"
    finally:
        del sys.modules["classes"]


@pytest.mark.parametrize("look", LOOKS)
def test_the_first_look_shows_what_the_standard_decorator_writes(look: str) -> None:
    assert first_look(look, late.__name__) == first_look(look, "dataclasses")


def package_classes() -> list[type]:
    """Classes that the modules of the package define."""
    modules = [importlib.import_module(m.name) for m in pkgutil.walk_packages(haptid.__path__, "haptid.")]
    own = [c for m in modules for c in vars(m).values() if isinstance(c, type) and c.__module__ == m.__name__]
    return list(dict.fromkeys(own))


def test_the_standard_decorator_accepts_every_class_of_the_package() -> None:
    """What it refuses, such as a list as a default, would be seen at the first use only."""
    classes = [c for c in package_classes() if dataclasses.is_dataclass(c) and "__dataclass_params__" in vars(c)]
    assert len(classes) > 500
    for cls in classes:
        assert list(inspect.signature(cls).parameters) or not dataclasses.fields(cls), cls
        assert cls.__dataclass_params__, cls
        assert not any(isinstance(value, late._Late) for value in vars(cls).values()), cls


def test_a_value_from_another_process_is_whole() -> None:
    """It is made without a call of its class, which that process has not used before."""
    sent = pickle.dumps(Treatment(cutoff_hz=20.0))
    program = f"""
import pickle, dataclasses
value = pickle.loads({sent!r})
print([f.name for f in dataclasses.fields(value)], value == pickle.loads(pickle.dumps(value)), value)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    value = pickle.loads(sent)
    assert run.stdout == f"{[f.name for f in dataclasses.fields(value)]} True {value}\n"


def test_threads_that_use_a_class_first_all_find_it_whole() -> None:
    """A class without a method for a moment would compare by identity, or let its fields be set."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    wrong: list[Any] = []
    try:
        for _ in range(30):

            @late.dataclass(frozen=True)
            class Point:
                """A point."""

                x: float
                y: float = 2.0

            start = threading.Barrier(6)

            def use(cls: Any = Point, start: threading.Barrier = start) -> None:
                start.wait()
                try:
                    one, other = cls(1.0), cls(1.0)
                    assert one == other
                    assert hash(one) == hash(other)
                    assert [f.name for f in dataclasses.fields(cls)] == ["x", "y"]
                    with pytest.raises(dataclasses.FrozenInstanceError):
                        one.x = 2.0
                    assert repr(one).endswith("Point(x=1.0, y=2.0)")
                except BaseException as error:
                    wrong.append(error)

            threads = [threading.Thread(target=use) for _ in range(6)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not wrong
