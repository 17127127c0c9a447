# SPDX-License-Identifier: Apache-2.0
"""Message classes, definitions and the reading of hostile bytes."""

import array
import contextlib
import copy
import random
import struct
import time
import tracemalloc

import numpy as np
import pytest
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from pneu_common.errors import InputError
from pneu_runtime import interfaces
from pneu_runtime.interfaces.catalogue import Catalogue
from pneu_runtime.interfaces.errors import DefinitionError
from pneu_runtime.interfaces.hashes import rihs01
from pneu_runtime.interfaces.parse import parse_structure
from pneu_runtime.interfaces.registry import Registry

pytestmark = pytest.mark.kernel_free


def message(name, /, **fields):
    return interfaces.message_class(name)(**fields)


# Classes.


def test_fields_have_defaults_and_types():
    imu = message("sensor_msgs/msg/Imu")
    assert imu.orientation.w == 1.0
    assert imu.orientation_covariance.dtype == np.float64
    assert imu.orientation_covariance.shape == (9,)
    assert message("sensor_msgs/msg/NavSatStatus").status == -2
    joints = message("sensor_msgs/msg/JointState", name=("a", "b"), position=[1.0, 2.0])
    assert joints.position == array.array("d", [1.0, 2.0])
    assert joints.name == ["a", "b"]
    assert message("diagnostic_msgs/msg/DiagnosticStatus").level == b"\x00"
    assert joints.get_fields_and_field_types() == {
        "header": "std_msgs/Header",
        "name": "sequence<string>",
        "position": "sequence<double>",
        "velocity": "sequence<double>",
        "effort": "sequence<double>",
    }


def test_constants_are_on_the_class():
    status = interfaces.message_class("diagnostic_msgs/msg/DiagnosticStatus")
    assert (status.OK, status.STALE) == (b"\x00", b"\x03")
    goal = interfaces.action_class("pneu_msgs/action/Identify").Goal
    assert goal.LEARN == "learn"


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("std_msgs/msg/Float64", "data", 1),
        ("std_msgs/msg/Float64", "data", "1.0"),
        ("std_msgs/msg/Float32", "data", 1e39),
        ("std_msgs/msg/UInt8", "data", 256),
        ("std_msgs/msg/UInt8", "data", -1),
        ("std_msgs/msg/UInt8", "data", 1.0),
        ("std_msgs/msg/Bool", "data", 1),
        ("std_msgs/msg/String", "data", b"bytes"),
        ("std_msgs/msg/String", "data", None),
        ("std_msgs/msg/Byte", "data", 1),
        ("sensor_msgs/msg/JointState", "position", [1, 2]),
        ("sensor_msgs/msg/JointState", "name", "abc"),
        ("sensor_msgs/msg/JointState", "header", 0),
        ("sensor_msgs/msg/Imu", "orientation_covariance", [0.0] * 8),
        ("rcl_interfaces/msg/ParameterDescriptor", "integer_range", "ab"),
        ("rmw_dds_common/msg/NodeEntitiesInfo", "node_name", "x" * 257),
    ],
)
def test_wrong_values_are_refused(name, field, value):
    with pytest.raises(AssertionError, match=field):
        setattr(message(name), field, value)
    with pytest.raises(AssertionError, match=field):
        message(name, **{field: value})


def test_unknown_fields_are_refused():
    with pytest.raises(AssertionError, match="pressure"):
        message("sensor_msgs/msg/FluidPressure", pressure=1.0)
    with pytest.raises(AttributeError):
        message("sensor_msgs/msg/FluidPressure").pressure = 1.0
    with pytest.raises(TypeError):
        interfaces.message_class("std_msgs/msg/String")("hi")


def test_messages_compare_copy_and_print():
    one = message("sensor_msgs/msg/Imu")
    other = copy.deepcopy(one)
    assert one == other
    other.orientation_covariance[3] = 1.0
    assert one != other
    assert one != message("std_msgs/msg/String")
    assert repr(message("std_msgs/msg/String", data="hi")) == "std_msgs.msg.String(data='hi')"
    joints = message("sensor_msgs/msg/JointState", position=[1.5])
    assert "position=[1.5]" in repr(joints)


def test_bytes_and_numpy_fill_sequences():
    image = message("sensor_msgs/msg/Image", data=b"\x01\x02")
    assert image.data == array.array("B", [1, 2])
    joints = message("sensor_msgs/msg/JointState", position=np.array([1.0, 2.0]))
    assert joints.position == array.array("d", [1.0, 2.0])


def test_what_changes_a_list_in_place_reaches_the_wire():
    joints = message("sensor_msgs/msg/JointState")
    joints.name.append("a")
    joints.position.append(2.0)
    again = interfaces.deserialize(interfaces.serialize(joints), type(joints))
    assert (again.name, list(again.position)) == (["a"], [2.0])
    joints.name.append(3)
    with pytest.raises(interfaces.EncodeError, match="JointState"):
        interfaces.serialize(joints)


