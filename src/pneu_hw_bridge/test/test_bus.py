# SPDX-License-Identifier: Apache-2.0
"""The Modbus bus against a real pymodbus server, a serial line of pseudo terminals, and garbage."""

import asyncio
import os
import random
import socket
import struct
import threading
import time
from contextlib import suppress
from itertools import pairwise

import pytest
from pymodbus.constants import ExcCodes
from tests.measured import MachineStalledError, waited_s
from tests.modbus_devices import PRESSURES, Owner, open_bus, rival, serial_bus

from pneu_common.errors import InputError
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.modbus.client import Client
from pneu_hw_bridge.registers.load import load_register_map

pytestmark = pytest.mark.realtime


def test_reads_and_writes(server, wait_until):
    owner = Owner()
    before_ns = time.time_ns()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 20)
        owner.volts = {"voltage": 7.5}
        bus.poke()
        wait_until(lambda: server.written and server.written[-1][1] == 7.5)
    values, steady_s, stamp_ns = owner.samples[-1]
    assert list(values.values()) == PRESSURES
    assert before_ns < stamp_ns < time.time_ns()
    assert steady_s < time.monotonic()
    assert owner.faults == [""]
    assert set(server.reads) == {(4, 0, 10), (3, 100, 2)}, "all taps come in one request"
    taps = sum(function == 4 for function, _, _ in server.reads)
    assert len(server.reads) - taps < 0.5 * taps, "outputs are read back less often"


def test_command_rate_and_latency(server, wait_until):
    """500 commands a second, each seen in the register."""
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples)
        begun = next_s = time.monotonic()
        waited = waited_s(os.getpid())
        cycles = len(owner.samples)
        sent = {}
        for i in range(500):
            next_s += 0.002
            time.sleep(max(next_s - time.monotonic(), 0.0))
            volts = 1.0 + i / 64.0  # exact in float32
            sent[volts] = time.monotonic()
            owner.volts = {"voltage": volts}
            bus.poke()
        wait_until(lambda: server.written[-1][1] == volts)
        took = time.monotonic() - begun
        waited = waited_s(os.getpid()) - waited
        cycles = len(owner.samples) - cycles
    latencies = sorted(t - sent[v] for t, v in server.written if v in sent)
    if cycles <= 250.0 * took and cycles > 250.0 * (took - waited):
        raise MachineStalledError(f"a thread waited {waited:.2f} of {took:.2f} s for a processor")
    assert cycles > 250.0 * took
    assert len(latencies) > 300
    assert latencies[len(latencies) // 2] < 0.01


def test_vent_is_written_and_read_back(server, wait_until):
    owner = Owner()
    owner.volts = {"voltage": 7.5}
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: server.written and server.written[-1][1] == 7.5)
        owner.volts = {"voltage": 0.0}
        vented = bus.vent()
    assert vented.verified, vented.message
    assert vented.duration_s < 0.1
    assert server.written[-1][1] == 0.0
    assert (3, 100, 2) in server.reads


def test_vent_on_a_dead_bus_returns_in_time_and_says_so(server, wait_until):
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples)
        server.close()
        wait_until(lambda: bus.fault)
        begun, failures = time.monotonic(), bus.statistics.connect_failures
        vented = bus.vent(0.14)
        assert time.monotonic() - begun < 0.4
        assert not vented.verified
        assert bus.statistics.connect_failures - failures < 20, "it must not hammer"
        server.open()


def test_a_lost_connection_is_noticed_at_once_and_comes_back(server, wait_until):
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples)
        server.close()
        assert wait_until(lambda: owner.faults[-1]) < 0.15
        time.sleep(1.0)
        server.open()
        assert wait_until(lambda: owner.faults[-1] == "", 3.0) < 1.5
        assert bus.statistics.losses >= 1
        assert bus.statistics.connects == 2
        assert bus.statistics.connect_failures < 20, "it must not hammer"


def test_exception_replies_keep_the_connection(server, wait_until):
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples)
        server.refuse = ExcCodes.DEVICE_FAILURE
        wait_until(lambda: "exception reply 4" in owner.faults[-1])
        count = len(owner.samples)
        time.sleep(0.05)
        assert len(owner.samples) <= count + 1
        server.refuse = None
        wait_until(lambda: owner.faults[-1] == "")
        assert bus.statistics.exceptions > 0
        assert bus.statistics.connects == 1


