# SPDX-License-Identifier: Apache-2.0
"""What came in of late, as a recording; and what the page knows of a graph."""

import math
import os
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pneu_common.entry import COMMAND
from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.problem import record_for
from pneu_sysid.records.write import write_bag
from pneu_workbench.live import link
from pneu_workbench.live.link import SHOWN_S, Course, Live, Status
from pneu_workbench.live.samples import KEPT_S, Samples

ROOT = Path(__file__).resolve().parents[3]
RIG = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
BEGIN_S = 1.79e9


def _samples(seconds: float, step_s: float = 0.01) -> Samples:
    samples = Samples(RIG)
    samples.add("voltage", BEGIN_S, 3.0)
    for k in range(round(seconds / step_s)):
        at = BEGIN_S + step_s * k
        if k == round(seconds / step_s) // 2:
            samples.add("voltage", at, 7.0)
        for tap in ("supply", "valve_out", "middle", "end", "exhaust"):
            samples.add(tap, at, 1e5 + 100.0 * k)
    return samples


def test_the_last_seconds_are_a_recording(tmp_path: Path) -> None:
    samples, rig = _samples(8.0), RIG
    samples.add("end", BEGIN_S + 9.0, math.nan)
    samples.add("nobody", BEGIN_S + 9.0, 1.0)
    last = samples.last(2.0)
    assert last.start_time_s == pytest.approx(BEGIN_S + 5.99, abs=1e-6)
    end = last.pressures["end"]
    assert (end.time_s[0], end.time_s[-1]) == pytest.approx((0.0, 2.0), abs=1e-6)
    assert end.values[-1] == 1e5 + 100.0 * 799
    # the command that holds when the part begins was sent long before
    assert last.commands["voltage"].values.tolist() == [7.0]
    assert last.commands["voltage"].time_s[0] < 0.0
    assert samples.last(6.0).commands["voltage"].values.tolist() == [3.0, 7.0]
    # as a bag it is read like any other
    write_bag(tmp_path / "live.mcap", rig, samples.last(6.0))
    again = record_for(rig, str(tmp_path / "live.mcap"))
    assert again.end_s - again.start_s == pytest.approx(6.0, abs=0.02)
    np.testing.assert_allclose(again.pressures["end"].values[-3:], [179700.0, 179800.0, 179900.0])


def test_what_is_old_is_forgotten_but_for_the_command_that_holds() -> None:
    samples = _samples(KEPT_S + 40.0, 0.1)
    last = samples.last(1e6)
    assert last.pressures["end"].time_s[-1] - last.pressures["end"].time_s[0] < KEPT_S + 0.3
    assert last.commands["voltage"].values.tolist() == [3.0, 7.0]


def test_time_that_begins_anew_forgets_what_was() -> None:
    samples = _samples(5.0)
    samples.add("end", BEGIN_S - 100.0, 1e5)
    with pytest.raises(InputError, match="no readings, or no commands, came in yet"):
        samples.last(5.0)
    samples.add("voltage", BEGIN_S - 99.99, 5.0)
    assert samples.last(5.0).pressures["end"].values.tolist() == [1e5]


def _window(end_s: float, **other: Any) -> dict[str, Any]:
    time = np.linspace(end_s - 0.5, end_s, 50).tolist()
    names = list(RIG.taps)
    courses = {name: [time, [2e5] * 50, [2.1e5] * 50] for name in names}
    of = dict.fromkeys(names, 500.0)
    window = dict(end_s=end_s, level=2, times=9.5, worst="end", noise=of, rms=of, courses=courses)
    return {"window": window | other}


def test_what_is_shown_is_of_late(tmp_path: Path) -> None:
    changed: list[int] = []
    live = Live(tmp_path, lambda: changed.append(1))
    with pytest.raises(InputError, match="nothing is listened to"):
        live.take(5.0, lambda path: None)
    assert live.shown() == ({}, {}) and live.state() == []
    live._forget()
    live.courses = {name: Course("Pa") for name in RIG.taps}
    for k in range(200):
        live._heard(_window(BEGIN_S + 0.5 * (k + 1)))
    sensors, _ = live.shown()
    time, measured, model, noise = sensors["end"]
    assert time[-1] == pytest.approx(100.0, abs=0.01)  # from the first window
    assert SHOWN_S - 1.0 <= time[-1] - time[0] <= SHOWN_S + 1.0
    assert (measured[0], model[0], noise) == (2e5, 2.1e5, 500.0)
    assert (live.level, live.times, live.worst) == (2, 9.5, "end")
    live._heard(_window(BEGIN_S - 1000.0))  # a simulation that was begun anew
    assert live.shown()[0]["end"][0].size == 50
    live._heard({"status": [["bridge: link", 2, "lost"], ["pid: pressure", 0, "well"]]})
    assert live.state() == [("bridge: link", 2, "lost"), ("pid: pressure", 0, "well")]
    live.statuses["bridge: link"].heard_s -= 60.0
    assert live.state()[0] == ("bridge: link", 3, "not heard for 60 s")
    live._heard({"fault": "the model cannot be run along"})
    assert live.fault == "the model cannot be run along"
    assert len(changed) > 200


