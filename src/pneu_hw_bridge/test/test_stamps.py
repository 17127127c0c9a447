# SPDX-License-Identifier: Apache-2.0
"""The time of everything written and read, by clocks and a device that take exactly known times.

The steady clock, the clock of the stamps and the exchange all differ, so that none can stand for
another.
"""

import math
from types import SimpleNamespace

import pytest

from pneu_hw_bridge.device_clock import SETTLE_READS
from pneu_hw_bridge.link import MOST_WAITING, Link
from pneu_hw_bridge.modbus import reading, writing
from pneu_hw_bridge.modbus.client import RequestError
from pneu_hw_bridge.modbus.reading import Reader
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.modbus.writing import KEEP_ALIVE_S, Writer
from pneu_hw_bridge.registers.load import load_register_map, parse_register_map
from pneu_hw_bridge.safety.limits import Limits, OutputLimits, SensorLimits, limits_of
from pneu_hw_bridge.safety.motion import EncoderLimits
from pneu_hw_bridge.safety.supervisor import State, Supervisor

pytestmark = pytest.mark.kernel_free

MAP = parse_register_map(
    """
pneu_registers: 1
name: two
device: {watchdog_s: 0.125}
channels:
  a: {direction: write, table: holding, address: 0, type: float32, range: [0, 10], safe: 1}
  b: {direction: write, table: holding, address: 20, type: float32, range: [0, 10], safe: 2}
  p: {direction: read, table: input, address: 0, type: float32, unit: Pa, range: [0, 1.0e6]}
  q: {direction: read, table: holding, address: 60, type: float32, unit: Pa, range: [0, 1.0e6]}
""",
    "two.yaml",
)
SAFE, OPEN = {"a": 1.0, "b": 2.0}, {"a": 5.0, "b": 6.0}
BEGUN_S, BEGUN_NS = 1000.0, 7_000_000_000


