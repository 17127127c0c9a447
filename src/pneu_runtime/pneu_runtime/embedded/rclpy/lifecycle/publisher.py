# SPDX-License-Identifier: Apache-2.0
"""A publisher that is silent unless its node is active."""

from typing import Any

from rclpy.lifecycle.managed_entity import SimpleManagedEntity
from rclpy.publisher import Publisher


class LifecyclePublisher(SimpleManagedEntity, Publisher):
    """Publisher of a managed node; made by `LifecycleNode.create_lifecycle_publisher`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Pass everything on to `Publisher`.

        Args:
            *args: Its arguments.
            **kwargs: Its arguments.
        """
        SimpleManagedEntity.__init__(self)
        Publisher.__init__(self, *args, **kwargs)

    def publish(self, msg: Any) -> None:
        """Publish while the node is active; otherwise do nothing.

        Args:
            msg: The message, or its bytes.
        """
        if self._enabled:
            Publisher.publish(self, msg)
