"""LaTeX export, `export_latex(model, folder)`: tables of parameters and groupings for a paper."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Unpack

from haptid._internal.escaping import latex_text
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic.formulas import subscript
from haptid.errors import RegroupingError
from haptid.estimation.parameter import NOT_EXCITED
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, about, provenance

# Significant digits.
DIGITS = 5
DOCUMENT = r"""\documentclass{article}
\usepackage[margin=2.5cm]{geometry}
\usepackage{amsmath,booktabs,longtable}
\begin{document}
\section*{@title}
@verdict
\input{@name_parameters}
\input{@name_groupings}
\end{document}
"""


def export_latex(identified: ExportSource, folder: str | Path, **criterion: Unpack[ExportCriterion]) -> Export:
    """Write parameters and groupings as LaTeX tables, and a document that includes them.

    The tables need the packages amsmath, booktabs and longtable. Groupings have symbolic lengths where the exact
    regroupings exist, else numbers.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of NAME.tex, NAME_parameters.tex and NAME_groupings.tex.

    Raises:
        UnvalidatedModelError, OutputFolderError: as in `export_c`.
    """
    source = provenance(identified, quoted=True, **criterion)
    name = default_name(source.model.device.name)
    head = "\n".join(f"% {line}".rstrip() for line in about(source))
    document = DOCUMENT.replace("@title", latex_text(source.model.device.name)).replace("@name", name)
    texts = {
        f"{name}.tex": document.replace("@verdict", "\n\n".join(map(latex_text, (source.verdict, *source.fitness)))),
        f"{name}_parameters.tex": f"{head}\n{_parameters(source)}",
        f"{name}_groupings.tex": f"{head}\n{_groupings(source.model)}",
    }
    return write(folder, texts, source.verdict)


def _parameters(source: Provenance) -> str:
    """Table with a row for each base parameter."""
    lines = []
    for k, (name, unit) in enumerate(zip(source.model.base.names, source.model.base.units, strict=True)):
        interval = ("", "") if source.intervals is None else tuple(map(latex_number, source.intervals[k]))
        value = NOT_EXCITED if k in source.unexcited else latex_number(source.beta[k])
        lines.append(" & ".join((f"${subscript(name)}$", value, *interval, unit_text(unit))))
    head = r"parameter & value & \multicolumn{2}{c}{95\,\% interval} & unit"
    return _table("lrrrl", head, lines)


def _groupings(model: DynamicModel) -> str:
    """Table with a row for each base parameter: inline formulas, which LaTeX can break."""
    try:
        formulas = model.regroupings.latex
    except RegroupingError:
        rows = zip(model.base.names, model.base.groupings, strict=True)
        formulas = tuple(f"{subscript(name)} = {_numeric(grouping)}" for name, grouping in rows)
    return _table(r"p{0.95\linewidth}", "groupings", [f"${formula}$" for formula in formulas])


def _numeric(grouping: str) -> str:
    """LaTeX of a numerical grouping such as `ZZ1 + 0.2025 M3`."""
    words = grouping.split()
    return " ".join(word if word in "+-" else _factor(word) for word in words)


def _factor(word: str) -> str:
    if re.fullmatch(r"[0-9.]+(e[-+]?[0-9]+)?", word):
        return latex_number(float(word)).strip("$") + r"\,"
    return f"-{subscript(word[1:])}" if word.startswith("-") else subscript(word)


def _table(columns: str, head: str, lines: list[str]) -> str:
    body = "\n".join(f"{line} \\\\" for line in lines)
    top = rf"\begin{{longtable}}{{{columns}}}" + "\n" + rf"\toprule {head} \\ \midrule \endhead"
    return f"{top}\n{body}\n" + r"\bottomrule" + "\n" + r"\end{longtable}" + "\n"


def latex_number(value: float) -> str:
    """A number in math mode: 1.2345, or 1.2345 times a power of ten."""
    if math.isinf(value):
        return r"$-\infty$" if value < 0 else r"$\infty$"
    mantissa, _, exponent = f"{value:.{DIGITS}g}".partition("e")
    return f"${mantissa}$" if not exponent else rf"${mantissa} \times 10^{{{int(exponent)}}}$"


def unit_text(unit: str) -> str:
    """A unit in upright type: kg m^2 with a superscript."""
    parts = re.split(r"\^(-?[0-9]+)", unit)  # texts and exponents in turn
    return "".join(f"$^{{{p}}}$" if k % 2 else latex_text(p).replace(" ", r"\,") for k, p in enumerate(parts))