@pytest.fixture
def changes() -> list[int]:
    """Grows with each change that a page hears of."""
    return []


@pytest.fixture
def live(tmp_path: Path, changes: list[int], monkeypatch: pytest.MonkeyPatch) -> Live:
    """What a page knows, by a steady clock that stands at 100 s."""
    monkeypatch.setattr(link, "time", SimpleNamespace(monotonic=lambda: 100.0))
    made = Live(tmp_path, lambda: changes.append(1))
    made.courses = {name: Course("Pa") for name in RIG.taps}
    made.commands = {"voltage": deque(), "other": deque()}
    return made


def test_commands_are_kept_from_the_one_that_holds_where_what_is_shown_begins(
    live: Live, changes: list[int]
) -> None:
    def held() -> list[tuple[float, float]]:
        return list(live.commands["voltage"])

    live._heard({"commands": {"voltage": []}})
    assert held() == []
    live._heard({"commands": {"voltage": [[0, 1]], "other": [[3.0, 9.0]]}})
    live._heard({"commands": {"voltage": [[50.0, 2.0]]}})  # the first one held until then
    assert held() == [(0.0, 1.0), (50.0, 2.0)]
    live._heard({"commands": {"voltage": [[80.0, 3.0]]}})  # and the second is not too old yet
    assert held() == [(0.0, 1.0), (50.0, 2.0), (80.0, 3.0)]
    live._heard({"commands": {"voltage": [[81.0, 4.0], [90.0, 5.0]]}})
    assert held() == [(50.0, 2.0), (80.0, 3.0), (81.0, 4.0), (90.0, 5.0)]
    live._heard({"commands": {"voltage": [[111.0, 6.0], [112.0, 7.0]]}})
    assert held() == [(81.0, 4.0), (90.0, 5.0), (111.0, 6.0), (112.0, 7.0)]
    assert list(live.commands["other"]) == [(3.0, 9.0)]
    assert changes == []  # they are shown with the next window
    live._origin_s = 80.0
    _, shown = live.shown()
    assert shown["voltage"].tolist() == [[1.0, 10.0, 31.0, 32.0], [4.0, 5.0, 6.0, 7.0]]
    assert shown["other"].tolist() == [[-77.0], [9.0]]
    live._heard({"commands": {"other": []}})
    live.commands["other"].clear()
    assert live.shown()[1]["other"].shape == (2, 0)


def test_only_a_new_number_of_samples_is_a_change(live: Live, changes: list[int]) -> None:
    assert (live.samples, live.level, live.times) == (0, -1, None)
    live._heard({"alive": 0})
    assert (live.samples, len(changes)) == (0, 0)
    live._heard({"alive": 5})
    assert (live.samples, len(changes)) == (5, 1)
    live._heard({"alive": 5})
    assert (live.samples, len(changes)) == (5, 1)
    live._heard({"alive": 4})  # begun anew
    assert (live.samples, len(changes)) == (4, 2)


def test_what_is_told_once_is_taken_once(live: Live, changes: list[int]) -> None:
    live._heard({"fault": "no graph"})
    live._heard({"status": [["pid", 1, "late"]]})
    assert live.fault == "no graph"
    live._heard({"namespace": "/rig"})
    assert (live.namespace, live.fault) == ("/rig", "")
    assert live.statuses == {"pid": Status(1, "late", 100.0)}
    got: list[str] = []
    live._taken = got.append
    live._heard({"taken": "a.mcap"})
    live._heard({"taken": "b.mcap"})
    assert got == ["a.mcap"]
    assert len(changes) == 5


def test_a_window_says_how_well_the_model_does(live: Live) -> None:
    live.fault = "nothing came in"
    live._heard(_window(20.0, level=1, times=None, worst="middle"))
    assert (live.level, live.times, live.worst, live.fault) == (1, None, "middle", "")
    other = dict.fromkeys(RIG.taps, 7.0)
    live._heard(_window(20.5, noise={**other, "end": None}, rms={**other, "middle": None}))
    end, middle = live.courses["end"], live.courses["middle"]
    assert (end.rms, middle.noise) == (7.0, 7.0)
    assert math.isnan(end.noise) and math.isnan(middle.rms)
    assert live._origin_s == 19.5  # where the first one begins
    assert live.shown()[0]["end"][0].tolist() == pytest.approx(
        [*np.linspace(0.0, 0.5, 50), *np.linspace(0.5, 1.0, 50)]
    )


