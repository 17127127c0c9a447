# SPDX-License-Identifier: Apache-2.0
"""What pydantic finds wrong, in one sentence: where, what was found, what is allowed."""

import difflib
import types
from collections.abc import Mapping
from typing import Annotated, Any, Self, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Strict, Tag, ValidationError

from pneu_common.errors import InputError


def sentence(error: ValidationError, model: Any) -> str:
    """The first fault of a validation; an unknown key comes first, as its right name is missing.

    Args:
        error: The faults.
        model: The class, or the annotation, that was validated.
    """
    faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    first = faults[0]
    unknown = first["type"] == "extra_forbidden"
    where = ".".join(str(part) for part in _walk(model, first["loc"], unknown)[1])
    if unknown:
        key = str(first["loc"][-1])
        known = _fields_at(model, first["loc"][:-1])
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
        return f"unknown key {where!r}{hint}"
    if first["type"].startswith("union_tag"):
        return f"{where + ': ' if where else ''}{_untagged(first['ctx'])}"
    message = first["msg"].removeprefix("Value error, ")
    found = first.get("input")
    said = f", found {found!r}" if isinstance(found, int | float | str | bool) else ""
    return f"{where + ': ' if where else ''}{message}{said}"


def _untagged(context: Mapping[str, Any]) -> str:
    """What is wrong with the key that tells which of several kinds a part is.

    Args:
        context: What pydantic tells of it.
    """
    # of a key that may be left out it tells the function that looks at it, which is named so
    key = str(context["discriminator"]).strip("'").removesuffix("()")
    if "tag" not in context:
        return f"{key} is needed, which says what kind it is"
    return f"{key}: found {context['tag']!r}, allowed are {context['expected_tags']}"


def _inner(annotation: Any) -> list[Any]:
    """Classes of models, mappings and tagged alternatives that a value may be made of."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        tags = [one.tag for one in arguments[1:] if isinstance(one, Tag)]
        inner = _inner(arguments[0])
        return [(tags[0], inner)] if tags else inner
    if origin in (Union, types.UnionType):
        return [one for argument in arguments for one in _inner(argument)]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return [("each", _inner(arguments[1]))]
    if origin in (list, tuple):
        return [("each", [one for argument in arguments for one in _inner(argument)])]
    return (
        [annotation] if isinstance(annotation, type) and issubclass(annotation, BaseModel) else []
    )


def _walk(
    model: Any, loc: tuple[int | str, ...], unknown: bool
) -> tuple[list[Any], list[int | str]]:
    """What is at a place, and the place without the names of alternatives that lead to it.

    Args:
        model: What was validated.
        loc: The place as pydantic names it.
        unknown: Whether its last part is a key that is not known, rather than an alternative.
    """
    at, way = _inner(model), []
    for number, part in enumerate(loc):
        following = []
        known = tagged = False
        for one in at:
            if isinstance(one, tuple):
                if one[0] in ("each", part):
                    following += one[1]
                    known = True
                    tagged = tagged or one[0] != "each"
                continue
            for name, field in one.model_fields.items():
                if part in (name, field.alias):
                    following += _inner(field.annotation)
                    known = True
        if not known:
            if unknown and number == len(loc) - 1:
                way.append(part)
            continue  # pydantic tells which of several alternatives it tried
        at = following
        if not tagged:
            way.append(part)
    return at, way


def _fields_at(model: Any, loc: tuple[int | str, ...]) -> list[str]:
    found = [one for one in _walk(model, loc, False)[0] if not isinstance(one, tuple)]
    return [field.alias or name for one in found for name, field in one.model_fields.items()]


Listed = Strict(False)
"""For a tuple among settings, which a file has as a list."""


class Settings(BaseModel):
    """Settings that are made of plain values, checked as they are made, and never change.

    A text is no number, and a number with a fraction no whole one. Tuples are written
    ``Annotated[tuple[float, ...], Listed]``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        """Checks and takes the values.

        Args:
            values: By the fields' names.

        Raises:
            InputError: A field is unknown, missing, of a wrong type or out of range.
        """
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(sentence(error, type(self))) from None

    # Else pydantic would make parts of settings by calling this, and lose where a fault is.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def usual(cls, name: str) -> Any:
        """The value of a field where none is given.

        Args:
            name: The field.
        """
        return cls.model_fields[name].default

    def but(self, **changes: Any) -> Self:
        """The same but for some fields.

        Args:
            changes: Their values.

        Raises:
            InputError: As `__init__`.
        """
        given = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**(given | changes))

    def plain(self) -> dict[str, Any]:
        """The same as plain values, as they go into YAML, JSON and provenance."""
        return self.model_dump(mode="json")
