# SPDX-License-Identifier: Apache-2.0
"""The simulator node: a rig file as a live rig, in real time, at a factor, or in lock-step.

It is a plain node, not a lifecycle one: there is no hardware to open or to make safe, and a rig
without commands rests with its valves in their safe state. The gas is advanced in a thread of its
own, one control period at a time, so that no callback ever waits for numerics; callbacks leave
commands and requests for that thread. Parameters and topics: see ``ros_ws/README.md``.
"""

import math
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import LineState, TapPressures, ValveCommand
from pneu_msgs.srv import ResetSimulator, StepSimulator
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import FluidPressure, JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.models import kind_of
from pneu_sim.nodes.stepper import Inputs, Pacing, Sample, Stepper
from pneu_sim.rig import load_rig


@dataclass
class SimulatorParameters(Parameters):
    """What the simulator node is told."""

    rig: str = parameter("", "Path of the rig file.", read_only=True)
    pace: str = parameter(
        "real_time",
        "real_time follows the clock, times `factor`; as_fast_as_possible does not wait; lock_step"
        " waits for ~/step.",
        choices=("real_time", "as_fast_as_possible", "lock_step"),
        read_only=True,
    )
    factor: float = parameter(
        1.0, "Simulated seconds per second, for real_time.", within=(0.01, 100.0)
    )
    publish_rate_hz: float = parameter(
        500.0,
        "Control rate in simulated time: commands are taken and taps published this often, Hz.",
        within=(1.0, 5000.0),
        read_only=True,
    )
    dx_m: float = parameter(
        0.0, "Cell length, m; 0 is the rig's own.", within=(0.0, 1.0), read_only=True
    )
    seed: int = parameter(0, "Seed of the sensor noise.", within=(0, 2**31 - 1), read_only=True)
    line_state_rate_hz: float = parameter(
        0.0,
        "How often the state of every line is published while somebody listens, Hz; 0 is not.",
        within=(0.0, 1000.0),
    )
    command_timeout_s: float = parameter(
        0.1,
        "Age in simulated time at which a command gives way to the safe voltage, s; 0: never.",
        within=(0.0, 10.0),
    )
    safe: str = parameter(
        "closed",
        "Safe state of the valves: closed is each valve's null voltage, vent is vent_voltage_v.",
        choices=("closed", "vent"),
        read_only=True,
    )
    vent_voltage_v: float = parameter(
        0.0, "Voltage that vents, V.", within=(-24.0, 24.0), read_only=True
    )
    publish_clock: bool = parameter(
        False, "Publish simulated time on /clock; it begins at zero.", read_only=True
    )


