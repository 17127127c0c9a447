# SPDX-License-Identifier: Apache-2.0
"""Finds the definition of an interface by its name.

Looked at, in this order; the first that has the type gives it:

1. folders named in `PNEU_INTERFACE_PATH`, then installed packages below `AMENT_PREFIX_PATH`;
2. `pneu_msgs`, from the checkout or from where the wheel put it;
3. definitions that come with this package (`share/`), for what the next lacks;
4. the ROS 2 Jazzy type store of `rosbags`.

A service also defines its request, response and event as messages, an action its goal, result,
feedback and the services and messages that carry them, with the names that rosidl gives them
(rosidl_parser/definition.py and rosidl_generator_type_description of ros2/rosidl, branch jazzy).
"""

import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

from pneu_common.installed import own_tree
from pneu_runtime.interfaces.errors import DefinitionError, UnknownInterfaceError
from pneu_runtime.interfaces.model import EMPTY_FIELD, Constant, Field, FieldType, Structure
from pneu_runtime.interfaces.parse import parse_structure, split_parts

_BUNDLED = Path(__file__).parent / "share"
_KINDS = ("msg", "srv", "action")
_SERVICE_PARTS = ("_Request", "_Response", "_Event")


class Registry:
    """The known interface definitions.

    Args:
        environment: Variables that name folders; those of the process where None.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        self._folders = list(_package_roots(environment))
        self._structures: dict[str, Structure] = {}
        self._sources: dict[str, str] = {}

    def structure(self, name: str) -> Structure:
        """Returns the definition of a message.

        Args:
            name: Such as `std_msgs/msg/String` or `std_srvs/srv/Trigger_Request`.

        Returns:
            Structure: its content. A service or action as a whole is a structure too, of its parts.

        Raises:
            UnknownInterfaceError: There is none.
            DefinitionError: There is one, and it is wrong.
        """
        found = self._structures.get(name)
        if found is None:
            self._load(name)
            found = self._structures.get(name)
            if found is None:
                raise UnknownInterfaceError(self._not_found(name))
        return found

    def source(self, name: str) -> tuple[str, str]:
        """Returns how a type was defined.

        Args:
            name: Full name of a message, service or action.

        Returns:
            tuple[str, str]: the encoding, `msg`, `srv` or `action`, and the text as written, or,
            where only the content is known, as it could have been written.
        """
        structure = self.structure(name)
        kind = name.split("/")[1]
        return (
            (kind, self._sources[name]) if name in self._sources else ("msg", structure.to_text())
        )

    def names(self) -> list[str]:
        """Returns the full names of all messages, services and actions, sorted."""
        found = set(self._store)
        for _, name, _ in self._files:
            found.add(name)
        return sorted(found)

    def is_service(self, name: str) -> bool:
        """Returns whether a name is that of a service.

        Args:
            name: Such as `std_srvs/srv/Trigger`.
        """
        return [field.name for field in self.structure(name).fields] == [
            "request_message",
            "response_message",
            "event_message",
        ]

    @cached_property
    def _files(self) -> list[tuple[Path, str, str]]:
        """Path, full name and kind of every definition file; the first of a name counts."""
        found: dict[str, tuple[Path, str, str]] = {}
        for package, folder in self._folders:
            for kind in _KINDS:
                for path in sorted((folder / kind).glob(f"*.{kind}")):
                    name = f"{package}/{kind}/{path.stem}"
                    found.setdefault(name, (path, name, kind))
        return list(found.values())

    @cached_property
    def _paths(self) -> dict[str, Path]:
        return {name: path for path, name, _ in self._files}

    @cached_property
    def _store(self) -> dict[str, Any]:
        return dict(get_typestore(Stores.ROS2_JAZZY).fielddefs)

    def _load(self, name: str) -> None:
        parts = name.split("/")
        if len(parts) != 3 or parts[1] not in _KINDS:
            raise UnknownInterfaceError(
                f"'{name}' is no interface type; types are written as 'std_msgs/msg/String'."
            )
        package, kind, short = parts
        if kind == "msg":
            if name in self._paths:
                self._structures[name] = parse_structure(name, self._read(name))
            elif name in self._store:
                self._structures[name] = _from_store(name, self._store[name])
            return
        whole = name if name in self._paths else f"{package}/{kind}/{short.split('_')[0]}"
        if whole not in self._paths:
            return
        text = self._read(whole)
        if kind == "srv":
            self._add_service(whole, *_parts(whole, text, 2))
        else:
            self._add_action(whole, *_parts(whole, text, 3))
        self._sources[whole] = text

    def _read(self, name: str) -> str:
        try:
            return self._paths[name].read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DefinitionError(f"{self._paths[name]}: cannot be read: {error}.") from error

    def _add(self, name: str, fields: list[tuple[str, FieldType]]) -> None:
        self._structures[name] = Structure(name, tuple(Field(*field) for field in fields))

    def _add_service(self, name: str, request: Structure, response: Structure) -> None:
        for part, suffix in ((request, "_Request"), (response, "_Response")):
            full = name + suffix
            self._structures[full] = Structure(full, part.fields, part.constants, part.text)
        self._add(
            f"{name}_Event",
            [
                ("info", FieldType("service_msgs/msg/ServiceEventInfo")),
                ("request", FieldType(f"{name}_Request", kind="bounded", count=1)),
                ("response", FieldType(f"{name}_Response", kind="bounded", count=1)),
            ],
        )
        parts = [f"{part[1:].lower()}_message" for part in _SERVICE_PARTS]
        self._add(
            name,
            [
                (field, FieldType(name + part))
                for field, part in zip(parts, _SERVICE_PARTS, strict=True)
            ],
        )

    def _add_action(
        self, name: str, goal: Structure, result: Structure, feedback: Structure
    ) -> None:
        for part, suffix in ((goal, "_Goal"), (result, "_Result"), (feedback, "_Feedback")):
            full = name + suffix
            self._structures[full] = Structure(full, part.fields, part.constants, part.text)
        identity = Field("goal_id", FieldType("unique_identifier_msgs/msg/UUID"))

        def message(*fields: Field) -> Structure:
            return Structure("", fields)

        self._add_service(
            f"{name}_SendGoal",
            message(identity, Field("goal", FieldType(f"{name}_Goal"))),
            message(
                Field("accepted", FieldType("bool")),
                Field("stamp", FieldType("builtin_interfaces/msg/Time")),
            ),
        )
        self._add_service(
            f"{name}_GetResult",
            message(identity),
            message(
                Field("status", FieldType("int8")), Field("result", FieldType(f"{name}_Result"))
            ),
        )
        self._add(
            f"{name}_FeedbackMessage",
            [("goal_id", identity.type), ("feedback", FieldType(f"{name}_Feedback"))],
        )
        self._add(
            name,
            [
                ("goal", FieldType(f"{name}_Goal")),
                ("result", FieldType(f"{name}_Result")),
                ("feedback", FieldType(f"{name}_Feedback")),
                ("send_goal_service", FieldType(f"{name}_SendGoal")),
                ("get_result_service", FieldType(f"{name}_GetResult")),
                ("cancel_goal_service", FieldType("action_msgs/srv/CancelGoal")),
                ("feedback_message", FieldType(f"{name}_FeedbackMessage")),
                ("status_message", FieldType("action_msgs/msg/GoalStatusArray")),
            ],
        )

    def _not_found(self, name: str) -> str:
        package = name.split("/")[0]
        same = [one for one in self.names() if one.startswith(f"{package}/")]
        known = f"known of {package}: {', '.join(same)}" if same else f"no package '{package}'"
        return (
            f"There is no definition of '{name}' ({known}); folders with further packages are "
            "named in PNEU_INTERFACE_PATH."
        )


def _parts(name: str, text: str, count: int) -> list[Structure]:
    return [parse_structure(name, part) for part in split_parts(name, text, count)]


def _from_store(name: str, entry: Any) -> Structure:
    """Translates an entry of rosbags, whose field descriptions are nested tuples."""

    def base(description: Any) -> tuple[str, int]:
        if isinstance(description[1], str):
            return description[1], 0
        kind, bound = description[1]
        return ("uint8" if kind == "char" else kind), bound

    fields = []
    for field, description in entry[1]:
        code = int(description[0])
        if field == EMPTY_FIELD:
            continue
        if code <= 2:  # a primitive, a string or a message
            fields.append(Field(field, FieldType(*base(description))))
            continue
        inner, count = description[1]
        kind = "array" if code == 3 else ("bounded" if count else "sequence")
        fields.append(Field(field, FieldType(*base(inner), kind, count)))
    constants = tuple(
        Constant(constant, "uint8" if kind == "char" else kind, value)
        for constant, kind, value in entry[0]
    )
    return Structure(name, tuple(fields), constants)


def _package_roots(environment: Mapping[str, str]) -> Iterator[tuple[str, Path]]:
    """Name and folder of each package with definitions, most important first."""
    for text in filter(None, environment.get("PNEU_INTERFACE_PATH", "").split(os.pathsep)):
        folder = Path(text).expanduser()
        if not folder.is_dir():
            raise DefinitionError(f"PNEU_INTERFACE_PATH: there is no folder '{text}'.")
        yield from _packages_in(folder)
    for text in filter(None, environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield from _packages_in(Path(text) / "share")
    tree = own_tree()
    if tree is not None:
        yield "pneu_msgs", tree / "msgs"
    yield from _packages_in(_BUNDLED)


def _packages_in(folder: Path) -> Iterator[tuple[str, Path]]:
    if any((folder / kind).is_dir() for kind in _KINDS):
        yield _package_name(folder), folder
        return
    for base in (folder, folder / "share"):
        if base.is_dir():
            for child in sorted(base.iterdir()):
                if any((child / kind).is_dir() for kind in _KINDS):
                    yield _package_name(child), child


def _package_name(folder: Path) -> str:
    manifest = folder / "package.xml"
    if manifest.is_file():
        text = manifest.read_text(encoding="utf-8", errors="replace")
        start, end = text.find("<name>"), text.find("</name>")
        if 0 <= start < end:
            return text[start + 6 : end].strip()
    return folder.resolve().name
