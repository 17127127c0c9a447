# SPDX-License-Identifier: Apache-2.0
"""The process of an emulated hand: its plant keeps time whatever its node is busy with."""

import contextlib
import json
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_hw_bridge.child import JSON, LONGEST, Child, packed
from pneu_hw_bridge.hand_lab.hidden import open_truth
from pneu_hw_bridge.hand_lab.plant import HandPlant
from pneu_hw_bridge.priority import precedence
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.operator import Operator
from pneu_sim.hand.truth import Truth
from pneu_sim.hand.world import Reading, World

Floats = NDArray[np.float64]

READINGS = b"R"
KINDS = ("imu", "pose", "touch")
TOGETHER_S = 0.002
"""Readings of so long are sent together."""
REPORT_S = 0.5

_READING = struct.Struct("<BBQq7d")


class PlantProcess(Child):
    """The process, as the node sees it.

    Attributes:
        report: What it told last of how the plant does.
    """

    def __init__(
        self,
        settings: dict[str, Any],
        names: dict[str, list[str]],
        heard: Callable[[str, str, int, Floats], None],
        flushed: Callable[[], None],
    ) -> None:
        """Starts it.

        Args:
            settings: See `run`.
            names: Of what tells each kind of reading.
            heard: Called with kind, name, time by the plant's clock, ns, and values.
            flushed: Called after several of them, with a new report, and when it has ended.

        Raises:
            InputError: It cannot be started so.
        """
        self.report: dict[str, Any] = {}
        self._names, self._reading, self._flushed = names, heard, flushed
        super().__init__("pneu_hw_bridge.hand_lab.process", settings, self._take)

    def _take(self, message: bytes) -> None:
        if message[:1] == READINGS:
            for kind, index, _, stamp_ns, *values in _READING.iter_unpack(message[1:]):
                of = KINDS[kind]
                width = 7 if of == "pose" else 6
                self._reading(of, self._names[of][index], stamp_ns, np.array(values[:width]))
        elif message:
            self.report = json.loads(message[1:])
        self._flushed()


def run(link: socket.socket) -> None:
    """Runs a plant until its node ends or tells it to.

    Args:
        link: To the node, whose first message says what is emulated.
    """
    told = json.loads(link.recv(LONGEST)[1:])
    batch: list[bytes] = []
    flush_s = 0.0
    try:
        hand = Hand(told["hand"])
        truth = open_truth(told["truth"]) if told["truth"] else Truth()
        held = told["operator"]
        operator = Operator(hand, **held) if held else None
        world = World(hand, truth, told["seed"], touch=told["touch"], operator=operator)
        names = {
            "imu": list(hand.settings.imus),
            "pose": list(hand.settings.poses),
            "touch": list(hand.settings.arms),
        }

        def hear(reading: Reading, stamp_ns: int) -> None:
            nonlocal flush_s
            values = [*reading.values.tolist(), 0.0][:7]
            at = KINDS.index(reading.kind), names[reading.kind].index(reading.name)
            batch.append(_READING.pack(*at, reading.number, stamp_ns, *values))
            now_s = time.monotonic()
            if now_s > flush_s + TOGETHER_S:
                flush_s = now_s
                with contextlib.suppress(OSError):  # the node is busy, or has ended
                    link.send(READINGS + b"".join(batch))
                batch.clear()

        ports = {arm: tuple(pair) for arm, pair in told["ports"].items()}
        looking = _looking(link)
        plant = HandPlant(
            world,
            Path(told["devices"]),
            ports,
            hear,
            look=lambda now_s: looking(plant, now_s),
            rate=told["rate"],
        )
    except InputError as error:
        link.send(packed({"failed": str(error)}))
        return
    link.send(packed({"ready": hand.settings.name}))
    link.setblocking(False)
    spare_what_stays()
    plant.run()
    if plant.failure:
        with contextlib.suppress(OSError):
            link.send(packed({"failure": plant.failure, "let_go": {}}))


def _looking(link: socket.socket) -> Callable[[HandPlant, float], bool]:
    """Takes what the node tells, and tells it how the plant does, between two steps."""
    told_s = -REPORT_S

    def look(plant: HandPlant, now_s: float) -> bool:
        nonlocal told_s
        if now_s > told_s + REPORT_S:
            told_s = now_s
            report = {
                "stood_s": plant.stood_s,
                "plant_s": plant.world.time_s,
                "failure": plant.failure,
                "let_go": {arm: a.let_go for arm, a in plant.amplifiers.items()},
            }
            with contextlib.suppress(BlockingIOError):
                link.send(packed(report))
        try:
            message = link.recv(LONGEST)
        except BlockingIOError:
            return True
        except OSError:
            return False
        if not message:
            return False
        if message[:1] != JSON:
            return True
        told = json.loads(message[1:])
        for one in plant.amplifiers.values():
            one.fault = told.get("arm_fault", one.fault)
        for its in plant.boxes.values():
            its.fault = told.get("sensor_fault", its.fault)
        if "answer" in told:
            zero = {arm: a.zero_s for arm, a in plant.amplifiers.items()}
            torques = {arm: a.torque_n_m for arm, a in plant.amplifiers.items()}
            with contextlib.suppress(OSError):
                link.send(packed({"answer": told["answer"], "zero_s": zero, "torques": torques}))
        return not told.get("end")

    return look


def main() -> None:
    """Runs the plant on the socket whose number is the argument."""
    with precedence(), socket.socket(fileno=int(sys.argv[1])) as link:
        sys.setswitchinterval(1e-4)
        run(link)


if __name__ == "__main__":
    main()
