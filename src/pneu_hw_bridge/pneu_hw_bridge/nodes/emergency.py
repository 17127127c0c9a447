# SPDX-License-Identifier: Apache-2.0
"""How a bridge is stopped, by whomever, and how that outlives it: the same for all bridges.

Services ``~/e_stop`` and ``~/reset_e_stop``; the topic ``e_stop`` of the namespace, which all its
bridges obey; `pneu stop` by a socket, in a thread of its own. Stop, trip and whether anything may
be driven are kept for the next start.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from pneu_common.text import one_line
from pneu_graph.nodes.executor_callback import ExecutorCallback
from pneu_hw_bridge.safety.memory import Memory
from pneu_hw_bridge.safety.supervisor import Latches
from pneu_hw_bridge.stopping import LONGEST_REASON, StopListener, call_all

MOST_CALLS = 64
"""Calls for a stop that the node has still to hear of."""

AFTER_RESET = "commands are followed after a safe one, or once the bridge is activated again"

LISTEN_AGAIN_S = 1.0
"""After so long at most a socket that was removed is there again."""

E_STOP_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""A state that late joiners must learn."""


class Emergency:
    """The emergency stop of a bridge.

    Attributes:
        latches: What is stopped or tripped, and why.
        driving: Whether commands may be followed, as the next start is to know.
    """

    def __init__(
        self,
        node: Node,
        stop: Callable[[str], tuple[bool, str]],
        reset: Callable[[], str],
    ) -> None:
        """Begins to listen.

        Args:
            node: The bridge.
            stop: Stops with a reason until it is reset, from any thread; returns whether what is
                driven is known to be safe, and why.
            reset: Releases the stop where nothing speaks against it; returns why not, or nothing.
        """
        self._node = node
        self._stop, self._reset = stop, reset
        self.latches = Latches()
        self.driving = False
        self._device = ""
        # Kept, as the thread that takes stops may need them after the node was destroyed.
        self._name, self._namespace = node.get_fully_qualified_name(), node.get_namespace()
        self._memory: Memory | None = None
        self._calls: deque[Mapping[str, Any]] = deque(maxlen=MOST_CALLS)
        self._publisher = node.create_publisher(Bool, "e_stop", E_STOP_QOS)
        node.create_service(Trigger, "~/e_stop", self._on_e_stop)
        node.create_service(Trigger, "~/reset_e_stop", self._on_reset)
        self._called = ExecutorCallback(node, self._on_called)
        self._ear: StopListener | None = None
        self.ensure_listening()
        node.create_subscription(Bool, "e_stop", self._on_stop_of_others, E_STOP_QOS)
        # whoever clears the folder of sockets must not make the bridge deaf
        node.create_timer(LISTEN_AGAIN_S, self.ensure_listening)
        self.say()

    def recall(self, device: str) -> None:
        """Remembers what was latched when the bridge before ended.

        Args:
            device: Where the device is reached.
        """
        self._device = device
        self._memory = Memory(self._name, device)
        before = self._memory.recall()
        if before.e_stop or before.trip:
            self._node.get_logger().error(
                f"stopped before this start, and not reset: {before.e_stop or before.trip}"
            )
        self.latches.e_stop = self.latches.e_stop or before.e_stop
        self.latches.trip = self.latches.trip or before.trip
        self.say()

    def ensure_listening(self) -> bool:
        """Listen for `pneu stop` if this bridge does not yet, and return whether it does.

        Without that nothing may be driven.
        """
        if self._ear is not None and not self._ear.listening:
            self._ear.close()
            self._ear = None
        if self._ear is None:
            try:
                self._ear = StopListener(self._name, self._on_call)
            except OSError as error:
                self._node.get_logger().error(
                    f"'pneu stop' cannot reach this bridge, which so drives nothing: {error}",
                    throttle_duration_sec=10.0,
                )
        return self._ear is not None

    def keep(self) -> None:
        """Keeps for the next start what must not be forgotten."""
        if self._memory is None:
            return
        try:
            self._memory.keep(self.latches, self.driving)
        except OSError as error:
            self._node.get_logger().error(
                f"a stop would be forgotten by a restart: {error}", throttle_duration_sec=10.0
            )

    def say(self) -> None:
        """Tells the graph whether it is stopped."""
        self._publisher.publish(Bool(data=bool(self.latches.e_stop)))

    def close(self) -> None:
        """Ends listening."""
        if self._ear is not None:
            self._ear.close()
        self._called.destroy()

    def _on_e_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        response.success, response.message = self._stop("called for by service")
        self._after_stop()
        return response

    def _on_call(self, asked: Mapping[str, Any]) -> Mapping[str, Any]:
        """Stops on a word to the socket, in its thread; the node learns of it afterwards."""
        device, space = asked.get("device"), asked.get("namespace")
        shared = device is None and space is None  # all are meant
        if not (shared or device == self._device or space == self._namespace):
            return {}
        before = self.latches.e_stop
        reason = one_line(asked.get("reason") or "called for", LONGEST_REASON)
        safe, message = self._stop(reason)
        self._calls.append({"passed": "by" in asked, "before": before})
        self._called.trigger()
        return {
            "bridge": self._name,
            "safe": safe,
            "message": message,
        }

    def _on_called(self) -> None:
        while self._calls:
            call = self._calls.popleft()
            if not call["before"]:
                self._after_stop(pass_on=not call["passed"])

    def _on_stop_of_others(self, message: Bool) -> None:
        """Obeys the stop of another bridge in the namespace."""
        if message.data and not self.latches.e_stop:
            self._stop("another bridge of this namespace was stopped")
            self._after_stop()

    def _after_stop(self, pass_on: bool = True) -> None:
        """Tells all who have to know: the graph, the next start, whoever shares the device."""
        self.say()
        self.keep()
        if pass_on:
            call_all(
                {
                    "reason": f"{self._name}: {self.latches.e_stop}",
                    "by": self._name,
                    "device": self._device,
                    "namespace": self._namespace,
                },
                but=self._ear.path if self._ear is not None else None,
            )

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        refused = self._reset()
        response.success = not refused
        response.message = refused or f"released; {AFTER_RESET}"
        self.keep()
        self.say()
        return response
