# SPDX-License-Identifier: Apache-2.0
"""Starts the process that runs a model at other strengths, and speaks with it."""

from collections.abc import Sequence
from typing import Any

from pneu_sysid.tasks.child import Child, Say


class TrialProcess:
    """A model that is held ready to be run at other strengths."""

    def __init__(self, bags: Sequence[str], rig: str, workers: int, heard: Say) -> None:
        """Starts it.

        Args:
            bags: The recordings.
            rig: Rig file; it has an effect.
            workers: Threads; 0 is all cores.
            heard: Called from a thread with each answer, see `pneu_sysid.tasks.trial`, and with
                ``{"fault": …}`` where the process ended by itself.
        """

        def gone(status: int, told: bool) -> None:
            if status != 0 and not told:
                heard({"fault": f"the process ended with status {status}"})

        def answered(answer: dict[str, Any]) -> None:
            if not self._ended:
                heard(answer)

        self._ended = False

        first = {"bags": list(bags), "rig": rig, "workers": workers}
        self._child = Child("pneu_sysid.tasks.trial", first, answered, gone)

    def run(self, strength: float, file: str) -> None:
        """Asks for a strength; what was asked before and is not begun is forgotten.

        Args:
            strength: How strong.
            file: Where the signals go.
        """
        self._child.say({"strength": strength, "file": file})

    def end(self) -> None:
        """Ends it, and waits until it is gone."""
        self._ended = True
        self._child.end()
        self._child.wait()
