# SPDX-License-Identifier: Apache-2.0
"""Every option of the recorder, and of `pneu bag record`, on topics of this process."""

from tests.graph_fixtures import domain, graph, outside  # isort: skip

import functools
import random
import threading

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tests.live_graph import wait_for
from typer.testing import CliRunner

from pneu_common.errors import InputError
from pneu_graph.bag.reader import BagReader, side_records
from pneu_graph.nodes.recorder import Recorder
from pneu_graph.tools.bag import app

__all__ = ["domain", "graph", "outside"]

pytestmark = pytest.mark.kernel_free

DEEP = QoSProfile(depth=1000)
TOPICS = ("/a", "/rig/a", "/rig/ab", "/rig/_hidden", "/_hidden")


@pytest.fixture
def record(graph, tmp_path):
    """Begins a recording with parameters; each recorder has a name and a folder of its own."""
    begun = {}

    def begin(name, **parameters):
        rename = ["--ros-args", "-r", f"__node:={name}"]
        make = functools.partial(Recorder, cli_args=rename)
        values = {"uri": str(tmp_path / name), "polling_interval": 0.02, **parameters}
        begun[name] = graph.add(make, **values)
        return begun[name]

    yield begin
    for node in begun.values():
        node.close()


def end(recorder, graph):
    """Ends a recording, and returns its bag."""
    graph.executor.remove_node(recorder)
    assert recorder.close()
    return BagReader(recorder.get_parameter("uri").value)


def texts(bag):
    """What was recorded of each topic of text."""
    found = {}
    for message in bag.messages():
        if message.topic in (*TOPICS, "/late"):
            size = int.from_bytes(message.data[4:8], "little")
            text = message.data[8 : 8 + size - 1].decode()
            found.setdefault(message.topic, []).append(text)
    return found


def counts(recorder):
    """How many messages of each topic of text a recorder has written so far."""
    topics = recorder._rec_recording._writer.metadata.topics
    found = {topic.name: topic.message_count for topic in topics if topic.message_count}
    return {name: count for name, count in found.items() if name in (*TOPICS, "/late")}


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, {"/a", "/rig/a", "/rig/ab"}),
        ({"all": True}, {"/a", "/rig/a", "/rig/ab"}),
        ({"all": True, "include_hidden_topics": True}, set(TOPICS)),
        ({"topics": ["/rig/ab", "/a"]}, {"/a", "/rig/ab"}),
        ({"topics": ["rig/a"]}, {"/rig/a"}),
        ({"topics": ["/_hidden"]}, {"/_hidden"}),
        ({"topics": ["/a"], "all": True}, {"/a", "/rig/a", "/rig/ab"}),
        ({"regex": "/rig/a"}, {"/rig/a"}),
        ({"regex": "/rig/a.*"}, {"/rig/a", "/rig/ab"}),
        ({"regex": ".*/_hidden"}, {"/_hidden", "/rig/_hidden"}),
        ({"topics": ["/a"], "regex": "/rig/ab"}, {"/a", "/rig/ab"}),
        ({"all": True, "exclude": "/rig/a"}, {"/a", "/rig/ab"}),
        ({"topics": ["/a", "/rig/a"], "exclude": "/rig/.*"}, {"/a"}),
    ],
)
def test_topics_are_chosen(graph, record, parameters, expected):
    publishers = {topic: graph.probe.create_publisher(String, topic, DEEP) for topic in TOPICS}
    recorder = record("recorder", **parameters)
    # another takes all, so that it is known that those left out would have been found as well
    every = record("every", all=True, include_hidden_topics=True)
    for topic, publisher in publishers.items():
        wait_for(lambda topic=topic, publisher=publisher: (
            publisher.get_subscription_count() == 1 + (topic in expected)))  # fmt: skip
        publisher.publish(String(data=f"on {topic}"))
    wait_for(lambda: counts(every) == dict.fromkeys(TOPICS, 1))
    wait_for(lambda: counts(recorder) == dict.fromkeys(expected, 1))
    assert texts(end(recorder, graph)) == {topic: [f"on {topic}"] for topic in expected}


@pytest.mark.parametrize("name", ["regex", "exclude"])
def test_what_is_no_regular_expression_is_refused(graph, tmp_path, name):
    with pytest.raises(InputError, match=f"parameter {name}: '\\[' is no regular expression"):
        graph.add(Recorder, uri=str(tmp_path / "bag"), **{name: "["})


def test_a_topic_that_appears_later_is_recorded(graph, record):
    recorder = record("recorder", all=True)
    publisher = graph.probe.create_publisher(String, "/late", DEEP)
    wait_for(publisher.get_subscription_count)
    publisher.publish(String(data="late"))
    wait_for(lambda: counts(recorder))
    assert texts(end(recorder, graph)) == {"/late": ["late"]}


