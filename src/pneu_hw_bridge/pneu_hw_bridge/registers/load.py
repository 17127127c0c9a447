# SPDX-License-Identifier: Apache-2.0
"""Reading register maps: a YAML file or a profile by name, one clear sentence where it is wrong."""

import difflib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pneu_common.documents import parse_yaml, read_text
from pneu_common.errors import InputError
from pneu_hw_bridge.registers.clock import Clock, Commands, Count, Records, Ticks
from pneu_hw_bridge.registers.part import Part
from pneu_hw_bridge.registers.schema import (
    SCHEMA_VERSION,
    Batching,
    Device,
    Input,
    Output,
    RegisterMap,
    Setting,
)


def profiles() -> list[str]:
    """Names of the maps that come with the package."""
    folder = resources.files("pneu_hw_bridge.registers").joinpath("profiles")
    return sorted(one.name.removesuffix(".yaml") for one in folder.iterdir() if one.is_file())


def load_register_map(source: str | Path, device: Mapping[str, Any] | None = None) -> RegisterMap:
    """Reads and checks a register map.

    Args:
        source: A YAML file, or the name of a profile.
        device: Entries of ``device`` that replace those of the file.

    Raises:
        InputError: There is no such map, or it says something a map cannot be.
    """
    known = profiles()
    if str(source) in known:
        folder = resources.files("pneu_hw_bridge.registers").joinpath("profiles")
        text = folder.joinpath(f"{source}.yaml").read_text(encoding="utf-8")
    else:
        text = read_text(source, f"register map (a file, or one of {', '.join(known)})")
    return parse_register_map(text, str(source), device)


def parse_register_map(
    text: str, name: str, device: Mapping[str, Any] | None = None
) -> RegisterMap:
    """Reads and checks the text of a register map.

    Args:
        text: The YAML text.
        name: What messages call it.
        device: Entries of ``device`` that replace those of the text.

    Raises:
        InputError: It says something a map cannot be.
    """
    data = parse_yaml(text, name, "register map")
    if not isinstance(data, dict):
        raise InputError(f"{name}: a register map is a mapping, found {type(data).__name__}")
    if data.get("pneu_registers") != SCHEMA_VERSION:
        raise InputError(
            f"{name}: pneu_registers: found {data.get('pneu_registers')!r}, this version reads"
            f" {SCHEMA_VERSION}"
        )
    if device:
        given = data.get("device") or {}
        if isinstance(given, dict):
            data["device"] = {**given, **device}
    try:
        return RegisterMap.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(name, error)) from None


def _sentence(name: str, error: ValidationError) -> str:
    """Turns the first fault of a validation into one sentence."""
    # A misspelt key is also a missing one; the misspelling is what helps.
    faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    first = faults[0]
    # The direction, by which pydantic tells channels apart, is no key of the file.
    loc = [str(part) for part in first["loc"] if part not in ("read", "write")]
    where = ".".join(loc)
    if first["type"] == "extra_forbidden":
        known = _fields_at(loc)
        near = difflib.get_close_matches(loc[-1], known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
        return f"{name}: unknown key {where!r}{hint}"
    message = first["msg"].removeprefix("Value error, ")
    found = first.get("input")
    shown = f", found {found!r}" if isinstance(found, int | float | str | bool) else ""
    return f"{name}: {where + ': ' if where else ''}{message}{shown}"


def _fields_at(loc: list[str]) -> list[str]:
    """Names allowed where an unknown key was found."""
    parts: dict[str, tuple[type[Part], ...]] = {
        "channels": (Output, Input),
        "device": (Device,),
        "batching": (Batching,),
        "settings": (Setting,),
        "clock": (Clock,),
        "clock.samples": (Records,),
        "clock.commands": (Commands,),
        "clock.samples.counter": (Count,),
        "clock.samples.time": (Ticks,),
        "clock.commands.counter": (Count,),
        "clock.commands.time": (Ticks,),
    }
    models = parts.get(".".join(loc[:-1])) or parts.get(loc[0]) if len(loc) > 1 else None
    return sorted({name for model in models or (RegisterMap,) for name in model.model_fields})
