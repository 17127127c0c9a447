# SPDX-License-Identifier: Apache-2.0
"""Signals of models as they lie in the session's folders, ready to be shown at any zoom."""

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pneu_sysid.tasks.signals import Signals, load_signals
from pneu_workbench.traces import Floats, Pyramid

KEPT = 4
"""Models whose signals are held in memory, those that were asked for last."""


class Store:
    """Signals by the folder that they lie in. Its methods may be called from any thread."""

    def __init__(self, folder: Path) -> None:
        """Knows where folders are.

        Args:
            folder: The session's.
        """
        self._folder = folder
        self._lock = threading.RLock()
        self._held: dict[str, tuple[Signals, dict[tuple[str, str], Pyramid]]] = {}

    def signals(self, name: str) -> Signals:
        """Signals of a model.

        Args:
            name: Of its folder.

        Raises:
            InputError: They cannot be read.
        """
        return self._load(name)[0]

    def pyramid(
        self, name: str, kind: str, of: str, values: Callable[[Signals], tuple[Floats, Floats]]
    ) -> Pyramid:
        """One of them, built once.

        Args:
            name: Of the model's folder.
            kind: What kind of signal it is.
            of: Which sensor or command it is of.
            values: Makes times and values of it.
        """
        with self._lock:
            signals, built = self._load(name)
            if (kind, of) not in built:
                built[kind, of] = Pyramid(*values(signals))
            return built[kind, of]

    def forget(self, name: str | None = None) -> None:
        """Lets go of what is held: it has changed.

        Args:
            name: Of the folder; None is all.
        """
        with self._lock:
            if name is None:
                self._held.clear()
            else:
                self._held.pop(name, None)

    def _load(self, name: str) -> tuple[Signals, dict[tuple[str, str], Pyramid]]:
        with self._lock:
            entry = self._held.pop(name, None)
            if entry is None:
                entry = load_signals(self._folder / name / "signals.npz"), {}
            while len(self._held) >= KEPT:
                del self._held[next(iter(self._held))]
            self._held[name] = entry
            return entry


def as_steps(signals: Signals, name: str) -> tuple[Floats, Floats]:
    """Times and volts of a command, held until it changes, to the end of all readings.

    Args:
        signals: The signals.
        name: Of the command.
    """
    time, volts = signals.commands[name]
    end = max(t.time_s[-1] for t in signals.sensors.values() if t.time_s.size)
    until = np.append(time[1:], max(end, time[-1]))
    return np.stack([time, until], axis=1).ravel(), np.repeat(volts, 2)
