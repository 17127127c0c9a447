# SPDX-License-Identifier: Apache-2.0
"""An arm's emulated amplifier and the plant behind it, step by step in a time that is made up."""

import math
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pneu_common.errors import InputError
from pneu_hw_bridge.hand_lab.amplifier import FAULTS, Amplifier
from pneu_hw_bridge.hand_lab.plant import HandPlant
from pneu_hw_bridge.phantom.emulated import FRAME, TORQUES
from pneu_hw_bridge.phantom.net_ft import read_calibration
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.truth import Truth
from pneu_sim.hand.world import Reading, World

HAND = Path(__file__).parents[3] / "scenes/phantom/hand.yaml"
NONE = [0.0, 0.0, 0.0]
TORQUE = [0.25, -0.5, 0.125]
COUNTS = (7, -80, 900)


class Loop:
    """The loop at the other end of an amplifier's socket."""

    def __init__(self, path: Path) -> None:
        self.link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.link.connect(str(path))
        self.link.setblocking(False)

    def send(self, torque: list[float], number: int = 3) -> None:
        self.link.send(TORQUES.pack(number, *torque))

    def frames(self) -> list[tuple[int, ...]]:
        """All that was told since; an empty one where the amplifier has hung up."""
        out: list[tuple[int, ...]] = []
        while True:
            try:
                packet = self.link.recv(100)
            except BlockingIOError:
                return out
            except ConnectionResetError:  # what was told before comes next
                continue
            out.append(FRAME.unpack(packet) if packet else ())
            if not packet:
                return out


@pytest.fixture
def amplifier(tmp_path: Path) -> Iterator[Amplifier]:
    one = Amplifier(tmp_path / "made" / "arm.sock")
    yield one
    one.close()


@pytest.fixture
def loop(amplifier: Amplifier) -> Iterator[Loop]:
    one = Loop(amplifier.path)
    yield one
    one.link.close()


def test_torques_hold_for_as_long_as_the_watchdog_lets_them(
    amplifier: Amplifier, loop: Loop
) -> None:
    assert (amplifier.zero_s, amplifier.heard_s) == (-math.inf, -math.inf)
    assert amplifier.take(10.0) == NONE and amplifier.zero_s == -math.inf
    loop.send(NONE)
    loop.send(TORQUE)
    assert amplifier.take(10.5) == TORQUE  # the newest
    assert (amplifier.heard_s, amplifier.zero_s, amplifier.let_go) == (10.5, None, 0)
    assert amplifier.take(10.5 + 0.0049) == TORQUE
    assert amplifier.take(10.5 + 0.0051) == NONE
    assert (amplifier.zero_s, amplifier.let_go) == (10.5051, 1)
    assert amplifier.take(11.0) == NONE
    assert (amplifier.zero_s, amplifier.let_go) == (10.5051, 1)
    loop.send([0.0, 0.0, -0.5])
    assert amplifier.take(12.0) == [0.0, 0.0, -0.5] and amplifier.zero_s is None
    loop.send(NONE)
    assert amplifier.take(12.001) == NONE
    assert (amplifier.zero_s, amplifier.let_go) == (12.001, 1)
    assert amplifier.take(13.0) == NONE
    assert amplifier.let_go == 1, "there was nothing to let go"


def test_what_it_gives_is_not_its_own_list(amplifier: Amplifier, loop: Loop) -> None:
    loop.send(TORQUE)
    amplifier.take(1.0)[0] = 9.0
    assert amplifier.torque_n_m == TORQUE


@pytest.mark.parametrize(
    ("fault", "torque", "frames"),
    [
        ("none", TORQUE, [(123, 7, -80, 900, 0)]),
        ("gone", NONE, [()]),
        ("frozen", TORQUE, []),
        ("jump", TORQUE, [(123, 257, -80, 900, 0)]),
        ("amplifier", NONE, [(123, 7, -80, 900, 1)]),
    ],
)
def test_what_an_amplifier_does_with_a_fault(
    amplifier: Amplifier, loop: Loop, fault: str, torque: list[float],
    frames: list[tuple[int, ...]],
) -> None:  # fmt: skip
    amplifier.take(1.0)
    loop.send(TORQUE)
    amplifier.fault = fault
    assert amplifier.take(1.001) == torque
    amplifier.tell(COUNTS, 123)
    assert loop.frames() == frames
    assert amplifier.zero_s == (None if any(torque) else -math.inf)
    amplifier.fault = "none"
    if fault == "gone":
        loop.link.close()
        loop.__init__(amplifier.path)  # type: ignore[misc]
    loop.send(TORQUE)
    assert amplifier.take(1.002) == TORQUE
    amplifier.tell((1, 2, 3), 456)
    assert loop.frames() == [(456, 1, 2, 3, 0)]


