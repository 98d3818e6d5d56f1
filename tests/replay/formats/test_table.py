"""Boxes in CSV and Parquet, by hand-checked values."""

import resource
import sys
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.feather as pf
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.formats.box_files import S, coordinates, read

from fbench.replay.contracts.errors import ConfigError, FbenchError, LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.formats.open import open_boxes, results_entry, truth_entry
from fbench.replay.formats.table_files import _MAX_AT_ONCE
from fbench.replay.logs.setup import BoxSource
from fbench.replay.runs.tables import BoxWriter

SOLID = "x,y,z,length,width,height,yaw"
BOX = "1,2,0.5,4,2,1.5,0.25"


@pytest.fixture
def table(tmp_path):
    def write(text, name="boxes.csv"):
        (tmp_path / name).write_bytes(text.encode() if isinstance(text, str) else text)
        return tmp_path / name

    return write


def test_values_by_hand(table):
    path = table(
        f"stamp_ns,{SOLID},pitch,vx,vy,label,score,track_id,ignore,num_lidar_pts,occlusion,attribute,arrival_ns\n"
        f"1631702348299745001,{BOX},0.1,3,-1,Car,0.75,7,,12,2,parked,1631702348399745001\n"
        f"1631702348299745001,9,8,7,1,1,1,0,0,,,Cyclist,,,true,,,,\n"
    )
    [truth] = read(path)
    assert (truth.stamp_ns, truth.log_ns, truth.boxes2d) == (1631702348299745001, 1631702348399745001, None)
    boxes = truth.boxes3d
    assert boxes.center_m.tolist() == [[1, 2, 0.5], [9, 8, 7]]
    assert boxes.size_lwh_m.tolist() == [[4, 2, 1.5], [1, 1, 1]]
    assert (boxes.yaw_rad.tolist(), boxes.pitch_rad.tolist()) == ([0.25, 0], [0.1, 0])
    assert boxes.velocity_mps[0].tolist() == [3, -1, 0]
    assert np.isnan(boxes.velocity_mps[1]).all()
    assert (boxes.label.tolist(), boxes.source_label.tolist()) == (["car", "bicycle"], ["Car", "Cyclist"])
    assert (boxes.track_id.tolist(), boxes.ignore.tolist()) == ([7, -1], [False, True])
    assert (boxes.num_lidar_pts.tolist(), boxes.attribute.tolist()) == ([12, -1], ["parked", ""])
    assert boxes.score[0] == 0.75
    assert np.isnan(boxes.score[1])


def test_2d_boxes_and_empty_instants(table):
    path = table(
        "frame,camera,left,top,right,bottom,distance_m\n0,cam,10,20,30,40,12.5\n2,,,,,,\n5,/cam/image,1,2,3,4,\n"
    )
    first, empty, last = read(path)
    assert (first.frame_index, first.frame_number, first.stamp_ns, first.boxes3d) == (0, 0, 0, None)
    assert first.boxes2d.xyxy_px.tolist() == [[10, 20, 30, 40]]
    assert first.boxes2d.distance_m.tolist() == [12.5]
    assert (empty.frame_index, len(empty.boxes2d), empty.boxes3d) == (2, 0, None)
    assert (last.frame_index, last.boxes2d.camera.tolist()) == (5, ["cam"])


def test_both_kinds_in_one_table(table):
    """A row may have both; an instant with boxes of one kind isn't labeled in the other, an empty row labels both."""
    path = table(
        f"stamp_s,{SOLID},left,top,right,bottom\n1,{BOX},1,2,3,4\n2,{BOX},,,,\n3,,,,,,,,1,2,3,4\n4,,,,,,,,,,,\n"
    )
    both, solid, flat, empty = read(path)
    assert (len(both.boxes3d), len(both.boxes2d)) == (1, 1)
    assert (len(solid.boxes3d), solid.boxes2d) == (1, None)
    assert (flat.boxes3d, len(flat.boxes2d)) == (None, 1)
    assert (len(empty.boxes3d), len(empty.boxes2d)) == (0, 0)


