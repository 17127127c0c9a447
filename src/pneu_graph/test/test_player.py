# SPDX-License-Identifier: Apache-2.0
"""The player: every service and every option, on a bag whose messages lie minutes apart.

Recorded time runs so much faster than the clock, or so much slower, that no outcome hangs on
punctuality: a rate that is not applied makes a playback last for minutes, or end at once.
"""

from tests.graph_fixtures import domain, graph, outside  # isort: skip

import contextlib
import functools
import threading
import time

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from tests.live_graph import wait_for
from tests.measured import PATIENCE_S
from typer.testing import CliRunner

from pneu_common.errors import InputError
from pneu_graph.bag.bag_writer import BagWriter
from pneu_graph.bag.metadata import Topic
from pneu_graph.bag.qos import OfferedQos
from pneu_graph.bag.reader import BagReader
from pneu_graph.nodes.player import Player, PlayOptions
from pneu_graph.tools.bag import app
from pneu_runtime import interfaces

__all__ = ["domain", "graph", "outside"]

pytestmark = pytest.mark.kernel_free

BEGIN_NS = 1_700_000_000_250_000_000
FAST = 1e5
"""At this rate the whole bag, 1000 s long, lasts 10 ms."""

SLOW = 0.5
"""At this rate the second message is due after minutes."""

DEEP = QoSProfile(depth=1000)
AT_S = {"/a": (0, 200, 400, 600, 800, 1000), "/b": (100, 300, 500, 700, 900), "/c": (450,)}
"""When the messages of each topic were recorded, s after the first; each holds that time."""


@pytest.fixture
def bag(tmp_path):
    return written_bag(tmp_path / "bag")


def written_bag(folder, profiles=None, extra=()):
    """Writes the bag, and further (time, topic, type, message) into it."""
    writer = BagWriter(folder)
    float64 = interfaces.message_class("std_msgs/msg/Float64")
    rows = [
        (at_s, topic, "std_msgs/msg/Float64", float64(data=float(at_s)))
        for topic, times in AT_S.items()
        for at_s in times
    ]
    rows = sorted([*rows, *extra], key=lambda row: row[0])
    for topic, name in {row[1]: row[2] for row in rows}.items():
        offered = (profiles or {}).get(topic, [OfferedQos(depth=100)])
        writer.add_topic(Topic(topic, name, profiles=offered), interfaces.full_text(name))
    for at_s, topic, _, message in rows:
        at_ns = BEGIN_NS + round(at_s * 1e9)
        writer.write(topic, interfaces.serialize(message), at_ns, at_ns)
    assert writer.close() == []
    return BagReader(folder)


def times_of(*topics, within=(0, 1000)):
    """What is to be heard of each topic: the times of its messages within a range."""
    low, high = within
    return {
        topic: [float(at_s) for at_s in AT_S[topic] if low <= at_s <= high]
        for topic in topics
        if any(low <= at_s <= high for at_s in AT_S[topic])
    }


class Heard:
    """What a probe hears of the topics of the bag, and of the clock in seconds after its begin."""

    def __init__(self, subscribe, topics=("/a", "/b", "/c", "/again/a")):
        self.by_topic = {topic: [] for topic in topics}
        for topic, found in self.by_topic.items():
            subscribe(Float64, topic, lambda message, found=found: found.append(message.data), DEEP)
        self.ticks = []
        subscribe(Clock, "/clock", self._on_clock, DEEP)

    def _on_clock(self, message):
        now_ns = message.clock.sec * 10**9 + message.clock.nanosec
        self.ticks.append((now_ns - BEGIN_NS) / 1e9)

    @property
    def messages(self):
        return {topic: found for topic, found in self.by_topic.items() if found}

    @property
    def count(self):
        return sum(map(len, self.by_topic.values()))


@pytest.fixture
def heard(graph):
    return Heard(graph.probe.create_subscription)


