# SPDX-License-Identifier: Apache-2.0
"""The workbench as a user starts it, and its page in a real browser, for tests.

Every page is watched: no script may fail, nothing may be asked for beyond the loopback. Importing
this skips the module that does where no browser is installed.
"""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.browsers import BROWSER, WITHOUT

if BROWSER is None:
    pytest.skip(f"the workbench was not opened in a browser: {WITHOUT}", allow_module_level=True)

from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

expect.set_options(timeout=30_000)

QUIET = [
    "--no-sandbox", "--disable-gpu", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run",
]  # fmt: skip
LONG_MS = 300_000
"""A machine may be busy."""


class Server:
    """`pneu workbench` as its user starts it."""

    def __init__(self, folder: Path, session: Path) -> None:
        words = [sys.executable, "-m", "pneu_common.cli", "workbench"]
        words += ["--folder", str(folder), "--session", str(session), "--workers", "2"]
        # NiceGUI takes a server that a test starts for its own test
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
        self.process = subprocess.Popen(
            words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True,
        )  # fmt: skip
        self.said: list[str] = []
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line)
            if found := re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", line):
                self.address = found.group(0)
                break
        else:
            pytest.fail(f"the workbench did not start: {''.join(self.said)}")
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        self.said += list(self.process.stdout)

    def stop(self) -> int:
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(20.0)
        finally:
            self.process.kill()


class Watch:
    """What a page should not do."""

    def __init__(self, page: Page) -> None:
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", lambda m: self.faults.append(m.text) if m.type == "error" else None)
        page.on("request", self._asked)

    def _asked(self, request: Any) -> None:
        if not re.match(r"(https?|wss?)://127\.0\.0\.1[:/]|data:|blob:", request.url):
            self.faults.append(f"asked for {request.url}")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=QUIET)
        yield browser
        browser.close()


def open_page(
    browser: Browser, server: Server, width: int = 1600, **how: Any
) -> tuple[Page, Watch]:
    context = browser.new_context(viewport={"width": width, "height": 1000}, **how)
    context.set_default_timeout(30_000)
    page = context.new_page()
    watch = Watch(page)
    page.goto(server.address)
    expect(page.get_by_role("button", name="Open", exact=True)).to_be_visible()
    assert "token" not in page.url
    return page, watch


def pick(page: Page, label: str, name: str) -> None:
    box = page.get_by_label(label)
    box.click()
    box.fill(name)
    page.get_by_role("option", name=name, exact=True).click()
    page.keyboard.press("Escape")


def button(page: Page, name: str) -> Locator:
    return page.get_by_role("button", name=name, exact=True)
