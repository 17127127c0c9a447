# SPDX-License-Identifier: Apache-2.0
"""A launch file as a tree of entities that know their line."""

import difflib
from pathlib import Path
from typing import Any

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError


class LaunchError(InputError):
    """Signals a fault in a launch file; the message begins with file and line."""


class Entity:
    """One action of a launch file, or a part of one such as a `param`.

    Args:
        kind: Its name, such as ``node``.
        data: What stands below it.
        path: The file.
        line: Its line, from 1.
    """

    def __init__(self, kind: str, data: Any, path: Path, line: int) -> None:
        self.kind = kind
        self.data = data
        self.path = path
        self.line = line

    def fault(self, sentence: str, key: str | None = None) -> LaunchError:
        """Returns an error that names file and line.

        Args:
            sentence: What is wrong.
            key: The attribute that is meant.
        """
        return LaunchError(f"{self.path}, line {self._line_of(key)}: {self.kind}: {sentence}")

    def check(self, known: tuple[str, ...], needed: tuple[str, ...] = ()) -> None:
        """Checks that the entity is a mapping with known keys only.

        Args:
            known: Optional keys.
            needed: Keys that must be there.

        Raises:
            LaunchError: It is not.
        """
        if not isinstance(self.data, dict):
            raise self.fault(f"is a mapping, found {_shown(self.data)}")
        allowed = (*needed, *known)
        for key in self.data:
            if key not in allowed:
                near = difflib.get_close_matches(str(key), allowed, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(allowed)}"
                raise self.fault(f"unknown key {str(key)!r}; {hint}", key)
        for key in needed:
            if key not in self.data:
                raise self.fault(f"key {key!r} is missing")

    def has(self, key: str) -> bool:
        """Returns whether an attribute is given.

        Args:
            key: Its name.
        """
        return isinstance(self.data, dict) and key in self.data

    def value(self, key: str) -> Any:
        """Returns an attribute as YAML has it; None where it is not given.

        Args:
            key: Its name.
        """
        return self.data.get(key)

    def text(self, key: str, default: str = "") -> str:
        """Returns a scalar attribute as text, with its substitutions still in it.

        Args:
            key: Its name.
            default: Where it is not given.

        Raises:
            LaunchError: It is a mapping or a list.
        """
        if not self.has(key):
            return default
        value = self.data[key]
        if value is None:
            return ""
        if isinstance(value, bool):
            return str(value).lower()
        if not isinstance(value, str | int | float):
            raise self.fault(f"{key} is a text or number, found {_shown(value)}", key)
        return str(value)

    def parts(self, key: str) -> list["Entity"]:
        """Returns the mappings listed under an attribute, such as the `param` of a node.

        Args:
            key: Its name.

        Raises:
            LaunchError: It is no list of mappings.
        """
        listed = self.data.get(key)
        if listed is None:
            return []
        if not isinstance(listed, list) or not all(isinstance(item, dict) for item in listed):
            raise self.fault(f"{key} is a list of mappings, found {_shown(listed)}", key)
        return [
            Entity(f"{self.kind}: {key}", item, self.path, _line(listed, i, self._line_of(key)))
            for i, item in enumerate(listed)
        ]

    def children(self) -> list["Entity"]:
        """Returns the actions inside a group.

        Raises:
            LaunchError: It is no list of actions.
        """
        data = self.data.get("children") if isinstance(self.data, dict) else self.data
        return actions(data, self.path, self.line, self.kind)

    def _line_of(self, key: str | None) -> int:
        return self.line if key is None else _line(self.data, key, self.line)


def actions(listed: Any, path: Path, line: int, where: str) -> list[Entity]:
    """Returns the actions of a list, each a mapping with one key.

    Args:
        listed: The list.
        path: The file.
        line: Line of what holds the list, for the error message.
        where: Name of what holds the list.

    Raises:
        LaunchError: It is no such list.
    """
    if not isinstance(listed, list):
        raise LaunchError(
            f"{path}, line {line}: {where}: is a list of actions, found {_shown(listed)}"
        )
    found = []
    for i, item in enumerate(listed):
        at = _line(listed, i, line)
        if not isinstance(item, dict) or len(item) != 1:
            raise LaunchError(
                f"{path}, line {at}: {where}: an action is a mapping with one key,"
                f" found {_shown(item)}"
            )
        ((kind, data),) = item.items()
        found.append(Entity(str(kind), data, path, at))
    return found


def load_launch_file(path: str | Path) -> list[Entity]:
    """Reads a launch file.

    Args:
        path: The file.

    Returns:
        Its actions.

    Raises:
        InputError: The file is missing, is not YAML, or is no launch file.
    """
    path = Path(path)
    if path.suffix in (".py", ".xml"):
        raise LaunchError(
            f"{path}: launch files are read in YAML here; `ros2 launch` reads Python and XML too"
        )
    data = read_yaml(path, "launch file", lines=True)
    if not isinstance(data, dict) or list(data) != ["launch"]:
        raise LaunchError(f"{path}: a launch file is a mapping with the one key 'launch'")
    return actions(data["launch"] or [], path, _line(data, "launch", 1), "launch")


def _line(container: Any, key: Any, otherwise: int) -> int:
    places = getattr(getattr(container, "lc", None), "data", None) or {}
    return int(places[key][0]) + 1 if key in places else otherwise


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return f"a mapping with {', '.join(map(str, value)) or 'nothing'}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return "nothing" if value is None else repr(value)
