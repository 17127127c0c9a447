# SPDX-License-Identifier: Apache-2.0
"""Progress of long work: a bar per stage on a terminal, now and then a line elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import Protocol

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

FIRST_AFTER_S = 2.0
"""Work that ends sooner is not worth a line."""
EVERY_S = 10.0
"""Lines are at least this far apart."""
SETTLED = 0.02
"""Share of a stage after which what is left can be estimated."""


class Tell(Protocol):
    """Called with a stage, the fraction of it that is done if known, and how it stands."""

    def __call__(self, stage: str, fraction: float | None = None, note: str = "") -> None:
        """Take it down."""


@contextmanager
def progress(first: str) -> Iterator[Tell]:
    """Has long work tell how far it is, on standard error.

    Args:
        first: What is done until the first stage is told.

    Yields:
        What is to be called with each stage, from one thread at a time.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        with _Lines(first) as lines:
            yield lines.tell
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
        transient=True,
    ) as bar:
        beginning = bar.add_task(escape(first), total=None, note="")
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, fraction: float | None = None, note: str = "") -> None:
            bar.update(beginning, visible=False)
            if stage not in tasks:
                tasks[stage] = bar.add_task(escape(stage), total=1.0, note="")
            bar.update(tasks[stage], completed=fraction, note=escape(note))

        yield tell


class _Lines:
    """Lines for a file or a pipe: what is done, since when, and what is left of it."""

    def __init__(self, first: str) -> None:
        self._begun_s = self._stage_s = time.monotonic()
        self._stage, self._note = first, ""
        self._fraction: float | None = None
        self._told = False
        self._lock = Lock()
        self._ended = Event()
        self._thread = Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> "_Lines":
        self._thread.start()
        return self

    def __exit__(self, fault: type[BaseException] | None, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        if self._told and fault is None:
            _say(f"done after {clock(time.monotonic() - self._begun_s)}")

    def tell(self, stage: str, fraction: float | None = None, note: str = "") -> None:
        with self._lock:
            if stage != self._stage:
                self._stage, self._stage_s = stage, time.monotonic()
            self._fraction, self._note = fraction, note

    def _run(self) -> None:
        pause_s = FIRST_AFTER_S
        while not self._ended.wait(pause_s):
            with self._lock:
                text = self._text(time.monotonic())
            _say(text)
            self._told, pause_s = True, EVERY_S

    def _text(self, now_s: float) -> str:
        words = [f"{self._stage}: {clock(now_s - self._begun_s)} so far"]
        if self._fraction is not None:
            words.append(f"{100.0 * self._fraction:.0f} % done")
            if SETTLED < self._fraction < 1.0:
                left_s = (now_s - self._stage_s) * (1.0 / self._fraction - 1.0)
                words.append(f"about {clock(left_s)} left of this")
        if self._note:
            words.append(self._note)
        return ", ".join(words)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def clock(seconds: float) -> str:
    """A length of time as minutes and seconds, with hours where there are any.

    Args:
        seconds: It, s.
    """
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
