# SPDX-License-Identifier: Apache-2.0
"""Parameters as rclpy has them: types, declaration, ranges, callbacks, events and services."""

import pytest
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterEvent,
    ParameterType,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy.parameter import Parameter, get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.parameter_event_handler import ParameterEventHandler

pytestmark = pytest.mark.kernel_free

Type = Parameter.Type

VALUES = [
    (True, Type.BOOL),
    (3, Type.INTEGER),
    (2.5, Type.DOUBLE),
    ("text", Type.STRING),
    ([b"\x01", b"\x02"], Type.BYTE_ARRAY),
    ([True, False], Type.BOOL_ARRAY),
    ([1, 2], Type.INTEGER_ARRAY),
    ([1.0, 2.5], Type.DOUBLE_ARRAY),
    (["a", "b"], Type.STRING_ARRAY),
]


# The class


@pytest.mark.parametrize(("value", "type_"), VALUES)
def test_type_follows_from_the_value_and_survives_a_message(value, type_):
    parameter = Parameter("p", value=value)
    assert parameter.type_ == type_
    message = parameter.to_parameter_msg()
    assert (message.name, message.value.type) == ("p", type_.value)
    again = Parameter.from_parameter_msg(message)
    assert (again.name, again.type_, list_of(again.value)) == ("p", type_, value)
    assert parameter_value_to_python(message.value) == value


def list_of(value):
    return list(value) if hasattr(value, "tolist") else value


def test_a_value_of_another_type_is_an_error():
    with pytest.raises(ValueError):
        Parameter("p", Type.INTEGER, "three")
    with pytest.raises(TypeError):
        Parameter("p", value=[1, "two"])
    with pytest.raises(TypeError):
        Parameter("p", "INTEGER", 3)


@pytest.mark.parametrize(
    ("text", "type_", "value"),
    [
        ("true", ParameterType.PARAMETER_BOOL, True),
        ("42", ParameterType.PARAMETER_INTEGER, 42),
        ("4.2", ParameterType.PARAMETER_DOUBLE, 4.2),
        ("hello", ParameterType.PARAMETER_STRING, "hello"),
        ("'42'", ParameterType.PARAMETER_STRING, "42"),
        ("[1, 2]", ParameterType.PARAMETER_INTEGER_ARRAY, [1, 2]),
        ("[1.5, 2.5]", ParameterType.PARAMETER_DOUBLE_ARRAY, [1.5, 2.5]),
        ("[a, b]", ParameterType.PARAMETER_STRING_ARRAY, ["a", "b"]),
        ("[true, false]", ParameterType.PARAMETER_BOOL_ARRAY, [True, False]),
        ("[1, a]", ParameterType.PARAMETER_STRING, "[1, a]"),
    ],
)
def test_text_is_read_as_yaml(text, type_, value):
    message = get_parameter_value(text)
    assert (message.type, parameter_value_to_python(message)) == (type_, value)


# Declaring and reading


def test_declared_parameters_are_read_back(ros):
    node = ros.node("declaring")
    assert node.declare_parameter("gain", 1.5).value == 1.5
    assert node.has_parameter("gain")
    assert node.get_parameter("gain").type_ == Type.DOUBLE
    names = [p.name for p in node.declare_parameters("pid", [("p", 1), ("i", 2)])]
    assert names == ["pid.p", "pid.i"]
    by_prefix = node.get_parameters_by_prefix("pid")
    assert {name: parameter.value for name, parameter in by_prefix.items()} == {"p": 1, "i": 2}
    assert [p.value for p in node.get_parameters(["pid.i", "gain"])] == [2, 1.5]


def test_every_node_has_use_sim_time(ros):
    node = ros.node("plain")
    assert node.get_parameter("use_sim_time").value is False


def test_undeclared_parameters_raise(ros):
    node = ros.node("strict")
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter("nothing")
    with pytest.raises(ParameterNotDeclaredException):
        node.set_parameters([Parameter("nothing", value=1)])
    with pytest.raises(ParameterNotDeclaredException):
        node.describe_parameter("nothing")
    with pytest.raises(ParameterNotDeclaredException):
        node.undeclare_parameter("nothing")
    assert node.get_parameter_or("nothing", Parameter("other", value=7)).value == 7
    assert node.get_parameter_or("nothing").type_ == Type.NOT_SET