def test_a_file_ends_at_its_size(graph, record):
    """Text of random characters, in messages of a fifth of the size."""
    publisher = graph.probe.create_publisher(String, "/a", DEEP)
    recorder = record("recorder", topics=["/a"], max_bag_size=100_000)
    whole = record("whole", topics=["/a"])
    wait_for(lambda: publisher.get_subscription_count() == 2)
    rng = random.Random(1)
    for _ in range(20):
        publisher.publish(String(data="".join(chr(rng.randrange(32, 127)) for _ in range(20_000))))
    for one in (recorder, whole):
        wait_for(lambda one=one: counts(one) == {"/a": 20})
    split, unsplit = end(recorder, graph), end(whole, graph)
    # what was flushed in between counts as it is packed, to five sixths
    assert {file.entry.message_count for file in split.files[:-1]} <= {5, 6}
    assert len(split.files) in (4, 5)
    assert [file.entry.message_count for file in unsplit.files] == [20]
    assert texts(split) == texts(unsplit)


def test_a_file_ends_at_its_duration_in_simulated_time(graph, record):
    """Messages 10 s apart of simulated time, in files of at most 25 s."""
    clock = graph.probe.create_publisher(Clock, "/clock", DEEP)
    publisher = graph.probe.create_publisher(String, "/a", DEEP)
    recorder = record("recorder", topics=["/a"], max_bag_duration=25.0, use_sim_time=True)
    by_wall = record("by_wall", topics=["/a"], max_bag_duration=25.0)
    wait_for(lambda: publisher.get_subscription_count() == 2)
    wait_for(clock.get_subscription_count)
    for k in range(6):
        now_s = 1000 + 10 * k
        message = Clock()
        message.clock.sec = now_s
        clock.publish(message)
        wait_for(lambda now_s=now_s: recorder.get_clock().now().nanoseconds == now_s * 10**9)
        publisher.publish(String(data=str(now_s)))
        wait_for(lambda k=k: counts(recorder) == {"/a": k + 1})
    wait_for(lambda: counts(by_wall) == {"/a": 6})
    bag = end(recorder, graph)
    assert [message.log_time_ns for message in bag.messages()] == [
        (1000 + 10 * k) * 10**9 for k in range(6)
    ]
    assert [file.entry.message_count for file in bag.files] == [3, 3]
    by_wall = end(by_wall, graph)
    assert [file.entry.message_count for file in by_wall.files] == [6]
    assert all(message.log_time_ns > 10**18 for message in by_wall.messages())


def test_a_snapshot_holds_what_fits_into_the_cache(graph, record):
    """Of ten messages of 1008 bytes, four fit."""
    publisher = graph.probe.create_publisher(String, "/a", DEEP)
    recorder = record("recorder", topics=["/a"], snapshot_mode=True, max_cache_size=4500)
    at_once = record("at_once", topics=["/a"])
    wait_for(lambda: publisher.get_subscription_count() == 2)
    sent = [f"{k:0999d}" for k in range(10)]
    for k, text in enumerate(sent):
        publisher.publish(String(data=text))
        wait_for(lambda k=k: counts(at_once) == {"/a": k + 1})
        wait_for(lambda: recorder._rec_recording.status().queued_bytes == 0)
    wait_for(lambda: recorder._rec_recording._bytes_in == 10 * 1008)
    assert counts(recorder) == {}
    response = graph.call(Trigger, "/recorder/snapshot", Trigger.Request())
    assert (response.success, response.message) == (True, "")
    refused = graph.call(Trigger, "/at_once/snapshot", Trigger.Request())
    assert not refused.success and "does not run in snapshot mode" in refused.message
    assert texts(end(recorder, graph)) == {"/a": sent[-4:]}
    assert texts(end(at_once, graph)) == {"/a": sent}


def test_the_service_split_begins_a_file(graph, record):
    publisher = graph.probe.create_publisher(String, "/a", DEEP)
    recorder = record("recorder", topics=["/a"])
    wait_for(publisher.get_subscription_count)
    for k, count in enumerate((2, 3, 1)):
        for _ in range(count):
            publisher.publish(String(data=f"part {k}"))
        wait_for(lambda k=k: counts(recorder) == {"/a": (2, 5, 6)[k]})
        if k < 2:
            response = graph.call(Trigger, "/recorder/split", Trigger.Request())
            assert (response.success, response.message) == (True, "")
    assert [file.entry.message_count for file in end(recorder, graph).files] == [2, 3, 1]


def test_attachments_and_the_operator_are_kept(graph, record, tmp_path):
    kinds = {"rig.yaml": "application/yaml", "notes.txt": "application/octet-stream",
             "report.json": "application/json"}  # fmt: skip
    for name in kinds:
        (tmp_path / name).write_text(f"this is {name}")
    recorder = record(
        "recorder",
        topics=["/a"],
        attachments=[str(tmp_path / name) for name in kinds],
        operator="Anna Ø.",
    )
    bag = end(recorder, graph)
    records = list(side_records(bag.files[0].path))
    attached = {record.name: record for record in records if hasattr(record, "media_type")}
    for name, kind in kinds.items():
        assert attached[name].data.decode() == f"this is {name}"
        assert attached[name].media_type == kind
    (about,) = [record.metadata for record in records if record.name == "pneu"]
    assert about["operator"] == "Anna Ø."


