# SPDX-License-Identifier: Apache-2.0
"""Bags: what the writer makes is what rosbag2 makes, and nothing written is lost."""

import dataclasses
import errno
import itertools
import os
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pneu_common.errors import InputError
from pneu_graph.bag.bag_writer import Attachment, BagWriter
from pneu_graph.bag.info import info_text
from pneu_graph.bag.metadata import read_metadata
from pneu_graph.bag.playback import Pacer
from pneu_graph.bag.qos import (
    OfferedQos,
    adapt_to_publishers,
    adapt_to_recorded,
    parse_profiles,
    profiles_text,
)
from pneu_graph.bag.reader import BagReader, side_records
from pneu_graph.bag.recording import Recording
from pneu_graph.bag.recover import recover_bag

pytestmark = pytest.mark.kernel_free

GENUINE = Path(__file__).parent / "data" / "rosbag2_zstd"
PRESSURE = "/rig/taps/end/pressure"


@pytest.fixture
def genuine():
    return BagReader(GENUINE)


def copy_into(recording, bag, repeat=1):
    """Records the messages of a bag anew."""
    for topic in bag.metadata.topics:
        recording.add_topic(
            dataclasses.replace(topic, message_count=0), bag.definitions.get(topic.name, "")
        )
    span = bag.metadata.duration_ns + 10**8
    for i in range(repeat):
        for m in bag.messages():
            recording.write(m.topic, m.data, m.log_time_ns + i * span, m.publish_time_ns + i * span)


def copied(bag, folder, repeat=1, **options):
    recording = Recording(BagWriter(folder, **options), 10**8)
    copy_into(recording, bag, repeat)
    assert recording.close() == []
    return BagReader(folder)


def contents(bag):
    return [(m.topic, m.data, m.log_time_ns, m.publish_time_ns) for m in bag.messages()]


def test_a_genuine_bag_is_read(genuine):
    messages = list(genuine.messages())
    assert len(messages) == genuine.metadata.message_count == 150
    assert all(a.log_time_ns <= b.log_time_ns for a, b in itertools.pairwise(messages))
    store = get_typestore(Stores.ROS2_JAZZY)
    pressures = [
        store.deserialize_cdr(m.data, "sensor_msgs/msg/FluidPressure").fluid_pressure
        for m in messages
        if m.topic == PRESSURE
    ]
    assert [p - pressures[0] for p in pressures] == list(range(75))
    assert 101325.0 <= pressures[0] < 101425.0
    assert {t.name: t.profiles[0].depth for t in genuine.metadata.topics} == {
        PRESSURE: 10,
        "/rig/joint_states": 10,
        "/parameter_events": 1000,
    }


def test_metadata_yaml_is_the_one_rosbag2_writes(genuine, tmp_path):
    shutil.copytree(GENUINE, tmp_path / "bag")
    read_metadata(tmp_path / "bag").write(tmp_path / "bag")
    written = (tmp_path / "bag" / "metadata.yaml").read_text()
    assert written.rstrip("\n") == (GENUINE / "metadata.yaml").read_text().rstrip("\n")


def test_info_looks_like_that_of_ros2_bag(genuine):
    lines = info_text(genuine).splitlines()
    assert lines[0] == "Files:             realbag_zstd_0.mcap"
    assert "Duration:          7.401069665s" in lines
    assert any(line.endswith("(1795224727.274243587)") for line in lines)
    assert (
        f"Topic: {PRESSURE} | Type: sensor_msgs/msg/FluidPressure | Count: 75"
        " | Serialization Format: cdr"
    ) in info_text(genuine)


def test_what_we_write_is_read_by_mcap_and_rosbags(genuine, tmp_path):
    bag = copied(genuine, tmp_path / "bag", repeat=20)
    assert contents(bag)[:150] == contents(genuine)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert sum(1 for _ in reader.iter_messages()) == 3000
        records = [m.metadata["serialized_metadata"] for m in reader.iter_metadata()]
    theirs = make_reader((GENUINE / "realbag_zstd_0.mcap").open("rb")).get_summary()
    ours = {c.topic: (c.metadata, summary.schemas[c.schema_id]) for c in summary.channels.values()}
    for channel in theirs.channels.values():
        metadata, schema = ours[channel.topic]
        expected = theirs.schemas[channel.schema_id]
        assert metadata == channel.metadata
        assert (schema.name, schema.encoding, schema.data) == (
            expected.name, expected.encoding, expected.data,
        )  # fmt: skip
    assert all(chunk.compression == "zstd" for chunk in summary.chunk_indexes)
    assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    assert "message_count: 0" in records[0] and "message_count: 3000" in records[-1]
    with Reader(tmp_path / "bag") as rosbags:
        assert rosbags.message_count == 3000
        connection = next(c for c in rosbags.connections if c.topic == PRESSURE)
        assert connection.msgdef.data.encode() == ours[PRESSURE][1].data
        assert sum(1 for _ in rosbags.messages([connection])) == 1500


