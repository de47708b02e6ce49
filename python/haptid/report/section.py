"""A section of a page: plain values and charts, shown by one template; of the report, made from one source."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

from haptid.report.chart import Chart
from haptid.report.source import Source


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
    """What every section of a page has. Fields are plain values, so that a folder of results can hold them.

    Attributes:
        key: of the section and of its template, `templates/KEY.html`.
        title: above it.
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
        """The same as values that JSON can say."""
        return dataclasses.asdict(self)

    @classmethod
    def revived(cls, values: Mapping[str, Any]) -> Self:
        """From what `plain` gave."""
        charts = tuple(Chart(**chart) for chart in values["charts"])
        return cls(**{**values, "charts": charts})


class Section(Shown, ABC):
    """A section of the report of one result."""

    @classmethod
    @abstractmethod
    def of(cls, source: Source) -> Self | None:
        """The section, or None where the source has nothing for it."""