def test_coordinate_frames(table):
    """The LiDAR sits at (1, 0, 2) and looks to the left: its x is the body's y."""
    path = table(
        f"frame,frame_id,{SOLID},vx,vy\n0,,{BOX},1,0\n0,body,{BOX},1,0\n0,base_link,{BOX},1,0\n0,lidar,{BOX},1,0\n"
        f"1,world,{BOX},1,0\n"
    )
    body, world = read(path)
    assert not body.in_world
    assert body.boxes3d.center_m[:3].tolist() == [[1, 2, 0.5]] * 3
    np.testing.assert_allclose(body.boxes3d.center_m[3], [1 - 2, 1, 2.5], atol=1e-12)
    np.testing.assert_allclose(body.boxes3d.yaw_rad, [0.25, 0.25, 0.25, 0.25 + np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(body.boxes3d.velocity_mps[3], [0, 1, 0], atol=1e-12)
    assert (world.in_world, world.boxes3d.center_m.tolist()) == (True, [[1, 2, 0.5]])


def test_named_frame_holds_where_the_file_doesnt_tell(table):
    path = table(f"frame,frame_id,{SOLID}\n0,,{BOX}\n0,body,{BOX}\n")
    [truth] = read(path, frame="lidar")
    np.testing.assert_allclose(truth.boxes3d.center_m, [[-1, 1, 2.5], [1, 2, 0.5]], atol=1e-12)


def test_rotation_as_quaternion_or_in_degrees(table):
    head = "x,y,z,length,width,height"
    [a] = read(table(f"frame,{head},qx,qy,qz,qw\n0,1,2,3,4,2,1,0,0,{np.sin(0.3)},{np.cos(0.3)}\n"))
    [b] = read(table(f"frame,{head},yaw_deg\n0,1,2,3,4,2,1,{np.rad2deg(0.6)}\n"))
    np.testing.assert_allclose([a.boxes3d.yaw_rad, b.boxes3d.yaw_rad], 0.6, atol=1e-15)
    [c] = read(table(f"frame,{head},qx,qy,qz,qw\n0,1,2,3,4,2,1,{np.sin(0.1)},0,0,{np.cos(0.1)}\n"))
    np.testing.assert_allclose([*c.boxes3d.roll_rad, *c.boxes3d.yaw_rad], [0.2, 0], atol=1e-15)


def test_forms_of_csv(table):
    """A byte order mark, semicolons, carriage returns, blanks, blank lines and another case."""
    path = table("\ufeffStamp_S; X;y;z;length;width;height;yaw;Label\r\n\r\n1.25; 1;2 ;0.5;4;2;1.5;0.25; Car \r\n")
    [truth] = read(path)
    assert (truth.stamp_ns, truth.boxes3d.center_m.tolist()) == (1_250_000_000, [[1, 2, 0.5]])
    assert truth.boxes3d.source_label.tolist() == ["Car"]
    [tabbed] = read(table(f"frame\t{SOLID}\n3\t{BOX}\n".replace(",", "\t"), "b.tsv"))
    assert tabbed.frame_index == 3


def test_rows_in_any_order(table):
    rows = [f"{stamp},{x},2,0.5,4,2,1.5,0" for stamp, x in ((3, 30), (1, 10), (2, 20), (1, 11))]
    truths = read(table(f"stamp_ns,{SOLID}\n" + "\n".join(rows) + "\n"))
    assert [t.stamp_ns for t in truths] == [1, 2, 3]
    assert truths[0].boxes3d.center_m[:, 0].tolist() == [10, 11]


@given(st.integers(0, 2**63 - 1))
def test_seconds_are_read_exactly(stamp_ns):
    from fbench.replay.formats.text import stamp_of_seconds

    assert stamp_of_seconds(f"{stamp_ns // S}.{stamp_ns % S:09d}") == stamp_ns


def test_ids_that_are_texts(table):
    """Numbers stay, texts become numbers that depend on the text alone."""
    path = table(f"frame,{SOLID},track_id\n0,{BOX},car-a\n0,{BOX},12\n1,{BOX},car-b\n1,{BOX},car-a\n1,{BOX},\n")
    first, second = read(path)
    other = read(table(f"frame,{SOLID},track_id\n0,{BOX},x\n1,{BOX},car-a\n", "other.csv"))[1]
    car_a = first.boxes3d.track_id[0]
    assert car_a > 2**62
    assert first.boxes3d.track_id.tolist() == [car_a, 12]
    assert second.boxes3d.track_id[1:].tolist() == [car_a, -1]
    assert other.boxes3d.track_id.tolist() == [car_a]


def test_folder_of_tables_is_one(tmp_path, table):
    table(f"frame,{SOLID}\n0,{BOX}\n2,{BOX}\n", "a.csv")
    table("frame,left,top,right,bottom\n0,1,2,3,4\n1,5,6,7,8\n", "b.csv")
    truths = read(tmp_path)
    assert [(t.frame_index, t.boxes3d is not None, t.boxes2d is not None) for t in truths] == [
        (0, True, True), (1, False, True), (2, True, False),
    ]  # fmt: skip
    table(f"frame,{SOLID}\n0,{BOX}\n", "c.csv")
    with pytest.raises(LogError, match="two tables have boxes of one kind at 0"):
        read(tmp_path)
    table(f"stamp_ns,{SOLID}\n0,{BOX}\n", "c.csv")
    with pytest.raises(ConfigError, match="some tables count frames and some have stamps"):
        read(tmp_path)


def test_a_run_folder_must_say_which_of_its_tables(tmp_path, table):
    table(f"frame,{SOLID}\n0,{BOX}\n", "a.csv")
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(ConfigError, match=r"a run folder; give the table that is meant, such as .*detections\.parquet"):
        read(tmp_path)


def test_parquet_of_any_types(tmp_path):
    columns = {
        "stamp_ns": pa.array([5, 5, 6], pa.uint64()), "label": pa.array(["Car", "Van", None]).dictionary_encode(),
        "track_id": pa.array(["a", "b", None], pa.large_string()), "ignore": pa.array([True, False, None]),
        "qx": [0.0, 0, None], "qy": [0.0, 0, None], "qz": [0.0, 0, None], "qw": [1.0, 1, None],
    }  # fmt: skip
    columns |= {n: pa.array([1, 2, None], pa.float32()) for n in ("x", "y", "z", "length", "width", "height")}
    pq.write_table(pa.table(columns), tmp_path / "boxes.parquet")
    first, empty = read(tmp_path / "boxes.parquet")
    assert first.boxes3d.center_m.tolist() == [[1, 1, 1], [2, 2, 2]]
    assert (first.boxes3d.label.tolist(), first.boxes3d.ignore.tolist()) == (["car", "van"], [True, False])
    assert (empty.stamp_ns, len(empty.boxes3d)) == (6, 0)


AV2 = {
    "log_id": ["drive"] * 2, "timestamp_ns": [315966070557248000, 315966070657248000],
    "track_uuid": ["0b5cfe20", "0b5cfe20"], "category": ["REGULAR_VEHICLE", "PEDESTRIAN"], "length_m": [4.0, 0.5],
    "width_m": [2.0, 0.6], "height_m": [1.5, 1.7], "qw": [np.cos(0.25), 1.0], "qx": [0.0, 0.0], "qy": [0.0, 0.0],
    "qz": [np.sin(0.25), 0.0], "tx_m": [10.0, 11.0], "ty_m": [-2.0, 3.0], "tz_m": [0.5, 0.7],
    "num_interior_pts": [12, 0],
}  # fmt: skip


@pytest.mark.parametrize("compression", ["uncompressed", "lz4", "zstd"])
def test_annotations_of_argoverse_2_are_read_as_they_are(tmp_path, compression):
    pf.write_feather(pa.table(AV2), tmp_path / "annotations.feather", compression=compression)
    first, second = read(tmp_path / "annotations.feather")
    assert (first.stamp_ns, second.stamp_ns) == tuple(AV2["timestamp_ns"])
    assert (first.boxes3d.center_m.tolist(), first.boxes3d.size_lwh_m.tolist()) == ([[10, -2, 0.5]], [[4, 2, 1.5]])
    assert first.boxes3d.yaw_rad == pytest.approx(0.5)
    assert (first.boxes3d.num_lidar_pts.tolist(), second.boxes3d.num_lidar_pts.tolist()) == ([12], [0])
    assert first.boxes3d.track_id == second.boxes3d.track_id
    assert second.boxes3d.source_label.tolist() == ["PEDESTRIAN"]


def test_feather_of_fbenchs_columns_and_damaged(tmp_path):
    columns = {"stamp_ns": [5], **{n: [1.0] for n in ("x", "y", "z", "length", "width", "height", "yaw")}}
    path = tmp_path / "boxes.feather"
    pf.write_feather(pa.table(columns), path)
    assert read(path)[0].boxes3d.center_m.tolist() == [[1, 1, 1]]
    whole = path.read_bytes()
    for damaged in (b"", b"ARROW1", whole[: len(whole) // 2], b"FEA1" + bytes(20) + b"FEA1", whole[:-200] + bytes(200)):
        path.write_bytes(damaged)
        with pytest.raises(LogError, match=r"boxes\.feather: "):
            read(path)
    with path.open("wb") as file:
        file.truncate(513 * 2**20)
    with pytest.raises(LimitError, match="513 MiB, more than 512"):
        read(path)


def test_the_coordinate_frame_that_a_user_names_is_kept(tmp_path):
    (tmp_path / "a.csv").write_text(f"frame,{SOLID}\n0,{BOX}\n")
    entries = [make(BoxSource(tmp_path / "a.csv", None, "lidar", "front")) for make in (truth_entry, results_entry)]
    assert [(entry.frame, entry.camera) for entry in entries] == [("lidar", "front")] * 2
    assert truth_entry(BoxSource(tmp_path / "a.csv")).frame == ""


def test_tables_of_runs_are_accepted(tmp_path):
    writer = BoxWriter(tmp_path / "detections.parquet", Boxes3D)
    boxes = Boxes3D(np.arange(6.0).reshape(2, 3), np.ones((2, 3)), np.zeros(2), score=np.array([0.5, 0.7]))
    writer.add(3, boxes)
    writer.add(7, boxes[:1])
    writer.close()
    first, second = read(tmp_path / "detections.parquet")
    assert (first.frame_index, first.frame_number, second.frame_index) == (3, None, 7)
    assert first.boxes3d.center_m.tolist() == boxes.center_m.tolist()
    assert second.boxes3d.score.tolist() == [0.5]
    assert first.boxes3d.label is None


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("center_m", pa.array([[1.0, 2.0, 3.0]]), "'center_m' is list<element: double>, expected fixed_size_list"),
        ("center_m", pa.array([{"x": 1.0}]), "'center_m' is struct<x: double>, expected fixed_size_list"),
        ("score", pa.array([[0.5]]), "'score' is list<element: double>, expected double"),
        ("label", pa.array([1]), "'label' is int64, expected string"),
        ("yaw_rad", pa.array(["east"]), "'yaw_rad' is string, expected double"),
    ],
)
def test_tables_of_runs_that_others_wrote_anew_are_refused_by_name(tmp_path, name, values, said):
    writer = BoxWriter(tmp_path / "tracks.parquet", Boxes3D)
    writer.add(0, Boxes3D(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1), score=np.ones(1)))
    writer.close()
    table = pq.read_table(tmp_path / "tracks.parquet")
    table = table.set_column(table.column_names.index(name), name, values)
    pq.write_table(table.replace_schema_metadata({"boxes": "Boxes3D"}), tmp_path / "tracks.parquet")
    with pytest.raises(LogError, match=said):
        read(tmp_path / "tracks.parquet")


def test_tables_of_runs_that_pandas_wrote_anew_are_read(tmp_path):
    writer = BoxWriter(tmp_path / "tracks.parquet", Boxes3D)
    writer.add(0, Boxes3D(np.zeros((2, 3)), np.ones((2, 3)), np.zeros(2), score=np.ones(2)))
    writer.close()
    table = pq.read_table(tmp_path / "tracks.parquet")
    for name, values in [("label", pa.array(["truck", "bus"], pa.large_string())), ("velocity_mps", pa.nulls(2)),
                         ("track_id", pa.array([1, 2], pa.int32())), ("attribute", pa.nulls(2))]:  # fmt: skip
        table = table.set_column(table.column_names.index(name), name, values)
    pq.write_table(table.replace_schema_metadata({"boxes": "Boxes3D"}), tmp_path / "tracks.parquet")
    (truth,) = read(tmp_path / "tracks.parquet")
    assert truth.boxes3d.label.tolist() == ["truck", "bus"]
    assert truth.boxes3d.track_id.tolist() == [1, 2]
    assert truth.boxes3d.velocity_mps is None


def test_labels_of_a_run_are_read(tmp_path):
    boxes = replace(Boxes3D.empty(), center_m=np.zeros((2, 3)), size_lwh_m=np.ones((2, 3)), yaw_rad=np.zeros(2))
    writer = BoxWriter(tmp_path / "tracks.parquet", Boxes3D)
    writer.add(0, replace(boxes, label=np.array(["car", "truck"])))
    writer.close()
    (truth,) = read(tmp_path / "tracks.parquet")
    assert truth.boxes3d.label.tolist() == ["car", "truck"]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is empty; expected a first line with the names of columns"),
        (b"\xff\xfes\x00", "is UTF-16 text; save it as UTF-8"),
        (f"{SOLID}\n{BOX}\n", "no column says when boxes were; expected stamp_ns, stamp_s or frame"),
        ("stamp_ns,label\n1,car\n", "no columns of boxes; expected x y z length width height yaw, or left top"),
        ("frame,x,y,z,length,width,heigth,yaw\n", "column 'height' is missing; did you mean 'heigth'"),
        ("frame,x,y,z,length,width,height\n", "column 'yaw' is missing"),
        (f"frame,{SOLID},trackid\n", "column 'trackid' isn't known; did you mean 'track_id'"),
        (f"frame,{SOLID},frame\n", "column 'frame' is there twice"),
        (f"frame,{SOLID}\n0,{BOX}\n1,1,2,abc,4,2,1.5,0\n", r"boxes.csv row 2: z is 'abc', expected a number"),
        (f"frame,{SOLID}\n0,1,2,,4,2,1.5,0\n", "row 1: z is empty, though the row has a box"),
        (f"frame,{SOLID}\n0,1,2,3,4,2,1.5,\n", "row 1: yaw is empty, though the row has a box"),
        (f"frame,{SOLID}\n,{BOX}\n", "row 1: frame is missing or negative"),
        (f"frame,{SOLID}\n-1,{BOX}\n", "row 1: frame is missing or negative"),
        (f"stamp_ns,{SOLID}\n1.5e18,{BOX}\n", "row 1: stamp_ns is '1.5e18', expected a whole number"),
        (f"stamp_s,{SOLID}\nsoon,{BOX}\n", "row 1: stamp_s is 'soon', expected seconds"),
        (f"stamp_s,{SOLID}\n1e999999999,{BOX}\n", "row 1: stamp_s is '1e999999999', expected seconds"),
        (f"frame,{SOLID},ignore\n0,{BOX},maybe\n", "row 1: ignore is 'maybe', expected true or false"),
        (f"frame,{SOLID}\n0,1,2\n", "Expected 8 columns, got 3"),
        (f"frame,frame_id,{SOLID}\n0,lidarr,{BOX}\n", "row 1: coordinate frame 'lidarr' isn't in the log; did you"),
        (f"frame,frame_id,{SOLID}\n0,world,{BOX}\n0,,{BOX}\n", "boxes in 'world' and in 'body' at one instant"),
        ("frame,camera,left,top,right,bottom\n0,cem,1,2,3,4\n", "row 1: 'cem' is no camera of the log; did you"),
        (f"frame,{SOLID},track_id\n4,{BOX},7\n4,{BOX},7\n", "id 7 twice at frame 4; an id names one object"),
        ("frame,x,y,z,length,width,height,qx,qy,qz,qw\n0,1,2,3,4,2,1,0,0,0,0\n", "row 1: rotation is the quaternion 0"),
        (b"frame,x,y,z,length,width,height,yaw,label\n0,1,2,0.5,4,2,1.5,0.2,Fu\xdfg\xe4nger\n", "invalid UTF8"),
    ],
)  # fmt: skip
def test_bad_tables_name_place_and_remedy(table, text, match):
    with pytest.raises(FbenchError, match=match) as caught:
        read(table(text))
    assert "\n" not in str(caught.value)


