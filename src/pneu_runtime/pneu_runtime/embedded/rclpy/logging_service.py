# SPDX-License-Identifier: Apache-2.0
"""Services get_logger_levels and set_logger_levels of a node that asks for them."""

from typing import TYPE_CHECKING

from rcl_interfaces.msg import LoggerLevel, SetLoggerLevelsResult
from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels

import rclpy.logging
from rclpy.qos import qos_profile_services_default

if TYPE_CHECKING:
    from rclpy.node import Node


class LoggingService:
    """Lets others read and set the levels of the loggers of this process."""

    def __init__(self, node: "Node") -> None:
        """Create both services.

        Args:
            node: Node they belong to.
        """
        name = node.get_name()
        node.create_service(
            GetLoggerLevels,
            f"{name}/get_logger_levels",
            self._get_logger_levels,
            qos_profile=qos_profile_services_default,
        )
        node.create_service(
            SetLoggerLevels,
            f"{name}/set_logger_levels",
            self._set_logger_levels,
            qos_profile=qos_profile_services_default,
        )

    @staticmethod
    def _get_logger_levels(
        request: GetLoggerLevels.Request, response: GetLoggerLevels.Response
    ) -> GetLoggerLevels.Response:
        response.levels = [
            LoggerLevel(name=name, level=int(rclpy.logging.get_logger_level(name)))
            for name in request.names
        ]
        return response

    @staticmethod
    def _set_logger_levels(
        request: SetLoggerLevels.Request, response: SetLoggerLevels.Response
    ) -> SetLoggerLevels.Response:
        results = []
        for level in request.levels:
            try:
                rclpy.logging.set_logger_level(level.name, level.level)
                results.append(SetLoggerLevelsResult(successful=True))
            except ValueError:
                reason = "Failed reason: Invalid logger level."
                results.append(SetLoggerLevelsResult(successful=False, reason=reason))
        response.results = results
        return response
