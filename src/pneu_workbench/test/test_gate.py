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


LISTENING = ("http", "websocket")
IN = {"http": 200, "websocket": "accepted"}
OUT = {"http": 403, "websocket": CLOSED}


@pytest.mark.parametrize("kind", LISTENING)
@pytest.mark.parametrize("origin", ["none", "own"])
@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8123",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8123",
        "evil-localhost",
        "127.0.0.11:8123",
        "evil.example@evil.example",
        "[::2]:8123",
        "",
    ],
)
def test_no_name_of_another_leads_here(host: str, origin: str, kind: str) -> None:
    """With the right cookie, and with the origin that a page at such a name would have."""
    own = {"origin": f"http://{host}"} if origin == "own" else {}
    assert ask(host=host, cookie=COOKIE, kind=kind, **own)[0] == OUT[kind]
    assert ask(query=f"token={TOKEN}", host=host, kind=kind, **own)[0] == OUT[kind]
    assert ask(host=HOST, cookie=COOKIE, kind=kind)[0] == IN[kind]


@pytest.mark.parametrize("kind", LISTENING)
@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://localhost:8123",  # a page at another name of this machine
        "http://127.0.0.1:8124",  # another server of this machine
        "http://127.0.0.1",
        "https://127.0.0.1:8123",
        "http://127.0.0.1:81230",
        "http://127.0.0.1:8123.evil.example",
        "http://evil.example/http://127.0.0.1:8123",
        "127.0.0.1:8123",
        "null",
        "",
    ],
)
def test_no_page_of_another_site_asks(origin: str, kind: str) -> None:
    """With the right name and the right cookie: nothing but the origin tells."""
    assert ask(host=HOST, cookie=COOKIE, origin=origin, kind=kind)[0] == OUT[kind]
    assert ask(host=HOST, query=f"token={TOKEN}", origin=origin, kind=kind)[0] == OUT[kind]


@pytest.mark.parametrize("kind", LISTENING)
@pytest.mark.parametrize("host", [HOST, "localhost:9", "127.0.0.1", "[::1]:80"])
def test_its_own_pages_come_in_and_nobody_without_the_token(host: str, kind: str) -> None:
    own = {"host": host, "origin": f"http://{host}", "kind": kind}
    assert ask(cookie=COOKIE, **own)[0] == IN[kind]
    for cookie in (
        f"pneu_{PORT}=wrong",
        f"pneu_{PORT}={TOKEN}x",
        f"pneu_{PORT}={TOKEN[:-1]}",
        f"pneu_{PORT}=",
        f"pneu_{PORT + 1}={TOKEN}",
        f"xpneu_{PORT}={TOKEN}",
        f"token={TOKEN}",
    ):
        assert ask(cookie=cookie, **own)[0] == OUT[kind]
    assert ask(**own)[0] == OUT[kind]
    if kind == "websocket":  # a token in an address is for the first page alone
        assert ask(query=f"token={TOKEN}", **own)[0] == CLOSED


@pytest.mark.parametrize("answer", [200, 303, 403])
def test_every_answer_forbids_other_sites_to_use_it(answer: int) -> None:
    query = f"token={TOKEN}" if answer == 303 else ""
    cookie = {"cookie": COOKIE} if answer == 200 else {}
    status, headers = ask(query=query, host=HOST, **cookie)
    assert status == answer
    policy = dict(
        part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";")
    )
    assert policy["default-src"] == policy["form-action"] == "'self'"
    assert policy["frame-ancestors"] == policy["object-src"] == policy["base-uri"] == "'none'"
    assert policy["connect-src"] == "'self' ws: wss:"
    assert policy["script-src"] == "'self' 'unsafe-inline' 'unsafe-eval'"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cross-origin-opener-policy"] == "same-origin"
    assert headers["cross-origin-resource-policy"] == "same-origin"