def test_every_fault_of_an_amplifier_is_tested() -> None:
    (table,) = test_what_an_amplifier_does_with_a_fault.pytestmark  # type: ignore[attr-defined]
    assert tuple(row[0] for row in table.args[1]) == FAULTS


def test_while_it_is_gone_it_takes_no_call(amplifier: Amplifier, loop: Loop) -> None:
    loop.send(TORQUE)
    amplifier.fault = "gone"
    assert amplifier.take(1.0) == NONE
    amplifier.tell(COUNTS, 1)
    assert loop.frames() == []
    amplifier.fault = "none"
    assert amplifier.take(1.1) == TORQUE


@pytest.mark.parametrize("size", [0, 1, TORQUES.size - 1, TORQUES.size + 1])
def test_what_is_no_command_ends_the_call(amplifier: Amplifier, loop: Loop, size: int) -> None:
    loop.send(TORQUE)
    assert amplifier.take(1.0) == TORQUE
    if size > TORQUES.size:
        loop.link.send(b"x" * size)  # what is too long is cut off, and taken for a command
        assert len(amplifier.take(1.001)) == 3
        return
    if size:
        loop.link.send(b"x" * size)
    else:
        loop.link.close()
        loop.link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    assert amplifier.take(1.001) == NONE
    assert amplifier.zero_s == 1.001
    amplifier.tell(COUNTS, 1)
    if size:
        assert loop.frames() == [()]
    again = Loop(amplifier.path)
    again.send(TORQUE)
    assert amplifier.take(1.002) == TORQUE
    again.link.close()


def test_whoever_does_not_read_does_not_hold_it_up(amplifier: Amplifier, loop: Loop) -> None:
    loop.send(TORQUE)
    amplifier.take(1.0)
    for number in range(20_000):
        amplifier.tell(COUNTS, number)
    assert amplifier.take(1.001) == TORQUE, "it has not hung up"
    frames = loop.frames()
    assert 10 < len(frames) < 20_000
    assert [frame[0] for frame in frames] == list(range(len(frames)))


def test_whoever_is_gone_is_hung_up_on(amplifier: Amplifier, loop: Loop) -> None:
    loop.send(TORQUE)
    amplifier.take(1.0)
    loop.link.close()
    amplifier.tell(COUNTS, 1)
    assert amplifier.torque_n_m == NONE


def test_one_amplifier_at_a_socket(amplifier: Amplifier, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        Amplifier(amplifier.path)
    assert str(caught.value) == f"{amplifier.path}: another emulated device listens there"
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError) as caught:
        Amplifier(tmp_path / "file" / "arm.sock")
    says = f"{tmp_path}/file/arm.sock: an emulated device cannot listen there (File exists)"
    assert str(caught.value) == says
    left = tmp_path / "left.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(left))  # as one leaves it that was killed
    one = Amplifier(str(left))
    assert one.path == left
    one.close()
    assert not left.exists()
    one.close()  # and again


# The plant


@pytest.fixture(scope="module")
def hand() -> Hand:
    return Hand(HAND)


class Steps:
    """Looks before each step, and ends the plant at the last."""

    def __init__(self, count: int, at: Any = None) -> None:
        self.count, self.at = count, at
        self.seen: list[float] = []

    def __call__(self, now_s: float) -> bool:
        self.seen.append(now_s)
        if self.at is not None:
            self.at(len(self.seen))
        return len(self.seen) <= self.count


def run(plant: HandPlant) -> None:
    """Runs it in a thread of its own, whose priority it may raise."""
    thread = threading.Thread(target=plant.run)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive()


