# SPDX-License-Identifier: Apache-2.0
"""The rclpy API and messages of ROS 2 for machines that have none, over Cyclone DDS."""
