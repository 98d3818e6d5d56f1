"""Logs that others wrote after docs/formats.md, without checksums."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose, Truth

XYZ = np.arange(12, dtype=np.float32).reshape(4, 3)


def foreign(path, *streams, **more):
    """A log of (stream, columns): only what must be there."""
    path.mkdir(exist_ok=True)
    described = []
    for number, (stream, columns, *how) in enumerate(streams):
        name = stream.get("file", f"{number}.parquet")
        if columns is not None:
            pq.write_table(pa.table(columns), path / name, **(how[0] if how else {}))
        described.append({"file": name, **stream})
    text = json.dumps({"format": "fbench-parquet", "version": 1, "streams": described, **more})
    (path / "log.json").write_text(text)
    return path


LIDAR = {"kind": "lidar", "sensor": "top"}


def clouds(num=3, **more):
    return {"log_ns": list(range(num)), "stamp_ns": list(range(num)), "xyz": [XYZ.tobytes()] * num, **more}


def all_of(path):
    reader, faults = logs.read(path)
    return [*reader.messages(), *reader.truths()], faults


@pytest.mark.parametrize("how", [{}, {"compression": "gzip"}, {"row_group_size": 1}, {"data_page_version": "2.0"}])
def test_the_least_that_must_be_there(tmp_path, how):
    found, faults = all_of(foreign(tmp_path / "a", (LIDAR, clouds(), how)))
    expected = [PointCloud("top", i, i, XYZ) for i in range(3)]
    assert [b.canonical(m) for m in found] == [b.canonical(m) for m in expected]
    assert dict(faults.counts) == {"LOG006": 2}  # log.json, and the file


def test_log_id_and_rig_of_a_minimal_log(tmp_path):
    a, _ = logs.read(foreign(tmp_path / "a", (LIDAR, clouds())))
    c, _ = logs.read(foreign(tmp_path / "c", (LIDAR, clouds())))
    d, _ = logs.read(foreign(tmp_path / "d", (LIDAR, clouds(4))))
    assert a.info.log_id == c.info.log_id != d.info.log_id
    rig = {"mounts": {"top": {"kind": "lidar", "translation_m": [0, 0, 2], "rotation_xyzw": [0, 0, 0, 1]}}}
    e, _ = logs.read(foreign(tmp_path / "e", (LIDAR, clouds()), rigs=[rig]))
    assert e.rig.mounts["top"].translation_m.tolist() == [0, 0, 2]


def test_pandas(tmp_path):
    pandas = pytest.importorskip("pandas")
    path = foreign(tmp_path / "a", ({**LIDAR, "file": "x.parquet"}, None), ({"kind": "truth_3d", "file": "t"}, None))
    pandas.DataFrame({**clouds(), "comment": ["more", "columns", "don't matter"]}).to_parquet(path / "x.parquet")
    truth = {
        "log_ns": [0, 1, 2], "stamp_ns": [0, 1, 2], "center_m": [[[1.0, 2, 3], [4, 5, 6]], [], None],
        "size_lwh_m": [[[4.0, 2, 1]] * 2, [], None], "yaw_rad": [[0.5, 1], [], None],
        "label": [["car", "bus"], [], None],
    }  # fmt: skip
    pandas.DataFrame(truth).to_parquet(path / "t")
    found, faults = all_of(path)
    center_m, size = np.array([[1.0, 2, 3], [4, 5, 6]]), np.array([[4.0, 2, 1]] * 2)
    boxes = [Boxes3D(center_m, size, np.array([0.5, 1]), label=np.array(["car", "bus"])), Boxes3D.empty(), None]
    assert b.canonical(found[3].boxes3d) == b.canonical(boxes[0])
    assert len(found[4].boxes3d) == 0
    assert found[5].boxes3d is None
    assert set(faults.counts) == {"LOG006"}
    table = pandas.read_parquet(path / "x.parquet")
    assert np.frombuffer(table.xyz[0], "<f4").reshape(-1, 3).tolist() == XYZ.tolist()


def test_what_fbench_wrote_is_read_by_others(tmp_path):
    path = logs.write(tmp_path / "a", b.sequence(10), b.the_rig())
    cloud = next(m for m in b.sequence(1) if isinstance(m, PointCloud))
    row = pq.read_table(path / "top.points.parquet").slice(0, 1).to_pylist()[0]
    assert np.array_equal(np.frombuffer(row["xyz"], "<f4").reshape(-1, 3), cloud.xyz)
    assert row["num_points"] == 50
    assert row["ring"] is None
    truth = next(m for m in b.sequence(1) if isinstance(m, Truth))
    row = pq.read_table(path / "truth.boxes.parquet").slice(0, 1).to_pylist()[0]
    assert row["center_m"] == truth.boxes3d.center_m.tolist()
    assert row["label"] is None


def test_other_types_of_the_same_meaning(tmp_path):
    columns = {
        "log_ns": pa.array([1, 2], pa.uint32()), "stamp_ns": pa.array([1, 2], pa.int32()),
        "translation_m": pa.array([[1, 2, 3]] * 2, pa.large_list(pa.float32())),
        "rotation_xyzw": pa.array([[0, 0, 0, 1]] * 2, pa.list_(pa.float64(), 4)),
    }  # fmt: skip
    image = {
        **clouds(2), "data": pa.array([b"ab", b""], pa.large_binary()), "width": [2, 0], "height": [1, 0],
        "encoding": pa.array(["mono8"] * 2, pa.large_string()),
    }  # fmt: skip
    path = foreign(
        tmp_path / "a", ({"kind": "pose", "sensor": "ego"}, columns), ({"kind": "camera", "sensor": "c"}, image)
    )
    found, _ = all_of(path)
    assert len(found) == 4
    assert [m.data for m in found if isinstance(m, Image)] == [b"ab", b""]
    assert [m.translation_m.tolist() for m in found if isinstance(m, Pose)] == [[1, 2, 3]] * 2


BAD_COLUMNS = [
    ({"stamp_ns": None}, "stream of kind 'lidar' without column stamp_ns; see docs/formats.md"),
    ({"log_ns": [0.5, 1, 2]}, "column 'log_ns': expected int64, got double"),
    ({"xyz": [[1.0, 2, 3]] * 3}, "column 'xyz': expected binary, got list<"),
    ({"ring": ["a"] * 3}, "column 'ring': expected binary, got string"),
    ({"log_ns": pa.array([0, 1, 2], pa.timestamp("ns"))}, "column 'log_ns': expected int64, got timestamp"),
]


@pytest.mark.parametrize(("columns", "match"), BAD_COLUMNS)
def test_wrong_columns_are_one_line(tmp_path, columns, match):
    merged = {name: column for name, column in {**clouds(), **columns}.items() if column is not None}
    with pytest.raises(LogError, match=match):
        logs.read(foreign(tmp_path / "a", (LIDAR, merged)))


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "not Parquet .looks like an empty file"),
        (b"\xff\xd8\xff" + bytes(100), "not Parquet .looks like a JPEG"),
        (b"PAR1" + bytes(100), "its start or end is damaged, or it is truncated"),
        (b"PAR1" + b"\xff" * 4 + b"PAR1", "damaged, its footer claims 4294967303 bytes"),
        (b"PAR1" + bytes(50) + b"\x20\0\0\0PAR1", "damaged footer"),
    ],
)
def test_other_files_are_one_line(tmp_path, content, match):
    path = foreign(tmp_path / "a", (LIDAR, clouds()))
    (path / "0.parquet").write_bytes(content)
    with pytest.raises(LogError, match=match) as error:
        logs.read(path)
    assert "\n" not in str(error.value)


BAD_ROWS = [
    ({"stamp_ns": [0, None, 2]}, "row 1: log_ns 1, stamp_ns None"),
    ({"log_ns": [0, None, 2]}, "row 1: log_ns None, stamp_ns 1"),
    ({"log_ns": [0, -1, 2]}, "row 1: log_ns -1, stamp_ns 1"),
    ({"xyz": [XYZ.tobytes(), None, b""]}, "xyz is null"),
    ({"xyz": [XYZ.tobytes(), b"abc", b""]}, "xyz has 3 bytes, which aren't whole numbers of type <f4"),
    ({"xyz": [XYZ.tobytes(), bytes(8), b""]}, "xyz has 2 values, which aren't points"),
    ({"ring": [None, bytes(6), None]}, r"PointCloud.ring: expected uint16 \(4\), got uint16 \(3,\)"),
    ({"num_points": [4, 3, 4]}, "num_points is 3, xyz has 4 points"),
    ({"frame_number": [None, -3, 7]}, "frame_number -3 is outside 0 to 4294967295"),
]


@pytest.mark.parametrize(("columns", "where"), BAD_ROWS)
def test_a_bad_row_is_skipped_and_counted(tmp_path, columns, where):
    import re

    found, faults = all_of(foreign(tmp_path / "a", (LIDAR, clouds(**columns))))
    assert [m.stamp_ns for m in found] == [0, 2]
    assert faults.counts["DEC001"] == 1
    assert re.search(where, faults.places["DEC001"][0])


def test_truth_with_holes_is_skipped_and_counted(tmp_path):
    good = {"center_m": [[1.0, 2, 3]], "size_lwh_m": [[1.0, 1, 1]], "yaw_rad": [0.5], "label": ["car"]}
    bad = [
        {**good, "yaw_rad": None}, {**good, "center_m": [[1.0, 2]]}, {**good, "center_m": [None]},
        {**good, "yaw_rad": [None]}, {**good, "label": [None]}, {**good, "label": []},
    ]  # fmt: skip
    rows = [{"log_ns": i, "stamp_ns": i, **row} for i, row in enumerate([good, *bad])]
    path = foreign(tmp_path / "a", ({"kind": "truth_3d"}, None))
    pq.write_table(pa.Table.from_pylist(rows), path / "0.parquet")
    found, faults = all_of(path)
    assert [t.stamp_ns for t in found] == [0]
    assert faults.counts["DEC001"] == len(bad)


def test_damaged_pages_are_found_by_their_own_checksums(tmp_path):
    path = foreign(tmp_path / "a", (LIDAR, clouds(), {"write_page_checksum": True, "compression": "none"}))
    data = bytearray((path / "0.parquet").read_bytes())
    data[data.index(XYZ.tobytes()) + 7] ^= 1
    (path / "0.parquet").write_bytes(data)
    found, faults = all_of(path)
    assert not found
    assert faults.counts["PQ002"] == 1


ints = st.none() | st.integers(-(2**63), 2**63 - 1)
blobs = st.none() | st.binary(max_size=30) | st.sampled_from([XYZ.tobytes(), bytes(16)])


@pytest.mark.slow
@settings(max_examples=80)
@given(st.lists(st.tuples(ints, ints, ints, blobs, blobs), max_size=6), st.integers(1, 4))
def test_any_rows(tmp_path_factory, rows, size):
    names = ("log_ns", "stamp_ns", "position", "xyz", "ring")
    types = (pa.int64(), pa.int64(), pa.int64(), pa.binary(), pa.binary())
    columns = {n: pa.array([row[i] for row in rows], t) for i, (n, t) in enumerate(zip(names, types, strict=True))}
    path = foreign(tmp_path_factory.mktemp("rows") / "a", (LIDAR, columns, {"row_group_size": size}))
    found, faults = all_of(path)
    assert len(found) + faults.counts["DEC001"] == len(rows)
    assert [m.log_ns for m in found] == sorted(m.log_ns for m in found)
    logs.read(path)[0].container.log_times()


@pytest.mark.slow
@settings(max_examples=120)
@given(st.data())
def test_bit_flips_of_unverified_files_raise_nothing_else(tmp_path_factory, data):
    path = foreign(tmp_path_factory.mktemp("flip") / "a", (LIDAR, clouds(), {"write_page_checksum": True}))
    content = bytearray((path / "0.parquet").read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (path / "0.parquet").write_bytes(content)
    assert "\n" not in str(logs.refusal(lambda: all_of(path)))


@pytest.mark.slow
def test_many_bit_flips_of_unverified_files_raise_nothing_else(tmp_path):
    """pyarrow itself ends the process on some damaged footers, or gives wrong data where pages have no checksum."""
    boxes = {"center_m": [[1.0, 2, 3]], "size_lwh_m": [[1.0, 1, 1]], "yaw_rad": [0.5], "label": ["car"]}
    path = foreign(tmp_path / "a", (LIDAR, clouds(5)), ({"kind": "truth_3d"}, None))
    rows = [{"log_ns": i, "stamp_ns": i, **boxes} for i in range(5)]
    pq.write_table(pa.Table.from_pylist(rows), path / "1.parquet", compression="none")
    rng = np.random.Generator(np.random.Philox(5))
    for file in (path / "0.parquet", path / "1.parquet"):
        content = file.read_bytes()
        for at, bit in zip(rng.integers(0, len(content), 500).tolist(), rng.integers(0, 8, 500).tolist(), strict=True):
            file.write_bytes(content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :])
            assert "\n" not in str(logs.refusal(lambda: all_of(path)))
        file.write_bytes(content)
