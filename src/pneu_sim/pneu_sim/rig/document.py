# SPDX-License-Identifier: Apache-2.0
"""The reference of rig files, `docs/rig.md`, made from the schema that checks them."""

import inspect
import json
import re
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pneu_sim.rig.schema import Rig

_HEAD = """\
# Rig files

One rig is one YAML file. It names the parts of the rig, what they are connected to, where their
signals are recorded, and what identification may change. `pneu check RIG` says whether a file is
sound and shows what would be simulated; an unknown key, a value out of range or a part that is not
connected is refused with one sentence. `pneu init` writes a file to begin with, whose comments say
what to change and where to find it.

A rig is a network of named *nodes*. A pipe runs from one node to another. A reservoir or a chamber
sits at the node that has its name. Valve ports and orifices connect two nodes. The node `closed` is
a wall. Nodes need no declaration: a name that only pipes and ports use is a plain junction. A side
of a cylinder is a chamber at the node that it names; cylinders move bodies, whose joints have the
name of the body and their own (`cart_slide`) unless they are given one.

All quantities are SI and pressures absolute; the unit is in the key's name. Positions along a pipe
count from its `from` node. A key without a default must be given.

```yaml
pneu_rig: 1
name: bench
reservoirs:
  supply: {pressure_pa: 635000.0}
  room: {pressure_pa: 101000.0}
pipes:
  tube: {from: valve_out, to: closed, length_m: 2.5, area_m2: 6.0e-6}
valves:
  valve:
    command: voltage
    spool: {bandwidth_hz: 60.0}
    ports:
      fill:
        from: supply
        to: valve_out
        conductance_m3_s_pa: 0.9e-8
        opening: {voltage_v: [5.0, 10.0], fraction: [0.0, 1.0]}
      exhaust:
        from: valve_out
        to: room
        conductance_m3_s_pa: 0.9e-8
        opening: {mirror: fill}
commands:
  voltage: {channel: {topic: /valve/voltage}}
taps:
  end: {pipe: tube, position_m: 2.5, channel: {topic: /taps/end, field: fluid_pressure}}
```

Numbers are reached by dotted paths, `pipes.tube.area_m2` or
`valves.valve.ports.fill.opening.fraction.1`; in `fit`, `*` stands for every part of a kind
(`pipes.*.wall.unsteady`).

A valve is written as the general one, a spool and its ports, or with a few fields as a `kind` of
valve that robots have ([5/3](#fivethree), [3/3](#threethree), [3/2](#threetwo), [2/2](#twotwo),
[pressure regulator](#regulator)):

```yaml
valves:
  arm: {kind: 5/3, command: arm_v, supply: tank, outlets: [cap, rod], exhausts: [room],
        conductance_m3_s_pa: 2.8e-8, critical_ratio: 0.3, overlap_v: 0.1, bandwidth_hz: 100.0}
  muscle: {kind: 3/2, command: duty, supply: tank, outlet: muscle, exhaust: room,
           conductance_m3_s_pa: 4.0e-9, opening_delay_s: 0.0012, closing_delay_s: 0.0015,
           movement_s: 0.0005, pwm_hz: 100.0}
  preload: {kind: regulator, command: preload_v, supply: tank, outlet: bladder, exhaust: room,
            conductance_m3_s_pa: 1.0e-8, high_pa: 601325.0}
```

It becomes the general one as the file is read. Paths, effects, results and files that are written
know the ports and the spool of that: `valves.arm.ports.supply_a.conductance_m3_s_pa`,
`valves.preload.regulator.dead_zone_pa`.

This page is made by `python -m pneu_sim.rig.document`.
"""


