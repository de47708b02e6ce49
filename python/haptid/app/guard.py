"""Access control of the workbench: requests need its address, its token and its origin.

- The Host header must be the address that was bound: a foreign name that resolves to this machine (DNS rebinding) is
  answered with 421.
- Every request but the entry has the token as a cookie; without it 401.
- What changes or streams has this server's Origin; a form or script of another page is answered with 403.
- Every answer has a content security policy that allows this server's files only, without inline scripts or styles.
"""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any

_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]
_Application = Callable[[MutableMapping[str, Any], _Receive, _Send], Awaitable[None]]

POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' data:",  # pixels of the report's maps; an image runs nothing
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
        "object-src 'none'",
    )
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}
# Path that takes the token of the printed address and gives the cookie.
ENTRY = "/enter"


class Guard:
    """An ASGI application around another one, which sees only requests that may be answered.

    Args:
        application: to protect.
        port: of the server; part of the cookie's name, as browsers send cookies to every port of a host.
        token: secret of this start.
    """

    def __init__(self, application: _Application, port: int, token: str) -> None:
        self._application, self._token = application, token
        self.cookie = f"haptid-{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}

    async def __call__(self, scope: MutableMapping[str, Any], receive: _Receive, send: _Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return

        async def headed(message: _Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                given = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message["headers"] = [*message.get("headers", ()), *given]
            await send(message)

        status, why = self.refusal(scope)
        if status == 200:
            await self._application(scope, receive, headed)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4000 + status, "reason": why})
        else:
            body = f"{why}\n".encode()
            head = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
            await headed({"type": "http.response.start", "status": status, "headers": head})
            await send({"type": "http.response.body", "body": body})

    def refusal(self, scope: MutableMapping[str, Any]) -> tuple[int, str]:
        """Status and reason of an answer without the application; 200 for a request that it may see."""
        given: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            given.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        if len(given.get("host", ())) != 1 or given["host"][0] not in self._hosts:
            return 421, "This server answers to the address that `haptid app` printed only."
        if scope["path"] != ENTRY and not self._known(given.get("cookie", ())):
            return 401, "Open the address that `haptid app` printed: it has the token of this session."
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if changes and (len(given.get("origin", ())) != 1 or given["origin"][0] not in self._origins):
            return 403, "A request of another page is refused."
        return 200, ""

    def same(self, token: str) -> bool:
        """Whether a text is the token, compared in constant time."""
        return secrets.compare_digest(token.encode("utf-8", "replace"), self._token.encode())

    def _known(self, cookies: object) -> bool:
        for text in cookies if isinstance(cookies, list) else ():
            try:
                found = SimpleCookie(text).get(self.cookie)
            except CookieError:
                continue
            if found is not None and self.same(found.value):
                return True
        return False
