"""Damaged, cut and hostile files: one clear error or a counted fault, never silence."""

import errno
import gzip
import json
import struct
import tracemalloc
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from tests.replay.logs import builders as b
from tests.replay.logs.other_forms import HEAD, NO_SUMMARY, chunks, layout, rewrite

from fbench.replay.contracts.errors import ConfigError, FbenchError, LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import PointCloud, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_container, open_log


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return b.write(tmp_path_factory.mktemp("log") / "drive.mcap", b.sequence(8), b.the_rig(), chunk_size=2000)


def content(path):
    """Messages and truths as comparable texts, and the counted faults."""
    reader, faults = b.read(path)
    found = [repr(b.canonical(m)) for m in (*reader.messages(), *reader.truths())]
    return found, faults


def saved(tmp_path, data):
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("data", "guess"),
    [
        (b"", "an empty file"),
        (b"PAR1abc", "Parquet; give the folder that it belongs to"),
        (gzip.compress(b"x", mtime=0), "gzip"),
        (b"PK\x03\x04abc", "a zip archive"),
        (json.dumps({"a": 1}).encode(), "JSON"),
        (b"stamp,x,y\n1,2,3\n", "text"),
        (bytes(range(128, 256)), "unknown binary data"),
        (b"\x89MCAP1\r\n", "MCAP of another version"),
    ],
)
def test_what_is_not_mcap_is_named(tmp_path, data, guess):
    with pytest.raises(LogError, match=rf"log\.mcap: not a log \(looks like {guess}\)$"):
        b.read(saved(tmp_path, data))


def test_folder_and_missing_file(tmp_path):
    with pytest.raises(LogError, match=r"no log \(a folder without log\.json and without"):
        b.read(tmp_path)
    with pytest.raises(LogError, match=r"none\.mcap: can't be read \(No such file or directory\)"):
        b.read(tmp_path / "none.mcap")


def test_no_permission(tmp_path, monkeypatch):
    def refuse(path, mode="r"):
        raise PermissionError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(LogError, match=r"log\.mcap: can't be read \(Permission denied\)"):
        b.read(tmp_path / "log.mcap")


@pytest.mark.slow
def test_truncated_log_gives_all_whole_chunks(tmp_path, drive):
    data = drive.read_bytes()
    whole, _ = content(drive)
    ends = [at + length for at, length in chunks(data)]
    counts = []
    for cut in range(9, len(data), 97):
        found, faults = content(saved(tmp_path, data[:cut]))
        assert faults.counts["LOG002"] == 1, cut
        assert set(found) <= set(whole)
        counts.append((sum(end <= cut for end in ends), len(found)))
    assert counts == sorted(counts)
    assert counts[-1] == (len(ends), len(whole))  # cut inside the summary


def test_truncation_names_byte_and_last_stamp(tmp_path, drive):
    data = drive.read_bytes()
    at, length = chunks(data)[1]
    path = saved(tmp_path, data[: at + length + 3])
    reader, faults = b.read(path)
    last = max(m.log_ns for m in reader.messages())
    [where] = faults.places["LOG002"]
    assert where == f"log.mcap: truncated at byte {at + length}, last good stamp {last}"
    assert "LOG003" not in faults.counts


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, NO_SUMMARY, {"use_chunking": False}, {"use_chunking": False, **NO_SUMMARY}])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_no_flipped_bit_is_silent(tmp_path, drive, how, compression):
    source = rewrite(drive, tmp_path / "source.mcap", chunk_size=3000, compression=compression, **how)
    data = source.read_bytes()
    whole, clean = content(source)
    rng = np.random.Generator(np.random.Philox(1))
    for bit in rng.integers(0, 8 * len(data), 40):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << (bit % 8)
        try:
            found, faults = content(saved(tmp_path, bytes(damaged)))
        except FbenchError:
            continue
        if found != whole:
            assert faults.num_lost > clean.num_lost, f"bit {bit}"


