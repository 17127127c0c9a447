# SPDX-License-Identifier: Apache-2.0
"""The numbers of a rig file as fields of a form: named, in the units that people use, checked.

A rig file stores SI. Which unit a number is shown in follows from the end of its name, as the
schema has it: `length_m` in mm, `pressure_pa` in bar.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.rig.load import check_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.parameter_units import PURE, SUFFIXES, unit_of_name
from pneu_sysid.report.quantities import pretty_unit

Keys = tuple[str, ...]

UNITS = {
    "Pa": ("bar", 1e-5),
    "m": ("mm", 1e3),
    "m^2": ("mm²", 1e6),
    "m^3": ("ml", 1e6),
    "m^3/(s Pa)": ("l/(min bar)", 6e9),
    "s": ("ms", 1e3),
}
"""Units that people use instead of the SI's, and how many of them one of those is."""
PARTS = (
    "ambient", "reservoirs", "pipes", "chambers", "valves", "cylinders", "taps", "encoders",
    "effects", "mechanism", "grid",
)  # fmt: skip
"""Parts of a rig file that are edited, in this order."""
LEFT_OUT = ("channel", "opening", "position_channel")
"""Keys under which there is more than single numbers."""


@dataclass(frozen=True)
class Field:
    """A number of a rig file.

    Attributes:
        keys: Where it stands in the file.
        part: The part that it is of, in words.
        label: Its name.
        unit: Unit that it is shown in; empty where it has none.
        scale: How many of them one of the SI is.
        value: It, in that unit.
    """

    keys: Keys
    part: str
    label: str
    unit: str
    scale: float
    value: float

    @property
    def text(self) -> str:
        """The number as it is shown: no more digits than it has."""
        return f"{self.value:.10g}"


def shown_unit(name: str) -> tuple[str, float]:
    """Unit that a number is shown in, and how many of them one of the SI is.

    Args:
        name: Its name in the rig file.
    """
    unit = unit_of_name(name)
    return UNITS.get(unit or "", (pretty_unit(unit), 1.0))


def fields_of(data: dict[str, Any]) -> list[Field]:
    """The numbers of a rig file, part after part.

    Args:
        data: The file as plain values.
    """
    out = []
    for part in PARTS:
        if part in data:
            out += list(_fields(data[part], (part,)))
    return out


def _fields(value: Any, keys: Keys) -> Iterator[Field]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in LEFT_OUT:
                yield from _fields(inner, (*keys, str(key)))
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            if isinstance(inner, dict):
                yield from _fields(inner, (*keys, str(k)))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        unit, scale = shown_unit(keys[-1])
        words = keys[-1]
        if words not in PURE:
            words = words.removesuffix(next((e for e, _ in SUFFIXES if words.endswith(e)), ""))
        part = ", ".join(keys[:-1])
        yield Field(keys, part, words.replace("_", " "), unit, scale, float(value) * scale)


def with_number(data: dict[str, Any], field: Field, text: str) -> dict[str, Any]:
    """A rig file with another number in a field.

    Args:
        data: The file as plain values; it stays as it is.
        field: The field.
        text: The number as it was typed, in the field's unit; a comma is a point.

    Raises:
        InputError: It is no number.
    """
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        named = f"{field.part}: {field.label}"
        raise InputError(f"{named}: found {text!r}, a number is needed") from None
    if text.strip().replace(",", ".") == field.text:
        return data
    return with_value(data, field.keys, value / field.scale)


def with_value(data: dict[str, Any], keys: Keys, value: Any) -> dict[str, Any]:
    """A rig file with another value somewhere.

    Args:
        data: The file as plain values; it stays as it is.
        keys: Where; what is not there is made.
        value: What; None takes away what is there.
    """
    out = deepcopy(data)
    at: Any = out
    for key in keys[:-1]:
        at = at[int(key)] if isinstance(at, list) else at.setdefault(key, {})
    if value is None:
        at.pop(keys[-1], None)
    elif isinstance(at, list):
        at[int(keys[-1])] = value
    else:
        at[keys[-1]] = value
    return out


def checked(data: dict[str, Any], path: Path) -> tuple[Rig | None, str]:
    """The rig that a file describes, or what is wrong with it in one sentence.

    Args:
        data: The file as plain values.
        path: Where it is, for files that it names.
    """
    try:
        return check_rig(deepcopy(data), path), ""
    except InputError as error:
        return None, str(error).removeprefix(f"{path}: ")


def channels_of(data: dict[str, Any]) -> list[tuple[Keys, str]]:
    """Commands, taps and encoders of a rig file that a recording has channels of.

    Args:
        data: The file as plain values.

    Returns:
        Where the channel stands in the file, and what it is of.
    """
    return [
        ((part, name, "channel"), f"{part.removesuffix('s')} {name}")
        for part in ("commands", "taps", "encoders")
        for name in data.get(part) or {}
    ]
