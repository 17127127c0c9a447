# SPDX-License-Identifier: Apache-2.0
"""How late a command is, without trusting that sender and receiver have the same time of day.

A command can wait in a queue: of the network, or of a bridge that did not get to run. Whoever takes
it then must not count it as new. Its stamp alone does not tell, since clocks of two machines
differ; but they differ by the same amount from one command to the next, and the quickest way that
a command ever had is taken for no delay at all. That is not forgotten: a queue that stands is late
for as long as it stands.

A clock that is set shows as what no queue can do. Commands arrive in the order in which they were
sent, so from one to the next lateness grows by no more than the time between their arrivals; and a
sender can have spent no more time than passed here, but for what it makes up for. (A clock that is
set forward by less than a queue is late looks like that queue emptying; nothing tells them apart.)
"""

DRIFT = 5e-4
"""So much faster or slower may one clock be than another: what NTP slews at most."""
UNSURE_S = 0.02
"""Lateness up to this may be drift, and is forgotten at that rate, s."""
JITTER_S = 5e-3
"""Excess over what can be, from which on the sender's clock was set, s."""


class Lateness:
    """Compares the time that each command of one sender took with the shortest one ever."""

    def __init__(self) -> None:
        """Knows nothing yet."""
        self._shortest_s: float | None = None
        self._sent_s = 0.0
        self._received_s = 0.0
        self._late_s = 0.0

    def of(self, sent_s: float, received_s: float) -> float:
        """Returns how much longer a command took than the quickest one, s; no less than it did.

        Args:
            sent_s: When it was sent, by the sender's clock.
            received_s: When it is taken, by a steady clock.
        """
        took_s = received_s - sent_s
        if self._shortest_s is None:
            self._shortest_s = took_s
        else:
            passed_s = received_s - self._received_s
            spent_s = sent_s - self._sent_s
            if self._late_s < UNSURE_S:
                self._shortest_s += DRIFT * passed_s
            most_s = self._late_s + passed_s
            if spent_s < 0.0:  # it was set back: this may have waited since the one before came
                self._shortest_s = took_s - most_s
            elif (
                spent_s > most_s + JITTER_S + 2.0 * DRIFT * spent_s
            ):  # it was set forward, and tells nothing of a queue
                self._shortest_s = took_s - self._late_s
        self._shortest_s = min(self._shortest_s, took_s)
        self._late_s = took_s - self._shortest_s
        self._sent_s, self._received_s = sent_s, received_s
        return self._late_s
