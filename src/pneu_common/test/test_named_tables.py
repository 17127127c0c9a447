# SPDX-License-Identifier: Apache-2.0
"""Widths of table columns: filled in the documented order, never wider than the terminal."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from pneu_common.tables import Column, NamedTable

pytestmark = pytest.mark.kernel_free


def lines_of(table: NamedTable, width: int) -> list[str]:
    stream = io.StringIO()
    Console(file=stream, width=width, markup=False, emoji=False).print(table)
    return stream.getvalue().splitlines()


def widths_of(lines: list[str]) -> list[list[int]]:
    """Width of each column of each table, without its border and padding."""
    borders = [line[1:-1].split("┳") for line in lines if line.startswith("┏")]
    return [[len(part) - 2 for part in parts] for parts in borders]


def errors_table() -> NamedTable:
    columns = [
        Column("sensor"),
        Column("time scale", "number"),
        Column("what was done", "words", drop=1),
        Column("RMSE", "number"),
        Column("share", "number", drop=2),
        Column("note", "words", drop=2),
    ]
    table = NamedTable("two sensors", columns, "of one rig")
    left = "supply_of_the_left_arm"
    table.add_row(left, "12345.6", "fill of the forearm", "-0.25", "50", "")
    table.add_row("气压计", "7", "rest", "1", "49.875", "a bag", end_section=True)
    table.add_row("end", "800", "vent", "3", "2", "b")
    return table


def test_text_of_a_table() -> None:
    """Names and words stand on the left, numbers on the right; a section ends where asked."""
    assert lines_of(errors_table(), 66) == [
        "two sensors",
        "┏━━━━━━━━━━━━━━━━━━━━┳━━━━━━━━━┳━━━━━━━━━┳━━━━━━━┳━━━━━━━━┳━━━━━━┓",
        "┃                    ┃         ┃ what    ┃       ┃        ┃      ┃",
        "┃                    ┃    time ┃ was     ┃       ┃        ┃      ┃",
        "┃ sensor             ┃   scale ┃ done    ┃  RMSE ┃  share ┃ note ┃",
        "┡━━━━━━━━━━━━━━━━━━━━╇━━━━━━━━━╇━━━━━━━━━╇━━━━━━━╇━━━━━━━━╇━━━━━━┩",
        "│ supply_of_the_left │ 12345.6 │ fill of │ -0.25 │     50 │      │",
        "│ _arm               │         │ the     │       │        │      │",
        "│                    │         │ forearm │       │        │      │",
        "│ 气压计             │       7 │ rest    │     1 │ 49.875 │ a    │",
        "│                    │         │         │       │        │ bag  │",
        "├────────────────────┼─────────┼─────────┼───────┼────────┼──────┤",
        "│ end                │     800 │ vent    │     3 │      2 │ b    │",
        "└────────────────────┴─────────┴─────────┴───────┴────────┴──────┘",
        "of one rig",
    ]


@pytest.mark.parametrize(
    ("width", "widths", "left_out"),
    [
        (100, [[22, 10, 19, 5, 6, 5]], ""),  # everything on single lines
        (86, [[22, 10, 19, 5, 6, 5]], ""),
        (85, [[22, 10, 18, 5, 6, 5]], ""),  # the widest words wrap first
        (74, [[22, 10, 7, 5, 6, 5]], ""),
        (72, [[22, 9, 7, 5, 6, 4]], ""),  # then the headings of numbers
        (69, [[21, 7, 7, 5, 6, 4]], ""),  # then names are folded
        (58, [[10, 7, 7, 5, 6, 4]], ""),
        (57, [[16, 7, 7, 5, 6]], "note"),  # of two that drop alike the last goes first
        (50, [[18, 7, 7, 5]], "share, note"),
        (41, [[19, 7, 5]], "what was done, share, note"),
        (32, [[10, 7, 5]], "what was done, share, note"),
        (31, [[17, 7], [19, 5]], "what was done, share, note"),  # a table for each number
        (24, [[10, 7], [12, 5]], "what was done, share, note"),
    ],
)
def test_widths_of_columns(width: int, widths: list[list[int]], left_out: str) -> None:
    lines = lines_of(errors_table(), width)
    assert widths_of(lines) == widths
    below = " ".join(line.strip() for line in lines if not re.match("[┏┃┡│├└]", line))
    told = f"not shown, for want of width: {left_out} " if left_out else ""
    assert below == f"two sensors {told}of one rig"


@pytest.mark.parametrize(
    ("column", "cells", "least", "whole"),
    [
        (Column("two words"), ["a"], 5, 9),  # a name: the longest word of the heading
        (Column("b"), ["seven_b"], 7, 7),
        (Column("b"), ["a b c d e"], 9, 9),  # a cell is one name, whatever it holds
        (Column("elevenwords"), [], 10, 11),
        (Column("b"), ["elevenwords"], 10, 11),
        (Column(""), [""], 1, 1),
        (Column("气压"), [], 4, 4),
        (Column("a", "words"), ["two words"], 5, 9),
        (Column("heading b", "words"), ["a"], 7, 9),
        (Column("a", "words"), ["elevenwords b"], 10, 13),
        (Column("", "words"), [], 1, 1),
        (Column("heading b", "number"), ["1"], 7, 9),
        (Column("elevenwords", "number"), ["1"], 10, 11),
        (Column("a", "number"), ["-1234567.8901", "2"], 13, 13),
        (Column("", "number"), [""], 1, 1),
    ],
)
def test_least_and_greatest_width_of_a_column(
    column: Column, cells: list[str], least: int, whole: int
) -> None:
    table = NamedTable("", [Column("x", drop=1), Column("first"), column])
    for cell in cells:
        table.add_row("y", "", cell)
    assert widths_of(lines_of(table, 100)) == [[1, 5, whole]]
    # The border, and three characters for each column besides its own.
    assert widths_of(lines_of(table, 10 + 6 + least)) == [[1, 5, least]]
    assert widths_of(lines_of(table, 9 + 6 + least))[0][0] == 5  # the first is left out


def test_the_narrowest_of_several_grows_first() -> None:
    columns = [Column("a"), Column("b"), Column("c", "words"), Column("d", "words")]
    table = NamedTable("", columns)
    table.add_row("a" * 30, "b" * 14, "c " * 10, "d " * 20)
    for width, widths in (
        (13 + 22, [10, 10, 1, 1]),
        (13 + 27, [13, 12, 1, 1]),
        (13 + 31, [15, 14, 1, 1]),
        (13 + 46, [30, 14, 1, 1]),
        (13 + 49, [30, 14, 3, 2]),
        (13 + 90, [30, 14, 20, 26]),
    ):
        assert widths_of(lines_of(table, width)) == [widths]


def test_several_tables_keep_the_order_of_columns() -> None:
    """Each has all names and words, and as many numbers as there is room for."""
    columns = [Column(name, "number") for name in ("one", "two", "three", "four")]
    table = NamedTable("", [columns[0], Column("a"), *columns[1:], Column("b", "words")])
    table.add_row("1", "x", "2", "3", "4", "y")
    lines = lines_of(table, 24)
    headings = [line.replace(" ", "").strip("┃").split("┃") for line in lines if line[:1] == "┃"]
    assert headings == [["one", "a", "two", "b"], ["a", "three", "four", "b"]]
    assert max(map(len, lines)) <= 24
    lines = lines_of(table, 23)
    headings = [line.replace(" ", "").strip("┃").split("┃") for line in lines if line[:1] == "┃"]
    assert headings == [["one", "a", "two", "b"], ["a", "three", "b"], ["a", "four", "b"]]
    lines = lines_of(table, 10)  # too narrow for any number; no table is without one
    assert [len(widths) for widths in widths_of(lines)] == [3, 3, 3, 3]


def test_a_table_without_title_note_and_rows() -> None:
    assert lines_of(NamedTable("", [Column("a"), Column("b c", "number")]), 20) == [
        "┏━━━┳━━━━━┓",
        "┃ a ┃ b c ┃",
        "┡━━━╇━━━━━┩",
        "└───┴─────┘",
    ]


def test_a_row_has_a_cell_for_each_column() -> None:
    table = NamedTable("", [Column("a"), Column("b")])
    for cells in (("x",), ("x", "y", "z")):
        with pytest.raises(ValueError, match=rf"^found {len(cells)} cells, needed are 2$"):
            table.add_row(*cells)
    assert table.rows == []


TEXT = st.text("ab气 ", max_size=24).map(lambda text: " ".join(text.split()))
KINDS = st.sampled_from(["name", "words", "number"])


@st.composite
def tables(draw: st.DrawFn) -> NamedTable:
    """A name, and other columns, some of which may be left out."""
    columns = [Column(draw(TEXT))]
    for _ in range(draw(st.integers(0, 5))):
        kind = draw(KINDS)
        # At most two that are never left out, so that all of them find room.
        drop = draw(st.integers(0 if kind == "number" or len(columns) < 3 else 1, 3))
        columns.append(Column(draw(TEXT), kind, drop))
    table = NamedTable("", columns)
    for _ in range(draw(st.integers(0, 3))):
        numbers = st.text("-0123456789.", max_size=15)
        table.add_row(*(draw(numbers if c.kind == "number" else TEXT) for c in columns))
    return table


@given(table=tables(), width=st.integers(60, 150))
def test_any_table_fits_fills_the_width_and_shows_every_text(table: NamedTable, width: int) -> None:
    lines = lines_of(table, width)
    assert max(cell_len(line) for line in lines) <= width
    text = "\n".join(lines)
    found = []
    for block in re.split("(?=┏)", text)[1:]:
        rows = [re.split("[│┃]", line)[1:-1] for line in block.splitlines() if line[:1] in "│┃"]
        found += ["".join(parts).replace(" ", "") for parts in zip(*rows, strict=True)]
    _, _, left_out = text.partition("not shown, for want of width:")
    left_out = left_out.replace("\n", "").replace(" ", "")
    hidden = 0
    for k, column in enumerate(table.columns):
        whole = "".join([column.heading, *(row[k] for row in table.rows)]).replace(" ", "")
        if whole not in found:
            assert column.drop > 0 and column.heading.replace(" ", "") in left_out
            hidden += 1
    # Each table is as wide as the terminal, or all its texts stand on single lines.
    for block in re.split("(?=┏)", text)[1:]:
        if len(block.splitlines()[0]) < width:
            assert sum(line[:1] == "┃" for line in block.splitlines()) == 1
            assert sum(line[:1] == "│" for line in block.splitlines()) == len(table.rows)
    for k, column in enumerate(table.columns):
        if column.kind == "number" and column.heading.replace(" ", "") not in left_out:
            for row in table.rows:  # no number is folded
                assert re.search(rf"│ *{re.escape(row[k])} │", text), row[k]
