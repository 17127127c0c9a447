# SPDX-License-Identifier: Apache-2.0
"""What an evaluation found: runs with their figures, as a file, and as tables over the runs.

The file is written after every run, so that an interrupted evaluation goes on where it was.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.documents import read_json
from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.tables import Column, NamedTable
from pneu_policy.judge.metrics import Metrics, Track

VERSION = 1
LIMIT = "limit"
"""Name of the runs of the physical limit."""

COLUMNS: tuple[tuple[str, str, float, str], ...] = (
    ("rmse_atm", "RMSE [atm]", 1.0, "{:.3f}"),
    ("latency_s", "latency [ms]", 1e3, "{:.1f}"),
    ("adjusted_rmse_atm", "adjusted RMSE [atm]", 1.0, "{:.3f}"),
    ("effort_v", "effort [V]", 1.0, "{:.2f}"),
    ("effort_rate_v_s", "rate [V/s]", 1.0, "{:.0f}"),
    ("oscillation_atm", "oscillation [atm]", 1.0, "{:.3f}"),
    ("reversals_hz", "reversals [1/s]", 1.0, "{:.1f}"),
)
"""Figure, heading, factor and format of a table's columns."""


@dataclass(frozen=True)
class Run:
    """One run of one controller.

    Attributes:
        controller: Name of the controller.
        plant: Name of the plant.
        kind: Kind of the target.
        seed: Seed of the target.
        metrics: Its figures; None where the run was not valid.
        attempts: How often it was tried.
        note: What else is to be known, such as why it was not valid.
    """

    controller: str
    plant: str
    kind: str
    seed: int
    metrics: Metrics | None
    attempts: int = 1
    note: str = ""

    @property
    def key(self) -> str:
        """What tells it from all others, fit for a file name."""
        return f"{self.plant}-{self.kind}-{self.seed}-{self.controller}"


@dataclass
class Evaluation:
    """All runs of an evaluation.

    Attributes:
        settings: What was asked for, plain data.
        controllers: By plant and name where each comes from, plain data.
        runs: The runs.
        folder: Where runs are kept as files; None keeps none.
    """

    settings: dict[str, Any]
    controllers: dict[str, Any] = field(default_factory=dict)
    runs: list[Run] = field(default_factory=list)
    folder: Path | None = None

    def has(self, key: str) -> bool:
        """Whether a run is there and valid.

        Args:
            key: Of the run.
        """
        return any(run.key == key and run.metrics is not None for run in self.runs)

    def add(self, run: Run, track: Track | None = None) -> None:
        """Adds a run, in place of one with the same key, and writes what there is.

        Args:
            run: The run.
            track: What it left, for figures.
        """
        self.runs = [other for other in self.runs if other.key != run.key] + [run]
        if self.folder is not None:
            if track is not None:
                save_track(track, self.folder / "tracks" / f"{run.key}.npz")
            save(self, self.folder / "evaluation.json")

    def introduce(self, plant: str, name: str, origin: dict[str, Any]) -> None:
        """Tells where a controller comes from; runs of another one of that name are dropped.

        Args:
            plant: Name of the plant that it runs on.
            name: Name of the controller.
            origin: Where it comes from, plain data.
        """
        own = self.controllers.setdefault(plant, {})
        if own.get(name, origin).get("sha256") != origin.get("sha256"):
            self.runs = [r for r in self.runs if (r.plant, r.controller) != (plant, name)]
        own[name] = origin

    def plants(self) -> list[str]:
        """Names of the plants, in the order in which they came."""
        return list(dict.fromkeys(run.plant for run in self.runs))

    def kinds(self) -> list[str]:
        """Kinds of target: smooth before jagged, as in thesis table 9.1."""
        known = dict.fromkeys(run.kind for run in self.runs)
        return sorted(known, key=lambda kind: (kind != "smooth", kind))

    def names(self) -> list[str]:
        """Names of the controllers in the order in which they came, the limit last."""
        known = dict.fromkeys(run.controller for run in self.runs)
        return sorted(known, key=lambda name: name == LIMIT)

    def values(self, figure: str, controller: str, plant: str, kind: str) -> list[float]:
        """One figure over the valid runs of one cell of the table.

        Args:
            figure: Name of the figure.
            controller: Name of the controller.
            plant: Name of the plant.
            kind: Kind of the target.
        """
        wanted = (controller, plant, kind)
        return [
            float(getattr(run.metrics, figure))
            for run in self.runs
            if (run.controller, run.plant, run.kind) == wanted and run.metrics is not None
        ]


def spread(values: Sequence[float]) -> tuple[float, float]:
    """Mean and standard deviation (of the sample) of what is finite.

    Args:
        values: The values.
    """
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return math.nan, math.nan
    deviation = float(np.std(finite, ddof=1)) if len(finite) > 1 else math.nan
    return float(np.mean(finite)), deviation


