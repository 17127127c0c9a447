# SPDX-License-Identifier: Apache-2.0
"""Who may come in, asked of the gate as a server would."""

import asyncio
from typing import Any

import pytest

from pneu_workbench.gate import CLOSED, REFUSAL, Gate

TOKEN = "a-token-that-nobody-guesses"
PORT = 8123
HOST = f"127.0.0.1:{PORT}"
COOKIE = f"pneu_{PORT}={TOKEN}"


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"within"})


def ask(
    path: str = "/", query: str = "", kind: str = "http", **headers: str
) -> tuple[Any, dict[str, str]]:
    """Status, or code of closing, and headers of an answer."""
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "websocket.connect" if kind == "websocket" else "http.request"}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    asyncio.run(Gate(_app, TOKEN, PORT)(scope, receive, send))
    first = sent[0]
    if first["type"].startswith("websocket"):
        return first.get("code", "accepted"), {}
    if first["status"] == 403:
        assert sent[1]["body"] == REFUSAL
    return first["status"], {k.decode(): v.decode() for k, v in first["headers"]}


def test_nobody_comes_in_without_the_token() -> None:
    assert ask(host=HOST)[0] == 403
    assert ask(host=HOST, cookie=f"pneu_{PORT}=wrong")[0] == 403
    assert ask(host=HOST, cookie=f"pneu_{PORT + 1}={TOKEN}")[0] == 403  # of another server
    assert ask(query="token=wrong", host=HOST)[0] == 403
    assert ask(query="token=", host=HOST)[0] == 403
    assert ask(path="/_nicegui/3.18.0/static/vue.js", host=HOST)[0] == 403
    assert ask(host=HOST, cookie="\x00;;=")[0] == 403


def test_who_knows_it_gets_a_cookie_that_scripts_and_other_sites_cannot_use() -> None:
    status, headers = ask(path="/a", query=f"x=1&token={TOKEN}", host=HOST)
    assert (status, headers["location"]) == (303, "/a?x=1")  # without the token
    assert headers["set-cookie"] == f"{COOKIE}; Path=/; HttpOnly; SameSite=Strict"
    assert headers["referrer-policy"] == "no-referrer"
    status, headers = ask(host=HOST, cookie=f"other=1; {COOKIE}")
    assert status == 200
    assert "default-src 'self'" in headers["content-security-policy"]


def test_the_welcome_leads_nowhere_else() -> None:
    assert ask(path="//evil.example/", query=f"token={TOKEN}", host=HOST)[1]["location"] == (
        "/evil.example/"
    )


@pytest.mark.parametrize("host", ["localhost:9", "127.0.0.1", "[::1]:80"])
def test_through_a_forward_the_page_has_another_port(host: str) -> None:
    assert ask(host=host, cookie=COOKIE)[0] == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8123", "127.0.0.1.evil.example", ""]
)
def test_no_name_of_another_leads_here(host: str) -> None:
    assert ask(host=host, cookie=COOKIE)[0] == 403
    assert ask(query=f"token={TOKEN}", host=host)[0] == 403


def test_no_page_of_another_site_asks() -> None:
    assert ask(host=HOST, cookie=COOKIE, origin="http://evil.example")[0] == 403
    assert ask(host=HOST, cookie=COOKIE, origin="null")[0] == 403
    assert ask(host=HOST, cookie=COOKIE, origin=f"http://{HOST}")[0] == 200


def test_sockets_are_kept_by_the_same_rules() -> None:
    path = "/_nicegui_ws/socket.io/"
    assert ask(path=path, kind="websocket", host=HOST)[0] == CLOSED
    assert ask(path=path, kind="websocket", host=HOST, query=f"token={TOKEN}")[0] == CLOSED
    other = {"host": HOST, "cookie": COOKIE, "origin": "http://evil.example"}
    assert ask(path=path, kind="websocket", **other)[0] == CLOSED
    assert ask(path=path, kind="websocket", host=HOST, cookie=COOKIE)[0] == "accepted"
