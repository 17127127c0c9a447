# SPDX-License-Identifier: Apache-2.0
"""Who may come in: whoever was told the token, from a page of this server alone.

The token stands in the address that the command prints. The first request with it gets a cookie,
which scripts cannot read and other sites cannot send, and is sent on to the address without it.
Names of hosts are checked too, so that no site can have its own name lead here (DNS rebinding);
through an SSH forward the page is at 127.0.0.1 or localhost, at whatever port.
"""

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HOSTS = ("127.0.0.1", "localhost", "[::1]")
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval';"
    " style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:;"
    " connect-src 'self' ws: wss:; object-src 'none'; base-uri 'none'; frame-ancestors 'none';"
    " form-action 'self'"
)
"""What a page may load: nothing from elsewhere. The page's library compiles its templates in the
browser, hence the evaluation of scripts."""
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
REFUSAL = b"This page needs the address that `pneu workbench` printed, with its token."
CLOSED = 4403
"""Status with which a socket is closed that may not come in."""


class Gate:
    """Stands before an ASGI application."""

    def __init__(self, app: App, token: str, port: int) -> None:
        """Stands before it.

        Args:
            app: The application.
            token: What must be known.
            port: Where it is served; cookies are not told apart by port, so their name has it.
        """
        self._app, self._token = app, token
        self._cookie = f"pneu_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets a request in, or does not.

        Args:
            scope: Of the request.
            receive: As ASGI has it.
            send: As ASGI has it.
        """
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {k.decode("latin-1").lower(): v.decode("latin-1") for k, v in scope["headers"]}
        if not self._from_here(headers):
            await self._refuse(scope, receive, send)
            return
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)
        given = [value for name, value in query if name == "token"]
        if scope["type"] == "http" and given and self._is_token(given[0]):
            rest = urlencode([pair for pair in query if pair[0] != "token"])
            await self._welcome(scope["path"] + (f"?{rest}" if rest else ""), send)
            return
        if not self._is_token(self._told(headers.get("cookie", ""))):
            await self._refuse(scope, receive, send)
            return

        async def guarded(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            await send(message)

        await self._app(scope, receive, guarded)

    def _from_here(self, headers: dict[str, str]) -> bool:
        host = headers.get("host", "")
        name = urlsplit(f"//{host}").hostname or ""
        if name not in {h.strip("[]") for h in HOSTS}:
            return False
        origin = headers.get("origin")
        return origin is None or origin == f"http://{host}"

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self._token.encode())

    def _told(self, header: str) -> str:
        try:
            cookie = SimpleCookie(header).get(self._cookie)
        except CookieError:
            return ""
        return cookie.value if cookie is not None else ""

    async def _welcome(self, path: str, send: Send) -> None:
        cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        # no path that begins with two slashes, which would be another host
        headers = [
            (b"location", ("/" + path.lstrip("/")).encode()),
            (b"set-cookie", cookie.encode()),
        ]
        await send({"type": "http.response.start", "status": 303, "headers": [*headers, *HEADERS]})
        await send({"type": "http.response.body", "body": b""})

    async def _refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": CLOSED})
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
        await send({"type": "http.response.start", "status": 403, "headers": headers})
        await send({"type": "http.response.body", "body": REFUSAL})