def test_damaged_chunk_is_skipped_and_counted_once(tmp_path, drive):
    data = bytearray(drive.read_bytes())
    at, length = chunks(data)[2]
    data[at + length - 5] ^= 1
    reader, faults = b.read(saved(tmp_path, data))
    whole, _ = content(drive)
    found = [repr(b.canonical(m)) for m in (*reader.messages(), *reader.truths())]
    again = [repr(b.canonical(m)) for m in (*reader.messages(), *reader.truths())]
    assert found == again
    assert 0 < len(found) < len(whole)
    assert faults.counts == {"LOG004": 1}
    assert faults.places["LOG004"][0].startswith(f"log.mcap: byte {at}: ")


def test_damaged_metadata_are_not_used(tmp_path, drive):
    data = drive.read_bytes().replace("Köln".encode(), b"Koeln", 1)
    reader, faults = b.read(saved(tmp_path, data))
    assert faults.counts == {"LOG004": 1}
    assert reader.info.metadata == {}
    assert b.canonical(reader.rig) == b.canonical(b.the_rig())


def test_damaged_summary_costs_the_index_only(tmp_path, drive):
    data = bytearray(drive.read_bytes())
    data[-60] ^= 1
    found, faults = content(saved(tmp_path, data))
    assert found == content(drive)[0]
    assert faults.counts == {"LOG003": 1}


def test_chunks_without_checksum_are_reported(tmp_path, drive):
    path = rewrite(drive, tmp_path / "log.mcap", chunk_size=3000, enable_crcs=False)
    reader, faults = b.read(path)
    for _ in range(2):
        assert list(reader.messages())
        assert list(reader.truths())
    num = len(chunks(path.read_bytes()))
    assert faults.counts == {"LOG003": 1, "LOG006": num}
    assert faults.places["LOG006"] == [f"log.mcap: {num} chunks"]


def test_chunk_without_checksum_under_a_verified_index_is_reported_when_it_is_read(tmp_path, drive):
    data = bytearray(drive.read_bytes())
    at, _ = chunks(data)[1]
    data[at + 9 + 24 : at + 9 + 28] = bytes(4)
    reader, faults = b.read(saved(tmp_path, data))
    for _ in range(2):
        assert list(reader.messages())
    assert faults.counts == {"LOG006": 1}
    assert faults.places["LOG006"] == [f"log.mcap: chunk at byte {at}"]


def test_messages_outside_chunks_without_checksum_are_reported(tmp_path, drive):
    path = rewrite(drive, tmp_path / "log.mcap", use_chunking=False, enable_data_crcs=False)
    _, faults = content(path)
    assert faults.counts["LOG006"] == 1
    assert "messages outside chunks" in faults.places["LOG006"][0]


@pytest.mark.parametrize("record", [Opcode.HEADER, Opcode.MESSAGE])
def test_messages_outside_chunks_are_delivered_only_if_the_checksum_over_all_is_right(tmp_path, drive, record):
    """It isn't known where the damage is: any of them may be the wrong one."""
    path = rewrite(drive, tmp_path / "log.mcap", use_chunking=False)
    data = bytearray(path.read_bytes())
    at, length = next((at, length) for opcode, at, length in layout(bytes(data)) if opcode == record)
    data[at + length - 1] ^= 1
    path.write_bytes(data)
    container = open_container(path, faults := FaultLog())
    assert not list(container.entries(frozenset(container.channels)))
    assert sum(container.counts.values()) == 0
    assert faults.counts == {"LOG003": 1, "LOG004": 1}
    assert faults.places["LOG004"][0].endswith("messages outside chunks can be trusted")


