"""What a small file can make a reader hold is bounded."""

import os
import struct

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from tests.replay.logs import builders as b
from tests.replay.logs.other_forms import HEAD

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers import limits as held
from fbench.replay.logs.containers.mcap import index as definitions
from fbench.replay.logs.containers.mcap import records
from fbench.replay.logs.open import open_container

MAGIC = b"\x89MCAP0\r\n"


def record(opcode, content):
    return HEAD.pack(opcode, len(content)) + content


def text(data):
    return struct.pack("<I", len(data)) + data


def chunk(content, compression=b"zstd"):
    stored = (zstandard if compression == b"zstd" else lz4.frame).compress(content)
    head = struct.pack("<QQQI", 0, 1, len(content), 0) + text(compression)
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(stored)) + stored)


def saved(tmp_path, *parts):
    path = tmp_path / "log.mcap"
    end = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20)) + MAGIC
    path.write_bytes(MAGIC + record(Opcode.HEADER, bytes(8)) + b"".join(parts) + end)
    return path


def schema(id_, size):
    return record(Opcode.SCHEMA, struct.pack("<H", id_) + text(b"a") + text(b"x") + text(bytes(size)))


@pytest.mark.slow
@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_millions_of_empty_records(tmp_path, compression):
    path = saved(tmp_path, chunk(HEAD.pack(0x20, 0) * 1_500_000, compression))
    with pytest.raises(LimitError, match=r"log\.mcap: chunk at byte 25: holds more than 1048576 records") as error:
        b.read(path)
    assert error.value.code == "LIM001"


def test_one_schema_that_is_too_large(tmp_path):
    path = saved(tmp_path, chunk(schema(1, definitions.MAX_DEFINITIONS)))
    with pytest.raises(LimitError, match=r"chunk at byte 25: schemas and channels of more than 16777216 bytes"):
        b.read(path)


def test_schemas_that_are_too_large_together(tmp_path):
    parts = [chunk(schema(i, definitions.MAX_DEFINITIONS // 3)) for i in range(1, 5)]
    with pytest.raises(LimitError, match=r"byte \d+: schemas and channels of more than 16777216 bytes"):
        b.read(saved(tmp_path, *parts))


def test_definitions_that_are_repeated_in_each_chunk(tmp_path):
    parts = [chunk(schema(1, definitions.MAX_DEFINITIONS // 3))] * 6
    _, faults = b.read(saved(tmp_path, *parts))
    assert not faults.num_lost


def test_more_chunks_than_an_index_may_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(definitions, "MAX_CHUNKS", 3)
    path = b.write(tmp_path / "log.mcap", b.sequence(8), chunk_size=2000)
    with pytest.raises(LimitError, match=r"log\.mcap: summary: more than 3 chunks; write larger ones"):
        b.read(path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(LimitError, match=r"log\.mcap: more than 3 chunks; write larger ones"):
        b.read(path)


def test_metadata_that_are_too_large(tmp_path):
    items = text(b"k") + text(bytes(definitions.MAX_METADATA))
    path = saved(tmp_path, record(Opcode.METADATA, text(b"fbench") + text(items)))
    _, faults = b.read(path)
    assert "more than the limit of 4194304" in faults.places["LOG004"][0]


def test_metadata_of_others_are_not_kept(tmp_path):
    path = saved(tmp_path, record(Opcode.METADATA, text(b"other") + text(b"no map at all")))
    faults = FaultLog()
    assert open_container(path, faults).header is None
    assert not faults.num_lost


def test_lz4_is_unpacked_once(tmp_path):
    content = os.urandom(3_000_000)
    found = records.unpack(
        records.Chunk(0, 0, len(content), 0, "lz4", memoryview(lz4.frame.compress(content))), "somewhere"
    )
    assert bytes(found) == content


def test_a_pipe_is_refused_and_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "log.mcap")
    with pytest.raises(LogError, match=r"log\.mcap: not a regular file"):
        b.read(tmp_path / "log.mcap")


def large(log_ns, size):
    """A chunk with one message of `size` zeros."""
    message = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, log_ns, log_ns) + bytes(size))
    stored = zstandard.compress(message)
    head = struct.pack("<QQQI", log_ns, log_ns, len(message), 0) + text(b"zstd")
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(stored)) + stored)


def channel():
    return record(Opcode.CHANNEL, struct.pack("<HH", 1, 0) + text(b"/zeros") + text(b"") + struct.pack("<I", 0))


def counted(path):
    container = open_container(path, FaultLog())
    return sum(1 for _ in container.entries(frozenset(container.channels)))


def test_chunks_of_one_time_that_fill_the_memory_together(tmp_path, monkeypatch):
    monkeypatch.setattr(held, "MAX_HELD", 3_000_000)
    path = saved(tmp_path, channel(), *(large(5, 1_000_000) for _ in range(4)))
    with pytest.raises(
        LimitError, match=r"log\.mcap: byte \d+: chunks that overlap in time unpack to over 3000000"
    ) as error:
        counted(path)
    assert error.value.code == "LIM002"


def test_chunks_one_after_the_other_are_read_however_many(tmp_path, monkeypatch):
    monkeypatch.setattr(held, "MAX_HELD", 3_000_000)
    assert counted(saved(tmp_path, channel(), *(large(i, 1_000_000) for i in range(9)))) == 9
    assert counted(saved(tmp_path, channel(), *(large(i, 4_000_000) for i in range(2)))) == 2
