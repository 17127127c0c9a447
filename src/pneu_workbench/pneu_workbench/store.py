# SPDX-License-Identifier: Apache-2.0
"""Signals of models as they lie in the session's folders, ready to be shown at any zoom."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_sysid.tasks.regime_masks import REGIMES, RegimeMasks, load_regimes
from pneu_sysid.tasks.signals import SIGNALS, Signals, load_signals
from pneu_workbench.traces import Floats, Pyramid

MOST_PYRAMIDS = 60
"""Of one model; those of regimes that were looked at long ago are built anew."""
KEPT = 4
"""Models whose signals are held in memory, those that were asked for last."""


@dataclass
class _Entry:
    """A model's signals.

    Attributes:
        signals: They.
        pyramids: Those that were built, by kind and by sensor or command.
        regimes: Which of its readings belong to which regime, once somebody asked.
    """

    signals: Signals
    pyramids: dict[tuple[str, str], Pyramid] = field(default_factory=dict)
    regimes: RegimeMasks | None = None


class Store:
    """Signals by the folder that they lie in. Its methods may be called from any thread."""

    def __init__(self, folder: Path) -> None:
        """Knows where folders are.

        Args:
            folder: The session's.
        """
        self._folder = folder
        self._lock = threading.RLock()
        self._held: dict[str, _Entry] = {}

    def signals(self, name: str) -> Signals:
        """Signals of a model.

        Args:
            name: Of its folder.

        Raises:
            InputError: They cannot be read.
        """
        return self._load(name).signals

    def regimes(self, name: str) -> RegimeMasks | None:
        """Which readings belong to which regime; None where nothing says so.

        Args:
            name: Of the model's folder.
        """
        with self._lock:
            entry = self._load(name)
            if entry.regimes is None:
                try:
                    entry.regimes = load_regimes(self._folder / name / REGIMES)
                except InputError:
                    return None
            return entry.regimes

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
            entry = self._load(name)
            built = entry.pyramids
            if (kind, of) not in built:
                while len(built) >= MOST_PYRAMIDS:
                    del built[next(iter(built))]
                built[kind, of] = Pyramid(*values(entry.signals))
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

    def _load(self, name: str) -> _Entry:
        with self._lock:
            entry = self._held.pop(name, None)
            if entry is None:
                entry = _Entry(load_signals(self._folder / name / SIGNALS))
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
