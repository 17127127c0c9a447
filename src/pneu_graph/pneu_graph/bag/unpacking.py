# SPDX-License-Identifier: Apache-2.0
"""Compressed parts of recordings, unpacked within bounds.

A few hundred kilobytes can unpack to many gigabytes, and a file may claim any size. What a part
claims and what it really holds are both measured against an allowance before memory is taken.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader

from pneu_common.errors import InputError

LARGEST_RATIO = 100
"""Recordings of sensors unpack to some 2 to 20 times their size, as every stamp is another."""
FREE_BYTES = 64 << 20
"""What may be unpacked from any file, however small."""

_STEP_BYTES = 1 << 20
_HEAD = struct.Struct("<BQ")
"""Of a record: its opcode and length."""
_MESSAGE = struct.Struct("<HIQQ")
"""Of a message: channel, sequence, log and publish time."""


class DamagedError(ValueError):
    """Signals a part that is not what it says."""


class Allowance:
    """How much may still be unpacked from a file.

    Args:
        path: The file, for the message.
        size: Its size as it lies there, bytes.
    """

    def __init__(self, path: str | Path, size: int) -> None:
        self.path = path
        self.size = size
        self.left = self.most = FREE_BYTES + LARGEST_RATIO * size

    def check(self, claimed: int) -> None:
        """Refuses a part that claims more than is left.

        Args:
            claimed: What it says that it unpacks to, bytes.

        Raises:
            InputError: That is too much.
        """
        if claimed > self.left:
            raise InputError(
                f"{self.path}: its {self.size} bytes unpack to more than {self.most / 1e6:.0f} MB,"
                f" which is the most that is unpacked ({LARGEST_RATIO} times its size and"
                f" {FREE_BYTES / 1e6:.0f} MB); where that is meant, `mcap decompress` makes a file"
                " that is read as it is"
            )

    def take(self, size: int) -> None:
        """Counts what was unpacked.

        Args:
            size: How much, bytes.

        Raises:
            InputError: That is more than is left.
        """
        self.check(size)
        self.left -= size


def unzstd(stream: IO[bytes], allowance: Allowance, claimed: int | None = None) -> bytes:
    """Unpacks one zstd frame.

    Args:
        stream: Where it stands.
        allowance: What may be unpacked.
        claimed: What it should unpack to, bytes; None where nothing says so.

    Raises:
        InputError: It unpacks to more than is allowed.
        DamagedError: It unpacks to more than is claimed.
        zstandard.ZstdError: It is damaged.
    """
    out = bytearray()
    with zstandard.ZstdDecompressor().stream_reader(stream, closefd=False) as reader:
        while part := reader.read(_STEP_BYTES):
            allowance.take(len(part))
            out += part
            if claimed is not None and len(out) > claimed:
                raise DamagedError(f"a part unpacks to more than the {claimed} bytes that it names")
    return bytes(out)


def chunk_records(
    chunk: Chunk, allowance: Allowance, validate_crc: bool = True
) -> Iterator[Schema | Channel | Message]:
    """Yields the records inside of a chunk of an MCAP file.

    Args:
        chunk: The chunk.
        allowance: What may be unpacked.
        validate_crc: Whether its checksum is compared, where it has one.

    Raises:
        InputError: It unpacks to more than is allowed.
        DamagedError: It is not what it says.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "":
        data = chunk.data
    else:
        allowance.check(size)
        if chunk.compression == "zstd":
            data = unzstd(io.BytesIO(chunk.data), allowance, size)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            allowance.take(len(data))
        else:
            raise DamagedError(
                f"a chunk is compressed by {chunk.compression!r}, read are zstd and lz4"
            )
    if len(data) != size:
        raise DamagedError(f"a chunk holds {len(data)} bytes, it names {size}")
    if validate_crc and chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise DamagedError("the checksum of a chunk is not that of its content")
    # Message by message through the library's stream takes four times as long.
    at, end = 0, len(data)
    while at < end:
        if end - at < _HEAD.size:
            raise EOFError(f"a chunk ends within the head of a record, {end - at} bytes of it")
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > end - at:
            raise EOFError(f"{length} bytes are named where {end - at} are left")
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise DamagedError(f"a message has {length} bytes, its head alone {_MESSAGE.size}")
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
            yield Message(
                channel, log_ns, data[at + _MESSAGE.size : at + length], publish_ns, sequence
            )
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            part = Bounded(io.BytesIO(data[at : at + length]), length)
            kind = Channel if opcode == Opcode.CHANNEL else Schema
            yield kind.read(ReadDataStream(cast(Any, part)))
        at += length


class WithoutIndex(StreamReader):
    """Reads records as they come, the indexes of messages as empty ones.

    An index is as many numbers as there are messages, and whoever reads all of them needs none.
    """

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode == Opcode.MESSAGE_INDEX:
            self._stream.read(length)  # counted in the checksum all the same
            return MessageIndex(0, [])
        return super()._read_record(opcode, length)


class Bounded:
    """A stream that takes no memory for bytes that it does not have, whatever is asked of it.

    Args:
        stream: The stream, which can seek.
        size: Its length, bytes.
    """

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream = stream
        self._size = size

    def __enter__(self) -> "Bounded":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def read(self, size: int = -1) -> bytes:
        """Reads what is asked for.

        Args:
            size: Number of bytes; negative takes all that is left.

        Raises:
            EOFError: Fewer bytes are left.
        """
        left = max(self._size - self._stream.tell(), 0)
        if size > left:
            raise EOFError(f"{size} bytes are named where {left} are left")
        return self._stream.read(size if size >= 0 else left)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Goes to a place, at most to the end: that of when it was opened, where a file grows.

        Args:
            offset: Where, bytes from the origin.
            whence: The origin, as for any stream.
        """
        begin = {io.SEEK_SET: 0, io.SEEK_CUR: self._stream.tell(), io.SEEK_END: self._size}[whence]
        return self._stream.seek(min(max(begin + offset, 0), self._size))

    def tell(self) -> int:
        """Returns the place."""
        return self._stream.tell()

    def seekable(self) -> bool:
        """Returns true."""
        return True


def bounded(path: Path) -> Any:
    """Opens a file for reading within its bounds.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be opened.
    """
    return Bounded(path.open("rb"), path.stat().st_size)
