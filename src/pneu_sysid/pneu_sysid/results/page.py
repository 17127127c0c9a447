# SPDX-License-Identifier: Apache-2.0
"""The page that documents the JSON results, from their models."""

from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pneu_sysid.results.base import Result
from pneu_sysid.results.files import RESULTS

_PAGE = """\
# JSON results

`--json FILE` of `pneu compare`, `fit`, `diagnose`, `learn`, `friction` and `observe` writes one
object as below, and so does `pneu excite -o FILE`; where a scene stands for a rig, one of those
whose names begin with `pneu.scene`. All quantities are SI, pressures absolute pascals, times from
the start of the recording; the unit is in a key's name (`rmse_pa`). Encoders stand apart from
taps: their keys have no unit in their names (`rmse`), and `encoders` says of each whether it is
rad or m. Where one list holds both, a number is in its sensor's unit.
There is never NaN or infinity: where a number does not exist, `null` stands. `schema` names the
command and the version; the version rises when a key changes its meaning or goes away, not when
one is added.

Residuals are measured minus model everywhere: `bias_pa` is positive where the sensor reads above
the model. `lag_s` is positive where the measurement is later than the model.

This page is made by `python -m pneu_sysid.results.page`.
"""


def json_markdown() -> str:
    """The page that documents the JSON results."""
    parts = [_PAGE]
    done: set[type[Result]] = set()
    for kind in RESULTS:
        parts.append(_table(kind, f"## {kind.model_fields['schema_'].default}"))
        todo = _nested(kind)
        while todo:
            one = todo.pop(0)
            if one not in done:
                done.add(one)
                parts.append(_table(one, f"### {one.__name__}"))
                todo = _nested(one) + todo
    return "\n".join(parts)


def _table(kind: type[Result], heading: str) -> str:
    rows = ["| key | type | meaning |", "| --- | --- | --- |"]
    fields = kind.model_fields
    names = [n for n in fields if n == "schema_"] + [n for n in fields if n != "schema_"]
    for name in names:
        field = fields[name]
        meaning = " ".join((field.description or "").split()).replace("|", "\\|")
        rows.append(f"| `{field.alias or name}` | {_words(field.annotation)} | {meaning} |")
    about = " ".join((kind.__doc__ or "").split())
    return (
        f"{heading}\n\n{about.replace('``', '`')}\n\n" + "\n".join(rows).replace("``", "`") + "\n"
    )


def _words(annotation: Any) -> str:
    """A type in words."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _words(args[0])
    if origin in (Union, UnionType):
        return " or ".join(_words(arg) for arg in args)
    if origin is Literal:
        return " or ".join(f'`"{arg}"`' for arg in args)
    if origin is list:
        return f"list of {_words(args[0])}"
    if origin is tuple:
        return f"[{', '.join(_words(arg) for arg in args)}]"
    if origin is dict:
        return f"object of {_words(args[1])}"
    if isinstance(annotation, type) and issubclass(annotation, Result):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    plain = {str: "text", float: "number", int: "integer", bool: "boolean", type(None): "null"}
    return plain[annotation]


def _nested(kind: type[Result]) -> list[type[Result]]:
    """Models that the fields of a model are made of."""
    found: list[type[Result]] = []
    todo: list[Any] = [field.annotation for field in kind.model_fields.values()]
    while todo:
        one = todo.pop(0)
        if isinstance(one, type) and issubclass(one, Result):
            found.append(one)
        todo = list(get_args(one)) + todo if not isinstance(one, str) else todo
    return found


if __name__ == "__main__":
    print(json_markdown(), end="")