def test_files_are_split_by_duration_and_size(genuine, tmp_path):
    by_time = copied(genuine, tmp_path / "time", max_file_s=2.0)
    assert [file.entry.path for file in by_time.files] == [f"time_{i}.mcap" for i in range(4)]
    assert all(file.entry.duration_ns <= 2.0e9 for file in by_time.files)
    # half a megabyte as it is packed; how soon it is packed hangs on the clock
    by_size = copied(genuine, tmp_path / "size", repeat=100, max_file_bytes=100_000)
    assert len(by_size.files) >= 3
    assert all(file.path.stat().st_size < 200_000 for file in by_size.files)
    for bag, count in ((by_time, 150), (by_size, 15000)):
        assert len(contents(bag)) == count
        with Reader(bag.path) as rosbags:
            assert rosbags.message_count == count


def test_attachments_and_records_are_in_every_file(genuine, tmp_path):
    recording = Recording(BagWriter(tmp_path / "bag", max_file_s=4.0), 10**8)
    recording.attach(Attachment("rig.yaml", b"pneu_rig: 1\n", "application/yaml", 5))
    recording.add_record("pneu", {"git_revision": "abc"})
    copy_into(recording, genuine)
    assert recording.close() == []
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) == 2
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream)
            (attachment,) = reader.iter_attachments()
            found = {m.name: m.metadata for m in reader.iter_metadata()}
        assert (attachment.name, attachment.data) == ("rig.yaml", b"pneu_rig: 1\n")
        assert found["pneu"] == {"git_revision": "abc"}


def test_snapshot_writes_the_newest_messages(genuine, tmp_path):
    newest = contents(genuine)[-30:]
    size = sum(len(data) for _, data, *_ in newest) + 20
    recording = Recording(BagWriter(tmp_path / "bag"), size, snapshot_mode=True)
    for topic in genuine.metadata.topics:
        definition = genuine.definitions.get(topic.name, "")
        recording.add_topic(dataclasses.replace(topic, message_count=0), definition)
    for message in contents(genuine):
        while recording.status().queued_bytes > size / 2:
            time.sleep(0.001)  # a queue as small as this would refuse messages
        recording.write(*message)
    assert recording.snapshot() == ""
    assert recording.close() == []
    assert contents(BagReader(tmp_path / "bag")) == newest


@pytest.mark.parametrize("cut", [10, 1000, 5000, 20_000])
def test_a_cut_file_is_read_and_completed(genuine, tmp_path, cut):
    bag = copied(genuine, tmp_path / "bag", repeat=60)
    whole = contents(bag)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    os.truncate(path, path.stat().st_size - cut)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    found = BagReader(tmp_path / "bag")
    assert not found.files[0].indexed
    kept = contents(found)
    assert kept == whole[: len(kept)]
    assert len(kept) > 0.5 * len(whole)
    assert "Without index" in info_text(found)
    recover_bag(tmp_path / "bag")
    again = BagReader(tmp_path / "bag")
    assert again.files[0].indexed
    assert contents(again) == kept
    with Reader(tmp_path / "bag") as rosbags:
        assert rosbags.message_count == len(kept)
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"", "is no MCAP file"), (b"nonsense" * 9, "is no MCAP file"), (None, "no such bag")],
)
def test_what_is_no_bag_is_refused(tmp_path, content, sentence):
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        BagReader(path)


def test_an_existing_folder_is_not_written_into(tmp_path):
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path)


