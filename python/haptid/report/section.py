"""Sections of a page: plain values and charts with one template each."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, Self

from haptid._internal.late import dataclass
from haptid.report.chart import Chart
from haptid.report.source import ReportSource


class PageSection(Protocol):
    """What a page requires of a section: a key that is its anchor, a title, a template and its charts."""

    @property
    def key(self) -> str: ...

    @property
    def title(self) -> str: ...

    @property
    def template(self) -> str: ...

    @property
    def charts(self) -> tuple[Chart, ...]: ...


@dataclass(frozen=True)
class Shown:
    """A section with its own template; its fields are plain values, so that a result folder can store them.

    Attributes:
        key: of the section and of its template, `templates/KEY.html`.
        title: heading.
        charts: in the order of the page.
    """

    key: ClassVar[str]
    title: ClassVar[str]
    charts: tuple[Chart, ...]

    @property
    def template(self) -> str:
        """Name of the template, without its ending."""
        return self.key

    def plain(self) -> dict[str, Any]:
        """The section as JSON values."""
        return dataclasses.asdict(self)

    @classmethod
    def revived(cls, values: Mapping[str, Any]) -> Self:
        """The section from its JSON values."""
        charts = tuple(Chart(**chart) for chart in values["charts"])
        return cls(**{**values, "charts": charts})


class Section(Shown, ABC):
    """A section of the report of one result, made from a `ReportSource`."""

    @classmethod
    @abstractmethod
    def of(cls, source: ReportSource) -> Self | None:
        """The section, or None where it does not apply to the source."""
