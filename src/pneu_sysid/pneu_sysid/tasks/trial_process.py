# SPDX-License-Identifier: Apache-2.0
"""Starts the process that runs a model at other strengths, and speaks with it."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

GRACE_S = 2.0


class TrialProcess:
    """A model that is held ready to be run at other strengths."""

    def __init__(
        self,
        bags: Sequence[str],
        rig: str,
        workers: int,
        heard: Callable[[dict[str, Any]], object],
    ) -> None:
        """Starts it.

        Args:
            bags: The recordings.
            rig: Rig file; it has an effect.
            workers: Threads; 0 is all cores.
            heard: Called from a thread with each answer, see `pneu_sysid.tasks.trial`, and with
                ``{"fault": …}`` where the process ended by itself.
        """
        self._heard, self._ended = heard, False
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pneu_sysid.tasks.trial"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        self._say({"bags": list(bags), "rig": rig, "workers": workers})
        self._thread = threading.Thread(target=self._listen, name="trial", daemon=True)
        self._thread.start()

    def run(self, strength: float, file: str) -> None:
        """Asks for a strength; what was asked before and is not begun is forgotten.

        Args:
            strength: How strong.
            file: Where the signals go.
        """
        self._say({"strength": strength, "file": file})

    def end(self) -> None:
        """Ends it, and waits until it is gone."""
        self._ended = True
        self._process.terminate()
        try:
            self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _say(self, told: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(told) + "\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError):
            pass  # it ended; the thread finds out

    def _listen(self) -> None:
        assert self._process.stdout is not None and self._process.stdin is not None
        for line in self._process.stdout:
            try:
                told = json.loads(line)
            except json.JSONDecodeError:  # cut off by `end`
                continue
            if not self._ended:
                self._heard(told)
        status = self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        if not self._ended and status != 0:
            self._heard({"fault": f"the process ended with status {status}"})