WRITE_FOR_EVER = textwrap.dedent(
    """
    import dataclasses, sys, time
    from pathlib import Path
    from pneu_graph.bag.bag_writer import BagWriter
    from pneu_graph.bag.reader import BagReader
    from pneu_graph.bag.recording import Recording

    bag = BagReader(sys.argv[1])
    recording = Recording(BagWriter(Path(sys.argv[2])), 10**8)
    topic = next(t for t in bag.metadata.topics if t.message_count)
    recording.add_topic(dataclasses.replace(topic), bag.definitions[topic.name])
    data = next(bag.messages({topic.name})).data
    print("begin", flush=True)
    for i in range(10**9):
        recording.write(topic.name, data, time.time_ns(), i)
        time.sleep(0.001)
    """
)


def test_kill_9_leaves_everything_but_the_last_second(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", WRITE_FOR_EVER, GENUINE, tmp_path / "bag"], stdout=subprocess.PIPE
    )
    assert process.stdout.readline() == b"begin\n"
    time.sleep(2.5)
    killed_ns = time.time_ns()
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    found = BagReader(tmp_path / "bag")
    numbers = [m.publish_time_ns for m in found.messages()]
    assert numbers == list(range(len(numbers)))
    assert killed_ns - found.metadata.end_ns < 1.0e9
    recover_bag(tmp_path / "bag")
    with Reader(tmp_path / "bag") as rosbags:
        assert rosbags.message_count == len(numbers)


class Faults:
    """What a recording reports, and a way to wait for it."""

    def __init__(self):
        self.sentences = []
        self.said = threading.Event()

    def __call__(self, sentence):
        self.sentences.append(sentence)
        self.said.set()

    def wait(self):
        assert self.said.wait(10.0)
        self.said.clear()


def load(recording, bag, stop):
    """Records incompressible messages until told to stop."""
    topic = next(t for t in bag.metadata.topics if t.message_count)
    recording.add_topic(dataclasses.replace(topic, message_count=0), bag.definitions[topic.name])
    i = 0
    while not stop():
        recording.write(topic.name, os.urandom(4096), 10**9 + i, i)
        i += 1
        time.sleep(0.0005)


def test_full_disk_pauses_the_recording_and_costs_nothing_written(genuine, tmp_path):
    """A real small file system where the user may mount one."""
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(small)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no right to mount a file system")
    try:
        ballast = small / "ballast"
        ballast.write_bytes(bytes(1 << 20))
        faults = Faults()
        recording = Recording(BagWriter(small / "bag"), 10**8, report=faults)
        load(recording, genuine, faults.said.is_set)
        faults.wait()
        assert os.strerror(errno.ENOSPC) in faults.sentences[0]
        assert recording.status().fault == os.strerror(errno.ENOSPC)
        during = BagReader(small / "bag")
        assert during.metadata.message_count > 100
        assert not during.files[0].damage

        lost_from = recording.status().written
        recording.write(PRESSURE, b"lost", 1, 1)
        ballast.unlink()
        faults.wait()  # resumed by itself
        assert "is written again" in faults.sentences[1]
        assert recording.status().dropped > 0
        topic = next(t for t in genuine.metadata.topics if t.message_count).name
        recording.write(topic, b"after", 10**18, 1)
        assert recording.close() == []
        with Reader(small / "bag") as rosbags:
            assert rosbags.message_count == lost_from + 1
        assert contents(BagReader(small / "bag"))[-1][1] == b"after"
    finally:
        subprocess.run(["umount", str(small)], check=True)


def test_a_file_that_may_not_grow_stays_readable_to_the_end(genuine, tmp_path):
    faults = Faults()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, limits[1]))
        recording = Recording(BagWriter(tmp_path / "bag"), 10**8, report=faults)
        load(recording, genuine, faults.said.is_set)
        left = recording.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert "has no index" in left[0] and "pneu bag recover" in left[0]
    found = BagReader(tmp_path / "bag")
    count = len(contents(found))
    assert count > 100 and not found.files[0].damage
    recover_bag(tmp_path / "bag")
    with Reader(tmp_path / "bag") as rosbags:
        assert rosbags.message_count == count


def test_the_recording_thread_never_waits_for_the_disk(genuine, tmp_path):
    """A queue that is full refuses messages at once and counts them."""
    recording = Recording(BagWriter(tmp_path / "bag"), 100_000)
    topic = next(t for t in genuine.metadata.topics if t.message_count)
    recording.add_topic(dataclasses.replace(topic, message_count=0), "")
    data = os.urandom(50_000)
    slowest = 0.0
    for i in range(300):
        begin = time.perf_counter()
        recording.write(topic.name, data, i, i)
        slowest = max(slowest, time.perf_counter() - begin)
    status = recording.status()
    assert recording.close() == []
    assert status.dropped > 0
    assert slowest < 0.2
    assert BagReader(tmp_path / "bag").metadata.message_count == 300 - status.dropped