class Bench:
    """A device that answers each request after a time, and who is told of it."""

    def __init__(self, monkeypatch):
        self.now_s, self.ahead_ns, self.takes_s = BEGUN_S, 0, 0.0
        self.volts, self.told, self.read_at = OPEN, [], []
        self.asked, self.lost, self.usable = [], None, True
        clock = SimpleNamespace(monotonic=lambda: self.now_s)
        monkeypatch.setattr(writing, "time", clock)
        monkeypatch.setattr(reading, "time", clock)
        self.statistics = Statistics()

    def clock_ns(self):
        return BEGUN_NS + round(1e9 * (self.now_s - BEGUN_S)) + self.ahead_ns

    # The device

    async def write(self, table, address, raw):
        self.now_s += self.takes_s
        if self.lost is not None:
            raise self.lost
        self.asked.append((address, raw))

    async def read(self, batch):
        self.now_s += self.takes_s
        self.asked.append((batch.address, batch.count))
        return [0] * batch.count

    # The owner

    def output(self, now_s):
        return self.volts

    def written(self, values, stamp_ns):
        self.told.append((values, stamp_ns))

    def readings(self, values, steady_s, stamp_ns):
        self.read_at.append((steady_s, stamp_ns))

    def writer(self, device_tells=False):
        return Writer(MAP, self, self.statistics, self.clock_ns, device_tells)

    def reader(self):
        return Reader(MAP, self, self.statistics, self.clock_ns)


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def now(coroutine):
    """Runs what never waits."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


LONG_S = 0.01
"""Of each of two requests: beyond that it is not known when it was."""


@pytest.mark.parametrize("takes_s", [0.0, 0.004, 0.00999])
def test_what_was_written_acts_from_the_middle_of_the_exchange(bench, takes_s):
    bench.takes_s = takes_s
    now(bench.writer().write(bench, force=True))
    assert bench.told == [(OPEN, pytest.approx(BEGUN_NS + 1e9 * takes_s, abs=2))]


def test_what_was_held_up_acts_from_its_end(bench):
    bench.takes_s = 0.02
    now(bench.writer().write(bench, force=True))
    assert bench.told == [(OPEN, pytest.approx(BEGUN_NS + 4e7, abs=2))]


def test_what_the_device_tells_itself_is_not_told_twice(bench):
    now(bench.writer(device_tells=True).write(bench, force=True))
    assert bench.told == []


@pytest.mark.parametrize(
    ("alone_s", "ahead_s"), [(0.125, 0.0), (0.5, 0.0), (0.5, 3600.0), (0.5, -3600.0)]
)
def test_a_device_that_was_left_alone_had_vented_after_its_watchdog(bench, alone_s, ahead_s):
    """How long it was alone, the steady clock says: the other one may have been set."""
    bench.takes_s = 0.00390625
    writer = bench.writer()
    now(writer.write(bench, force=True))
    first_ns = bench.told.pop()[1]
    bench.ahead_ns = round(1e9 * ahead_s)
    bench.now_s = BEGUN_S + alone_s  # both exchanges take as long, so this is between their middles
    now(writer.write(bench, force=True))
    confirmed_ns = first_ns + round(1e9 * (alone_s + ahead_s))
    vented = (SAFE, confirmed_ns - round(1e9 * (alone_s - 0.125)))
    assert bench.told == [*([vented] if alone_s > 0.125 else []), (OPEN, confirmed_ns)]


def test_an_unchanged_voltage_is_due_from_when_its_write_began(bench):
    bench.takes_s = 0.003
    writer = bench.writer()
    assert writer.due_s() == -math.inf
    now(writer.write(bench, force=True))
    assert writer.due_s() == BEGUN_S + KEEP_ALIVE_S
    bench.now_s = math.nextafter(BEGUN_S + KEEP_ALIVE_S, 0.0)
    now(writer.write(bench, force=False))
    assert len(bench.told) == 1
    bench.now_s = BEGUN_S + KEEP_ALIVE_S
    now(writer.write(bench, force=False))
    assert len(bench.told) == 2
    bench.volts = {**OPEN, "b": 3.0}
    now(writer.write(bench, force=False))
    assert bench.told[-1][0] == {"a": 5.0, "b": 3.0}, "a change at once"
    writer.renew()
    assert writer.due_s() == -math.inf
    now(writer.send_safe(bench))
    assert writer.due_s() == bench.now_s + KEEP_ALIVE_S and writer.is_safe


@pytest.mark.parametrize("name", ["a", "b"])
def test_a_voltage_that_no_register_holds_becomes_the_safe_one(bench, name):
    bench.volts = {**OPEN, name: 1e39}
    now(bench.writer().write(bench, force=True))
    held = {**OPEN, name: SAFE[name]}
    words = {1.0: [0x3F80, 0], 2.0: [0x4000, 0], 5.0: [0x40A0, 0], 6.0: [0x40C0, 0]}
    assert bench.asked == [(0, words[held["a"]]), (20, words[held["b"]])]
    assert bench.told == [(held, BEGUN_NS)]
    assert bench.statistics.unwritable == 1


def test_a_line_that_is_lost_in_a_vent_is_asked_nothing_more(bench):
    bench.lost = RequestError("write of 2 at holding 0: connection lost")
    bench.usable = False
    with pytest.raises(StopIteration) as ended:
        bench.writer().vent(bench).send(None)
    says = "read back a write of 2 at holding 0: connection lost, b write of 2 at holding 0: conn"
    assert ended.value.value == (False, says + "ection lost", bench.lost)
    assert bench.asked == [] and bench.told == []


def test_a_line_that_goes_on_after_a_write_without_answer_is_read_back_in_a_vent(bench):
    """It may have been taken all the same; who connects anew knows less."""
    bench.lost = RequestError("write of 2 at holding 0: no answer within 0.1 s")
    with pytest.raises(StopIteration) as ended:
        bench.writer().vent(bench).send(None)
    assert ended.value.value == (False, "read back a 0 V, b 0 V", bench.lost)
    assert bench.asked == [(0, 2), (20, 2)] and bench.told == []


@pytest.mark.parametrize("takes_s", [0.0, 0.004, 0.00999])
def test_what_was_read_is_of_the_middle_of_the_exchange(bench, takes_s):
    bench.takes_s = takes_s
    now(bench.reader().read(bench))
    ((steady_s, stamp_ns),) = bench.read_at
    assert steady_s == pytest.approx(BEGUN_S + takes_s, abs=1e-9)
    assert stamp_ns == pytest.approx(BEGUN_NS + 1e9 * takes_s, abs=2)
    assert bench.statistics.unclear == 0


def test_a_reading_that_was_held_up_counts_as_an_old_one_and_has_no_stamp(bench):
    bench.takes_s = 0.02
    now(bench.reader().read(bench))
    assert bench.read_at == [(BEGUN_S, None)]
    assert bench.statistics.unclear == 1


@pytest.mark.parametrize(
    ("reply_s", "requests", "most_s"),
    [(0.001, 1, LONG_S), (0.0025, 1, LONG_S), (0.005, 1, 0.02), (0.001, 3, 3 * LONG_S)],
)
def test_an_exchange_tells_when_it_was_unless_it_was_far_longer_than_usual(
    reply_s, requests, most_s
):
    statistics = Statistics()
    assert statistics.tells_when(requests * LONG_S, requests), "before anything was answered"
    for share in (0.5, 1.0, 2.0):
        statistics.reply.add(share * reply_s)  # whose median is the middle one
    assert statistics.tells_when(most_s, requests)
    assert not statistics.tells_when(math.nextafter(most_s, 1.0), requests)


# A device with a clock

CLOCKED_TEXT = """
pneu_registers: 1
name: clocked
device: {watchdog_s: 0.125}
channels:
  a: {direction: write, table: holding, address: 0, type: float32, range: [0, 10], safe: 1}
  p: {direction: read, table: input, address: 6, type: uint16, unit: Pa, range: [0, 1.0e6]}