# Definitions.


def test_all_known_types_can_be_used():
    maker = {
        "msg": interfaces.message_class,
        "srv": interfaces.service_class,
        "action": interfaces.action_class,
    }
    names = interfaces.known_types()
    assert len(names) > 180
    for name in names:
        cls = maker[name.split("/")[1]](name)
        assert interfaces.type_name(cls) == name
        assert interfaces.type_hash(name).startswith("RIHS01_")


def test_unknown_types_are_named():
    with pytest.raises(interfaces.UnknownInterfaceError, match="std_msgs/msg/Strong"):
        interfaces.message_class("std_msgs/msg/Strong")
    with pytest.raises(InputError, match="no_such_msgs"):
        interfaces.service_class("no_such_msgs/srv/Ping")
    with pytest.raises(InputError, match="std_msgs/msg/String"):
        interfaces.message_class("String")


def test_packages_are_found_in_folders(tmp_path):
    package = tmp_path / "share" / "lab_msgs"
    (package / "msg").mkdir(parents=True)
    (package / "action").mkdir()
    (package / "msg" / "Probe.msg").write_text("# a probe\nuint8 DRY=1\nTip[<=2] tips\n")
    (package / "msg" / "Tip.msg").write_text("float32[3] at\nstring<=4 label 'ab#1' # named\n")
    (package / "action" / "Poke.action").write_text("Tip tip\n---\n---\nfloat32 done\n")
    for variable in ("AMENT_PREFIX_PATH", "PNEU_INTERFACE_PATH"):
        catalogue = Catalogue(Registry({variable: str(tmp_path)}))
        probe = catalogue.message("lab_msgs/msg/Probe")
        tip = catalogue.message("lab_msgs/msg/Tip")
        assert probe.DRY == 1
        assert tip().label == "ab#1"
        assert catalogue.action("lab_msgs/action/Poke").Goal().tip == tip()
        encode = catalogue.encoder(probe)
        data = encode(probe(tips=[tip(at=[1.0, 2.0, 3.0], label="x")]))
        assert catalogue.decoder(probe, "<")(data).tips[0].at.tolist() == [1.0, 2.0, 3.0]
        with pytest.raises(AssertionError):
            probe(tips=[tip()] * 3)


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(InputError, match="PNEU_INTERFACE_PATH"):
        Registry({"PNEU_INTERFACE_PATH": str(tmp_path / "none")})


@pytest.mark.parametrize(
    "text",
    ["float64", "float64 x y z", "float64[0] x", "int8 x = a", "string[<=x] s", "int8 a\nint8 a"],
)
def test_wrong_definitions_are_refused(text):
    with pytest.raises(InputError, match="a_msgs/msg/Wrong"):
        parse_structure("a_msgs/msg/Wrong", text)


def test_full_text_holds_every_definition_once():
    text = interfaces.full_text("sensor_msgs/msg/JointState")
    assert text.count("=" * 80 + "\nMSG: ") == 2
    for part in ("MSG: std_msgs/Header\n", "MSG: builtin_interfaces/Time\n", "float64[] effort"):
        assert part in text
    own = interfaces.full_text("pneu_msgs/msg/ValveCommand")
    assert "# Voltages for the proportional valves" in own


def test_full_texts_are_read_by_an_independent_parser():
    for name in interfaces.known_types():
        if "/msg/" in name:
            assert name in get_types_from_msg(interfaces.full_text(name), name)


# Dictionaries.


def test_dictionaries_become_messages_and_back():
    cls = interfaces.message_class("pneu_msgs/msg/ValveCommand")
    values = {"header": {"stamp": {"sec": 3}}, "name": ["v"], "voltage_v": [5]}
    built = interfaces.from_dict(cls, values)
    assert built == cls(header=built.header, name=["v"], voltage_v=[5.0])
    assert built.header.stamp.sec == 3
    assert interfaces.to_dict(built)["voltage_v"] == [5.0]
    assert interfaces.from_dict(cls, interfaces.to_dict(built)) == built


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ({"voltage": [1.0]}, "voltage"),
        ({"voltage_v": 1.0}, "voltage_v"),
        ({"voltage_v": [1.0, "a"]}, r"voltage_v\[1\]"),
        ({"header": {"stamp": {"sec": 2**40}}}, "header.stamp.sec"),
        ({"header": 3}, "header"),
        ([1], "ValveCommand"),
    ],
)
def test_wrong_dictionaries_name_the_field(values, where):
    with pytest.raises(InputError, match=where):
        interfaces.from_dict(interfaces.message_class("pneu_msgs/msg/ValveCommand"), values)


# Hostile bytes.