def test_chunks_keep_their_messages_where_those_outside_are_lost(tmp_path, drive):
    data = rewrite(drive, tmp_path / "log.mcap", chunk_size=3000, **NO_SUMMARY).read_bytes()
    num, places = len(content(tmp_path / "log.mcap")[0]), layout(data)
    at, length = next((at, length) for opcode, at, length in places if opcode == Opcode.CHUNK)
    plain = HEAD.pack(Opcode.MESSAGE, 22) + struct.pack("<HIQQ", 1, 0, 5, 5)
    found, faults = content(saved(tmp_path, data[: at + length] + plain + data[at + length :]))
    assert len(found) == num
    assert faults.counts == {"LOG003": 1, "LOG004": 1}


def test_index_that_misses_a_chunk_is_not_trusted(tmp_path, drive):
    """A summary with a correct checksum that lists one chunk less, as a broken writer may leave."""
    data = drive.read_bytes()
    records = layout(data)
    footer_at = records[-1][1]
    (start,) = struct.unpack_from("<Q", data, footer_at + 9)
    inside = [r for r in records if start <= r[1] < footer_at and r[0] != Opcode.STATISTICS]
    missing = next(r for r in inside if r[0] == Opcode.CHUNK_INDEX)
    summary = b"".join(data[at : at + n] for _, at, n in inside if at != missing[1])
    footer = HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
    crc = struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary)))
    found, faults = content(saved(tmp_path, data[:start] + summary + footer + crc + data[-8:]))
    assert found == content(drive)[0]
    assert faults.places["LOG003"] == ["log.mcap: index is incomplete"]


def one_chunk(tmp_path, compression, size, stored):
    """A file without summary that has one chunk as given."""
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(stored))
    start = b"\x89MCAP0\r\n" + HEAD.pack(Opcode.HEADER, 8) + bytes(8)
    chunk = HEAD.pack(Opcode.CHUNK, len(body) + len(stored)) + body + stored
    end = HEAD.pack(Opcode.DATA_END, 4) + bytes(4) + HEAD.pack(Opcode.FOOTER, 20) + bytes(20) + b"\x89MCAP0\r\n"
    return saved(tmp_path, start + chunk + end)


def test_unknown_compression(tmp_path):
    with pytest.raises(LogError, match=r"chunk at byte 25: unknown compression 'brotli'"):
        b.read(one_chunk(tmp_path, "brotli", 3, b"abc"))


def test_chunk_that_declares_too_much_is_refused(tmp_path):
    with pytest.raises(LogError, match=r"chunk at byte 25: declares 2\d+ bytes, more than the limit of 268435456"):
        b.read(one_chunk(tmp_path, "zstd", 2**31, b"abc"))


@pytest.mark.parametrize("compress", [zstandard.compress, lz4.frame.compress])
def test_bomb_is_not_unpacked(tmp_path, compress):
    name = "zstd" if compress is zstandard.compress else "lz4"
    path = one_chunk(tmp_path, name, 100, compress(bytes(200_000_000)))
    tracemalloc.start()
    with pytest.raises(LimitError, match=r"log\.mcap: chunk at byte \d+: .* it is a decompression bomb") as error:
        b.read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert error.value.code == "LIM002"
    assert peak < 20_000_000


@pytest.mark.parametrize("compress", [zstandard.compress, lz4.frame.compress])
def test_chunk_that_is_a_little_larger_than_it_says_is_damaged(tmp_path, compress):
    name = "zstd" if compress is zstandard.compress else "lz4"
    _, faults = b.read(one_chunk(tmp_path, name, 100, compress(bytes(1000))))
    assert "declares 100 unpacked bytes and has" in faults.places["LOG004"][0]


def test_record_beyond_the_limit_is_refused(tmp_path, monkeypatch, drive):
    monkeypatch.setattr("fbench.replay.logs.containers.mcap.records.MAX_RECORD", 1000)
    with pytest.raises(LogError, match="more than the limit of 1000"):
        content(drive)


def foreign(path, topics):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, schema, encoding, datas in topics:
            id_ = writer.register_schema(schema, "x", b"") if schema else 0
            channel = writer.register_channel(topic, encoding, id_)
            for i, data in enumerate(datas):
                writer.add_message(channel, i, data, i)
        writer.finish()
    return path


