# SPDX-License-Identifier: Apache-2.0
"""The ranking of a report where candidates are many, or where one lacks a figure."""

from typing import Any

import pytest
from tests.pages import Element, Table, read_page, read_table

from pneu_sysid.report.contents import Contents
from pneu_sysid.report.sections import ranking

pytestmark = pytest.mark.kernel_free


def candidate(k: int, **more: Any) -> dict[str, Any]:
    return {
        "effect": f"effect_{k}", "title": f"Title {k}", "place": f"p{k}", "position_m": None,
        "explained_fraction": 0.5 - 0.01 * k, "refit_fraction": 0.6, "held_out_gain": 0.7,
        "strength": 2.0 + k, "std_error": 0.5, "unit": "m", "significance": 4.0 + k,
        "indistinguishable_from": [], "next_experiment": None, **more,
    }  # fmt: skip


def page_of(candidates: list[dict[str, Any]], learn: bool = False, **more: Any) -> Element:
    diagnose = {"candidates": candidates, "sentence": "Said.", **more}
    return read_page(
        ranking.render(Contents(diagnose=diagnose, learn={} if not learn else {"a": 1}))
    )


def cells(table: Table, row: list[Element | None], heading: str) -> Element:
    cell = row[table.column(heading)]
    assert cell is not None
    return cell


@pytest.mark.parametrize("count", [1, 10, 11, 13])
def test_more_than_ten_candidates_are_folded(count: int) -> None:
    page = page_of([candidate(k) for k in range(count)])
    tables = [read_table(t) for t in page.every("table")]
    assert [len(t.rows) for t in tables] == [n for n in (min(count, 10), count - 10) if n > 0]
    rank = 0
    for table in tables:
        for row in table.rows:
            assert cells(table, row, "#").text == str(rank + 1)
            assert (
                cells(table, row, "Effect and place").text == f"effect_{rank} @ p{rank}Title {rank}"
            )
            rank += 1
    folded = list(page.every("details"))
    assert len(folded) == (count > 10)
    for details in folded:
        first, rest = details.children  # a browser shows the summary only if it comes first
        assert isinstance(first, Element) and isinstance(rest, Element)
        assert first.tag == "summary" and first.text == f"{count - 10} more candidates"
        assert rest.the("table") is list(page.every("table"))[1]


def test_what_was_not_tested_is_not_ranked() -> None:
    tested = [True, False, None, True, False]
    page = page_of([candidate(k, tested=t) for k, t in enumerate(tested)])
    table = read_table(page.the("table"))
    names = [cells(table, row, "Effect and place").the("code").text for row in table.rows]
    assert names == ["effect_0 @ p0", "effect_2 @ p2", "effect_3 @ p3"]
    assert not list(page_of([candidate(0, tested=False)]).every("table"))
    assert not list(page_of([]).every("p"))


@pytest.mark.parametrize("learn", [False, True])
def test_the_sentence_is_told_beside_what_was_learnt(learn: bool) -> None:
    page = page_of([], learn)
    assert [p.text for p in page.every("p")] == (["Said."] if learn else [])


@pytest.mark.parametrize(
    ("more", "name"),
    [
        ({}, "effect_4 @ p4"),
        ({"place": None}, "effect_4"),
        ({"position_m": 0.25}, "effect_4 @ p4 0.250 m"),
        ({"position_m": 0.0}, "effect_4 @ p4 0 m"),
    ],
)
def test_name_and_place(more: dict[str, Any], name: str) -> None:
    table = read_table(page_of([candidate(4, **more)]).the("table"))
    assert cells(table, table.rows[0], "Effect and place").the("code").text == name


