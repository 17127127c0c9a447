# SPDX-License-Identifier: Apache-2.0
"""The service get_type_description: what the types of a node's entities are made of."""

import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import FluidPressure
from type_description_interfaces.srv import GetTypeDescription

pytestmark = pytest.mark.kernel_free

# As `ros2 topic info --verbose` shows it for a publisher of a genuine Jazzy.
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def ask(ros):
    ros.node("described", namespace="/rig").create_publisher(FluidPressure, "pressure", 10)
    asking = ros.node("asking")
    client = asking.create_client(GetTypeDescription, "/rig/described/get_type_description")
    assert ros.spin_until(client.service_is_ready)

    def hash_of_pressure():
        found = asking.get_publishers_info_by_topic("/rig/pressure")
        return str(found[0].topic_type_hash) if found else ""

    def ask(type_hash, **kwargs):
        request = GetTypeDescription.Request(type_hash=type_hash, **kwargs)
        return ros.result(client.call_async(request))

    assert ros.spin_until(hash_of_pressure)
    ask.pressure = "RIHS01_" + hash_of_pressure()[-64:]
    return ask


def test_a_type_in_use_is_described(ask):
    answer = ask(ask.pressure, type_name="sensor_msgs/msg/FluidPressure")
    assert answer.successful, answer.failure_reason
    described = answer.type_description
    assert described.type_description.type_name == "sensor_msgs/msg/FluidPressure"
    fields = {field.name: field.type for field in described.type_description.fields}
    assert list(fields) == ["header", "fluid_pressure", "variance"]
    assert fields["header"].nested_type_name == "std_msgs/msg/Header"
    referenced = [one.type_name for one in described.referenced_type_descriptions]
    assert referenced == ["builtin_interfaces/msg/Time", "std_msgs/msg/Header"]


def test_sources_come_where_they_are_wanted(ask):
    with_sources = ask(ask.pressure, include_type_sources=True)
    sources = {one.type_name: one for one in with_sources.type_sources}
    assert set(sources) == {
        "sensor_msgs/msg/FluidPressure",
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
    }
    source = sources["sensor_msgs/msg/FluidPressure"]
    assert source.encoding == "msg"
    assert "float64 fluid_pressure" in source.raw_file_contents
    assert not ask(ask.pressure, include_type_sources=False).type_sources


def test_types_not_in_use_are_not_described(ask):
    answer = ask(STRING_HASH)
    assert not answer.successful
    assert answer.failure_reason


def test_what_is_no_hash_is_refused(ask):
    answer = ask("no hash")
    assert not answer.successful
    assert answer.failure_reason


@pytest.mark.parametrize("value", [False, "yes", 1])
def test_the_service_can_be_left_out(ros, value, capfd):
    """A value that is none of the two is an error, and leaves it out too."""
    parameter = Parameter("start_type_description_service", value=value)
    # Declared before the service asks for it, so that its type is that of the value.
    declared = {"automatically_declare_parameters_from_overrides": True}
    ros.node("closed", parameter_overrides=[parameter], **declared)
    said = capfd.readouterr().err
    assert ("Invalid type for parameter" in said) == (value is not False)
    watcher = ros.node("watching")
    assert ros.spin_until(lambda: "closed" in watcher.get_node_names())
    names = dict(watcher.get_service_names_and_types_by_node("closed", "/"))
    assert "/closed/get_parameters" in names
    assert "/closed/get_type_description" not in names
