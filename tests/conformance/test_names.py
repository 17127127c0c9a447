# SPDX-License-Identifier: Apache-2.0
"""The rules for names, and how they are made full."""

import pytest
from rclpy.exceptions import (
    InvalidNodeNameException,
    InvalidServiceNameException,
    InvalidTopicNameException,
    NameValidationException,
)
from rclpy.expand_topic_name import expand_topic_name
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
from rclpy.utilities import remove_ros_args
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_topic_name import validate_topic_name
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.kernel_free


@pytest.mark.parametrize(
    "name", ["chatter", "/chatter", "{node}/chatter", "~/chatter", "~", "~a", "a/b_1/c", "a//b"]
)
def test_topic_names_that_are_right(name):
    assert validate_topic_name(name)


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("", 0),
        ("1st", 0),
        ("/2nd", 1),
        ("a/", 1),
        ("with space", 4),
        ("what?", 4),
        ("a/~b", 2),
        ("~ab", 1),
        ("{open", 0),
        ("a/{b}}", 5),
        ("a{1}", 2),
        ("a{b-c}", 3),
        ("a~b", 1),
    ],
)
def test_topic_names_that_are_wrong(name, index):
    with pytest.raises(InvalidTopicNameException) as caught:
        validate_topic_name(name)
    # the text shows the name, and under it a mark where the fault is
    shown, mark = str(caught.value).split("\n")[1:3]
    assert shown.strip() == f"'{name}'"
    assert mark.index("^") - shown.index("'") - 1 == index
    with pytest.raises(InvalidServiceNameException):
        validate_topic_name(name, is_service=True)


@pytest.mark.parametrize(
    ("validate", "name", "index"),
    [
        (validate_full_topic_name, "", 0),
        (validate_full_topic_name, "chatter", 0),
        (validate_full_topic_name, "/a/", 2),
        (validate_full_topic_name, "/ab//c", 4),
        (validate_full_topic_name, "/a/2b", 3),
        (validate_full_topic_name, "/{node}", 1),
        (validate_full_topic_name, "/~", 1),
        (validate_full_topic_name, "/a b", 2),
        (validate_namespace, "", 0),
        (validate_namespace, "space", 0),
        (validate_namespace, "/a/", 2),
        (validate_namespace, "/ab//c", 4),
        (validate_namespace, "/1", 1),
        (validate_namespace, "/a b", 2),
        (validate_node_name, "", 0),
        (validate_node_name, "a/b", 1),
        (validate_node_name, "1a", 0),
        (validate_node_name, "ab-c", 2),
    ],
)
def test_where_names_are_wrong(validate, name, index):
    with pytest.raises(NameValidationException) as caught:
        validate(name)
    shown, mark = str(caught.value).split("\n")[1:3]
    assert shown.strip() == f"'{name}'"
    assert mark.index("^") - shown.index("'") - 1 == index


@pytest.mark.parametrize(
    ("validate", "begin", "longest"),
    [
        (validate_full_topic_name, "/", 247),
        (validate_namespace, "/", 245),
        (validate_node_name, "", 255),
    ],
)
def test_names_have_a_longest(validate, begin, longest):
    name = begin + "a" * (longest - len(begin))
    assert validate(name)
    with pytest.raises(NameValidationException):
        validate(name + "a")


@pytest.mark.parametrize("name", ["", "a/b", "1a", "a-b", "a b"])
def test_node_names_that_are_wrong(name, make_node):
    with pytest.raises(InvalidNodeNameException):
        make_node(name)


def test_names_that_are_right():
    assert validate_node_name("my_node_1")
    assert validate_namespace("/")
    assert validate_namespace("/my/space")
    assert validate_full_topic_name("/my/topic_1")


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("chatter", "/space/chatter"),
        ("/chatter", "/chatter"),
        ("~", "/space/me"),
        ("~/chatter", "/space/me/chatter"),
        ("{node}/chatter", "/space/me/chatter"),
        ("/{node}", "/me"),
        ("{ns}/chatter", "/space/chatter"),
        ("{namespace}s", "/spaces"),
        ("/x{ns}", "/x/space"),
        ("x/{ns}/a", "/space/x//space/a"),
        ("a//b", "/space/a//b"),
    ],
)
def test_expansion(name, full):
    assert expand_topic_name(name, "me", "/space") == full


def test_expansion_in_the_root_namespace():
    assert expand_topic_name("chatter", "me", "/") == "/chatter"
    assert expand_topic_name("~/chatter", "me", "/") == "/me/chatter"


def test_nodes_refuse_wrong_names(node):
    with pytest.raises(InvalidTopicNameException):
        node.create_publisher(String, "wrong?", 1)
    with pytest.raises(InvalidTopicNameException):
        node.create_publisher(String, "a//b", 1)
    with pytest.raises(InvalidTopicNameException):
        node.create_subscription(String, "a/", lambda message: None, 1)
    with pytest.raises(InvalidServiceNameException):
        node.create_client(Trigger, "wrong?")
    with pytest.raises(InvalidServiceNameException):
        node.create_service(Trigger, "a/", lambda request, response: response)


def test_hidden_names():
    assert topic_or_service_is_hidden("/a/_action/status")
    assert not topic_or_service_is_hidden("/a/b_c")


def test_ros_arguments_are_removed():
    line = ["program", "-a", "--ros-args", "-r", "x:=y", "--", "last", "--ros-args", "-p", "p:=1"]
    assert remove_ros_args(line) == ["program", "-a", "last"]
