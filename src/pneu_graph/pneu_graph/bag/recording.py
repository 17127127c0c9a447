# SPDX-License-Identifier: Apache-2.0
"""A recording in progress: messages go in from any thread, and one thread writes them.

The thread that hands messages over never waits for the disk. Where the disk does not keep up, or
is full, messages are dropped and counted, and writing resumes when it can.
"""

import collections
import dataclasses
import functools
import queue
import threading
import time
from collections.abc import Callable

from pneu_graph.bag.bag_writer import Attachment, BagWriter
from pneu_graph.bag.metadata import LOST_KEY, Topic

FLUSH_PERIOD_S = 0.05
"""How often the chunk in progress reaches the disk: what a kill can cost at most, s."""

_Message = tuple[str, bytes, int, int]
_Task = Callable[[], None]


@dataclasses.dataclass(frozen=True)
class RecordingStatus:
    """How a recording goes.

    Attributes:
        written: Messages written.
        dropped: Messages lost since the beginning, because the disk was full or too slow.
        queued_bytes: Waiting to be written, bytes.
        fault: Why nothing can be written now; empty where all is well.
        files: Files of the bag.
        lag_s: How late the writer last came round to flushing, s.
    """

    written: int
    dropped: int
    queued_bytes: int
    fault: str
    files: int
    lag_s: float


class Recording:
    """Writes a bag in its own thread.

    Args:
        writer: The bag; from now on it belongs to the thread.
        max_queue_bytes: Messages that may wait for the disk, bytes; also the length of the
            history in snapshot mode.
        snapshot_mode: Keep messages in memory and write them when `snapshot` is called.
        report: Told, in the writing thread, when the disk refuses and when it takes again.
    """

    def __init__(
        self,
        writer: BagWriter,
        max_queue_bytes: int,
        snapshot_mode: bool = False,
        report: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._writer = writer
        self._max_queue_bytes = max_queue_bytes
        self._snapshot_mode = snapshot_mode
        self._report = report
        self._queue: queue.SimpleQueue[_Message | _Task] = queue.SimpleQueue()
        self._history: collections.deque[_Message] = collections.deque()
        self._history_bytes = 0
        # Each is written by one side only, so that neither needs a lock.
        self._bytes_in = 0
        self._bytes_out = 0
        self._refused = 0
        self._lost = 0
        self._fault = ""
        self._lag_s = 0.0
        self._stop = False
        self._faults_at_close: list[str] = []
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def status(self) -> RecordingStatus:
        """Returns how the recording goes."""
        return RecordingStatus(
            written=self._writer.metadata.message_count,
            dropped=self._refused + self._lost,
            queued_bytes=self._bytes_in - self._bytes_out,
            fault=self._fault,
            files=len(self._writer.metadata.files),
            lag_s=self._lag_s,
        )

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Makes a topic known; it must come before the topic's first message.

        Args:
            topic: The topic.
            definition: Full text of the message type and of the types in it.
        """
        self._queue.put(lambda: self._writer.add_topic(topic, definition))

    def attach(self, attachment: Attachment) -> None:
        """Adds an attachment.

        Args:
            attachment: Name and content.
        """
        self._queue.put(lambda: self._writer.attach(attachment))

    def add_record(self, name: str, values: dict[str, str]) -> None:
        """Adds a metadata record.

        Args:
            name: Name of the record.
            values: Its texts.
        """
        self._queue.put(lambda: self._writer.add_record(name, values))

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Hands over a message and returns at once. For one thread only.

        Args:
            topic: Name of a topic that was added.
            data: CDR with its header.
            log_time_ns: When it was received, ns.
            publish_time_ns: When it was sent, ns.
        """
        if self._bytes_in - self._bytes_out > self._max_queue_bytes:
            self._refused += 1
            return
        self._bytes_in += len(data)
        self._queue.put((topic, data, log_time_ns, publish_time_ns))

    def tell_lost(self, lost: dict[str, int]) -> None:
        """Has the bag's description say what was lost on the way to the recorder.

        Args:
            lost: Messages by topic.
        """
        text = ", ".join(f"{topic} {count}" for topic, count in sorted(lost.items()))
        self._queue.put(lambda: self._writer.metadata.custom_data.update({LOST_KEY: text}))

    def split(self, timeout_s: float = 5.0) -> str:
        """Begins a new file.

        Args:
            timeout_s: How long to wait for the writing thread, s.

        Returns:
            What went wrong; empty where all is well.
        """
        return self._do(self._writer.split, timeout_s)

    def snapshot(self, timeout_s: float = 5.0) -> str:
        """Writes the history that snapshot mode keeps, and begins a new file.

        Args:
            timeout_s: How long to wait for the writing thread, s.

        Returns:
            What went wrong; empty where all is well.
        """
        if not self._snapshot_mode:
            return "the recorder does not run in snapshot mode"
        return self._do(self._write_history, timeout_s)

    def close(self) -> list[str]:
        """Writes what waits, and ends the bag.

        Returns:
            A sentence for each part that could not be written.
        """
        self._queue.put(self._end)
        self._thread.join()
        return self._faults_at_close

    def _end(self) -> None:
        self._stop = True

    def _do(self, task: _Task, timeout_s: float) -> str:
        done = threading.Event()
        outcome: list[str] = []

        def run() -> None:
            try:
                task()
            except OSError as error:
                outcome.append(str(error.strerror))
                raise
            finally:
                done.set()

        self._queue.put(run)
        if not done.wait(timeout_s):
            return f"the disk has not answered for {timeout_s:g} s"
        return outcome[0] if outcome else ""

    def _run(self) -> None:
        due = time.monotonic() + FLUSH_PERIOD_S
        while not self._stop:
            try:
                item = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except queue.Empty:
                item = None
            if item is not None:
                self._guarded(functools.partial(self._take, item))
            now = time.monotonic()
            if now >= due:
                self._lag_s = now - due
                self._guarded(self._writer.flush)
                due = time.monotonic() + FLUSH_PERIOD_S
        self._faults_at_close = self._writer.close()

    def _take(self, item: _Message | _Task) -> None:
        if callable(item):
            item()
            return
        topic, data, log_time_ns, publish_time_ns = item
        self._bytes_out += len(data)
        if self._snapshot_mode:
            self._history.append(item)
            self._history_bytes += len(data)
            while self._history_bytes > self._max_queue_bytes:
                self._history_bytes -= len(self._history.popleft()[1])
        elif self._fault:
            self._lost += 1
        else:
            before = self._writer.metadata.message_count
            try:
                self._writer.write(topic, data, log_time_ns, publish_time_ns)
            finally:
                # a disk that refuses may have taken the message all the same, into its chunk
                self._lost += self._writer.metadata.message_count == before

    def _write_history(self) -> None:
        while self._history and self._writer.ready:
            topic, data, log_time_ns, publish_time_ns = self._history.popleft()
            self._history_bytes -= len(data)
            self._writer.write(topic, data, log_time_ns, publish_time_ns)
        self._writer.split()

    def _guarded(self, step: _Task) -> None:
        """Runs a step; a disk that refuses is a state and not the end of the recording."""
        try:
            step()
        except OSError as error:
            if not self._fault:
                self._report(
                    f"{self._writer.folder}: cannot be written ({error.strerror});"
                    " messages are dropped until it can"
                )
            self._fault = str(error.strerror)
            return
        if self._fault and self._writer.ready:
            self._report(
                f"{self._writer.folder}: is written again after {self._lost} lost messages"
            )
            self._fault = ""