def test_a_slow_device_is_given_up_in_time(server, wait_until):
    owner = Owner()
    with open_bus(server.port, owner, timeout_s=0.05) as bus:
        wait_until(lambda: owner.samples)
        server.delay_s = 0.2
        assert wait_until(lambda: "no answer within" in owner.faults[-1]) < 0.2
        server.delay_s = 0.0
        wait_until(lambda: owner.faults[-1] == "", 3.0)
        assert bus.statistics.timeouts >= 1


def test_nothing_there(tmp_path, wait_until):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        owner = Owner()
        with open_bus(free.getsockname()[1], owner) as bus:
            wait_until(lambda: owner.faults)
            time.sleep(0.5)
    assert "no connection to 127.0.0.1" in owner.faults[-1]
    assert 2 <= bus.statistics.connect_failures < 10


def test_a_vent_that_waits_for_a_connection_ends_with_the_bus(wait_until):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        owner, vented = Owner(), []
        with open_bus(free.getsockname()[1], owner) as bus:
            wait_until(lambda: owner.faults)
            thread = threading.Thread(target=lambda: vented.append(bus.vent(50.0)), daemon=True)
            thread.start()
            wait_until(lambda: bus._vent is not None)
        thread.join(10.0)
    assert (vented[0].verified, vented[0].message) == (False, "the bus was closed")
    assert 0.0 < vented[0].duration_s < 10.0
    bus.poke()  # which a bus that is closed takes for nothing
    assert bus.vent().message == "the bus is not open"


def test_a_failure_of_the_thread_is_told(server, wait_until, monkeypatch):
    """Nothing is written from then on."""
    owner, raised = Owner(), []
    monkeypatch.setattr(threading, "excepthook", lambda told: raised.append(told.exc_type))
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples)
        owner.volts = None
        wait_until(lambda: owner.faults[-1])
        assert owner.faults == [
            "",
            "the thread of the bus failed: TypeError: 'NoneType' object is not iterable",
        ]
        wait_until(lambda: not bus._thread.is_alive())
        assert raised == [TypeError]  # whose traceback is shown
        assert bus._loop.is_closed()
        assert bus.vent().message == "the bus is not open"
        bus.poke()


def test_what_comes_before_there_is_a_wait_is_not_waited_for():
    bus = ModbusBus(load_register_map("generic_plc"), Owner())
    asked = iter([False, True, True])
    begun_s = time.monotonic()
    bus._loop.run_until_complete(bus._until(begun_s + 60.0, only=lambda: next(asked)))
    assert time.monotonic() - begun_s < 30.0
    bus.stop()


@pytest.mark.parametrize("options", [{"timeout_s": 0.0}, {"timeout_s": 0.3}, {"period_s": 0.0}])
def test_unsafe_settings_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        ModbusBus(load_register_map("generic_plc"), Owner(), **options)


# Several valves

TWO_VALVES = """
pneu_registers: 1
name: two_valves
description: Two valves whose registers are apart.
device: {transport: tcp, host: 127.0.0.1, port: PORT, unit: 1, watchdog_s: 0.1}
channels:
  left: {direction: write, table: holding, address: 100, type: float32, unit: V, range: [0, 10],
         safe: 0.0}
  right: {direction: write, table: holding, address: 110, type: float32, unit: V, range: [0, 10],
          safe: 5.0}
  end: {direction: read, table: input, address: 0, type: float32, unit: Pa, range: [1.0e4, 1.6e6]}
"""
SAFE = {100: 0.0, 110: 5.0}


@pytest.fixture
def two_valves(server, tmp_path):
    """A bus that drives two valves, its owner, and the device."""
    path = tmp_path / "two_valves.yaml"
    path.write_text(TWO_VALVES.replace("PORT", str(server.port)))
    owner = Owner()
    owner.volts = {"left": 6.5, "right": 6.5}
    bus = ModbusBus(load_register_map(str(path)), owner)
    bus.start()
    yield bus, owner, server
    bus.stop()


@pytest.mark.parametrize("how", ["refused", "mute"])
@pytest.mark.parametrize("bad", [100, 110])
def test_each_valve_is_made_safe_whatever_becomes_of_the_others(two_valves, wait_until, bad, how):
    bus, owner, server = two_valves
    good = 210 - bad
    wait_until(lambda: server.volts == {100: 6.5, 110: 6.5} and owner.faults)
    getattr(server, how).add(bad)
    # One that is not in our hands has the other made safe, though its owner has not said so yet.
    wait_until(lambda: server.volts[good] == SAFE[good], 1.0)
    assert owner.faults[-1] or wait_until(lambda: owner.faults[-1], 1.0)
    assert not bus.vent().verified
    owner.volts = {"left": 0.0, "right": 5.0}
    begun = len(server.written)
    wait_until(lambda: len(server.written) > begun + 1)
    assert {volts for _, volts in server.written[begun:]} == {SAFE[good]}
    assert owner.applied[-1][0][{100: "right", 110: "left"}[bad]] == SAFE[good]
    getattr(server, how).clear()
    wait_until(lambda: server.volts == SAFE, 3.0)
    wait_until(lambda: owner.faults[-1] == "", 3.0)
    assert bus.vent().verified


