# SPDX-License-Identifier: Apache-2.0
"""Recordings of scenes as CSV: a line of names, then one of numbers per instant."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Series, Track, unbroken

Floats = NDArray[np.float64]

UNIT_WITHIN = 0.02
"""A quaternion's length may differ from one by so much: numbers of few digits."""


def read_csv(path: str | Path, loaded: Loaded) -> Track:
    """Reads a CSV file.

    Args:
        path: The file.
        loaded: The scene.

    Raises:
        InputError: The file is missing or no table of numbers, or lacks what the scene needs.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = list(csv.reader(stream))
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV ({error})") from None
    if len(lines) < 2:
        raise InputError(f"{path}: is empty: a line of names and lines of numbers are needed")
    names = [name.strip() for name in lines[0]]
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if not line:
            continue
        try:
            row = [float(x) for x in line]
        except ValueError:
            raise InputError(f"{path}: line {number}: holds what is no number") from None
        if len(row) != len(names):
            raise InputError(
                f"{path}: line {number}: has {len(row)} numbers, the first line {len(names)} names"
            )
        rows.append(row)
    table = np.array(rows)
    time = _time(path, names, table, loaded)
    sensors = {}
    for name, settings in loaded.scene.sensors.items():
        if not settings.columns:
            raise InputError(f"{path}: sensors: {name}: the scene names no columns for it")
        values = _columns(path, names, table, settings.columns, f"sensors: {name}")
        good = np.isfinite(values).all(axis=1)
        if good.sum() < 4:
            raise InputError(f"{path}: {name}: has {good.sum()} readings, too few")
        values, at = values[good], time[good]
        if loaded.widths[name] == 4:
            values = unit_quaternions(values, f"{path}: {name}")
        else:
            values = values * settings.unit
        sensors[name] = Series(at, values)
    controls = {}
    for name, control in loaded.scene.controls.items():
        if control.column is not None:
            values = _columns(path, names, table, (control.column,), f"controls: {name}")
            controls[name] = Series(time, values * control.unit)
    return Track(path.stem, sensors, controls)


def unit_quaternions(values: Floats, what: str) -> Floats:
    """Quaternions of unit length without jumps of sign.

    Args:
        values: (m, 4).
        what: What messages call them.

    Raises:
        InputError: They are not of unit length.
    """
    length = np.linalg.norm(values, axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > UNIT_WITHIN:
        raise InputError(
            f"{what}: reading {worst + 1} is a quaternion of length {length[worst]:.3g}; an"
            " orientation has length 1"
        )
    return unbroken(values)


def _columns(
    path: Path, names: list[str], table: Floats, wanted: tuple[str, ...], what: str
) -> Floats:
    for name in wanted:
        if name not in names:
            raise InputError(f"{path}: {what}: no column {name!r}; there are {', '.join(names)}")
    return table[:, [names.index(name) for name in wanted]]


def _time(path: Path, names: list[str], table: Floats, loaded: Loaded) -> Floats:
    if "time_s" in names:
        time = table[:, names.index("time_s")]
        back = np.flatnonzero(~(np.diff(time) > 0.0))
        if len(back):
            raise InputError(
                f"{path}: time_s: runs backwards or stands still at line {back[0] + 3}"
                f" ({time[back[0]]:g} s, then {time[back[0] + 1]:g} s)"
            )
        return np.asarray(time - time[0])
    if loaded.scene.rate_hz is None:
        raise InputError(f"{path}: has no column time_s, and the scene no rate_hz")
    return np.asarray(np.arange(len(table)) / loaded.scene.rate_hz)
