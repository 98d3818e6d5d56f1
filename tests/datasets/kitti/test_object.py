"""The object benchmark: a tiny folder by hand, and three real frames against a plain computation in numpy."""

from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.datasets.kitti import Kitti
from fbench.replay.check.log_check import CheckOptions, check_log
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.messages import Image, Message, PointCloud, Tick, Truth
from fbench.replay.data.rig import Rig, RigChange
from fbench.replay.geometry.iou import corners, iou_2d
from fbench.replay.geometry.transforms import inverse, transform
from fbench.replay.logs.open import open_log

S = 1_000_000_000


def imported(source: Path, out: Path, frames: FrameRange | None = None) -> tuple[Reader, ImportedLog]:
    log = import_one(Kitti(), source, out, ImportRequest(tuple(Kitti().names(source)), frames or FrameRange()))
    return open_log(out, FaultLog()), log


def test_all_frames_are_one_log_named_as_the_folder(object_folder: Path, tmp_path: Path) -> None:
    assert Kitti().names(object_folder) == ["objects"]
    reader, log = imported(object_folder, tmp_path / "out.mcap")
    assert [(t.frame_number, t.stamp_ns) for t in reader.truths()] == [(0, 10 * S), (1, 20 * S), (5, 60 * S)]
    assert reader.info.metadata["benchmark"] == "object"
    assert "classes: Car 2" in log.lines
    assert "boxes: 2, without track ids; 1 DontCare regions" in log.lines


def test_both_benchmarks_in_one_folder(object_folder: Path, tracking_folder: Path) -> None:
    """Their downloads unpack to the same `training/`, and name files with 6 and 4 digits."""
    for folder in sorted(object_folder.iterdir()):
        for path in sorted(folder.iterdir()):
            target = tracking_folder / folder.name / path.name
            target.parent.mkdir(exist_ok=True)
            path.rename(target)
    assert Kitti().names(tracking_folder) == ["0000", "0001", "set"]


def test_each_frame_has_its_calibration_and_size(object_folder: Path, tmp_path: Path) -> None:
    reader, _ = imported(object_folder, tmp_path / "out.mcap")
    assert reader.rig.cameras["image_02"].size_wh == (100, 40)
    assert reader.rig.cameras["image_02"].K[0, 0] == 700
    items = list(reader.messages())
    [change] = [item for item in items if isinstance(item, RigChange)]
    assert (change.log_ns, change.sensors) == (60 * S, ("image_02",))
    assert change.rig.cameras["image_02"].size_wh == (90, 30)
    assert change.rig.cameras["image_02"].K[0, 0] == 650
    assert [item.frame_number for item in items[items.index(change) + 1 :]] == [5, 5]


def test_a_frame_without_an_image_has_a_size_from_its_boxes(object_folder: Path, tmp_path: Path) -> None:
    (object_folder / "image_2/000005.png").unlink()
    reader, log = imported(object_folder, tmp_path / "out.mcap")
    [change] = [item for item in reader.messages() if isinstance(item, RigChange)]
    assert change.rig.cameras["image_02"].size_wh == (61, 32)
    assert "missing files: image_02 1 (frames 5)" in log.lines


def test_unlabeled_frames_are_not_empty_ones(object_folder: Path, tmp_path: Path) -> None:
    (object_folder / "label_2/000000.txt").unlink()
    reader, log = imported(object_folder, tmp_path / "out.mcap")
    assert [t.frame_number for t in reader.truths()] == [1, 5]
    assert "unlabeled frames: 1" in log.lines


def test_gaps_between_frames_are_no_finding(object_folder: Path, tmp_path: Path) -> None:
    reader, _ = imported(object_folder, tmp_path / "out.mcap")
    result = check_log(reader, FaultLog(), CheckOptions())
    assert {f.severity for f in result.findings if f.code == "TIM007"} == {"info"}
    assert result.frames.num_frames == 3


def test_a_range_of_frames(object_folder: Path, tmp_path: Path) -> None:
    reader, _ = imported(object_folder, tmp_path / "out.mcap", FrameRange(5))
    assert [t.stamp_ns for t in reader.truths()] == [60 * S]
    assert reader.rig.cameras["image_02"].size_wh == (90, 30)