@pytest.mark.parametrize("step_s", [5.0, -5.0])
def test_a_clock_that_is_set_puts_no_safe_voltages_into_the_record(
    server, tmp_path, wait_until, step_s
):
    """They were written all the time, though by the clock of the day nothing was for 5 s."""
    path = tmp_path / "two_valves.yaml"
    path.write_text(TWO_VALVES.replace("PORT", str(server.port)))
    owner, ahead_ns = Owner(), [0]
    owner.volts = {"left": 6.5, "right": 6.5}
    bus = ModbusBus(
        load_register_map(str(path)), owner, clock_ns=lambda: time.time_ns() + ahead_ns[0]
    )
    bus.start()
    try:
        wait_until(lambda: len(owner.applied) > 5)
        begun = len(owner.applied)
        ahead_ns[0] = round(1e9 * step_s)
        wait_until(lambda: len(owner.applied) > begun + 10)
        longest_s = bus.statistics.request.quantile(1.0)
    finally:
        bus.stop()
    if longest_s < 0.05:  # else the machine stood still, and the device had vented
        assert all(values == owner.volts for values, _ in owner.applied[begun:])


def test_venting_says_which_valve_is_not_safe(two_valves, wait_until):
    bus, _, server = two_valves
    wait_until(lambda: server.volts == {100: 6.5, 110: 6.5})
    server.refused.add(100)
    vented = bus.vent()
    assert not vented.verified
    assert "left 6.5 V" in vented.message
    assert "right 5 V" in vented.message
    assert server.volts == {100: 6.5, 110: 5.0}


def test_a_device_whose_watchdog_acted_is_set_up_again(server, tmp_path, wait_until):
    """It refuses outputs until then, as real couplers do."""
    path = tmp_path / "coupler.yaml"
    text = TWO_VALVES.replace("PORT", str(server.port))
    path.write_text(text + "settings:\n- {table: holding, address: 104, type: float32, value: 3}\n")
    owner = Owner()
    owner.volts = {"left": 6.5, "right": 6.5}
    bus = ModbusBus(load_register_map(str(path)), owner)
    bus.start()
    try:
        wait_until(lambda: server.volts == {100: 6.5, 110: 6.5, 104: 3.0} and owner.faults)
        del server.volts[104]
        server.refused |= {100, 110}
        server.set_up_at = 104
        wait_until(lambda: owner.faults[-1] == "" and not server.refused, 2.0)
        assert any("exception reply 4" in fault for fault in owner.faults)
        assert bus.statistics.connects == 1 + bus.statistics.losses
        assert 2 <= bus.statistics.settings < 6
    finally:
        bus.stop()


def test_another_master_is_noticed_told_of_and_outvoted(server, wait_until):
    """It writes 9 V every 5 ms to a valve that is to be safe."""
    owner = Owner()
    over = threading.Event()

    with open_bus(server.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 5)
        thread = threading.Thread(target=lambda: asyncio.run(rival(server.port, over)), daemon=True)
        thread.start()
        wait_until(lambda: "somebody else writes" in owner.faults[-1], 2.0)
        assert "voltage reads back 9 V where 0 V was written" in owner.faults[-1]
        begun = len(server.written)
        time.sleep(1.0)
        told = server.written[begun:]
        assert not bus.vent().verified or bus.statistics.foreign > 5
        open_s = sum(b[0] - a[0] for a, b in pairwise(told) if a[1] == 9.0)
        assert open_s < 0.5 * (told[-1][0] - told[0][0])
        assert {volts for _, volts in told} == {0.0, 9.0}
        over.set()
        thread.join(2.0)
        wait_until(lambda: owner.faults[-1] == "", 3.0)
        assert bus.vent().verified


def test_outputs_that_cannot_be_read_back_are_said_to_be_so(server, wait_until):
    server.hidden.add(100)
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: not bus.readable)
        count = len(owner.samples)
        wait_until(lambda: len(owner.samples) > count + 5)
        assert not bus.vent().verified


