# SPDX-License-Identifier: Apache-2.0
"""Tables for the terminal that never cut a name, however narrow the terminal is.

Words are wrapped first, then names are folded onto further lines. Where even that leaves too little
room the columns that matter least are left out, which is said below the table; where there are
still too many columns of numbers they go into several tables, each with the names again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

LEAST_NAME = 10
"""A column of names or words is made no narrower than this, unless all it holds is shorter."""
BETWEEN = 3
"""Characters that a column's border and padding take; the table itself takes one more."""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        heading: Its heading, which may be a name too.
        kind: Names are folded where there is too little room, words make room for them, numbers
            stay whole and right-aligned.
        drop: Columns with the greatest are left out first where there is too little room; one with
            0 never is.
    """

    heading: str
    kind: Literal["name", "words", "number"] = "name"
    drop: int = 0


class NamedTable:
    """A table that rich prints at any width; brackets in its texts are brackets."""

    def __init__(self, title: str, columns: Sequence[Column], note: str = "") -> None:
        """Starts without rows.

        Args:
            title: Title; empty for none.
            columns: Its columns.
            note: A line below it.
        """
        self.title = title
        self.columns = list(columns)
        self.note = note
        self.rows: list[tuple[str, ...]] = []
        self._ends: set[int] = set()

    def add_row(self, *cells: str, end_section: bool = False) -> None:
        """Adds a row.

        Args:
            cells: One text for every column.
            end_section: Whether a line is drawn below it.
        """
        if len(cells) != len(self.columns):
            raise ValueError(f"found {len(cells)} cells, needed are {len(self.columns)}")
        if end_section:
            self._ends.add(len(self.rows))
        self.rows.append(cells)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table | Text]:
        """Prints it, as one table or as several."""
        shown, left_out = self._shown(options.max_width)
        parts = self._parts(shown, options.max_width)
        if self.title:
            yield Text(self.title, style="table.title")
        for part in parts:
            yield self._table(part, options.max_width)
        if left_out:
            names = ", ".join(self.columns[k].heading for k in left_out)
            yield Text(f"not shown, for want of width: {names}", style="table.caption")
        if self.note:
            yield Text(self.note, style="table.caption")

    def _least(self, k: int) -> int:
        """Characters that a column needs."""
        column = self.columns[k]
        cells = [row[k] for row in self.rows]
        # Wrapped between words, or folded where these are long; a name is one word.
        parts = cells if column.kind == "name" else [word for c in cells for word in c.split()]
        least = min(LEAST_NAME, _longest([*column.heading.split(), *parts]))
        return max(least, _longest(cells)) if column.kind == "number" else least

    def _whole(self, k: int) -> int:
        """Characters of the longest that a column holds, its heading included."""
        return _longest([self.columns[k].heading, *(row[k] for row in self.rows)])

    def _needed(self, columns: list[int]) -> int:
        return 1 + sum(self._least(k) + BETWEEN for k in columns)

    def _shown(self, width: int) -> tuple[list[int], list[int]]:
        """Columns that are shown and those that are left out, both in their order."""
        shown = list(range(len(self.columns)))
        spare = sorted(
            (k for k in shown if self.columns[k].drop), key=lambda k: self.columns[k].drop
        )
        while spare and self._needed(shown) > width:
            shown.remove(spare.pop())
        return shown, [k for k in range(len(self.columns)) if k not in shown]

    def _parts(self, shown: list[int], width: int) -> list[list[int]]:
        """The columns of each table: all names in every one, as many numbers as there is room."""
        names = [k for k in shown if self.columns[k].kind != "number"]
        parts: list[list[int]] = []
        now: list[int] = []
        for k in shown:
            if k in names:
                continue
            if now and self._needed([*names, *now, k]) > width:
                parts.append(now)
                now = []
            now.append(k)
        parts.append(now)
        return [[k for k in shown if k in names or k in part] for part in parts]

    def _widths(self, columns: list[int], width: int) -> dict[int, int]:
        """Characters of each column: the least, the rest to names, numbers and words in turn."""
        widths = {k: self._least(k) for k in columns}
        spare = width - self._needed(columns)
        for kind in ("name", "number", "words"):
            short = [k for k in columns if self.columns[k].kind == kind]
            while spare > 0 and (short := [k for k in short if widths[k] < self._whole(k)]):
                narrowest = min(short, key=lambda k: widths[k])
                widths[narrowest] += 1
                spare -= 1
        return widths

    def _table(self, columns: list[int], width: int) -> Table:
        table = Table()
        widths = self._widths(columns, width)
        for k in columns:
            column = self.columns[k]
            table.add_column(
                Text(column.heading),
                justify="right" if column.kind == "number" else "left",
                overflow="fold",
                width=widths[k],
            )
        for i, row in enumerate(self.rows):
            table.add_row(*(Text(row[k]) for k in columns), end_section=i in self._ends)
        return table


def _longest(texts: Sequence[str]) -> int:
    """Characters of the longest text, and one where there is none or all are empty."""
    return max([1, *(cell_len(text) for text in texts)])
