# SPDX-License-Identifier: Apache-2.0
"""The workbench in a real browser: from nothing to the leak named, added and exported, by clicks.

Every page is watched: no script may fail, nothing may be asked for beyond the loopback.
"""

import io
import os
import re
import shutil
import signal
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.coarse import coarsened
from tests.short_bags import shorten

from tests.workbench_pages import LONG_MS, Server, browser, button, open_page, pick  # isort: skip

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from pneu_sim.rig.load import load_rig

pytestmark = pytest.mark.takes(120)

__all__ = ["browser"]  # a fixture

PICTURES = os.environ.get("PNEU_PICTURES")
"""A folder that receives the story as one picture, as docs/workbench.md shows it, of all of it."""

ROOT = Path(__file__).resolve().parents[1]
BAG, RIG = "bags/a_leak", "rig_a_fitted.yaml"
SHORT, SHORT_S = "bags/a_leak_short.mcap", 4.0
"""Its beginning: what is missing is looked for twice, and fitted."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a user has it, with a recording that is cut short besides."""
    lab = tmp_path_factory.mktemp("lab", numbered=False)
    shutil.copytree(ROOT / "data" / "bags" / "a_leak", lab / BAG)
    # for pictures as a user has it
    (shutil.copy if PICTURES else coarsened)(ROOT / "rigs" / RIG, lab / RIG)
    mcap = next((lab / BAG).glob("*.mcap"))
    shorten(mcap, lab / SHORT, SHORT_S)
    whole = mcap.read_bytes()
    (lab / "cut.mcap").write_bytes(whole[: len(whole) // 3])
    (lab / "<img src=x onerror=alert(1)>.csv").write_text("time\n1\n")
    return lab


@pytest.fixture(scope="module")
def server(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    server = Server(lab, tmp_path_factory.mktemp("work") / "session")
    yield server
    assert server.stop() in (0, -signal.SIGINT, 130), "".join(server.said)
    assert "Traceback" not in "".join(server.said)


def _drawn(page: Page) -> int:
    """How many times the chart was painted."""
    page.wait_for_function("document.querySelector('.pneu-chart')?.dataset.shown")
    return int(page.locator(".pneu-chart").get_attribute("data-shown") or 0)


TIMES = "35" if PICTURES else "28"
"""The error over the noise that is left without the leak."""


def _picture(page: Page, pictures: list[bytes]) -> None:
    if PICTURES:
        size = page.viewport_size
        page.set_viewport_size({"width": 1600, "height": 1500})
        page.mouse.move(0, 0)
        page.evaluate("window.scrollTo(0, 0)")
        page.wait_for_timeout(1500)  # signals are read anew for another width
        pictures.append(page.screenshot())
        if size is not None:
            page.set_viewport_size(size)


def _strip(pictures: list[bytes]) -> None:
    """Puts the pictures into one, two beside each other."""
    if not PICTURES:
        return
    from PIL import Image

    parts = [Image.open(io.BytesIO(one)).convert("RGB") for one in pictures]
    w, h = (int(0.6 * x) for x in parts[0].size)
    whole = Image.new("RGB", (2 * w + 10, -(-len(parts) // 2) * (h + 10) - 10), "#888888")
    for k, part in enumerate(parts):
        whole.paste(
            part.resize((w, h), Image.Resampling.LANCZOS), (k % 2 * (w + 10), k // 2 * (h + 10))
        )
    whole.quantize(64).save(f"{PICTURES}/workbench.png", optimize=True)


def _serious(page: Page) -> list[str]:
    found = Axe().run(page).response["violations"]
    return [
        f"{one['id']}: {one['nodes'][0]['html'][:200]}"
        for one in found
        if one["impact"] in ("serious", "critical")
    ]


def _too_wide(page: Page) -> list[str]:
    """Elements that stick out of the page, but for those of a table that is moved by itself."""
    return list(
        page.evaluate(
            "() => [...document.querySelectorAll('body *')].filter((e) => {"
            " const r = e.getBoundingClientRect();"
            " return !e.closest('.pneu-scroll > *') && r.width > 0"
            " && getComputedStyle(e).visibility !== 'hidden'"
            " && r.right > document.documentElement.clientWidth + 1; })"
            ".map((e) => e.outerHTML.slice(0, 120))"
        )
    )


def _over_each_other(page: Page) -> list[str]:
    """Pairs of words that lie over each other, as far as they are to be seen."""
    return list(
        page.evaluate(
            """() => {
              const seen = [];
              const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
              while (walk.nextNode()) {
                const node = walk.currentNode;
                const own = node.parentElement;
                const shown = { opacityProperty: true, visibilityProperty: true };
                if (!node.data.trim() || !own.checkVisibility(shown)) continue;
                if (own.closest("i, script, style, .q-tooltip")) continue;
                const range = document.createRange();
                range.selectNodeContents(node);
                for (const r of range.getClientRects()) {
                  const box = [r.left, r.top, r.right, r.bottom];
                  for (let at = own; at; at = at.parentElement) {
                    if (getComputedStyle(at).overflowY === "visible") continue;
                    const c = at.getBoundingClientRect();
                    box[0] = Math.max(box[0], c.left); box[1] = Math.max(box[1], c.top);
                    box[2] = Math.min(box[2], c.right); box[3] = Math.min(box[3], c.bottom);
                  }
                  if (box[2] - box[0] > 1 && box[3] - box[1] > 1)
                    seen.push([box, node.data.trim().slice(0, 60), node]);
                }
              }
              const found = [];
              for (let a = 0; a < seen.length; a++)
                for (let b = a + 1; b < seen.length; b++) {
                  const [p, q] = [seen[a][0], seen[b][0]];
                  const wide = Math.min(p[2], q[2]) - Math.max(p[0], q[0]);
                  const high = Math.min(p[3], q[3]) - Math.max(p[1], q[1]);
                  if (seen[a][2] !== seen[b][2] && wide > 3 && high > 4)
                    found.push(`${seen[a][1]} | ${seen[b][1]}`);
                }
              return found;
            }"""
        )
    )


def test_from_nothing_to_a_leak_named_added_and_exported(
    browser: Browser, server: Server, tmp_path: Path
) -> None:
    page, watch = open_page(browser, server)
    pictures: list[bytes] = []
    # a name with markup is words, and what cannot be read says why
    pick(page, "Recordings", "<img src=x onerror=alert(1)>.csv")
    pick(page, "Rig file", RIG)
    button(page, "Open").click()
    expect(page.get_by_role("alert").filter(has_text="onerror=alert(1)")).to_be_visible(
        timeout=LONG_MS
    )
    page.get_by_label("Recordings").press("Backspace")
    # a recording that was cut short, dropped onto the page
    page.get_by_text("A recording from elsewhere").click()
    lab = Path(server.process.args[server.process.args.index("--folder") + 1])  # type: ignore
    with page.expect_file_chooser() as chooser:
        page.locator(".q-uploader").get_by_role("button").last.click()
    chooser.value.set_files(lab / "cut.mcap")
    expect(page.get_by_text("cut.mcap").first).to_be_visible()
    button(page, "Open").click()
    expect(page.get_by_role("alert").filter(has_text="cut")).to_be_visible(timeout=LONG_MS)
    page.reload()
    # the true one
    pick(page, "Recordings", BAG if PICTURES else SHORT)
    pick(page, "Rig file", RIG)
    button(page, "Open").click()
    opened = page.get_by_text(f"rig_a_fitted: {TIMES}", exact=False)
    expect(opened.first).to_be_visible(timeout=LONG_MS)
    first = _drawn(page)
    # what is no longer there, as a strength that was tried, is nothing, and no error
    stale = "fetch('signals?begin=0&end=1&columns=10&trial=true').then((r) => r.status)"
    assert page.evaluate(stale) == 204
    # a regime is chosen, and all that is shown is of it; then all again
    page.get_by_role("button", name="flow direction, fill", exact=True).click()
    expect(page.get_by_text("Only: flow direction, fill")).to_be_visible()
    expect(page.get_by_text("of flow direction, fill", exact=True)).to_be_visible()
    page.wait_for_function(f"document.querySelector('.pneu-chart').dataset.shown > {first}")
    button(page, "Show all readings").click()
    expect(page.get_by_text("of all readings", exact=True)).to_be_visible()
    first = _drawn(page)
    _picture(page, pictures)
    page.get_by_role("button", name=re.compile(r"^end, .* x noise")).first.click()
    page.wait_for_function(f"document.querySelector('.pneu-chart').dataset.shown > {first}")
    page.locator(".pneu-chart").focus()
    page.keyboard.press("Home")
    page.keyboard.press("+")
    expect(page.locator(".pneu-chart")).to_have_attribute(
        "aria-label", re.compile(r"^Signals from")
    )
    # cancelled, begun again, and found running by a page that is loaded anew and by another
    expect(page.get_by_text(re.compile(r"^That takes about \d"))).to_be_visible()
    button(page, "Find what is missing").click()
    expect(button(page, "Cancel")).to_be_visible()
    expect(page.get_by_text(re.compile(r"\d:\d\d of about \d"))).to_be_visible()
    button(page, "Cancel").click()
    expect(page.get_by_role("alert").filter(has_text="cancelled")).to_be_visible()
    button(page, "Find what is missing").click()
    expect(button(page, "Cancel")).to_be_visible()
    page.reload()
    named = "Missing: leak of a line to the room"

    def runs_or_has_run(one):  # a busy machine may show a page only after the search has ended
        runs = one.get_by_role("status").filter(has_text="what is missing")
        expect(runs.or_(one.get_by_text(named)).first).to_be_visible()

    runs_or_has_run(page)
    other, other_watch = open_page(browser, server, 420, color_scheme="dark")
    runs_or_has_run(other)
    for one in (page, other):
        expect(one.get_by_text(named)).to_be_visible(timeout=LONG_MS)
    # what it would explain, drawn before it is added; added, undone, done again
    before = _drawn(page)
    button(page, "Draw 1").click()
    page.wait_for_function(f"document.querySelector('.pneu-chart').dataset.shown > {before}")
    _picture(page, pictures)
    button(page, "Add 1").click()
    expect(page.get_by_role("status").filter(has_text="fitting what was added")).to_be_visible(
        timeout=LONG_MS
    )
    _picture(page, pictures)
    expect(page.get_by_text(re.compile(rf"^before: {TIMES}"))).to_be_visible(timeout=LONG_MS)
    fallen = page.get_by_text(re.compile(r"^error over noise: .*end [34]\d\.\d to 1\.\d")).first
    expect(fallen).to_be_visible()
    _picture(page, pictures)
    button(page, "Undo").click()
    expect(page.get_by_text(re.compile(r"^before:"))).to_have_count(0)
    expect(page.get_by_text("Missing: leak of a line to the room")).to_be_visible()
    button(page, "Redo").click()
    expect(page.get_by_text(re.compile(rf"^before: {TIMES}"))).to_be_visible()
    # the model run at another strength, as the slider moves
    button(page, "Try other strengths").click()
    expect(page.get_by_role("slider")).to_be_visible(timeout=LONG_MS)
    for _ in range(20):  # of ten notches of 200 each: down to no leak at all
        page.locator(".q-slider [tabindex]").press("PageDown")
    expect(page.get_by_text(re.compile(r"^0: .*end [34]\d\.\d"))).to_be_visible(timeout=LONG_MS)
    button(page, "Keep this strength").click()
    fixed = page.get_by_text(re.compile(rf"^leak of a line to the room fixed at 0.*: {TIMES}"))
    expect(fixed.first).to_be_visible(timeout=LONG_MS)
    # any two versions beside each other
    button(page, "Draw beside: rig_a_fitted").click()
    expect(page.get_by_text(re.compile(rf"^beside, rig_a_fitted: {TIMES}"))).to_be_visible()
    button(page, "Draw beside: rig_a_fitted").click()
    expect(page.get_by_text(re.compile(r"^before: \d"))).to_be_visible()
    button(page, "Undo").click()
    expect(page.get_by_text(re.compile(rf"^before: {TIMES}"))).to_be_visible()
    with page.expect_download() as download:
        button(page, "Rig file").click()
    download.value.save_as(tmp_path / "rig.yaml")
    (leak,) = load_rig(tmp_path / "rig.yaml").effects
    assert leak.place == "tube"
    assert leak.parameters["position_m"] == pytest.approx(2.4, abs=0.2)
    with page.expect_download() as download:
        button(page, "Report").click()
    assert "leak" in Path(download.value.path()).read_text(encoding="utf-8")
    # on a telephone and in the dark as well
    expect(other.get_by_text(re.compile(rf"^before: {TIMES}"))).to_be_visible()
    for one in (page, other):
        _drawn(one)
        assert _serious(one) == []
        assert _too_wide(one) == []
        assert _over_each_other(one) == []
    assert watch.faults == [] and other_watch.faults == []
    _strip(pictures)


@pytest.mark.long
def test_a_rig_is_edited_and_its_channels_are_matched(browser: Browser, server: Server) -> None:
    page, watch = open_page(browser, server)
    pick(page, "Recordings", BAG)
    page.get_by_text("Edit the rig, begin one, match channels").click()
    # from a template: what is wrong is said while it is typed
    page.get_by_label("Begin from").click()
    page.get_by_role("option", name=re.compile("^new: A valve .* with a closed end")).click()
    button(page, "Edit").click()
    page.get_by_text("pipes", exact=True).click()
    length = page.get_by_label("pipes, tube: length, mm")
    for wrong in ("-3", "long"):
        length.fill(wrong)
        expect(page.get_by_role("alert").filter(has_text="length")).to_be_visible()
        expect(button(page, "Use this rig")).to_be_disabled()
    length.fill("2600")
    expect(button(page, "Use this rig")).to_be_enabled()
    expect(page.get_by_text("tube, 2.6 m")).to_be_visible()
    page.get_by_text("channels of the recording").click()
    button(page, "Look into the recording").click()
    end = page.get_by_label(re.compile(r"^tap \w+: signal")).first
    end.click(timeout=LONG_MS)
    end.fill("/taps/end/pressure fluid")
    page.get_by_role("option", name="/taps/end/pressure fluid_pressure").click()
    expect(page.get_by_text("1 to 6.73 bar absolute")).to_be_visible()
    expect(page.get_by_label("Outline of /taps/end/pressure fluid_pressure")).to_be_visible()
    # what is open, edited: another version of it
    page.get_by_label("Begin from").click()
    page.get_by_role("option", name="what is open, or the chosen file").click()
    button(page, "Edit").click()
    expect(page.get_by_label("pipes, supply_line: length, mm")).to_be_attached()
    page.get_by_text("pipes", exact=True).click()
    expect(length).to_have_value("2500")
    length.fill("3200")
    assert _serious(page) == []
    button(page, "Use this rig").click()
    edited = page.get_by_text(re.compile(r"^pipes, tube length 3200 mm: \d+"))
    expect(edited.first).to_be_visible(timeout=LONG_MS)
    assert _over_each_other(page) == []
    assert watch.faults == []


def test_without_the_token_there_is_nothing(server: Server) -> None:
    address = server.address.partition("?")[0]
    for path in ("", "signals?begin=0&end=1&columns=10", "uplot.css", "?token=guessed"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(address + path, timeout=10.0)
        assert refused.value.code == 403
