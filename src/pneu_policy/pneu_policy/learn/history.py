# SPDX-License-Identifier: Apache-2.0
"""The history of a training: one row per iteration, as JSON beside the policy it led to.

Rows hold ``iteration`` (1 is the first), ``samples`` (control periods of all rigs so far),
``simulated_s``, ``wall_s``, ``cpu_s`` (what the process computed for, whatever else went on),
``score`` (mean sum of rewards of an episode) and ``rmse`` of the episodes with exploration,
``eval_score`` and ``eval_rmse`` of those without it where one was made (else null),
``eval_success`` (share of its steps that were a success, where the task says what that is),
``std`` of the exploration, and what the algorithm adds. Errors are in the unit that the task is
told in.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneu_common.documents import read_json
from pneu_common.errors import InputError
from pneu_common.files import write_whole

VERSION = 2

Row = dict[str, Any]


@dataclass(frozen=True)
class History:
    """How a training went.

    Attributes:
        algorithm: ``npg`` or ``ppo``.
        settings: What it was set to, as plain values.
        rows: One per iteration.
        finished: Whether all iterations were done.
        unit: What errors are told in.
        mark: Error at which the task is called learned, in that unit.
    """

    algorithm: str
    settings: Mapping[str, Any]
    rows: Sequence[Row]
    finished: bool
    unit: str = "atm"
    mark: float = 0.1

    def learned(self) -> Row | None:
        """The first row whose evaluation is at the mark or below, or None."""
        for row in self.rows:
            if row["eval_rmse"] is not None and row["eval_rmse"] <= self.mark:
                return row
        return None

    def save(self, path: str | Path) -> None:
        """Writes the history, whole or not at all.

        Args:
            path: The file; its folder must exist.

        Raises:
            InputError: It cannot be written.
        """
        path = Path(path)
        document = {
            "pneu_history": VERSION,
            "algorithm": self.algorithm,
            "finished": self.finished,
            "unit": self.unit,
            "mark": self.mark,
            "learned": self.learned(),
            "settings": self.settings,
            "rows": [{key: _json(value) for key, value in row.items()} for row in self.rows],
        }
        write_whole(path, json.dumps(document, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> "History":
        """Reads a history.

        Args:
            path: The file.

        Raises:
            InputError: It is missing, damaged or not a history.
        """
        document = read_json(path, "history of a training")
        if not isinstance(document, dict) or document.get("pneu_history") != VERSION:
            found = document.get("pneu_history") if isinstance(document, dict) else None
            raise InputError(f"{path}: pneu_history: found {found!r}, this version reads {VERSION}")
        try:
            return cls(
                algorithm=document["algorithm"],
                settings=document["settings"],
                rows=document["rows"],
                finished=document["finished"],
                unit=document["unit"],
                mark=document["mark"],
            )
        except KeyError as error:
            raise InputError(f"{path}: {error.args[0]} is missing from the history") from None


def _json(value: Any) -> Any:
    """JSON knows no infinities."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
