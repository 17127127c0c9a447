# SPDX-License-Identifier: Apache-2.0
"""Channels out of delimited text (CSV, tab, blanks) by a column map."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.channels import Channel, TextFormat
from pneu_sysid.records.recording import Finding, absent
from pneu_sysid.records.stream import STAMP_LIMIT_NS, Role, Stream

_MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}


def read_text(
    path: Path,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    layout: TextFormat,
    positions: dict[str, Channel] | None = None,
    encoders: dict[str, Channel] | None = None,
) -> tuple[list[Stream], list[Finding]]:
    """Read the mapped columns of a text file.

    Args:
        path: Text file, one sample of all channels per line.
        commands: Held channels by name.
        pressures: Pressure channels by name.
        layout: How the rows are laid out.
        positions: Channels of spools' positions by name, which the file may lack.
        encoders: Channels of encoders by name.

    Returns:
        One stream per channel on the file's time column, and the findings about rows. Positions
        without a column in the file are among the findings.

    Raises:
        InputError: The file is missing or not text, or a column is absent or not numeric.
    """
    rows, numbers, names, findings = read_rows(path, layout)
    time_index = _column(path, "time", layout.time, names, len(rows[0]))
    wanted = {
        name: _column(path, name, channel.column, names, len(rows[0]))
        for name, channel in {**commands, **pressures, **(encoders or {})}.items()
    }
    present: dict[str, Channel] = {}
    for name, channel in (positions or {}).items():
        column = channel.column
        if column is None:
            findings.append(absent(name, "it has no column"))
        elif column in names or (isinstance(column, int) and 0 <= column < len(rows[0])):
            wanted[name] = _column(path, name, column, names, len(rows[0]))
            present[name] = channel
        else:
            findings.append(absent(name, f"the file has no column {column!r}"))
    width = max([time_index, *wanted.values()]) + 1
    whole = [i for i, row in enumerate(rows) if len(row) >= width]
    if len(whole) < len(rows):
        note = f"row(s) with fewer than {width} columns were dropped"
        findings.append(Finding(path.name, "short_row", len(rows) - len(whole), note))
        rows = [rows[i] for i in whole]
        numbers = [numbers[i] for i in whole]
    time = numbers_of(path, "time", rows, numbers, time_index, layout, findings)
    timed = np.isfinite(time)
    if not timed.all():
        note = "row(s) without a time were dropped"
        findings.append(Finding(path.name, "unreadable", int((~timed).sum()), note))
    with np.errstate(over="ignore"):  # beyond all clocks, and clipped to that below
        time_ns = np.rint(time[timed] * layout.time_scale * 1e9)
    stamp_ns = np.clip(time_ns, -STAMP_LIMIT_NS, STAMP_LIMIT_NS).astype(np.int64)
    arrival = np.flatnonzero(timed)
    streams = []
    roles: list[tuple[Role, dict[str, Channel]]] = [
        ("command", commands),
        ("pressure", pressures),
        ("encoder", encoders or {}),
        ("position", present),
    ]
    for role, channels in roles:
        for name, channel in channels.items():
            raw = numbers_of(path, name, rows, numbers, wanted[name], layout, findings)[timed]
            streams.append(
                Stream(
                    name=name,
                    role=role,
                    source=f"{path.name}, column {channel.column}",
                    arrival=arrival,
                    log_ns=stamp_ns,
                    header_ns=None,
                    values=channel.convert(raw),
                    stamp_ns=stamp_ns,
                )
            )
    return streams, findings


def read_rows(
    path: Path, layout: TextFormat
) -> tuple[list[list[str]], list[int], list[str], list[Finding]]:
    """Return the data rows as words, their line numbers, the column names if any, and findings.

    Args:
        path: Text file.
        layout: How the rows are laid out.

    Raises:
        InputError: It is no text, or has no row.
    """
    if not path.is_file():
        raise InputError(f"{path}: is no file and no bag")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
    except UnicodeDecodeError as err:
        raise InputError(f"{path}: byte {err.start} is not text; a bag must be .mcap") from err
    comments: list[str] = []
    kept: list[tuple[int, str]] = []
    for number, line in enumerate(lines[layout.skip_rows :], start=layout.skip_rows + 1):
        if layout.comment and line.startswith(layout.comment):
            if not kept:
                comments.append(line[len(layout.comment) :])
        elif line.strip():
            kept.append((number, line))
    if not kept:
        raise InputError(f"{path}: the file holds no rows ({len(lines)} lines)")
    delimiter = layout.delimiter or _guess_delimiter([line for _, line in kept[-20:]], layout)
    rows = [_split(path, number, line, delimiter) for number, line in kept]
    numbers = [number for number, _ in kept]
    names: list[str] = []
    if not any(_is_number(word, layout) for word in rows[0]):
        names, rows, numbers = rows[0], rows[1:], numbers[1:]
        if not rows:
            raise InputError(f"{path}: the file holds a heading but no rows")
    elif comments and len(last := _split(path, 0, comments[-1], delimiter)) == len(rows[0]):
        names = last
    return rows, numbers, list(layout.names) if layout.names else names, []


def _guess_delimiter(lines: list[str], layout: TextFormat) -> str:
    for candidate in (";", "\t", ","):
        if candidate in (layout.decimal, layout.thousands_separator):
            continue
        if sum(candidate in line for line in lines) >= 0.8 * len(lines):  # a few may be spoilt
            return candidate
    return " "


def _split(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return [word.strip() for word in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error as err:  # a cell longer than any number
        where = f"line {number}" if number else "the comment above the numbers"
        raise InputError(f"{path}: {where} cannot be split into columns ({err})") from None
    except (TypeError, ValueError) as err:
        raise InputError(
            f"{path}: text.delimiter: found {delimiter!r}, which cannot be one ({err})"
        ) from None


def _plain(word: str, layout: TextFormat) -> str:
    """Return a number's text without grouping and with a decimal point."""
    group = layout.thousands_separator
    if group == layout.decimal:
        head, point, tail = word.rpartition(group)
        word = head.replace(group, "") + point + tail
    elif group:
        word = word.replace(group, "")
    return word if layout.decimal == "." else word.replace(layout.decimal, ".")


