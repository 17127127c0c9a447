# SPDX-License-Identifier: Apache-2.0
"""Numbers of a rig by dotted path: reading one, a copy with some changed, those to be fitted."""

from typing import Any

from pydantic import BaseModel

from pneu_common.errors import InputError
from pneu_sim.rig.schema import FitParameter, Rig


def _step(node: Any, part: str, path: str) -> Any:
    try:
        if isinstance(node, BaseModel):
            return getattr(node, part)
        if isinstance(node, dict):
            return node[part]
        return node[int(part)]
    except (AttributeError, KeyError, IndexError, ValueError, TypeError):
        if isinstance(node, BaseModel):
            known = ", ".join(type(node).model_fields)
        elif isinstance(node, dict):
            known = ", ".join(node)
        else:
            known = f"0 to {len(node) - 1}" if isinstance(node, list) else "nothing"
        raise InputError(f"parameter {path!r}: no {part!r} there; known are {known}") from None


def _holders(rig: Rig, path: str) -> list[tuple[str, Any, str]]:
    """Of every number that a path stands for: its own path, what holds it, and its name there."""
    *parents, last = path.split(".")
    nodes: list[tuple[str, Any]] = [("", rig)]
    for part in parents:
        if part != "*":
            nodes = [(f"{at}{part}.", _step(node, part, path)) for at, node in nodes]
        elif all(isinstance(node, dict) and node for _, node in nodes):
            nodes = [(f"{at}{name}.", of) for at, node in nodes for name, of in node.items()]
        else:
            raise InputError(f"parameter {path!r}: there is nothing for '*' to stand for")
    return [(f"{at}{last}", node, last) for at, node in nodes]


def get_parameter(rig: Rig, path: str) -> float:
    """Returns the number at a dotted path.

    Args:
        rig: The rig.
        path: Such as ``pipes.tube.area_m2`` or ``valves.valve.ports.supply.opening.fraction.3``;
            ``*`` stands for every part of a mapping (``pipes.*.wall.unsteady``) and reads the
            first.

    Raises:
        InputError: There is no number at that path.
    """
    _, node, last = _holders(rig, path)[0]
    found = _step(node, last, path)
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise InputError(f"parameter {path!r}: found {found!r}, a number is needed")
    return float(found)


def each_that_differs(rig: Rig, path: str) -> list[str]:
    """The path itself; where ``*`` in it stands for numbers that differ, the path of each.

    Args:
        rig: The rig.
        path: Dotted path, see `get_parameter`.

    Raises:
        InputError: There is no number at that path.
    """
    paths = [one for one, _, _ in _holders(rig, path)]
    values = {get_parameter(rig, one) for one in paths}
    return [path] if len(values) == 1 else paths


def with_parameters(rig: Rig, values: dict[str, float]) -> Rig:
    """Returns a copy of the rig with the numbers at some paths replaced; bounds are not checked.

    Args:
        rig: The rig, left as it is.
        values: Path to new value.

    Raises:
        InputError: A path leads nowhere.
    """
    copy = rig.model_copy(deep=True)
    for path, value in values.items():
        for _, node, last in _holders(copy, path):
            _step(node, last, path)
            if isinstance(node, BaseModel):
                object.__setattr__(node, last, float(value))
                node.__pydantic_fields_set__.add(last)
            elif isinstance(node, dict):
                node[last] = float(value)
            else:
                node[int(last)] = float(value)
    return copy


def rig_in_recording(rig: Rig, name: str) -> Rig:
    """The rig with the values that it has in one recording; the rig itself where it has none.

    Args:
        rig: The rig.
        name: Name of the recording.
    """
    own = rig.recordings.get(name)
    return with_parameters(rig, own) if own else rig


def value_of(rig: Rig, parameter: FitParameter) -> float:
    """The value of a parameter, in the recording that it is for.

    Args:
        rig: The rig.
        parameter: The parameter.
    """
    own = rig.recordings.get(parameter.recording or "", {})
    return own.get(parameter.path, get_parameter(rig, parameter.path))


def misfit(rig: Rig) -> str:
    """The first parameter to fit that the rig has not, or that starts outside its bounds.

    Args:
        rig: The rig.

    Returns:
        A sentence without the file's name; empty if there is none.

    Raises:
        InputError: A path leads nowhere.
    """
    for field, listed in (("parameters", rig.fit.parameters), ("add", rig.fit.add)):
        for k, p in enumerate(listed):
            value = value_of(rig, p)
            slack = 1e-6 * (p.upper - p.lower)
            if not p.lower - slack <= value <= p.upper + slack:
                return (
                    f"fit.{field}.{k}: {p.path} starts at {value:g}, outside its bounds"
                    f" {p.lower:g} to {p.upper:g}"
                )
    return ""
