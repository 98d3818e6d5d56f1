"""Recordings of ROS and Parquet logs: damaged bytes, edited cells of SQLite, edited tables and descriptions."""

import io
import json
import sqlite3
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys.base import TypesysError
from tests.hostile.damage import EXTREMES, FOREIGN, Random, damage, edit_number, edit_text
from tests.hostile.target import Case, Files
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.ros.builders import DISTROS, STAMP_NS, Ros
from tests.replay.logs.codecs.ros.test_calibration import transforms
from tests.replay.logs.codecs.ros.test_damage import payloads
from tests.replay.logs.codecs.ros.test_other_definitions import KNOWN
from tests.replay.logs.containers.parquet import logs

BAG1, FOLDER = "log.bag", "log"  # What is opened
_TYPES = ("PointCloud2", "CompressedImage", "CameraInfo", "TFMessage")
"""One message of each; others are tried one by one: building their decoders takes most of the time of a case."""
_CELLS = {
    "messages": ("topic_id", "timestamp", "data", "id"),
    "topics": ("name", "type", "serialization_format", "offered_qos_profiles", "id"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}


@cache
def _messages(version: int) -> tuple[tuple[str, str, bytes], ...]:
    """Type, definition and payload of messages of a few types, as ROS 1 or 2 has them."""
    distro = DISTROS[2 if version == 1 else 1]
    ros = Ros(distro, KNOWN)
    found: dict[str, tuple[str, str, bytes]] = {}
    edges = [("base_link", child) for child in ("lidar", "cam", "laser", "sensor")]
    for name, kind, payload in payloads(distro)[1]:
        if name in found or name.partition("/msg/")[2] not in _TYPES:
            continue
        data = transforms(ros, name, edges) if kind == "transform" else payload
        try:
            text = ros.schema(name).data.decode()
        except TypesysError:  # its definition isn't in the store; fbench knows it
            continue
        found[name] = name, text, bytes(data)
    return tuple(found.values())


@cache
def bag1(compression: str) -> Files:
    """A ROS 1 bag in small chunks."""
    with tempfile.TemporaryDirectory() as folder:
        writer = Writer1(Path(folder) / BAG1)
        writer.chunk_threshold = 2000
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
        with writer:
            for i, (name, text, data) in enumerate(_messages(1)):
                connection = writer.add_connection(f"/t{i}", name, msgdef=text, md5sum="0" * 32)
                for k in range(2):
                    writer.write(connection, STAMP_NS + k * 10**7 + i, data)
        return {BAG1: (Path(folder) / BAG1).read_bytes()}


@cache
def bag2(storage: str, mode: str) -> Files:
    """A folder of rosbag2."""
    with tempfile.TemporaryDirectory() as folder:
        writer = Writer2(Path(folder) / FOLDER, version=9, storage_plugin=StoragePlugin[storage])
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        with writer:
            for i, (name, text, data) in enumerate(_messages(2)):
                connection = writer.add_connection(f"/t{i}", name, msgdef=text, rihs01="RIHS01_0")
                for k in range(2):
                    writer.write(connection, STAMP_NS + k * 10**7 + i, data)
        return _files(Path(folder))


@cache
def parquet(compression: str) -> Files:
    """A Parquet log as fbench writes it."""
    with tempfile.TemporaryDirectory() as folder:
        logs.write(
            Path(folder) / FOLDER, b.sequence(2, points=10), b.the_rig(), compression=compression, rows_per_group=2
        )
        return _files(Path(folder))


def _files(folder: Path) -> Files:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def damage_bag1(random: Random) -> Case:
    """Change bytes, which no checksum covers."""
    whole = bag1(["", "BZ2", "LZ4"][int(random.integers(3))])
    how = [damage, edit_number][int(random.integers(2))]
    return Case({BAG1: how(whole[BAG1], random)}, whole)


def damage_sqlite(random: Random) -> Case:
    """Change bytes of the database."""
    whole = bag2("SQLITE3", ["NONE", "MESSAGE"][int(random.integers(2))])
    name = next(name for name in whole if name.endswith(".db3"))
    return Case({**whole, name: [damage, edit_number][int(random.integers(2))](whole[name], random)}, whole)


def edit_sqlite(random: Random) -> Case:
    """Change cells and columns by SQL, or the description."""
    whole = bag2("SQLITE3", ["NONE", "MESSAGE"][int(random.integers(2))])
    name = next(name for name in whole if name.endswith(".db3"))
    if random.random() < 0.2:
        text = next(name for name in whole if name.endswith(".yaml"))
        return Case({**whole, text: edit_text(whole[text], random)})
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:  # noqa: S108
        path = Path(folder) / "a.db3"
        path.write_bytes(whole[name])
        with closing(sqlite3.connect(path)) as database, database:
            for _ in range(int(random.integers(1, 4))):
                _edit_cell(database, random)
        return Case({**whole, name: path.read_bytes()})


def _edit_cell(database: sqlite3.Connection, random: Random) -> None:
    table = ["messages", "messages", "topics", "message_definitions"][int(random.integers(4))]
    column = _CELLS[table][int(random.integers(len(_CELLS[table])))]
    rows = database.execute(f"SELECT rowid, {column} FROM {table}").fetchall()  # noqa: S608
    if not rows:
        return
    row, old = rows[int(random.integers(len(rows)))]
    content = old if isinstance(old, bytes) else str(old).encode()
    value = [
        lambda: None,
        lambda: EXTREMES[int(random.integers(len(EXTREMES)))] % 2**63 * int(random.choice([1, -1])),
        lambda: FOREIGN[int(random.integers(len(FOREIGN)))].decode(errors="replace"),
        lambda: edit_number(content, random),
        lambda: edit_text(content, random).decode(errors="replace"),
        lambda: 1.5,
    ][int(random.integers(6))]()
    try:
        database.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row))  # noqa: S608
    except sqlite3.Error:  # a key that is there, or must be
        database.execute(f"DELETE FROM {table} WHERE rowid = ?", (row,))  # noqa: S608


