"""Requests and answers of the pages' calls: JSON both ways, errors as sentences."""

from __future__ import annotations

import json
import traceback
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse

from haptid.app.workspace import StaleFileError
from haptid.errors import HaptidError, WorkbenchError

_S = TypeVar("_S")
# Largest body of a call, bytes; logs are streamed instead.
_LARGEST = 4 * 2**20


class Asked:
    """Parameters of a call: of its query string and of its JSON body.

    Args:
        given: by name.
    """

    def __init__(self, given: dict[str, Any]) -> None:
        self._given = given

    def text(self, name: str, default: str | None = None) -> str:
        """A text.

        Raises:
            WorkbenchError: it is missing or none.
        """
        value = self._given.get(name, default)
        if not isinstance(value, str):
            raise WorkbenchError(f"{name!r} is missing in the request, or no text.", where=name, found=value)
        return value

    def texts(self, name: str) -> list[str]:
        """A list of texts.

        Raises:
            WorkbenchError: it is missing or none.
        """
        value = self._given.get(name)
        value = value.split(",") if isinstance(value, str) else value
        if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
            raise WorkbenchError(f"{name!r} is missing in the request, or no list of texts.", where=name, found=value)
        return value


def call(session: _S, function: Callable[[_S, Asked], Any]) -> Callable[[HttpRequest], Awaitable[JSONResponse]]:
    """An endpoint that runs a function of session and parameters in a thread, and answers with its value."""

    async def answered(request: HttpRequest) -> JSONResponse:
        try:
            asked = Asked({**request.query_params, **request.path_params, **await _body(request)})
            return JSONResponse(await run_in_threadpool(lambda: _finite(function(session, asked))))
        except StaleFileError as error:
            return refusing(error, 409, current=error.found)
        except HaptidError as error:
            return refusing(error)
        except Exception:
            return JSONResponse({"defect": traceback.format_exc()}, 500)

    return answered


def refusing(error: HaptidError, status: int = 400, **more: Any) -> JSONResponse:
    """The answer for an error in the input."""
    return JSONResponse({"error": str(error), "where": repr(error.where) if error.where else "", **more}, status)


async def _body(request: HttpRequest) -> dict[str, Any]:
    """The JSON object of a request, counted while it comes in; empty where there is none."""
    content = bytearray()
    async for part in request.stream():
        content += part
        if len(content) > _LARGEST:
            raise WorkbenchError(f"the request has more than {_LARGEST} bytes.", limit=_LARGEST)
    try:
        made = json.loads(content) if content else {}
    except (ValueError, RecursionError) as error:
        raise WorkbenchError("the request is not JSON.") from error
    if not isinstance(made, dict):
        raise WorkbenchError("the request is no JSON object.")
    return made


def _finite(value: Any) -> Any:
    """Values of JSON: None where a number is not finite."""
    if isinstance(value, dict):
        return {str(key): _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, float) and not (-float("inf") < value < float("inf")):
        return None
    return value
