# SPDX-License-Identifier: Apache-2.0
"""How long it takes until the graph is known, by the middleware of the process.

Nothing tells when discovery is complete. What is found is there; what is not found within this time
is most likely not there, which is good enough for an answer on the command line and for a warning,
but not for a decision on which safety depends.
"""

from rclpy.utilities import get_rmw_implementation_identifier

DISCOVERY_S = 1.5
"""Time in which participants that have heard of each other exchange all endpoints, s."""

CYCLONE = "rmw_cyclonedds_cpp"
"""The middleware, also the embedded one, whose participants answer each announcement at once."""

ANNOUNCEMENT_S = 3.0
"""Period in which a participant of Fast DDS repeats its announcement, s (its default
``leaseDuration_announcementperiod``). Where the first ones are lost, which are sent within half a
second of the start, two participants hear of each other only with the next. It is taken for every
middleware that is not known better."""


def patience_s(known_s: float = DISCOVERY_S) -> float:
    """Returns how long to wait for something that discovery has to bring, s.

    Args:
        known_s: How long it may take once participants have heard of each other, s.
    """
    heard = get_rmw_implementation_identifier() == CYCLONE
    return known_s if heard else known_s + ANNOUNCEMENT_S
