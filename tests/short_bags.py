# SPDX-License-Identifier: Apache-2.0
"""Beginnings of recordings, for tests that need no more of them."""

from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer


def shorten(whole: Path, short: Path, seconds: float) -> None:
    """Writes the beginning of a recording.

    Args:
        whole: The recording, an MCAP file.
        short: Where its beginning is written.
        seconds: How long, s.
    """
    with whole.open("rb") as source, short.open("wb") as sink:
        writer, known, end_ns = Writer(sink), {}, None
        writer.start("ros2")
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            end_ns = end_ns or message.log_time + round(1e9 * seconds)
            if message.log_time > end_ns:
                break
            if channel.id not in known:
                of = writer.register_schema(schema.name, schema.encoding, schema.data)
                encoding = channel.message_encoding
                known[channel.id] = writer.register_channel(channel.topic, encoding, of)
            at_ns = message.log_time, message.publish_time
            writer.add_message(known[channel.id], at_ns[0], message.data, at_ns[1])
        writer.finish()
