# SPDX-License-Identifier: Apache-2.0
"""The observer node: gas and joints of a rig from its commands and readings, and taps not there.

It follows commands, taps and encoders as they are recorded too, whoever publishes them, and tells
what every tap of the rig file shows or would show, with its variance, the state of every line, and
of a rig that moves places and speeds of its joints. A controller or a recorder that is remapped
from ``taps/<tap>/pressure`` to ``virtual/<tap>/pressure`` does not know the difference. Parameters
and topics: see ``ros_ws/README.md``.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import LineState, ValveCommand
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.observe.observer import Innovation, Observer
from pneu_sim.observe.settings import LEAK_S, LOAD_S, Drift, ObserverSettings
from pneu_sim.rig import load_rig
from pneu_sim.rig.cells import middles

LONGEST_S = 0.1
"""After so long without readings the state is found anew, s."""


@dataclass
class ObserverParameters(Parameters):
    """What the observer node is told."""

    rig: str = parameter("", "Path of the calibrated rig file.", read_only=True)
    used: str = parameter(
        "",
        "Taps and encoders whose readings are taken, with commas between; empty takes all of the"
        " rig.",
        read_only=True,
    )
    rate_hz: float = parameter(
        250.0, "How often readings are taken and told, Hz.", within=(1.0, 1000.0), read_only=True
    )
    members: int = parameter(16, "Rigs side by side.", within=(4, 64), read_only=True)
    dx_m: float = parameter(
        0.1, "Cell length, m; 0 is the rig's own.", within=(0.0, 1.0), read_only=True
    )
    noise_pa: float = parameter(
        250.0,
        "Noise of taps whose noise the rig file does not tell, one sigma, Pa.",
        within=(0.1, 1e5),
        read_only=True,
    )
    leak_m2: float = parameter(
        0.0,
        "Lines may come to leak to the room by about so much, effective area, m^2; 0 is none.",
        within=(0.0, 1e-4),
        read_only=True,
    )
    load_kg: float = parameter(
        0.0,
        "Joints may come to carry about so much, kg; 0 is nothing.",
        within=(0.0, 1e3),
        read_only=True,
    )
    hears: str = parameter(
        "applied",
        "applied follows valve/applied, which simulator and bridge publish; commanded the commands"
        " themselves.",
        choices=("applied", "commanded"),
        read_only=True,
    )
    line_state_rate_hz: float = parameter(
        50.0,
        "How often the state of every line is published while somebody listens, Hz; 0 is not.",
        within=(0.0, 1000.0),
    )
    seed: int = parameter(0, "Seed of all draws.", within=(0, 2**31 - 1), read_only=True)


class ObserverNode(Node):
    """Commands and readings in; virtual taps and states of lines out."""

    def __init__(self, **options: Any) -> None:
        """Reads the rig and begins to listen.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: A parameter or the rig file is wrong, or the rig cannot be followed.
        """
        super().__init__("observer", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = ObserverParameters.declare(self)
        if not params.rig:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        rig = self._rig = load_rig(params.rig)
        sensors = [*rig.taps, *rig.encoders]
        used = [name.strip() for name in params.used.split(",") if name.strip()] or sensors
        for name in used:
            if name not in sensors:
                raise InputError(
                    f"parameter used: found {name!r}, rig {rig.name!r} has {', '.join(sensors)}"
                )
        settings = ObserverSettings(
            members=params.members,
            dx_m=params.dx_m or None,
            noise_pa=params.noise_pa,
            seed=params.seed,
            leak=Drift(std=params.leak_m2, time_s=LEAK_S),
            load=Drift(std=params.load_kg, time_s=LOAD_S),
        )
        self._observer = Observer(rig, settings, used)
        self._volts = {valve.command: valve.spool.null_v for valve in self._rig.valves.values()}
        self._newest: dict[str, tuple[int, float]] = {}
        self._taken: dict[str, int] = {}
        self._time_ns: int | None = None
        self._steps = self._anew = 0
        self._last: dict[str, Innovation] = {}
        self._line_ns = 0
        self._subscribe(used)
        self._virtual = {
            name: self.create_publisher(FluidPressure, f"virtual/{name}/pressure", common.FAST_QOS)
            for name in rig.taps
        }
        self._lines = {
            name: self.create_publisher(LineState, f"observed/{name}/state", common.READINGS_QOS)
            for name in rig.pipes
        }
        self._joints = (
            self.create_publisher(JointState, "observed/joint_states", common.READINGS_QOS)
            if self._observer.plant.joint_names
            else None
        )
        self._diagnostics = common.Diagnostics(self, self._report)
        self.create_timer(1.0 / params.rate_hz, self._tick)
        self.about = f"rig {rig.name!r} by {', '.join(used)}"

    def _subscribe(self, used: list[str]) -> None:
        heard = topics.only(topics.tap_topics(self._rig), set(used) & set(self._rig.taps))
        heard += topics.only(topics.encoder_topics(self._rig), set(used) & set(self._rig.encoders))
        for topic in heard:
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                lambda message, topic=topic: self._on_reading(topic, message),
                common.READINGS_QOS,
            )
        if self._params.hears == "applied":
            self.create_subscription(
                ValveCommand, topics.APPLIED_TOPIC, self._on_applied, common.READINGS_QOS
            )
            return
        for topic in topics.command_topics(self._rig):
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                lambda message, topic=topic: self._hear(topic.read(message)),
                common.READINGS_QOS,
            )

    # ---- called by the executor ----------------------------------------------------------------

    def _on_applied(self, message: ValveCommand) -> None:
        self._hear(dict(zip(message.name, message.voltage_v, strict=False)))

    def _hear(self, volts: dict[str, float]) -> None:
        self._volts |= {
            name: float(value)
            for name, value in volts.items()
            if name in self._volts and math.isfinite(value)
        }

    def _on_reading(self, topic: topics.Topic, message: Any) -> None:
        stamped = hasattr(message, "header")
        stamp = message.header.stamp if stamped else self.get_clock().now().to_msg()
        at_ns = common.from_stamp(stamp)
        for name, value in topic.read(message).items():
            if name in self._observer.used:
                self._newest[name] = (at_ns, value)

    def _tick(self) -> None:
        fresh = {
            name: (at_ns, value)
            for name, (at_ns, value) in self._newest.items()
            if at_ns != self._taken.get(name)
        }
        if not fresh:
            return
        now_ns = max(at_ns for at_ns, _ in fresh.values())
        values = {name: value for name, (_, value) in fresh.items()}
        self._taken |= {name: at_ns for name, (at_ns, _) in fresh.items()}
        before, self._time_ns = self._time_ns, now_ns
        since_s = math.inf if before is None else 1e-9 * (now_ns - before)
        if not 0.0 < since_s <= LONGEST_S:
            self._anew += before is not None
            self._observer.begin(values, self._volts)
        else:
            commands = self._observer.plant.plan.commands
            held = np.array([[self._volts[name]] for name in commands])
            self._observer.advance(held, since_s)
        self._last = self._observer.assimilate(values)
        self._steps += 1
        self._publish(now_ns)

    def _publish(self, now_ns: int) -> None:
        stamp = common.to_stamp(now_ns)
        told = self._observer.estimate()
        for name, publisher in self._virtual.items():
            message = FluidPressure(fluid_pressure=told.mean[name], variance=told.std[name] ** 2)
            message.header.stamp, message.header.frame_id = stamp, name
            publisher.publish(message)
        if self._joints is not None:
            place, speed = self._observer.plant.joints().mean(axis=-1).T
            joints = JointState(
                name=list(self._observer.plant.joint_names),
                position=place.tolist(),
                velocity=speed.tolist(),
            )
            joints.header.stamp, joints.header.frame_id = stamp, self._rig.name
            self._joints.publish(joints)
        rate = self._params.line_state_rate_hz
        if rate <= 0.0 or 0 <= now_ns - self._line_ns < 1e9 / rate:
            return
        self._line_ns = now_ns
        for name, publisher in self._lines.items():
            if publisher.get_subscription_count() == 0:
                continue
            density, velocity, pressure = (
                part.mean(axis=1) for part in self._observer.plant.gas_in(name)
            )
            cells, length = len(density), self._rig.pipes[name].length_m
            state = LineState(
                line=name,
                position_m=middles(length, cells).tolist(),
                density_kg_m3=density.tolist(),
                velocity_m_s=velocity.tolist(),
                pressure_pa=pressure.tolist(),
            )
            state.header.stamp, state.header.frame_id = stamp, self._rig.name
            publisher.publish(state)

    def _report(self) -> list[DiagnosticStatus]:
        name, rig, observer = self.get_name(), self._rig.name, self._observer
        level, text = DiagnosticStatus.OK, "the model holds"
        if not self._steps:
            level, text = DiagnosticStatus.WARN, "no reading yet"
        elif observer.watch.wrong:
            level, text = DiagnosticStatus.WARN, "; ".join(observer.watch.wrong)
        figures: dict[str, object] = {"steps": self._steps, "begun anew": self._anew}
        for unknown, value, _ in observer.drifts.slow(observer.settings.slow_s):
            figures[f"{unknown.name} ({unknown.unit})"] = value
        lines = [common.status(level, f"{name}: model", text, figures, rig)]
        for sensor in observer.used:
            what, unit = ("tap", "Pa") if sensor in self._rig.taps else ("encoder", "rad or m")
            matter = observer.trust.matter(sensor)
            level = DiagnosticStatus.WARN if matter else DiagnosticStatus.OK
            seen = self._last.get(sensor)
            figures = {} if seen is None else {
                f"innovation ({unit})": seen.difference,
                f"expected ({unit})": seen.std,
            }  # fmt: skip
            text = f"not believed: {matter}" if matter else "agrees"
            lines.append(common.status(level, f"{name}: {what} {sensor}", text, figures, rig))
        return lines


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(ObserverNode, args)


if __name__ == "__main__":
    main()
