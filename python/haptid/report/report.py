"""The report of an identification: made, stored in a result folder, read again, written as an HTML page."""

from __future__ import annotations

import gzip
import io
import json
import zlib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType

from jinja2 import TemplateError

from haptid._core import __version__
from haptid._internal.atomic_folder import publishing, verified, write_file
from haptid._internal.bounded_files import REPORT_DATA, RESULT_FILE, read_at_most, read_bounded
from haptid._internal.late import dataclass
from haptid.errors import ResultFileError
from haptid.report.page import page
from haptid.report.section import Section
from haptid.report.sections import SECTIONS
from haptid.report.source import HandForceData, ReportSource
from haptid.results.tables import finite
from haptid.study.identify import Identification

_SCHEMA = 2
# Not gzip, not JSON, not these sections, or values of other types in them.
_DAMAGED = (
    OSError,
    EOFError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RecursionError,
    zlib.error,
    TemplateError,
)
# Files of a report in a result folder: its data and its page.
DATA, PAGE = "report-data.json.gz", "report.html"


@dataclass(frozen=True, eq=False)
class Report:
    """Content of a report page.

    Attributes:
        name: of the study.
        model: name of the device.
        made: when, as a date and time in UTC.
        haptid: version of haptid.
        sections: by key, in the order of the page.
    """

    name: str
    model: str
    made: str
    haptid: str
    sections: Mapping[str, Section]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sections", MappingProxyType(dict(self.sections)))

    def html(self) -> str:
        """The self-contained page."""
        return page(self.name, f"{self.model}, {self.made}, haptid {self.haptid}", tuple(self.sections.values()))

    def write_page(self, path: Path) -> None:
        """Write the page.

        Raises:
            OutputFolderError: it cannot be written there.
        """
        write_file(path, self.html())

    def write(self, folder: str | Path) -> None:
        """Write the page and its data into a folder, both or none.

        Raises:
            OutputFolderError: the folder cannot be written.
        """
        with publishing(Path(folder)) as scratch:
            self.write_into(scratch)

    def write_into(self, folder: Path) -> None:
        """Write both files into a folder that a caller publishes."""
        (folder / PAGE).write_text(self.html(), encoding="utf-8", errors="backslashreplace")
        plain = {key: section.plain() for key, section in self.sections.items()}
        head = {"schema": _SCHEMA, "haptid": self.haptid, "name": self.name, "device": self.model, "made": self.made}
        text = json.dumps(finite({**head, "sections": plain}), allow_nan=False, separators=(",", ":"))
        (folder / DATA).write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))


def make_report(
    identification: Identification,
    *,
    command: str = "",
    hands: Sequence[HandForceData] = (),
    made: datetime | None = None,
) -> Report:
    """The report of an identification.

    Args:
        identification: result of `haptid.identify`.
        command: the command line that made it.
        hands: estimated hand forces.
        made: when; now where None.
    """
    return report_of(ReportSource(identification, command, tuple(hands)), made)


def report_of(source: ReportSource, made: datetime | None = None) -> Report:
    """The report of a source, which may have results computed already."""
    sections = [kind.of(source) for kind in SECTIONS]
    moment = (made or datetime.now(UTC)).astimezone(UTC)
    return Report(
        name=source.identification.study.name,
        model=source.identification.model.device.name,
        made=f"{moment:%Y-%m-%d %H:%M} UTC",
        haptid=__version__,
        sections={section.key: section for section in sections if section is not None},
    )


def _unreadable(path: Path, reason: str) -> ResultFileError:
    """The error for a result folder whose report data cannot be read."""
    advice = "Give the output folder of `haptid identify`, or run it again with this version of haptid."
    return ResultFileError(f"{path}: {reason}.", where=str(path), found=reason, advice=advice)


def read_report(folder: str | Path) -> Report:
    """The report in a result folder.

    Raises:
        ResultFileError: the folder has none, or one of another version.
    """
    path = Path(folder) / DATA
    try:
        packed = io.BytesIO(verified(path, read_bounded(path, RESULT_FILE)))
        with gzip.open(packed) as file:
            data = json.loads(read_at_most(file.read, path, REPORT_DATA))
        if data["schema"] != _SCHEMA:
            raise _unreadable(path, f"its schema is {data['schema']}, and {_SCHEMA} is read")
        kinds = {kind.key: kind for kind in SECTIONS}
        sections = {key: kinds[key].revived(values) for key, values in data["sections"].items()}
        report = Report(data["name"], data["device"], data["made"], data["haptid"], sections)
        report.html()  # every value is of a kind that the page can show
    except FileNotFoundError as error:
        raise _unreadable(path, "there is no such file") from error
    except _DAMAGED as error:
        raise _unreadable(path, f"these are not the data of a report: {error}") from error
    return report
