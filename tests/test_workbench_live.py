# SPDX-License-Identifier: Apache-2.0
"""The workbench on a running graph: a leak is seen while it leaks, recorded, and opened."""

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.workbench_pages import LONG_MS, Server, browser, button, open_page, pick  # isort: skip

from playwright.sync_api import Browser, expect
from tests.live_graph import own_domain, running_graph, wait_and_see
from tests.live_rig import HardwareRig

pytestmark = pytest.mark.realtime

__all__ = ["browser"]  # a fixture

ROOT = Path(__file__).resolve().parents[1]
RIG = "rig_a_fitted.yaml"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    """The page beside a graph on which a recording with a leak is replayed again and again."""
    shutil.copy(ROOT / "rigs" / RIG, tmp_path / RIG)
    words = [sys.executable, "-m", "pneu_common.cli", "run", "pneu_sysid", "replay", "--ros-args"]
    words += ["-p", f"bag:={ROOT / 'data' / 'bags' / 'a_leak'}", "-p", f"rig:={tmp_path / RIG}"]
    with own_domain():
        replay = subprocess.Popen([*words, "-p", "loop:=true"], stdout=subprocess.DEVNULL)
        server = Server(tmp_path, tmp_path / "session")
    yield server
    assert server.stop() in (0, -signal.SIGINT, 130), "".join(server.said)
    assert "Traceback" not in "".join(server.said)
    replay.terminate()
    replay.wait(20.0)


@pytest.mark.long
def test_a_leak_is_seen_while_it_leaks(browser: Browser, server: Server) -> None:
    page, watch = open_page(browser, server)
    page.get_by_text("Live: a running graph").click()
    button(page, "Listen").click()
    expect(page.get_by_text("rig file: none was chosen whose model").first).to_be_visible()
    pick(page, "Rig file", RIG)
    button(page, "Listen").click()
    verdict = page.get_by_text("the model does not describe the rig", exact=True)
    expect(verdict).to_be_visible(timeout=LONG_MS)
    expect(
        page.get_by_text(re.compile(r"times the error known from its calibration"))
    ).to_be_visible()
    expect(page.get_by_text(re.compile(r"^replay: replay: at "))).to_be_visible()
    page.wait_for_function("document.querySelector('.pneu-chart')?.dataset.shown > 2")
    # no bridge is here; the page says so instead of that all is safe
    button(page, "Emergency stop").click()
    expect(page.get_by_text("no bridge found")).to_be_visible(timeout=LONG_MS)
    # what came in of late is a recording like another
    page.get_by_label("Last seconds").fill("0.1")
    button(page, "Diagnose them").click()
    expect(page.get_by_text("found 0.1, allowed are 1 to 120").first).to_be_visible()
    page.get_by_label("Last seconds").fill("4")
    button(page, "Diagnose them").click()
    asked = page.get_by_role("status").filter(has_text="what is missing")
    expect(asked).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_text(re.compile(r"^Open: live_"))).to_be_visible()
    button(page, "Cancel").click()
    expect(page.get_by_role("alert").filter(has_text="cancelled")).to_be_visible()
    # and so is what the recorder wrote
    button(page, "Record").click()
    expect(page.get_by_text(re.compile(r"^recorder: bag: recording"))).to_be_visible(
        timeout=LONG_MS
    )
    page.wait_for_timeout(3000)
    button(page, "Stop recording").click()
    expect(page.get_by_text(re.compile(r"^Open: recorded_"))).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_text("Where the model fails")).to_be_visible(timeout=LONG_MS)
    button(page, "Listen no longer").click()
    expect(button(page, "Listen")).to_be_visible()
    assert watch.faults == []


def test_the_emulated_lab_is_watched_and_stopped(browser: Browser, tmp_path: Path) -> None:
    """Over bridge and bus, in a namespace of its own, with a controller that goes on commanding."""
    with own_domain() as domain, running_graph() as graph:
        rig = HardwareRig(tmp_path, graph, domain)
        pages = tmp_path / "pages"
        pages.mkdir()
        shutil.copy(ROOT / "rigs" / "lab.yaml", pages / "lab.yaml")
        server = Server(pages, tmp_path / "session")
        try:
            page, watch = open_page(browser, server)
            page.get_by_text("Live: a running graph").click()
            pick(page, "Rig file", "lab.yaml")
            button(page, "Listen").click()
            waits = page.get_by_text(re.compile("valve/command.*no node has these topics yet"))
            expect(waits.first).to_be_visible(timeout=LONG_MS)
            rig.start()
            expect(page.get_by_text(re.compile(r"samples in /lab$"))).to_be_visible(timeout=LONG_MS)
            expect(
                page.get_by_text(re.compile(r"times the error known from its calibration"))
            ).to_be_visible(timeout=LONG_MS)
            follows = page.get_by_text(re.compile(r"^valve_bridge: safety: following"))
            expect(follows).to_be_visible()
            button(page, "Emergency stop").click()
            answer = page.get_by_text("/lab/valve_bridge: safe, read back voltage 0 V")
            expect(answer).to_be_visible(timeout=LONG_MS)
            assert rig.lab.resting_since() is not None
            expect(
                page.get_by_text("valve_bridge: safety: e_stop: e-stop: workbench")
            ).to_be_visible(timeout=LONG_MS)
            assert wait_and_see(lambda: rig.lab.resting_since() is None, 1.0) is False
            assert watch.faults == []
        finally:
            assert server.stop() in (0, -signal.SIGINT, 130), "".join(server.said)
            rig.nodes.close()
        assert not rig.nodes.complaints()