UNUSUAL = OfferedQos(
    history="keep_all",
    depth=7,
    reliability="best_effort",
    durability="transient_local",
    deadline_ns=1_500_000_001,
    lifespan_ns=3_250_000_002,
    liveliness="manual_by_topic",
    lease_ns=2_750_000_003,
    avoid_ros_namespace_conventions=True,
)
"""Each policy unlike its default, and each duration unlike the others."""

UNUSUAL_TEXT = """\
- history: keep_all
  depth: 7
  reliability: best_effort
  durability: transient_local
  deadline:
    sec: 1
    nsec: 500000001
  lifespan:
    sec: 3
    nsec: 250000002
  liveliness: manual_by_topic
  liveliness_lease_duration:
    sec: 2
    nsec: 750000003
  avoid_ros_namespace_conventions: true"""
"""As rosbag2 writes it."""


def test_each_policy_is_written_and_read():
    assert UNUSUAL.text() == UNUSUAL_TEXT
    assert parse_profiles(UNUSUAL_TEXT, "x") == [UNUSUAL]
    both = profiles_text([OfferedQos(), UNUSUAL])
    assert parse_profiles(both, "x") == [OfferedQos(), UNUSUAL]
    nothing_asked = "- {history: 3, depth: 0, deadline: {sec: 0, nsec: 0}}"
    (found,) = parse_profiles(nothing_asked, "x")
    assert (found.deadline_ns, found.lifespan_ns, found.lease_ns) == (2**63 - 1,) * 3
    assert parse_profiles("", "x") == []
    with pytest.raises(InputError, match="reliability of a QoS profile is one of"):
        parse_profiles("- {reliability: sometimes}", "bag: /t")


# The numbers of rmw/types.h, which Humble and older wrote.
NUMBERS = {
    "history": ["system_default", "keep_last", "keep_all", "unknown"],
    "reliability": ["system_default", "reliable", "best_effort", "unknown", "best_available"],
    "durability": ["system_default", "transient_local", "volatile", "unknown", "best_available"],
    "liveliness": ["system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown",
                   "best_available"],
}  # fmt: skip


@pytest.mark.parametrize(
    ("policy", "number", "word"),
    [(policy, k, word) for policy, words in NUMBERS.items() for k, word in enumerate(words)],
)
def test_numbers_of_policies_are_read(policy, number, word):
    (found,) = parse_profiles(f"- {{{policy}: {number}}}", "x")
    assert getattr(found, policy) == word
    with pytest.raises(InputError, match=policy):
        parse_profiles(f"- {{{policy}: {len(NUMBERS[policy])}}}", "x")


@pytest.mark.parametrize("offered", [UNUSUAL, OfferedQos(), OfferedQos(depth=3)])
def test_each_policy_goes_into_a_profile_and_back(offered):
    from pneu_runtime import hook

    hook.install()
    # a profile of rclpy for a topic of ROS always has its prefix
    expected = dataclasses.replace(offered, avoid_ros_namespace_conventions=False)
    assert OfferedQos.from_profile(offered.profile()) == expected


def test_an_endpoint_is_shown_with_each_policy():
    from pneu_runtime import hook

    hook.install()
    from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum

    from pneu_graph.tools.endpoint_text import endpoint_text

    endpoint = TopicEndpointInfo(
        node_name="talker",
        node_namespace="/rig",
        topic_type="std_msgs/msg/String",
        endpoint_type=TopicEndpointTypeEnum.SUBSCRIPTION,
        endpoint_gid=[1, 0xAB, *range(2, 16)],
        qos_profile=UNUSUAL.profile(),
    )
    assert endpoint_text(endpoint).splitlines() == [
        "Node name: talker",
        "Node namespace: /rig",
        "Topic type: std_msgs/msg/String",
        "Topic type hash: INVALID",
        "Endpoint type: SUBSCRIPTION",
        "GID: 01.ab.02.03.04.05.06.07.08.09.0a.0b.0c.0d.0e.0f",
        "QoS profile:",
        "  Reliability: BEST_EFFORT",
        "  History (Depth): KEEP_ALL (7)",
        "  Durability: TRANSIENT_LOCAL",
        "  Lifespan: 3250000002 nanoseconds",
        "  Deadline: 1500000001 nanoseconds",
        "  Liveliness: MANUAL_BY_TOPIC",
        "  Liveliness lease duration: 2750000003 nanoseconds",
    ]
    endpoint.qos_profile = OfferedQos().profile()
    assert "  Liveliness lease duration: Infinite" in endpoint_text(endpoint).splitlines()