def test_windows_are_kept_for_as_long_as_they_are_shown(live: Live) -> None:
    empty: dict[str, list[list[float]]] = {name: [[], [], []] for name in RIG.taps}
    live._heard(_window(10.0, courses=empty))
    assert (live._origin_s, len(live.courses["end"].parts)) == (0.0, 1)
    live._heard(_window(10.0))
    live._heard(_window(40.0))  # the first ends just as long ago as is shown
    assert [part[0][-1] for part in live.courses["end"].parts if part[0].size] == [10.0, 40.0]
    live._heard(_window(40.5, courses=empty))
    assert [part[0].size for part in live.courses["end"].parts] == [50, 0]
    live._heard(_window(40.5))  # begins when the newest ended: time goes on
    assert [part[0].size for part in live.courses["end"].parts] == [50, 0, 50]
    live._heard(_window(40.9))  # begins before: time began anew
    assert [part[0][-1] for part in live.courses["end"].parts] == [40.9]
    live._heard(_window(71.0))  # too long after for the one before to be seen
    assert [part[0][-1] for part in live.courses["end"].parts] == [71.0]
    live.courses["end"].parts.clear()
    live._heard(_window(100.0, courses=empty))
    assert [part[0].size for part in live.courses["end"].parts] == [0]


@pytest.mark.parametrize(
    ("silent_s", "level", "words"),
    [(0.0, 1, "late"), (4.9, 1, "late"), (5.0, 3, "not heard for 5 s"), (7.6, 3, None)],
)
def test_a_status_is_gone_when_it_was_not_heard(
    live: Live, silent_s: float, level: int, words: str | None
) -> None:
    live.statuses["pid"] = Status(1, "late", 100.0 - silent_s)
    assert live.state() == [("pid", level, words or "not heard for 8 s")]


def test_the_worst_status_comes_first_then_by_name(live: Live) -> None:
    live._heard({"status": [["c", 1, "x"], ["b", 0, "y"], ["d", 2, "z"], ["a", 0, "w"]]})
    assert [name for name, *_ in live.state()] == ["d", "c", "a", "b"]


def test_a_listening_node_that_ends_by_itself_is_a_fault(live: Live, changes: list[int]) -> None:
    class Told:
        said: list[dict[str, Any]]

        def __init__(self) -> None:
            self.said = []

        def say(self, line: dict[str, Any]) -> None:
            self.said.append(line)

    child = Told()
    live._child = child  # type: ignore[assignment]
    assert live.listening
    live.take(5.0, lambda path: None)
    live.take(2.5, lambda path: None)
    folder = live._folder
    assert child.said == [
        {"take": 5.0, "to": str(folder / f"live_1_{os.getpid()}.mcap")},
        {"take": 2.5, "to": str(folder / f"live_2_{os.getpid()}.mcap")},
    ]
    live._gone(0, True)
    assert (live.fault, live.listening, len(changes)) == ("", True, 1)
    live._gone(3, False)
    assert (live.fault, live.listening) == ("the listening node ended with status 3", False)
    assert len(changes) == 2
    live.fault = "no graph"
    live._gone(3, False)
    assert live.fault == "no graph"


def test_one_recording_at_a_time(live: Live, changes: list[int]) -> None:
    class Ended:
        """A recorder that has a bag, or none."""

        bag = Path("some/bag")

        def __init__(self, there: bool) -> None:
            self._there = there

        def end(self, then: Any) -> None:
            then(self._there)

    assert live.recording == ""
    got: list[str] = []
    live.stop_recording(got.append)
    assert (got, changes) == ([], [])
    for there in (True, False):
        live._recorder = Ended(there)  # type: ignore[assignment]
        assert live.recording == "some/bag"
        with pytest.raises(InputError, match=r"^recording: one goes on already$"):
            live.record()
        live.stop_recording(got.append)
        assert live.recording == "" and got == ["some/bag"]
    assert live.fault == "recording: nothing came in that could be written"
    assert len(changes) == 4


@pytest.mark.parametrize(
    ("out", "error", "lines"),
    [
        ("a: torques are zero\n\nb: safe\n", "", ["a: torques are zero", "b: safe"]),
        (" \n", 400 * "x" + "no graph\n", ["NOT CONFIRMED: " + 292 * "x" + "no graph"]),
    ],
)
def test_what_a_stop_was_answered_with(
    live: Live, monkeypatch: pytest.MonkeyPatch, out: str, error: str, lines: list[str]
) -> None:
    program = "import sys; sys.stdout.write(sys.argv[-2]); sys.stderr.write(sys.argv[-1])"
    asked: list[list[str]] = []
    real = subprocess.run

    def run(words: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        asked.append(words)
        return real([sys.executable, "-I", "-S", "-c", program, out, error], **options)

    monkeypatch.setattr(subprocess, "run", run)
    before = set(threading.enumerate())
    live.e_stop()
    for thread in set(threading.enumerate()) - before:
        thread.join()
    assert asked == [[*COMMAND, "stop", "--reason", "workbench"]]
    assert live.stopped == lines


def test_a_rig_that_is_wrong_is_not_listened_to(tmp_path: Path) -> None:
    live = Live(tmp_path, lambda: None)
    with pytest.raises(InputError, match="no such rig file"):
        live.listen(tmp_path / "no.yaml")
    assert not live.listening
    live.close()
