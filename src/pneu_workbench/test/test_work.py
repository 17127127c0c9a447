# SPDX-License-Identifier: Apache-2.0
"""A session without a page: versions, what is kept and refused; and one on a real recording."""

import json
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.coarse import coarsened
from tests.short_bags import shorten

from pneu_common.errors import InputError
from pneu_workbench.packed import SESSION, unpack
from pneu_workbench.versions import Version, Versions
from pneu_workbench.view import Part
from pneu_workbench.work import Work

pytestmark = pytest.mark.takes(15)

ROOT = Path(__file__).resolve().parents[3]
SECONDS = 6.0
"""Length of the recording, s: long enough for readings in all regimes."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> str:
    short = tmp_path_factory.mktemp("bag") / "a_leak.mcap"
    shorten(ROOT / "data" / "bags" / "a_leak" / "a_leak.mcap", short, SECONDS)
    return str(short)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> str:
    coarse = tmp_path_factory.mktemp("rig") / "rig_a_fitted.yaml"
    whole = ROOT / "rigs" / "rig_a_fitted.yaml"
    return str(coarsened(whole, coarse, dx_m=0.125, memory=False))


def _version(title: str) -> Version:
    return Version(0, None, title, f"folder_{title}", f"{title}.yaml")


def test_versions_are_a_tree() -> None:
    v = Versions()
    for title in ("base", "leak", "lag"):
        v.add(_version(title))
    assert v.undo() and v.undo() and not v.undo()
    assert v.now is not None and v.now.title == "base"
    assert v.redo() and v.redo() and not v.redo()
    assert v.now.title == "lag"
    v.go(0)
    v.add(_version("friction"))  # a second branch
    assert not v.redo()
    assert [(depth, one.title) for depth, one in v.tree()] == [
        (0, "base"), (1, "leak"), (2, "lag"), (1, "friction")
    ]  # fmt: skip
    assert v.before is not None and v.before.title == "base"
    with pytest.raises(IndexError):
        v.go(4)


def _until_done(work: Work, seconds: float = 240.0) -> None:
    end = time.monotonic() + seconds
    while work.task is not None and work.task.running:
        assert time.monotonic() < end, "the task did not end"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory, bag: str, rig: str) -> Iterator[Work]:
    """A session with an open recording; tests leave its versions as they are."""
    work = Work(tmp_path_factory.mktemp("opened") / "session", workers=1)
    work.open([bag], rig)
    _until_done(work)
    assert work.task is not None and work.task.fault == ""
    yield work
    work.close()


def test_what_cannot_be_done_is_said(tmp_path: Path, rig: str) -> None:
    work = Work(tmp_path / "session")
    with pytest.raises(InputError, match="none was chosen"):
        work.open([], rig)
    for what in (work.suspect, work.report, work.rig_text):
        with pytest.raises(InputError, match="nothing is open yet"):
            what()
    with pytest.raises(InputError, match="found 0, there are 0 to add"):
        work.add(0)
    work.undo()
    work.cancel()  # nothing goes on
    assert (
        work.view.comparison() is None
        and work.view.sensors() == []
        and work.view.span_s() == (0.0, 0.0)
    )


def test_a_session_that_is_none_is_refused(tmp_path: Path) -> None:
    for text in ("", "{}", '{"pneu_workbench": 99}', '{"pneu_workbench": 1, "versions": 3}'):
        (tmp_path / SESSION).write_text(text)
        with pytest.raises(InputError, match="is no session of the workbench"):
            Work(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made a folder"):
        Work(tmp_path / "file")


def test_a_recording_is_opened_kept_and_come_back_to(
    tmp_path: Path, bag: str, opened: Work
) -> None:
    work = opened
    now = work.versions.now
    assert now is not None and now.added == 0 and now.parent is None
    assert now is not None and now.title == "rig_a_fitted"
    assert [name for name, *_ in work.view.sensors()] == list(now.times_noise)
    begin, end = work.view.span_s()
    measured, model, residual = (
        work.view.pyramid(kind, "end").shown(begin, end, 100_000)  # type: ignore[arg-type]
        for kind in ("measured", "model", "residual")
    )
    noise = next(n for name, _, n in work.view.sensors() if name == "end")
    np.testing.assert_array_equal(measured[0], model[0])
    expected = (measured[1].astype(float) - model[1]) / noise
    np.testing.assert_allclose(residual[1], expected, atol=0.05)
    # what is drawn is what the table says: 46 times the noise at the closed end
    assert np.sqrt(np.mean(residual[1] ** 2)) == pytest.approx(now.times_noise["end"], rel=0.02)
    volts = work.view.pyramid("command", "voltage").shown(begin, end, 100_000)
    assert 0.0 <= volts[1].min() < volts[1].max() <= 10.0
    with pytest.raises(KeyError):
        work.view.pyramid("candidate", "end", 0)
    # what is told of all time by hand is what the comparison says of every regime
    rows = {row.key: row for row in work.view.map(Part())}
    within = {row.key: row for row in work.view.map(Part(begin - 1.0, end + 1.0))}
    assert {key[0] for key in rows} >= {"flow_direction", "choked", "opening", "pressure"}
    for key, row in rows.items():
        assert row.chosen == (key[0] != "frequency")
        assert within[key].times_noise == pytest.approx(row.times_noise, rel=1e-5), key
    fill = ("flow_direction", "", "fill")
    shown = work.view.pyramid("measured", "end", None, fill).shown(begin, end, 100_000)
    assert 0.1 < np.isfinite(shown[1]).mean() < 0.9
    alone = work.view.errors(Part(regime=fill))
    assert alone["end"] == pytest.approx(rows[fill].times_noise["end"], rel=1e-5)
    everything = work.view.errors(Part())
    assert everything == pytest.approx(now.times_noise, rel=1e-5)
    # another part is kept aside by hand: the same version, judged by other stretches
    assert work.view.errors(Part(), beside=True) == {}
    work.keep_aside([(3.0, 6.0)])
    _until_done(work)
    assert work.task.fault == "" and len(work.versions.all) == 1
    ((kept_from, kept_to),) = work.view.kept_aside()
    assert (kept_from, kept_to) == (pytest.approx(3.0, abs=0.6), pytest.approx(6.0, abs=0.6))
    assert any("--aside 3:6" in words for words in work.words())
    work.keep_aside([(90.0, 95.0)])
    _until_done(work)
    assert "none of the 11 stretches" in work.task.fault
    assert work.kept_aside == [(3.0, 6.0)]
    assert work.report().read_text(encoding="utf-8").startswith("<!doctype html>")
    # as one small file it is all that is needed to come back, elsewhere too
    packed = work.packed()
    assert packed.stat().st_size < 0.1 * sum(
        p.stat().st_size for p in packed.parent.rglob("*") if p.is_file() and p != packed
    )
    unpack(packed, tmp_path / "elsewhere")
    other = Work(tmp_path / "elsewhere", workers=1)
    assert other.view.comparison() == work.view.comparison()
    _until_done(other)  # the model is run again, for its signals
    assert other.task is not None and other.task.fault == ""
    assert other.view.errors(Part()) == pytest.approx(work.view.errors(Part()), rel=1e-6)
    assert other.versions.now is not None and other.versions.now.title == now.title
    with pytest.raises(InputError, match="is there already"):
        unpack(packed, tmp_path / "elsewhere")
    again = Work(work.folder)
    assert again.kept_aside == [(3.0, 6.0)]
    assert again.versions == work.versions and again.bags == [bag]
    assert again.view.span_s() == work.view.span_s()


def test_a_file_that_is_no_session_is_refused(tmp_path: Path) -> None:
    for name, files in {
        "empty": {},
        "words": {SESSION: "hello"},
        "out": {SESSION: '{"versions": {"all": [{"folder": "../../out"}]}}'},
        "gone": {SESSION: '{"versions": {"all": [{"folder": "look"}]}}'},
    }.items():
        file = tmp_path / f"{name}.zip"
        with zipfile.ZipFile(file, "w") as out:
            for inside, text in files.items():
                out.writestr(inside, text)
        with pytest.raises(InputError, match="is no session of the workbench"):
            unpack(file, tmp_path / name)
        assert not (tmp_path / name).exists()
    (tmp_path / "text.zip").write_text("no archive")
    with pytest.raises(InputError, match="is no session of the workbench"):
        unpack(tmp_path / "text.zip", tmp_path / "text")


def test_what_was_open_is_back_where_another_recording_is_not_opened(
    opened: Work, bag: str, rig: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was measured is shown before the model has run, and gone again where it never does."""
    work = opened
    before = work.versions.now
    assert before is not None
    early: list[bool] = []

    def changed(keep: bool = True, really: Callable[..., None] = work._changed) -> None:
        really(keep)
        if work.view._seen.early and not early:
            early.append(work.versions.now is None)
            assert [name for name, *_ in work.view.sensors()] == list(before.times_noise)
            model = work.view.pyramid("model", "end").shown(0.0, 20.0, 4000)
            measured = work.view.pyramid("measured", "end").shown(0.0, 20.0, 4000)
            early.extend([bool(np.isnan(model[1]).all()), bool(np.isfinite(measured[1]).all())])
            work.cancel()

    monkeypatch.setattr(work, "_changed", changed)
    work.open([bag], rig)
    _until_done(work)
    assert early == [True, True, True]
    assert work.task is not None and work.task.fault == "cancelled"
    assert work.versions.now == before and work.bags == [bag]
    assert work.view.errors(Part())["end"] > 10.0


def test_a_task_that_fails_or_is_cancelled_leaves_nothing(
    tmp_path: Path, bag: str, rig: str
) -> None:
    work = Work(tmp_path / "session", workers=1)
    work.open([bag], str(tmp_path / "no.yaml"))
    _until_done(work)
    assert work.task is not None and "there is no such file" in work.task.fault
    assert work.versions.now is None
    work.open([bag], rig)
    with pytest.raises(InputError, match="is still going on; cancel it, or wait"):
        work.open([bag], rig)
    end = time.monotonic() + 60.0
    while work.task is not None and work.task.stage == "starting" and time.monotonic() < end:
        time.sleep(0.02)
    work.cancel()
    _until_done(work, 20.0)
    assert work.task is not None and work.task.fault == "cancelled"
    assert work.versions.now is None
    left = [p.name for p in (tmp_path / "session").iterdir() if p.name != SESSION]
    assert left == []
    state = json.loads((tmp_path / "session" / SESSION).read_text(encoding="utf-8"))
    assert state["bags"] == []