@contextlib.contextmanager
def playing(graph, bag, **options):
    """A player that plays in a thread, and a list with what `play` returned once it ended."""
    player = graph.add(functools.partial(Player, bag, PlayOptions(**options)))
    outcome = []
    thread = threading.Thread(target=lambda: outcome.append(player.play()), daemon=True)
    thread.start()
    try:
        yield player, outcome
    finally:
        player.pacer.stop()
        thread.join(10.0)
        assert not thread.is_alive()


def play_all(graph, heard, bag, **options):
    """Plays to the end, and waits until all of it was heard; how long playing took, s."""
    begun = time.monotonic()
    with playing(graph, bag, **{"rate": FAST, **options}) as (player, outcome):
        wait_for(lambda: outcome)
        took_s = time.monotonic() - begun
    assert outcome == [True]
    wait_for(lambda: heard.count >= player.published)
    assert heard.count == player.published
    return took_s


def ask(graph, service):
    """Calls a service of the player; success and message."""
    response = graph.call(Trigger, f"/player/{service}", Trigger.Request())
    return response.success, response.message


# Options.


def test_all_is_played_in_order(graph, heard, bag):
    took_s = play_all(graph, heard, bag)
    assert heard.messages == times_of("/a", "/b", "/c")
    assert heard.ticks == []
    assert took_s >= 1000 / FAST


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1e6])
def test_a_rate_out_of_range_is_refused(rate):
    with pytest.raises(InputError, match="--rate: is more than 0"):
        PlayOptions(rate=rate).check()


@pytest.mark.parametrize(
    ("field", "option"),
    [
        ("start_offset_s", "--start-offset"),
        ("duration_s", "--duration"),
        ("clock_hz", "--clock"),
        ("delay_s", "--delay"),
    ],
)
def test_negative_times_are_refused(field, option):
    with pytest.raises(InputError, match=f"{option}: is 0 or more, found -0.5"):
        PlayOptions(**{field: -0.5}).check()


@pytest.mark.parametrize(
    ("options", "within"),
    [
        ({"start_offset_s": 350.5}, (350.5, 1000)),
        ({"start_offset_s": 400.0}, (400, 1000)),
        ({"duration_s": 450.0}, (0, 450)),
        ({"start_offset_s": 250.5, "duration_s": 350.0}, (250.5, 600.5)),
        ({"start_offset_s": 800.0, "duration_s": 900.0}, (800, 1000)),
    ],
)
def test_a_part_is_played(graph, heard, bag, options, within):
    play_all(graph, heard, bag, **options)
    assert heard.messages == times_of("/a", "/b", "/c", within=within)


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        ({"topics": ("/c", "/a")}, ("/a", "/c")),
        ({"exclude": ("/b",)}, ("/a", "/c")),
        ({"topics": ("/b", "/c"), "exclude": ("/c",)}, ("/b",)),
    ],
)
def test_topics_are_chosen(graph, heard, bag, options, topics):
    play_all(graph, heard, bag, **options)
    assert heard.messages == times_of(*topics)
    others = {"/a", "/b", "/c"} - set(topics)
    assert [graph.probe.count_publishers(topic) for topic in sorted(others)] == [0] * len(others)


@pytest.mark.parametrize("field", ["topics", "exclude"])
def test_a_topic_that_is_not_in_the_bag_is_refused(graph, bag, field):
    with pytest.raises(InputError, match="has no topic '/d'; it has /a, /b, /c"):
        Player(bag, PlayOptions(**{field: ("/a", "/d")}))


@pytest.mark.parametrize(
    ("rate", "hz", "step_s"), [(FAST, 800.0, 125.0), (FAST / 2, 800.0, 62.5), (FAST, 400.0, 250.0)]
)
def test_the_clock_ticks_by_the_wall_and_tells_recorded_time(graph, heard, bag, rate, hz, step_s):
    """So many ticks a second of the wall: recorded time between them grows with the rate."""
    play_all(graph, heard, bag, rate=rate, clock_hz=hz)
    ticks = [step_s * k for k in range(round(1000 / step_s) + 1)]
    wait_for(lambda: len(heard.ticks) >= len(ticks))
    assert heard.ticks == ticks


