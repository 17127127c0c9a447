# SPDX-License-Identifier: Apache-2.0
"""The layer below the API under the name that some code imports it by."""

from rclpy import _rclpy_pybind11 as rclpy_implementation

__all__ = ["rclpy_implementation"]
