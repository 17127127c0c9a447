# SPDX-License-Identifier: Apache-2.0
"""State and contact force of what a scene is of, while it moves: a fixed-lag estimate.

Reads the topics that the scene file names. Gives ``estimate/joint_states`` with all joints of one
coordinate, ``estimate/<body>/pose`` of bodies that move freely, and ``estimate/touch``, the force
of the tree of ``body`` on what it touches, in the world's frame, each stamped by the instant it is
of: a few milliseconds ago. /diagnostics tells the lag and how long a cycle takes.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_hw_bridge.priority import precedence
from pneu_hw_bridge.safety.lateness import Lateness
from pneu_sysid.contacts.read_bag import OF_JOINTS, OF_SENSORS, PARTS
from pneu_sysid.contacts.scene import Loaded, load_scene
from pneu_sysid.contacts.window import Estimate, Window

TYPES: dict[str, Any] = {
    "sensor_msgs/msg/JointState": JointState,
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "sensor_msgs/msg/Imu": Imu,
    "geometry_msgs/msg/PoseStamped": PoseStamped,
}
"""Messages that sensors are read from while they move."""

QUEUE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=500, reliability=ReliabilityPolicy.BEST_EFFORT
)
"""Every reading counts, and none is worth waiting for."""

PILED_S = 0.02
"""Readings that come later than the quickest by more wait in a queue, which is worked off first."""

Take = Callable[[Any, float], None]


@dataclass
class HandStateParameters(Parameters):
    """What the node is told."""

    scene: str = parameter("", "Scene file, with what was identified.", read_only=True)
    body: str = parameter("", "A body of the tree whose force on others is told.", read_only=True)
    rate_hz: float = parameter(
        100.0, "Estimates per second, at most.", within=(1.0, 1000.0), read_only=True
    )
    step_s: float = parameter(
        0.0025, "Time between knots, s.", within=(0.0005, 0.02), read_only=True
    )
    knots: int = parameter(16, "Knots of the window.", within=(6, 200), read_only=True)
    iterations: int = parameter(
        1, "Steps of Gauss and Newton for each estimate.", within=(1, 20), read_only=True
    )
    lag_knots: int = parameter(
        2, "Knots by which what is told is behind the last that has an acceleration.",
        within=(0, 50), read_only=True,
    )  # fmt: skip


def takes_of(loaded: Loaded, window: Window) -> dict[tuple[str, str], list[Take]]:
    """What is to be done with messages, by topic and type.

    Args:
        loaded: The scene.
        window: What takes readings.

    Raises:
        InputError: A sensor has no topic, or none of the usual messages tells of it.
    """
    setup = loaded.setup()
    out: dict[tuple[str, str], list[Take]] = {}
    joint_state = "sensor_msgs/msg/JointState"
    for name, settings in loaded.scene.sensors.items():
        if settings.topic is None:
            raise InputError(f"sensors: {name}: the scene names no topic for it")
        element = setup.spec.sensor(name)
        kind = element.type.name.removeprefix("mjSENS_").lower()
        unit = settings.unit
        if kind in OF_JOINTS:
            joint = settings.joint or str(element.objname)
            part = settings.field or OF_JOINTS[kind]

            def of_joint(
                message: Any, at: float, name: str = name, joint: str = joint, part: str = part,
                unit: float = unit,
            ) -> None:  # fmt: skip
                window.sensor(
                    name, at, np.array([unit * getattr(message, part)[message.name.index(joint)]])
                )

            out.setdefault((settings.topic, joint_state), []).append(of_joint)
            continue
        on_it = [
            setup.spec.sensor(n).type.name.removeprefix("mjSENS_").lower()
            for n, other in loaded.scene.sensors.items()
            if other.topic == settings.topic
        ]
        types = [t for t in TYPES if all(k in OF_SENSORS.get(t, {}) for k in on_it)]
        if not types:
            raise InputError(
                f"sensors: {name}: no message of {', '.join(TYPES)} tells {', '.join(on_it)},"
                f" which the scene reads from {settings.topic}"
            )
        path = (settings.field or OF_SENSORS[types[0]][kind]).split(".")
        parts = PARTS[loaded.widths[name]]
        by = 1.0 if loaded.widths[name] == 4 else unit

        def of_field(
            message: Any, at: float, name: str = name, path: list[str] = path,
            parts: tuple[str, ...] = parts, by: float = by,
        ) -> None:  # fmt: skip
            where = reduce(getattr, path, message)
            window.sensor(name, at, by * np.array([getattr(where, p) for p in parts]))

        out.setdefault((settings.topic, types[0]), []).append(of_field)
    for name, control in loaded.scene.controls.items():
        if control.topic is None:
            raise InputError(f"controls: {name}: the scene names no topic for it")
        joint = control.joint or str(setup.spec.actuator(name).target)
        part = control.field or "effort"

        def of_motor(
            message: Any, at: float, name: str = name, joint: str = joint, part: str = part,
            unit: float = control.unit,
        ) -> None:  # fmt: skip
            window.control(name, at, unit * getattr(message, part)[message.name.index(joint)])

        out.setdefault((control.topic, joint_state), []).append(of_motor)
    return out


class HandState(Node):
    """The node."""

    def __init__(self, **options: Any) -> None:
        """Reads the scene and begins to listen.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or the scene is wrong.
        """
        super().__init__("hand_state", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = HandStateParameters.declare(self)
        if not params.scene:
            raise InputError("parameter scene: found nothing, it must be the path of a scene file")
        loaded = load_scene(params.scene)
        model = loaded.setup(loaded.scene.values).spec.compile()
        bodies = [model.body(k).name for k in range(1, model.nbody)]
        if params.body not in bodies:
            raise InputError(
                f"parameter body: found {params.body!r}, {params.scene} has {', '.join(bodies)}"
            )
        self._origin_ns: int | None = None
        self._window = Window(
            loaded, loaded.scene.values, params.body, params.step_s, params.knots,
            params.iterations, params.lag_knots,
        )  # fmt: skip
        self._cycle_s: deque[float] = deque(maxlen=1000)
        self._lag_s: deque[float] = deque(maxlen=1000)
        self._wrong = 0
        self._joints = [
            (model.joint(j).name, int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]))
            for j in range(model.njnt)
            if int(model.jnt_type[j]) in (2, 3)
        ]
        free = [j for j in range(model.njnt) if int(model.jnt_type[j]) == 0]
        self._to_joints = self.create_publisher(
            JointState, "estimate/joint_states", common.READINGS_QOS
        )
        self._to_touch = self.create_publisher(WrenchStamped, "estimate/touch", common.READINGS_QOS)
        self._to_poses = [
            (
                int(model.jnt_qposadr[j]),
                self.create_publisher(
                    PoseStamped,
                    f"estimate/{model.body(int(model.jnt_bodyid[j])).name}/pose",
                    common.READINGS_QOS,
                ),
            )
            for j in free
        ]
        self._next_s = 0.0
        self._lateness = Lateness()
        self._passed_over = 0
        wanted = takes_of(loaded, self._window)
        leading = next(
            (key for key in wanted if key[1].endswith("/JointState")), next(iter(wanted))
        )
        for key, takes in wanted.items():
            listener = self._listening(takes, key == leading)
            self.create_subscription(TYPES[key[1]], key[0], listener, QUEUE)
        self._diagnostics = common.Diagnostics(self, self._report)

    def _listening(self, takes: list[Take], leads: bool) -> Callable[[Any], None]:
        """The callback of a topic; where it leads, estimates are made by the time that it tells."""

        def heard(message: Any) -> None:
            stamp_ns = common.from_stamp(message.header.stamp)
            if self._origin_ns is None:
                self._origin_ns = stamp_ns
            at = 1e-9 * (stamp_ns - self._origin_ns)
            try:
                for take in takes:
                    take(message, at)
            except (ValueError, IndexError, AttributeError):
                self._wrong += 1
            if leads and at >= self._next_s:
                self._advance(at)

        return heard

    def _advance(self, at: float) -> None:
        """Makes an estimate, unless readings have piled up, which come first."""
        if self._lateness.of(at, time.monotonic()) > PILED_S:
            self._passed_over += 1
            return
        self._next_s = at + 1.0 / self._params.rate_hz - 1e-6
        begun_s = time.perf_counter()
        found = self._window.advance()
        if found is None:
            return
        self._tell(found)
        self._cycle_s.append(time.perf_counter() - begun_s)
        self._lag_s.append(found.lag_s)

    def _tell(self, found: Estimate) -> None:
        assert self._origin_ns is not None
        stamp = common.to_stamp(self._origin_ns + round(1e9 * found.time_s))
        joints = JointState(
            name=[name for name, _, _ in self._joints],
            position=[float(found.q[at]) for _, at, _ in self._joints],
            velocity=[float(found.v[at]) for _, _, at in self._joints],
        )
        joints.header.stamp = stamp
        self._to_joints.publish(joints)
        for at, publisher in self._to_poses:
            pose = PoseStamped()
            pose.header.stamp, pose.header.frame_id = stamp, "world"
            place, turn = pose.pose.position, pose.pose.orientation
            place.x, place.y, place.z = (float(x) for x in found.q[at : at + 3])
            turn.w, turn.x, turn.y, turn.z = (float(x) for x in found.q[at + 3 : at + 7])
            publisher.publish(pose)
        touch = WrenchStamped()
        touch.header.stamp, touch.header.frame_id = stamp, "world"
        force, torque = touch.wrench.force, touch.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = (float(x) for x in found.touch)
        self._to_touch.publish(touch)

    def _report(self) -> list[DiagnosticStatus]:
        cycles = np.array(self._cycle_s) if self._cycle_s else np.array([np.nan])
        lags = np.array(self._lag_s) if self._lag_s else np.array([np.nan])
        values: dict[str, object] = {
            "cycle p50 [s]": float(np.quantile(cycles, 0.5)),
            "cycle p99 [s]": float(np.quantile(cycles, 0.99)),
            "lag p50 [s]": float(np.quantile(lags, 0.5)),
            "lag p99 [s]": float(np.quantile(lags, 0.99)),
            "cost of the window": self._window.cost,
            "begun anew": self._window.restarts,
            "passed over to catch up": self._passed_over,
            "messages not understood": self._wrong,
        }
        known = bool(self._cycle_s)
        level = DiagnosticStatus.OK if known and not self._wrong else DiagnosticStatus.WARN
        text = "works" if known else "waits for readings of all sensors"
        return [common.status(level, f"{self.get_name()}: estimate", text, values, "estimate")]


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    with precedence():  # what comes late is of no use to who controls by it
        common.run_node(HandState, args)


if __name__ == "__main__":
    main()
