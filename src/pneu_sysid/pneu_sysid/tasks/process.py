# SPDX-License-Identifier: Apache-2.0
"""Starts a task of the identification in a process, follows it, and ends it when told to."""

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict

from pneu_sysid.tasks.request import Outcome, Request, Tell

GRACE_S = 2.0


class TaskProcess:
    """A running task."""

    def __init__(
        self,
        request: Request,
        tell: Tell,
        done: Callable[[Outcome], object],
        errors: Callable[[dict[str, float]], object] | None = None,
    ) -> None:
        """Starts it.

        Args:
            request: What to do.
            tell: Called from a thread with stage and fraction done.
            done: Called once from that thread with the outcome, also after `end`.
            errors: Called from it with the error of each sensor, in noise units, as it falls.
        """
        self._errors = errors or (lambda told: None)
        self._request = request
        self._tell = tell
        self._done = done
        self._ended = False
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pneu_sysid.tasks"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            # A Ctrl-C meant for the node reaches the task through `end`, not by itself.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(asdict(request)) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:  # it died at once; the thread finds out how
            pass
        self._thread = threading.Thread(target=self._follow, name="task", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def end(self) -> None:
        """Ends the task; `done` hears of it. Does not wait."""
        self._ended = True
        self._process.terminate()

    def wait(self) -> None:
        """Waits until all is over."""
        self._thread.join()

    def _follow(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        outcome: Outcome | None = None
        for line in self._process.stdout:
            try:
                values = json.loads(line)
            except json.JSONDecodeError:  # cut off by `end`
                continue
            if "success" in values:
                outcome = Outcome(**values)
            elif self._ended:
                continue
            elif "errors" in values:
                self._errors(values["errors"])
            else:
                self._tell(values["stage"], float(values["progress"]))
        try:
            status = self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        shutil.rmtree(self._request.aside, ignore_errors=True)
        if outcome is None:
            reason = "cancelled" if self._ended else f"the process ended with status {status}"
            outcome = Outcome(False, reason)
        self._done(outcome)
