"""`haptid` and `python -m haptid`."""

import gc
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

# Exit status of a command that was interrupted: 128 and the number of SIGINT, as in a shell.
_INTERRUPTED = 130
# SciPy copies every name of NumPy, and with them its compiler of Fortran and its tests, which nothing here calls.
_LATE = frozenset({"numpy.f2py", "numpy.testing"})


class _Late:
    """Finder of modules that are loaded when one of their names is asked for."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in _LATE else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def program() -> None:
    """Entry point; Ctrl-C while the commands are still being imported ends without a traceback."""
    # The garbage collector would go through what is imported again and again, a tenth of a command's time.
    gc.set_threshold(300_000, 50, 50)
    sys.meta_path.insert(0, _Late)
    try:
        from haptid.cli import main as commands

        commands()
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)


if __name__ == "__main__":
    program()
