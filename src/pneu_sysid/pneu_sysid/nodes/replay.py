# SPDX-License-Identifier: Apache-2.0
"""The replay node: a bag as if its rig were live, or its commands alone into a simulator.

What a rig file names as commands and taps is taken out of the bag and published on the rig's
topics, at the pace it was recorded times `rate`; and what its encoders read, or where a rig with
bodies has none, the states of their joints. Parameters and topics: see ``ros_ws/README.md``.
"""

import threading
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import TapPressures
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock as ClockMessage

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import velocity_of
from pneu_sysid.records.bag import read_bag, read_joints
from pneu_sysid.records.clock import choose_clock, mend_clock_jumps

MODES = ("all", "taps", "commands")

Events = list[tuple[int, list[tuple[topics.Topic, dict[str, float]]]]]
"""Per stamp, ns, what is published: the topic and SI values by name."""


def load_events(rig: Rig, bag: Path, mode: str) -> Events:
    """Takes the signals of a rig out of a bag, in order of time.

    Args:
        rig: The rig.
        bag: rosbag2 folder or .mcap file.
        mode: ``all``, ``taps`` or ``commands``.

    Returns:
        Per stamp, ns, what is published then; joints are a topic without signals of its own, whose
        values are by the names in the messages themselves.

    Raises:
        InputError: The bag cannot be read, or lacks a channel of the rig.
    """
    commands = (
        {n: c.channel for n, c in rig.commands.items() if c.channel} if mode != "taps" else {}
    )
    taps = {n: t.channel for n, t in rig.taps.items() if t.channel} if mode != "commands" else {}
    encoders = {n: topics.encoder_channel(rig, n) for n in rig.encoders if mode != "commands"}
    # Numbers are read as those of taps are; a JointState as a whole, by the names in it.
    taps |= {n: channel for n, channel in encoders.items() if channel.type != topics.JOINT_STATE}
    together = [t.name for t in topics.position_topics(rig) if t.type == topics.JOINT_STATE]
    found = {n: read_joints(bag, n) for n in together} if mode != "commands" else {}
    said = {name: told for name, (stream, told) in found.items() if stream is not None}
    if not commands and not taps and not said:
        raise InputError(f"rig {rig.name!r}: no channel says what to replay in mode {mode!r}")
    streams, _ = read_bag(bag, commands, taps)
    streams += [stream for stream, _ in found.values() if stream is not None]
    wanted = {name: channel.stamp for name, channel in {**commands, **taps}.items()}
    wanted |= dict.fromkeys(said, "auto")
    streams, _ = choose_clock(streams, wanted, str(bag))
    streams, _ = mend_clock_jumps(streams)
    topic_of = {
        signal.name: topic
        for topic in (
            *topics.command_topics(rig),
            *topics.tap_topics(rig),
            *topics.encoder_topics(rig),
        )
        for signal in topic.signals
    }
    samples = sorted(
        (int(stamp), stream.name, float(value))
        for stream in streams
        for stamp, value in zip(stream.stamp_ns, stream.values, strict=True)
    )
    if not samples:
        raise InputError(f"{bag}: it holds nothing to replay")
    events: Events = []
    for stamp, group in groupby(samples, key=lambda sample: sample[0]):
        of_topic: dict[str, tuple[topics.Topic, dict[str, float]]] = {}
        for _, name, value in group:
            if name in said:
                joints = topics.Topic(name, topics.JOINT_STATE, ())
                of_topic[name] = (joints, said[name][int(value)])
                continue
            topic = topic_of[name]
            of_topic.setdefault(topic.name, (topic, {}))[1][name] = value
        events.append((stamp, list(of_topic.values())))
    return events


@dataclass
class ReplayParameters(Parameters):
    """What the replay node is told."""

    bag: str = parameter("", "Recording: folder or .mcap file.", read_only=True)
    rig: str = parameter("", "Rig file, whose channels say what is replayed.", read_only=True)
    mode: str = parameter(
        "all",
        "What is published: taps and commands, or one of them.",
        choices=MODES,
        read_only=True,
    )
    rate: float = parameter(
        1.0, "Recorded seconds per second.", within=(0.01, 100.0), read_only=True
    )
    loop: bool = parameter(False, "Begin again at the end.")
    publish_clock: bool = parameter(
        False,
        "Publish recorded time on /clock and keep recorded stamps; else stamps are the present's.",
        read_only=True,
    )
    clock_rate_hz: float = parameter(
        250.0, "Least rate of /clock in recorded time, Hz.", within=(1.0, 5000.0), read_only=True
    )
    start_delay_s: float = parameter(
        1.0,
        "Pause before the first message, for subscribers to be found, s.",
        within=(0.0, 60.0),
        read_only=True,
    )