HOSTILE_TYPES = [
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "rcl_interfaces/msg/ParameterEvent",
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/ByteMultiArray",
    "sensor_msgs/msg/Imu",
]


@pytest.mark.parametrize("name", HOSTILE_TYPES)
def test_every_truncation_is_refused(name):
    cls = interfaces.message_class(name)
    data = interfaces.serialize(cls())
    for size in range(len(data)):
        with pytest.raises(interfaces.DecodeError):
            interfaces.deserialize(data[:size], cls)


@pytest.mark.parametrize("name", HOSTILE_TYPES)
def test_random_bytes_never_do_more_than_raise(name):
    cls = interfaces.message_class(name)
    rng = random.Random(1)
    for _ in range(3000):
        data = b"\x00\x01\x00\x00" + rng.randbytes(rng.randrange(200))
        if rng.random() < 0.5:  # small lengths reach deeper
            data = data[:4] + bytes(byte if byte < 8 else 0 for byte in data[4:])
        with contextlib.suppress(interfaces.DecodeError):
            interfaces.deserialize(data, cls)


@pytest.mark.parametrize("name", HOSTILE_TYPES)
def test_huge_lengths_allocate_nothing(name):
    cls = interfaces.message_class(name)
    data = bytearray(interfaces.serialize(cls()))
    tracemalloc.start()
    started = time.perf_counter()
    for at in range(4, len(data) - 3, 4):
        changed = data.copy()
        struct.pack_into("<I", changed, at, 0xFFFFFFF0)
        with contextlib.suppress(interfaces.DecodeError):
            interfaces.deserialize(bytes(changed), cls)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10e6
    assert time.perf_counter() - started < 5


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "encapsulation"),
        (b"\x00\x07\x00\x00\x00\x00\x00\x00", "encapsulation"),
        (bytes.fromhex("0001000003000000ff6900"), "utf-8"),
        (bytes.fromhex("0001000003000000686969"), "does not end"),
        (bytes.fromhex("00010000030000006869000000000000"), "left over"),
    ],
)
def test_faults_are_explained(data, why):
    with pytest.raises(interfaces.DecodeError, match=why):
        interfaces.deserialize(data, interfaces.message_class("std_msgs/msg/String"))


def test_padding_and_big_endian_bytes_are_accepted():
    cls = interfaces.message_class("std_msgs/msg/String")
    assert interfaces.deserialize(bytes.fromhex("000100000300000068690000"), cls).data == "hi"
    assert interfaces.deserialize(bytes.fromhex("0000000000000003686900"), cls).data == "hi"
    assert interfaces.deserialize(bytes.fromhex("0001000000000000"), cls).data == ""


def test_no_message_is_no_message():
    with pytest.raises(InputError):
        interfaces.serialize("text")


def test_hashes_of_messages_are_those_of_rosbags():
    store = get_typestore(Stores.ROS2_JAZZY)
    registry = Registry({})
    names = [name for name in store.fielddefs if name.split("/")[1] == "msg"]
    assert len(names) > 150
    differ = [name for name in names if rihs01(registry, name) != store.hash_rihs01(name)]
    # Those with a char somewhere in them: rosidl makes it a uint8, and hashes that.
    assert set(differ) == {
        "rmw_dds_common/msg/Gid",
        "rmw_dds_common/msg/NodeEntitiesInfo",
        "rmw_dds_common/msg/ParticipantEntitiesInfo",
        "service_msgs/msg/ServiceEventInfo",
        "std_msgs/msg/Char",
    }


def test_why_definitions_are_read_here_and_not_by_rosbags():
    """What it cannot do is what a graph needs beyond a bag; where it can, this reader may go."""
    # Defaults are lost, with which a message of rclpy begins.
    (_, fields) = get_types_from_msg("float64 gain 2.5", "mine/msg/Gain")["mine/msg/Gain"]
    assert fields == [("gain", (1, ("float64", 0)))]
    assert parse_structure("mine/msg/Gain", "float64 gain 2.5").fields[0].default == 2.5
    # Services and actions are none of its types, neither whole nor by their parts.
    service = "bool data\n---\nbool success\nstring message\n"
    with pytest.raises(TypesysError):
        get_types_from_msg(service, "std_srvs/srv/SetBool")
    assert list(get_types_from_msg("bool data", "std_srvs/srv/SetBool_Request")) != [
        "std_srvs/srv/SetBool_Request"
    ]
    assert not any("/srv/" in name for name in get_typestore(Stores.ROS2_JAZZY).fielddefs)
    assert Registry({}).is_service("std_srvs/srv/SetBool")
    # What rosidl refuses passes.
    for wrong in ("float64 a\nfloat64 a", "float64[<=0] a"):
        assert get_types_from_msg(wrong, "mine/msg/Wrong")
        with pytest.raises(DefinitionError):
            parse_structure("mine/msg/Wrong", wrong)
