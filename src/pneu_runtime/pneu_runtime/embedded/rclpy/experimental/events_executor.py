# SPDX-License-Identifier: Apache-2.0
"""The executor that real rclpy drives by events instead of wait sets.

All executors of the embedded runtime are driven by events, so this is the single-threaded one.
"""

from rclpy.executors import SingleThreadedExecutor


class EventsExecutor(SingleThreadedExecutor):
    """Runs callbacks one after another, in the thread that spins.

    Args:
        context: The context it belongs to; the default one where not given.
    """
