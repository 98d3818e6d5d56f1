"""SQLite files of rosbag2 against the library `rosbags`, and what SQL can do to a reader."""

import sqlite3
import tracemalloc
from contextlib import closing

import numpy as np
import pytest
from tests.replay.logs.containers.rosbag import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.containers.mcap.records import MAX_RECORD
from fbench.replay.logs.containers.rosbag.sqlite import KEYS, Db3File


def opened(path, compression=""):
    faults = FaultLog()
    return Db3File(path, faults, compression), faults


def written(tmp_path, messages=None, **how):
    return b.write_bag2(tmp_path / "bag", b.rows() if messages is None else messages, **how) / "bag.db3"


def changed(path, *statements):
    """The file after some SQL, as others may have made it."""
    with closing(sqlite3.connect(path)) as database, database:
        for statement in statements:
            database.execute(statement)
    return path


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("mode", ["none", "message"])
def test_reads_what_rosbags_reads(tmp_path, version, mode):
    messages = b.rows()
    path = written(tmp_path, messages, version=version, mode=mode)
    file, faults = opened(path, "zstd" if mode == "message" else "")
    got = b.everything(file)
    assert [(log_ns, topic, data) for log_ns, topic, _, data in got] == [
        (log_ns, b.TOPICS[number][0], data)
        for number, log_ns, data in sorted(messages, key=lambda row: (row[1], b.TOPICS[row[0]][0]))
    ]
    assert sorted((log_ns, topic, data) for log_ns, topic, _, data in got) == b.read_bag2(path.parent)
    assert faults.places == {"LOG006": ["bag.db3: SQLite keeps no checksums of messages"]}


def test_channels_are_topics(tmp_path):
    file, _ = opened(written(tmp_path))
    schema = Schema("std_msgs/msg/String", "ros2msg", b.DEFINITION.encode())
    metadata = {"offered_qos_profiles": "[]", "type_description_hash": "RIHS01_0"}
    assert file.channels[1] == Channel("/b", "cdr", schema, metadata)
    assert [channel.topic for channel in file.channels.values()] == ["/b", "/a", "/c"]
    assert file.header is None
    assert not file.rigs


def test_messages_without_a_format_are_those_of_ros_2(tmp_path):
    file, _ = opened(changed(written(tmp_path), "UPDATE topics SET serialization_format = ''"))
    assert {channel.encoding for channel in file.channels.values()} == {"cdr"}


def test_counts_and_times_are_those_of_the_messages(tmp_path):
    file, _ = opened(written(tmp_path))
    for number, channel in file.channels.items():
        stamps = sorted(log_ns for row, log_ns, _ in b.rows() if b.TOPICS[row][0] == channel.topic)
        assert file.counts[number] == len(stamps)
        np.testing.assert_array_equal(file.log_times()[number], stamps)


def test_only_the_wanted_channels(tmp_path):
    file, faults = opened(written(tmp_path))
    assert {entry.channel for entry in file.entries(frozenset({1, 3, 99}))} == {1, 3}
    assert b.counted(faults) == {}


def test_old_recordings_have_no_definitions(tmp_path):
    path = tmp_path / "%41 ?#.db3"  # what means something in a URI
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        database.execute("INSERT INTO topics VALUES (-4, '/a', 'a/msg/B', 'cdr'), (5, '/a', 'a/msg/B', 'cdr')")
        database.execute("INSERT INTO messages VALUES (1, 5, 7, x'01'), (2, -4, 7, x'02'), (-9, 5, 8, x'')")
    file, faults = opened(path)
    assert file.channels == dict.fromkeys((-4, 5), Channel("/a", "cdr", Schema("a/msg/B", "", b"")))
    assert b.everything(file) == [(7, "/a", 5, b"\1"), (7, "/a", -4, b"\2"), (8, "/a", 5, b"")]
    assert b.counted(faults) == {}


def plan(path):
    with closing(sqlite3.connect(path)) as database:
        return " ".join(row[-1] for row in database.execute(f"EXPLAIN QUERY PLAN {KEYS}"))


def test_index_of_timestamps_gives_the_order(tmp_path):
    assert plan(written(tmp_path)) == "SCAN messages USING COVERING INDEX timestamp_idx"