def test_what_is_not_known_is_left_out() -> None:
    bare = dict.fromkeys(candidate(0))
    table = read_table(page_of([{**bare, "effect": "leak"}]).the("table"))
    (row,) = table.rows
    assert cells(table, row, "Effect and place").text == "leak"
    assert not list(cells(table, row, "Explains").every("rect"))
    assert {t.number("x") for t in cells(table, row, "Explains").every("text")} == {36.0}
    assert cells(table, row, "Strength").text.strip() == "–"
    assert cells(table, row, "Strength over its error").text == "–"
    assert cells(table, row, "Look-alikes on this recording").text == ""
    for gone in ({"strength": None}, {"std_error": None}, {"std_error": 0.0}):
        table = read_table(page_of([candidate(0, **gone)]).the("table"))
        assert not list(cells(table, table.rows[0], "Strength").every("svg"))


@pytest.mark.parametrize(
    ("value", "left", "width", "text"),
    [
        (0.5, 30.0, 95.0, 131.0), (1.0, 30.0, 190.0, 226.0), (1.7, 30.0, 190.0, 226.0),
        (-0.1, 11.0, 19.0, 36.0), (-0.9, 0.0, 30.0, 36.0), (0.0, 30.0, 0.0, 36.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("key", "kind", "top"),
    [("explained_fraction", "score", 3), ("refit_fraction", "refit", 20),
     ("held_out_gain", "held", 37)],
)  # fmt: skip
def test_bars_stay_within_their_margins(
    key: str, kind: str, top: int, value: float, left: float, width: float, text: float
) -> None:
    table = read_table(page_of([candidate(0, **{key: value})]).the("table"))
    drawn = cells(table, table.rows[0], "Explains")
    bar = drawn.the("rect", kind)
    assert (bar.number("x"), bar.number("width"), bar.number("y")) == (left, width, top)
    label = next(t for t in drawn.every("text") if t.number("y") == top + 10)
    assert label.number("x") == text
    assert drawn.the("line", "zero").number("x1") == drawn.the("line", "zero").number("x2") == 30.0
    assert drawn.the("svg").number("width") == 270.0


@pytest.mark.parametrize(
    ("strength", "error", "low", "high"),
    [(2.0, 0.5, 0.0, 3.0), (-2.0, 0.5, -3.0, 0.0), (0.3, 0.5, -0.7, 1.3), (-0.3, 0.4, -1.1, 0.5)],
)
def test_whisker_from_zero_or_two_errors(
    strength: float, error: float, low: float, high: float
) -> None:
    table = read_table(page_of([candidate(0, strength=strength, std_error=error)]).the("table"))
    drawn = cells(table, table.rows[0], "Strength")

    def at(value: float) -> float:
        return 4.0 + 142.0 * (value - low) / (high - low)

    assert drawn.the("line", "zero").number("x1") == pytest.approx(at(0.0), abs=0.06)
    assert drawn.the("line", "zero").number("x2") == drawn.the("line", "zero").number("x1")
    assert drawn.the("circle").number("cx") == pytest.approx(at(strength), abs=0.06)
    span = drawn.the("line", "interval")
    assert span.number("x1") == pytest.approx(at(strength - 2.0 * error), abs=0.06)
    assert span.number("x2") == pytest.approx(at(strength + 2.0 * error), abs=0.06)


def test_what_an_error_depends_on() -> None:
    entries = [
        {"variable": "flow", "tap": None, "gain": 0.25},
        {"variable": "time", "tap": "end", "gain": None},
        {"variable": "speed", "tap": "mid", "gain": -0.5},
        {"variable": "level", "tap": "end", "gain": 1.5},
    ]
    page = page_of([], depends_on=entries)
    assert page.the("h3").text == "What the remaining error depends on"
    table = read_table(page.the("table"))
    found = [
        [cells(table, row, h).text for h in ("Variable", "Tap", "Held-out gain")]
        + [cells(table, row, "Held-out gain").the("rect").number("width")]
        for row in table.rows
    ]
    assert found == [
        ["flow", "all", "25 %", 47.5],
        ["speed", "mid", "−50 %", 0.0],
        ["level", "end", "150 %", 190.0],
    ]
    assert not list(page_of([], depends_on=[entries[1]]).every("h3"))
