"""Another system's results beside KITTI's files: `--detections DIR`."""

from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.datasets.kitti import Kitti
from fbench.datasets.kitti.sensors import KittiParams
from fbench.pipelines.variants.recorded import Recorded
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.contracts.plugins import make_importer
from fbench.replay.data.messages import Truth
from fbench.replay.logs.open import open_log

CAR = "Car -1 -1 -1.5 10 5 60 30 1.5 2.0 4.0 3 1.6 20 0.5"
FLAT = "Pedestrian -1 -1 -10 1 2 3 4 -1 -1 -1 -1 -1 -1 -1"
ROW = "2,2,10,5,60,30,12.5,1.5,2.0,4.0,3,1.6,20,0.5,-1.5"
"""Frame, class, box, score, height, width, length, x, y, z, rotation_y, alpha."""


def imported(
    source: Path, detections: Path, out: Path, frames: FrameRange | None = None, bad: BadInput | None = None
) -> ImportedLog:
    name = Kitti().names(source)[0]
    asked = ImportRequest((name,), frames or FrameRange(), bad or BadInput())
    return import_one(Kitti(KittiParams(detections)), source, out, asked)


def results(out: Path, topic: str = "") -> list[Truth]:
    return list(open_log(out, FaultLog()).detections(topic))


def folder_of(tmp_path: Path, **files: str) -> Path:
    folder = tmp_path / "found"
    folder.mkdir()
    for name, text in files.items():
        (folder / f"{name.removeprefix('n')}.txt").write_text(text)
    return folder


def test_the_setting_of_the_command_line_makes_the_importer(tmp_path: Path, tracking_folder: Path) -> None:
    folder = folder_of(tmp_path, n0000=f"0 7 {CAR} 0.5\n")
    importer = make_importer("kitti", [f"detections={folder}"])
    import_one(importer, tracking_folder, tmp_path / "out.mcap", ImportRequest(("0000",)))
    assert len(results(tmp_path / "out.mcap")) == 4
    assert make_importer("kitti", ["detections=none"]).names(tracking_folder) == ["0000", "0001"]


@pytest.mark.parametrize("text", [ROW, f"2 -1 {CAR} 12.5"])
def test_both_forms_of_a_sequence_give_the_same_boxes(tmp_path: Path, tracking_folder: Path, text: str) -> None:
    out = tmp_path / "out.mcap"
    log = imported(tracking_folder, folder_of(tmp_path, n0000=f"{text}\n"), out)
    found = results(out)
    assert [(t.frame_number, len(t.boxes3d)) for t in found] == [(0, 0), (1, 0), (2, 1), (3, 0)]
    assert found[2].stamp_ns == found[2].log_ns == 300_000_000
    boxes = found[2].boxes3d
    assert boxes.center_m.tolist() == [[20, -3, 0.75 - 1.6]]
    assert boxes.size_lwh_m.tolist() == [[4, 2, 1.5]]
    assert boxes.yaw_rad.tolist() == [-0.5 - np.pi / 2]
    assert boxes.score.tolist() == [12.5]
    assert boxes.source_label.tolist() == ["Car"]
    flat = results(out, "/results/boxes_2d")[2].boxes2d
    assert (flat.xyxy_px.tolist(), flat.score.tolist()) == ([[10, 5, 60, 30]], [12.5])
    assert "detections: 1 in 3D, 1 in 2D, for 4 frames" in log.lines


def test_ids_of_a_tracker_are_kept(tmp_path: Path, tracking_folder: Path) -> None:
    imported(tracking_folder, folder_of(tmp_path, n0000=f"1 4 {CAR}\n1 9 {CAR}\n"), tmp_path / "out.mcap")
    assert results(tmp_path / "out.mcap")[1].boxes3d.track_id.tolist() == [4, 9]


def test_results_in_2d_alone(tmp_path: Path, tracking_folder: Path) -> None:
    """The only topic is that of the image, which `recorded` then takes."""
    log = imported(tracking_folder, folder_of(tmp_path, n0000=f"1 4 {FLAT} 1 \n"), tmp_path / "out.mcap")
    found = results(tmp_path / "out.mcap")
    assert [(t.boxes3d, len(t.boxes2d)) for t in found] == [(None, 0), (None, 1), (None, 0), (None, 0)]
    assert "detections: 1 in 2D, for 4 frames" in log.lines


def test_an_empty_file_found_nothing(tmp_path: Path, tracking_folder: Path) -> None:
    log = imported(tracking_folder, folder_of(tmp_path, n0000="\n"), tmp_path / "out.mcap")
    assert [(len(t.boxes3d)) for t in results(tmp_path / "out.mcap")] == [0, 0, 0, 0]
    assert "detections: none, for 4 frames" in log.lines