def rows(evaluation: Evaluation) -> tuple[list[str], list[list[str]]]:
    """The table of all figures: mean and standard deviation over runs.

    Args:
        evaluation: What was found.

    Returns:
        Headings and rows.
    """
    heads = ["plant", "target", "controller", "runs", *(head for _, head, _, _ in COLUMNS)]
    out = []
    for plant in evaluation.plants():
        for kind in evaluation.kinds():
            for name in evaluation.names():
                found = evaluation.values("rmse_atm", name, plant, kind)
                if found:
                    cells = [
                        _cell(evaluation.values(figure, name, plant, kind), factor, form)
                        for figure, _, factor, form in COLUMNS
                    ]
                    out.append([plant, kind, name, str(len(found)), *cells])
    return heads, out


def error_rows(evaluation: Evaluation) -> tuple[list[str], list[list[str]]]:
    """The errors alone, laid out as thesis table 9.1: a row per task, a column per controller.

    Args:
        evaluation: What was found.

    Returns:
        Headings and rows.
    """
    names = evaluation.names()
    out = []
    for plant in evaluation.plants():
        for kind in evaluation.kinds():
            cells = [evaluation.values("rmse_atm", name, plant, kind) for name in names]
            if any(cells):
                row = [_cell(cell, 1.0, "{:.4f}" if n == LIMIT else "{:.3f}")
                       for n, cell in zip(names, cells, strict=True)]  # fmt: skip
                out.append([f"{plant}, {kind}", *row])
    return ["RMSE [atm]", *names], out


def _cell(values: Sequence[float], factor: float, form: str) -> str:
    mean, deviation = spread([factor * value for value in values])
    if not math.isfinite(mean):
        return "-"
    text = form.format(mean)
    return f"{text} ± {form.format(deviation)}" if math.isfinite(deviation) else text


def markdown(heads: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """A table in Markdown.

    Args:
        heads: Headings.
        body: Rows.
    """
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)]) + "\n"


def rich_table(title: str, heads: Sequence[str], body: Iterable[Sequence[str]]) -> NamedTable:
    """A table for a terminal.

    Args:
        title: What it shows.
        heads: Headings.
        body: Rows.
    """
    rows = list(body)
    worded = [any(c.isalpha() for row in rows for c in row[k]) for k in range(len(heads))]
    table = NamedTable(
        title,
        [
            Column(head, "name" if words else "number")
            for head, words in zip(heads, worded, strict=True)
        ],
    )
    for row in rows:
        table.add_row(*row)
    return table


def save(evaluation: Evaluation, path: Path) -> None:
    """Writes an evaluation, whole or not at all.

    Args:
        evaluation: What was found.
        path: The file.

    Raises:
        InputError: It cannot be written.
    """
    runs = [{**asdict(run), "metrics": _plain(run.metrics)} for run in evaluation.runs]
    data = {
        "pneu_evaluation": VERSION,
        "settings": evaluation.settings,
        "controllers": evaluation.controllers,
        "runs": runs,
    }
    _make_folder(path)
    write_whole(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def _make_folder(path: Path) -> None:
    """Makes the folder of a file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


def load(path: Path) -> Evaluation:
    """Reads an evaluation; its folder is where the file lies.

    Args:
        path: The file.

    Raises:
        InputError: It is missing, or no evaluation.
    """
    data = read_json(path, "evaluation")
    try:
        version = data["pneu_evaluation"]
        if version != VERSION:
            raise InputError(
                f"{path}: pneu_evaluation: found {version!r}, this version reads {VERSION}"
            )
        runs = [_run(item) for item in data["runs"]]
        return Evaluation(data["settings"], dict(data["controllers"]), runs, path.parent)
    except InputError:  # before its base, ValueError
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no evaluation ({error})") from None


def _plain(metrics: Metrics | None) -> dict[str, float | None] | None:
    """Figures for JSON, which knows no NaN."""
    if metrics is None:
        return None
    return {n: v if math.isfinite(v) else None for n, v in metrics.to_dict().items()}


def _run(data: Mapping[str, Any]) -> Run:
    run = Run(**{**data, "metrics": None})
    if data["metrics"] is None:
        return run
    return replace(run, metrics=Metrics.from_dict(data["metrics"]))


def save_track(track: Track, path: Path) -> None:
    """Writes what a run left, whole or not at all.

    Args:
        track: What it left.
        path: The file, .npz.

    Raises:
        InputError: It cannot be written.
    """
    _make_folder(path)
    with whole(path) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, **vars(track))


def load_track(path: Path) -> Track:
    """Reads what a run left.

    Args:
        path: The file.

    Raises:
        InputError: It is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            return Track(**{name: stored[name] for name in stored.files})
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: holds no run ({error})") from None
