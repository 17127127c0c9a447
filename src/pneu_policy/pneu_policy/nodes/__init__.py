# SPDX-License-Identifier: Apache-2.0
"""Controllers and target generators as ROS 2 nodes; the controllers themselves import no ROS."""
