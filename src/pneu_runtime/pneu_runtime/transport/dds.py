# SPDX-License-Identifier: Apache-2.0
"""The functions of the Cyclone DDS library that this package calls, by ctypes.

The library is the one that the PyPI package `cyclonedds` brings. Its Python classes are left aside
for three reasons: its `write` keeps the interpreter's lock while a reliable writer waits for a slow
reader, which would stop every other thread of the process; it encodes and decodes samples, where
the bytes themselves are wanted; and its waiting does not tell what woke it.

`_RELEASING` functions may wait and let go of the interpreter's lock; `_HOLDING` functions return at
once, and keep it, because getting it back can cost a switching interval (5 ms) in a busy process.
"""

import ctypes as ct
from types import FrameType
from typing import Any

from cyclonedds import _clayer
from cyclonedds.builtin import (
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.internal import DDS

from pneu_runtime.transport.errors import TransportError

INFINITY_NS = 0x7FFFFFFFFFFFFFFF
LIBRARY = 0x7FFF0100  # the root of all entities; parent of what belongs to no domain
UNLIMITED = -1
ANY_STATE = 0x7F
ALIVE = 16

TOPIC_PARTICIPANTS: int = BuiltinTopicDcpsParticipant._ref
TOPIC_PUBLICATIONS: int = BuiltinTopicDcpsPublication._ref
TOPIC_SUBSCRIPTIONS: int = BuiltinTopicDcpsSubscription._ref

RETCODE_BAD_PARAMETER = -3
RETCODE_PRECONDITION_NOT_MET = -4
RETCODE_ALREADY_DELETED = -9
RETCODE_TIMEOUT = -10

Entity = ct.c_int32
_Pointer = ct.c_void_p
_holding = ct.PyDLL(None, handle=DDS._dll_handle._handle)
_releasing = DDS._dll_handle


class Blob(ct.Structure):
    """Bytes as the sample type of the Python layer takes them."""

    _fields_ = (("data", ct.c_char_p), ("size", ct.c_size_t))


class Guid(ct.Structure):
    """Identity of an entity on the network."""

    _fields_ = (("value", ct.c_uint8 * 16),)


def _function(library: Any, name: str, result: Any, *arguments: Any) -> Any:
    # indexing gives an own function object, whose types no other module changes
    function = library[name]
    function.restype = result
    function.argtypes = arguments
    return function


def _both(name: str, result: Any, *arguments: Any) -> Any:
    return _function(_holding, name, result, *arguments)


_I32, _U32, _I64, _U64, _SIZE = ct.c_int32, ct.c_uint32, ct.c_int64, ct.c_uint64, ct.c_size_t

# May wait.
create_domain = _function(_releasing, "dds_create_domain", Entity, _U32, ct.c_char_p)
create_participant = _function(
    _releasing, "dds_create_participant", Entity, _U32, _Pointer, _Pointer
)
create_writer = _function(
    _releasing, "dds_create_writer", Entity, Entity, Entity, _Pointer, _Pointer
)
create_reader = _function(
    _releasing, "dds_create_reader", Entity, Entity, Entity, _Pointer, _Pointer
)
delete = _function(_releasing, "dds_delete", _I32, Entity)
write = _function(_releasing, "dds_write", _I32, Entity, ct.POINTER(Blob))
write_at = _function(_releasing, "dds_write_ts", _I32, Entity, ct.POINTER(Blob), _I64)
wait_for_acks = _function(_releasing, "dds_wait_for_acks", _I32, Entity, _I64)
waitset_wait = _function(
    _releasing, "dds_waitset_wait", _I32, Entity, ct.POINTER(ct.c_ssize_t), _SIZE, _I64
)

# Do not wait.
create_waitset = _both("dds_create_waitset", Entity, Entity)
waitset_attach = _both("dds_waitset_attach", _I32, Entity, Entity, ct.c_ssize_t)
waitset_detach = _both("dds_waitset_detach", _I32, Entity, Entity)
create_guard = _both("dds_create_guardcondition", Entity, Entity)
set_guard = _both("dds_set_guardcondition", _I32, Entity, ct.c_bool)
create_read_condition = _both("dds_create_readcondition", Entity, Entity, _U32)
get_guid = _both("dds_get_guid", _I32, Entity, ct.POINTER(Guid))
get_handle = _both("dds_get_instance_handle", _I32, Entity, ct.POINTER(_U64))
matched_readers = _both("dds_get_matched_subscriptions", _I32, Entity, ct.POINTER(_U64), _SIZE)
matched_writers = _both("dds_get_matched_publications", _I32, Entity, ct.POINTER(_U64), _SIZE)
assert_liveliness = _both("dds_assert_liveliness", _I32, Entity)
status_changes = _both("dds_get_status_changes", _I32, Entity, ct.POINTER(_U32))
set_status_mask = _both("dds_set_status_mask", _I32, Entity, _U32)
return_code_text = _both("dds_strretcode", ct.c_char_p, _I32)
set_log_mask = _both("dds_set_log_mask", None, _U32)

create_qos = _both("dds_create_qos", _Pointer)
delete_qos = _both("dds_delete_qos", None, _Pointer)
qset_userdata = _both("dds_qset_userdata", None, _Pointer, ct.c_char_p, _SIZE)
qset_history = _both("dds_qset_history", None, _Pointer, ct.c_int, _I32)
qset_reliability = _both("dds_qset_reliability", None, _Pointer, ct.c_int, _I64)
qset_durability = _both("dds_qset_durability", None, _Pointer, ct.c_int)
qset_durability_service = _both(
    "dds_qset_durability_service", None, _Pointer, _I64, ct.c_int, _I32, _I32, _I32, _I32
)
qset_lifespan = _both("dds_qset_lifespan", None, _Pointer, _I64)
qset_deadline = _both("dds_qset_deadline", None, _Pointer, _I64)
qset_liveliness = _both("dds_qset_liveliness", None, _Pointer, ct.c_int, _I64)
qset_ignorelocal = _both("dds_qset_ignorelocal", None, _Pointer, ct.c_int)
qset_lifecycle = _both("dds_qset_writer_data_lifecycle", None, _Pointer, ct.c_bool)
qset_representation = _both(
    "dds_qset_data_representation", None, _Pointer, _U32, ct.POINTER(ct.c_int16)
)
qget_userdata = _both(
    "dds_qget_userdata", ct.c_bool, _Pointer, ct.POINTER(_Pointer), ct.POINTER(_SIZE)
)
qget_history = _both(
    "dds_qget_history", ct.c_bool, _Pointer, ct.POINTER(ct.c_int), ct.POINTER(_I32)
)
qget_reliability = _both(
    "dds_qget_reliability", ct.c_bool, _Pointer, ct.POINTER(ct.c_int), ct.POINTER(_I64)
)
qget_durability = _both("dds_qget_durability", ct.c_bool, _Pointer, ct.POINTER(ct.c_int))
qget_lifespan = _both("dds_qget_lifespan", ct.c_bool, _Pointer, ct.POINTER(_I64))
qget_deadline = _both("dds_qget_deadline", ct.c_bool, _Pointer, ct.POINTER(_I64))
qget_liveliness = _both(
    "dds_qget_liveliness", ct.c_bool, _Pointer, ct.POINTER(ct.c_int), ct.POINTER(_I64)
)
free = _both("dds_free", None, _Pointer)

create_topic = _clayer.ddspy_topic_create
take = _clayer.ddspy_take
take_endpoints = _clayer.ddspy_take_endpoint
take_participants = _clayer.ddspy_take_participant
matched_writer_data = _clayer.ddspy_get_matched_publication_data
matched_reader_data = _clayer.ddspy_get_matched_subscription_data

_CALLED = frozenset({"construct", "construct_peer", "convert_policies", "_participant_data"})
"""Functions of this package that the library calls from `take_...` and `matched_...`."""


def called_by_library(frame: FrameType | None) -> bool:
    """Whether a frame belongs to what the library calls, where nothing may be raised.

    Besides `_CALLED` that is the class that `take` makes of each message's information: where its
    constructor fails, the library goes on with a null pointer.

    Args:
        frame: The innermost frame.
    """
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module == "cyclonedds.internal":
            return True
        if module.startswith("pneu_runtime.transport.") and frame.f_code.co_name in _CALLED:
            return True
        frame = frame.f_back
    return False


def status_function(name: str, structure: type[ct.Structure]) -> Any:
    """Returns one of the functions `dds_get_..._status`.

    Args:
        name: Its name.
        structure: What it fills.
    """
    return _both(name, _I32, Entity, ct.POINTER(structure))


def checked(code: int, doing: str) -> int:
    """Returns the result of a call of the library.

    Args:
        code: What it returned; negative where it failed.
        doing: What was tried, for the text of the error.

    Raises:
        TransportError: It failed.
    """
    if code < 0:
        text = return_code_text(code).decode()
        raise TransportError(f"Cyclone DDS refused {doing}: {text} ({code}).")
    return code


def guid_of(entity: int) -> bytes:
    """Returns the 16 bytes that identify an entity on the network.

    Args:
        entity: The entity.
    """
    guid = Guid()
    checked(get_guid(entity, ct.byref(guid)), "to tell the identity of an entity")
    return bytes(guid.value)


def handle_of(entity: int) -> int:
    """Returns the 64-bit number by which the library refers to an entity.

    Args:
        entity: The entity.
    """
    handle = ct.c_uint64()
    checked(get_handle(entity, ct.byref(handle)), "to tell the handle of an entity")
    return handle.value


def matched_handles(function: Any, entity: int) -> list[int]:
    """Returns the handles of the endpoints that an endpoint is matched with.

    Args:
        function: `matched_readers` of a writer, or `matched_writers` of a reader.
        entity: The endpoint.
    """
    room = 16
    while True:
        handles = (ct.c_uint64 * room)()
        count = function(entity, handles, room)
        if count < 0:  # closed meanwhile
            return []
        if count <= room:
            return list(handles[:count])
        room = count
