# SPDX-License-Identifier: Apache-2.0
"""Ways to spoil an input: bytes and lines of a file, and values inside of what a YAML file says."""

import copy
import io
import random
import re
from collections.abc import Callable
from typing import Any

from ruamel.yaml import YAML

DIGITS = "9" * 5000
"""More digits than Python turns into a number without being asked."""

LAUGHS = "".join(
    f"l{k}: &l{k} [{', '.join([f'*l{k - 1}'] * 9) if k else 'ha'}]\n" for k in range(9)
)
"""The billion laughs: 9 lines of YAML that mean 9^8 words."""

NUMBERS = (
    ".nan", ".inf", "-.inf", "-1", "0", "-0.0", "1e308", "-1e308", "1e-308", "5e-324", "1e400",
    str(10**30), str(-(10**30)), str(2**63), DIGITS, "0x10", "0o7", "1_000", "1e3", "12:30:00",
)  # fmt: skip
WORDS = (
    "true", "null", "~", '""', "[]", "{}", "[[]]", "{a: {b: c}}", '"[red]x[/]"', '"[/end]"',
    '"a\\nb"', '"\\0"', '"\\e[31m"', '"\\uD800"', '"\\u202e"', "ünïcödé", "🫁", "2020-01-01",
    "!!binary aGE=", "!!set {a, b}", "!!python/object:os.system x", "!foreign x", "*absent",
    "'.'", "'a.b'", "'/'", "'..'", '"' + "x" * 3000 + '"', "closed", "room", "yes", "nan",
    "[1, 2, 3]", "{from: a, to: b}", "&a [*a]",
)  # fmt: skip
HOSTILE = NUMBERS + WORDS


def of_bytes(rng: random.Random, data: bytes) -> bytes:
    """A file with some of its bytes changed.

    Args:
        rng: Source of the choice.
        data: The file.
    """
    out = bytearray(data)
    kind = rng.randrange(8)
    if not out or kind == 0:
        return bytes(out[: rng.randrange(len(out) + 1)])
    at = rng.randrange(len(out))
    if kind in (1, 2):
        for _ in range(rng.choice((1, 1, 3, 20))):
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    elif kind == 3:
        out[at : at + rng.randrange(1, 50)] = b""
    elif kind == 4:
        out[at:at] = rng.randbytes(rng.randrange(1, 50))
    elif kind == 5:
        out[at:at] = out[at : at + rng.randrange(1, 500)]
    elif kind == 6:
        out[at : at + 8] = rng.choice((b"\xff" * 8, b"\0" * 8, b"\xff\xff\xff\x7f\0\0\0\0"))
    else:
        out[at : at + 1] = rng.choice((b"\xff\xfe", b"\xc3", b"\0", b"\x85", b"\x1b[2J", b"\x0c"))
    return bytes(out)


def of_text(rng: random.Random, text: str) -> bytes:
    """A text file with lines or words changed.

    Args:
        rng: Source of the choice.
        text: The text.
    """
    lines = text.splitlines(keepends=True) or [""]
    at = rng.randrange(len(lines))
    kind = rng.randrange(12)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[at])
    elif kind == 2:
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 3:
        lines[at] = lines[at].replace(" ", "\t", rng.randrange(1, 4))
    elif kind == 4:
        lines[at] = lines[at].replace("  ", rng.choice(("", " ", "   ", "    ")), 1)
    elif kind in (5, 6, 7):
        words = list(re.finditer(r"[\w./+-]+", lines[at]))
        if words:
            word = rng.choice(words)
            lines[at] = lines[at][: word.start()] + rng.choice(HOSTILE) + lines[at][word.end() :]
    elif kind == 8:
        lines = [line.replace("\n", rng.choice(("\r\n", "\r", "\u2028"))) for line in lines]
    elif kind == 9:
        lines.insert(at, rng.choice(("---\n", "...\n", "%YAML 9.9\n", "? \n", "<<: *a\n", "- x\n")))
    elif kind == 10:
        lines.insert(0, rng.choice(("\ufeff", LAUGHS, "a: &a {<<: *a}\n", "&x\n", "!!map\n")))
    else:
        depth = rng.choice((50, 2000, 100_000))
        lines.append(rng.choice(("deep: " + "[" * depth, "{a: " * depth, "- " * depth)) + "\n")
    return "".join(lines).encode("utf-8", "surrogatepass")


def of_values(rng: random.Random, text: str) -> bytes:
    """A YAML file whose values, keys or references are changed.

    Args:
        rng: Source of the choice.
        text: The file.
    """
    data = YAML(typ="safe").load(text)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _one_value(rng, data)
    out = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.allow_unicode = True
    yaml.dump(data, out)
    # Hostile values stand as marks until here: what they say is YAML, not a value of Python.
    return re.sub(r"mark_(\d+)", lambda m: HOSTILE[int(m[1])], out.getvalue()).encode(
        "utf-8", "surrogatepass"
    )


def _one_value(rng: random.Random, data: Any) -> None:
    places = list(_places(data))
    if not places:
        return
    holder, key = rng.choice(places)
    value = holder[key]
    kind = rng.randrange(12)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        del holder[key]
        holder[rng.choice(("renamed", f"{key}x", str(key).upper(), "", "a.b", "[x]", 7))] = value
    elif kind == 2 and isinstance(holder, dict):
        holder[f"{key}_2"] = copy.deepcopy(value)
    elif kind == 3:
        other, name = rng.choice(places)
        holder[key] = copy.deepcopy(other[name])
    elif kind == 4 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = value * 10.0 ** rng.choice((-9, -6, -3, -1, 1, 3, 6, 9))
    elif kind == 5 and isinstance(value, list) and value:
        rng.choice((value.clear, value.reverse, lambda: value.append(value[0])))()
    elif kind == 6 and isinstance(value, str):
        holder[key] = rng.choice((value + "x", "closed", "absent", value.upper(), "", value + "."))
    elif kind == 7 and isinstance(value, dict) and value:
        value[rng.choice(("unknown", "from", "name", "effect"))] = rng.choice((1, "x", None))
    elif kind == 8 and isinstance(holder, dict) and len(holder) > 1:
        other_key = rng.choice(list(holder))
        holder[key], holder[other_key] = holder[other_key], holder[key]
    else:
        holder[key] = f"mark_{rng.randrange(len(HOSTILE))}"


def _places(data: Any) -> Any:
    """Every value inside of nested lists and mappings, as its holder and its key there."""
    if isinstance(data, dict | list):
        for key in list(data) if isinstance(data, dict) else range(len(data)):
            yield data, key
            yield from _places(data[key])


def of_yaml(rng: random.Random, text: str) -> bytes:
    """A YAML file that is spoilt in any of these ways.

    Args:
        rng: Source of the choice.
        text: The file.
    """
    ways: list[Callable[[], bytes]] = [
        lambda: of_values(rng, text),
        lambda: of_values(rng, text),
        lambda: of_values(rng, text),
        lambda: of_text(rng, text),
        lambda: of_bytes(rng, text.encode()),
    ]
    return rng.choice(ways)()
