# SPDX-License-Identifier: Apache-2.0
"""Plant and registers of the emulated lab, step by step: nothing waits for the machine's clock."""

import asyncio
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymodbus.constants import ExcCodes

from pneu_common.errors import InputError
from pneu_hw_bridge.lab import device as device_module
from pneu_hw_bridge.lab import plant as plant_module
from pneu_hw_bridge.lab.device import LabDevice
from pneu_hw_bridge.lab.plant import Pace, Plant
from pneu_hw_bridge.registers.load import load_register_map
from pneu_sim.rig.load import load_rig

SAFE = {"voltage": 5.0}
QUIET: dict[str, Any] = {"dx_m": 0.5, "noise_pa": 0.0, "quantum_pa": 0.0}
STEP_S = 1e-3


class Clock:
    """The steady clock, as a test sets it; whoever sleeps has it pass."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    perf_counter = monotonic


@pytest.fixture
def clock(monkeypatch):
    one = Clock()
    for module in (plant_module, device_module):
        monkeypatch.setattr(module, "time", one)
    return one


@pytest.fixture
def rig(rig_file):
    return load_rig(rig_file)


def plant_of(rig, **changes):
    return Plant(rig, SAFE, **{**QUIET, **changes})


def paced(factor=1.0, kept=3, period_s=2e-3, standing=False):
    return Pace(period_s, kept, factor, standing)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sample_s": 1.99e-4}, "sample_s: found 0.000199, needed are 0.0002 to 0.1 s"),
        ({"sample_s": 2e-4}, None),
        ({"sample_s": 0.1}, None),
        ({"sample_s": 0.101}, "sample_s: found 0.101, needed are 0.0002 to 0.1 s"),
        ({"latency_s": -1e-9}, "latency_s: found -1e-09, needed are 0 to 1 s"),
        ({"latency_s": 1.0}, None),
        ({"latency_s": 1.01}, "latency_s: found 1.01, needed are 0 to 1 s"),
        ({"pace": Pace(2.5e-3, 3)},
         "period_s: found 0.0025, needed is a multiple of the plant's 0.001 s"),
        ({"pace": paced(0.0099)}, "pace: found 0.0099, needed are 0.01 to 1"),
        ({"pace": paced(0.01)}, None),
        ({"pace": paced(1.01)}, "pace: found 1.01, needed are 0.01 to 1"),
        ({"safe_v": {}}, "rig 'lab' and the register map differ in command 'voltage'"),
        ({"safe_v": {**SAFE, "a": 0.0}}, "rig 'lab' and the register map differ in command 'a'"),
    ],
)  # fmt: skip
def test_limits_of_a_plant(rig, changes, says):
    options = {"safe_v": SAFE, **QUIET, **changes}
    if says is None:
        assert Plant(rig, **options).status().time_s == options.get("sample_s", STEP_S)
        return
    with pytest.raises(InputError) as caught:
        Plant(rig, **options)
    assert str(caught.value) == says


def advance(plant, steps):
    for _ in range(steps):
        plant._advance(1, plant._acting)


@pytest.mark.parametrize("latency_s", [0.0, 3e-3, 4e-3, 5e-3])
@pytest.mark.parametrize("kept", [1, 3])
def test_samples_that_a_device_shows(rig, latency_s, kept):
    """Every second step is one; the newest that is old enough comes first."""
    plant = plant_of(rig, latency_s=latency_s, pace=paced(kept=kept))
    first = plant.taken(0.0)
    assert [one.number for one in first] == [0]
    advance(plant, 24)
    late = math.ceil(latency_s / 2e-3)
    assert len(plant._taken) == late + 1 + kept
    assert plant.newest().number == 12 and plant.newest().time_s == pytest.approx(24 * STEP_S)
    newest = int((25 * STEP_S - latency_s) / 2e-3 + 1e-6)
    found = plant.taken(0.0)
    assert [one.number for one in found] == [newest - k for k in range(kept)]
    assert [one.time_s for one in found] == pytest.approx([2e-3 * one.number for one in found])
    assert (plant._shown, plant._shown_s > 0.0) == (2 * newest, True)


def test_samples_that_are_not_there_yet(rig, clock):
    """Where device time is real time a sample of the moment asked for is waited for."""
    plant = plant_of(rig, latency_s=2e-3, pace=Pace(1e-3, 3))
    advance(plant, 9)
    plant._begun_s = 1000.0  # ten steps are simulated
    assert plant.taken(1000.0129) is not None
    assert plant.taken(1000.0131) is None
    assert [one.number for one in plant.taken(1000.0098)] == [7, 6, 5]
    assert plant.now_s() == 1000.0


@pytest.mark.parametrize(
    ("at_s", "share"),
    [(None, 0.0), (1000.0, 10.0 - 2.0), (1000.002, 8.0 + 2.0 - 2.0), (1000.0045, 7.5)],
)
def test_a_reading_is_that_of_the_moment_asked_for(rig, clock, at_s, share):
    plant = plant_of(rig, latency_s=2e-3)
    plant.apply({"voltage": 9.0})
    plant._acting = dict(plant._volts)
    advance(plant, 9)
    plant._begun_s = 1000.0
    past = np.array(plant._past)
    assert len(past) == 10 and np.ptp(past[:, 1]) > 0.0
    found = plant.readings(at_s)
    if at_s is None:
        expected = past[-1]
    else:
        since = min(max((at_s - 2e-3 - 1000.0) / STEP_S - 1.0, 0.0), 9.0)
        low = int(since)
        expected = past[low] + (since - low) * (past[min(low + 1, 9)] - past[low])
    assert list(found) == [*rig.taps]
    np.testing.assert_allclose(list(found.values()), expected, rtol=1e-9)
    assert plant.readings(1000.0119) is not None and plant.readings(1000.0121) is None


def test_noise_and_resolution_replace_the_rigs(rig):
    noisy = Plant(rig, SAFE, dx_m=0.5, noise_pa=100.0, quantum_pa=1000.0, seed=3)
    values = [noisy.readings()["end"] for _ in range(50)]
    assert all(abs(value / 1000.0 - round(value / 1000.0)) < 1e-9 for value in values)
    again = Plant(rig, SAFE, dx_m=0.5, noise_pa=100.0, quantum_pa=1000.0, seed=3)
    assert values == [again.readings()["end"] for _ in range(50)]
    own = Plant(rig, SAFE, dx_m=0.5)
    taps = rig.taps.values()
    assert list(own._noise[: len(taps)]) == [tap.noise_pa for tap in taps]
    assert list(own._quantum[: len(taps)]) == [tap.quantum_pa for tap in taps]


def test_a_voltage_acts_from_when_it_was_set(rig, clock):
    """Where it changes during a sample, the mean of the sample acts."""
    plant = plant_of(rig)
    plant._begun_s = 1000.0 - STEP_S  # the next sample begins now
    for at_s, volts in ((999.0, 4.0), (1000.00125, 8.0), (1000.0015, 6.0), (1000.0035, 2.0)):
        clock.now_s = at_s
        plant.apply({"voltage": volts})
    held = plant._held(3)["voltage"]
    np.testing.assert_allclose(held, [4.0, 0.25 * 4.0 + 0.25 * 8.0 + 0.5 * 6.0, 6.0])
    assert plant._acting == {"voltage": 6.0} and plant.volts() == {"voltage": 2.0}
    plant._samples += 3
    np.testing.assert_allclose(plant._held(2)["voltage"], [0.5 * 6.0 + 0.5 * 2.0, 2.0])


def test_a_taken_voltage_acts_from_the_next_sample_on(rig):
    plant = plant_of(rig, pace=paced())
    assert plant.take({"voltage": 7.0}) == pytest.approx(STEP_S)
    assert plant._acting == plant.volts() == {"voltage": 7.0}
    plant._promised = 5
    assert plant.take({}) == pytest.approx(5 * STEP_S)


@pytest.mark.parametrize(
    ("behind_s", "due", "skipped_s"),
    [
        (-0.9e-3, 0, 0.0),
        (0.0, 0, 0.0),
        (0.9e-3, 0, 0.0),
        (1e-3, 1, 0.0),
        (7.5e-3, 7, 0.0),
        (20.5e-3, 20, 0.0),
        (21.5e-3, 20, 0.0),
        (1.99, 20, 0.0),
        (2.01, 1, 2.01),
    ],
)
def test_how_many_samples_are_due(rig, clock, behind_s, due, skipped_s):
    plant = plant_of(rig)
    advance(plant, 4)
    plant._begun_s = 1000.0 - 5 * STEP_S - behind_s
    assert plant._due() == (due, pytest.approx(1e-3 if skipped_s else behind_s))
    status = plant.status()
    assert status.lag_s == status.worst_lag_s == pytest.approx(max(behind_s, 0.0))
    assert status.skipped_s == pytest.approx(skipped_s)
    assert plant._due() == (due, pytest.approx(1e-3 if skipped_s else behind_s))
    plant._begun_s = 1000.0 - 5 * STEP_S
    assert plant._due()[0] == 0
    assert plant.status().worst_lag_s == pytest.approx(max(behind_s, 0.0))


@pytest.mark.parametrize(
    ("factor", "passed_s", "due", "waited_s"),
    [
        (1.0, 2.5e-3, 2, 0.0),
        (0.5, 5e-3, 2, 0.0),
        (1.0, 5e-3, 5, 0.0),
        (1.0, 8e-3, 5, 3e-3),
        (0.5, 16e-3, 5, 6e-3),
    ],
)
def test_the_time_of_a_paced_plant_waits_for_the_machine(
    rig, clock, factor, passed_s, due, waited_s
):
    plant = plant_of(rig, pace=paced(factor))
    plant._begun_s = 1000.0 - STEP_S / factor - passed_s
    assert plant._due_when_paced()[0] == due
    assert plant.status().waited_s == pytest.approx(waited_s)
    assert (1000.0 - plant._begun_s) * factor - STEP_S == pytest.approx(
        min(passed_s * factor, 5e-3)
    )
    assert plant.now_s() == pytest.approx(STEP_S)


@pytest.mark.parametrize(
    ("silent_s", "latency_s", "shown", "due"),
    [
        (0.0, 0.0, 0, 3),  # two more samples than the one shown, of two steps each, one is there
        (0.99, 0.0, 0, 3),
        (1.01, 0.0, 0, 5),
        (0.0, 1.5e-3, 0, 5),
        (0.0, 1e-3, 0, 4),
        (0.0, 0.0, 1, 4),
        (0.0, 0.0, -9, 0),
    ],
)
def test_a_paced_plant_waits_for_its_reader(rig, clock, silent_s, latency_s, shown, due):
    plant = plant_of(rig, latency_s=latency_s, pace=paced())
    plant._begun_s = 1000.0 - STEP_S - 5e-3
    plant._shown, plant._shown_s = shown, 1000.0 - silent_s
    assert plant._due_when_paced()[0] == due


def test_a_paced_plant_stands_and_goes(rig, clock):
    plant = plant_of(rig, pace=paced(standing=True))
    plant._begun_s = 1000.0 - STEP_S - 20e-3
    assert plant.status().standing and plant._due_when_paced() == (0, 0.0)
    assert plant.status().waited_s == 0.0, "that it stands is no waiting"
    plant.go()
    clock.now_s += 2e-3
    assert plant._due_when_paced()[0] == 5 and not plant.status().standing
    plant.stand()
    assert plant._due_when_paced()[0] == 0
    plant.go(3e-3)
    clock.now_s += 9e-3
    assert plant._due_when_paced()[0] == 3
    advance(plant, 3)
    assert not plant.status().standing
    assert plant._due_when_paced() == (0, 0.0) and plant.status().standing
    plant.go(1e-9)
    clock.now_s += 9e-3
    plant._until += 3
    assert plant._due_when_paced()[0] == 1, "one at least"
    for seconds in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(InputError, match=f"^seconds: found {seconds:g}, must be positive"):
            plant.go(seconds)
    for other in (plant_of(rig), plant_of(rig, pace=Pace(2e-3, 3))):
        for what in (other.stand, other.go):
            with pytest.raises(InputError, match=r"^only the time of a lab with --paced can stand"):
                what()


def test_the_supply_is_lost_and_comes_back(rig):
    plant = plant_of(rig)
    whole = plant.readings()["supply"]
    plant.supply(True)
    advance(plant, 40)
    lost = plant.readings()["supply"]
    assert plant.status().supply_lost and lost < whole - 1e5
    plant.supply(False)
    advance(plant, 40)
    assert not plant.status().supply_lost and plant.readings()["supply"] > lost + 1e5


# Registers


@pytest.fixture
def lab(rig):
    return lab_of(rig)


def lab_of(rig, registers="generic_plc", watchdog_s=0.1, pace=None, seed=0):
    plant = Plant(rig, {"voltage": 3.0}, **QUIET, pace=pace)
    return LabDevice(plant, load_register_map(registers), watchdog_s, seed)


@pytest.mark.parametrize(
    ("watchdog_s", "fits"), [(0.0, 0), (-1.0, 0), (1e-6, 1), (10.0, 1), (10.1, 0)]
)
def test_limits_of_the_watchdog(rig, watchdog_s, fits):
    if fits:
        lab_of(rig, watchdog_s=watchdog_s)
        return
    with pytest.raises(InputError) as caught:
        lab_of(rig, watchdog_s=watchdog_s)
    says = f"watchdog_s: found {watchdog_s:g}, needed is more than 0, at most 10"
    assert str(caught.value) == says


def begin(lab, name, **options):
    return lab.faults.begin(name, 0.0, **options)


def test_malformed_answers_are_shorter_or_longer_than_right_ones(rig, lab):
    data = bytes(range(50))
    assert lab._trace_packet(True, data) == data
    begin(lab, "malformed")
    assert lab._trace_packet(False, data) == data, "what comes in is whole"
    sent = [lab._trace_packet(True, data) for _ in range(500)]
    sizes = {len(one) for one in sent}
    assert min(sizes) < 5 and max(sizes) > 95 and sizes <= set(range(1, 100))
    assert len(set(sent)) > 490
    same, other = lab_of(rig), lab_of(rig, seed=1)
    for one in (same, other):
        begin(one, "malformed")
    assert same._trace_packet(True, data) == sent[0] != other._trace_packet(True, data)
    begin(lab, "silent")
    assert lab._trace_packet(True, data) == b"" and lab._trace_packet(False, data) == data


def test_when_it_is_closed_all_its_work_ends(lab):
    async def serve():
        port = await lab.open("127.0.0.1", 0)
        assert port > 0
        begin(lab, "drop")
        working = set(lab._tasks)
        assert len(working) == 2
        lab._plant.apply({"voltage": 7.0})
        await lab.close()
        await asyncio.wait(working, timeout=5.0)
        assert all(task.done() for task in working) and not lab._tasks
        assert lab._plant.volts() == lab._safe != {"voltage": 7.0}
        lab.faults.clear()
        assert not lab._tasks, "what is closed opens no more"

    asyncio.run(serve())


@pytest.mark.parametrize(("there_after", "waits"), [(0, 0), (3, 3), (4, 4), (5, None)])
def test_a_reading_that_is_not_there_yet_is_waited_for(lab, clock, monkeypatch, there_after, waits):
    """At quarters of a second, so that after four it has been just as long as it may be."""
    monkeypatch.setattr(device_module, "GLANCE_S", 0.25)
    slept, asked = [], []

    async def sleep(seconds):
        slept.append(seconds)
        clock.now_s += seconds

    def look(asked_s):
        asked.append(asked_s)
        return dict.fromkeys(lab._plant.rig.taps, 2e5) if len(slept) >= there_after else None

    monkeypatch.setattr(device_module, "asyncio", SimpleNamespace(sleep=sleep))
    monkeypatch.setattr(lab._plant, "readings", look)
    registers = [0] * 10
    answer = asyncio.run(lab._access(4, 0, 0, 10, registers, None))
    assert slept == [0.25] * (4 if waits is None else waits) and set(asked) == {1000.0}
    if waits is None:
        assert (answer, lab.refused, lab.requests) == (ExcCodes.DEVICE_BUSY, 1, 0)
        assert registers == [0] * 10
    else:
        assert (answer, lab.refused, lab.requests) == (None, 0, 1)
        tap = lab._registers.sampled["end"]
        assert tap.decode(registers[tap.address : tap.address + tap.width]) == 2e5
    begin(lab, "slow", value=0.75)
    slept.clear()
    there_after = 0
    assert asyncio.run(lab._access(4, 0, 0, 10, registers, None)) is None
    assert slept == [0.75]


def asked_of(lab, function, address, count=0, written=None):
    """What a request is answered with, and the registers after it."""
    registers = [0] * 120
    values = dict.fromkeys(lab._plant.rig.taps, 2e5)
    if written is not None:
        count, values = len(written), {}
    answer = lab._answer(function, 0, address, count, registers, written, values, [])
    return answer, registers


def test_what_is_written_acts_where_it_can(lab, clock):
    output = lab._registers.outputs["voltage"]
    low, high = output.range
    rests = len(lab.rests)
    for volts, acts in ((7.5, 7.5), (25.0, high), (-25.0, low), (7.5, 7.5)):
        assert asked_of(lab, 16, output.address, written=output.encode(volts))[0] is None
        assert lab._plant.volts() == {"voltage": acts}
    assert lab.history[-1].cause == "write" and len(lab.rests) >= rests
    changes = len(lab.history)
    asked_of(lab, 16, output.address, written=output.encode(7.5))
    assert len(lab.history) == changes, "no change is none"
    for volts in (math.nan, math.inf):
        answer, _ = asked_of(lab, 16, output.address, written=output.encode(volts))
        assert answer == ExcCodes.ILLEGAL_VALUE
    assert (lab.refused, lab._plant.volts()) == (2, {"voltage": 7.5})
    assert asked_of(lab, 99, output.address)[0] == ExcCodes.ILLEGAL_FUNCTION
    begin(lab, "dead_valve")
    answer, _ = asked_of(lab, 16, output.address, written=output.encode(5.0))
    assert answer == ExcCodes.GATEWAY_NO_RESPONSE and lab._plant.volts() == {"voltage": 7.5}
    begin(lab, "exception", value=2.0)
    assert asked_of(lab, 4, 0, 10)[0] == ExcCodes.ILLEGAL_ADDRESS
    assert lab.refused == 5
    begin(lab, "silent")
    assert asked_of(lab, 4, 0, 10)[0] == ExcCodes.DEVICE_BUSY and lab.refused == 5


def test_the_watchdog_goes_off_after_its_time(lab, clock, monkeypatch):
    async def watch(times):
        async def sleep(seconds):
            clock.now_s += 0.0625
            times[0] -= 1
            if not times[0]:
                raise asyncio.CancelledError

        monkeypatch.setattr(device_module, "asyncio", SimpleNamespace(sleep=sleep))
        await lab._watch()

    def looks(count):
        with pytest.raises(asyncio.CancelledError):
            asyncio.run(watch([count]))

    lab._watchdog_s = 0.125
    output = lab._registers.outputs["voltage"]
    asked_of(lab, 16, output.address, written=output.encode(7.5))
    looks(3)  # at 0, 1/16 and 1/8 s
    assert (lab.watchdog_trips, lab.bitten, lab._plant.volts()) == (0, False, {"voltage": 7.5})
    assert [stall.seconds for stall in lab.stalls] == pytest.approx([0.0605, 0.0605])
    looks(1)
    assert (lab.watchdog_trips, lab.bitten, lab._plant.volts()) == (1, True, lab._safe)
    assert lab.history[-1].cause == lab.rests[-1].cause == "watchdog"
    assert lab.rests[-1].begun_s == clock.now_s - 0.0625 and lab.rests[-1].ended_s is None
    looks(3)
    assert lab.watchdog_trips == 1, "once"
    asked_of(lab, 16, output.address, written=output.encode(7.5))
    assert not lab.bitten and lab.rests[-1].ended_s == clock.now_s


def test_readings_with_faults(lab):
    def shown(**values):
        return lab._shown(0.0, {"end": 1.0, "middle": 2.0, **values})

    assert shown() == {"end": 1.0, "middle": 2.0}
    begin(lab, "frozen", channel="end")
    assert shown() == {"end": 1.0, "middle": 2.0}
    assert shown(end=5.0, middle=6.0) == {"end": 1.0, "middle": 6.0}
    begin(lab, "frozen")
    assert shown(end=5.0, middle=6.0) == {"end": 5.0, "middle": 6.0}
    assert shown() == {"end": 5.0, "middle": 6.0}
    begin(lab, "out_of_range", channel="middle", value=-3.0)
    assert shown() == {"end": 5.0, "middle": -3.0}
    begin(lab, "out_of_range")
    assert shown() == {"end": 1e7, "middle": 1e7}


def test_a_device_without_a_clock_cannot_begin_anew(lab):
    with pytest.raises(InputError, match=r"^the device of this register map has no clock that"):
        lab.restart()


def test_a_device_with_a_clock_shows_samples_and_commands(rig):
    lab = lab_of(rig, "logging_plc", pace=paced(period_s=1e-3, kept=4))
    plan = lab._registers.clock
    advance(lab._plant, 20)
    lab._plant._promised = 30
    lab._apply({"voltage": 7.5})
    lab._apply({"voltage": 2.5})
    assert [(one.number, one.volts["voltage"]) for one in lab._commands][-2:] == [
        (1, 7.5), (2, 2.5)
    ]  # fmt: skip
    assert lab._commands[-1].time_s == lab._plant._promised * STEP_S
    lab.restart()
    newest = lab._plant.taken(0.0)[0]
    assert lab._zero == (newest.number, newest.time_s) == (21, pytest.approx(21 * STEP_S))
    (first,) = lab._commands
    assert (first.number, first.volts) == (0, lab._safe)
    assert first.time_s == max(lab._plant._promised * STEP_S, newest.time_s)
    advance(lab._plant, 2)
    samples = lab._plant.taken(0.0)
    registers = [0] * 400
    lab._show_samples(0.0, 0, registers, samples)

    def numbers(count, stride, records):
        places = [place * stride + count.address for place in range(records)]
        return [count.decode(registers[at : at + count.width]) for at in places]

    told = plan.samples
    found = numbers(told.counter, told.stride, told.records)
    assert found[:3] == [2, 1, 0] and set(found[3:]) <= {0}, "what is not there repeats the oldest"
    tick_s = told.time.tick_s
    times = numbers(told.time, told.stride, told.records)
    assert times[:3] == [round(k * STEP_S / tick_s) for k in (2, 1, 0)]
