# SPDX-License-Identifier: Apache-2.0
"""The node that shows a robot: its description as URDF, and its links' frames as it moves.

It follows the JointState that simulator, bridge or replay publish, and says the same on ``/tf`` and
``/tf_static`` as ROS 2's robot_state_publisher would, so that Foxglove and RViz show a robot where
there is no ROS. Beside it, ``robot_description`` is what that node, or a viewer, asks for.
Parameters and topics: see ``ros_ws/README.md``.
"""

import math
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.rig import load_rig
from pneu_sim.view.tree import Link, tree_of
from pneu_sim.view.urdf import urdf_of

LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
TF_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100)


@dataclass
class ViewParameters(Parameters):
    """What the node is told."""

    rig: str = parameter("", "Path of the rig file.", read_only=True)
    rate_hz: float = parameter(
        50.0, "Most frames a second, by the stamps of readings, Hz.", within=(1.0, 1000.0)
    )
    publish_tf: bool = parameter(
        True, "Whether frames are published; else robot_state_publisher does.", read_only=True
    )


class RobotView(Node):
    """A rig's bodies as viewers know robots."""

    def __init__(self, **options: Any) -> None:
        """Describes the robot and begins to follow its joints.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: The rig file is wrong, or has no bodies.
        """
        super().__init__("robot_view", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = ViewParameters.declare(self)
        if not params.rig:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        rig = load_rig(params.rig)
        links = tree_of(rig)
        self._description = self.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=urdf_of(rig)))
        self._moving = [link for link in links if not link.limits.held]
        self._positions = {link.told: link.limits.start for link in self._moving}
        self._told_ns = -math.inf
        if not params.publish_tf:
            return
        self._tf = self.create_publisher(TFMessage, "/tf", TF_QOS)
        self._static = self.create_publisher(TFMessage, "/tf_static", LATCHED_QOS)
        now = self.get_clock().now().to_msg()
        held = [_frame(link, link.limits.start, now) for link in links if link.limits.held]
        if held:
            self._static.publish(TFMessage(transforms=held))
        for topic in topics.position_topics(rig):
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                lambda message, topic=topic: self._on_joints(topic, message),
                common.READINGS_QOS,
            )

    def _on_joints(self, topic: topics.Topic, message: Any) -> None:
        if topic.signals:
            said = topic.read(message)
        else:
            said = dict(zip(message.name, message.position, strict=False))
        self._positions |= {
            name: value
            for name, value in said.items()
            if name in self._positions and math.isfinite(value)
        }
        stamped = isinstance(message, JointState) or hasattr(message, "header")
        stamp = message.header.stamp if stamped else self.get_clock().now().to_msg()
        at_ns = common.from_stamp(stamp)
        if 0.0 <= at_ns - self._told_ns < 1e9 / self._params.rate_hz:
            return
        self._told_ns = at_ns
        frames = [_frame(link, self._positions[link.told], stamp) for link in self._moving]
        self._tf.publish(TFMessage(transforms=frames))


def _frame(link: Link, position: float, stamp: Any) -> TransformStamped:
    place, turn = link.pose(position)
    frame = TransformStamped(child_frame_id=link.name)
    frame.header.stamp, frame.header.frame_id = stamp, link.parent
    frame.transform.translation = Vector3(**dict(zip("xyz", place.tolist(), strict=True)))
    frame.transform.rotation = Quaternion(**dict(zip("xyzw", turn.tolist(), strict=True)))
    return frame


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(RobotView, args)


if __name__ == "__main__":
    main()
