# SPDX-License-Identifier: Apache-2.0
"""A version run with other strengths of what was added to it last."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_sysid.tasks.trial_process import TrialProcess
from pneu_workbench.versions import Version


@dataclass
class Trial:
    """How it stands.

    Attributes:
        of: Number of the version.
        strength: How strong it was tried; None is not yet.
        lower: Least strength that may be.
        upper: Most.
        unit: Of all three.
        title: What was added.
        errors: Of each sensor over its noise, at that strength.
        ready: Whether the model is ready to be run.
        fault: Why not; empty where it is.
    """

    of: int
    strength: float | None = None
    lower: float = 0.0
    upper: float = 0.0
    unit: str = ""
    title: str = ""
    errors: dict[str, float] = field(default_factory=dict)
    ready: bool = False
    fault: str = ""


class Trying:
    """A version that is held ready to be run at other strengths.

    Attributes:
        state: How it stands.
    """

    def __init__(
        self,
        version: Version,
        bags: Sequence[str],
        workers: int,
        folder: Path,
        changed: Callable[[], None],
    ) -> None:
        """Begins.

        Args:
            version: The version.
            bags: The recordings.
            workers: Threads; 0 is all cores.
            folder: That receives the signals.
            changed: Called from a thread when anything has changed.
        """
        folder.mkdir(exist_ok=True)
        self.state = Trial(version.number)
        self._file, self._changed = str(folder / "signals.npz"), changed
        self._process = TrialProcess(bags, version.rig, workers, self._heard)

    def run(self, strength: float) -> None:
        """Runs it.

        Args:
            strength: How strong; beyond what may be it is cut off.

        Raises:
            InputError: It is not ready.
        """
        if not self.state.ready:
            raise InputError("strength: the model is not ready to be run at another")
        self._process.run(min(max(strength, self.state.lower), self.state.upper), self._file)

    def end(self) -> None:
        """Ends it, and waits until it is gone."""
        self._process.end()

    def _heard(self, told: dict[str, Any]) -> None:
        state = self.state
        if "fault" in told:
            state.fault, state.ready = told["fault"], False
        elif "errors" in told:
            state.strength, state.errors = told["strength"], told["errors"]
        else:
            state.lower, state.upper = told["lower"], told["upper"]
            state.unit, state.title = told["unit"] or "", told["title"]
            state.strength, state.ready = told["strength"], True
        self._changed()
