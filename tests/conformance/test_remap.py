# SPDX-License-Identifier: Apache-2.0
"""Remappings, parameters and files of parameters on the command line."""

import pytest
import rclpy
from rclpy.context import Context
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.kernel_free


@pytest.fixture
def make_remapped():
    """Makes a node in a context with arguments."""
    made = []

    def make(*arguments, name="me", **options):
        context = Context()
        rclpy.init(args=["--ros-args", *arguments], context=context)
        node = rclpy.create_node(name, context=context, **options)
        made.append((context, node))
        return node

    yield make
    for context, node in made:
        node.destroy_node()
        context.try_shutdown()


def test_names_of_nodes(make_remapped):
    node = make_remapped("-r", "__node:=you", "-r", "__ns:=/there")
    assert node.get_fully_qualified_name() == "/there/you"
    assert node.get_logger().name == "there.you"


def test_a_rule_for_one_node(make_remapped):
    node = make_remapped("-r", "other:__node:=you", "-r", "me:__ns:=/mine")
    assert node.get_fully_qualified_name() == "/mine/me"


@pytest.mark.parametrize(
    ("rule", "name", "full"),
    [
        ("a:=b", "a", "/space/b"),
        ("a:=/b", "a", "/b"),
        ("/space/a:=b", "a", "/space/b"),
        ("~/a:=b", "~/a", "/space/b"),
        ("a:=~/b", "a", "/space/me/b"),
        ("a:=b", "/a", "/a"),
        ("me:a:=b", "a", "/space/b"),
        ("other:a:=b", "a", "/space/a"),
        ("rostopic://a:=b", "a", "/space/b"),
        ("rosservice://a:=b", "a", "/space/a"),
    ],
)
def test_topics(make_remapped, rule, name, full):
    node = make_remapped("-r", rule, namespace="/space")
    assert node.resolve_topic_name(name) == full
    assert node.create_publisher(String, name, 1).topic_name == full
    assert node.create_subscription(String, name, lambda message: None, 1).topic_name == full


def test_services(make_remapped):
    node = make_remapped("--remap", "ask:=/answer", "-r", "rostopic://only:=topic")
    assert node.resolve_service_name("ask") == "/answer"
    assert node.resolve_service_name("ask", only_expand=True) == "/ask"
    assert node.create_client(Trigger, "ask").service_name == "/answer"
    assert node.resolve_service_name("only") == "/only"


def test_the_first_rule_that_fits_holds(make_remapped):
    node = make_remapped("-r", "a:=b", "-r", "a:=c", "-r", "b:=d")
    assert node.resolve_topic_name("a") == "/b"


def test_arguments_of_one_node_come_first(make_remapped):
    node = make_remapped("-r", "a:=b", cli_args=["--ros-args", "-r", "a:=local"])
    assert node.resolve_topic_name("a") == "/local"


def test_a_node_can_leave_the_arguments_of_the_process_out(make_remapped):
    node = make_remapped("-r", "a:=b", "-r", "__node:=you", use_global_arguments=False)
    assert node.get_name() == "me"
    assert node.resolve_topic_name("a") == "/a"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("1.5", 1.5),
        ("true", True),
        ("word", "word"),
        ("'1'", "1"),
        ("[1, 2]", [1, 2]),
        ("[a, b]", ["a", "b"]),
        ("1e3", 1000.0),
    ],
)
def test_parameters(make_remapped, text, value):
    node = make_remapped("-p", f"given:={text}")
    found = node.declare_parameter("given", value).value
    assert type(value)(found) == value


def test_a_parameter_for_one_node(make_remapped):
    node = make_remapped("-p", "me:one:=1", "-p", "other:two:=2")
    assert node.declare_parameter("one", 0).value == 1
    assert node.declare_parameter("two", 0).value == 0


def test_files_of_parameters(make_remapped, tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_text(
        """
/**:
  ros__parameters:
    everywhere: 1
    both: 1
/space/me:
  ros__parameters:
    both: 2
    group:
      inner: text
/space/other:
  ros__parameters:
    elsewhere: 5
""",
        encoding="utf-8",
    )
    node = make_remapped("--params-file", str(path), namespace="/space")
    assert node.declare_parameter("everywhere", 0).value == 1
    assert node.declare_parameter("both", 0).value == 2
    assert node.declare_parameter("group.inner", "").value == "text"
    assert node.declare_parameter("elsewhere", 0).value == 0


def test_later_parameters_win(make_remapped, tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_text("/**:\n  ros__parameters:\n    given: 1\n", encoding="utf-8")
    node = make_remapped("--params-file", str(path), "-p", "given:=2")
    assert node.declare_parameter("given", 0).value == 2


def test_overrides_in_the_code_win(make_remapped):
    from rclpy.parameter import Parameter

    node = make_remapped("-p", "given:=1", parameter_overrides=[Parameter("given", value=3)])
    assert node.declare_parameter("given", 0).value == 3


def test_a_file_that_is_not_there_is_refused():
    with pytest.raises(RuntimeError):
        rclpy.init(args=["--ros-args", "--params-file", "/no/such/file.yaml"], context=Context())
