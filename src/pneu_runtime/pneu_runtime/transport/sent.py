# SPDX-License-Identifier: Apache-2.0
"""How many messages each publication has sent, told to whoever listens: what is missing was lost.

The library numbers what it sends, but shows nobody the numbers, and its own count of lost messages
knows only of some. So every half second, while somebody listens, a participant tells on a hidden
topic of each of its publications how many messages it has sent and the source timestamp of the last
one; a listener compares with those up to that time that it got. The middleware of ROS 2 itself does
not tell; there losses are known where it hands out sequence numbers.
"""

from __future__ import annotations

import json
import threading

from pneu_runtime import interfaces
from pneu_runtime.transport import naming
from pneu_runtime.transport.endpoints import Publication, Writer
from pneu_runtime.transport.errors import TransportError
from pneu_runtime.transport.owner import Owner
from pneu_runtime.transport.qos import EndpointQos

TOPIC = "/_pneu_sent"
TYPE = "std_msgs/msg/String"
PERIOD_S = 0.5
MOST_ENDED = 1000
"""Publications that have ended and are still told of."""
LAST_WORD_S = 0.1

Counts = dict[str, tuple[int, int]]
"""By the identity of a publication, in hexadecimal digits: how many, and when the last one, ns."""


def decode(text: str) -> Counts:
    """Reads what a participant tells.

    Args:
        text: The message.

    Raises:
        ValueError: It is no such message.
    """
    try:
        found = json.loads(text)
        return {str(gid): (int(count), int(at_ns)) for gid, (count, at_ns) in found.items()}
    except (AttributeError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(str(error)) from None


class Teller:
    """Tells how much was sent, from when somebody listens for the first time."""

    def __init__(self, session: Owner) -> None:
        """Tells nothing yet.

        Args:
            session: Whose publications it tells of.
        """
        self._session = session
        self._lock = threading.Lock()
        self._publications: set[Publication] = set()
        self._ended: Counts = {}
        self._writer: Writer | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def begins(self, publication: Publication) -> None:
        """Takes a publication up.

        Args:
            publication: It.
        """
        with self._lock:
            self._publications.add(publication)

    def ends(self, publication: Publication) -> None:
        """Keeps the count of a publication that is closed.

        Args:
            publication: It.
        """
        with self._lock:
            self._publications.discard(publication)
            self._ended[publication.gid.hex()] = publication.sent
            while len(self._ended) > MOST_ENDED:
                del self._ended[next(iter(self._ended))]

    def heard_of_listeners(self, count: int) -> None:
        """Begins to tell where somebody listens.

        Args:
            count: How many listen.
        """
        if count and self._thread is None and not self._stop.is_set():
            self._thread = threading.Thread(target=self._run, name="pneu-sent", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        data = naming.user_data(typehash=interfaces.type_hash(TYPE))
        topic = naming.topic_to_dds(TOPIC)
        try:
            self._writer = Writer(self._session, None, topic, TYPE, EndpointQos(depth=10), data)
            while not self._stop.wait(PERIOD_S):
                self._tell()
        except TransportError:  # the session was closed meanwhile
            return

    def _tell(self) -> None:
        writer = self._writer
        if writer is None or not writer.matched_count():
            return
        with self._lock:
            counts = self._ended | {one.gid.hex(): one.sent for one in self._publications}
        message = interfaces.message_class(TYPE)(data=json.dumps(counts))
        writer.publish(interfaces.serialize(message))

    def close(self) -> None:
        """Tells a last time."""
        self._stop.set()
        if self._thread is None:
            return
        self._thread.join()
        if self._writer is not None:
            try:
                self._tell()
                self._writer.wait_for_all_acked(LAST_WORD_S)
            except TransportError:
                return