def _is_number(word: str, layout: TextFormat) -> bool:
    try:
        float(_plain(word, layout))
    except ValueError:
        return False
    return True


def _column(path: Path, channel: str, column: str | int | None, names: list[str], n: int) -> int:
    if column is None:
        raise InputError(f"{path}: channel '{channel}' has no column, which a text file needs")
    if isinstance(column, int):
        if not 0 <= column < n:
            raise InputError(
                f"{path}: channel '{channel}': no column {column}; "
                f"the rows have columns 0 to {n - 1}"
            )
        return column
    if column not in names:
        have = ", ".join(names) if names else f"no names, {n} columns numbered from 0"
        raise InputError(
            f"{path}: channel '{channel}': no column '{column}' (the file has: {have})"
        )
    return names.index(column)


def numbers_of(
    path: Path,
    channel: str,
    rows: list[list[str]],
    lines: list[int],
    column: int,
    layout: TextFormat,
    findings: list[Finding],
) -> NDArray[np.float64]:
    """Return one column as floats, NaN where a cell is empty or unreadable.

    Args:
        path: Text file, for messages.
        channel: What the column is of.
        rows: Rows as words.
        lines: Numbers of their lines.
        column: Number of the column.
        layout: How rows are laid out.
        findings: Receives what was found.

    Raises:
        InputError: No cell of it is a number.
    """
    values = np.full(len(rows), np.nan)
    bad: list[int] = []
    for i, row in enumerate(rows):
        word = row[column]
        try:
            values[i] = float(_plain(word, layout))
        except ValueError:
            if word.lower() not in _MISSING:
                bad.append(i)
    if 2 * len(bad) > len(rows):
        raise InputError(
            f"{path}: channel '{channel}': column {column} is not numeric "
            f"(line {lines[bad[0]]} has '{rows[bad[0]][column][:40]}')"
        )
    if bad:
        note = f"cell(s) that are no number, first in line {lines[bad[0]]}, were taken as missing"
        findings.append(Finding(channel, "unreadable", len(bad), note))
    return values
