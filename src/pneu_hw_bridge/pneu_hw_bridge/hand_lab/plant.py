# SPDX-License-Identifier: Apache-2.0
"""The plant behind emulated devices, in real time as far as the machine lets it.

Its time is its own: it begins at the time of day, and where the machine is late by more than a
moment it stands still rather than jump. What is stamped by it is right however busy the machine
is.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path

from pneu_hw_bridge.hand_lab.amplifier import Amplifier
from pneu_hw_bridge.hand_lab.box import Box
from pneu_hw_bridge.priority import punctual
from pneu_sim.hand.pace import Pace
from pneu_sim.hand.world import Reading, World


class HandPlant:
    """The plant and its devices.

    Attributes:
        world: What moves.
        amplifiers: By the names of arms.
        boxes: Force sensors, by the names of arms.
        origin_ns: The time of day at which plant time began.
        stood_s: For how long it stood still.
        failure: Why it ended; empty where it was told to.
    """

    def __init__(
        self,
        world: World,
        folder: str | Path,
        ports: dict[str, tuple[int, int]] | None = None,
        hear: Callable[[Reading, int], None] | None = None,
        look: Callable[[float], bool] | None = None,
        rate: float = 1.0,
    ) -> None:
        """Opens the devices; nothing moves yet.

        Args:
            world: What moves.
            folder: Of the sockets.
            ports: UDP and web port of each arm's force sensor; free ones unless given.
            hear: Called with what inertial units and motion capture read, and its time, ns.
            look: Called before each step with the steady time; whether to go on.
            rate: Seconds of the plant in one of the machine's.

        Raises:
            InputError: A socket or a port cannot be had.
        """
        self.world = world
        self.stood_s = 0.0
        self.failure = ""
        self.origin_ns = 0
        self._hear = hear
        self._look = look
        self._rate = rate
        self.amplifiers: dict[str, Amplifier] = {}
        self.boxes: dict[str, Box] = {}
        try:
            for arm, its in world.hand.settings.arms.items():
                self.amplifiers[arm] = Amplifier(Path(folder) / f"{arm}.sock")
                if its.wrench is not None:
                    port, web = (ports or {}).get(arm, (0, 0))
                    self.boxes[arm] = Box(its.wrench, port=port, web_port=web)
        except BaseException:
            self._close()
            raise

    def run(self) -> None:
        """Lets it move, until it is told to end."""
        try:
            self._run()
        finally:
            self._close()

    def _close(self) -> None:
        for amplifier in self.amplifiers.values():
            amplifier.close()
        for box in self.boxes.values():
            box.close()

    def _run(self) -> None:
        try:
            punctual()
            self._move()
        except Exception as error:
            self.failure = f"the plant failed: {error}"

    def _counts(self, arm: str) -> tuple[int, int, int]:
        counts = (*self.world.counts(arm), 0, 0, 0)
        return counts[0], counts[1], counts[2]

    def _move(self) -> None:
        world = self.world
        self.origin_ns = time.time_ns() - round(1e9 * world.time_s)
        pace = Pace(world.time_s, self._rate)
        while True:
            now_s = pace.wait(world.time_s)
            self.stood_s = pace.stood_s
            torques = {
                arm: amplifier.take(now_s)[: len(world.arms[arm])]
                for arm, amplifier in self.amplifiers.items()
            }
            if self._look is not None and not self._look(now_s):
                return
            read_ns = self.origin_ns + round(1e9 * world.time_s)
            readings = world.advance(torques)
            for arm, amplifier in self.amplifiers.items():
                amplifier.tell(self._counts(arm), read_ns)
            for box in self.boxes.values():
                box.poll()
            for reading in readings:
                if reading.kind == "wrench":
                    self.boxes[reading.name].send(reading.number, reading.values.tolist())
                elif self._hear is not None:
                    self._hear(reading, self.origin_ns + round(1e9 * reading.time_s))
            if not math.isfinite(world.data.qacc[0]):
                raise ArithmeticError(f"it ran away at {world.time_s:.3f} s")
