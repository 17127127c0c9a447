# SPDX-License-Identifier: Apache-2.0
"""The output of an MCAP writer that reaches the disk whole chunk by whole chunk.

What the writer puts out is held in memory until `commit`. A commit that fails, because the disk is
full or the file may not grow, takes back what it wrote, so that the file always ends after a whole
record and can be read; the bytes stay in memory and the next commit tries again.
"""

import os
from pathlib import Path


class Spool:
    """A file that grows by whole commits.

    Args:
        path: File to create; must not exist.

    Attributes:
        path: The file.
        committed: Its length, bytes.
        failed: Whether the last commit failed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.committed = 0
        self.failed = False
        self._pending = bytearray()
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._descriptor = os.open(path, flags, 0o644)

    def write(self, data: bytes) -> int:
        """Keeps bytes for the next commit.

        Args:
            data: Whole records.
        """
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Returns the position that the next byte will have in the file."""
        return self.committed + len(self._pending)

    def flush(self) -> None:
        """Does nothing: when bytes reach the disk is decided by `commit`."""

    def commit(self) -> None:
        """Writes what is pending.

        Raises:
            OSError: It cannot be written; the file is as before, and the bytes are kept.
        """
        view = memoryview(bytes(self._pending))
        written = 0
        try:
            while written < len(view):
                written += os.pwrite(self._descriptor, view[written:], self.committed + written)
        except OSError:
            self.failed = True
            os.ftruncate(self._descriptor, self.committed)
            raise
        self.failed = False
        self.committed += written
        self._pending.clear()

    def close(self) -> None:
        """Closes the file; what is pending is lost."""
        os.close(self._descriptor)
