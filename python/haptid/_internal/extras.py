"""Optional packages: which extra brings them, and the error where one is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from haptid.errors import MissingDependencyError

# Extra of haptid by package.
EXTRAS = {"pyarrow": "parquet", "h5py": "hdf5", "matplotlib": "plots", "starlette": "app", "uvicorn": "app"}


@contextmanager
def needing(purpose: str) -> Iterator[None]:
    """Around imports: an optional package that is missing becomes an error that names its extra.

    Raises:
        MissingDependencyError: the package is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise MissingDependencyError(
            f"{purpose} needs the package {package}, which is not installed.",
            where=package,
            advice=f'pip install "haptid[{EXTRAS[package]}]"',
        ) from error