def as_markdown() -> str:
    """The page that documents rig files."""
    parts = [_HEAD]
    done: set[type[BaseModel]] = set()
    todo: list[type[BaseModel]] = [Rig]
    while todo:
        model = todo.pop(0)
        if model not in done:
            done.add(model)
            parts.append(_section(model))
            todo = _nested(model) + todo
    return "\n".join(parts)


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """What the docstrings of a part, and of what it is a kind of, say about its keys.

    Args:
        model: The part.

    Returns:
        Sentences by attribute name; the part's own come before those of what it is a kind of.
    """
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, BaseModel):
            found |= _told_by(kind.__dict__.get("__doc__") or "")
    return found


def _told_by(docstring: str) -> dict[str, str]:
    _, _, body = inspect.cleandoc(docstring).partition("Attributes:\n")
    found: dict[str, str] = {}
    name = ""
    for line in body.splitlines():
        entry = re.match(r"    (\w+): (.*)", line)
        if entry:
            name = entry[1]
            found[name] = entry[2]
        elif name and line.startswith("        "):
            found[name] += " " + line.strip()
        else:
            break
    return found


def _section(model: type[BaseModel]) -> str:
    about = inspect.cleandoc(model.__doc__ or "").split("\n\nAttributes:")[0]
    told = meanings(model)
    rows = ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
    rows += [
        f"| `{field.alias or name}` | {_type(field)} | {_default(field)} | {_plain(told[name])} |"
        for name, field in model.model_fields.items()
    ]
    return f"## {model.__name__}\n\n{_plain(about, ' ')}\n\n" + "\n".join(rows) + "\n"


def _plain(text: str, bar: str = "\\|") -> str:
    """Docstring text on one line, as Markdown."""
    return " ".join(text.split()).replace("``", "`").replace("|", bar)


def _type(field: FieldInfo) -> str:
    bounds = [
        sign + f"{getattr(limit, name):g}"
        for limit in field.metadata
        for name, sign in (("gt", "> "), ("ge", "≥ "), ("lt", "< "), ("le", "≤ "))
        if getattr(limit, name, None) is not None
    ]
    return ", ".join([_words(field.annotation), *bounds])


def _words(annotation: Any) -> str:
    """A type in words, with its bounds."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        limits = [m for m in args[1:] if isinstance(m, FieldInfo)]
        return _type(FieldInfo.merge_field_infos(*limits, annotation=args[0]))
    if origin in (Union, UnionType):
        return " or ".join(_words(arg) for arg in args if arg is not type(None))
    if origin is Literal:
        return " or ".join(f"`{arg}`" for arg in args)
    if origin is list:
        return f"list of {_words(args[0])}"
    if origin is tuple:
        inner = [arg for arg in args if arg is not Ellipsis]
        return f"[{', '.join(map(_words, inner))}{', ...' if len(inner) < len(args) else ''}]"
    if origin is dict:
        return f"name: {_words(args[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    plain = {str: "text", float: "number", int: "integer", bool: "`true` or `false`"}
    return plain[annotation]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    value = field.get_default(call_default_factory=True)
    if value is None:
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, int | float):
        return f"{value:g}"
    if isinstance(value, str):
        return f"`{value}`" if value else "empty"
    if isinstance(value, tuple):
        return f"[{', '.join(f'{one:g}' for one in value)}]"
    if isinstance(value, BaseModel):
        return _differs(value)
    return "empty"


def _differs(value: BaseModel) -> str:
    """What a part is by default, as it would be written, where that is not the part's own."""
    changed = value.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    if not changed:
        return "its defaults"
    # JSON without quotes around words is YAML, as a rig file has it
    return "`" + json.dumps(changed).replace('"', "") + "`"


def _nested(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Parts that the keys of a part are made of, in order."""
    found: list[type[BaseModel]] = []
    todo: list[Any] = [field.annotation for field in model.model_fields.values()]
    while todo:
        one = todo.pop(0)
        if isinstance(one, type) and issubclass(one, BaseModel):
            found.append(one)
        elif get_origin(one) is not Literal:
            todo = list(get_args(one)) + todo
    return found


if __name__ == "__main__":
    print(as_markdown(), end="")
