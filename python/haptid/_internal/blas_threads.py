"""BLAS on one thread: haptid's matrices are small, and threads that wait for each other take longer than the work.

The commands set it in the environment before NumPy is loaded. In a notebook NumPy is loaded already: there a search for
an exciting motion took three times as long with OpenBLAS's threads as without.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


def on_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The function, during which BLAS has one thread; as many as before afterwards.

    Nothing is changed where OPENBLAS_NUM_THREADS is set: the user, or the command, has chosen.
    """

    @wraps(function)
    def limited(*args: _P.args, **settings: _P.kwargs) -> _R:
        if "OPENBLAS_NUM_THREADS" in os.environ:
            return function(*args, **settings)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **settings)

    return limited
