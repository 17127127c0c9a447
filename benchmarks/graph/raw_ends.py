# SPDX-License-Identifier: Apache-2.0
"""The same ends on bare Cyclone DDS, as pip brings it: `... raw_ends raw ROLE TYPE`.

Its public interface, its own serialisation and a waitset; no nodes, executor or graph.
"""

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from benchmarks.graph.processes import orders, reply
from pneu_runtime.transport.domain import configuration, domain_id_from

JOINTS = 7
LONGEST_S = 60.0
TAKEN = 100
RELIABLE = Policy.Reliability.Reliable(duration(seconds=LONGEST_S))
NEWEST = Qos(RELIABLE, Policy.History.KeepLast(10))
ALL = Qos(RELIABLE, Policy.History.KeepAll)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class FluidPressure(IdlStruct, typename="sensor_msgs.msg.dds_.FluidPressure_"):
    header: Header = field(default_factory=lambda: Header(frame_id="end"))
    fluid_pressure: float64 = 101325.0
    variance: float64 = 0.0


def _values() -> list[float]:
    return [0.1 * joint for joint in range(JOINTS)]


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=lambda: [f"joint_{j}" for j in range(JOINTS)])
    position: sequence[float64] = field(default_factory=_values)
    velocity: sequence[float64] = field(default_factory=_values)
    effort: sequence[float64] = field(default_factory=_values)


KINDS = {"FluidPressure": FluidPressure, "JointState": JointState}


class End:
    """A participant with at most a writer and a reader."""

    def __init__(self, kind: type, writes: str = "", reads: str = "", qos: Qos = NEWEST) -> None:
        number = domain_id_from(os.environ)
        self._domain = Domain(number, configuration(os.environ))  # of the network as ours is
        self._participant = DomainParticipant(number)
        self.writer = self.reader = None
        if writes:
            topic = Topic(self._participant, f"rt/{writes}", kind)
            self.writer = DataWriter(self._participant, topic, qos)
        if reads:
            topic = Topic(self._participant, f"rt/{reads}", kind)
            self.reader = DataReader(self._participant, topic, qos)
            self._waitset = WaitSet(self._participant)
            self._condition = ReadCondition(
                self.reader, ViewState.Any | InstanceState.Any | SampleState.NotRead
            )
            self._waitset.attach(self._condition)

    def found(self) -> None:
        """Waits for the other end."""
        end = time.monotonic() + LONGEST_S
        while (self.writer and not self.writer.get_matched_subscriptions()) or (
            self.reader and not self.reader.get_matched_publications()
        ):
            if time.monotonic() > end:
                raise TimeoutError("the other end is not found")
            time.sleep(0.01)
        time.sleep(0.3)

    def samples(self, longest_s: float = LONGEST_S) -> Iterator:
        """What comes in; raises TimeoutError where nothing does."""
        while self._waitset.wait(duration(seconds=longest_s)):
            yield from self.reader.take(N=TAKEN)
        raise TimeoutError("nothing came")


def echo(kind: type) -> None:
    """Sends back what comes, with the time at which it was taken."""
    end = End(kind, "pong", "ping")
    for sample in end.samples():
        stamp = sample.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.monotonic_ns(), 1_000_000_000)
        end.writer.write(sample)


def ping(kind: type) -> None:
    """Sends the next message when the last one is back; both ways are timed."""
    end, message = End(kind, "ping", "pong"), kind()
    end.found()
    stamp = message.header.stamp
    for order in orders():
        forth, whole = [], []
        answers = end.samples()
        for _ in range(int(order["count"])):
            sent_ns = time.monotonic_ns()
            stamp.sec, stamp.nanosec = divmod(sent_ns, 1_000_000_000)
            end.writer.write(message)
            back = next(answers).header.stamp
            whole.append(time.monotonic_ns() - sent_ns)
            forth.append(back.sec * 1_000_000_000 + back.nanosec - sent_ns)
        reply(forth_ns=forth, round_ns=whole)


def source(kind: type) -> None:
    """Publishes as fast as it can; reliable with all history, so nothing may be lost."""
    end, message = End(kind, writes="stream", qos=ALL), kind()
    end.found()
    for order in orders():
        begin_ns = time.monotonic_ns()
        for _ in range(int(order["count"])):
            end.writer.write(message)
        reply(begin_ns=begin_ns, publish_ns=time.monotonic_ns() - begin_ns)


def sink(kind: type) -> None:
    """Counts what comes."""
    end = End(kind, reads="stream", qos=ALL)
    for order in orders():
        left = int(order["count"])
        for _ in end.samples():
            left -= 1
            if left == 0:
                break
        reply(end_ns=time.monotonic_ns())


if __name__ == "__main__":
    {"echo": echo, "ping": ping, "source": source, "sink": sink}[sys.argv[2]](KINDS[sys.argv[3]])
