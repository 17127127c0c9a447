# SPDX-License-Identifier: Apache-2.0
"""Substitutions ``$(name arguments)`` in the texts of a launch file."""

import os
import secrets
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from pneu_graph.launch.expression import evaluate
from pneu_runtime.packages import PackageNotFoundError, package_prefix, package_share

REFUSED = {
    "command": "it would run a program while the file is read",
    "exec-in-package": "nodes are found by their package and executable",
    "exec-in-pkg": "nodes are found by their package and executable",
    "find-exec": "an executable is found by the shell's PATH as it stands",
    "path-join": "write the path with /",
    "parameter": "parameters of other nodes are not known here",
    "launch_log_dir": "logs go where ROS_LOG_DIR says",
}


class Scope(Protocol):
    """What substitutions refer to.

    Attributes:
        configurations: Values of arguments and of `let`.
        environment: Environment of the processes.
        path: The launch file.
        anonymous: Names made by ``$(anon ...)``.
    """

    configurations: dict[str, str]
    environment: dict[str, str]
    path: Path
    anonymous: dict[str, str]


def substitute(text: str, scope: Scope) -> str:
    """Returns a text with its substitutions done.

    Args:
        text: As it stands in the launch file.
        scope: What the substitutions refer to.

    Raises:
        ValueError: A substitution is unknown, malformed, or has nothing to refer to.
    """
    return "".join(part for part, _ in _parts(text, scope))


def split_words(text: str, scope: Scope) -> list[str]:
    """Returns the words of a command line; what a substitution yields is never split.

    Args:
        text: As it stands in the launch file.
        scope: What the substitutions refer to.

    Raises:
        ValueError: As `substitute`, or a quotation mark is not closed.
    """
    yields: list[str] = []
    marked = ""
    for part, substituted in _parts(text, scope):
        if substituted:
            marked += chr(0xE000 + len(yields))
            yields.append(part)
        else:
            marked += part
    words = shlex.split(marked)
    for i, value in enumerate(yields):
        words = [word.replace(chr(0xE000 + i), value) for word in words]
    return words


def _parts(text: str, scope: Scope) -> list[tuple[str, bool]]:
    parts: list[tuple[str, bool]] = []
    at = 0
    while at < len(text):
        begin = text.find("$(", at)
        if begin < 0:
            parts.append((text[at:], False))
            break
        if begin > at and text[begin - 1] == "\\":
            parts.append((text[at : begin - 1] + "$(", False))
            at = begin + 2
            continue
        parts.append((text[at:begin], False))
        value, at = _substitution(text, begin, scope)
        parts.append((value, True))
    return parts


def _substitution(text: str, begin: int, scope: Scope) -> tuple[str, int]:
    """Value of the substitution that begins at a place, and the place behind it."""
    words: list[str] = []
    word: str | None = None
    quote = ""
    at = begin + 2
    while at < len(text):
        c = text[at]
        if c == "\\" and at + 1 < len(text):
            word = (word or "") + text[at + 1]
            at += 2
            continue
        if text.startswith("$(", at):
            value, at = _substitution(text, at, scope)
            word = (word or "") + value
            continue
        at += 1
        if quote:
            if c == quote:
                quote = ""
            else:
                word = (word or "") + c
        elif c in "'\"":
            quote = c
            word = word or ""
        elif c == ")":
            if word is not None:
                words.append(word)
            if not words:
                raise ValueError(f"{text!r}: a substitution has no name")
            return _apply(words[0], words[1:], text[begin:at], scope), at
        elif c.isspace():
            if word is not None:
                words.append(word)
            word = None
        else:
            word = (word or "") + c
    raise ValueError(f"{text!r}: a substitution is not closed")


def _apply(name: str, arguments: list[str], shown: str, scope: Scope) -> str:
    if name in REFUSED:
        raise ValueError(f"{shown}: $({name}) is not supported here; {REFUSED[name]}")
    if name not in _FUNCTIONS:
        raise ValueError(
            f"{shown}: unknown substitution {name!r}; known are {', '.join(sorted(_FUNCTIONS))}"
        )
    fewest, most, function = _FUNCTIONS[name]
    if not fewest <= len(arguments) <= most:
        takes = str(fewest) if fewest == most else f"{fewest} to {most}"
        raise ValueError(f"{shown}: takes {takes} arguments, found {len(arguments)}")
    try:
        return function(scope, *arguments)
    except ValueError as error:
        raise ValueError(f"{shown}: {error}") from None


def truth(text: str) -> bool:
    """Returns whether a text says yes, by the words that `ros2 launch` knows.

    Args:
        text: The text.

    Raises:
        ValueError: It says neither.
    """
    word = text.strip().lower()
    if word in ("true", "1"):
        return True
    if word in ("false", "0"):
        return False
    raise ValueError(f"a condition is true, false, 1 or 0, found {text!r}")


def _var(scope: Scope, name: str) -> str:
    if name not in scope.configurations:
        known = ", ".join(sorted(scope.configurations)) or "none"
        raise ValueError(f"no argument or variable {name!r} has been set; set are {known}")
    return scope.configurations[name]


def _env(scope: Scope, name: str, default: str | None = None) -> str:
    value = scope.environment.get(name, default)
    if value is None:
        raise ValueError(f"environment variable {name!r} is not set")
    return value


def _share(scope: Scope, package: str) -> str:
    return str(_package(package)[0])


def _prefix(scope: Scope, package: str) -> str:
    return str(_package(package)[1])


def _package(package: str) -> tuple[str, str]:
    try:
        return package_share(package), package_prefix(package)
    except PackageNotFoundError:
        raise ValueError(f"package {package!r} is not installed") from None


def _eval(scope: Scope, expression: str) -> str:
    try:
        return str(evaluate(expression))
    except ValueError as error:
        raise ValueError(f"{expression!r} {error}") from None


def _anon(scope: Scope, name: str) -> str:
    if name not in scope.anonymous:
        scope.anonymous[name] = f"{name}_{os.getpid()}_{secrets.token_hex(4)}"
    return scope.anonymous[name]


_FUNCTIONS: dict[str, tuple[int, int, Callable[..., Any]]] = {
    "var": (1, 1, _var),
    "env": (1, 2, _env),
    "optenv": (1, 2, lambda scope, name, default="": scope.environment.get(name, default)),
    "find-pkg-share": (1, 1, _share),
    "find-pkg-prefix": (1, 1, _prefix),
    "dirname": (0, 0, lambda scope: str(scope.path.parent)),
    "filename": (0, 0, lambda scope: scope.path.name),
    "anon": (1, 1, _anon),
    "eval": (1, 1, _eval),
    "not": (1, 1, lambda scope, a: str(not truth(a)).lower()),
    "and": (2, 2, lambda scope, a, b: str(truth(a) and truth(b)).lower()),
    "or": (2, 2, lambda scope, a, b: str(truth(a) or truth(b)).lower()),
    "equals": (2, 2, lambda scope, a, b: str(a == b).lower()),
    "not-equals": (2, 2, lambda scope, a, b: str(a != b).lower()),
    "if": (2, 3, lambda scope, a, b, c="": b if truth(a) else c),
}