def test_a_sequence_without_a_file_has_no_results(tmp_path: Path, tracking_folder: Path) -> None:
    log = imported(tracking_folder, folder_of(tmp_path, n0001=ROW), tmp_path / "out.mcap")
    with pytest.raises(LogError, match=r"which topic holds the results\? there is none, only truth: /truth/boxes, "):
        results(tmp_path / "out.mcap")
    assert "detections: none, found has no 0000.txt" in log.lines


def test_classes_are_not_filtered(tmp_path: Path, tracking_folder: Path) -> None:
    rows = "".join(ROW.replace("2,2,", f"2,{kind},", 1) + "\n" for kind in (1, 2, 3, 7))
    imported(tracking_folder, folder_of(tmp_path, n0000=rows), tmp_path / "out.mcap")
    boxes = results(tmp_path / "out.mcap")[2].boxes3d
    assert boxes.source_label.tolist() == ["Pedestrian", "Car", "Cyclist", "7"]
    assert boxes.label.tolist() == ["pedestrian", "car", "bicycle", "other"]


def test_object_results(tmp_path: Path, object_folder: Path) -> None:
    """Frame 1 has an empty file, frame 5 none."""
    log = imported(object_folder, folder_of(tmp_path, n000000=f"{CAR} 0.75\n", n000001=""), tmp_path / "out.mcap")
    found = results(tmp_path / "out.mcap")
    assert [(t.frame_number, len(t.boxes3d)) for t in found] == [(0, 1), (1, 0)]
    assert found[0].boxes3d.score.tolist() == [0.75]
    assert "detections: 1 in 3D, 1 in 2D, for 2 frames" in log.lines


def test_other_content_is_another_log(tmp_path: Path, tracking_folder: Path) -> None:
    """Files of the same size, which logs can't be told apart by."""
    folder, ids = folder_of(tmp_path, n0000=ROW), []
    for text in (ROW, ROW.replace("12.5", "12.6")):
        (folder / "0000.txt").write_text(text)
        imported(tracking_folder, folder, tmp_path / "out.mcap")
        ids.append(open_log(tmp_path / "out.mcap", FaultLog()).info.log_id)
    assert ids[0] != ids[1]


