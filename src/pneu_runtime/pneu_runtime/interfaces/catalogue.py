# SPDX-License-Identifier: Apache-2.0
"""Classes, bytes and texts of interfaces by name; made when first asked for, and kept."""

import struct
import threading
from typing import Any, TypeVar

from pneu_runtime.interfaces import hashes
from pneu_runtime.interfaces.classes import Message, build_class
from pneu_runtime.interfaces.codec import Decoder, Encoder, build_decoder, build_encoder
from pneu_runtime.interfaces.errors import DecodeError, EncodeError, UnknownInterfaceError
from pneu_runtime.interfaces.registry import Registry

M = TypeVar("M")

_SEPARATOR = "=" * 80
_ORDER_OF_HEADER = {b"\x00\x01": "<", b"\x00\x00": ">"}


class Catalogue:
    """Classes and codecs of the types of one registry.

    Args:
        registry: Where definitions are found.
    """

    def __init__(self, registry: Registry) -> None:
        self.registry = registry
        self._lock = threading.RLock()  # so that there is one class of a type, whoever asks first
        self._classes: dict[str, type] = {}
        self._hashes: dict[str, str] = {}
        self.encoders: dict[type, Encoder] = {}
        self.decoders: dict[tuple[type, str], Decoder] = {}

    def message(self, name: str) -> type[Message]:
        """Returns the class of a message.

        Args:
            name: Full name, such as `std_msgs/msg/String` or `std_srvs/srv/Trigger_Request`.
        """
        found = self._classes.get(name)
        if found is None:
            with self._lock:
                found = self._classes.get(name)
                if found is None:
                    structure = self.registry.structure(name)
                    module = ".".join(name.split("/")[:2])
                    found = build_class(structure, module, self.message)
                    self._classes[name] = found
        return found

    def service(self, name: str) -> type:
        """Returns the class of a service.

        Args:
            name: Full name, such as `std_srvs/srv/Trigger`.
        """
        with self._lock:
            if name not in self._classes:
                if not self.registry.is_service(name):
                    raise UnknownInterfaceError(f"'{name}' is no service.")
                parts = {
                    part: self.message(f"{name}_{part}")
                    for part in ("Request", "Response", "Event")
                }
                self._classes[name] = _holder(name, "Service", parts)
            return self._classes[name]

    def action(self, name: str) -> type:
        """Returns the class of an action.

        Args:
            name: Full name, such as `example_interfaces/action/Fibonacci`.
        """
        with self._lock:
            if name not in self._classes:
                if name.split("/")[1:2] != ["action"]:
                    raise UnknownInterfaceError(f"'{name}' is no action.")
                self.registry.structure(name)
                implementation = {
                    "SendGoalService": self.service(f"{name}_SendGoal"),
                    "GetResultService": self.service(f"{name}_GetResult"),
                    "CancelGoalService": self.service("action_msgs/srv/CancelGoal"),
                    "FeedbackMessage": self.message(f"{name}_FeedbackMessage"),
                    "GoalStatusMessage": self.message("action_msgs/msg/GoalStatusArray"),
                }
                parts: dict[str, type] = {
                    part: self.message(f"{name}_{part}") for part in ("Goal", "Result", "Feedback")
                }
                parts["Impl"] = type("Impl", (), dict(implementation))
                self._classes[name] = _holder(name, "Action", parts)
            return self._classes[name]

    def encoder(self, message_type: type) -> Encoder:
        """Returns the function that writes messages of a class.

        Args:
            message_type: A message class.
        """
        name = type_name(message_type)
        if self._classes.get(name) is not message_type or not issubclass(message_type, Message):
            raise EncodeError(f"{message_type.__name__} is no message class of this runtime.")
        found = self.encoders[message_type] = build_encoder(self.registry, name)
        return found

    def decoder(self, message_type: type, order: str) -> Decoder:
        """Returns the function that reads messages of a class.

        Args:
            message_type: A message class.
            order: `<` for little-endian bytes, `>` for big-endian.
        """
        decode = build_decoder(self.registry, type_name(message_type), self.message, order)
        self.decoders[message_type, order] = decode
        return decode

    def hash(self, name: str) -> str:
        """Returns the RIHS01 hash of a type.

        Args:
            name: Full name of a message, service or action.
        """
        found = self._hashes.get(name)
        if found is None:
            found = self._hashes[name] = hashes.rihs01(self.registry, name)
        return found


def _holder(name: str, kind: str, parts: dict[str, type]) -> type:
    package, group, short = name.split("/")
    return type(
        short,
        (),
        {
            "__module__": f"{package}.{group}",
            "__doc__": f"{kind} of type {name}.",
            "_full_name": name,
            **parts,
        },
    )


_CATALOGUE = Catalogue(Registry())
_ENCODERS = _CATALOGUE.encoders
_DECODERS = _CATALOGUE.decoders


