# SPDX-License-Identifier: Apache-2.0
"""The command-line tools on the graph, after those of `ros2`."""