def test_the_clock_begins_where_playing_begins(graph, heard, bag):
    play_all(graph, heard, bag, clock_hz=1000.0, start_offset_s=350.5, duration_s=450.0)
    wait_for(lambda: len(heard.ticks) >= 5)
    assert heard.ticks == [350.5, 450.5, 550.5, 650.5, 750.5]  # the last message is of 800 s


def test_a_recorded_clock_is_played_unless_there_is_another(graph, heard, tmp_path):
    kind = "rosgraph_msgs/msg/Clock"
    recorded = interfaces.message_class(kind)()
    recorded.clock.sec = BEGIN_NS // 10**9 + 77
    bag = written_bag(tmp_path / "bag", extra=[(500, "/clock", kind, recorded)])
    with playing(graph, bag, rate=FAST) as (_, outcome):
        wait_for(lambda: outcome and heard.ticks)
    assert heard.ticks == [76.75]
    graph.nodes.pop().destroy_node()
    wait_for(lambda: graph.probe.count_publishers("/clock") == 0)
    heard.ticks.clear()
    with playing(graph, bag, rate=FAST, clock_hz=200.0) as (_, outcome):
        wait_for(lambda: outcome and len(heard.ticks) >= 3)
    assert heard.ticks == [0.0, 500.0, 1000.0]


def test_a_delay_is_of_the_wall_clock(graph, heard, bag):
    took_s = play_all(graph, heard, bag, delay_s=0.25)
    assert took_s >= 0.25
    assert heard.messages == times_of("/a", "/b", "/c")


def test_a_slow_rate_takes_its_time(graph, heard, tmp_path):
    writer = BagWriter(tmp_path / "short")
    name = "std_msgs/msg/Float64"
    writer.add_topic(Topic("/a", name), interfaces.full_text(name))
    data = interfaces.serialize(interfaces.message_class(name)(data=1.0))
    for at_ns in (BEGIN_NS, BEGIN_NS + 10**8):
        writer.write("/a", data, at_ns, at_ns)
    writer.close()
    assert play_all(graph, heard, BagReader(tmp_path / "short"), rate=0.25) >= 0.4


def test_a_loop_begins_again(graph, heard, bag):
    with playing(graph, bag, rate=FAST, loop=True, start_offset_s=350.5) as (_, outcome):
        wait_for(lambda: len(heard.by_topic["/b"]) >= 8)
        assert outcome == []
    assert outcome == [False]
    assert heard.by_topic["/b"][:8] == [500.0, 700.0, 900.0] * 2 + [500.0, 700.0]


def test_the_recorded_quality_is_offered(graph, tmp_path):
    """Each policy unlike its default; what several publishers offered is weakened to fit all."""
    unusual = OfferedQos(
        depth=7,
        reliability="best_effort",
        durability="transient_local",
        deadline_ns=1_500_000_000,
        lifespan_ns=3_250_000_000,
        liveliness="manual_by_topic",
        lease_ns=2_750_000_000,
    )
    several = [OfferedQos(depth=3, durability="transient_local"), OfferedQos(depth=8)]
    bag = written_bag(tmp_path / "bag", {"/b": [unusual], "/c": several})
    graph.add(functools.partial(Player, bag, PlayOptions()))
    (b,) = graph.probe.get_publishers_info_by_topic("/b")
    (c,) = graph.probe.get_publishers_info_by_topic("/c")
    profile = b.qos_profile
    assert profile.depth == 7
    assert profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    assert profile.deadline == Duration(nanoseconds=1_500_000_000)
    assert profile.lifespan == Duration(nanoseconds=3_250_000_000)
    assert profile.liveliness_lease_duration == Duration(nanoseconds=2_750_000_000)
    assert c.qos_profile.depth == 8
    assert c.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert c.qos_profile.durability == DurabilityPolicy.VOLATILE


