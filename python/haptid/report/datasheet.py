"""Data sheets as pages: HTML for the screen and for paper, one PDF page of a device, and a comparison of several."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from haptid._core import __version__
from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files, write_file
from haptid._internal.extras import needing
from haptid.end_effector.datasheet import DataSheet, SheetRow
from haptid.experiment.bench.picture import BAR, stick_figure
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable
from haptid.report.page import page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Views of the workspace: horizontal and vertical axis.
_VIEWS = ((0, 2), (1, 2), (0, 1))
# Size of a page (A4), inches; height of a line and left ends of columns, shares of the page; size of letters, points,
# and how many go on the width of a page.
_PAGE, _LINE, _SIZE, _LETTERS = (8.27, 11.69), 0.0145, 6.4, 182
_COLUMNS, _LEFT, _RIGHT = (0.06, 0.29, 0.385, 0.505, 0.61), 0.06, 0.97


def sheet_page(sheets: Sequence[DataSheet]) -> str:
    """One HTML document: a chapter for each device, and a comparison where there are several."""
    sections = [_section(sheet, k) for k, sheet in enumerate(sheets)]
    if len(sheets) > 1:
        cells = comparison(sheets)
        text = ("Values are medians over each workspace; see each sheet for range, interval and method.",)
        sections.insert(0, DocumentSection("comparison", "Comparison", text, (TextTable("", cells),)))
    title = "Data sheet: " + ", ".join(sheet.model.device.name for sheet in sheets)
    return page(title, f"haptid {__version__}", sections)


def write_sheet(sheets: Sequence[DataSheet], path: Path) -> None:
    """Write data sheets as .html, or as .pdf with one page for each device.

    Raises:
        OutputFolderError: the file cannot be written.
    """
    if path.suffix == ".pdf":
        with publishing_files(path) as scratch:
            (scratch / path.resolve().name).write_bytes(_pdf(sheets))
    else:
        write_file(path, sheet_page(sheets))


def comparison(sheets: Sequence[DataSheet]) -> list[list[str]]:
    """One row for each figure that a sheet has, one column for each device; what makers and papers publish below."""
    cells = [["", *(sheet.model.device.name for sheet in sheets)]]
    for group, name in dict.fromkeys((row.group, row.name) for sheet in sheets for row in sheet.rows):
        rows = [next((row for row in sheet.rows if (row.group, row.name) == (group, name)), None) for sheet in sheets]
        if any(row is not None and row.value is not None for row in rows):
            cells.append([name, *(_value(row) if row else "" for row in rows)])
    for name in dict.fromkeys(name for sheet in sheets for name, _, _ in sheet.published):
        cells.append([f"{name}, published", *(next((v for n, v, _ in s.published if n == name), "") for s in sheets)])
    return cells


def sheet_cells(sheet: DataSheet) -> list[list[str]]:
    """All computed figures as a table; its first row is the headings, and rows with a name alone begin a group."""
    cells, group = [["", "median", "range", "95 % interval", "method"]], ""
    for row in sheet.rows:
        if row.group != group:
            group = row.group
            cells.append([group.upper(), "", "", "", ""])
        low_high = "" if row.low is None or row.high is None else f"{_digits(row.low)} .. {_digits(row.high)}"
        ends = "" if row.conf_int is None else " .. ".join(map(_digits, row.conf_int))
        cells.append([row.name, _value(row), low_high, ends, row.method])
    return cells


def published_cells(sheet: DataSheet) -> list[list[str]]:
    """Figures that makers and papers publish, as a table."""
    return [["published", "value", "source"], *(list(row) for row in sheet.published)]


def _value(row: SheetRow) -> str:
    return "not known" if row.value is None else f"{_digits(row.value)} {row.unit}".strip()


def _digits(value: float) -> str:
    """A figure of three digits, without an exponent up to a million: 2780 is narrower than 2.78e+03."""
    return f"{float(f'{value:.3g}'):g}"


def _section(sheet: DataSheet, k: int) -> DocumentSection:
    device = sheet.model.device
    text = (device.description or device.name, f"Source of the geometry: {device.source or 'not stated'}.")
    tables = [TextTable("", sheet_cells(sheet))]
    if sheet.published:
        tables.append(TextTable("", published_cells(sheet)))
    charts = tuple(_workspace(sheet, f"sheet-{k}", view) for view in _VIEWS)
    return DocumentSection(f"sheet-{k}", device.name, text, tuple(tables), charts)


def _bars(sheet: DataSheet) -> Array:
    """Bars of the mechanism at the middle pose, (bars, 2, 3), m."""
    bars: Array = stick_figure(sheet.model, sheet.poses[:, [sheet.middle]].T)[0][0]
    return bars


def _workspace(sheet: DataSheet, key: str, view: tuple[int, int]) -> Chart:
    """Positions of the handle, and the mechanism at the middle pose."""
    a, b = view
    x, y = sheet.positions[:, a], sheet.positions[:, b]
    curves = [chart_series("handle", "points", "sky", x=packed(x), y=packed(y))]
    # One line, interrupted between the bars.
    ends = _bars(sheet)[:, [0, 1, 1]][:, :, [a, b]]
    ends[:, 2, 1] = np.nan
    ends = ends.reshape(-1, 2)
    curves.append(chart_series("mechanism", "path", "blue", x=packed(ends[:, 0]), y=packed(ends[:, 1])))
    letters = "xyz"[a], "xyz"[b]
    drawing = plot(axis(letters[0], "m"), axis(letters[1], "m"), curves, height=300, equal=True)
    caption = f"{np.ptp(x):.3g} m along {letters[0]}, {np.ptp(y):.3g} m along {letters[1]}."
    alt = f"Positions of the handle in {letters[0]} and {letters[1]}, and the mechanism in the middle."
    return Chart(f"{key}-{''.join(letters)}", f"Workspace, {letters[0]} and {letters[1]}", alt, caption, drawing)


def _pdf(sheets: Sequence[DataSheet]) -> bytes:
    """One page of A4 for each device: pictures of the workspace above its tables."""
    with needing("a PDF"):
        from matplotlib.backends.backend_pdf import PdfPages
    buffer = io.BytesIO()
    with PdfPages(buffer, metadata={"CreationDate": None}) as pages:
        for sheet in sheets:
            pages.savefig(sheet_figure(sheet))
    return buffer.getvalue()


def sheet_figure(sheet: DataSheet) -> Figure:
    """The page of a device as a figure."""
    with needing("a data sheet"):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=_PAGE)
    FigureCanvasAgg(figure)
    figure.text(_LEFT, 0.965, sheet.model.device.name, fontsize=15, weight="bold", parse_math=False)
    figure.text(_LEFT, 0.95, sheet.model.device.description, fontsize=7.5, parse_math=False)
    bars = _bars(sheet)
    for k, (a, b) in enumerate(_VIEWS):
        panel = figure.add_axes((0.09 + 0.31 * k, 0.775, 0.24, 0.155))
        panel.plot(sheet.positions[:, a], sheet.positions[:, b], ".", color="0.8", markersize=1)
        for bar in bars:
            panel.plot(bar[:, a], bar[:, b], color=BAR, linewidth=1.2)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_xlabel(f"{'xyz'[a]}, m", fontsize=6, labelpad=1)
        panel.set_ylabel(f"{'xyz'[b]}, m", fontsize=6, labelpad=1)
        panel.tick_params(labelsize=6)
    _write_lines(figure, sheet)
    return figure


def _write_lines(figure: Figure, sheet: DataSheet) -> None:
    """The tables as lines of text, as small as they have to be."""
    wide, narrow = sheet_cells(sheet), published_cells(sheet) if sheet.published else []
    lines = [(_COLUMNS, cells) for cells in wide] + [((_COLUMNS[0], _COLUMNS[1], _COLUMNS[3]), c) for c in narrow]
    height = min(_LINE, 0.7 / len(lines))
    for k, (places, cells) in enumerate(lines):
        head = cells in (wide[0], [*narrow, None][0]) or not any(cells[1:])
        for place, cell in zip(places, cells, strict=True):
            # Smaller letters leave room for more of them.
            room = int(_LETTERS * _LINE / height * (_RIGHT - place if place == places[-1] else 1))
            short = cell if len(cell) <= room else cell[: room - 2] + " .."
            size, weight = _SIZE * height / _LINE, "bold" if head else "normal"
            figure.text(place, 0.735 - k * height, short, fontsize=size, weight=weight, parse_math=False)
