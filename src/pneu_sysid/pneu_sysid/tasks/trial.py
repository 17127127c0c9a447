# SPDX-License-Identifier: Apache-2.0
"""A model run again and again with other strengths of the effect that was added last.

A process of its own, because it holds the recordings and compiled models ready. It reads one line
of JSON, ``{"bags": […], "rig": …, "workers": …}``, and answers with the strength that the rig has
and the range in which it may be tried, or with ``{"fault": …}``. Then every line ``{"strength": …,
"file": …}`` is answered with the error of each sensor over its noise once the signals are in the
file; of several lines that wait, the last alone. It ends with its standard input.
"""

import json
import os
import sys
import threading
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.fit import sensor_times_noise
from pneu_sysid.problem import Problem, make_problem, record_for
from pneu_sysid.tasks.child import answering
from pneu_sysid.tasks.signals import save_signals, signals_of
from pneu_sysid.tasks.strength import range_of, with_strength


class _Latest:
    """The last line that was read and not taken yet."""

    def __init__(self, source: TextIO) -> None:
        self._source = source
        self._line: str | None = None
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self._source:
            with self._news:
                self._line = line
                self._news.notify()
        os._exit(0)  # whoever asked is gone

    def take(self) -> str:
        with self._news:
            while self._line is None:
                self._news.wait()
            line, self._line = self._line, None
            return line


def _tried(problem: Problem, rig: Rig, asked: dict[str, Any]) -> dict[str, Any]:
    other = with_strength(rig, float(asked["strength"]))
    readings = problem.predict([other])[0]
    save_signals(signals_of(problem, other, readings), Path(asked["file"]))
    every = np.ones(problem.stretches, dtype=bool)
    return {**asked, "errors": sensor_times_noise(problem, readings, every)}


def main() -> None:
    """Serves whoever started this process."""
    say = answering()
    asked = json.loads(sys.stdin.readline())
    latest = _Latest(sys.stdin)
    try:
        rig = load_rig(asked["rig"])
        told = range_of(rig)
        recordings = [record_for(rig, bag) for bag in asked["bags"]]
        problem = make_problem(rig, recordings, workers=asked["workers"] or None)
        say(told)
        while True:
            say(_tried(problem, rig, json.loads(latest.take())))
    except InputError as error:
        say({"fault": str(error)})


if __name__ == "__main__":
    main()