clock:
  samples:
    counter: {address: 0}
    time: {address: 2, type: uint64, tick_s: 1.0e-9}
    records: 2
    stride: 8
  commands:
    counter: {address: 40}
    time: {address: 42, tick_s: 1.0e-6}
    values: {a: 44}
"""
CLOCKED = parse_register_map(CLOCKED_TEXT, "clocked.yaml")


class Clocked:
    """A device with a clock, which keeps two samples and one command, and who reads it."""

    def __init__(self, bench, text=CLOCKED_TEXT):
        self.bench, self.sample, self.command, self.asked = bench, 0, 0, []
        self.volts = 0
        bench.read = self.read
        registers = parse_register_map(text, "clocked.yaml")
        self.reader = Reader(registers, bench, bench.statistics, bench.clock_ns)

    async def read(self, batch):
        self.asked.append((batch.address, batch.count))
        words = [0] * 48
        for place in range(2):
            at, number = 8 * place, max(self.sample - place, 0)
            ticks = PERIOD_NS * number
            words[at : at + 2] = [0, number]
            words[at + 2 : at + 7] = [0, 0, ticks >> 16, ticks & 0xFFFF, 7 + number]
        words[40:46] = [0, self.command, 0, 1000 * self.command, self.volts, 0]
        return words[batch.address : batch.address + batch.count]

    def read_by_us(self):
        now(self.reader.read(self.bench))

    def run(self, times):
        """Takes as many samples, each of which is read; returns how many have no stamp."""
        begun = len(self.bench.read_at)
        for _ in range(times):
            self.sample += 1
            self.bench.now_s += 1e-9 * PERIOD_NS
            self.read_by_us()
        return [stamp_ns for _, stamp_ns in self.bench.read_at[begun:]].count(None)


PERIOD_NS = 16_000_000
"""With which samples are taken; twenty take longer than clocks are compared for."""
SETTLED = SETTLE_READS - 1
"""Samples without a stamp, until clocks were compared."""


@pytest.mark.parametrize(
    ("batching", "old", "new", "asked"),
    [
        ("{}", "", "", [(0, 15), (40, 6)]),
        ("{max_gap: 25}", "", "", [(0, 46)]),
        ("{max_gap: 24}", "", "", [(0, 15), (40, 6)]),
        ("{max_gap: 25, max_registers: 46}", "", "", [(0, 46)]),
        ("{max_gap: 25, max_registers: 45}", "", "", [(0, 15), (40, 6)]),
        ("{max_gap: 25}", "{address: 4", "{table: holding, address: 4", [(0, 15), (40, 6)]),
        ("{}", "  commands:" + CLOCKED_TEXT.partition("  commands:")[2], "", [(0, 15)]),
    ],
)
def test_records_are_read_with_as_few_requests_as_hold_them(bench, batching, old, new, asked):
    assert old in CLOCKED_TEXT
    text = (CLOCKED_TEXT.replace(old, new) if old else CLOCKED_TEXT) + f"batching: {batching}\n"
    device, tells = Clocked(bench, text), "commands:" in text
    assert device.reader.device_tells == tells
    device.command, device.volts = 1, 0x40A0
    assert device.run(SETTLED + 2) == SETTLED
    assert device.asked == asked * (SETTLED + 2)
    assert device.reader.requests == len(asked)
    assert [values for values, _ in bench.told] == ([{"a": 5.0}] if tells else [])


def test_clocks_are_compared_again_on_a_new_connection_but_not_begun_again(bench):
    """Else a line that is often lost would never have a stamp."""
    device = Clocked(bench)
    assert device.run(SETTLED - 4) == SETTLED - 4
    device.reader.begin()
    assert device.run(10) == 4
    device.reader.begin()
    assert device.run(SETTLED + 10) == SETTLED
    assert device.reader.clock.restarts == 0


@pytest.mark.parametrize("tells", [True, False])
def test_of_a_device_that_begins_anew_nothing_old_is_told(bench, tells):
    """Its commands are numbered anew as well, and what waited for a stamp has none."""
    device = Clocked(bench, CLOCKED_TEXT if tells else CLOCKED_TEXT.partition("  commands:")[0])
    device.command, device.volts = 3, 0x40A0
    assert device.run(5) == 5
    device.sample, device.command, device.volts = 1, 9, 0x40C0
    device.read_by_us()
    assert list(device.reader.clock.told) == ["the device's counter went back"]
    assert device.run(SETTLED) == SETTLED - 1
    assert [values for values, _ in bench.told] == ([{"a": 6.0}] if tells else [])
    assert bench.statistics.commands_skipped == 0


def test_samples_and_commands_that_were_lost_are_counted_apart(bench):
    """Two samples are kept and one command; a read comes after 1, 0, 5 and 2 samples more."""
    device = Clocked(bench)
    counts = []
    for samples, commands in ((1, 1), (0, 0), (5, 3), (2, 1)):
        device.sample += samples
        device.command += commands
        device.read_by_us()
        of = bench.statistics
        skipped = of.samples_skipped, of.commands_skipped
        counts.append((of.samples, of.reads_without_news, *skipped))
    assert counts == [(1, 0, 0, 0), (1, 1, 0, 0), (3, 1, 3, 2), (5, 1, 3, 2)]


# From the bus to the supervisor

LIMITS = Limits(
    outputs={"a": OutputLimits(0.0, 10.0, 1.0)},
    sensors={"p": SensorLimits(0.0, 1e6)},
    encoders={
        "hip": EncoderLimits((-9.0, 9.0)),
        "elbow": EncoderLimits((-9.0, 9.0), impossible=16.0),
    },
)


@pytest.mark.parametrize(
    ("device_time", "between_ns", "jumps"),
    [
        (True, 125_000_000, False),  # 16/s for 125 ms are 2 and more
        (True, 1_000_000, True),
        (False, 125_000_000, True),
        (False, 1_000_000, True),
        (True, None, False),  # of no known time
        (False, None, False),
    ],
)
def test_readings_are_told_apart_by_the_devices_time_where_it_has_one(
    device_time, between_ns, jumps
):
    one = Supervisor(LIMITS)
    notified = []
    link = Link(one, lambda: notified.append(1), device_time=device_time)
    stamps = (BEGUN_NS, None if between_ns is None else BEGUN_NS + between_ns)
    for place, steady_s, stamp_ns in ((0.0, 64.0, stamps[0]), (1.5, 64.002, stamps[1])):
        values = {"hip": 0.5, "elbow": place, "p": 1e5, "other": 3.0}
        link.readings(values, steady_s, stamp_ns)
    assert bool(one.latches.trip) is jumps
    known = [stamp_ns for stamp_ns in stamps if stamp_ns is not None]
    assert [(sample.stamp_ns, sample.values["elbow"]) for sample in link.take()] == list(
        zip(known, (0.0, 1.5), strict=False)
    )
    assert len(notified) == len(known)
    one.enable()
    assert not any("p" in reason.split() for reason in one.reasons(64.102))
    assert "sensor p: stale for 0.11 s" in one.reasons(64.112)


def test_what_the_bus_hands_over_is_taken_once():
    notified = []
    link = Link(Supervisor(LIMITS), lambda: notified.append(1), every=4)
    for number in range(9):
        link.readings({"other": float(number)}, 64.0 + number, BEGUN_NS + number)
    assert len(notified) == 2
    assert [(one.stamp_ns, one.values) for one in link.take()] == [
        (BEGUN_NS + 3, {"other": 3.0}),
        (BEGUN_NS + 7, {"other": 7.0}),
    ]
    link.written({"a": 5.0}, BEGUN_NS)
    link.written({"a": 4.0}, BEGUN_NS + 3)
    assert len(notified) == 4
    assert [(one.stamp_ns, one.values["a"]) for one in link.take_applied()] == [
        (BEGUN_NS, 5.0),
        (BEGUN_NS + 3, 4.0),
    ]
    assert link.take() == link.take_applied() == []
    assert link.report().dropped == 0
    for number in range(MOST_WAITING + 2):
        link.written({"a": float(number)}, BEGUN_NS)
    assert link.report().dropped == 2
    assert link.take_applied()[0].values == {"a": 2.0}
    for number in range(4 * MOST_WAITING + 10):
        link.readings({"other": float(number)}, 64.0, BEGUN_NS)
    assert link.report().dropped == 4
    assert link.take()[0].values == {"other": 10.0}


def test_a_reading_that_lacks_a_sensor_counts_for_the_others():
    one = Supervisor(LIMITS)
    link = Link(one, lambda: None)
    one.enable()
    for steady_s, values in ((64.0, {"p": 1e5, "hip": 0.5, "elbow": 0.0}), (70.0, {"hip": 0.5})):
        link.readings(values, steady_s, BEGUN_NS)
    stale = [reason.split(":")[0] for reason in one.reasons(70.0) if "stale" in reason]
    assert stale == ["sensor p", "encoder elbow"]


def test_changes_of_state_are_told_once_each_with_its_reason():
    link = Link(Supervisor(LIMITS), lambda: None)
    link.bus("no connection to lab:502")
    link.bus("no connection to lab:502")
    link.e_stop("the door is open")
    link.output(64.0)
    link.malformed()
    link.malformed()
    assert link.take_changes() == [
        (State.DISABLED, "not active"),
        (State.E_STOP, "e-stop: the door is open"),
    ]
    assert link.take_changes() == []
    assert link.report().counters["unknown"] == 2


def test_a_command_counts_from_when_it_was_sent(monkeypatch):
    registers = load_register_map("generic_plc")
    one = Supervisor(limits_of(registers))
    link = Link(one, lambda: None)
    monkeypatch.setattr("pneu_hw_bridge.link.time", SimpleNamespace(monotonic=lambda: 64.0))
    link.bus("")
    link.publishers(1)
    link.enable(True)
    link.readings(dict.fromkeys(registers.taps, 3e5), 64.0, BEGUN_NS)
    for sent_s, age_s in ((63.9375, 0.0625), (None, 0.0)):
        assert link.command({"voltage": 5.0}, sent_s) == ""
        left_s = 0.1 - age_s
        assert one.state(64.0 + left_s - 1e-6) is State.FOLLOWING
        assert one.reasons(64.0 + left_s + 1e-6)[-1] == "command voltage: none for 0.10 s"
    assert link.command({"voltage": 5.0}, 63.875) == ""
    assert link.report().reason == "command voltage: none for 0.12 s"