def edit_recording(random: Random) -> Case:
    """Change the description of a folder of MCAP files, or the file."""
    whole = bag2("MCAP", ["NONE", "MESSAGE"][int(random.integers(2))])
    name = sorted(whole)[int(random.integers(len(whole)))]
    how = edit_text if name.endswith(".yaml") else damage
    return Case({**whole, name: how(whole[name], random)})


def damage_parquet(random: Random) -> Case:
    """Change bytes of any file of a log with checksums."""
    whole = parquet(["none", "snappy", "zstd"][int(random.integers(3))])
    name = sorted(whole)[int(random.integers(len(whole)))]
    return Case({**whole, name: damage(whole[name], random)}, whole)


def edit_parquet(random: Random) -> Case:
    """Change a log whose description has no checksums: its text, footers, and columns of tables."""
    whole = dict(parquet(["none", "snappy"][int(random.integers(2))]))
    about = json.loads(whole[f"{FOLDER}/log.json"])
    about.pop("digest")
    for stream in about["streams"]:
        stream.pop("checksums", None)
    text = json.dumps(about, indent=1).encode()
    tables = sorted(name for name in whole if name.endswith(".parquet"))
    name = tables[int(random.integers(len(tables)))]
    match int(random.integers(3)):
        case 0:
            text = edit_text(text, random)
        case 1:
            whole[name] = _edit_footer(whole[name], random)
        case _:
            whole[name] = _edit_table(whole[name], random)
    return Case({**whole, f"{FOLDER}/log.json": text})


def _edit_footer(data: bytes, random: Random) -> bytes:
    length = int.from_bytes(data[-8:-4], "little")
    pages, footer = data[: -8 - length], data[-8 - length : -8]
    if random.random() < 0.5:
        footer = [damage, edit_number][int(random.integers(2))](footer, random)
    else:
        pages = pages[:4] + edit_number(pages[4:], random)
    return pages + footer + len(footer).to_bytes(4, "little") + data[-4:]


def _edit_table(data: bytes, random: Random) -> bytes:
    table = pq.read_table(io.BytesIO(data))
    i = int(random.integers(table.num_columns))
    name, column = table.column_names[i], table.column(i)
    rows = column.to_pylist()
    k = int(random.integers(len(rows))) if rows else 0
    new: pa.Array | None = None
    match int(random.integers(6)):
        case 0:
            new = pa.nulls(len(rows), column.type)
        case 1 if rows:
            new = _array([None if n == k else row for n, row in enumerate(rows)], column.type)
        case 2 if rows:
            odd = [
                b"",
                b"x" * 5,
                "",
                2**31 - 1,
                -1,
                float("nan"),
                float("inf"),
                [],
                [1.0],
                [float("nan")] * 3,
                "é" * 400,
            ]
            new = _array(
                [odd[int(random.integers(len(odd)))] if n == k else row for n, row in enumerate(rows)], column.type
            )
        case 3:
            kinds = [pa.string(), pa.float64(), pa.int8(), pa.binary(), pa.list_(pa.float64()), pa.bool_()]
            new = _array([None] * len(rows), kinds[int(random.integers(len(kinds)))])
        case 4 if rows and isinstance(rows[k], bytes):
            new = _array([edit_number(row, random) if n == k else row for n, row in enumerate(rows)], column.type)
        case 5 if rows and isinstance(rows[k], int | float):
            value: float = EXTREMES[int(random.integers(len(EXTREMES)))]
            value = float(np.uint64(value).view(np.float64)) if isinstance(rows[k], float) else value % 2**63
            new = _array([value if n == k else row for n, row in enumerate(rows)], column.type)
        case _:
            pass
    table = table.remove_column(i) if new is None else table.set_column(i, name, new)
    file = io.BytesIO()
    pq.write_table(table, file, compression="none", write_page_checksum=bool(random.integers(2)))
    return file.getvalue()


def _array(rows: list[object], kind: pa.DataType) -> pa.Array | None:
    try:
        return pa.array(rows, kind)
    except (pa.ArrowException, TypeError, ValueError, OverflowError):
        return None
