# SPDX-License-Identifier: Apache-2.0
"""Starts a task of the identification in a process, follows it, and ends it when told to."""

import shutil
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from pneu_sysid.tasks.child import Child
from pneu_sysid.tasks.request import Outcome, Request, Tell


class TaskProcess:
    """A running task."""

    def __init__(
        self,
        request: Request,
        tell: Tell,
        done: Callable[[Outcome], object],
        errors: Callable[[dict[str, float]], object] | None = None,
        early: Callable[[str], object] | None = None,
    ) -> None:
        """Starts it.

        Args:
            request: What to do.
            tell: Called from a thread with stage and fraction done.
            done: Called once from that thread with the outcome, also after `end`.
            errors: Called from it with the error of each sensor, in noise units, as it falls.
            early: Called from it with the folder in which what was measured lies.
        """
        self._aside = request.aside
        self._tell, self._done = tell, done
        self._errors = errors or (lambda told: None)
        self._early = early or (lambda folder: None)
        self._outcome: Outcome | None = None
        self._ended = False
        self._child = Child("pneu_sysid.tasks", asdict(request), self._heard, self._gone)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._child.pid

    def end(self) -> None:
        """Ends the task; `done` hears of it. Does not wait."""
        self._ended = True
        self._child.end()

    def wait(self) -> None:
        """Waits until all is over."""
        self._child.wait()

    def _heard(self, answer: dict[str, Any]) -> None:
        if "success" in answer:
            self._outcome = Outcome(**answer)
        elif self._ended:
            return
        elif "errors" in answer:
            self._errors(answer["errors"])
        elif "early" in answer:
            self._early(answer["early"])
        else:
            self._tell(answer["stage"], float(answer["progress"]))

    def _gone(self, status: int, told: bool) -> None:
        shutil.rmtree(self._aside, ignore_errors=True)
        reason = "cancelled" if told else f"the process ended with status {status}"
        self._done(self._outcome or Outcome(False, reason))
