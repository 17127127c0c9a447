# SPDX-License-Identifier: Apache-2.0
"""The simulator as a ROS 2 node; the rest of the package imports without ROS."""
