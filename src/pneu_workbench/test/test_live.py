# SPDX-License-Identifier: Apache-2.0
"""What came in of late, as a recording; and what the page knows of a graph."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.problem import record_for
from pneu_sysid.records.write import write_bag
from pneu_workbench.live.link import SHOWN_S, Course, Live
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


def test_a_rig_that_is_wrong_is_not_listened_to(tmp_path: Path) -> None:
    live = Live(tmp_path, lambda: None)
    with pytest.raises(InputError, match="no such rig file"):
        live.listen(tmp_path / "no.yaml")
    assert not live.listening
    live.close()
