import json
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.datasets.astyx.conftest import CALIBRATION

from fbench.datasets.astyx import Astyx
from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Message, PointCloud
from fbench.replay.logs.open import open_log

SWEEP, OBJECTS = "lidar_vlp16/000008.txt", "groundtruth_obj3d/000008.json"
HEADER = "X Y Z Reflectivity LaserID Timestamp\n"


def refused(folder: Path, message: str) -> None:
    out = folder.parent / "out.mcap"
    with pytest.raises(LogError, match=message) as caught:
        import_one(Astyx(), folder, out)
    assert "\n" not in str(caught.value)
    assert not out.exists()


def test_source_missing(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"none: no such folder$")


def test_source_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused(tmp_path / "file", r"file: not a folder$")


def test_source_is_another_folder(tmp_path: Path) -> None:
    refused(tmp_path, r"not an Astyx folder, no lidar_vlp16/$")
    (tmp_path / "lidar_vlp16").mkdir()
    refused(tmp_path, r"not an Astyx folder, no calibration/$")


@pytest.mark.parametrize(("folder", "like"), [("lidar_vlp16", "000001.txt"), ("calibration", "000001.json")])
def test_empty_set(astyx_folder: Path, folder: str, like: str) -> None:
    for path in (astyx_folder / folder).iterdir():
        path.unlink()
    refused(astyx_folder, rf"{folder}: no frames, expected files like {like}$")


def test_no_frame_has_a_point(astyx_folder: Path) -> None:
    for path in (astyx_folder / "lidar_vlp16").iterdir():
        path.write_text(HEADER)
    refused(astyx_folder, r"lidar_vlp16: no frame has a LiDAR point, and so none has a time$")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (SWEEP, HEADER + "1 2 3 4 5 6\n\n1 2 3 4 x 6\n", r"lidar_vlp16/000008.txt: line 4: expected 6 numbers"),
        (SWEEP, HEADER + "1 2 3 4 5\n1 2 3 4 5 6 7\n", r"000008.txt: line 2: expected 6 numbers"),
        (SWEEP, "1 2 3 4 5 6\n", r"000008.txt: line 1: expected the header 'X Y Z Reflectivity"),
        (SWEEP, "", r"000008.txt: line 1: expected the header 'X Y Z Reflectivity"),
        (SWEEP, HEADER + "1 2 3 4 5 nan\n", r"000008.txt: expected LaserID from 0 to 65535 and"),
        (SWEEP, HEADER + "1 2 3 4 -1 6\n", r"000008.txt: expected LaserID from 0 to 65535 and"),
        (SWEEP, HEADER + "1 2 3 4 5 3600000000\n", r"000008.txt: expected .* Timestamp within one hour"),
        (SWEEP, HEADER + "1 2 3 4 5 6\n1 2 3 4 5 3000006\n", r"000008.txt: points more than 2 s apart"),
        ("radar_6455/000008.txt", "\nX Y Z V_r Mag\n1 2 3 4\n", r"radar_6455/000008.txt: line 3: expected 5 numbers"),
        ("calibration/000007.json", "{", r"calibration/000007.json: Invalid JSON"),
        ("calibration/000007.json", "{}", r"calibration/000007.json: sensors: Field required"),
        ("calibration/000010.json", '{"sensors": []}', r"calibration/000010.json: no sensor 'camera_front'"),
        (OBJECTS, '{"objects": [{}]}', r"obj3d/000008.json: objects.0.classname: Field required"),
        (OBJECTS, "", r"groundtruth_obj3d/000008.json: Invalid JSON"),
        ("camera_front/000008.jpg", "no picture", r"camera_front/000008.jpg: neither a JPEG nor a PNG"),
        ("camera_front/000007.jpg", "", r"camera_front/000007.jpg: neither a JPEG nor a PNG"),
    ],
)  # fmt: skip
def test_broken_files(astyx_folder: Path, name: str, content: str, message: str) -> None:
    (astyx_folder / name).write_text(content)
    refused(astyx_folder, message)


def test_images_of_another_size_or_kind(astyx_folder: Path) -> None:
    path = astyx_folder / "camera_front/000008.jpg"
    path.write_bytes(encode_jpeg(np.zeros((5, 6, 3), np.uint8)))
    refused(astyx_folder, r"000008.jpg: 6x5 px, expected 6x4 as in the first image$")
    path.write_bytes(cv2.imencode(".png", np.zeros((4, 6, 3), np.uint8))[1].tobytes())
    refused(astyx_folder, r"000008.jpg: not a JPEG image$")


def test_a_truncated_image(astyx_folder: Path) -> None:
    path = astyx_folder / "camera_front/000008.jpg"
    path.write_bytes(path.read_bytes()[:-2])
    refused(astyx_folder, r"000008.jpg: the image has no end, is it truncated\?$")


def test_tables_may_be_spaced_as_they_like(astyx_folder: Path) -> None:
    path = astyx_folder / SWEEP
    plain = HEADER + "1.1 2.2 -3.3 4 5 6\n1e1 .5 -0.1 7 8 9\n"
    path.write_text(plain)
    logs = []
    for text in (
        plain,
        f"\n  {plain}",
        plain.replace(" ", "  "),
        plain.replace("\n", " \n"),
        plain.replace("\n", "\r\n"),
    ):
        path.write_text(text)
        cloud = next(m for m in messages(astyx_folder) if m.frame_number == 8 and isinstance(m, PointCloud))
        logs.append((cloud.xyz.tobytes(), cloud.intensity.tobytes(), cloud.ring.tobytes(), cloud.offset_ns.tobytes()))
    assert logs == logs[:1] * 5
    assert logs[0][0] == np.array([[1.1, 2.2, -3.3], [10, 0.5, -0.1]], np.float32).tobytes()


