# SPDX-License-Identifier: Apache-2.0
"""What numbers a recording holds: found without a rig, by topic and field or by column."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pneu_common.errors import InputError
from pneu_sim.channels import TextFormat
from pneu_sysid.records.peek import DEEPEST, MOST, POINTS, peek

ROOT = Path(__file__).resolve().parents[3]
STORE = get_typestore(Stores.ROS2_JAZZY)


def test_a_bag_tells_every_number_that_it_holds() -> None:
    found = {
        (one.topic, one.field): one for one in peek(ROOT / "data" / "bags" / "a_leak", TextFormat())
    }
    volts = found["/valve/voltage", "data"]
    assert (volts.type, volts.count) == ("std_msgs/msg/Float64", 7500)
    assert (volts.least, volts.most, len(volts.outline)) == (0.0, 10.0, POINTS)
    end = found["/taps/end/pressure", "fluid_pressure"]
    assert 0.9e5 < end.least < 1.1e5 and 6.0e5 < end.most < 7.0e5
    assert not any("stamp" in field for _, field in found)


def test_elements_of_arrays_are_told_and_pictures_are_not(tmp_path: Path) -> None:
    types = STORE.types
    time = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        messages = {
            "sensor_msgs/msg/JointState": types["sensor_msgs/msg/JointState"](
                header, ["elbow", "wrist"], np.array([0.5, np.nan]), np.array([2.0]), np.zeros(0)
            ),
            "sensor_msgs/msg/Image": types["sensor_msgs/msg/Image"](
                header, 64, 64, "mono8", 0, 64, np.zeros(64 * 64, dtype=np.uint8)
            ),
            "std_msgs/msg/String": types["std_msgs/msg/String"](data="words"),
        }
        for msgtype, message in messages.items():
            text, _ = STORE.generate_msgdef(msgtype)
            schema = writer.register_schema(msgtype, "ros2msg", text.encode())
            channel = writer.register_channel(f"/{msgtype.split('/')[-1]}", "cdr", schema)
            raw = bytes(STORE.serialize_cdr(message, msgtype))
            for k in range(10):
                writer.add_message(channel, k, raw, k)
        writer.finish()
    found = {(one.topic, one.field): one for one in peek(path, TextFormat())}
    assert set(found) == {
        ("/JointState", "position[0]"), ("/JointState", "position[1]"),
        ("/JointState", "velocity[0]"),
    }  # fmt: skip
    assert found["/JointState", "position[0]"].outline == (0.5,) * 10
    never = found["/JointState", "position[1]"]
    assert np.isnan(never.least) and np.isnan(never.outline).all()


def _bag(path: Path, kind: str, text: str, rows: list[bytes], written_in: str = "ros2msg") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, written_in, text.encode())
        channel = writer.register_channel("/own", "cdr", schema)
        for k, raw in enumerate(rows):
            writer.add_message(channel, k, raw, k)
        writer.finish()
    return path


def test_no_more_numbers_are_told_than_a_list_may_have(tmp_path: Path) -> None:
    """Nor messages inside of each other without end, nor arrays of messages."""
    kind = "lab/msg/Many"
    line = "=" * 80
    inner = "".join(f"float32 n{k}\n" for k in range(MOST // 2 + 1))
    text = f"lab/Part[] parts\nlab/Part one\nlab/Part two\n{line}\nMSG: lab/Part\n{inner}"
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, kind))
    part = store.types["lab/msg/Part"]
    numbers = iter(range(10**6))
    message = store.types[kind](
        [part(*[0.5] * (MOST // 2 + 1))],
        *(part(*[float(next(numbers)) for _ in range(MOST // 2 + 1)]) for _ in range(2)),
    )
    raw = bytes(store.serialize_cdr(message, kind))
    found = peek(_bag(tmp_path / "a.mcap", kind, text, [raw]), TextFormat())
    assert len(found) == MOST
    assert [one.least for one in found] == [float(k) for k in range(MOST)]
    assert found[0].field == "one.n0" and found[-1].field == f"two.n{MOST // 2 - 2}"


def test_messages_deep_inside_of_each_other_are_left_out(tmp_path: Path) -> None:
    line = "=" * 80
    depth = DEEPEST + 2
    text = "float64[2] class\nfloat64 n\nlab/L1 in\n" + "".join(
        f"{line}\nMSG: lab/L{k}\nfloat64 n\n" + (f"lab/L{k + 1} in\n" if k < depth else "")
        for k in range(1, depth + 1)
    )
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, "lab/msg/L0"))
    message = store.types[f"lab/msg/L{depth}"](float(depth))
    for k in reversed(range(depth)):
        # Fields may have names that are keywords of Python.
        first = () if k else (np.array([-7.0, 2.5]),)
        message = store.types[f"lab/msg/L{k}"](*first, float(k), message)
    raw = bytes(store.serialize_cdr(message, "lab/msg/L0"))
    found = peek(_bag(tmp_path / "a.mcap", "lab/msg/L0", text, [raw]), TextFormat())
    assert {one.field: one.most for one in found} == {
        "class[0]": -7.0,
        "class[1]": 2.5,
        **{"in." * k + "n": float(k) for k in range(DEEPEST + 1)},
    }


def test_what_nobody_can_read_is_passed_over(tmp_path: Path) -> None:
    raw = bytes(
        STORE.serialize_cdr(STORE.types["std_msgs/msg/Float64"](data=3.5), "std_msgs/msg/Float64")
    )
    text, _ = STORE.generate_msgdef("std_msgs/msg/Float64")
    for name, kind, definition in (
        ("a", "lab/msg/Own", ""),
        ("b", "lab/msg/Own", "float64 a b c\n="),
    ):
        assert peek(_bag(tmp_path / f"{name}.mcap", kind, definition, [raw]), TextFormat()) == []
    (one,) = peek(_bag(tmp_path / "c.mcap", "std_msgs/msg/Float64", text, [raw]), TextFormat())
    assert (one.topic, one.field, one.least, one.count) == ("/own", "data", 3.5, 1)


def test_columns_of_text_are_told_but_for_those_of_words(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = [f"{0.01 * k},{k % 7},on,{5.0 - k}" for k in range(300)]
    path.write_text("time,volts,state,p end\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = {one.field: one for one in peek(path, TextFormat())}
    assert set(found) == {"time", "volts", "p end"}
    assert (found["volts"].least, found["volts"].most) == (0.0, 6.0)
    assert found["p end"].outline[0] == 5.0 and len(found["p end"].outline) == POINTS


def test_text_is_read_as_the_rig_file_lays_it_out(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text("\n".join(f"{k};{k},5" for k in range(50)), encoding="utf-8")
    layout = TextFormat(delimiter=";", decimal=",", names=["t", "volts"])
    found = {one.field: one for one in peek(path, layout)}
    assert (found["volts"].least, found["volts"].most) == (0.5, 49.5)


def test_what_cannot_be_read_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        peek(tmp_path / "no.mcap", TextFormat())
    (tmp_path / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(InputError):
        peek(tmp_path / "broken.mcap", TextFormat())
