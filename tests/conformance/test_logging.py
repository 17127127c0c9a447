# SPDX-License-Identifier: Apache-2.0
"""Logging: levels, children, filters, the console and /rosout."""

import gc
import inspect
import os
import re
import subprocess
import sys
import time

import pytest
import rclpy
import rclpy.logging
from rcl_interfaces.msg import Log, LoggerLevel
from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels
from rclpy.clock import Clock
from rclpy.logging import LoggingSeverity
from rclpy.qos import DurabilityPolicy, QoSProfile

pytestmark = pytest.mark.kernel_free


@pytest.fixture
def run(tmp_path):
    """Runs a script in a process of its own and returns its standard error."""
    path = tmp_path / "script.py"
    # The embedded rclpy has to be put in place first.
    launcher = ["-m", "pneu_runtime"] if "pneu_runtime" in rclpy.__file__ else []

    def run(script, *arguments, **environment):
        path.write_text(script, encoding="utf-8")
        finished = subprocess.run(
            [sys.executable, *launcher, str(path), *arguments],
            env={**os.environ, "RCUTILS_COLORIZED_OUTPUT": "0", **environment},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert finished.returncode == 0, finished.stderr
        return finished.stderr

    return run


# Levels


def test_severities_have_their_numbers():
    assert [int(severity) for severity in LoggingSeverity] == [0, 10, 20, 30, 40, 50]
    found = rclpy.logging.get_logging_severity_from_string("WARN")
    assert found == LoggingSeverity.WARN


def test_children_inherit_levels():
    parent = rclpy.logging.get_logger("levels")
    child = parent.get_child("deep").get_child("deeper")
    assert child.name == "levels.deep.deeper"
    parent.set_level(LoggingSeverity.ERROR)
    assert child.get_effective_level() == LoggingSeverity.ERROR
    child.set_level(LoggingSeverity.DEBUG)
    assert child.is_enabled_for(LoggingSeverity.DEBUG)
    assert not parent.is_enabled_for(LoggingSeverity.WARN)
    assert rclpy.logging.get_logger_effective_level("levels.other") == LoggingSeverity.ERROR
    rclpy.logging.set_logger_level("levels", LoggingSeverity.INFO)
    assert parent.get_effective_level() == LoggingSeverity.INFO


def test_wrong_names_and_levels_raise():
    with pytest.raises(ValueError):
        rclpy.logging.get_logger("")
    with pytest.raises(ValueError):
        rclpy.logging.get_logger("wrong").get_child("")
    with pytest.raises(ValueError):
        rclpy.logging.set_logger_level("wrong", 17)


def test_log_says_whether_it_logged():
    logger = rclpy.logging.get_logger("saying")
    logger.set_level(LoggingSeverity.WARN)
    assert logger.warning("out")
    assert logger.log("out", LoggingSeverity.ERROR)
    assert not logger.info("not out")


# Filters


def test_once():
    logger = rclpy.logging.get_logger("filters")
    assert [logger.info("message", once=True) for _ in range(3)] == [True, False, False]


def test_skip_first():
    logger = rclpy.logging.get_logger("filters")
    assert [logger.info("message", skip_first=True) for _ in range(3)] == [False, True, True]


def test_throttle():
    logger = rclpy.logging.get_logger("filters")
    clock = Clock()
    logged = []
    for _ in range(2):
        logged.append(
            logger.info("message", throttle_duration_sec=1000, throttle_time_source_type=clock)
        )
    assert logged == [True, False]
    assert [logger.info("message", throttle_duration_sec=0.0) for _ in range(2)] == [True, True]


def test_filters_are_counted_by_the_place_of_the_call():
    logger = rclpy.logging.get_logger("filters")
    assert logger.info("one place", once=True)
    assert logger.info("another place", once=True)


def test_wrong_filters_raise():
    logger = rclpy.logging.get_logger("filters")
    with pytest.raises(TypeError):
        logger.info("message", no_such_filter=True)


def test_a_place_keeps_its_severity():
    logger = rclpy.logging.get_logger("severities")

    def log(severity):
        return logger.log("message", severity)

    assert log(LoggingSeverity.INFO)
    with pytest.raises(ValueError):
        log(LoggingSeverity.WARN)
    assert log(LoggingSeverity.INFO)


# Console

LOG = """
import sys
import rclpy
rclpy.init(args=sys.argv)
node = rclpy.create_node("talker", namespace="/rig")
node.get_logger().debug("for debugging")
node.get_logger().info("for information")
node.get_logger().get_child("part").error("an error")
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.long
def test_lines_on_stderr(run):
    lines = run(LOG).splitlines()
    pattern = r"\[INFO\] \[\d+\.\d{9}\] \[rig\.talker\]: for information"
    assert any(re.fullmatch(pattern, line) for line in lines)
    assert any(line.endswith("[rig.talker.part]: an error") for line in lines)
    assert "for debugging" not in "".join(lines)


def test_the_format_of_lines_can_be_set(run):
    form = "{severity}|{name}|{message}|{function_name}|{line_number}"
    lines = run(LOG, RCUTILS_CONSOLE_OUTPUT_FORMAT=form).splitlines()
    assert "INFO|rig.talker|for information|<module>|7" in lines


@pytest.mark.long
def test_the_level_comes_from_the_command_line(run):
    assert "for debugging" in run(LOG, "--ros-args", "--log-level", "debug")
    only = run(LOG, "--ros-args", "--log-level", "rig.talker:=error")
    assert "for information" not in only
    assert "an error" in only


# /rosout

LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_messages_go_to_rosout(ros):
    node = ros.node("logging", namespace="/rig")
    received = []
    ros.node("listening").create_subscription(Log, "/rosout", received.append, LATCHED)
    before_ns = time.time_ns()
    node.get_logger().warning("look here")
    line = inspect.currentframe().f_lineno - 1
    after_ns = time.time_ns()
    node.get_logger().get_child("part").error("and here")
    node.get_logger().debug("not here")
    logs = {}

    def all_there():
        logs.update({log.msg: log for log in received if log.name.startswith("rig.logging")})
        return {"look here", "and here"} <= set(logs)

    assert ros.spin_until(all_there)
    warning = logs["look here"]
    assert warning.name == "rig.logging"
    assert warning.level == int(LoggingSeverity.WARN)
    assert warning.function == "test_messages_go_to_rosout"
    assert warning.file.endswith("test_logging.py")
    assert warning.line == line
    assert before_ns <= warning.stamp.sec * 10**9 + warning.stamp.nanosec <= after_ns
    assert logs["and here"].name == "rig.logging.part"
    assert logs["and here"].level == int(LoggingSeverity.ERROR)
    assert "not here" not in logs


def test_a_child_that_is_gone_leaves_nothing_on_rosout(ros):
    logger = ros.node("forgetting", namespace="/rig").get_logger()
    received = []
    ros.node("listening").create_subscription(Log, "/rosout", received.append, LATCHED)
    kept, gone = logger.get_child("kept"), logger.get_child("gone")
    kept.info("first of one")
    gone.info("first of the other")
    del gone
    gc.collect()
    rclpy.logging.get_logger("rig.forgetting.gone").info("of no child")
    rclpy.logging.get_logger("rig.forgetting.kept").info("of a child")  # the same name counts
    logger.info("last")
    assert ros.spin_until(lambda: any(log.msg == "last" for log in received))
    of_this = [log.msg for log in received if log.name.startswith("rig.forgetting")]
    assert of_this == ["first of one", "first of the other", "of a child", "last"]


def test_rosout_can_be_left_out(ros):
    ros.node("silent", enable_rosout=False)
    watcher = ros.node("watching")
    assert ros.spin_until(lambda: "silent" in watcher.get_node_names())
    topics = dict(watcher.get_publisher_names_and_types_by_node("silent", "/"))
    assert "/rosout" not in topics
    own = dict(watcher.get_publisher_names_and_types_by_node("watching", "/"))
    assert own["/rosout"] == ["rcl_interfaces/msg/Log"]


# Services


def test_levels_are_read_and_set_by_service(ros):
    ros.node("leveled", enable_logger_service=True)
    asking = ros.node("asking")
    getting = asking.create_client(GetLoggerLevels, "/leveled/get_logger_levels")
    setting = asking.create_client(SetLoggerLevels, "/leveled/set_logger_levels")
    assert ros.spin_until(lambda: getting.service_is_ready() and setting.service_is_ready())
    levels = [LoggerLevel(name="leveled", level=10), LoggerLevel(name="leveled", level=17)]
    response = ros.result(setting.call_async(SetLoggerLevels.Request(levels=levels)))
    assert [result.successful for result in response.results] == [True, False]
    response = ros.result(getting.call_async(GetLoggerLevels.Request(names=["leveled"])))
    assert [(level.name, level.level) for level in response.levels] == [("leveled", 10)]