def test_qos_matches_every_publisher():
    reliable, lossy = OfferedQos(), OfferedQos(reliability="best_effort")
    latched = OfferedQos(durability="transient_local", depth=1)
    assert adapt_to_publishers([reliable, lossy], 10).reliability == "best_effort"
    assert adapt_to_publishers([latched, latched], 10).durability == "transient_local"
    assert adapt_to_publishers([latched, reliable], 10).durability == "volatile"
    assert adapt_to_publishers([latched], 7) == OfferedQos(depth=7, durability="transient_local")
    assert adapt_to_recorded([UNUSUAL, UNUSUAL]) == UNUSUAL
    assert adapt_to_recorded([OfferedQos(depth=0)]) == OfferedQos(depth=10)
    assert adapt_to_recorded([OfferedQos(depth=3), latched, OfferedQos(depth=8)]) == OfferedQos(
        depth=8
    )
    assert adapt_to_recorded([reliable, lossy]) == lossy
    assert adapt_to_recorded([]) == OfferedQos()


class PacerTime:
    """A clock that only waiting moves, and how long was waited each time."""

    def __init__(self, pacer, monkeypatch):
        self.now_s, self.waited = 1000.0, []
        clock = SimpleNamespace(monotonic=lambda: self.now_s)
        monkeypatch.setattr("pneu_graph.bag.playback.time", clock)
        monkeypatch.setattr(pacer._changed, "wait", self.wait)

    def wait(self, seconds):
        self.waited.append(seconds)
        self.now_s += seconds


@pytest.mark.parametrize(("rate", "waits_s"), [(10.0, 0.1), (1.0, 1.0), (0.25, 4.0)])
def test_pacer_keeps_rate(rate, waits_s, monkeypatch):
    pacer = Pacer(rate)
    time_ = PacerTime(pacer, monkeypatch)
    pacer.begin(5 * 10**9)
    assert pacer.wait_until(6 * 10**9)
    assert time_.waited == pytest.approx([waits_s])
    assert pacer.now_ns() == 6 * 10**9
    assert pacer.wait_until(6 * 10**9) and len(time_.waited) == 1, "it is due already"
    pacer.set_rate(2.0 * rate)
    assert pacer.now_ns() == 6 * 10**9, "from now on"
    assert pacer.wait_until(7 * 10**9)
    assert time_.waited == pytest.approx([waits_s, 0.5 * waits_s])


def test_pacer_stands_while_it_is_paused(monkeypatch):
    pacer = Pacer(10.0)
    time_ = PacerTime(pacer, monkeypatch)
    pacer.begin(0)
    time_.now_s += 0.5
    for _ in range(2):
        pacer.pause()
        time_.now_s += 3.0
        assert pacer.paused and pacer.now_ns() == 5 * 10**9
    for passed_ns in (0, 2_500_000_000, 5_000_000_000):  # only the first resumes
        pacer.resume()
        assert not pacer.paused and pacer.now_ns() == 5 * 10**9 + passed_ns
        time_.now_s += 0.25
    assert pacer.now_ns() == 12_500_000_000
    assert not pacer.step(), "which only a paused one does"


def test_pacer_lets_one_through_for_each_step_and_ends():
    pacer = Pacer(10.0, paused=True)
    pacer.begin(0)
    passed, through = [], threading.Event()

    def play():
        for due_ns in (10**12, 2 * 10**12, 3 * 10**12):
            passed.append(pacer.wait_until(due_ns))
            through.set()

    thread = threading.Thread(target=play, daemon=True)
    thread.start()
    assert pacer.step()
    assert through.wait(60.0) and passed == [True]
    assert pacer.now_ns() == 10**12
    assert thread.is_alive()
    pacer.stop()
    thread.join(60.0)
    assert passed == [True, False, False]


def test_side_records_of_a_genuine_file():
    names = [record.name for record in side_records(GENUINE / "realbag_zstd_0.mcap")]
    assert names == ["rosbag2", "rosbag2"]
