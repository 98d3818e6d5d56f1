"""Files that are written to do harm; `tests/hostile` damages these, too."""

import io
import json
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.replay.formats.box_files import read
from tests.replay.formats.test_kalibr import CAM
from tests.replay.formats.test_urdf import ROBOT

from fbench.replay.contracts.errors import ConfigError, LimitError, LogError
from fbench.replay.formats.rig_files import open_rig_file

HEADER = "frame,x,y,z,length,width,height,yaw,label,track_id\n"
ROW = "0,12,0,0.7,4,1.8,1.5,0,car,3\n"
CAR = {"type": "car", "object_data": {"cuboid": [{"name": "b", "val": [12, 0, 0.7, 0, 0, 0, 1, 4, 1.8, 1.5]}]}}


def openlabel(car=CAR, **frame):
    return json.dumps({"openlabel": {"frames": {"0": {"objects": {"1": car}, **frame}}}})


def table(num=1, **columns):
    numbers = {name: np.zeros(num) for name in ("x", "y", "z", "length", "width", "height", "yaw")}
    return pa.table({"frame": np.arange(num), **numbers, **columns})


def parquet(content, **options):
    file = io.BytesIO()
    pq.write_table(content, file, **options)
    return file.getvalue()


SUBMISSION = json.dumps({"meta": {}, "results": {"7": [{
    "sample_token": "7", "translation": [1, 2, 3], "size": [2, 4, 1.5], "rotation": [1, 0, 0, 0], "velocity": [1, 0],
    "detection_name": "car", "detection_score": 0.5, "attribute_name": "vehicle.moving",
}]}})  # fmt: skip
KITTI = "Car 0.00 0 -1.58 587.01 173.33 614.12 200.12 1.65 1.67 3.64 -0.65 1.71 46.70 -1.59\n" * 2
VALID = {
    "a.csv": (HEADER + ROW + ROW.replace("0,12", "1,13")).encode(),
    "a.json": openlabel(frame_properties={"timestamp": "2020-01-01T00:00:00"}).encode(),
    "b.json": SUBMISSION.encode(),
    "000000.txt": KITTI.encode(),
    "track.txt": b"".join(b"%d 1 " % i + KITTI[: KITTI.index("\n") + 1].encode() for i in range(2)),
    "gt.txt": b"1,1,10,20,30,40,1,1,0.9\n2,1,11,21,30,40,1,1,0.8\n",
    "a.parquet": parquet(table(3, label=["car", "bus", "car"])),
}


@pytest.mark.parametrize("name", VALID)
def test_what_the_fuzzing_edits_is_valid(tmp_path, name):
    (tmp_path / name).write_bytes(VALID[name])
    assert read(tmp_path / name)


@pytest.mark.parametrize("name", ["a.csv", "000000.txt", "a.json", "a.parquet"])
def test_files_that_would_block_are_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ConfigError, match="neither a regular file nor a folder"):
        read(tmp_path / name)


def test_a_folder_is_read_without_what_would_block(tmp_path):
    os.mkfifo(tmp_path / "000000.txt")
    (tmp_path / "000001.txt").write_text(KITTI)
    assert [truth.frame_number for truth in read(tmp_path, format="kitti")] == [1]


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_one_long_text_among_many_does_not_take_its_room_for_all(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    long = "L" * 300_000
    if kind == "csv":
        path.write_text(HEADER + "".join(f"0,1,2,3,4,2,2,0,{'car' if i else long},{i}\n" for i in range(10_000)))
    else:
        objects = {str(i): {**CAR, "type": "car" if i else long} for i in range(5000)}
        path.write_text(json.dumps({"openlabel": {"frames": {"0": {"objects": objects}}}}))
    with pytest.raises(LogError, match="a text"):
        read(path)


def test_a_text_that_a_dictionary_repeats_is_not_repeated_in_memory(tmp_path):
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(16_384, np.int32)), pa.array(["L" * 1_000_000]))
    for column in (texts, texts.slice(0, 16_384)):
        (tmp_path / "a.parquet").write_bytes(parquet(table(16_384, label=column)))
        with pytest.raises(LimitError, match="column 'label' has a text of 1000000 bytes"):
            read(tmp_path / "a.parquet")


@pytest.mark.slow
def test_pages_that_unpack_to_gigabytes_are_refused_unread(tmp_path):
    content = parquet(table(2, label=["L" * 300_000_000, "x"]), compression="zstd", use_dictionary=False)
    assert len(content) < 100_000
    (tmp_path / "a.parquet").write_bytes(content)
    with pytest.raises(LimitError, match="pages take"):
        read(tmp_path / "a.parquet")


