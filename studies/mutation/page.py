# SPDX-License-Identifier: Apache-2.0
"""The results as a page: rates by group and by class, survivors, and faults that change nothing."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import yaml

from studies.digest import ROOT, digest_of
from studies.mutation.faults import CRITICAL, GROUPS, sources
from studies.mutation.operators import CLASSES

PAGE = ROOT / "docs" / "results" / "mutation.md"
EQUIVALENTS = ROOT / "studies" / "mutation" / "equivalents.yaml"
MARK, CRITICAL_MARK = 0.85, 0.9


def equivalents() -> dict[tuple[str, str, str], str]:
    """Return why a fault changes nothing that could be noticed, by path, lines before and after."""
    listed = yaml.safe_load(EQUIVALENTS.read_text(encoding="utf-8")) or []
    return {(one["path"], one["before"], one["after"]): one["reason"] for one in listed}


def _rates(name: str, values: Iterable[Any], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a table of what became of faults by a field."""
    lines = [
        f"| {name} | faults | noticed | survived | equivalent | rate | when drawn |",
        "|---|---|---|---|---|---|---|",
    ]
    for value in (*values, "all"):
        of = [row for row in rows if value == "all" or row[name] == value]
        if not of:
            continue
        noticed = sum(row["status"] == "noticed" for row in of)
        equivalent = sum(row["status"] == "equivalent" for row in of)
        survived = len(of) - noticed - equivalent
        count = max(len(of) - equivalent, 1)
        # (a fault is tried again until a test notices it; one that is equivalent is never noticed)
        first = sum(row["first"] == "noticed" for row in of)
        lines.append(
            f"| {value} | {len(of)} | {noticed} | {survived} | {equivalent} |"
            f" {noticed / count:.0%} | {first / count:.0%} |"
        )
    return lines


def _covered(totals: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return a table of the lines and branches that tests reach, by group."""
    lines = ["| group | lines | reached | branches | taken |", "|---|---|---|---|---|"]
    groups = sources()
    for group in (*GROUPS, "all"):
        of = [one for path, one in totals.items() if group in ("all", groups.get(path))]
        shown = []
        for whole, part in (
            ("num_statements", "covered_lines"),
            ("num_branches", "covered_branches"),
        ):
            count = sum(one[whole] for one in of)
            shown.append(f"{count} | {sum(one[part] for one in of) / max(count, 1):.1%}")
        lines.append(f"| {group} | {' | '.join(shown)} |")
    return lines


def _code(text: str) -> str:
    """Return code for a cell of a table."""
    text = text if len(text) <= 110 else f"{text[:107]}..."
    return f"`{text.replace('|', chr(92) + '|').replace('`', '')}`" if text else "(nothing)"


def page(
    rows: Sequence[dict[str, Any]],
    totals: Mapping[str, Mapping[str, int]],
    drawn: Mapping[int, int],
) -> str:
    """Return the page.

    Args:
        rows: Fields of each fault and of its outcome; a survivor that is argued to be equivalent
            counts as such.
        totals: Of the coverage of each file.
        drawn: How many faults of each group, by the seed that they were drawn with.
    """
    known = equivalents()
    rows = [dict(row) for row in rows]
    for row in rows:
        reason = known.get((row["path"], row["before"], row["after"]))
        if row["status"] != "noticed" and reason is not None:
            row.update(status="equivalent", reason=reason)
    took_s = sum(row["took_s"] for row in rows)
    draws = " and ".join(f"{each} with seed {seed}" for seed, each in drawn.items())
    lines = [
        "# Faults that the tests notice",
        "",
        "Written by `make mutate`. Cosmic Ray and operators of our own"
        " (`studies/mutation/operators.py`) put faults into the source, one at a time; the tests of"
        " `make test` that reach the changed lines are run until one fails. A fault that no test"
        f" reaches has survived. Of each group {draws} were drawn, classes in turn; {len(rows)} in"
        f" all took {took_s / 60:.0f} minutes of trials,"
        f" {took_s / max(len(rows), 1):.0f} s each. For survivors tests were written, and they were"
        " tried again: the last column is the share that was noticed when a fault was first tried,"
        " and those of a later seed were drawn when the tests for an earlier one stood. Sources"
        f" {digest_of([ROOT / 'src'])}, tests {digest_of([ROOT / 'tests'])}.",
        "",
        f"The mark is {CRITICAL_MARK:.0%} in {', '.join(CRITICAL)}, and {MARK:.0%} elsewhere.",
        "",
        *_rates("seed", sorted({row["seed"] for row in rows}), rows),
        "",
        *_rates("group", GROUPS, rows),
        "",
        *_rates("kind", CLASSES, rows),
        "",
        "Lines and branches that the tests reach (kernels where they run uncompiled):",
        "",
        *_covered(totals),
        "",
        "## Survivors",
        "",
        "| group | kind | place | before | after |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        if row["status"] in ("survived", "not run"):
            where = f"{row['path'].removeprefix('src/')}:{row['line']}"
            shown = _code(row["before"]), _code(row["after"])
            lines.append(f"| {row['group']} | {row['kind']} | {where} | {shown[0]} | {shown[1]} |")
    lines += ["", "## Equivalents", "", "| place | before | after | reason |", "|---|---|---|---|"]
    for row in rows:
        if row["status"] == "equivalent":
            where = f"{row['path'].removeprefix('src/')}:{row['line']}"
            shown = _code(row["before"]), _code(row["after"])
            lines.append(f"| {where} | {shown[0]} | {shown[1]} | {row['reason']} |")
    return "\n".join([*lines, ""])
