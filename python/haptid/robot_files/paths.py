"""Files that a robot description may name: those under its own folder and under folders that the caller gives."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from haptid._internal.late import dataclass
from haptid.robot_files.xml import refused


@dataclass(frozen=True)
class Roots:
    """Folders that a description may read from.

    Attributes:
        file: the description, for errors.
        folder: its own folder, resolved.
        packages: folders by the name of the package, resolved.
    """

    file: str
    folder: Path
    packages: Mapping[str, Path]

    @staticmethod
    def of(path: Path, packages: Mapping[str, str | Path]) -> Roots:
        """Of a description and the packages stated by the caller.

        Raises:
            RobotFileError: a package is no folder.
        """
        made = {}
        for name, folder in packages.items():
            at = Path(folder)
            if not at.is_dir():
                found = f"the folder of package {name!r}, {folder}, does not exist"
                raise refused(str(path), found, "Give --package NAME=FOLDER with an existing folder.")
            made[name] = at.resolve()
        return Roots(str(path), path.resolve().parent, made)

    @property
    def allowed(self) -> tuple[Path, ...]:
        """All folders that files may be read from."""
        return (self.folder, *self.packages.values())

    def resolved(self, name: str, base: Path, line: int | None = None) -> Path:
        """The file that a name in the description stands for.

        Args:
            name: relative to `base`, or `package://NAME/...`.
            base: folder that relative names start from.
            line: where it is named.

        Raises:
            RobotFileError: it is outside the description's folder and the packages, with `..`, absolute, or by a link.
        """
        if "\0" in name:
            raise refused(self.file, f"the file name {name!r} has a zero byte in it", "Correct it.", line)
        scheme, separator, rest = name.partition("://")
        if separator:
            package, _, inside = rest.partition("/")
            if scheme not in ("package", "model") or package not in self.packages:
                advice = f"State its folder: --package {package}=FOLDER."
                raise refused(self.file, f"the file {name!r} is of a package that is not known", advice, line)
            path = self.packages[package] / inside
        else:
            path = base / name
        try:
            made = path.resolve()
        except (OSError, RuntimeError) as error:
            raise refused(self.file, f"the file {name!r} cannot be found ({error})", "Correct it.", line) from None
        if not any(made.is_relative_to(root) for root in self.allowed):
            found = f"the file {name!r} is outside the folder of the description"
            advice = "If you trust it, state a folder that holds it: --package NAME=FOLDER."
            raise refused(self.file, found, advice, line)
        return made