def test_unknown_topics_are_counted_once(tmp_path):
    topics = [("/odd", "my.Type", "json", [b"1", b"2"]), ("/bare", "", "", [b"1"]), ("/json", "", "json", [b"{}"]),
              ("/ros", "foxglove.PointCloud", "cdr", [b"1"])]  # fmt: skip
    reader, faults = b.read(foreign(tmp_path / "log.mcap", topics))
    assert list(reader.messages()) == []
    assert list(reader.messages()) == []
    assert faults.places["LOG012"] == [
        "log.mcap: topic '/bare' has type 'unknown' (encoding none)",
        "log.mcap: topic '/json' has type 'unknown' (encoding json), without a schema that says what it is",
        "log.mcap: topic '/odd' has type 'my.Type' (encoding json)",
    ]
    what = "topic '/ros' has type 'foxglove.PointCloud' (encoding cdr)"
    assert faults.places["LOG013"] == [f"log.mcap: {what}; a decoder plug-in can read it, named with --decoder"]


@pytest.mark.parametrize(
    ("topic", "schema", "code"),
    [
        ("/pandar_packets", "hesai_ros_driver/msg/UdpFrame", "LOG013"),
        ("/sensing/lidar/top/pandar_packets", "pandar_msgs/msg/Unknown", "LOG013"),
        ("/rslidar_packets", "rslidar_msg/msg/RslidarPacket", "LOG013"),
        ("/ars408/front", "continental_radar_msgs/msg/Ars540Scan", "LOG013"),
        ("/cam0", "acme_msgs/msg/RawVideo", "LOG013"),
        ("/old_cloud", "sensor_msgs/msg/PointCloud", "LOG013"),
        ("/lidar/status", "acme_msgs/msg/LidarStatus", "LOG012"),
        ("/lidar/imu_packets", "acme_msgs/msg/PacketMsg", "LOG012"),
        ("/radar/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "LOG012"),
        ("/lidar/name", "std_msgs/msg/String", "LOG012"),
        ("/gnss/fix", "sensor_msgs/msg/NavSatFix", "LOG012"),
        ("/lidar/gps", "acme_msgs/msg/Sentence", "LOG012"),
    ],
)
def test_topics_that_look_like_those_of_sensors_are_told_apart(tmp_path, topic, schema, code):
    path = foreign(tmp_path / "log.mcap", [(topic, schema, "cdr", [bytes(20)])])
    faults = FaultLog()
    open_log(path, faults)
    assert {c: num for c, num in faults.counts.items() if c.startswith("LOG01")} == {code: 1}
    (place,) = faults.places[code]
    assert f"topic '{topic}' has type '{schema}'" in place
    assert ("--decoder" in place) == (code == "LOG013")


def test_an_empty_topic_of_a_sensor_is_not_missed(tmp_path):
    faults = FaultLog()
    open_log(foreign(tmp_path / "log.mcap", [("/lidar_packets", "acme/msg/Packets", "cdr", [])]), faults)
    assert not faults.counts["LOG013"]


def test_payload_that_cannot_be_decoded(tmp_path):
    reader, faults = b.read(foreign(tmp_path / "log.mcap", [("/p", "foxglove.PointCloud", "protobuf", [b"\xff", b""])]))
    assert list(reader.messages()) == []
    assert list(reader.messages()) == []
    assert faults.counts == {"DEC001": 1, "DEC003": 1}
    assert faults.places["DEC001"] == ["log.mcap: /p at 0: message is cut off"]
    assert faults.places["DEC003"] == ["log.mcap: /p at 1: points have no field x, y, z"]


def test_topic_that_is_not_utf8(tmp_path, drive):
    path = rewrite(drive, tmp_path / "log.mcap", enable_crcs=False, enable_data_crcs=False)
    found, faults = content(saved(tmp_path, path.read_bytes().replace(b"/top/points", b"/top/point\xff")))
    assert len(found) == len(content(drive)[0])
    assert faults.places["LOG010"][0].endswith("topic '/top/point\\xff'")


def test_disk_that_fails_while_reading(drive, monkeypatch):
    reader, _ = b.read(drive)
    messages = reader.messages()
    next(messages)

    def fail(*_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("fbench.replay.logs.containers.mcap.records.parse_chunk", fail)
    with pytest.raises(LogError, match=r"drive\.mcap: can't be read \(Input/output error\)"):
        list(messages)


def test_two_schemas_on_one_topic(tmp_path):
    topics = [("/p", "foxglove.PointCloud", "protobuf", [b""]), ("/p", "foxglove.RawImage", "protobuf", [b""])]
    with pytest.raises(LogError, match="topic '/p' has messages of two schemas"):
        b.read(foreign(tmp_path / "log.mcap", topics))


def test_what_the_writer_refuses(tmp_path):
    path = tmp_path / "log.mcap"
    cloud = PointCloud("a", 1, 1, np.zeros((0, 3), np.float32))
    bad = [
        (PointCloud("a", -1, 1, cloud.xyz), "stamp_ns -1 is outside 0 to"),
        (PointCloud("a", 1, 2**63, cloud.xyz), "log_ns 9223372036854775808 is outside"),
        (PointCloud("a", 1, 1, cloud.xyz, frame_number=2**32), "frame_number 4294967296 is outside"),
        (PointCloud("\ud800", 1, 1, cloud.xyz), "can't be stored"),
    ]
    for message, text in bad:
        with pytest.raises(LogError, match=text), McapWriter(path, b.INFO, b.NO_RIG) as writer:
            writer.write(message)
    with pytest.raises(ConfigError, match="compression 'brotli': choose one of zstd, lz4, none"):
        McapWriter(path, b.INFO, b.NO_RIG, compression="brotli")
    with pytest.raises(LogError, match="metadata can't be stored"):
        McapWriter(path, LogInfo("log", "\ud800"), Rig({}, {}))
    assert list(tmp_path.iterdir()) == []
    path.touch()
    with pytest.raises(ConfigError, match="can't be written"):
        McapWriter(path / "log.mcap", b.INFO, b.NO_RIG)


def test_an_error_leaves_nothing_behind_and_keeps_the_old_file(tmp_path, drive):
    path = saved(tmp_path, b"old")

    def broken():
        yield Truth(1, 1)
        raise KeyError

    with pytest.raises(KeyError):
        b.write(path, broken())
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]
    assert path.read_bytes() == b"old"


def test_foreign_readers_accept_the_checksums(drive):
    with drive.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) > 40