def test_an_attachment_that_is_missing_is_refused(graph, tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be attached"):
        graph.add(Recorder, uri=str(tmp_path / "bag"), attachments=[str(tmp_path / "none.yaml")])
    assert not (tmp_path / "bag").exists()


def test_diagnostics_tell_topics_and_messages(graph, record):
    publisher = graph.probe.create_publisher(String, "/a", DEEP)
    arrays = graph.listen(DiagnosticArray, "/diagnostics", DEEP)
    recorder = record("recorder", topics=["/a"])
    wait_for(publisher.get_subscription_count)
    for _ in range(3):
        publisher.publish(String(data="x"))
    wait_for(lambda: counts(recorder) == {"/a": 3})
    recorder._diagnose()

    def newest():
        statuses = [status for array in arrays for status in array.status]
        assert {status.name for status in statuses} <= {"recorder: bag"}
        return {pair.key: pair.value for status in statuses[-1:] for pair in status.values}

    wait_for(lambda: newest().get("written") == "3")
    shown = {key: newest()[key] for key in ("topics", "written", "dropped", "files", "fault")}
    assert shown == {"topics": "1", "written": "3", "dropped": "0", "files": "1", "fault": ""}
    assert arrays[-1].status[0].message == "recording"


# The command line.


def parameters_of_command(outside, name, *words):
    """Runs `pneu bag record` until its node has told its parameters."""
    told, faults = {}, []
    names = ["uri", "topics", "all", "regex", "exclude", "include_hidden_topics", "max_bag_size",
             "max_bag_duration", "max_cache_size", "snapshot_mode", "use_sim_time", "attachments",
             "operator"]  # fmt: skip
    client = outside.create_client(GetParameters, f"/{name}/get_parameters")

    def meanwhile():
        try:
            wait_for(client.service_is_ready)
            future = client.call_async(GetParameters.Request(names=names))
            wait_for(future.done)
            values = map(parameter_value_to_python, future.result().values)
            told.update(zip(names, values, strict=True))
        except BaseException as fault:
            faults.append(fault)
        finally:
            rclpy.try_shutdown()

    thread = threading.Thread(target=meanwhile)
    thread.start()
    result = CliRunner().invoke(app, ["record", *map(str, words)])
    thread.join()
    assert faults == []
    assert result.exit_code == 0, result.output
    return told


DEFAULTS = {
    "uri": "",
    "topics": [""],
    "all": False,
    "regex": "",
    "exclude": "",
    "include_hidden_topics": False,
    "max_bag_size": 0,
    "max_bag_duration": 0.0,
    "max_cache_size": 104_857_600,
    "snapshot_mode": False,
    "use_sim_time": False,
    "attachments": [""],
    "operator": "",
}


@pytest.mark.usefixtures("domain")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["/a", "/rig/a"], {"topics": ["/a", "/rig/a"]}),
        (["--all"], {"all": True}),
        (["-a", "--use-sim-time"], {"all": True, "use_sim_time": True}),
        (["--regex", "/rig/.*", "--snapshot-mode"], {"regex": "/rig/.*", "snapshot_mode": True}),
        (
            ["-e", "/b.*", "-x", "/bc", "--include-hidden-topics"],
            {"regex": "/b.*", "exclude": "/bc", "include_hidden_topics": True},
        ),
        (
            ["/a", "--max-bag-size", 7_000_001, "--max-bag-duration", 12.5, "--max-cache-size",
             3_000_003, "--operator", "Anna: \"Ø\" #1", "--exclude-regex", "/none"],
            {"topics": ["/a"], "max_bag_size": 7_000_001, "max_bag_duration": 12.5,
             "max_cache_size": 3_000_003, "operator": "Anna: \"Ø\" #1", "exclude": "/none"},
        ),
        (["/a", "-b", 42, "-d", 3.0], {"topics": ["/a"], "max_bag_size": 42,
                                       "max_bag_duration": 3.0}),
    ],
)  # fmt: skip
def test_options_of_the_command_line(outside, tmp_path, words, expected):
    files = [tmp_path / "rig.yaml", tmp_path / "b.txt"]
    for file in files:
        file.write_text("x")
    bag = tmp_path / "bag"
    told = parameters_of_command(outside, "recorder", *words, "--output", bag)
    assert told == {**DEFAULTS, **expected, "uri": str(bag)}
    attach = [word for file in files for word in ("--attach", file)]
    again = tmp_path / "again"
    told = parameters_of_command(
        outside, "second", *words, "-o", again, "--node-name", "second", *attach
    )
    attachments = [str(file) for file in files]
    assert told == {**DEFAULTS, **expected, "uri": str(again), "attachments": attachments}
    assert (bag / "metadata.yaml").exists() and (again / "metadata.yaml").exists()


def test_a_recording_of_nothing_is_refused():
    result = CliRunner().invoke(app, ["record", "--exclude-regex", "/a"])
    assert isinstance(result.exception, InputError)
    assert "name topics, or say --all or --regex" in str(result.exception)