# Services.


def test_nothing_is_played_before_a_paused_player_resumes(graph, heard, bag):
    with playing(graph, bag, rate=FAST, paused=True, clock_hz=1000.0) as (player, outcome):
        assert ask(graph, "pause") == (True, "")  # it may be asked again, which changes nothing
        assert (player.published, heard.count, heard.ticks, outcome) == (0, 0, [], [])
        assert ask(graph, "resume") == (True, "")
        wait_for(lambda: outcome)
        assert not player.pacer.paused
    wait_for(lambda: heard.count >= 12)
    assert heard.messages == times_of("/a", "/b", "/c")


def test_play_next_plays_one_message_and_moves_the_time(graph, heard, bag):
    with playing(graph, bag, rate=FAST, paused=True, clock_hz=1000.0) as (player, outcome):
        for count, last_s in ((1, 0.0), (2, 100.0), (3, 200.0)):
            assert ask(graph, "play_next") == (True, "")
            wait_for(lambda count=count: heard.count >= count)
            wait_for(lambda last_s=last_s: heard.ticks[-1:] == [last_s])
            assert player.published == heard.count == count
            assert player.pacer.now_ns() == BEGIN_NS + round(last_s * 1e9)
        assert player.pacer.paused and outcome == []
    assert heard.messages == {"/a": [0.0, 200.0], "/b": [100.0]}


def test_play_next_is_refused_unless_paused(graph, heard, bag):
    with playing(graph, bag, rate=SLOW) as (player, _):
        wait_for(lambda: heard.count == 1)
        assert ask(graph, "play_next") == (False, "the player is not paused")
        assert ask(graph, "pause") == (True, "")
        assert (player.published, heard.count) == (1, 1)


def test_pause_stops_the_time_and_resume_goes_on_from_there(graph, heard, bag):
    """A rate at which a pause that was not held would be seen at once."""
    rate = 500.0
    with playing(graph, bag, rate=rate) as (player, _):
        wait_for(lambda: heard.count >= 1 and player.pacer.now_ns() > BEGIN_NS)
        reached_ns = player.pacer.now_ns()
        assert ask(graph, "pause") == (True, "")
        assert player.pacer.paused
        stood_ns, published = player.pacer.now_ns(), player.published
        assert stood_ns >= reached_ns
        time.sleep(0.1)
        assert (player.pacer.now_ns(), player.published) == (stood_ns, published)
        before = time.monotonic()
        assert ask(graph, "resume") == (True, "")
        assert not player.pacer.paused
        moved_s = (player.pacer.now_ns() - stood_ns) / 1e9
        assert 0.0 < moved_s <= rate * (time.monotonic() - before)
        wait_for(lambda: player.published > published)


def test_toggling_pauses_and_resumes_in_turn(graph, heard, bag):
    with playing(graph, bag, rate=FAST, paused=True) as (player, outcome):
        assert ask(graph, "toggle_paused") == (True, "")
        assert not player.pacer.paused
        assert ask(graph, "toggle_paused") == (True, "")
        assert player.pacer.paused
        assert ask(graph, "toggle_paused") == (True, "")
        wait_for(lambda: outcome)
    wait_for(lambda: heard.count >= 12)
    assert heard.messages == times_of("/a", "/b", "/c")


def test_a_new_rate_counts_from_now_on(bag):
    from pneu_graph.bag.playback import Pacer

    pacer = Pacer(FAST)
    pacer.begin(BEGIN_NS)
    assert pacer.wait_until(BEGIN_NS + 10**12)
    pacer.set_rate(2e-3)
    changed_ns, changed_s = pacer.now_ns(), time.monotonic()
    assert changed_ns >= BEGIN_NS + 10**12
    time.sleep(0.05)
    moved_s = (pacer.now_ns() - changed_ns) / 1e9
    assert 0.05 * 2e-3 <= moved_s <= 2e-3 * (time.monotonic() - changed_s) + 1e-6