class ReplayNode(Node):
    """A recording on the topics of its rig."""

    def __init__(self, **options: Any) -> None:
        """Reads the bag and starts to publish it.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: A parameter, the rig file or the bag is wrong, or somebody else publishes
                the clock.
        """
        super().__init__("replay", **options)
        self.done: Future = Future()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        p = self._params = ReplayParameters.declare(self)
        for name, value in (("bag", p.bag), ("rig", p.rig)):
            if not value:
                raise InputError(f"parameter {name}: found nothing, it must be a path")
        if common.other_clocks(self, wait=True):
            raise InputError(
                "/clock already has a publisher; a recording beside it would mix two times"
            )
        rig = load_rig(p.rig)
        self._name = Path(p.bag).name
        self._events = load_events(rig, Path(p.bag), p.mode)
        self._position = 0
        self._clock_publisher: Any = None
        if p.publish_clock:
            self._clock_publisher = self.create_publisher(
                ClockMessage, common.CLOCK_TOPIC, common.COMMAND_QOS
            )
        taps = {t.name for t in topics.tap_topics(rig)}
        readings = taps | {t.name for t in topics.position_topics(rig)}
        self._taps = {t for t in taps if p.mode != "commands"}
        used = {topic.name: topic for _, group in self._events for topic, _ in group}
        self._publishers_of = {
            name: self.create_publisher(
                topics.message_class(topic.type),
                name,
                common.READINGS_QOS if name in readings else common.COMMAND_QOS,
            )
            for name, topic in used.items()
        }
        self._set_publisher: Any = None
        if self._taps:
            self._set_publisher = self.create_publisher(
                TapPressures, topics.TAPS_TOPIC, common.READINGS_QOS
            )
        self._rig = rig
        self._diagnostics = common.Diagnostics(self, self._report)
        self.get_logger().info(f"{p.mode} of {p.bag}, {self._length_s():.3g} s")
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)
        self._thread.start()

    def destroy_node(self) -> None:
        """Ends the replay, then the node."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        super().destroy_node()

    def _length_s(self) -> float:
        return (self._events[-1][0] - self._events[0][0]) * 1e-9

    def _report(self) -> list[DiagnosticStatus]:
        at_s = (self._events[self._position][0] - self._events[0][0]) * 1e-9
        values = {"position (s)": at_s, "length (s)": self._length_s()}
        level, text = DiagnosticStatus.OK, f"at {at_s:.2f} of {self._length_s():.2f} s"
        if common.other_clocks(self, own=int(self._clock_publisher is not None)):
            level, text = DiagnosticStatus.ERROR, "/clock has another publisher"
        return [common.status(level, f"{self.get_name()}: replay", text, values, self._name)]

    def _run(self) -> None:
        try:
            self._ended.wait(self._params.start_delay_s)
            while self._once() and self._params.loop:
                continue
            self.done.set_result(None)
        except Exception:
            # Publishing fails when the context goes down under it, which is an ordinary end.
            if self.context.ok() and not self._ended.is_set():
                raise

    def _once(self) -> bool:
        """Plays the bag; returns whether it came to the end."""
        first = self._events[0][0]
        clock = common.steady_clock()
        began = clock.now().nanoseconds
        shift = 0
        if self._clock_publisher is None:
            shift = self.get_clock().now().nanoseconds - first
        tick = round(1e9 / self._params.clock_rate_hz)
        told = first
        for position, (stamp, group) in enumerate(self._events):
            self._position = position
            between = range(told + tick, stamp, tick) if self._clock_publisher else ()
            for due in (*between, stamp):
                while (
                    left := (due - first) / self._params.rate - (clock.now().nanoseconds - began)
                ) > 0 and not self._ended.is_set():
                    self._ended.wait(left * 1e-9)
                if self._ended.is_set() or not self.context.ok():
                    return False
                if self._clock_publisher is not None:
                    self._clock_publisher.publish(ClockMessage(clock=common.to_stamp(due)))
            told = stamp
            self._publish(group, common.to_stamp(stamp + round(shift)))
        return True

    def _publish(self, group: list[tuple[topics.Topic, dict[str, float]]], stamp: Any) -> None:
        together: dict[str, float] = {}
        for topic, values in group:
            if topic.type == topics.JOINT_STATE and not topic.signals:
                message = self._joint_states(values, stamp)
            else:
                message = topic.message(values, stamp)
            if message is not None:
                self._publishers_of[topic.name].publish(message)
            if topic.name in self._taps:
                together.update(values)
        if together:
            readings = [together.get(name, np.nan) for name in self._rig.taps]
            message = TapPressures(name=list(self._rig.taps), pressure_pa=readings)
            message.header.stamp = stamp
            message.header.frame_id = self._rig.name
            self._set_publisher.publish(message)

    def _joint_states(self, values: dict[str, float], stamp: Any) -> Any:
        """The message of joints again, with the present stamp."""
        speeds = {n: values[velocity_of(n)] for n in values if velocity_of(n) in values}
        of_speeds = {velocity_of(name) for name in speeds}
        positions = {name: value for name, value in values.items() if name not in of_speeds}
        return topics.joint_states(positions, speeds, stamp, self._rig.name)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(ReplayNode, args)


if __name__ == "__main__":
    main()
