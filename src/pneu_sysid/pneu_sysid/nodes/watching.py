# SPDX-License-Identifier: Apache-2.0
"""A model run alongside a rig on the graph, in a thread beside the executor."""

import threading
from collections import deque
from collections.abc import Callable

from rclpy.node import Node

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.nodes.listening import Heard, Listening
from pneu_sysid.watch import Verdict, Watch, Window

LOOK_S = 0.02
"""How often new samples are looked for."""


class Watching:
    """Feeds a watch from the graph and judges its windows.

    Attributes:
        newest: The newest window; None as long as there is none.
        failure: Why the model cannot be run along; empty where it can.
        verdict: What the last windows say together.
    """

    def __init__(
        self,
        node: Node,
        rig: Rig,
        watch: Watch,
        verdict: Verdict,
        told: Callable[[Window], None],
        heard: Heard | None = None,
    ) -> None:
        """Subscribes; `start` sets it going.

        Args:
            node: The node.
            rig: The model.
            watch: Compares it.
            verdict: Judges it.
            told: Called from the thread with each window, after it is judged.
            heard: Called from it with each sample; it may be slow.
        """
        self.newest: Window | None = None
        self.failure = ""
        self.verdict = verdict
        self._node, self._watch, self._told, self._heard = node, watch, told, heard
        # Callbacks append, the thread takes: a deque needs no lock for that.
        self._arrived: deque[tuple[bool, str, float, float]] = deque(maxlen=500_000)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        Listening(node, rig, lambda *sample: self._arrived.append(sample))

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread and waits for it."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(LOOK_S):
            while self._arrived:
                is_command, name, time_s, value = self._arrived.popleft()
                (self._watch.command if is_command else self._watch.reading)(name, time_s, value)
                if self._heard is not None:
                    self._heard(is_command, name, time_s, value)
            try:
                window = self._watch.window()
                self.failure = ""
            except InputError as error:
                self.failure = f"the model cannot be run along: {error}"
                continue
            if window is not None and self._node.context.ok() and not self._ended.is_set():
                self.verdict.add(window)
                self.newest = window
                self._told(window)
