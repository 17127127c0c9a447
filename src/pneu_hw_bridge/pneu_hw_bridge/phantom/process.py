# SPDX-License-Identifier: Apache-2.0
"""A servo's process as its node sees it."""

import json
from collections.abc import Callable, Sequence
from typing import Any

from pneu_hw_bridge.child import Child
from pneu_hw_bridge.phantom.wire import (
    SAMPLES,
    JointSample,
    WrenchSample,
    packed_command,
    samples_of,
)
from pneu_sim.hand.drive import JointCommand


class ServoProcess(Child):
    """The process.

    Attributes:
        report: What it told last of how it does.
    """

    def __init__(
        self,
        settings: dict[str, Any],
        arrived: Callable[[Sequence[JointSample], Sequence[WrenchSample]], None],
        told: Callable[[], None],
    ) -> None:
        """Starts it and waits until it has opened its device.

        Args:
            settings: See `servo.run`.
            arrived: Called with samples, in a thread of its own.
            told: Called in that thread when there is a new report, or it has ended.

        Raises:
            InputError: It cannot open its device.
        """
        self.report: dict[str, Any] = {}
        self._arrived, self._told = arrived, told
        self._count = len(settings["joints"])
        super().__init__("pneu_hw_bridge.phantom.servo", settings, self._take)

    def command(self, command: Sequence[JointCommand], sent_s: float) -> None:
        """Hands on a command.

        Args:
            command: Of each joint.
            sent_s: When it was sent, by the steady clock.
        """
        self.send(packed_command(command, sent_s))

    def _take(self, message: bytes) -> None:
        if message[:1] == SAMPLES:
            self._arrived(*samples_of(message, self._count))
            return
        if message:
            told = json.loads(message[1:])
            if "gone" in told:
                self.ended = f"the device is gone: {told['gone']}"
            else:
                self.report = told
        self._told()