class SimulatorNode(Node):
    """A rig file behind the topics of a real rig."""

    def __init__(self, **options: Any) -> None:
        """Reads the rig and starts to run it.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: A parameter or the rig file is wrong, or somebody else publishes the clock.
        """
        super().__init__("simulator", **options)
        self._clock_publisher: Any = None
        self._stepper: Stepper | None = None
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = SimulatorParameters.declare(self)
        if not params.rig:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        rig = self._rig = load_rig(params.rig)
        safe_v = None if params.safe == "closed" else params.vent_voltage_v
        self._inputs = Inputs(rig, params.command_timeout_s, safe_v)
        self._tap_topics = topics.tap_topics(rig)
        self._encoder_topics = topics.encoder_topics(rig)
        self._command_topics = topics.command_topics(rig)
        topics.check_joints_topic(rig, (*self._command_topics, *self._tap_topics))
        if params.publish_clock:
            if common.other_clocks(self, wait=True):
                raise InputError(
                    "parameter publish_clock: /clock already has a publisher, there can be one"
                )
            self._clock_publisher = self.create_publisher(
                ClockMessage, common.CLOCK_TOPIC, common.COMMAND_QOS
            )
        self._make_topics()
        self.create_service(StepSimulator, "~/step", self._on_step)
        self.create_service(ResetSimulator, "~/reset", self._on_reset)
        self.add_post_set_parameters_callback(self._on_parameters)
        self._diagnostics = common.Diagnostics(self, self._report)
        follows = bool(self.get_parameter("use_sim_time").value) and not params.publish_clock
        clock = self.get_clock() if follows else common.steady_clock()
        self._stepper = Stepper(
            rig,
            self._inputs,
            Pacing(params.pace, params.factor, clock, follows),
            1.0 / params.publish_rate_hz,
            params.dx_m or None,
            params.seed,
            origin_ns=None if params.publish_clock else lambda: self.get_clock().now().nanoseconds,
            publish=self._publish,
            running=self.context.ok,
        )
        self.about = f"rig {rig.name!r} at {params.publish_rate_hz:g} Hz, {params.pace}"
        if params.pace == "real_time" and params.factor != 1.0:
            self.about += f" times {params.factor:g}"
        self._stepper.start()

    def _make_topics(self) -> None:
        """Publishers of all that the rig shows, and subscriptions to its commands."""
        rig = self._rig
        # The set of all taps has a topic anyway.
        self._tap_topics = [t for t in self._tap_topics if t.name != topics.TAPS_TOPIC]
        self._publishers_of = {
            topic.name: self.create_publisher(
                topics.message_class(topic.type), topic.name, common.FAST_QOS
            )
            for topic in (*self._tap_topics, *self._encoder_topics)
        }
        # What a rig has none of is on no topic.
        self._set_publisher = self._applied = self._joint_publisher = None
        if rig.taps:
            self._set_publisher = self.create_publisher(
                TapPressures, topics.TAPS_TOPIC, common.FAST_QOS
            )
        if rig.commands:
            self._applied = self.create_publisher(
                ValveCommand, topics.APPLIED_TOPIC, common.FAST_QOS
            )
        if rig.moves and not rig.encoders:  # where they truly are: what nobody reads in its stead
            self._joint_publisher = self.create_publisher(
                JointState, topics.JOINTS_TOPIC, common.FAST_QOS
            )
        self._line_publishers = {
            name: self.create_publisher(LineState, f"lines/{name}/state", common.READINGS_QOS)
            for name in (rig.pipes if kind_of(rig).along_lines else ())
        }
        self._next_line_s = 0.0
        for topic in self._command_topics:
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                lambda message, topic=topic: self._inputs.take(topic.read(message)),
                common.COMMAND_QOS,
            )

    def destroy_node(self) -> None:
        """Ends the simulation, then the node."""
        if self._stepper is not None:
            self._stepper.stop()
        super().destroy_node()

    # ---- called by the executor ----------------------------------------------------------------

    def _on_parameters(self, parameters: list[Any]) -> None:
        self._inputs.timeout_s = self._params.command_timeout_s
        if self._stepper is not None and any(p.name == "factor" for p in parameters):
            self._stepper.pacing.set_factor(self._params.factor)

    async def _on_step(
        self, request: StepSimulator.Request, response: StepSimulator.Response
    ) -> StepSimulator.Response:
        assert self._stepper is not None
        duration_s = request.duration.sec + request.duration.nanosec * 1e-9
        done = common.from_another_thread(self)
        try:
            self._stepper.ask_step(duration_s, done.set_result)
        except InputError as error:
            response.success, response.message = False, str(error)
            response.stamp = common.to_stamp(self._stepper.stamp_ns)
            return response
        message, stamp_ns = await done
        response.success, response.message = not message, message
        response.stamp = common.to_stamp(stamp_ns)
        return response

    async def _on_reset(
        self, request: ResetSimulator.Request, response: ResetSimulator.Response
    ) -> ResetSimulator.Response:
        assert self._stepper is not None
        names, pressures = list(request.name), list(request.pressure_pa)
        response.success = False
        if len(names) != len(pressures):
            response.message = (
                f"found {len(names)} names and {len(pressures)} pressures, there must be equally"
                " many"
            )
        elif not all(math.isfinite(p) and p > 0.0 for p in pressures):
            response.message = "a pressure is not positive and finite; they are absolute, in Pa"
        else:
            done = common.from_another_thread(self)
            self._stepper.ask_reset(dict(zip(names, pressures, strict=True)), done.set_result)
            response.message, _ = await done
            response.success = not response.message
        return response

    def _report(self) -> list[DiagnosticStatus]:
        if self._stepper is None:
            return []
        name, rig = self.get_name(), self._rig.name
        lines = []
        pace = self._stepper.pace_report()
        level = DiagnosticStatus.OK
        text = f"{pace.reached:.3g} times real time"
        if self._stepper.failure:
            level, text = DiagnosticStatus.ERROR, f"stopped: {self._stepper.failure}"
        elif pace.behind:
            level = DiagnosticStatus.WARN
            text = f"cannot keep time: {pace.reached:.3g} of {pace.wanted:.3g} times real time"
        figures = {
            "factor wanted": pace.wanted,
            "factor reached": pace.reached,
            "simulated time (s)": self._stepper.time_s,
            "time let slip (s)": pace.slipped_s,
        }
        lines.append(common.status(level, f"{name}: pace", text, figures, rig))
        report = self._inputs.report(self._stepper.time_s)
        level, text = (
            DiagnosticStatus.OK,
            "commands arrive" if self._rig.commands else "there are none",
        )
        if report.waiting:
            level, text = DiagnosticStatus.WARN, "no command yet: valves in the safe state"
        elif report.stale:
            level = DiagnosticStatus.WARN
            text = f"no new command for {', '.join(report.stale)}: safe state"
        crowded = [
            topic.name
            for topic in self._command_topics
            # By its final name: counting expands a name, but does not remap it.
            if self.count_publishers(self.resolve_topic_name(topic.name)) > 1
        ]
        if crowded:
            level = DiagnosticStatus.WARN
            text = f"several publishers on {', '.join(crowded)}: the newest command wins"
        figures = {
            "commands": report.taken,
            "not finite, ignored": report.ignored,
            "beyond the valve's range, clamped": report.clamped,
        }
        figures |= {f"{key} (V)": value for key, value in report.volts.items()}
        lines.append(common.status(level, f"{name}: commands", text, figures, rig))
        if self._clock_publisher is not None and common.other_clocks(self, own=1):
            text = "/clock has another publisher"
            lines.append(common.status(DiagnosticStatus.ERROR, f"{name}: clock", text, {}, rig))
        return lines

    # ---- called by the stepper's thread --------------------------------------------------------

    def _publish(self, sample: Sample) -> None:
        stamp = common.to_stamp(sample.stamp_ns)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=stamp))
        if sample.taps is None:  # after a reset there is only the time to tell
            self._next_line_s = 0.0
            return
        for topic in self._tap_topics:
            message = topic.message(sample.taps, stamp)
            assert message is not None  # every tap has a reading
            if isinstance(message, FluidPressure):
                noise = self._rig.taps[topic.signals[0].name].noise_pa
                message.variance = (noise / topic.signals[0].scale) ** 2
            self._publishers_of[topic.name].publish(message)
        if self._set_publisher is not None:
            together = TapPressures(name=list(sample.taps), pressure_pa=list(sample.taps.values()))
            together.header.stamp = stamp
            together.header.frame_id = self._rig.name
            self._set_publisher.publish(together)
        for topic in self._encoder_topics:
            message = topic.message(sample.encoders, stamp)
            assert message is not None  # every encoder has a reading
            if isinstance(message, JointState):
                message.header.frame_id = self._rig.name
            self._publishers_of[topic.name].publish(message)
        if self._joint_publisher is not None:
            self._joint_publisher.publish(
                topics.joint_states(sample.joints, sample.speeds, stamp, self._rig.name)
            )
        if self._applied is not None:
            applied = ValveCommand(name=list(sample.volts), voltage_v=list(sample.volts.values()))
            applied.header.stamp = common.to_stamp(sample.since_ns)
            applied.header.frame_id = self._rig.name
            self._applied.publish(applied)
        if self._params.line_state_rate_hz > 0.0 and sample.time_s >= self._next_line_s - 1e-9:
            self._next_line_s = sample.time_s + 1.0 / self._params.line_state_rate_hz
            self._publish_lines(stamp)

    def _publish_lines(self, stamp: Any) -> None:
        assert self._stepper is not None
        for name, publisher in self._line_publishers.items():
            if publisher.get_subscription_count() == 0:
                continue
            state = self._stepper.state(name)
            message = LineState(
                line=name,
                position_m=state["x_m"].tolist(),
                density_kg_m3=state["density"].tolist(),
                velocity_m_s=state["velocity"].tolist(),
                pressure_pa=state["pressure"].tolist(),
            )
            message.header.stamp = stamp
            message.header.frame_id = self._rig.name
            publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(SimulatorNode, args)


if __name__ == "__main__":
    main()
