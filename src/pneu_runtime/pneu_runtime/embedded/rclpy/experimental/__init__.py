# SPDX-License-Identifier: Apache-2.0
"""What rclpy calls experimental."""

from rclpy.experimental.events_executor import EventsExecutor

__all__ = ["EventsExecutor"]