def test_float_stamps_in_parquet_are_refused(tmp_path):
    columns = {"stamp_ns": [1.6e18], **{n: [1.0] for n in SOLID.split(",")}}
    pq.write_table(pa.table(columns), tmp_path / "boxes.parquet")
    with pytest.raises(LogError, match="stamp_ns is a float, which loses nanoseconds; store it as int64"):
        read(tmp_path / "boxes.parquet")
    (tmp_path / "boxes.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(LogError, match="its start or end is damaged"):
        read(tmp_path / "boxes.parquet")


def test_which_camera_must_be_known(table):
    path = table("frame,left,top,right,bottom\n0,1,2,3,4\n")
    with pytest.raises(ConfigError, match=r"which camera are the boxes of. the log has left, right; name it"):
        read(path, "left", "right")
    [truth] = read(path, "left", "right", camera="right")
    assert truth.boxes2d.camera.tolist() == ["right"]


def test_what_isnt_finite_comes_as_it_is(table):
    """Whether that is a fault of truth or of results is for others to say."""
    [truth] = read(table(f"frame,{SOLID}\n0,nan,2,0.5,4,2,1.5,0\n0,1,2,3,-4,2,inf,0\n"))
    assert np.isnan(truth.boxes3d.center_m[0, 0])
    assert truth.boxes3d.size_lwh_m[1].tolist() == [-4, 2, np.inf]


def test_too_many_rows_at_one_instant(tmp_path):
    num = _MAX_AT_ONCE + 20_000
    pq.write_table(
        pa.table({"frame": np.zeros(num, np.int64), **{n: np.ones(num) for n in SOLID.split(",")}}),
        tmp_path / "boxes.parquet",
    )
    with pytest.raises(LimitError, match="over 200000 rows at 'frame' 0"):
        read(tmp_path / "boxes.parquet")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts kibibytes as Linux does")
def test_a_million_rows_stream(tmp_path):
    from tests.replay.formats.box_files import coordinates

    from fbench.replay.contracts.faults import FaultLog
    from fbench.replay.formats.open import open_boxes
    from fbench.replay.logs.setup import BoxSource

    num = 1_000_000
    columns = {"frame": np.arange(num) // 50, **{n: np.ones(num) for n in SOLID.split(",")}}
    path = tmp_path / "boxes.parquet"
    pq.write_table(pa.table(columns), path, row_group_size=50_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    truths = open_boxes(BoxSource(path), coordinates("cam"), FaultLog()).truths()
    assert sum(len(truth.boxes3d) for truth in truths) == num
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_boxes_in_another_world_than_the_poses_of_the_log_are_refused(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text(f"frame,frame_id,{SOLID}\n0,map,{BOX}\n")
    known = replace(coordinates("cam"), world="odom")
    with pytest.raises(ConfigError, match="boxes in 'map', but the log's poses are in 'odom'; name a topic with poses"):
        list(open_boxes(BoxSource(path), known, FaultLog()).truths())
    same = replace(known, world="map")
    assert next(open_boxes(BoxSource(path), same, FaultLog()).truths()).in_world