# The command line, whole: it has a context of its own, as in a process of its own.


def run_command(*words, meanwhile=None):
    """Runs `pneu bag` in this process; `meanwhile` runs beside it, and ends it as Ctrl-C does."""
    faults = []

    def beside():
        try:
            meanwhile()
        except BaseException as fault:
            faults.append(fault)
        finally:
            rclpy.try_shutdown()

    thread = threading.Thread(target=beside) if meanwhile else None
    if thread:
        thread.start()
    giving_up = threading.Timer(PATIENCE_S, rclpy.try_shutdown)
    giving_up.start()
    try:
        result = CliRunner().invoke(app, [*map(str, words)])
    finally:
        giving_up.cancel()
    if thread:
        thread.join()
    assert faults == []
    return result


def test_options_of_the_command_line(outside, bag):
    """Values of which each shows in what is heard."""
    heard = Heard(outside.create_subscription)
    result = run_command(
        "play", bag.path, "--rate", FAST, "--start-offset", 150.5, "--playback-duration", 500,
        "--clock", 1000, "--topics", "/b", "--topics", "/a", "--exclude-topics", "/b",
        "--remap", "/a:=/again/a",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    within = times_of("/a", within=(150.5, 650.5))["/a"]
    wait_for(lambda: heard.count >= len(within))
    assert heard.messages == {"/again/a": within}
    wait_for(lambda: len(heard.ticks) >= 5)
    assert heard.ticks == [150.5, 250.5, 350.5, 450.5, 550.5]


@pytest.mark.parametrize(
    ("flag", "paused"), [("--start-paused", True), ("-p", True), (None, False)]
)
def test_the_command_line_may_begin_paused(outside, bag, flag, paused):
    heard = Heard(outside.create_subscription)
    client = outside.create_client(Trigger, "/player/play_next")

    def meanwhile():
        wait_for(client.service_is_ready)
        future = client.call_async(Trigger.Request())
        wait_for(future.done)
        assert future.result().success == paused
        wait_for(lambda: heard.count >= 1)

    words = ["play", bag.path, "-r", SLOW, *([flag] if flag else [])]
    result = run_command(*words, meanwhile=meanwhile)
    assert result.exit_code == 130
    assert heard.messages == {"/a": [0.0]}


@pytest.mark.parametrize("flag", ["--delay", "-d"])
def test_the_command_line_may_wait_before_it_begins(outside, bag, flag):
    """For so long that the player is stopped before."""
    heard = Heard(outside.create_subscription)
    client = outside.create_client(Trigger, "/player/play_next")

    def meanwhile():
        wait_for(client.service_is_ready)
        wait_for(client.call_async(Trigger.Request()).done)
        time.sleep(0.1)  # without the delay the first message is heard by now

    result = run_command("play", bag.path, "-r", SLOW, flag, 1000, meanwhile=meanwhile)
    assert (result.exit_code, heard.messages) == (130, {})


@pytest.mark.parametrize("flag", ["--loop", "-l"])
def test_the_command_line_may_play_in_a_loop(outside, bag, flag):
    heard = Heard(outside.create_subscription)
    meanwhile = functools.partial(wait_for, lambda: len(heard.by_topic["/c"]) >= 3)
    result = run_command("play", bag.path, flag, "-r", FAST, meanwhile=meanwhile)
    assert result.exit_code == 130


def test_a_wrong_remap_is_refused(bag):
    result = run_command("play", bag.path, "--remap", "/a=/again/a")
    assert isinstance(result.exception, InputError)
    assert "--remap: is written old:=new, found '/a=/again/a'" in str(result.exception)