def test_order_without_the_index(tmp_path):
    path = written(tmp_path)
    expected = b.everything(opened(path)[0])
    changed(path, "DROP INDEX timestamp_idx")
    assert "TEMP B-TREE" in plan(path)
    file, faults = opened(path)
    assert b.everything(file) == expected
    assert b.counted(faults) == {}


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("ties", [True, False])
def test_memory_holds_one_message(tmp_path, index, ties):
    """40 MB of messages, also where all have one stamp and no index helps."""
    path = written(tmp_path, [(0, 1 if ties else -i + 99, bytes([i]) * 400_000) for i in range(100)])
    if not index:
        changed(path, "DROP INDEX timestamp_idx")
    file, _ = opened(path)
    tracemalloc.start()
    assert sum(1 for _ in file.entries(frozenset(file.channels))) == 100
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2_000_000


def test_nothing_is_written(tmp_path):
    path = written(tmp_path)
    changed(path, "PRAGMA journal_mode=WAL")
    before = {p.name: p.read_bytes() for p in path.parent.iterdir()}
    b.everything(opened(path)[0])
    assert {p.name: p.read_bytes() for p in path.parent.iterdir()} == before


@pytest.mark.parametrize("suffix", ["-wal", "-journal"])
def test_journals_of_a_killed_recorder_are_counted(tmp_path, suffix):
    path = written(tmp_path)
    path.with_name(path.name + suffix).write_bytes(b"x" * 100)
    file, faults = opened(path)
    assert len(b.everything(file)) == 300
    assert f"messages in bag.db3{suffix} aren't read" in faults.places["LOG002"][0]


@pytest.mark.parametrize(
    ("statement", "code", "num", "text"),
    [
        ("UPDATE messages SET data = 'text' WHERE id = 5", "LOG004", 1, "data aren't binary"),
        ("UPDATE messages SET data = 7 WHERE id = 5", "LOG004", 1, "data aren't binary"),
        ("UPDATE messages SET timestamp = 'soon' WHERE id IN (5, 6)", "LOG004", 2, "row 5 at "),
        ("UPDATE messages SET timestamp = 1.5 WHERE id = 5", "LOG004", 1, "row 5 at "),
        ("UPDATE messages SET timestamp = -1 WHERE id = 5", "LOG004", 1, "row 5 at "),
        ("UPDATE messages SET topic_id = x'00' WHERE id = 5", "LOG004", 1, "row 5 at "),
        ("UPDATE messages SET topic_id = 77 WHERE id IN (5, 6)", "LOG008", 1, "2 messages of unknown topic 77"),
        ("UPDATE topics SET name = x'2f61' WHERE id = 1", "LOG008", 1, "name, type or format of topic 1 is no text"),
        ("UPDATE topics SET name = CAST(x'2fff' AS TEXT) WHERE id = 1", "LOG010", 1, r"topic 1, '/\xff'"),
    ],
)
def test_values_that_cannot_be(tmp_path, statement, code, num, text):
    file, faults = opened(changed(written(tmp_path), statement))
    assert 100 < len(b.everything(file)) <= 300
    assert b.counted(faults) == {code: num}
    assert text in faults.places[code][0]


@pytest.mark.parametrize("field", ["timestamp", "topic_id", "data"])
def test_null_values(tmp_path, field):
    rebuilt = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    copied = "INSERT INTO messages SELECT * FROM old"
    path = changed(written(tmp_path), "ALTER TABLE messages RENAME TO old", rebuilt, copied)
    file, faults = opened(changed(path, f"UPDATE messages SET {field} = NULL WHERE id = 5"))  # noqa: S608
    assert len(b.everything(file)) == 299
    assert b.counted(faults) == {"LOG004": 1}


def test_largest_stamps(tmp_path):
    path = changed(written(tmp_path, b.rows(3)), f"UPDATE messages SET timestamp = {2**63 - 1}")  # noqa: S608
    assert {log_ns for log_ns, *_ in b.everything(opened(path)[0])} == {2**63 - 1}


VIEW = "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(2000000000) AS data"
KEYLESS = "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)"
COMPUTED = """CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
    data BLOB GENERATED ALWAYS AS (zeroblob(2000000000)))"""
VIRTUAL = "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)"


@pytest.mark.parametrize(
    ("statements", "match"),
    [
        (["DROP TABLE messages"], "no table 'messages'"),
        (["DROP TABLE topics"], "no table 'topics'"),
        (["ALTER TABLE messages RENAME COLUMN data TO content"], "table 'messages' has no column 'data'"),
        (["DROP TABLE messages", VIEW], "no table 'messages'"),
        (["DROP TABLE messages", VIRTUAL], "no table 'messages'"),
        (["DROP TABLE messages", KEYLESS], "table 'messages' isn't keyed by its id"),
        (["DROP TABLE messages", COMPUTED], "table 'messages' has no column 'data'"),
    ],
)
def test_tables_that_rosbag2_never_makes(tmp_path, statements, match):
    with pytest.raises(LogError, match=rf"bag\.db3: not a recording of rosbag2 \({match}\)"):
        opened(changed(written(tmp_path), *statements))