def test_undeclared_parameters_can_be_allowed(ros):
    node = ros.node("lenient", allow_undeclared_parameters=True)
    assert node.get_parameter("new").type_ == Type.NOT_SET
    assert node.set_parameters([Parameter("new", value=1)])[0].successful
    assert node.get_parameter("new").value == 1
    # Declared in passing, and of dynamic type.
    assert node.set_parameters([Parameter("new", value="one")])[0].successful
    assert node.set_parameters([Parameter("new")])[0].successful
    assert not node.has_parameter("new")


def test_declaring_twice_or_wrongly_raises(ros):
    node = ros.node("wrongly")
    node.declare_parameter("p", 1)
    with pytest.raises(ParameterAlreadyDeclaredException):
        node.declare_parameter("p", 1)
    with pytest.raises(InvalidParameterException):
        node.declare_parameter("", 1)
    with pytest.raises(ValueError):
        node.declare_parameter("not_set", None, ParameterDescriptor())
    with pytest.raises(ValueError):
        node.declare_parameter("typed", Type.INTEGER, ParameterDescriptor(dynamic_typing=True))
    with pytest.raises(TypeError):
        node.declare_parameters("", [(1, 2)])
    with pytest.raises(TypeError):
        node.declare_parameters("", [("p2", 2, "no descriptor")])


def test_a_parameter_of_given_type_has_no_value_until_it_is_set(ros):
    node = ros.node("typed")
    node.declare_parameter("count", Type.INTEGER)
    with pytest.raises(ParameterUninitializedException):
        node.get_parameter("count")
    assert node.get_parameter_or("count", Parameter("count", value=5)).value == 5
    assert not node.set_parameters([Parameter("count", value="one")])[0].successful
    assert node.set_parameters([Parameter("count", value=1)])[0].successful
    assert node.get_parameter("count").value == 1


def test_undeclaring(ros):
    node = ros.node("undeclaring")
    node.declare_parameter("p", 1)
    node.declare_parameter("fixed", 1, ParameterDescriptor(read_only=True))
    node.undeclare_parameter("p")
    assert not node.has_parameter("p")
    with pytest.raises(ParameterImmutableException):
        node.undeclare_parameter("fixed")


# Values from outside


def test_overrides_win_over_defaults(ros):
    overrides = [Parameter("gain", value=7.0), Parameter("idle", value=1)]
    node = ros.node("overridden", parameter_overrides=overrides)
    assert node.declare_parameter("gain", 1.0).value == 7.0
    assert not node.has_parameter("idle")
    node.undeclare_parameter("gain")
    assert node.declare_parameter("gain", 1.0, ignore_override=True).value == 1.0


def test_overrides_are_declared_where_that_is_wanted(ros):
    node = ros.node(
        "declared",
        parameter_overrides=[Parameter("gain", value=7.0)],
        automatically_declare_parameters_from_overrides=True,
    )
    assert node.get_parameter("gain").value == 7.0


def test_an_override_of_wrong_type_raises(ros):
    node = ros.node("mistyped", parameter_overrides=[Parameter("gain", value=7)])
    with pytest.raises(InvalidParameterTypeException):
        node.declare_parameter("gain", 1.0)


def test_values_come_from_the_command_line(ros):
    arguments = ["--ros-args", "-p", "gain:=2.5", "-p", "names:=[a, b]", "-p", "other:x:=1"]
    node = ros.node("told", cli_args=arguments)
    assert node.declare_parameter("gain", 1.0).value == 2.5
    assert list(node.declare_parameter("names", ["z"]).value) == ["a", "b"]
    assert node.declare_parameter("x", 0).value == 0


