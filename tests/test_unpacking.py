# SPDX-License-Identifier: Apache-2.0
"""Files that unpack to far more than they are: refused in one sentence, before memory is taken."""

import io
import os
import resource
import struct
import subprocess
import sys

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from tests.test_bad_input import RIG, check_refusal, recording
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.errors import InputError
from pneu_graph.bag.unpacking import FREE_BYTES, Allowance, bounded, unzstd
from pneu_sim.rig import load_rig
from pneu_sysid.records.write import write_bag

BOMB_BYTES = 1 << 30
MEMORY_BYTES = 3 << 29  # what such a process takes, and less than the bomb on top
CHUNK, MAGIC = 0x06, b"\x89MCAP0\r\n"


@pytest.fixture(scope="module")
def zeros():
    """A gigabyte of zeros, packed: with the size in the frame, without it, and by LZ4."""
    plain = bytes(BOMB_BYTES)
    quiet = zstandard.ZstdCompressor(level=1, write_content_size=False)
    return {
        "zstd": zstandard.compress(plain, 1),
        "zstd, of unknown size": quiet.compress(plain),
        "lz4": lz4.frame.compress(plain),
    }


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "run.mcap"
    write_bag(path, load_rig(RIG), recording(60))
    return path.read_bytes()


def with_chunk(good, compression, content, claimed):
    """A sound file whose first chunk is replaced."""
    out, at, done = [MAGIC], len(MAGIC), False
    while at + 9 <= len(good) - len(MAGIC):
        length = struct.unpack_from("<Q", good, at + 1)[0]
        body = good[at + 9 : at + 9 + length]
        if good[at] == CHUNK and not done:
            name = compression.encode()
            body = struct.pack("<QQQI", 0, 2**62, claimed, 0) + struct.pack("<I", len(name)) + name
            body += struct.pack("<Q", len(content)) + content
            done = True
        out += [bytes([good[at]]), struct.pack("<Q", len(body)), body]
        at += 9 + length
    assert done
    return b"".join([*out, MAGIC])


def bounded_pneu(folder, *words):
    """Runs `pneu` in a process that gets no more memory than it needs for a small bag."""
    code = "import sys; sys.argv[0] = 'pneu'; from pneu_common.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=120,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES)),
    )


def check(done, *named):
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("pneu: ") and done.stderr.count("\n") == 1
    for text in named:
        assert text in done.stderr


@pytest.mark.long
@pytest.mark.parametrize("claimed", [BOMB_BYTES, 1000, 12 * 10**9])
@pytest.mark.parametrize("packing", ["zstd", "zstd, of unknown size", "lz4"])
def test_a_chunk_that_unpacks_to_a_gigabyte(tmp_path, good, zeros, packing, claimed):
    bag = tmp_path / "bomb.mcap"
    bag.write_bytes(with_chunk(good, packing.partition(",")[0], zeros[packing], claimed))
    assert bag.stat().st_size < 6e6
    app = build_app()
    for words in (["compare", bag, "--rig", RIG, "--no-refine"], ["bag", "info", bag]):
        ended = CliRunner().invoke(app, [str(word) for word in words], prog_name="pneu")
        if claimed >= BOMB_BYTES:
            check_refusal(ended, bag, "bytes unpack to more than")
        elif words[0] == "compare":  # the other goes as far as the file is whole, and says so
            check_refusal(ended, bag, "damaged")


@pytest.mark.long
def test_in_a_process_without_the_memory_for_it(tmp_path, good, zeros):
    bag = tmp_path / "bomb.mcap"
    bag.write_bytes(with_chunk(good, "zstd", zeros["zstd"], BOMB_BYTES))
    done = bounded_pneu(tmp_path, "compare", bag, "--rig", RIG, "--no-refine")
    check(done, "bomb.mcap", "unpack to more than")


@pytest.mark.long
def test_a_file_that_unpacks_to_a_gigabyte(tmp_path, zeros):
    bag = tmp_path / "bomb.mcap.zstd"
    for packing in ("zstd", "zstd, of unknown size"):
        bag.write_bytes(zeros[packing])
        done = bounded_pneu(tmp_path, "compare", bag, "--rig", RIG, "--no-refine")
        check(done, "bomb.mcap.zstd", "unpack to more than")


@pytest.mark.long
def test_a_message_that_unpacks_to_a_gigabyte(tmp_path, zeros):
    """Of rosbag2's compression by message, which packs each one by itself."""
    rig = load_rig(RIG)
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    for part in (*rig.taps.values(), *rig.commands.values()):
        channel = part.channel
        schema = writer.register_schema(channel.type, "ros2msg", b"")
        number = writer.register_channel(channel.topic, "cdr", schema)
        for k in range(30):
            writer.add_message(number, 10**9 + k, zeros["zstd"] if k == 3 else bytes(12), k)
    writer.finish()
    bag = tmp_path / "bomb.mcap"
    bag.write_bytes(out.getvalue())
    done = bounded_pneu(tmp_path, "compare", bag, "--rig", RIG, "--no-refine")
    check(done, "bomb.mcap")


def test_a_playback_of_such_a_file(tmp_path, good, zeros):
    from pneu_graph.bag.reader import BagReader

    bag = tmp_path / "bomb.mcap"
    bag.write_bytes(with_chunk(good, "zstd", zeros["zstd"], BOMB_BYTES))
    with pytest.raises(InputError, match=r"bomb\.mcap: .* unpack to more than"):
        list(BagReader(bag).messages())


def test_what_is_well_packed_is_read():
    """Zeros a thousand times as long as their packing, within what any file may hold."""
    packed = zstandard.compress(bytes(FREE_BYTES // 2))
    assert len(packed) < FREE_BYTES / 1000
    allowance = Allowance("a", len(packed))
    assert unzstd(io.BytesIO(packed), allowance) == bytes(FREE_BYTES // 2)
    with pytest.raises(InputError, match="a: its"):
        unzstd(io.BytesIO(zstandard.compress(bytes(FREE_BYTES))), allowance)


def test_a_sound_bag_of_every_packing_is_read(tmp_path, good):
    from mcap.reader import make_reader

    from pneu_graph.bag.reader import BagReader
    from pneu_sysid.records.container import bag_topics

    counts = set()
    for packing in CompressionType:
        out = io.BytesIO()
        writer = Writer(out, chunk_size=500, compression=packing)
        writer.start()
        numbers = {}
        for schema, channel, message in make_reader(io.BytesIO(good)).iter_messages():
            if channel.id not in numbers:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", kind)
            writer.add_message(numbers[channel.id], message.log_time, message.data, 0)
        writer.finish()
        bag = tmp_path / f"{packing.name}.mcap"
        bag.write_bytes(out.getvalue())
        topics = bag_topics(bag)
        played = [message.topic for message in BagReader(bag).messages()]
        assert sum(count for _, count in topics.values()) == len(played)
        counts.add(len(played))
    assert len(counts) == 1 and counts.pop() > 100


def test_a_file_that_grows_ends_where_it_ended_when_it_was_opened(tmp_path):
    path = tmp_path / "growing"
    path.write_bytes(b"0123456789")
    with bounded(path) as stream:
        with path.open("ab") as more:
            more.write(b"abcdef")
        assert stream.seek(-4, io.SEEK_END) == 6
        assert stream.read(4) == b"6789"
        assert stream.seek(100) == 10
        assert stream.seek(-100, io.SEEK_CUR) == 0
        assert stream.read() == b"0123456789"
        with pytest.raises(EOFError):
            stream.read(1)
