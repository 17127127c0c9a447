# SPDX-License-Identifier: Apache-2.0
"""The /rosout publisher of a node, which carries the messages of its logger and its children."""

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Log

from pneu_runtime import interfaces
from rclpy.impl.log_output import output
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.qos import qos_profile_rosout_default

if TYPE_CHECKING:
    from rclpy.node import Node


class RosoutPublisher:
    """Sends what a node logs to /rosout; not one of the node's own publishers."""

    def __init__(self, node: "Node") -> None:
        """Create the publisher and connect it to the node's logger.

        Args:
            node: Node with a logger and a handle.
        """
        self._publication = node._session.create_publication(
            node._handle,
            node.resolve_topic_name("/rosout"),
            "rcl_interfaces/msg/Log",
            qos_profile_rosout_default,
        )
        self._closed = False
        # One bound method for good: a new one each time would not be found again.
        self._sink = self._publish
        output.add_sink(node.get_logger().name, self._sink)

    def _publish(
        self,
        severity: LoggingSeverity,
        name: str,
        message: str,
        file_path: str,
        function_name: str,
        line_number: int,
        stamp_ns: int,
    ) -> None:
        if self._closed:
            return
        stamp = Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        log = Log(
            stamp=stamp,
            level=int(severity),
            name=name,
            # Half a character, as in names of files whose bytes are no text, cannot be sent.
            msg=message.encode(errors="backslashreplace").decode(),
            file=file_path,
            function=function_name,
            line=line_number,
        )
        self._publication.publish(interfaces.serialize(log))

    def destroy(self) -> None:
        """End publishing; the loggers go on without it."""
        if not self._closed:
            self._closed = True
            output.remove_sink_everywhere(self._sink)
            self._publication.close()
