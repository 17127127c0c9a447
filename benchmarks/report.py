# SPDX-License-Identifier: Apache-2.0
"""What a subject measured: a table, printed to the terminal and kept as JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as RichTable

from pneu_common.files import write_whole

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results.json"
PAGE = ROOT / "docs" / "benchmarks.md"
SCHEMA = "pneu.benchmarks/1"


@dataclass
class Table:
    """One table of figures.

    Attributes:
        title: What it shows.
        text: How it was measured, and what to compare.
        columns: Key of a row's field to the heading, with its unit.
        rows: Raw values; None where there is nothing to state.
        notes: What could not be measured, and why.
        picture: A file of `docs/figures` that shows it; none unless given.
    """

    title: str
    text: str
    columns: Mapping[str, str]
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    picture: str = ""


def shown(value: Any) -> str:
    """A value as a person reads it: three significant digits, a dash for none."""
    if value is None:
        return "-"
    if isinstance(value, float):
        if value != 0.0 and not 1e-3 <= abs(value) < 1e5:
            return f"{value:.2e}"
        return f"{float(f'{value:.3g}'):g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return str(value)


def show(table: Table, console: Console) -> None:
    """Prints a table."""
    rich = RichTable(title=table.title, title_justify="left")
    for key, heading in table.columns.items():
        numeric = all(isinstance(row.get(key), int | float | None) for row in table.rows)
        rich.add_column(heading, justify="right" if numeric else "left")
    for row in table.rows:
        rich.add_row(*(shown(row.get(key)) for key in table.columns))
    console.print(rich)
    for note in table.notes:
        console.print(f"note: {note}", style="yellow")


def kept(subject: str) -> bool:
    """Whether a subject has been measured before.

    Args:
        subject: Its name.
    """
    if not RESULTS.exists():
        return False
    return subject in json.loads(RESULTS.read_text(encoding="utf-8"))["subjects"]


def keep(
    subjects: Mapping[str, Sequence[Table]], machine: Mapping[str, Any], command: str = ""
) -> None:
    """Writes what was measured, beside the subjects that were measured before.

    Args:
        subjects: Tables by what they are about.
        machine: On what.
        command: What made them; unless given, this package, of the subject's name.
    """
    known: dict[str, Any] = {}
    if RESULTS.exists():
        known = json.loads(RESULTS.read_text(encoding="utf-8")).get("subjects", {})
    for name, tables in subjects.items():
        known[name] = {"machine": dict(machine), "tables": [vars(t) for t in tables]}
        if command:
            known[name]["command"] = command
    whole = {"schema": SCHEMA, "subjects": dict(sorted(known.items()))}
    write_whole(RESULTS, json.dumps(whole, indent=1) + "\n")
    write_whole(PAGE, page(whole))


def page(whole: Mapping[str, Any]) -> str:
    """The Markdown page of all results."""
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench` from `benchmarks/`; the raw values are in"
        " `benchmarks/results.json`. Times are the best of many short runs after compilation, on"
        " one core unless stated otherwise; compare ratios, which hold on other machines better"
        " than times do.",
    ]
    machine: Any = None
    for name, subject in whole["subjects"].items():
        if subject["machine"] != machine:
            machine = subject["machine"]
            described = ", ".join(f"{key} {value}" for key, value in machine.items())
            lines += ["", f"Machine: {described}."]
        for table in subject["tables"]:
            keys = list(table["columns"])
            if table.get("picture"):
                lines += [f"![{table['title']}](figures/{table['picture']})", ""]
            lines += ["", f"## {table['title']}", "", table["text"], ""]
            lines.append("| " + " | ".join(table["columns"].values()) + " |")
            lines.append("|" + " --- |" * len(keys))
            for row in table["rows"]:
                lines.append("| " + " | ".join(shown(row.get(key)) for key in keys) + " |")
            for note in table["notes"]:
                lines += ["", f"Note: {note}"]
        lines += ["", f"(`{subject.get('command', f'python -m benchmarks {name}')}`)"]
    return "\n".join(lines) + "\n"
