# SPDX-License-Identifier: Apache-2.0
"""Identification and replay as ROS 2 nodes; the rest of the package imports without ROS."""
