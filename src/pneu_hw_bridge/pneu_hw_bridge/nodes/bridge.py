# SPDX-License-Identifier: Apache-2.0
"""What all bridges to hardware do alike: life cycle, settings, emergency stop, start and end."""

import signal
import sys
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from pneu_common.errors import InputError
from pneu_graph.nodes.common import EXIT_BAD_INPUT, Diagnostics, say_ready
from pneu_graph.nodes.lifetime import initialised
from pneu_hw_bridge.nodes.emergency import Emergency
from pneu_hw_bridge.priority import precedence

SWITCH_S = 5e-4
"""So long a thread may keep another one waiting that wants to run Python."""

REAL_TIME = "use_sim_time: found true; real devices keep the machine's time"


class Bridge(LifecycleNode):
    """A bridge: configure opens the hardware, safe; activate lets commands through; all else ends.

    A kind of bridge says how it opens, and what it means to be safe and closed.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """Offers the emergency stop; opens nothing yet. Parameters have to be declared after it.

        Args:
            name: Of the node.
            **options: For the node, such as its context or its parameter overrides.

        Raises:
            InputError: The node was told to use simulated time.
        """
        super().__init__(name, **options)
        if self.get_parameter("use_sim_time").value:
            raise InputError(REAL_TIME)
        self.add_on_set_parameters_callback(self._check_parameters)
        self._entities: list[tuple[Any, Any]] = []
        self._emergency = Emergency(self, self._stop, self._reset)
        self._diagnostics = Diagnostics(self, self._report)

    # What a kind of bridge says

    def make_safe(self, why: str) -> None:
        """Takes what is driven to where it is safe; needs no working graph.

        Args:
            why: For the log.
        """
        raise NotImplementedError

    def _let_through(self) -> None:
        """Lets commands through from now on."""
        raise NotImplementedError

    def _close(self) -> None:
        """Closes the hardware and destroys what configuring created."""
        for destroy, entity in self._entities:
            destroy(entity)
        self._entities = []

    def _stop(self, reason: str) -> tuple[bool, str]:
        """Stops until it is reset, from any thread; returns whether that is safe, and why."""
        raise NotImplementedError

    def _reset(self) -> str:
        """Releases the stop; returns why not, or nothing."""
        raise NotImplementedError

    def _report(self) -> list[DiagnosticStatus]:
        """Lines of its health."""
        raise NotImplementedError

    # Life cycle

    def start(self) -> None:
        """Configures and activates at once, where nothing manages the life cycle.

        Raises:
            InputError: The node cannot be configured.
        """
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise InputError("autostart: the node could not be configured, see its log")
        self.trigger_activate()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets commands through, where `pneu stop` reaches the bridge.

        Args:
            state: The state before.
        """
        if not self._emergency.ensure_listening():
            return TransitionCallbackReturn.FAILURE
        self._emergency.driving = True
        self._emergency.keep()  # before anything can move
        self._let_through()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Makes safe.

        Args:
            state: The state before.
        """
        self.make_safe("deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Makes safe and closes.

        Args:
            state: The state before.
        """
        self.make_safe("cleaned up")
        self._close()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Makes safe and closes.

        Args:
            state: The state before.
        """
        self.make_safe("shut down")
        self._close()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Makes safe and closes; the node can be configured anew.

        Args:
            state: The state before.
        """
        del state
        self.make_safe("error")
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def end(self) -> None:
        """Makes safe and closes, at the end of the process."""
        try:
            self.make_safe("end")
        finally:
            self._close()
            self._emergency.close()

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "use_sim_time" and parameter.value:
                return SetParametersResult(successful=False, reason=REAL_TIME)
            if self._entities and parameter.name != "use_sim_time":
                reason = f"{parameter.name}: can be set only before the node is configured"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)


def run_bridge(make: Callable[[], Bridge], args: list[str] | None) -> None:
    """Runs a bridge until it is told to end; what it drives is safe then, the graph gone or not.

    Args:
        make: Builds the node.
        args: Command line; None is the process's own.
    """
    node: Bridge | None = None
    try:
        # A thread that serves hardware gets its turn soon, however busy that of the node is.
        sys.setswitchinterval(SWITCH_S)
        with precedence(), initialised(args):
            _end_with_the_terminal()
            try:
                node = make()
                if node.get_parameter("autostart").value:
                    node.start()
                say_ready(node)
                rclpy.spin(node)
            finally:
                # The graph is already gone after a signal; the hardware is not.
                if node is not None:
                    node.end()
                    node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


def _end_with_the_terminal() -> None:
    """Has SIGHUP end the process as SIGTERM does: rclpy leaves it, and it would kill at once.

    Whoever ignores it on purpose (nohup) goes on doing so.
    """
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