def test_triggers_do_not_run(tmp_path):
    trigger = "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT zeroblob(2000000000); END"
    assert len(b.everything(opened(changed(written(tmp_path), trigger))[0])) == 300


def test_message_beyond_the_limit(tmp_path):
    path = changed(written(tmp_path), f"UPDATE messages SET data = zeroblob({MAX_RECORD + 1}) WHERE id = 5")  # noqa: S608
    file, _ = opened(path)
    tracemalloc.start()
    with pytest.raises(LogError, match=rf"row 5: declares {MAX_RECORD + 1} bytes, more than the limit"):
        b.everything(file)
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "not an SQLite database (looks like an empty file)"),
        (b"\x89MCAP0\r\n", "not an SQLite database (looks like MCAP"),
        (b"SQLite format 3\x00" + bytes(200), "damaged database"),
    ],
)
def test_other_files(tmp_path, content, match):
    path = tmp_path / "a.db3"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        opened(path)
    assert match in str(caught.value)
    assert str(path) in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(LogError, match=r"a\.db3: can't be read \(No such file or directory\)"):
        opened(tmp_path / "a.db3")


def test_unknown_compression(tmp_path):
    with pytest.raises(LogError, match="unknown message compression 'lz4'; fbench reads zstd and none"):
        opened(written(tmp_path), "lz4")


def test_messages_that_cannot_be_unpacked(tmp_path):
    path = written(tmp_path, mode="message")
    changed(
        path, "UPDATE messages SET data = x'28b52ffd00' WHERE id = 5", "UPDATE messages SET data = x'' WHERE id = 6"
    )
    file, faults = opened(path, "zstd")
    assert len(b.everything(file)) == 298
    assert b.counted(faults) == {"LOG004": 2}
    assert "zstd data are damaged" in faults.places["LOG004"][0]


@pytest.mark.slow
def test_single_bit_flips(tmp_path):
    """SQLite keeps no checksums, so that flips in messages can't be seen; that nothing breaks can."""
    path = written(tmp_path)
    data = path.read_bytes()
    rng = np.random.Generator(np.random.Philox(8))
    refused, short = 0, 0
    for bit in rng.integers(0, len(data) * 8, 300).tolist():
        changed_data = bytearray(data)
        changed_data[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(changed_data)
        try:
            file, faults = opened(path)
            got = b.everything(file)
            assert sum(file.counts.values()) >= 0
        except LogError:
            refused += 1
            continue
        assert len(got) == 300 or b.counted(faults), bit
        short += bool(b.counted(faults))
    assert refused + short > 0


def test_damaged_pages_in_the_middle(tmp_path):
    """Messages before are delivered; the fault names the last good stamp."""
    path = written(tmp_path, [(0, i, bytes(1000)) for i in range(300)])
    data = path.read_bytes()
    half = len(data) // 2 // 4096 * 4096
    path.write_bytes(data[:half] + b"\xff" * 4096 + data[half + 4096 :])
    file, faults = opened(path)
    got = b.everything(file)
    assert 290 <= len(got) < 300
    assert faults.num_lost >= 300 - len(got)
    places = [place for code in ("LOG002", "LOG004") for place in faults.places.get(code, [])]
    assert any("malformed" in place for place in places)


@pytest.mark.parametrize("num_bytes", [1, 100, 4095, 4096, 4097])
def test_truncated_file(tmp_path, num_bytes):
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:-num_bytes])
    with pytest.raises(LogError, match=r"bag\.db3: damaged database .*`sqlite3 bag\.db3 \.recover`"):
        opened(path)


def test_index_that_contradicts_the_table(tmp_path):
    """The stamp of a message stands twice in the file: in the table and in the index."""
    path = written(tmp_path, [(0, 0x1111111111111111 + i, b"x") for i in range(20)])
    data = path.read_bytes()
    stamp = (0x1111111111111111 + 7).to_bytes(8, "big")
    places = [at for at in range(len(data)) if data.startswith(stamp, at)]
    assert len(places) == 2
    for at in places:
        path.write_bytes(data[:at] + (0x1111111111111111 + 5).to_bytes(8, "big") + data[at + 8 :])
        file, faults = opened(path)
        assert len(b.everything(file)) < 20
        assert faults.num_lost