def test_importing_again_gives_the_same_bytes(object_folder: Path, tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        imported(object_folder, tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.fixture(scope="module")
def real(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    folder = shared / "data/kitti_object"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return imported(folder, tmp_path_factory.mktemp("object") / "out.mcap")[0]


def matrices(path: Path) -> dict[str, np.ndarray]:
    rows = (line.split(":") for line in path.read_text().splitlines() if line.strip())
    return {key: np.array(values.split(), float) for key, values in rows}


def plain_counts(folder: Path, number: int) -> list[int]:
    """Points inside each labeled box, in the coordinates of camera 0, where labels are."""
    found = matrices(folder / f"calib/{number:06d}.txt")
    R, velo = found["R0_rect"].reshape(3, 3), found["Tr_velo_to_cam"].reshape(3, 4)
    points = np.fromfile(folder / f"velodyne/{number:06d}.bin", np.float32).reshape(-1, 4)[:, :3].astype(float)
    xyz = (R @ (velo[:, :3] @ points.T + velo[:, 3:])).T
    counts = []
    for line in (folder / f"label_2/{number:06d}.txt").read_text().splitlines():
        name, *texts = line.split()
        if name == "DontCare":
            continue
        h, w, length, x, y, z, ry = map(float, texts[7:14])
        dx, dy, dz = (xyz - [x, y, z]).T
        along, across = np.cos(ry) * dx - np.sin(ry) * dz, np.sin(ry) * dx + np.cos(ry) * dz
        counts.append(int(np.sum((np.abs(along) <= length / 2) & (np.abs(across) <= w / 2) & (dy <= 0) & (dy >= -h))))
    return counts


def inside_counts(cloud: PointCloud, truth: Truth, body_T_lidar: np.ndarray) -> list[int]:
    xyz, boxes = transform(body_T_lidar, cloud.xyz), truth.boxes3d
    counts = []
    for center, size, yaw in zip(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, strict=True):
        d = xyz - center
        along, left = np.cos(yaw) * d[:, 0] + np.sin(yaw) * d[:, 1], np.cos(yaw) * d[:, 1] - np.sin(yaw) * d[:, 0]
        local = np.abs(np.column_stack([along, left, d[:, 2]]))
        counts.append(int(np.all(local <= size / 2, axis=1).sum()))
    return counts


def with_rigs(reader: Reader) -> list[tuple[Message, Rig]]:
    """Messages, each with the rig that holds for it."""
    rig, found = reader.rig, []
    for item in reader.messages():
        if isinstance(item, RigChange):
            rig = item.rig
        elif not isinstance(item, Tick):
            found.append((item, rig))
    return found


def test_real_points_inside_boxes_are_those_of_a_plain_computation(real: Reader, shared: Path) -> None:
    truths = {t.frame_number: t for t in real.truths()}
    counts = {
        m.frame_number: inside_counts(m, truths[m.frame_number], rig.body_T_sensor("velodyne"))
        for m, rig in with_rigs(real)
        if isinstance(m, PointCloud)
    }
    assert counts == {number: plain_counts(shared / "data/kitti_object", number) for number in range(3)}
    assert counts[0] == [376]
    assert all(count > 0 for of_frame in counts.values() for count in of_frame)


def test_real_boxes_project_onto_their_labels(real: Reader) -> None:
    truths = {t.frame_number: t for t in real.truths()}
    ious = []
    for image, rig in with_rigs(real):
        if not isinstance(image, Image):
            continue
        truth, (width, height) = truths[image.frame_number], image.size_wh
        camera_T_body = inverse(rig.body_T_sensor("image_02"))
        for points, xyxy in zip(
            corners(truth.boxes3d), truth.boxes2d.xyxy_px[truth.boxes2d.source_label != "DontCare"], strict=True
        ):
            uvw = transform(camera_T_body, points) @ rig.cameras["image_02"].K.T
            uv = uvw[:, :2] / uvw[:, 2:]
            low, high = np.maximum(uv.min(0), 0), np.minimum(uv.max(0), [width - 1, height - 1])
            ious.append(iou_2d(np.array([[*low, *high]]), xyxy[None])[0, 0])
    assert len(ious) == 6
    assert np.mean(ious) == pytest.approx(0.9516, abs=5e-4)
    assert min(ious) > 0.88


def test_real_files_are_taken_over(real: Reader, shared: Path) -> None:
    folder = shared / "data/kitti_object"
    images = [m for m in real.messages() if isinstance(m, Image)]
    assert [image.size_wh for image in images] == [(1224, 370), (1242, 375), (1242, 375)]
    for number, image in enumerate(images):
        assert image.data == (folder / f"image_2/{number:06d}.png").read_bytes()
    for number, cloud in enumerate(m for m in real.messages() if isinstance(m, PointCloud)):
        points = np.fromfile(folder / f"velodyne/{number:06d}.bin", "<f4").reshape(-1, 4)
        np.testing.assert_array_equal(cloud.xyz, points[:, :3])
        np.testing.assert_array_equal(cloud.intensity, points[:, 3])


def test_real_alpha_and_regions_are_kept(real: Reader) -> None:
    _, second, _ = real.truths()
    assert second.boxes2d.attribute.tolist() == ["alpha=-1.57", "alpha=1.85", "alpha=-1.65", "", "", "", ""]
    assert second.boxes2d.ignore.tolist() == [False] * 3 + [True] * 4
    assert second.boxes3d.label.tolist() == ["truck", "car", "bicycle"]
