# SPDX-License-Identifier: Apache-2.0
"""The node between the topics of the graph and real valves and sensors on Modbus.

Topics: takes ``valve/command``; gives ``taps/<tap>/pressure``, ``taps/pressures``, ``joint_states``
of encoders, ``valve/applied`` (what the device has confirmed, stamped when it took effect) and the
state of the emergency stop, ``e_stop``; on demand ``/clock``, from a device that keeps time itself.
Services: ``~/e_stop`` and ``~/reset_e_stop``. Life cycle: configure opens the bus and reads, with
the valves vented; activate lets commands through; deactivate, an error, and the end of the process
vent, by writing to the bus and reading it back.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import ValveCommand
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from pneu_common.errors import InputError
from pneu_graph.nodes.common import (
    COMMAND_QOS,
    READINGS_QOS,
    status,
    steady_clock,
    to_stamp,
)
from pneu_graph.nodes.executor_callback import ExecutorCallback
from pneu_hw_bridge.device_clock import DeviceClock
from pneu_hw_bridge.link import Link, Sample
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.nodes.bridge import Bridge, run_bridge
from pneu_hw_bridge.nodes.readings import ReadingsPublisher
from pneu_hw_bridge.nodes.settings import BridgeParameters
from pneu_hw_bridge.nodes.signals import told, topics_of
from pneu_hw_bridge.nodes.writers import Writers
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.bound import Bound, bound, check
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.stops import stops_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor
from pneu_sim import topics
from pneu_sim.rig import load_rig

LOOK_S = 0.05
"""Period with which the publishers of commands are looked at, s."""

BEHIND_S = 0.1
"""A device's clock that has fallen behind by more is told of."""

CYCLES_TO_TELL = 20
"""After so many it is known how quick a device is."""

NO_WATCHDOG = (
    "its register map has no device.watchdog_s: if this bridge is killed or its line cut, the"
    " valves STAY AS THEY ARE"
)