def registry() -> Registry:
    """Returns where the definitions of this process are found."""
    return _CATALOGUE.registry


def message_class(name: str) -> type[Any]:
    """Returns the class of a message.

    Args:
        name: Full name, such as `std_msgs/msg/String` or `std_srvs/srv/Trigger_Request`.

    Raises:
        UnknownInterfaceError: There is no such definition.
    """
    return _CATALOGUE.message(name)


def service_class(name: str) -> type[Any]:
    """Returns the class of a service, with its parts `Request`, `Response` and `Event`.

    Args:
        name: Full name, such as `std_srvs/srv/Trigger`.

    Raises:
        UnknownInterfaceError: There is no such definition.
    """
    return _CATALOGUE.service(name)


def action_class(name: str) -> type[Any]:
    """Returns the class of an action, with `Goal`, `Result`, `Feedback` and `Impl`.

    Args:
        name: Full name, such as `example_interfaces/action/Fibonacci`.

    Raises:
        UnknownInterfaceError: There is no such definition.
    """
    return _CATALOGUE.action(name)


def type_name(message_type: Any) -> str:
    """Returns the full name of the type of a message, service or action class.

    Args:
        message_type: The class, or a message of it.

    Raises:
        UnknownInterfaceError: It is none.
    """
    name: str = getattr(message_type, "_full_name", "")
    if not name:
        raise UnknownInterfaceError(f"{message_type!r} is no message, service or action class.")
    return name


def type_hash(name: str) -> str:
    """Returns the RIHS01 hash of a type.

    Args:
        name: Full name of a message, service or action, or of a part of one.
    """
    return _CATALOGUE.hash(name)


def type_description(name: str) -> dict[str, Any]:
    """Describes a type, with the structure of type_description_interfaces/msg/TypeDescription.

    Args:
        name: Full name of a message, service or action.
    """
    return hashes.type_description(_CATALOGUE.registry, name)


def type_sources(name: str) -> list[tuple[str, str, str]]:
    """Returns the definitions of a type and of all it is made of.

    Args:
        name: Full name of a message, service or action.

    Returns:
        list: of (type name, encoding `msg|srv|action|implicit`, text); the type itself first.
    """
    registry = _CATALOGUE.registry
    description = hashes.type_description(registry, name)
    names = [name, *(one["type_name"] for one in description["referenced_type_descriptions"])]
    return [(one, *registry.source(one)) for one in names]


def full_text(name: str) -> str:
    """Returns the definition of a message with those of all it is made of, for recordings.

    Args:
        name: Full name of a message.

    Returns:
        str: as the schema encoding `ros2msg` of MCAP wants it: the definition, then for each
        message it holds a line of 80 `=`, a line `MSG: package/Name`, and the definition.
    """
    registry = _CATALOGUE.registry
    seen = [name]
    for current in seen:  # grows while it is walked: breadth first, as rosbag2 orders them
        for field in registry.structure(current).fields:
            if field.type.is_message and field.type.base not in seen:
                seen.append(field.type.base)
    texts = [registry.structure(name).to_text()]
    for one in seen[1:]:
        package, _, short = one.split("/")
        texts.append(f"{_SEPARATOR}\nMSG: {package}/{short}\n{registry.structure(one).to_text()}")
    return "\n".join(text.rstrip("\n") for text in texts) + "\n"


def known_types() -> list[str]:
    """Returns the full names of all known messages, services and actions, sorted."""
    return _CATALOGUE.registry.names()


def serialize(msg: Any) -> bytes:
    """Returns a message as little-endian CDR bytes, with the four bytes of header.

    Args:
        msg: The message.

    Raises:
        EncodeError: It holds something that its type cannot express, or is no message.
    """
    cls = type(msg)
    encode = _ENCODERS.get(cls) or _CATALOGUE.encoder(cls)
    try:
        return encode(msg)
    except (struct.error, AttributeError, TypeError, ValueError) as error:
        raise EncodeError(f"{type_name(cls)}: {error}.") from error


def deserialize(data: bytes, message_type: type[M]) -> M:
    """Reads a message.

    Args:
        data: CDR bytes with the four bytes of header, of either byte order.
        message_type: The class of the message.

    Returns:
        The message.

    Raises:
        DecodeError: The bytes are no such message.
    """
    order = _ORDER_OF_HEADER.get(bytes(data[:2]))
    if order is None or len(data) < 4:
        raise DecodeError(
            f"{type_name(message_type)}: the encapsulation '{bytes(data[:4]).hex()}' is not plain"
            " CDR (0000 or 0001)."
        )
    decode = _DECODERS.get((message_type, order))
    if decode is None:
        decode = _CATALOGUE.decoder(message_type, order)
    message: M = decode(data)
    return message
