# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON that people write, as plain values: one sentence where a file holds none.

What a file means may be far more than what it says, or nothing that can be computed with: aliases
that stand for millions of values or for themselves, numbers of thousands of digits, half of a
character. That is refused here, so that what reads the values need not think of it.
"""

import json
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import ReusedAnchorWarning, YAMLError
from ruamel.yaml.nodes import MappingNode, SequenceNode

from pneu_common.errors import InputError

LARGEST_BYTES = 32 << 20
"""Size of a file that people write."""
MOST_VALUES = 1_000_000
"""Values that a document may stand for, those that an alias repeats counted each time."""
DEEPEST = 100
"""Lists and mappings inside of each other."""
MOST_WHOLE = 10**308
"""Largest whole number; those from 1.8e308 on are no floating-point numbers."""


def read_text(path: str | Path, what: str) -> str:
    """Reads a text file.

    Args:
        path: The file.
        what: What it should be, for messages, such as ``rig file``.

    Raises:
        InputError: It is missing or is no text.
    """
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(LARGEST_BYTES)
            if stream.peek():  # a device may have no end
                raise InputError(
                    f"{path}: has more than {LARGEST_BYTES} bytes, too many for a {what}"
                )
        return content.decode().replace("\r\n", "\n").replace("\r", "\n")
    except InputError:  # before its base, ValueError
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: cannot be read as a {what} (byte {error.start} is not UTF-8 text)"
        ) from None
    except (OSError, ValueError) as error:  # also a path that no file can have
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read as a {what} ({reason})") from None


def read_yaml(path: str | Path, what: str, lines: bool = False) -> Any:
    """Reads a YAML file as plain values.

    Args:
        path: The file.
        what: What it should be, for messages, such as ``rig file``.
        lines: Whether lists and mappings are to know their lines, as those of ``ruamel.yaml`` do.

    Raises:
        InputError: It is missing, is not YAML, or holds what nobody can compute with.
    """
    return parse_yaml(read_text(path, what), str(path), what, lines)


def parse_yaml(text: str, name: str, what: str, lines: bool = False) -> Any:
    """Reads YAML text as plain values.

    Args:
        text: The text.
        name: What messages call it.
        what: What it should be, for messages.
        lines: Whether lists and mappings are to know their lines.

    Raises:
        InputError: It is not YAML, or holds what nobody can compute with.
    """
    loader = YAML() if lines else YAML(typ="safe", pure=True)

    def load() -> Any:
        if "<<" in text:
            _check_merges(text, name)
        return loader.load(text)

    return _parsed(load, "YAML", name, what)


def _check_merges(text: str, name: str) -> None:
    """Refuse mappings that merge so many others that reading them alone takes for ever.

    A merged mapping's entries are copied one by one before those that recur are dropped.

    Args:
        text: YAML.
        name: What messages call it.

    Raises:
        InputError: A mapping is made of more than `MOST_VALUES` entries, or of itself.
    """
    entries: dict[int, int] = {}

    def size_of(node: Any) -> int:
        """Entries of a mapping, or of all mappings of a list that is merged."""
        if isinstance(node, SequenceNode):
            return sum(size_of(one) for one in node.value if isinstance(one, MappingNode))
        if not isinstance(node, MappingNode):
            return 0
        if id(node) in entries:
            return entries[id(node)]
        entries[id(node)] = MOST_VALUES + 1  # of a mapping that merges itself
        count = sum(size_of(v) if k.value == "<<" else 1 for k, v in node.value)
        entries[id(node)] = count
        if count > MOST_VALUES:
            raise InputError(
                f"{name}, line {node.start_mark.line + 1}: merges more than {MOST_VALUES} entries,"
                " which is the most that are read"
            )
        return count

    left, seen = [YAML(typ="safe", pure=True).compose(text)], set()
    while left:
        node = left.pop()
        if node is None or id(node) in seen or not isinstance(node, SequenceNode | MappingNode):
            continue
        seen.add(id(node))
        size_of(node)
        pairs = isinstance(node, MappingNode)
        left += [one for pair in node.value for one in pair] if pairs else node.value


def read_json(path: str | Path, what: str) -> Any:
    """Reads a JSON file as plain values.

    Args:
        path: The file.
        what: What it should be, for messages.

    Raises:
        InputError: It is missing, is not JSON, or holds what nobody can compute with.
    """
    text = read_text(path, what)
    return _parsed(lambda: json.loads(text), "JSON", str(path), what)


def _parsed(load: Callable[[], Any], language: str, name: str, what: str) -> Any:
    try:
        with warnings.catch_warnings():
            # An anchor may be set anew; what it stands for is the latest.
            warnings.simplefilter("ignore", ReusedAnchorWarning)
            data = load()
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{name}: is nested too deeply for a {what}") from None
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = getattr(mark, "line", None)
        at = "" if line is None else f", line {line + 1}"
        raise InputError(f"{name}: is not YAML{at}: {getattr(error, 'problem', error)}") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{name}: is not JSON, line {error.lineno}: {error.msg}") from None
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        # a date that is none, an empty number
        if "integer string conversion" in str(error):
            error = ValueError("a number has thousands of digits, allowed are those up to 1e308")
        raise InputError(f"{name}: is no {what} in {language} ({error})") from None
    check_values(data, name)
    return data


def check_values(data: Any, name: str) -> None:
    """Refuses values that cannot be computed with or written down.

    Args:
        data: Nested lists and mappings.
        name: What messages call them.

    Raises:
        InputError: They are too many, contain themselves, or one is out of all bounds.
    """
    # How many values and levels a list or mapping stands for, none of them while it is open.
    sizes: dict[int, tuple[int, int]] = {}

    def size_of(value: Any, where: str, depth: int) -> tuple[int, int]:
        if isinstance(value, str):
            _check_text(value, name, where)
            return 1, 0
        if isinstance(value, int) and abs(value) > MOST_WHOLE:
            digits = math.floor(math.log10(abs(value))) + 1
            raise InputError(
                f"{_place(name, where)}: found a whole number of {digits} digits, allowed are"
                " numbers up to 1e308"
            )
        if not isinstance(value, dict | list):
            return 1, 0
        known = sizes.get(id(value))
        if known == (0, 0):
            raise InputError(f"{name}: {where}: an alias stands for a part that contains it")
        values, levels = known or (1, 1)
        if depth + levels > DEEPEST:
            raise InputError(f"{name}: is nested too deeply, allowed are {DEEPEST} levels")
        if known:
            return known
        sizes[id(value)] = 0, 0
        for key, one in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(key, str):
                _check_text(key, name, where)
            more, inside = size_of(one, f"{where}.{key}" if where else str(key), depth + 1)
            values += more
            levels = max(levels, 1 + inside)
            if values > MOST_VALUES:
                raise InputError(
                    f"{name}: {where or key}: stands for more than {MOST_VALUES} values, which is"
                    " the most that are read"
                )
        sizes[id(value)] = values, levels
        return values, levels

    size_of(data, "", 0)


def _place(name: str, where: str) -> str:
    return f"{name}: {where}" if where else name


def _check_text(text: str, name: str, where: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise InputError(
            f"{_place(name, where)}: found {text[error.start]!r}, which is half of a character"
        ) from None