class ValveBridge(Bridge):
    """The node; what it decides is in `pneu_hw_bridge.safety`, what it sends in `.modbus`."""

    def __init__(self, **options: Any) -> None:
        """Declares parameters and offers the emergency stop; opens nothing yet.

        Args:
            **options: For the node, such as its context or its parameter overrides.

        Raises:
            InputError: The node was told to use simulated time.
        """
        self._bus: ModbusBus | None = None
        self._link: Link | None = None
        super().__init__("valve_bridge", **options)
        self._params = BridgeParameters.declare(self)
        self._readings: ReadingsPublisher | None = None
        self._skipped = 0
        self._bound: Callable[[float, float, float], Bound] | None = None
        self._bound_told = False
        self._unwatched: list[str] = []
        self._commands: list[topics.Topic] = []
        self._writers: Writers | None = None
        self._applied = self.create_publisher(ValveCommand, topics.APPLIED_TOPIC, READINGS_QOS)

    # Life cycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Opens the bus and begins to read, valves vented.

        Args:
            state: The state before.
        """
        try:
            settings = self._params  # which nobody can set until the node is cleaned up
            registers = load_register_map(settings.register_map, settings.device)
            if settings.publish_clock and registers.clock is None:
                raise InputError(
                    f"publish_clock: register map {settings.register_map!r} names no clock of the"
                    " device"
                )
            rig = load_rig(settings.rig) if settings.rig else None
            self._commands, taps, encoders = topics_of(rig, registers)
            limits = limits_of(
                registers,
                settings.watchdog_s,
                settings.sensor_timeout_s,
                settings.slew_v_s,
                settings.clamp_margin_v,
                settings.dwell_s,
                settings.safe_within_s,
                None if rig is None else stops_of(rig),
            )
            check(registers, limits, 1.0 / settings.rate_hz, settings.timeout_s)
            self._emergency.recall(registers.device.where)
            arrived = ExecutorCallback(self, self._on_samples)
            self._entities.append((ExecutorCallback.destroy, arrived))
            self._link = Link(
                Supervisor(limits, self._emergency.latches),
                arrived.trigger,
                max(1, round(settings.rate_hz / settings.publish_rate_hz)),
                registers.clock is not None,
            )
            clock = self.get_clock()
            self._skipped = 0
            self._bound_told = False
            self._bus = ModbusBus(
                registers,
                self._link,
                1.0 / settings.rate_hz,
                settings.timeout_s,
                lambda: int(clock.now().nanoseconds),
            )
        except InputError as error:
            self.get_logger().error(str(error))
            self._close()
            return TransitionCallbackReturn.FAILURE
        self._readings = ReadingsPublisher(
            self, registers, [*taps, *encoders], settings.frame_id, settings.publish_clock
        )
        listeners = {
            topic.name: self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                self._listening_to(topic),
                COMMAND_QOS,
            )
            for topic in self._commands
        }
        self._entities += [(self.destroy_subscription, one) for one in listeners.values()]
        self._writers = Writers(self, listeners, settings.commander)
        look = self.create_timer(LOOK_S, self._look_around, clock=steady_clock())
        self._entities.append((self.destroy_timer, look))
        if registers.device.watchdog_s is None:
            self.get_logger().error(f"{registers.name}: {NO_WATCHDOG}")
        self._unwatched = [
            name for name, tap in registers.taps.items() if tap.frozen_after_s is None
        ] + [name for name, one in registers.encoders.items() if one.frozen is None]
        if self._unwatched:
            self.get_logger().warning(
                f"{registers.name}: no frozen_after_s, or frozen of an encoder, for"
                f" {', '.join(self._unwatched)}: nobody would notice a sensor that always says the"
                " same"
            )
        self._bound = functools.partial(bound, registers, limits)
        self._bus.start()
        return super().on_configure(state)

    def _let_through(self) -> None:
        """Lets commands through from now on."""
        if self._link is not None:
            self._look_around()
            self._link.enable(True)

    def make_safe(self, why: str) -> None:
        """Vents: writes the safe voltages to the bus and reads them back.

        Args:
            why: For the log.
        """
        if self._link is None or self._bus is None:
            return
        self._link.enable(False)
        vented = self._bus.vent()
        self._emergency.driving = False
        self._emergency.keep()
        if vented.verified:
            self.get_logger().info(
                f"{why}: vented in {1e3 * vented.duration_s:.1f} ms, {vented.message}"
            )
        else:
            self.get_logger().error(
                f"{why}: venting is not confirmed ({vented.message}); the device's own watchdog"
                " has to vent"
            )

    def _close(self) -> None:
        """Closes the bus and destroys what configuring created."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.stop()
        super()._close()
        if self._readings is not None:
            self._readings.destroy()
        self._readings = None
        self._link = self._writers = None

    # Graph

    def _listening_to(self, topic: topics.Topic) -> Callable[[Any, dict[str, Any]], None]:
        """The callback of a topic with commands; its arguments are counted, so it has two."""

        def heard(message: Any, info: dict[str, Any]) -> None:
            self._on_command(topic, message, info)

        return heard

    def _on_command(self, topic: topics.Topic, message: Any, info: dict[str, Any]) -> None:
        link, bus, writers = self._link, self._bus, self._writers
        if link is None or bus is None or writers is None:
            return
        volts, refused = told(topic, message)
        if refused:
            link.malformed()
        else:
            if not writers.is_known(topic.name, info):
                link.publishers(*writers.look(info))  # before anything of a new one is followed
            refused = link.command(volts, writers.sent_s(info))
        if not refused:
            bus.poke()
        elif refused != "not active":
            self.get_logger().warning(
                f"{topic.name}: refused, {refused}", throttle_duration_sec=1.0
            )

    def _on_samples(self) -> None:
        link, readings = self._link, self._readings
        if link is None or readings is None:
            return
        for sample in link.take_applied():
            self._say_applied(sample)
        samples = link.take()
        for sample in samples:
            readings.publish(sample)
        if samples:
            readings.publish_clock(samples[-1].stamp_ns)

    def _say_applied(self, sample: Sample) -> None:
        """Publishes what the device has confirmed, with the time at which it took effect."""
        message = ValveCommand(name=list(sample.values), voltage_v=list(sample.values.values()))
        message.header.stamp = to_stamp(sample.stamp_ns)
        self._applied.publish(message)

    def _look_around(self) -> None:
        """Looks at publishers and reports changes of state, here so that flutter floods no log."""
        link, writers = self._link, self._writers
        if link is None or writers is None:
            return
        link.publishers(*writers.look())
        self._say_clock()
        self._say_bound(link)
        changes = link.take_changes()
        for state, reason in changes:
            text = f"{state.value}{': ' if reason else ''}{reason}"
            if state in (State.E_STOP, State.TRIPPED):
                self.get_logger().error(text)
            elif state is State.HOLDING:
                self.get_logger().warning(text)
            else:
                self.get_logger().info(text)
        if changes:
            self._emergency.keep()
            self._diagnostics.publish()

    def _say_bound(self, link: Link) -> None:
        """Logs once how soon the valves are safe, as soon as that was measured."""
        bus = self._bus
        if self._bound_told or bus is None or bus.statistics.cycles < CYCLES_TO_TELL:
            return
        self._bound_told = True
        found = self._worst(link, bus)
        say = self.get_logger().info if math.isfinite(found.dead_s) else self.get_logger().warning
        say(f"{found} ({bus.lines} connections)")

    def _worst(self, link: Link, bus: ModbusBus) -> Bound:
        """How soon the valves are safe, at worst, as replies are now."""
        assert self._bound is not None
        return self._bound(bus.reads_s(0.95), bus.takes_s(0.95), link.watchdog_s)

    def _say_clock(self) -> None:
        """Logs what became of the device's clock."""
        clock = self._bus.clock if self._bus is not None else None
        while clock is not None and clock.told:
            self.get_logger().warning(f"{clock.told.popleft()}: the clocks are compared anew")

    def _stop(self, reason: str) -> tuple[bool, str]:
        """Stops until it is reset; returns whether the valves are known to be safe, and why.

        From any thread.
        """
        link, bus = self._link, self._bus
        if link is None or bus is None:
            latches = self._emergency.latches
            latches.e_stop = latches.e_stop or reason
            return True, "latched; the bus is not open"
        link.e_stop(reason)
        vented = bus.vent()
        return vented.verified, vented.message

    def _reset(self) -> str:
        """Releases the stop; returns why not, or nothing."""
        if self._link is not None:
            return self._link.reset()
        if self._emergency.latches.trip:
            return "the bus is not open, so the pressures are not known"
        self._emergency.latches.e_stop = ""
        return ""

    def _report(self) -> list[DiagnosticStatus]:
        name = self.get_name()
        link, bus = self._link, self._bus
        if link is None or bus is None:
            level = (
                DiagnosticStatus.ERROR if self._emergency.latches.e_stop else DiagnosticStatus.OK
            )
            message = (
                f"e-stop: {self._emergency.latches.e_stop}"
                if self._emergency.latches.e_stop
                else "not open"
            )
            return [status(level, f"{name}: safety", message, {}, "modbus")]
        report = link.report()
        level = {
            State.FOLLOWING: DiagnosticStatus.OK,
            State.DISABLED: DiagnosticStatus.OK,
            State.HOLDING: DiagnosticStatus.WARN,
        }.get(report.state, DiagnosticStatus.ERROR)
        message = report.state.value + (f": {report.reason}" if report.reason else "")
        values: dict[str, object] = {
            **{f"{one} [V]": volts for one, volts in report.output.items()},
            **{f"{one} [SI]": value for one, value in report.readings.items()},
            **report.counters,
            "samples dropped": report.dropped,
            "not watched for being frozen": ", ".join(self._unwatched) or "none",
        }
        safety = status(level, f"{name}: safety", message, values, "modbus")
        counts = bus.statistics
        worst = self._worst(link, bus)
        values = {
            **{f"safe after {event} [s]": s for event, s in worst.by_event().items()},
            **counts.counters(),
            "connections": bus.lines,
            "outputs can be read back": bus.readable,
            "request p50 [s]": counts.request.quantile(0.5),
            "request p99 [s]": counts.request.quantile(0.99),
            "command to confirmation p50 [s]": counts.command.quantile(0.5),
            "command to confirmation p99 [s]": counts.command.quantile(0.99),
        }
        level = DiagnosticStatus.ERROR if bus.fault else DiagnosticStatus.OK
        text = bus.fault or "works"
        if math.isinf(worst.dead_s):
            level = max(level, DiagnosticStatus.WARN)
            text = f"{text}; {NO_WATCHDOG}"
        lines = [safety, status(level, f"{name}: bus", text, values, "modbus")]
        return lines if bus.clock is None else [*lines, self._report_clock(bus, bus.clock)]

    def _report_clock(self, bus: ModbusBus, clock: DeviceClock) -> DiagnosticStatus:
        """How the device's clock does, and whether samples were lost since the report before."""
        skipped = bus.statistics.samples_skipped + bus.statistics.commands_skipped
        lost, self._skipped = skipped - self._skipped, skipped
        told = []
        if not clock.settled:
            told.append("compared with this machine's, no stamps yet")
        if clock.behind_s > BEHIND_S:
            told.append(f"{clock.behind_s:.3f} s behind since it was compared")
        if lost > 0:
            told.append(f"{lost} samples or commands were forgotten before they were read")
        values: dict[str, object] = {
            "behind [s]": clock.behind_s,
            "drift [ppm]": 1e6 * clock.drift,
            "compared anew": clock.restarts,
        }
        level = DiagnosticStatus.WARN if told else DiagnosticStatus.OK
        text = "; ".join(told) or "works"
        return status(level, f"{self.get_name()}: device clock", text, values, "modbus")


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_bridge(ValveBridge, args)


if __name__ == "__main__":
    main()
