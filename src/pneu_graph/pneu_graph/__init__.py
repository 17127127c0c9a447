# SPDX-License-Identifier: Apache-2.0
"""What runs on the graph of either ROS: bags, launch files, tools, what all nodes do alike."""