def test_values_come_from_files(ros, tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_text(
        "/**:\n  ros__parameters: {everywhere: 1, mine: 1}\n"
        "/rig/told:\n  ros__parameters:\n    mine: 2\n    pid: {p: 1.5, i: 0.5}\n"
        "/rig/other:\n  ros__parameters: {mine: 3}\n",
        encoding="utf-8",
    )
    arguments = ["--ros-args", "--params-file", str(path)]
    node = ros.node("told", namespace="/rig", cli_args=arguments)
    declared = [("everywhere", 0), ("mine", 0), ("pid.p", 0.0), ("pid.i", 0.0)]
    assert [p.value for p in node.declare_parameters("", declared)] == [1, 2, 1.5, 0.5]


# Descriptors


def test_static_types_do_not_change(ros):
    node = ros.node("static")
    node.declare_parameter("p", 1)
    result = node.set_parameters([Parameter("p", value="one")])[0]
    assert not result.successful
    assert result.reason.startswith("Wrong parameter type")
    assert not node.set_parameters([Parameter("p")])[0].successful
    assert node.get_parameter("p").value == 1


def test_dynamic_types_change(ros):
    node = ros.node("dynamic")
    node.declare_parameter("p", 1, ParameterDescriptor(dynamic_typing=True))
    assert node.set_parameters([Parameter("p", value="one")])[0].successful
    assert node.get_parameter("p").value == "one"
    assert node.describe_parameter("p").type == ParameterType.PARAMETER_STRING


def test_read_only_parameters_do_not_change(ros):
    node = ros.node("fixed")
    node.declare_parameter("p", 1, ParameterDescriptor(read_only=True))
    result = node.set_parameters([Parameter("p", value=2)])[0]
    assert not result.successful
    assert "read-only" in result.reason
    assert node.get_parameter("p").value == 1


@pytest.mark.parametrize(
    ("value", "allowed"),
    [(-2, True), (1, True), (7, True), (9, True), (0, False), (3, False), (-3, False), (10, False)],
)
def test_integers_keep_to_their_range(ros, value, allowed):
    node = ros.node("integers")
    limits = IntegerRange(from_value=-2, to_value=9, step=3)  # the upper bound is no step
    node.declare_parameter("p", 4, ParameterDescriptor(integer_range=[limits]))
    assert node.set_parameters([Parameter("p", value=value)])[0].successful == allowed
    assert node.get_parameter("p").value == (value if allowed else 4)
    smooth = IntegerRange(from_value=9, to_value=-2)  # any step, and its ends the other way round
    node.declare_parameter("q", 4, ParameterDescriptor(integer_range=[smooth]))
    assert node.set_parameters([Parameter("q", value=value)])[0].successful == (-2 <= value <= 9)


@pytest.mark.parametrize(
    ("value", "allowed"),
    [
        (-0.25, True),
        (0.05, True),
        (1.0, True),
        (0.1, False),
        (0.3, False),
        (-0.35, False),
        (1.05, False),
        (1.0 + 1e-7, True),  # within the tolerance
        (-0.25 - 1e-8, True),
        (0.05 + 1e-8, True),
        (1.00001, False),
        (-0.25001, False),
        (0.05001, False),
        (float("inf"), False),
        (-float("inf"), False),
    ],
)
def test_doubles_keep_to_their_range(ros, value, allowed):
    node = ros.node("doubles")
    limits = FloatingPointRange(from_value=-0.25, to_value=1.0, step=0.1)
    node.declare_parameter("p", 0.45, ParameterDescriptor(floating_point_range=[limits]))
    assert node.set_parameters([Parameter("p", value=value)])[0].successful == allowed
    assert node.get_parameter("p").value == (value if allowed else 0.45)
    smooth = FloatingPointRange(from_value=1.0, to_value=-0.25)  # any step, ends the other way
    node.declare_parameter("q", 0.45, ParameterDescriptor(floating_point_range=[smooth]))
    inside = -0.250001 < value < 1.000001
    assert node.set_parameters([Parameter("q", value=value)])[0].successful == inside


def test_nan_is_in_no_range(ros):
    node = ros.node("nan")
    limits = FloatingPointRange(from_value=0.0, to_value=1.0)
    node.declare_parameter("p", 0.5, ParameterDescriptor(floating_point_range=[limits]))
    assert not node.set_parameters([Parameter("p", value=float("nan"))])[0].successful


def test_a_default_out_of_range_raises(ros):
    node = ros.node("default_out_of_range")
    limits = IntegerRange(from_value=0, to_value=10)
    with pytest.raises(InvalidParameterValueException):
        node.declare_parameter("p", 11, ParameterDescriptor(integer_range=[limits]))
    assert not node.has_parameter("p")


def test_descriptors_are_kept_and_can_be_replaced(ros):
    node = ros.node("described")
    node.declare_parameter("p", 5, ParameterDescriptor(description="a count"))
    described = node.describe_parameter("p")
    assert (described.name, described.type) == ("p", ParameterType.PARAMETER_INTEGER)
    assert described.description == "a count"
    limits = IntegerRange(from_value=0, to_value=3)
    new = ParameterDescriptor(type=ParameterType.PARAMETER_INTEGER, integer_range=[limits])
    with pytest.raises(InvalidParameterValueException):
        node.set_descriptor("p", new)
    alternative = Parameter("p", value=2).get_parameter_value()
    assert node.set_descriptor("p", new, alternative).integer_value == 2
    assert node.get_parameter("p").value == 2


# Callbacks and events


def test_callbacks_are_called_in_their_order(ros):
    node = ros.node("callbacks")
    node.declare_parameter("p", 1)
    calls = []

    def before(parameters):
        calls.append("before")
        return [Parameter(one.name, value=one.value * 10) for one in parameters]

    def decide(parameters):
        calls.append(("decide", [one.value for one in parameters], node.get_parameter("p").value))
        return SetParametersResult(successful=True)

    def after(parameters):
        calls.append(("after", [one.value for one in parameters], node.get_parameter("p").value))

    node.add_pre_set_parameters_callback(before)
    node.add_on_set_parameters_callback(decide)
    node.add_post_set_parameters_callback(after)
    assert node.set_parameters([Parameter("p", value=2)])[0].successful
    assert calls == ["before", ("decide", [20], 1), ("after", [20], 20)]

    node.remove_pre_set_parameters_callback(before)
    node.remove_on_set_parameters_callback(decide)
    node.remove_post_set_parameters_callback(after)
    calls.clear()
    assert node.set_parameters([Parameter("p", value=3)])[0].successful
    assert calls == []
    with pytest.raises(ValueError):
        node.remove_on_set_parameters_callback(decide)


def test_a_callback_refuses_with_a_reason(ros):
    node = ros.node("refusing")
    node.declare_parameter("p", 1)
    node.add_on_set_parameters_callback(
        lambda parameters: SetParametersResult(successful=False, reason="not today")
    )
    result = node.set_parameters([Parameter("p", value=2)])[0]
    assert (result.successful, result.reason) == (False, "not today")
    assert node.get_parameter("p").value == 1
    with pytest.raises(InvalidParameterValueException):
        node.declare_parameter("q", 1)


def test_setting_atomically_is_all_or_nothing(ros):
    node = ros.node("atomic")
    node.declare_parameters("", [("a", 1), ("b", 1)])
    mixed = [Parameter("a", value=2), Parameter("b", value="two")]
    assert not node.set_parameters_atomically(mixed).successful
    assert node.get_parameter("a").value == 1
    outcomes = [result.successful for result in node.set_parameters(mixed)]
    assert outcomes == [True, False]
    assert node.get_parameter("a").value == 2


def test_changes_are_published(ros):
    node = ros.node("eventful", namespace="/rig")
    watcher = ros.node("watcher")
    events = []
    watcher.create_subscription(ParameterEvent, "/parameter_events", events.append, 100)
    assert ros.spin_until(lambda: watcher.count_publishers("/parameter_events") >= 2)

    def told(kind):
        return [
            (one.name, parameter_value_to_python(one.value))
            for event in events
            if event.node == "/rig/eventful"
            for one in getattr(event, f"{kind}_parameters")
        ]

    def after(action):
        events.clear()
        action()
        return ros.spin_until(lambda: any(event.node == "/rig/eventful" for event in events))

    # Publishers match on their own time; a repeated change shows when they have.
    node.declare_parameter("warm_up", 0)
    assert ros.spin_until(
        lambda: node.set_parameters([Parameter("warm_up", value=1)]) and told("changed")
    )
    ros.spin_until(lambda: False, timeout_sec=0.3)
    assert after(lambda: node.declare_parameter("p", 1, ParameterDescriptor(dynamic_typing=True)))
    assert told("new") == [("p", 1)]
    assert after(lambda: node.set_parameters([Parameter("p", value=2)]))
    assert told("changed") == [("p", 2)]
    assert after(lambda: node.set_parameters([Parameter("p")]))
    assert told("deleted") == [("p", None)]


def test_event_handler_calls_for_its_parameter_only(ros):
    node = ros.node("changing")
    node.declare_parameters("", [("p", 0), ("q", 0)])
    watcher = ros.node("handling")
    handler = ParameterEventHandler(watcher)
    seen = []
    handle = handler.add_parameter_callback("p", "changing", lambda p: seen.append(p.name))

    def change():
        value = node.get_parameter("p").value + 1
        node.set_parameters([Parameter("q", value=value), Parameter("p", value=value)])
        return bool(seen)

    assert ros.spin_until(change)
    assert set(seen) == {"p"}
    handler.remove_parameter_callback(handle)
    with pytest.raises(RuntimeError):
        handler.remove_parameter_callback(handle)


# Services


@pytest.fixture
def client(ros):
    node = ros.node("served", namespace="/rig")
    limits = IntegerRange(from_value=0, to_value=10)
    node.declare_parameter("count", 3, ParameterDescriptor(integer_range=[limits]))
    node.declare_parameters("pid", [("p", 1.5), ("fast.d", 0.5)])
    node.declare_parameter("free", 1, ParameterDescriptor(dynamic_typing=True))
    parameters = AsyncParameterClient(ros.node("asking"), "/rig/served")
    assert ros.spin_until(parameters.services_are_ready)
    parameters.served = node
    return parameters


def test_services_have_their_names_and_types(ros, client):
    found = dict(client.node.get_service_names_and_types())
    for name, type_ in [
        ("describe_parameters", "DescribeParameters"),
        ("get_parameters", "GetParameters"),
        ("get_parameter_types", "GetParameterTypes"),
        ("list_parameters", "ListParameters"),
        ("set_parameters", "SetParameters"),
        ("set_parameters_atomically", "SetParametersAtomically"),
    ]:
        assert found[f"/rig/served/{name}"] == [f"rcl_interfaces/srv/{type_}"]


def test_get_by_service(ros, client):
    values = ros.result(client.get_parameters(["count", "pid.p"])).values
    assert [parameter_value_to_python(value) for value in values] == [3, 1.5]
    # One unknown name empties the answer.
    assert not ros.result(client.get_parameters(["count", "nothing"])).values


def test_types_by_service(ros, client):
    types = ros.result(client.get_parameter_types(["count", "pid.p"])).types
    assert list(types) == [ParameterType.PARAMETER_INTEGER, ParameterType.PARAMETER_DOUBLE]
    assert not list(ros.result(client.get_parameter_types(["nothing"])).types)


def test_describe_by_service(ros, client):
    (described,) = ros.result(client.describe_parameters(["count"])).descriptors
    assert (described.name, described.type) == ("count", ParameterType.PARAMETER_INTEGER)
    assert (described.integer_range[0].from_value, described.integer_range[0].to_value) == (0, 10)
    given = ParameterDescriptor(
        description="a gain",
        additional_constraints="odd",
        read_only=True,
        floating_point_range=[FloatingPointRange(from_value=-1.5, to_value=2.5, step=0.25)],
    )
    client.served.declare_parameter("gain", 0.5, given)
    _, described = ros.result(client.describe_parameters(["count", "gain"])).descriptors
    given.name, given.type = "gain", ParameterType.PARAMETER_DOUBLE
    assert described == given
    (described,) = ros.result(client.describe_parameters(["free"])).descriptors
    assert described.dynamic_typing and not described.read_only


def test_list_by_service(ros, client):
    everything = ros.result(client.list_parameters()).result
    assert {"count", "pid.p", "pid.fast.d", "use_sim_time"} <= set(everything.names)
    assert set(everything.prefixes) == {"pid", "pid.fast"}
    assert set(ros.result(client.list_parameters(["pid"])).result.names) == {"pid.p", "pid.fast.d"}
    assert set(ros.result(client.list_parameters(["pid"], 1)).result.names) == {"pid.p"}
    assert "pid.p" not in ros.result(client.list_parameters(depth=1)).result.names


def test_set_by_service(ros, client):
    wanted = [
        Parameter("count", value=4),
        Parameter("count", value=11),
        Parameter("pid.p", value=2),
        Parameter("nothing", value=1),
    ]
    results = ros.result(client.set_parameters(wanted)).results
    assert [result.successful for result in results] == [True, False, False, False]
    assert all(result.reason for result in results[1:])
    assert client.served.get_parameter("count").value == 4


def test_set_atomically_by_service(ros, client):
    wanted = [Parameter("count", value=5), Parameter("pid.p", value="fast")]
    assert not ros.result(client.set_parameters_atomically(wanted)).result.successful
    assert client.served.get_parameter("count").value == 3
    wanted[1] = Parameter("pid.p", value=9.0)
    assert ros.result(client.set_parameters_atomically(wanted)).result.successful
    assert client.served.get_parameter("count").value == 5


def test_delete_by_service(ros, client):
    assert not ros.result(client.delete_parameters(["count"])).results[0].successful
    assert ros.result(client.delete_parameters(["free"])).results[0].successful
    assert not client.served.has_parameter("free")


def test_load_a_file_by_service(ros, client, tmp_path):
    path = tmp_path / "dump.yaml"
    path.write_text(
        "/rig/served:\n  ros__parameters:\n    count: 8\n    pid: {p: 2.5}\n", encoding="utf-8"
    )
    results = ros.result(client.load_parameter_file(str(path))).results
    assert [result.successful for result in results] == [True, True]
    assert client.served.get_parameter("count").value == 8
    assert client.served.get_parameter("pid.p").value == 2.5


def test_services_can_be_left_out(ros):
    ros.node("closed", start_parameter_services=False)
    watcher = ros.node("looking")
    assert ros.spin_until(lambda: "closed" in watcher.get_node_names())
    names = [name for name, _ in watcher.get_service_names_and_types()]
    assert "/closed/get_parameters" not in names