def sane_reply(request):
    """A reply of a device that holds the pressures and 0 V."""
    function = request[7]
    held = {
        16: request[8:12],
        3: bytes([4]) + struct.pack(">f", 0.0),
        4: bytes([20]) + struct.pack(">5f", *PRESSURES),
    }
    body = bytes([function]) + held[function]
    return request[:4] + struct.pack(">H", 1 + len(body)) + request[6:7] + body


def test_a_device_that_lets_nobody_else_in_is_read_on_the_connection_that_it_has(wait_until):
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]

    def serve():
        peer, _ = listener.accept()
        listener.close()
        with peer, suppress(OSError):
            while len(request := peer.recv(512)) >= 12:
                peer.sendall(sane_reply(request))

    threading.Thread(target=serve, daemon=True).start()
    owner = Owner()
    with open_bus(port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 5)
        assert (bus.lines, bus.statistics.connects) == (1, 1)
        assert owner.faults == [""]
        assert bus.vent().verified
    assert list(owner.samples[-1][0].values()) == PRESSURES


# Garbage


def broken_reply(rng, request):
    """A reply that is wrong in one of many ways, or right."""
    tid, unit, function = request[0:2], request[6:7], request[7]
    kind = rng.randrange(10)
    body = bytes([function, 20]) + rng.randbytes(20)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 300))
    if kind == 1:
        body = bytes([function | 0x80, rng.randrange(256)])
    elif kind == 2:
        body = bytes([function, rng.randrange(256)]) + rng.randbytes(rng.randrange(64))
    elif kind == 3:
        body = rng.randbytes(rng.randrange(1, 60))
    elif kind == 4:
        tid = rng.randbytes(2)
    elif kind == 5:
        unit = rng.randbytes(1)
    elif kind == 6:
        body = body[: rng.randrange(1, len(body))]
    elif kind == 7 and function == 16:
        body = bytes([16]) + rng.randbytes(4)
    elif function == 16:
        body = bytes([16]) + request[8:12]
    frame = tid + b"\0\0" + struct.pack(">H", 1 + len(body)) + unit + body
    if kind == 8:
        frame += rng.randbytes(rng.randrange(20))
    if kind == 9:
        frame = frame[: rng.randrange(1, len(frame))]
    return frame


@pytest.mark.long
def test_ten_thousand_random_replies(wait_until, monkeypatch):
    """The bus survives them, takes only readings of full length, and works again afterwards."""
    # So that they take seconds; else the bus would spend its time waiting.
    monkeypatch.setattr("pneu_hw_bridge.modbus.bus.FIRST_BACKOFF_S", 0.0005)
    monkeypatch.setattr("pneu_hw_bridge.modbus.bus.LONGEST_BACKOFF_S", 0.0005)
    rng = random.Random(11)
    replies = 0
    sane = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.2)
    port = listener.getsockname()[1]
    finished = threading.Event()

    def serve():
        nonlocal replies
        while not finished.is_set():
            try:
                peer, _ = listener.accept()
            except TimeoutError:
                continue
            with peer:
                peer.settimeout(0.2)
                try:
                    while not finished.is_set():
                        request = peer.recv(512)
                        if len(request) < 12:
                            break
                        if sane.is_set():
                            peer.sendall(sane_reply(request))
                            continue
                        for _ in range(rng.choice([1, 1, 1, 2, 3])):
                            peer.sendall(broken_reply(rng, request))
                            replies += 1
                except OSError:
                    continue  # the bus gave this connection up, as it should

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    owner = Owner()
    try:
        with open_bus(port, owner, timeout_s=0.004) as bus:
            wait_until(lambda: replies >= 10_000, 60.0, 0.02)
            sane.set()
            wait_until(lambda: owner.faults and owner.faults[-1] == "", 5.0)
            count = len(owner.samples)
            wait_until(lambda: len(owner.samples) > count + 50)
            statistics = bus.statistics
    finally:
        finished.set()
        thread.join(3.0)
        listener.close()
    assert statistics.malformed > 20
    assert statistics.exceptions > 5
    assert list(owner.samples[-1][0].values()) == PRESSURES
    assert all(len(values) == 5 for values, _, _ in owner.samples)


def test_of_an_exchange_that_was_held_up_nobody_knows_when_it_was(server, wait_until):
    """Half a second in a machine that stood still is half a bar in a tube."""
    owner = Owner()
    with open_bus(server.port, owner, timeout_s=0.2) as bus:
        wait_until(lambda: len(owner.samples) > 100)
        assert all(stamp_ns is not None for _, _, stamp_ns in owner.samples[50:100])
        owner.volts = {"voltage": 3.0}
        server.delay_s = 0.08
        begun_s = time.monotonic()
        wait_until(lambda: bus.statistics.unclear > 1)
        wait_until(lambda: server.written[-1][1] == 3.0)
        server.delay_s = 0.0
        wait_until(lambda: owner.applied[-1][0] == owner.volts)
        count = len(owner.samples)
        wait_until(lambda: len(owner.samples) > count + 50)
    unclear = [at_s for _, at_s, stamp_ns in owner.samples if stamp_ns is None and at_s > begun_s]
    assert unclear and all(stamp_ns is not None for _, _, stamp_ns in owner.samples[-20:])


