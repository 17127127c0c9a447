# SPDX-License-Identifier: Apache-2.0
"""What messages are and hold: decoded by the definitions inside the file (``rosbags``)."""

import io
import keyword
import re
from collections.abc import Callable
from functools import reduce
from operator import attrgetter
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pneu_common.errors import InputError
from pneu_graph.bag.unpacking import Allowance, unzstd
from pneu_sysid.records.alike import Decoded
from pneu_sysid.records.container import ZSTD_MAGIC, RawTopic
from pneu_sysid.records.recording import Finding

_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d+\])*)$")
_IDL_SEPARATOR = "=" * 80 + "\n"


def typestore_of(where: str, topic: RawTopic, name: str, findings: list[Finding]) -> Typestore:
    """Return the types that a topic's embedded definition declares.

    Args:
        where: What messages to people begin with.
        topic: The topic.
        name: What findings are said of.
        findings: Receives what was found.

    Raises:
        InputError: There is no definition, or it cannot be read.
    """
    schema = topic.schema
    if schema is None or not schema.data:
        # Recorders write an empty definition when they cannot find the package.
        store = get_typestore(Stores.ROS2_JAZZY)
        if topic.msgtype not in store.fielddefs:
            raise InputError(f"{where}: the bag has no definition of this message type")
        note = f"the bag has no definition of {topic.msgtype}; that of ROS 2 Jazzy was used"
        findings.append(Finding(name, "no_definition", 1, note))
        return store
    store = get_typestore(Stores.EMPTY)
    try:
        text = schema.data.decode()
        if schema.encoding == "ros2msg":
            store.register(get_types_from_msg(text, topic.msgtype))
        elif schema.encoding in ("ros2idl", "omgidl"):
            parts = [text]
            if text.startswith(_IDL_SEPARATOR + "IDL: "):
                parts = [part.split("\n", 1)[1] for part in text.split(_IDL_SEPARATOR)[1:]]
            for part in parts:
                store.register(get_types_from_idl(part))
        else:
            raise InputError(
                f"{where}: the definition is written in '{schema.encoding}' "
                "(allowed: ros2msg, ros2idl, omgidl)"
            )
    except InputError:
        raise
    except Exception as err:  # a parser fed hostile text raises many kinds
        what = " ".join(str(err).split())[:120]
        raise InputError(f"{where}: the embedded definition cannot be parsed ({what})") from err
    _check_defined(where, store, topic.msgtype, set())
    return store


def _check_defined(where: str, store: Typestore, name: str, seen: set[str]) -> None:
    """Raise unless a message type and all that it consists of are defined, and end somewhere."""
    if name not in store.fielddefs:
        have = ", ".join(sorted(store.fielddefs)) or "nothing"
        raise InputError(f"{where}: the embedded definition has no {name}, it defines {have}")
    if name in seen:
        raise InputError(f"{where}: the embedded definition of {name} contains itself")
    for kind, detail in fields_of(store, name).values():
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        if kind == Nodetype.NAME:
            _check_defined(where, store, detail, {*seen, name})


def fields_of(store: Typestore, msgtype: str) -> dict[str, Any]:
    """Fields of a type and what they hold.

    Args:
        store: Definitions of types.
        msgtype: The type.
    """
    return dict(store.fielddefs[msgtype][1])


def split_field(where: str, path: str) -> list[tuple[str, list[int]]]:
    """Names and indices of which the path of a field consists.

    Args:
        where: What messages to people begin with.
        path: The path.

    Raises:
        InputError: It is none.
    """
    steps = []
    for part in path.split("."):
        match = _STEP.match(part)
        if match is None:
            raise InputError(
                f"{where}: field '{path}' is not a path such as 'data' or 'position[0]'"
            )
        steps.append((match[1], [int(i) for i in re.findall(r"\d+", match[2])]))
    return steps


