"""`serve`: the workbench's server on this machine's own address, with a token of each start."""

from __future__ import annotations

import os
import secrets
import socket
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request as HttpRequest
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from haptid.app.guard import ENTRY, Guard
from haptid.app.pages import PAGES, routes
from haptid.app.session import Session
from haptid.app.workspace import WorkbenchFolder
from haptid.errors import WorkbenchError

STATIC = Path(__file__).with_name("static")
_ADDRESS = "127.0.0.1"
# Of a message to a socket: a frame of samples is smaller.
_LARGEST_MESSAGE = 1 << 16
# Between threads, s: the one that receives samples must not wait for those that compute.
_SWITCH_S = 5e-4


def serve(
    folder: str | Path,
    port: int = 0,
    ready: Callable[[str], None] = lambda _: None,
    *,
    reindex: bool = False,
    largest_log: int = 2 * 2**30,
) -> None:
    """Serve the workbench of a folder until the process is interrupted.

    Args:
        folder: of devices, studies, logs and results; see `WorkbenchFolder`.
        port: on 127.0.0.1; a free one where 0.
        ready: called with the address to open, which has the token, as soon as it is answered.
        reindex: whether the index is made again from the files.
        largest_log: bytes of a log that is dropped on a page.

    Raises:
        WorkbenchError: there is no such folder, the port is taken, or the folder has a workbench already.
    """
    sys.setswitchinterval(_SWITCH_S)
    workspace = WorkbenchFolder(folder)
    listening = _bound(port)
    port = listening.getsockname()[1]
    token = secrets.token_urlsafe(32)
    address = f"http://{_ADDRESS}:{port}{ENTRY}?token={token}"
    with _alone(workspace, address):
        session = Session(workspace, largest_log, reindex)
        application = guarded_application(session, port, token, lambda: ready(address))
        settings = uvicorn.Config(
            application,
            log_level="warning",
            access_log=False,
            ws="websockets-sansio",
            ws_max_size=_LARGEST_MESSAGE,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        uvicorn.Server(settings).run(sockets=[listening])


def guarded_application(session: Session, port: int, token: str, ready: Callable[[], None]) -> Guard:
    """The application behind its guard.

    Args:
        session: what the pages show and change.
        port, token: of the guard.
        ready: called when the server begins to answer.
    """

    async def enter(request: HttpRequest) -> Response:
        if not guard.same(request.query_params.get("token", "")):
            return PlainTextResponse("This is not the token of this session.\n", 401)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(guard.cookie, token, httponly=True, samesite="strict", path="/")
        return answer

    async def shell(_: HttpRequest) -> Response:
        return FileResponse(STATIC / "index.html")

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        ready()
        yield
        session.close()

    served = [
        Route(ENTRY, enter),
        *(Route(path, shell) for path in ("/", *(f"/{name}" for name in PAGES))),
        *routes(session),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    guard = Guard(Starlette(routes=served, lifespan=life), port, token)
    return guard


def _bound(port: int) -> socket.socket:
    """A socket that listens on a port of this machine's own address."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((_ADDRESS, port))
        made.listen(128)  # who comes before the server is ready waits
    except (OSError, OverflowError) as error:
        made.close()
        raise WorkbenchError(
            f"port {port} of {_ADDRESS} cannot be used: {getattr(error, 'strerror', None) or error}.",
            where=port,
            advice="Give another one with --port, or 0 for any that is free.",
        ) from error
    made.set_inheritable(False)
    return made


@contextmanager
def _alone(workspace: WorkbenchFolder, address: str) -> Iterator[None]:
    """One workbench writes into a folder; its address stays in `.haptid/open` while it runs."""
    try:
        path = workspace.own() / "open"
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise WorkbenchError(
            f"{workspace.folder} cannot be written: {error.strerror}.", advice="Give a folder of your own."
        ) from error
    try:
        if not _lock(handle):
            raise WorkbenchError(
                f"{workspace.folder} has a workbench already: {os.read(handle, 500).decode()}.",
                where=str(workspace.folder),
                advice="Open that address, or end that one first.",
            )
        os.ftruncate(handle, 0)
        os.write(handle, address.encode())
        yield
        os.ftruncate(handle, 0)
    finally:
        os.close(handle)


def _lock(handle: int) -> bool:
    """Lock an open file until it is closed; False where another process has it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        with suppress(OSError):
            os.lseek(handle, 2**20, os.SEEK_SET)  # beyond the text, which stays readable
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            os.lseek(handle, 0, os.SEEK_SET)
            return True
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
