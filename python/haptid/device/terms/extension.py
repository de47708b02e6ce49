"""Terms of other packages: columns whose expressions an installed extension writes (entry points `haptid.terms`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from haptid._internal.extensions import extension, extension_names
from haptid._internal.late import dataclass
from haptid.device.expressions import column
from haptid.device.terms.custom import constant_names, with_constants
from haptid.device.terms.term import TermColumn
from haptid.device.toml.terms import ExtensionTerm
from haptid.errors import suggestion

if TYPE_CHECKING:
    from haptid.device.geometry import Reader
    from haptid.device.terms.build import Target, TermTargets
    from haptid.device.toml.errors_at import Place


@dataclass(frozen=True)
class TermFormula:
    """One column of a term of an extension.

    Attributes:
        stem: of its parameter's name, which ends with the joint's or motor's, such as "GM" for GM1 and GM2.
        unit: of its parameter.
        expression: torque or force per unit of the parameter, as in a custom term: over the position and velocity that
            the extension was given, and the constants of the term.
    """

    stem: str
    unit: str
    expression: str


# What an entry point in `haptid.terms` is: a function of position and velocity of the joint or motor, both as
# expressions, of whether it is prismatic, and of the settings of the term.
TermExtension = Callable[[str, str, bool, Mapping[str, Any]], Iterable[TermFormula]]


def extension_columns(
    table: ExtensionTerm, target: Target, targets: TermTargets, reader: Reader, place: Place
) -> list[TermColumn]:
    """The columns of an extension's term on one target.

    Raises:
        DeviceFileError: no installed package declares it, it refuses its settings, the target has no position that is a
            combination of the joints', or an expression is wrong.
        MissingDependencyError: it cannot be imported.
    """
    make: TermExtension | None = extension("haptid.terms", table.name)
    if make is None:
        found = f"no installed package declares a term {table.name!r} (entry point haptid.terms)"
        raise place.at("name").error(found, suggestion(table.name, extension_names("haptid.terms")))
    if target.varies or target.what == "cut":
        found = f"{target.on} has no position that is a combination of the joints'"
        raise place.error(found, "Name a joint of the tree, or a motor with constant rates.")
    try:
        formulas = list(make(f"({target.position})", f"({target.speed})", target.prismatic, table.settings))
    except (TypeError, ValueError, KeyError) as error:
        found = f"the term {table.name!r} refuses its settings: {type(error).__name__}: {error}"
        raise place.at("settings").error(found, "Write the settings that its package documents.") from error
    named = constant_names(table.constants, reader, place)
    joints = [joint.name for joint in targets.joints]
    columns = []
    for formula in formulas:
        shape = column(formula.expression, joints, named, place.at("name"))
        stem = formula.stem if table.prefix is None else f"{table.prefix}{formula.stem}"
        motor = "M" if target.what == "motor" and table.prefix is None else ""
        term = target.external(f"{stem}{motor}{target.name}", formula.unit, shape)
        columns.append(with_constants(term, table.constants, reader, place.at("constants")))
    return columns
