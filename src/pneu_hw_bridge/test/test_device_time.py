# SPDX-License-Identifier: Apache-2.0
"""Samples and commands carry the device's own time: real Modbus, a real lab, and a late bridge."""

import random
import struct
import time
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor
from pneu_sim.rig.load import load_rig
from pneu_sim.simulator import Simulator

pytestmark = pytest.mark.realtime

TAPS = ["supply", "valve_out", "middle", "end", "exhaust"]
PERIOD_NS = 2_000_000
STEP_NS = 1_000_000
CLOCKED = ("--registers", "logging_plc")
PACED = (*CLOCKED, "--paced", "1")


class Device:
    """A plain client that takes the records apart by the words of the profile's description."""

    def __init__(self, port):
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=1.0, retries=0)
        assert self.client.connect()

    def read(self):
        """Samples and commands by number, each with its device time in ns and its values."""
        reply = self.client.read_input_registers(0, count=123)
        assert not reply.isError(), reply
        data = struct.pack(">123H", *reply.registers)
        samples, commands = {}, {}
        for place in range(9):
            number, ns, *counts = struct.unpack_from(">IQ5H", data, 22 * place)
            samples[number] = ns, [15.0 * count for count in counts]
        for place in range(3):
            number, ns, volts = struct.unpack_from(">IQf", data, 198 + 16 * place)
            commands[number] = ns, volts
        return samples, commands

    def write(self, volts):
        words = struct.unpack(">2H", struct.pack(">f", volts))
        assert not self.client.write_registers(100, list(words)).isError()


class Owner:
    """Keeps what the bus tells; can hold the thread of the bus up, as a busy machine does."""

    def __init__(self, latest_s=0.0):
        self.volts = {"voltage": 0.0}
        self.latest_s = latest_s
        self.samples, self.applied, self.faults = [], [], []
        self._rng = random.Random(3)

    def output(self, now_s):
        time.sleep(self._rng.uniform(0.0, self.latest_s))
        return self.volts

    def readings(self, values, steady_s, stamp_ns):
        if stamp_ns is not None:
            self.samples.append((stamp_ns, values))

    def written(self, values, stamp_ns):
        self.applied.append((stamp_ns, values["voltage"]))

    def takes(self, mostly_s, usually_s):
        pass

    def bus(self, fault):
        self.faults.append(fault)


@contextmanager
def open_bus(port, owner, profile="logging_plc"):
    bus = ModbusBus(load_register_map(profile, {"port": port}), owner)
    bus.start()
    try:
        yield bus
    finally:
        bus.stop()


