# SPDX-License-Identifier: Apache-2.0
"""Numbers read as columns are those of messages decoded one by one, whatever the layout."""

from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from pneu_sysid.records.alike import MOST_LAYOUTS, MOST_MEMBERS, Decoded, layout_of

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("string name\nint8 small\nfloat64 value\n", "lab/msg/Part"))
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nbool on\nuint16[3] three\nlab/Part[] parts\nlab/Part[2] two\n"
        "float32 single\nstring[] words\nint64[] many\nfloat64 last\n",
        "lab/msg/Odd",
    )
)
TYPES = STORE.types


def _header(rng: np.random.Generator, k: int, frame: str) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=k, nanosec=int(rng.integers(10**9)))
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _part(rng: np.random.Generator, name: str) -> Any:
    return TYPES["lab/msg/Part"](
        name=name, small=int(rng.integers(-128, 128)), value=float(rng.normal())
    )


def _odd(rng: np.random.Generator, k: int, shape: tuple[int, int, int]) -> Any:
    """A message whose lengths are of a shape."""
    parts, words, many = shape
    return TYPES["lab/msg/Odd"](
        header=_header(rng, k, "x" * words),
        on=bool(rng.integers(2)),
        three=rng.integers(0, 2**16, 3).astype(np.uint16),
        parts=[_part(rng, "p" * (j + words)) for j in range(parts)],
        two=[_part(rng, "a"), _part(rng, "bc")],
        single=float(np.float32(rng.normal())),
        words=["w" * j for j in range(words)],
        many=rng.integers(-(2**62), 2**62, many),
        last=float(rng.normal()),
    )


def _decoded(messages: list[Any], msgtype: str, little: bool) -> Decoded:
    data = [bytes(STORE.serialize_cdr(m, msgtype, little_endian=little)) for m in messages]
    return Decoded(data, STORE, msgtype, lambda k: STORE.deserialize_cdr(data[k], msgtype))


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_columns_are_what_messages_say(seed: int, little: bool) -> None:
    rng = np.random.default_rng(seed)
    shapes = [tuple(int(n) for n in rng.integers(0, 4, 3)) for _ in range(5)]
    messages = [_odd(rng, k, shapes[rng.integers(5)]) for k in range(300)]
    decoded = _decoded(messages, "lab/msg/Odd", little)
    assert len(decoded) == 300
    for path, of in {
        "last": attrgetter("last"),
        "single": attrgetter("single"),
        "on": attrgetter("on"),
        "three[2]": lambda m: m.three[2],
        "many[1]": lambda m: m.many[1] if len(m.many) > 1 else np.nan,
        "two[1].value": lambda m: m.two[1].value,
        "parts[0].small": lambda m: m.parts[0].small if m.parts else np.nan,
    }.items():
        wanted = np.array([of(m) for m in messages], dtype=float)
        assert np.array_equal(decoded.numbers(path, of), wanted, equal_nan=True), path
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
    assert decoded.stamps_ns("header.stamp", attrgetter("header.stamp")).tolist() == stamps


def test_columns_are_really_read() -> None:
    """Of hundreds of messages a few are decoded."""
    rng = np.random.default_rng(0)
    messages = [_odd(rng, k, (1, 2, 3)) for k in range(300)]
    data = [bytes(STORE.serialize_cdr(m, "lab/msg/Odd")) for m in messages]
    asked: list[int] = []

    def one(k: int) -> Any:
        asked.append(k)
        return STORE.deserialize_cdr(data[k], "lab/msg/Odd")

    decoded = Decoded(data, STORE, "lab/msg/Odd", one)
    values = decoded.numbers("last", lambda m: pytest.fail("was decoded by itself"))
    assert values.tolist() == [m.last for m in messages]
    assert asked == [0]


def test_names_may_change_from_message_to_message() -> None:
    rng = np.random.default_rng(1)
    joint = TYPES["sensor_msgs/msg/JointState"]
    orders = [["elbow", "wrist"], ["wrist"], ["wrist", "elbow", "hand"], []]
    none = np.zeros(0)
    messages = []
    for k in range(200):
        names = orders[int(rng.integers(4))]
        few = max(len(names) - int(rng.integers(2)), 0)  # fewer numbers than names
        header = _header(rng, k, "")
        messages.append(joint(header, names, rng.normal(size=few), none, none))
    decoded = _decoded(messages, "sensor_msgs/msg/JointState", True)
    values, said, named = decoded.of_name("elbow", "position")
    assert set(named) == {"elbow", "wrist", "hand"}
    for message, value, there in zip(messages, values, said, strict=True):
        at = message.name.index("elbow") if "elbow" in message.name else None
        assert there == (at is not None and at < len(message.position))
        if there:
            assert value == message.position[at]


def test_what_is_laid_out_ever_anew_is_decoded_one_by_one() -> None:
    rng = np.random.default_rng(2)
    count = 3 * MOST_LAYOUTS
    messages = [_odd(rng, k, (k % 3, k, 1)) for k in range(count)]
    decoded = _decoded(messages, "lab/msg/Odd", True)
    wanted = [m.last for m in messages]
    assert decoded.numbers("last", attrgetter("last")).tolist() == wanted


def test_what_is_not_known_has_no_layout() -> None:
    plain = bytes(STORE.serialize_cdr(_part(np.random.default_rng(0), "ab"), "lab/msg/Part"))
    assert layout_of(STORE, "lab/msg/Part", plain) is not None
    assert layout_of(STORE, "lab/msg/Part", plain[:-3]) is None  # cut
    assert layout_of(STORE, "lab/msg/Part", b"\x00\x07" + plain[2:]) is None  # another encoding
    assert layout_of(STORE, "lab/msg/Part", b"") is None
    # a length beyond the message
    assert layout_of(STORE, "lab/msg/Part", plain[:4] + b"\xff" * 4 + plain[8:]) is None


def test_what_is_too_much_or_of_another_kind_is_decoded_one_by_one() -> None:
    """Arrays of more messages than are walked through, and strings of wide characters."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("string[] words\nfloat64 last\n", "lab/msg/Words"))
    text = "module lab { module msg { struct Wide { wstring wide; double last; }; }; };"
    store.register(get_types_from_idl(text))
    words = store.types["lab/msg/Words"]
    for count, known in ((MOST_MEMBERS, True), (MOST_MEMBERS + 1, False)):
        raw = bytes(store.serialize_cdr(words(["a"] * count, 2.5), "lab/msg/Words"))
        assert (layout_of(store, "lab/msg/Words", raw) is not None) == known
        data = [raw] * 9
        asked: list[int] = []

        def one(k: int, data: list[bytes] = data, asked: list[int] = asked) -> Any:
            asked.append(k)
            return store.deserialize_cdr(data[k], "lab/msg/Words")

        decoded = Decoded(data, store, "lab/msg/Words", one)
        assert decoded.numbers("last", attrgetter("last")).tolist() == [2.5] * 9
        assert asked == ([0] if known else list(range(9)))
    assert layout_of(store, "lab/msg/Wide", b"\x00\x01" + bytes(40)) is None