def messages(folder: Path) -> list[Message]:
    out = folder.parent / "out.mcap"
    import_one(Astyx(), folder, out)
    return list(open_log(out, FaultLog()).messages())


def skipping(folder: Path, frames: FrameRange | None = None) -> tuple[ImportedLog, BadInput]:
    asked = ImportRequest((folder.name,), frames or FrameRange(), BadInput(skip=True))
    return import_one(Astyx(), folder, folder.parent / "out.mcap", asked), asked.bad


@pytest.mark.parametrize(
    ("name", "content", "left"),
    [
        (SWEEP, HEADER + "1 2 3 4 5\n", {7: 3, 10: 1}),
        (OBJECTS, "{", {7: 3, 8: 3, 10: 1}),
        ("camera_front/000008.jpg", "", {7: 3, 8: 2, 10: 1}),
        ("radar_6455/000007.txt", "x", {7: 2, 8: 3, 10: 1}),
    ],
)
def test_what_cannot_be_used_is_skipped_and_counted(
    astyx_folder: Path, name: str, content: str, left: dict[int, int]
) -> None:
    (astyx_folder / name).write_text(content)
    log, bad = skipping(astyx_folder)
    assert (log.num_skipped, bad.num) == (1, 1)
    assert name in bad.texts[0]
    reader = open_log(log.path, FaultLog())
    assert Counter(m.frame_number for m in reader.messages()) == left
    assert reader.info.metadata["import.skip_bad"] == "yes"


def test_a_sequence_without_usable_calibration_fails_alone(astyx_folder: Path) -> None:
    for number in (7, 8, 10):
        (astyx_folder / f"calibration/{number:06d}.json").write_text("[]")
    log, bad = skipping(astyx_folder)
    assert (log.state, bad.num) == ("failed", 4)
    assert "no frame has a calibration that can be used" in bad.texts[-1]
    assert not log.path.exists()
    (astyx_folder / "calibration/000007.json").write_text(json.dumps(CALIBRATION))
    log, bad = skipping(astyx_folder, FrameRange(0, 8))
    assert (log.state, bad.num) == ("written", 0)


def test_only_frames_that_are_wanted(astyx_folder: Path) -> None:
    whole = import_one(Astyx(), astyx_folder, astyx_folder.parent / "whole.mcap")
    log, _ = skipping(astyx_folder, FrameRange(8, 10))
    reader = open_log(log.path, FaultLog())
    assert {m.frame_number for m in reader.messages()} == {8}
    assert [t.frame_number for t in reader.truths()] == [8]
    assert reader.info.log_id != open_log(whole.path, FaultLog()).info.log_id
    with pytest.raises(LogError, match=r"lidar_vlp16: no frame 11:, there are 7 to 10$"):
        import_one(Astyx(), astyx_folder, log.path, ImportRequest((astyx_folder.name,), FrameRange(11)))


@pytest.mark.parametrize("matrix", [np.eye(4) * 1.002, np.diag([1, 1, -1, 1]), np.zeros((4, 4))])
def test_a_mount_that_is_no_rotation(astyx_folder: Path, matrix: np.ndarray) -> None:
    change(astyx_folder, lambda sensors: sensors[1]["calib_data"].update(T_to_ref_COS=matrix.tolist()))
    refused(astyx_folder, r"000007.json: lidar_vlp16: T_to_ref_COS isn't a rotation")


def test_a_calibration_without_a_sensor_that_has_files(astyx_folder: Path) -> None:
    change(astyx_folder, lambda sensors: sensors.pop(0))
    refused(astyx_folder, r"000007.json: no sensor 'radar_6455'$")


def test_a_camera_without_intrinsics(astyx_folder: Path) -> None:
    change(astyx_folder, lambda sensors: sensors[2]["calib_data"].pop("K"))
    refused(astyx_folder, r"000007.json: camera_front: no K$")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("orientation_quat", [0, 0, 0, 0], r"000007.json: orientation_quat isn't a unit quaternion: 0.0 0.0 0.0 0.0$"),
        ("dimension3d", [4, 0, 1], r"000007.json: objects.0.dimension3d.1: Input should be greater than 0"),
        ("center3d", [4, 0], r"000007.json: objects.0.center3d.2: Field required"),
    ],
)
def test_broken_objects(astyx_folder: Path, key: str, value: list[float], message: str) -> None:
    path = astyx_folder / "groundtruth_obj3d/000007.json"
    content = json.loads(path.read_text())
    content["objects"][0][key] = value
    path.write_text(json.dumps(content))
    refused(astyx_folder, message)


def change(folder: Path, edit) -> None:
    for path in sorted((folder / "calibration").iterdir()):
        content = json.loads(path.read_text())
        edit(content["sensors"])
        path.write_text(json.dumps(content))


@pytest.mark.parametrize("target", ["/nowhere/at/all", "000008.txt"])
def test_links_to_nowhere(astyx_folder: Path, target: str) -> None:
    (astyx_folder / SWEEP).unlink()
    (astyx_folder / SWEEP).symlink_to(target)
    refused(astyx_folder, rf"{SWEEP}: (No such file or directory|Too many levels of symbolic links)$")
