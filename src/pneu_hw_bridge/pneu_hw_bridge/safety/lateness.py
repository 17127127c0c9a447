# SPDX-License-Identifier: Apache-2.0
"""How late a command is, without trusting that sender and receiver have the same time of day.

A command can wait in a queue: of the network, or of a bridge that did not get to run. Whoever takes
it then must not count it as new. Its stamp alone does not tell, since clocks of two machines
differ; but they differ by the same amount from one command to the next, and the quickest way that
commands had lately is taken for no delay at all.
"""

import math

WINDOW_S = 1.0
"""After one to two of these a clock that was set back is believed again, s."""


class Lateness:
    """Compares the time that each command took with the shortest one lately."""

    def __init__(self) -> None:
        """Knows nothing yet."""
        self._since_s = -math.inf
        self._shortest_s = math.inf
        self._before_s = math.inf

    def of(self, sent_s: float, received_s: float) -> float:
        """Returns how much longer a command took than the quickest one lately, s.

        Args:
            sent_s: When it was sent, by the sender's clock.
            received_s: When it is taken, by a steady clock.
        """
        took_s = received_s - sent_s
        if received_s - self._since_s > WINDOW_S:
            self._since_s = received_s
            self._before_s, self._shortest_s = self._shortest_s, took_s
        self._shortest_s = min(self._shortest_s, took_s)
        return took_s - min(self._before_s, self._shortest_s)