@pytest.mark.parametrize("field", [16, 24])
@pytest.mark.parametrize("value", [3, 10**6, 2**63, 2**64 - 1])
def test_index_that_points_elsewhere_is_not_trusted(tmp_path, drive, field, value):
    """Offset (16) or length (24) of a chunk in the index is wrong, the checksum of the summary is right."""
    data = bytearray(drive.read_bytes())
    records = layout(data)
    footer_at = records[-1][1]
    (start,) = struct.unpack_from("<Q", data, footer_at + 9)
    entry = next(at for opcode, at, _ in records if opcode == Opcode.CHUNK_INDEX)
    struct.pack_into("<Q", data, entry + 9 + field, value)
    struct.pack_into("<I", data, footer_at + 25, zlib.crc32(data[start : footer_at + 25]))
    found, faults = content(saved(tmp_path, bytes(data)))
    assert found == content(drive)[0]
    assert faults.counts["LOG003"] == 1


def test_a_disk_that_is_full_from_the_start_leaves_nothing(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "add_metadata", refuse)
    with pytest.raises(ConfigError, match=r"a\.mcap: can't be written \(No space left on device\)") as caught:
        McapWriter(tmp_path / "a.mcap", b.INFO, b.NO_RIG)
    assert caught.value.exit_code == 3
    assert not list(tmp_path.iterdir())