def test_no_folder_of_results(tmp_path: Path, tracking_folder: Path) -> None:
    for name, message in (("none", "no such folder"), ("file", "not a folder"), ("empty", "no file like 0000.txt")):
        (tmp_path / "file").touch()
        (tmp_path / "empty").mkdir(exist_ok=True)
        with pytest.raises(ConfigError, match=f"--detections .*{name}: {message}"):
            imported(tracking_folder, tmp_path / name, tmp_path / "out.mcap")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CAR, r"0000.txt: no results of a sequence, expected KITTI's 17 or 18 columns .* or AB3DMOT's 15 with commas"),
        ("1,2,3,4,5,6,7\n", r"0000.txt: no results of a sequence"),
        ("hello\n", r"0000.txt: no results of a sequence"),
        (f"{ROW}\n2,2,1\n", r"0000.txt line 2: 3 columns, expected 15: frame, class, left"),
        (f"{ROW}\n{ROW.replace('12.5', 'nan')}\n", r"0000.txt line 2: a number isn't finite"),
        (f"{ROW}\n{ROW.replace('12.5', 'x')}\n", r"0000.txt line 2: score is 'x', expected a number"),
        (f"4{ROW[1:]}\n", r"0000.txt: has frame 4, but sequence 0000 has 4 frames; are the results of another one\?"),
        (f"1 4 {CAR}\n1 4 {CAR}\n", r"0000.txt line 2: id 4 twice in frame 1"),
        (f"1 x {CAR}\n", r"0000.txt line 1: track id is 'x'"),
        (f"-1 4 {CAR}\n", r"0000.txt line 1: frame is -1"),
        (f"1e9 4 {CAR}\n", r"0000.txt line 1: frame is '1e9', expected a whole number"),
        (f"999999 4 {CAR}\n", r"0000.txt line 1: frame is 999999, expected less than 200000"),
    ],
)
def test_bad_results(tmp_path: Path, tracking_folder: Path, text: str, message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        imported(tracking_folder, folder_of(tmp_path, n0000=text), tmp_path / "out.mcap")
    assert "\n" not in str(caught.value)


def test_bad_text(tmp_path: Path, tracking_folder: Path) -> None:
    folder = folder_of(tmp_path, n0000="")
    (folder / "0000.txt").write_bytes(f"{ROW}\n".encode() + b"\xff\xfe\n")
    with pytest.raises(LogError, match=r"0000.txt: isn't UTF-8"):
        imported(tracking_folder, folder, tmp_path / "out.mcap")


def test_bad_rows_are_counted_where_they_may_be_skipped(tmp_path: Path, tracking_folder: Path) -> None:
    bad = BadInput(skip=True)
    folder = folder_of(tmp_path, n0000=f"{ROW}\n{ROW},7\n9{ROW[1:]}\n")
    imported(tracking_folder, folder, tmp_path / "out.mcap", bad=bad)
    assert bad.num == 2
    assert [len(t.boxes3d) for t in results(tmp_path / "out.mcap")] == [0, 0, 1, 0]


def test_results_of_other_frames_than_those_of_the_set(tmp_path: Path, object_folder: Path) -> None:
    folder = folder_of(tmp_path, n000000=CAR, n000007=CAR)
    with pytest.raises(LogError, match=r"000007.txt: no such frame in .*objects; are the results of another set\?"):
        imported(object_folder, folder, tmp_path / "out.mcap")


@pytest.fixture(scope="module")
def tracking(shared: Path) -> Path:
    folder = shared / "data/kitti_tracking"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return folder


VALIDATION = ["0001", "0006", "0008", "0010", "0012", "0013", "0014", "0015", "0016", "0018", "0019"]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in ("0012", "0014") else pytest.mark.slow) for n in VALIDATION]
)
def test_real_3d_detections_of_the_validation_sequences(tracking: Path, tmp_path: Path, name: str) -> None:
    folder, out = tracking / "pointrcnn_car_val", tmp_path / "out.mcap"
    import_one(Kitti(KittiParams(folder)), tracking, out, ImportRequest((name,)))
    rows = np.loadtxt(folder / f"{name}.txt", delimiter=",", ndmin=2)
    found, truths = results(out), list(open_log(out, FaultLog()).truths())
    assert [t.stamp_ns for t in found] == [t.stamp_ns for t in truths]
    for result in found:
        of_frame = rows[rows[:, 0] == result.frame_number]
        assert len(result.boxes3d) == len(of_frame)
        if len(of_frame):
            x, y, z, h = of_frame[:, 10], of_frame[:, 11], of_frame[:, 12], of_frame[:, 7]
            np.testing.assert_allclose(result.boxes3d.center_m, np.column_stack([z, -x, h / 2 - y]), atol=1e-12)
            assert result.boxes3d.score.tolist() == of_frame[:, 6].tolist()
    assert sum(len(t.boxes2d) for t in results(out, "/results/boxes_2d")) == len(rows)


def test_real_detections_lie_on_the_labeled_cars(tracking: Path, tmp_path: Path) -> None:
    """Independent of the axes: the nearest labeled car or van is less than 1 m away from most detections that the
    detector is sure of.
    """
    out = tmp_path / "out.mcap"
    import_one(Kitti(KittiParams(tracking / "pointrcnn_car_val")), tracking, out, ImportRequest(("0012",)))
    near = []
    for truth, result in zip(open_log(out, FaultLog()).truths(), results(out), strict=True):
        if len(result.boxes3d):
            sure = result.boxes3d.center_m[result.boxes3d.score > 5]
            apart = np.linalg.norm(truth.boxes3d.center_m[None] - sure[:, None], axis=2)
            near.extend(apart.min(axis=1, initial=99))
    assert len(near) > 50
    assert np.mean(np.array(near) < 1) > 0.9


@pytest.mark.parametrize("inner", ["", "data"])
def test_a_real_tracker_in_2d(tracking: Path, tmp_path: Path, inner: str) -> None:
    """Where TrackEval keeps it, in `data/`; `recorded` takes its boxes for tracks in images."""
    folder, out = tracking / "trackers_2d/GT-SORT" / inner, tmp_path / "out.mcap"
    import_one(Kitti(KittiParams(folder)), tracking, out, ImportRequest(("0012",)))
    rows = [r.split() for r in (tracking / "trackers_2d/GT-SORT/data/0012.txt").read_text().splitlines() if r.strip()]
    found = results(out)
    assert all(t.boxes3d is None for t in found)
    for result in found:
        of_frame = [row for row in rows if int(row[0]) == result.frame_number]
        if of_frame:
            assert result.boxes2d.track_id.tolist() == [int(row[1]) for row in of_frame]
        assert result.boxes2d.xyxy_px.tolist() == [[float(v) for v in row[6:10]] for row in of_frame]
    reader = open_log(out, FaultLog())
    pipeline = Recorded()
    pipeline.use_log(reader)
    pipeline.start(reader.rig, reader.info)
