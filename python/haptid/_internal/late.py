"""`dataclass`: that of the standard library, whose work on a frozen class is done when the class is first used.

The decorator of `dataclasses` writes and compiles the source of up to six methods, half a millisecond for each of the
400 classes that a command loads. It uses half of them, and hardly one of their comparisons and texts.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
from abc import ABCMeta, update_abstractmethods
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, **settings):
        """The decorator of `dataclasses`, with the same settings.

        What it would write into a frozen class is found at the first look: a call, a comparison, `fields`, `replace`,
        `inspect`, or a subclass that is made. The standard decorator then writes it for the class as its body was.
        What that decorator refuses (a mutable default, a frozen subclass of one that is not), it refuses then.

        At once are made the few classes that are not frozen, and those in which its work can be told apart: with slots
        (another class), a metaclass of their own, bases that are told of subclasses, or own methods of the names that
        it writes.
        """
        if cls is None:
            return functools.partial(dataclass, **settings)
        names = _written(**settings)
        apart = "__slots__" in vars(cls) or type(cls) not in (type, ABCMeta)
        told = any("__init_subclass__" in vars(base) for base in cls.__mro__[1:-1])
        if not names or names & vars(cls).keys() or apart or told:
            return dataclasses.dataclass(cls, **settings)
        names |= set() if cls.__doc__ else {"__doc__"}
        body = dict(vars(cls))
        first = _Work(cls, body, names & _FIRST, {**settings, "repr": False, "eq": False})
        other = _Work(cls, body, names - _FIRST, settings)
        for name, value in body.items():
            if isinstance(value, dataclasses.Field):
                _without_field(cls, name, value)
        for work in (first, other):
            for name in work.names:
                setattr(cls, name, _Late(name, work))
        return update_abstractmethods(cls)


# What an object is made with. Texts and comparisons, a third of the work, are written when one of them is used.
_FIRST = {"__dataclass_fields__", "__init__", "__match_args__", "__setattr__", "__delattr__"}


def _written(
    *,
    frozen: bool = False,
    init: bool = True,
    repr: bool = True,
    eq: bool = True,
    match_args: bool = True,
    kw_only: bool = False,  # noqa: ARG001 (writes no other names)
    **others: bool,
) -> set[str]:
    """Names that the standard decorator writes into a frozen class with a docstring; none for other settings."""
    if not frozen or any(others.values()):
        return set()
    names = {"__dataclass_fields__", "__dataclass_params__", "__setattr__", "__delattr__"}
    names |= {"__init__"} if init else set()
    names |= {"__repr__"} if repr else set()
    names |= {"__eq__", "__hash__"} if eq else set()
    names |= {"__match_args__"} if match_args else set()
    return names | ({"__replace__"} if sys.version_info >= (3, 13) else set())


def _without_field(cls: type, name: str, field: dataclasses.Field[Any]) -> None:
    """Leave the default of a field in the class, or nothing, as the decorator does."""
    if field.default is dataclasses.MISSING:
        delattr(cls, name)
    else:
        setattr(cls, name, field.default)


class _Work:
    """What is to be written into a class: under which names, from which body, with which settings."""

    def __init__(self, cls: type, body: dict[str, Any], names: set[str], settings: dict[str, bool]) -> None:
        self.cls, self.body, self.names, self.settings = cls, body, names, settings

    def do(self) -> None:
        """Write each name in place of its late one; what others have put there since stays.

        The decorator works on a copy, for it looks at what a class has: without the late ones the class itself would
        be without methods while other threads use it. Two threads may both do the work; what either writes is right.
        """
        copy: type = type(self.cls)(self.cls.__name__, self.cls.__bases__, {})
        copy.__qualname__ = self.cls.__qualname__
        for name, value in self.body.items():
            if name not in ("__dict__", "__weakref__", "__abstractmethods__", "_abc_impl"):
                setattr(copy, name, value)
        dataclasses.dataclass(**self.settings)(copy)
        for name in [name for name in self.names if isinstance(vars(self.cls).get(name), _Late)]:
            value = vars(copy)[name]
            for function in (value, getattr(value, "__annotate__", None)):
                for cell in getattr(function, "__closure__", None) or ():
                    if cell.cell_contents is copy:  # as in `__setattr__`, which asks whether an object is of this class
                        cell.cell_contents = self.cls
            setattr(self.cls, name, value)


class _Late:
    """One name of a class whose work is not done: a look at it does the work."""

    __slots__ = ("name", "work")

    def __init__(self, name: str, work: _Work) -> None:
        self.name, self.work = name, work

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if vars(self.work.cls).get(self.name) is self:
            self.work.do()
        found = vars(self.work.cls)[self.name]
        return found.__get__(instance, owner) if hasattr(found, "__get__") else found