def test_samples_are_the_plants_state_at_their_time(start_lab, tmp_path, rig_file, wait_until):
    """What a simulation offline gives along the commands at the times that the device tells."""
    rng = random.Random(1)
    samples, commands = {}, {}
    with start_lab(tmp_path, *PACED, "--standing", "--noise", "0") as lab:
        device = Device(lab.port)
        first = device.read()
        assert device.read() == first, "time stands still"
        lab.ask("go", seconds=1.2)
        while not lab.ask("status")["plant"]["standing"]:
            for _ in range(rng.randrange(1, 4)):
                found = device.read()
                for known, new in zip((samples, commands), found, strict=True):
                    assert all(known.get(number, one) == one for number, one in new.items())
                    known.update(new)
            device.write(rng.uniform(3.5, 7.0))
            time.sleep(rng.uniform(0.0, 0.01))
        device.client.close()
    end_ns = 1_199_000_000  # what shows at the end is older by the sensors' latency
    assert sorted(samples) == list(range(len(samples))), "none is missing"
    assert all(ns == number * PERIOD_NS for number, (ns, _) in samples.items())
    assert sorted(commands) == list(range(len(commands)))
    assert len(commands) > 50
    steps = round(end_ns / STEP_NS)
    volts = np.zeros(steps)
    for number in sorted(commands):
        ns, value = commands[number]
        assert ns % STEP_NS == 0
        volts[ns // STEP_NS :] = value
    simulator = Simulator(load_rig(rig_file), dx_m=0.1)
    runs = [simulator.run(1e-3, {"voltage": one}, 1e-3).taps for one in volts]
    offline = {tap: np.array([runs[0][tap][0], *(run[tap][1] for run in runs)]) for tap in TAPS}
    numbers = [n for n in sorted(samples) if 2 * n <= steps]
    assert len(numbers) > 590
    for place, tap in enumerate(TAPS):
        found = np.array([samples[n][1][place] for n in numbers])
        expected = offline[tap][[2 * n for n in numbers]]
        assert np.abs(found - expected).max() < 7.6, f"{tap}: beyond half a step of 15 Pa"
    assert np.ptp(offline["end"]) > 5e4


@pytest.mark.long
def test_no_sample_is_lost_or_bent_by_a_late_bridge(start_lab, tmp_path, wait_until):
    """The bridge comes up to 40 ms late each time: the lab's time waits, and stamps are exact."""
    owner = Owner(latest_s=0.04)
    with start_lab(tmp_path, *PACED) as lab, open_bus(lab.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 500, 30.0)
        for volts in (6.0, 5.5, 5.0, 5.75):
            owner.volts = {"voltage": volts}
            bus.poke()
            time.sleep(0.2)
        wait_until(lambda: len(owner.samples) > 1000, 30.0)
        assert lab.ask("status")["plant"]["waited_s"] > 0.3
    stamps = [stamp for stamp, _ in owner.samples]
    assert {b - a for a, b in pairwise(stamps)} == {PERIOD_NS}
    assert bus.statistics.samples_skipped == 0
    told = [volts for _, volts in owner.applied]
    assert [v for v, before in zip(told[1:], told, strict=False) if v != before][-4:] == [
        6.0,
        5.5,
        5.0,
        5.75,
    ]
    phases = {(stamp - stamps[0]) % STEP_NS for stamp, _ in owner.applied}
    assert max(phases) < 10, "on the device's own steps; 1 ns later where two began to act at once"
    assert all(b[0] > a[0] for a, b in pairwise(owner.applied))


@pytest.mark.long
def test_in_real_time_what_is_lost_is_counted(start_lab, tmp_path, wait_until):
    owner = Owner(latest_s=0.06)
    with start_lab(tmp_path, *CLOCKED) as lab, open_bus(lab.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 400, 30.0)
        statistics = bus.statistics
    stamps = [stamp for stamp, _ in owner.samples]
    steps = [(b - a) / PERIOD_NS for a, b in pairwise(stamps)]
    assert all(step == round(step) >= 1 for step in steps)
    assert 0 < sum(steps) - len(steps) <= statistics.samples_skipped


@pytest.mark.long
def test_no_sample_is_told_twice(start_lab, tmp_path, wait_until):
    """The device samples at 20 Hz and is read at 500 Hz."""
    owner = Owner()
    with start_lab(tmp_path, *PACED, "--period", "0.05") as lab, open_bus(lab.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 20, 30.0)
    stamps = [stamp for stamp, _ in owner.samples]
    assert {b - a for a, b in pairwise(stamps)} == {50_000_000}
    assert bus.statistics.reads_without_news > 10 * len(stamps)


@pytest.mark.long
def test_a_device_that_begins_anew_is_mapped_anew(start_lab, tmp_path, wait_until):
    owner = Owner()
    with start_lab(tmp_path, *CLOCKED) as lab, open_bus(lab.port, owner) as bus:
        wait_until(lambda: len(owner.samples) > 200, 30.0)
        owner.volts = {"voltage": 6.0}
        bus.poke()
        wait_until(lambda: owner.applied and owner.applied[-1][1] == 6.0)
        count = len(owner.samples)
        lab.ask("restart")
        wait_until(lambda: bus.clock.restarts)
        assert bus.clock.told.popleft() == "the device's counter went back"
        wait_until(lambda: len(owner.samples) > count + 200)
        applied = list(owner.applied)
    stamps = [stamp for stamp, _ in owner.samples]
    assert all(b > a for a, b in pairwise(stamps))
    assert stamps[-1] - stamps[count - 1] == pytest.approx(
        (len(stamps) - count) * PERIOD_NS + 2e8, abs=1e8
    )
    assert abs(time.time_ns() - stamps[-1]) < 1e9
    assert all(b[0] > a[0] for a, b in pairwise(applied))


class Rig:
    """Bus and supervisor with a controller."""

    def __init__(self, port):
        registers = load_register_map("logging_plc", {"port": port})
        self.link = Link(Supervisor(limits_of(registers)), lambda: None)
        self.bus = ModbusBus(registers, self.link)

    def __enter__(self):
        self.bus.start()
        self.link.publishers(1)
        self.link.enable(True)
        return self

    def __exit__(self, *error):
        self.bus.stop()

    def follows(self):
        if not self.link.command({"voltage": 5.5}):
            self.bus.poke()
        return self.link.report().state is State.FOLLOWING

    def holds(self):
        self.follows()
        return self.link.report().state is State.HOLDING


@pytest.mark.long
def test_a_counter_that_stands_still_is_a_sensor_that_stalls(start_lab, tmp_path, wait_until):
    """The device answers as ever, with its latest sample again and again."""
    with start_lab(tmp_path, *PACED) as lab, Rig(lab.port) as rig:
        wait_until(rig.follows, 10.0)
        wait_until(lambda: rig.follows() and lab.volts() == 5.5)
        lab.ask("stand")
        begun_s = time.monotonic()
        wait_until(rig.holds, 1.0)
        wait_until(lambda: lab.volts() == 0.0, 1.0)
        assert time.monotonic() - begun_s < 0.2
        assert "sensor end: stale" in rig.link.report().reason
        assert rig.bus.fault == ""
        lab.ask("go")
        wait_until(lambda: rig.follows() and lab.volts() == 5.5)


@pytest.mark.long
def test_the_watchdog_of_the_device_is_told_with_its_own_time(start_lab, tmp_path, wait_until):
    """Nobody writes for a while: who connects then learns when the device vented by itself."""
    with start_lab(tmp_path, *PACED) as lab:
        device = Device(lab.port)
        device.write(6.0)
        wait_until(lambda: lab.volts() == 0.0)
        commands = device.read()[1]
        newest = max(commands)
        assert [commands[n][1] for n in (newest - 1, newest)] == [6.0, 0.0]
        since_s = 1e-9 * (commands[newest][0] - commands[newest - 1][0])
        assert since_s == pytest.approx(0.1, abs=0.03)
        device.client.close()
        owner = Owner()
        with open_bus(lab.port, owner):
            wait_until(lambda: owner.applied)


# What cannot be


def pneu(*arguments):
    return CliRunner().invoke(build_app(), ["lab", *map(str, arguments)])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--paced", "1"), "register map 'generic_plc' has no clock"),
        ((*CLOCKED, "--standing"), "only the time of a lab with --paced can stand still"),
        ((*CLOCKED, "--paced", "2"), "pace: found 2, needed are 0.01 to 1"),
        ((*CLOCKED, "--period", "0.0025"), "needed is a multiple of the plant's 0.001 s"),
    ],
)
def test_a_time_that_cannot_be_is_refused(options, says, rig_file):
    result = pneu("--rig", rig_file, "--port", "0", "--control-port", "0", *options)
    assert result.exit_code == 2
    assert says in result.stderr and result.stderr.count("\n") == 1


def test_real_time_does_not_stand_still(start_lab, tmp_path):
    with start_lab(tmp_path, *CLOCKED) as lab:
        result = pneu("stand", "--control-port", lab.control_port)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert "--paced" in result.stderr
        assert pneu("restart", "--control-port", lab.control_port).exit_code == 0
