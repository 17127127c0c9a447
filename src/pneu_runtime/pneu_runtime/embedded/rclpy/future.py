# SPDX-License-Identifier: Apache-2.0
"""`Future`, under the module name that newer code imports it from."""

from rclpy.task import Future

__all__ = ["Future"]