def test_a_plant_that_has_not_moved_has_not_stood_still(hand: Hand, tmp_path: Path) -> None:
    plant = HandPlant(World(hand, Truth(), 0), tmp_path)
    try:
        assert (plant.stood_s, plant.failure, plant.origin_ns) == (0.0, "", 0)
        assert list(plant.amplifiers) == list(plant.boxes) == ["phantom"]
        assert plant.amplifiers["phantom"].path == tmp_path / "phantom.sock"
        box = plant.boxes["phantom"]
        assert box.port > 1023 and box.web_port > 1023
        found = read_calibration("127.0.0.1", box.web_port)
        assert found.counts_per_n == hand.settings.arms["phantom"].wrench.counts_per_n  # type: ignore[union-attr]
        ports = {"phantom": (box.port, box.web_port)}
        with pytest.raises(InputError, match=f"{box.port} or {box.web_port}: an emulated force"):
            HandPlant(World(hand, Truth(), 0), tmp_path / "other", ports)
        assert not (tmp_path / "other" / "phantom.sock").exists()
    finally:
        plant._close()
    other = HandPlant(World(hand, Truth(), 0), tmp_path, ports)
    assert (other.boxes["phantom"].port, other.boxes["phantom"].web_port) == ports["phantom"]
    other._close()


def test_a_plant_moves_until_it_is_told_to_end(hand: Hand, tmp_path: Path) -> None:
    heard: list[tuple[Reading, int]] = []
    world = World(hand, Truth(), 0)
    loops: list[Loop] = []
    looking = Steps(60, lambda count: loops[0].send([0.0, 0.02, 0.0]))
    plant = HandPlant(world, tmp_path, hear=lambda *one: heard.append(one), look=looking, rate=0.5)
    loops.append(Loop(tmp_path / "phantom.sock"))
    sent: list[tuple[int, list[float]]] = []
    plant.boxes["phantom"].send = lambda *one: sent.append(one)  # type: ignore[method-assign]
    run(plant)
    assert plant.failure == "" and len(looking.seen) == 61
    assert looking.seen == sorted(looking.seen)
    assert world.time_s == pytest.approx(60 * world.step_s)
    frames = loops[0].frames()
    assert frames.pop() == () and len(frames) == 60
    step_ns = round(1e9 * world.step_s)
    assert [frame[0] - plant.origin_ns for frame in frames] == [step_ns * k for k in range(60)]
    assert frames[-1][1:4] == tuple(world.counts("phantom"))
    assert frames[0][2] == 0 != frames[-1][2], "the torque has moved its joint"
    assert {reading.kind for reading, _ in heard} == {"imu", "pose"}
    for reading, stamp_ns in heard:
        assert stamp_ns - plant.origin_ns == round(1e9 * reading.time_s)
    rate_hz = hand.settings.arms["phantom"].wrench.rate_hz  # type: ignore[union-attr]
    assert [number for number, _ in sent] == list(range(round(60 * world.step_s * rate_hz)))
    assert not (tmp_path / "phantom.sock").exists()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", plant.boxes["phantom"].web_port), 1.0)


def test_a_plant_that_fails_says_why(hand: Hand, tmp_path: Path) -> None:
    world = World(hand, Truth(), 0)

    def fail(count: int) -> None:
        if count == 3:
            raise OSError("no look")

    plant = HandPlant(world, tmp_path, look=Steps(9, fail))
    run(plant)
    assert plant.failure == "the plant failed: no look"
    assert world.time_s == pytest.approx(2 * world.step_s)
    assert os.listdir(tmp_path) == []

    world = World(hand, Truth(), 0)
    world.time_s = 5.0
    plant = HandPlant(world, tmp_path, look=Steps(0))
    before_ns = time.time_ns()
    run(plant)
    assert before_ns <= plant.origin_ns + 5_000_000_000 <= time.time_ns()

    world = World(hand, Truth(), 0)
    moved = world.advance

    def run_away(torques: dict[str, list[float]]) -> list[Reading]:
        readings = moved(torques)
        if world.time_s > 1.5 * world.step_s:
            world.data.qacc[0] = math.nan
        return readings

    world.advance = run_away  # type: ignore[assignment, method-assign]
    plant = HandPlant(world, tmp_path, look=Steps(9))
    run(plant)
    assert plant.failure == "the plant failed: it ran away at 0.001 s"
    assert world.time_s == pytest.approx(2 * world.step_s)
