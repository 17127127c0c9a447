# SPDX-License-Identifier: Apache-2.0
"""`InvalidHandle`, where older code imports it from."""

from rclpy._rclpy_pybind11 import InvalidHandle

__all__ = ["InvalidHandle"]