def test_texts_that_grow_when_they_are_decoded_are_refused(tmp_path):
    coded = {"use_dictionary": False, "column_encoding": {"label": "DELTA_BYTE_ARRAY"}}
    (tmp_path / "a.parquet").write_bytes(parquet(table(2, label=["car", "car"]), **coded))
    with pytest.raises(LogError, match="column 'label' is delta-coded text; write it as PLAIN"):
        read(tmp_path / "a.parquet")


def test_texts_of_parquet_must_be_utf8(tmp_path):
    offsets = pa.py_buffer(np.array([0, 2], np.int32))
    wrong = pa.Array.from_buffers(pa.string(), 1, [None, offsets, pa.py_buffer(b"\xff\xfe")])
    (tmp_path / "a.parquet").write_bytes(parquet(table(1, label=wrong)))
    with pytest.raises(LogError, match="Invalid UTF8"):
        read(tmp_path / "a.parquet")


def test_stamps_beyond_nanoseconds_are_named(tmp_path):
    stamps = pa.array([2**62], pa.timestamp("us"))
    (tmp_path / "a.parquet").write_bytes(parquet(table(1).drop_columns(["frame"]).append_column("stamp_ns", stamps)))
    with pytest.raises(LogError, match="row 1: stamp_ns is '4611686018427387904', expected a stamp"):
        read(tmp_path / "a.parquet")


@pytest.mark.parametrize(
    ("column", "kind"),
    [("label", pa.timestamp("s")), ("track_id", pa.timestamp("s")), ("label", pa.timestamp("s", "no/zone"))],
)
def test_times_that_python_cannot_hold_are_one_line(tmp_path, column, kind):
    (tmp_path / "a.parquet").write_bytes(parquet(table(1, **{column: pa.array([10**15], kind)})))
    with pytest.raises(LogError, match=f"column '{column}' is timestamp.*can't be read") as error:
        read(tmp_path / "a.parquet")
    assert "\n" not in str(error.value)


def test_half_a_surrogate_pair_becomes_a_question_mark(tmp_path):
    (tmp_path / "a.json").write_text(openlabel({**CAR, "type": "c\ud800r"}))
    assert read(tmp_path / "a.json")[0].boxes3d.source_label.tolist() == ["c?r"]


def test_one_key_twice_is_refused_since_the_first_value_would_be_lost(tmp_path):
    (tmp_path / "a.json").write_text('{"openlabel": {"frames": {"0": {}, "1": {}, "0": {}}}}')
    with pytest.raises(LogError, match="isn't JSON \\(an object has the key '0' twice\\)"):
        read(tmp_path / "a.json")


def test_a_time_may_have_an_offset(tmp_path):
    (tmp_path / "a.json").write_text(openlabel(frame_properties={"timestamp": "1970-01-01T01:00:02.5+01:00"}))
    assert read(tmp_path / "a.json")[0].stamp_ns == 2_500_000_000


def test_millions_of_frames_without_rows_are_refused(tmp_path):
    (tmp_path / "gt.txt").write_text("1,1,10,20,30,40,1,1,0.9\n9999999,1,10,20,30,40,1,1,0.9\n")
    with pytest.raises(LimitError, match="frames 2 to 9999998 have no row"):
        read(tmp_path / "gt.txt")


OWN = """\
[sensors.lidar]
parent = "body"
translation_m = [1.0, 0, 1.8]
yaw_pitch_roll_deg = [1, 2, 3]
[cameras.front]
fx = 700.0
fy = 700.0
cx = 320.0
cy = 240.0
size_wh = [640, 480]
distortion_model = "plumb_bob"
distortion = [0.1, 0, 0, 0, 0]
"""
INFO = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [700, 0, 320, 0, 700, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
VALID_RIGS = {"a.toml": OWN, "a.urdf": ROBOT, "camchain.yaml": CAM.format(num=0), "front.yaml": INFO}


@pytest.mark.parametrize("name", VALID_RIGS)
def test_the_rigs_that_the_fuzzing_edits_are_valid(tmp_path, name):
    (tmp_path / name).write_text(VALID_RIGS[name])
    open_rig_file(tmp_path / name)


def test_keys_of_many_parts_are_refused_before_they_are_parsed(tmp_path):
    (tmp_path / "a.toml").write_text(".".join("a" * 400_000) + " = 1")
    with pytest.raises(ConfigError, match="line 1 has over 500 dots"):
        open_rig_file(tmp_path / "a.toml")
