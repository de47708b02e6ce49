"""Extensions: estimation methods, terms, log formats and export formats of other packages, by their entry points.

A package declares them in its metadata, such as `[project.entry-points."haptid.exports"]`. One is imported where a file
or a command names it, and never otherwise: it is code that the user installed.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from haptid.errors import MissingDependencyError

Group = Literal["haptid.methods", "haptid.terms", "haptid.log_formats", "haptid.exports"]


def extension_names(group: Group) -> tuple[str, ...]:
    """Names that installed packages declare in a group, sorted."""
    return tuple(sorted({entry.name for entry in entry_points(group=group)}))


def extension(group: Group, name: str) -> Any | None:
    """What an installed package declares under a name; None where no package does.

    Raises:
        MissingDependencyError: it cannot be imported, or two packages declare the name.
    """
    candidates = list(entry_points(group=group, name=name))
    if len({entry.value for entry in candidates}) > 1:
        packages = ", ".join(sorted(_package(entry) for entry in candidates))
        raise MissingDependencyError(
            f"the packages {packages} each declare {name!r} in {group}.",
            where=group,
            found=packages,
            advice="Uninstall all but one of them.",
        )
    for entry in candidates:
        try:
            return entry.load()
        except Exception as error:
            raise MissingDependencyError(
                f"the extension {name!r} of the package {_package(entry)} cannot be imported: "
                f"{type(error).__name__}: {error}.",
                where=group,
                found=entry.value,
                advice="Reinstall this package, or report the fault to its authors.",
            ) from error
    return None


def _package(entry: EntryPoint) -> str:
    return entry.value if entry.dist is None else entry.dist.name
