# SPDX-License-Identifier: Apache-2.0
"""Messages that were sent and never came: by the numbers they have, or by what senders tell.

Some middlewares number messages; of others the senders tell now and then how many they have sent
(`pneu_runtime.transport.sent`). A message may overtake what is told of it, so that is looked at a
while later.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

GRACE_S = 1.0
"""So long after it was told a message may still come."""

ROUNDED_NS = 1
"""Source timestamps lose so much on the wire."""


@dataclass
class _Sender:
    """What is known of one publication."""

    topic: str
    unseen_ns: deque[int] = field(default_factory=deque)
    received: int = 0
    before: int | None = None
    told: deque[tuple[float, int, int]] = field(default_factory=deque)
    number: int | None = None
    lost: int = 0


class Losses:
    """Counts them, for one thread."""

    def __init__(self) -> None:
        """Knows of no sender."""
        self._senders: dict[str, _Sender] = {}

    def seen(self, topic: str, sender: str, source_ns: int, number: int | None) -> None:
        """Takes note of a message.

        Args:
            topic: Its topic.
            sender: Identity of its publication in hexadecimal digits; empty where not known.
            source_ns: Its source timestamp, ns.
            number: Its number among those of its publication; None where not known. Messages before
                and after one without a number are not compared: they may be of two publications.
        """
        one = self._senders.setdefault(sender or topic, _Sender(topic))
        if number is not None and one.number is not None and number > one.number:
            one.lost += number - one.number - 1
        one.number = number
        if number is None and sender:
            one.unseen_ns.append(source_ns)

    def told(self, counts: Mapping[str, tuple[int, int]], now_s: float) -> None:
        """Takes note of what a participant tells of its publications.

        Args:
            counts: By identity how many messages were sent, and when the last one, ns.
            now_s: Steady time.
        """
        for sender, (count, at_ns) in counts.items():
            one = self._senders.get(sender)
            if one is not None and not (one.told and one.told[-1][1:] == (count, at_ns)):
                one.told.append((now_s, count, at_ns))

    def by_topic(self, now_s: float, ended: bool = False) -> dict[str, int]:
        """Returns how many messages of each topic were lost, of those that lost any.

        Args:
            now_s: Steady time.
            ended: No message is taken any more. What is told of a sender's messages up to a time is
                then compared if a later one of its messages was taken: the last ones may have been
                on their way when the taking ended, and are not lost but after the end.
        """
        found: dict[str, int] = {}
        for one in self._senders.values():
            newest_ns = max(one.unseen_ns, default=0)
            while one.told:
                told_s, count, at_ns = one.told[0]
                if told_s + GRACE_S > now_s and not (ended and newest_ns > at_ns + ROUNDED_NS):
                    break
                one.told.popleft()
                _compare(one, count, at_ns)
            if one.lost:
                found[one.topic] = found.get(one.topic, 0) + one.lost
        return found


def _compare(one: _Sender, count: int, at_ns: int) -> None:
    """Compares what was sent up to a time with what came of it."""
    later = deque(stamp for stamp in one.unseen_ns if stamp > at_ns + ROUNDED_NS)
    one.received += len(one.unseen_ns) - len(later)
    one.unseen_ns = later
    if one.before is None:  # what was sent before the recording began is not missing
        one.before = count - one.received
    one.lost = max(count - one.before - one.received, 0)