def test_a_device_that_hangs_up_while_the_line_is_set_up(server, wait_until, monkeypatch):
    """It ended the thread of the bus, and nothing was written any more."""
    left = iter([OSError(9, "Bad file descriptor"), AttributeError("no transport")])
    whole = Client._forget_when_closed

    def forget(self):
        for error in left:
            raise error
        whole(self)

    monkeypatch.setattr(Client, "_forget_when_closed", forget)
    owner = Owner()
    with open_bus(server.port, owner) as bus:
        wait_until(lambda: owner.samples, 5.0)
        assert bus.statistics.connect_failures == 2


def test_reading_does_not_go_on_alone(server, wait_until, monkeypatch):
    """Where asyncio forgets that it was cancelled, because an answer came at the same time."""

    async def read(self, client):
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(0.002)

    monkeypatch.setattr("pneu_hw_bridge.modbus.reading.Reader.read", read)
    owner = Owner()
    owner.volts = {"voltage": 5.5}
    with open_bus(server.port, owner, timeout_s=0.05) as bus:
        wait_until(lambda: len(server.written) > 2)
        server.mute.add(100)
        wait_until(lambda: bus.statistics.timeouts > 0)
        server.mute.clear()
        wait_until(lambda: owner.faults[-1] == "", 5.0)
        begun = len(server.written)
        wait_until(lambda: len(server.written) > begun + 2)


# Serial


def test_serial_line(wait_until):
    owner = Owner()
    with serial_bus(owner, timeout_s=0.2) as (bus, server):
        wait_until(lambda: len(owner.samples) > 5)
        owner.volts = {"voltage": 6.25}
        bus.poke()
        wait_until(lambda: server.written[-1][1] == 6.25)
        assert bus.vent().verified
    assert list(owner.samples[-1][0].values()) == PRESSURES
    assert server.written[-1][1] in (0.0, 6.25)


@pytest.mark.parametrize(
    "late_s",
    [
        (0.3, 0.5),
        pytest.param((0.12, 0.2), marks=pytest.mark.long),
        pytest.param((0.7, 0.9), marks=pytest.mark.long),
    ],
)
def test_late_answers_on_a_serial_line_are_not_taken_for_others(late_s):
    """They carry no number: each would pass for the answer to the next request."""
    owner = Owner()
    owner.volts = {"voltage": 5.5}
    with serial_bus(owner, late_s, timeout_s=0.1) as (bus, server):
        time.sleep(4.0)
        assert bus.statistics.timeouts > 3
        assert not owner.samples
    assert {volts for _, volts in server.written} == {0.0}


@pytest.mark.long
def test_spoilt_frames_on_a_serial_line_are_asked_for_again(wait_until):
    """One in fifty, of requests and of answers: no fault worth a vent."""
    owner = Owner()
    with serial_bus(owner, spoilt=0.02, timeout_s=0.15) as (bus, server):
        wait_until(lambda: len(owner.samples) > 5, 10.0)
        begun, told = len(owner.samples), len(owner.faults)
        for k in range(200):
            owner.volts = {"voltage": k / 32.0}  # exact in float32
            bus.poke()
            time.sleep(0.03)
        assert bus.statistics.repeats > 3
        told_of = [fault for fault in owner.faults[told:] if fault]
        assert len(told_of) <= max(2, bus.statistics.repeats // 5), told_of
        assert len(owner.samples) > begun + 150
        owner.volts = {"voltage": 6.25}
        wait_until(lambda: server.written[-1][1] == 6.25, 3.0)
    assert all(list(values.values()) == PRESSURES for values, _, _ in owner.samples)
    assert {volts for _, volts in server.written} <= {k / 32.0 for k in range(201)}


def test_missing_serial_port(wait_until):
    owner = Owner()
    device = {"transport": "rtu", "serial_port": "/dev/no_such_port"}
    bus = ModbusBus(load_register_map("generic_plc", device), owner)
    bus.start()
    try:
        wait_until(lambda: owner.faults)
    finally:
        bus.stop()
    assert owner.faults[-1].startswith("no connection to /dev/no_such_port")