def check_number(where: str, store: Typestore, msgtype: str, path: str) -> None:
    """Raise unless a field path leads to one number of the message type.

    Args:
        where: What messages to people begin with.
        store: Definitions of types.
        msgtype: The type.
        path: The path.

    Raises:
        InputError: It does not.
    """
    current = msgtype
    steps = split_field(where, path)
    for depth, (name, indices) in enumerate(steps):
        fields = fields_of(store, current)
        if name not in fields:
            raise InputError(
                f"{where} has no field '{path}': the fields of {current} are "
                f"{', '.join(n for n in fields if n != 'structure_needs_at_least_one_member')}"
            )
        kind, detail = fields[name]
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            if len(indices) != 1:
                raise InputError(
                    f"{where}: field '{path}': '{name}' is an array, write '{name}[0]'"
                )
            (kind, detail), length = detail
            if fields[name][0] == Nodetype.ARRAY and indices[0] >= length:
                raise InputError(f"{where}: field '{path}': '{name}' has only {length} elements")
        elif indices:
            raise InputError(f"{where}: field '{path}': '{name}' is not an array")
        last = depth == len(steps) - 1
        if kind == Nodetype.NAME:
            if last:
                raise InputError(
                    f"{where}: field '{path}' is a {detail}, not a number: its fields are "
                    f"{', '.join(fields_of(store, detail))}"
                )
            current = detail
        elif not last:
            raise InputError(f"{where}: field '{path}': '{name}' is a {detail[0]}, without fields")
        elif detail[0] in ("string", "wstring", "wchar"):
            raise InputError(f"{where}: field '{path}' is a {detail[0]}, not a number")


def stamp_path(store: Typestore, msgtype: str) -> str | None:
    """Return the path of a message's own time stamp, if it has one.

    Args:
        store: Definitions of types.
        msgtype: The message's type.
    """
    fields = fields_of(store, msgtype)
    if fields.get("header") == (Nodetype.NAME, "std_msgs/msg/Header"):
        return "header.stamp"
    if fields.get("stamp") == (Nodetype.NAME, "builtin_interfaces/msg/Time"):
        return "stamp"
    return None


def columns_of(where: str, store: Typestore, topic: RawTopic) -> Decoded:
    """The messages of a topic, to be read by field.

    Args:
        where: What messages to people begin with.
        store: Definitions of types.
        topic: The topic.

    Raises:
        InputError: One does not decode.
    """
    one = _decoder(where, store, topic)
    return Decoded(topic.data, store, topic.msgtype, one)


def messages_of(where: str, store: Typestore, topic: RawTopic) -> list[Any]:
    """The messages of a topic, each decoded as a whole.

    Args:
        where: What messages to people begin with.
        store: Definitions of types.
        topic: The topic.

    Raises:
        InputError: One does not decode.
    """
    one = _decoder(where, store, topic)
    return [one(number) for number in range(len(topic.data))]


def _decoder(where: str, store: Typestore, topic: RawTopic) -> Callable[[int], Any]:
    """What decodes the message of a number; those that are packed one by one are unpacked."""
    allowance = Allowance(where, sum(map(len, topic.data)))

    def refuse(number: int, err: Exception) -> InputError:
        what = " ".join(str(err).split())[:100]
        return InputError(
            f"{where}: message {number + 1} of {topic.count} does not decode ({what})"
        )

    for number, raw in enumerate(topic.data):
        if raw[:4] == ZSTD_MAGIC:
            try:
                topic.data[number] = unzstd(io.BytesIO(raw), allowance)
            except InputError:
                raise
            except Exception as err:
                raise refuse(number, err) from err

    def one(number: int) -> Any:
        try:
            return store.deserialize_cdr(topic.data[number], topic.msgtype)
        except Exception as err:  # generated code meets hostile bytes
            raise refuse(number, err) from err

    return one


def attribute_of(name: str) -> str:
    """The attribute of a decoded message that has a field; keywords of Python end in a line.

    Args:
        name: Name of the field.
    """
    return f"{name}_" if keyword.iskeyword(name) else name


def getter_of(steps: list[tuple[str, list[int]]]) -> Callable[[Any], float]:
    """What gets a number of a message; NaN where an array is too short to have it.

    Args:
        steps: Where, as `split_field` has it.
    """
    if not any(indices for _, indices in steps):
        return attrgetter(".".join(attribute_of(name) for name, _ in steps))

    def step(value: Any, part: tuple[str, list[int]]) -> Any:
        value = getattr(value, attribute_of(part[0]))
        for index in part[1]:
            value = value[index]
        return value

    def get(message: Any) -> float:
        try:
            return float(reduce(step, steps, message))
        except IndexError:  # a variable-length array may be shorter in some messages
            return float("nan")

    return get
