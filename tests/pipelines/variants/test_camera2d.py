from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.variants.camera2d import Camera2D, Camera2DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Message
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.iou import iou_2d

LOG = LogInfo("drive", "id")
MS = 1_000_000
LOOKING = Mount("camera", np.zeros(3), np.array([0.0, 0, 0, 1]))
MODEL = CameraModel(np.eye(3), (120, 100))
JPEG = encode_jpeg(np.zeros((100, 120, 3), np.uint8))


def rig(*cameras: str) -> Rig:
    return Rig(dict.fromkeys(cameras, LOOKING), dict.fromkeys(cameras, MODEL))


def image(sensor: str, stamp_ns: int, data: bytes = JPEG) -> Image:
    return Image(sensor, stamp_ns, stamp_ns, data, "jpeg", (120, 100))


def frame(index: int, *messages: Message) -> Frame:
    return Frame(index, (index + 1) * 100 * MS, 0, {m.sensor: m for m in messages})


def boxes(found: object) -> Boxes2D:
    assert isinstance(found, Boxes2D)
    return found


@pytest.fixture
def pipeline(one_car: Path) -> Camera2D:
    pipeline = Camera2D(Camera2DParams(camera=CameraParams(weights=one_car)))
    pipeline.start(rig("rear", "front"), LOG)
    return pipeline


def both(pipeline: Camera2D, index: int) -> Output:
    return pipeline.step(frame(index, image("front", index), image("rear", index)))


def test_all_cameras_are_used_in_the_order_of_their_names(pipeline: Camera2D) -> None:
    output = both(pipeline, 0)
    found = boxes(output.detections)
    assert found.camera.tolist() == ["front", "front", "rear", "rear"]
    assert found.xyxy_px[0].tolist() == [9.5, 19.5, 49.5, 59.5]
    assert found.label is not None
    assert found.label.tolist() == ["car", "pedestrian"] * 2
    assert found.sources is not None
    assert found.sources.tolist() == [1] * 4
    assert list(output.stage_ns) == ["decode", "preprocess", "detect.camera", "track"]
    assert boxes(output.tracks).track_id is not None
    assert output.faults == ()


def test_a_missing_image_gives_no_detections_and_predicted_tracks(pipeline: Camera2D) -> None:
    for index in range(2):
        both(pipeline, index)
    output = pipeline.step(frame(2, image("front", 2)))
    assert set(boxes(output.detections).camera.tolist()) == {"front"}
    tracks = boxes(output.tracks)
    assert tracks.predicted is not None
    assert tracks.predicted.tolist() == [camera == "rear" for camera in tracks.camera]
    nothing = pipeline.step(frame(3))
    assert len(nothing.detections) == 0
    assert nothing.faults == ()
    assert list(nothing.stage_ns) == ["track"]


def test_a_corrupt_image_is_a_fault(pipeline: Camera2D) -> None:
    output = pipeline.step(frame(0, image("front", 7, b"\xff\xd8broken"), image("rear", 7)))
    assert [(fault.code, fault.where) for fault in output.faults] == [("DEC002", "front at stamp 7")]
    assert boxes(output.detections).camera.tolist() == ["rear", "rear"]


def test_fields_are_the_same_with_and_without_detections(pipeline: Camera2D) -> None:
    full, empty = both(pipeline, 0), pipeline.step(frame(1))
    assert set(boxes(full.detections).arrays()) == set(boxes(empty.detections).arrays())
    assert set(boxes(full.tracks).arrays()) == set(boxes(empty.tracks).arrays())


def test_a_reset_begins_new_tracks_and_lets_time_jump_back(pipeline: Camera2D) -> None:
    before = boxes(both(pipeline, 5).tracks)
    pipeline.reset("gap")
    after = boxes(both(pipeline, 0).tracks)
    assert before.track_id is not None
    assert after.track_id is not None
    assert not set(before.track_id.tolist()) & set(after.track_id.tolist())


def test_without_weights() -> None:
    match = r"camera2d needs a detector for this log: fbench weights get deimv2-femto, then --set camera\.weights="
    with pytest.raises(ConfigError, match=match):
        Camera2D(Camera2DParams()).start(rig("front"), LOG)


SIMULATED = LogInfo("city", "id", {"simulated": "2"})


def test_simulated_logs_need_no_weights() -> None:
    pipeline = Camera2D(Camera2DParams())
    pipeline.start(rig("front"), SIMULATED)
    assert dict(pipeline.identity()).keys() == {"camera.weights"}


def test_simulated_logs_without_the_camera() -> None:
    with pytest.raises(ConfigError, match="camera2d needs a detector for this log"):
        Camera2D(Camera2DParams(camera=CameraParams(weights=None))).start(rig("front"), SIMULATED)


def test_a_rig_without_cameras(one_car: Path) -> None:
    pipeline = Camera2D(Camera2DParams(camera=CameraParams(weights=one_car)))
    with pytest.raises(LogError, match="log 'drive': camera2d needs a camera, and the rig has none"):
        pipeline.start(rig(), LOG)


def test_real_frames_keep_the_car_as_one_track(shared: Path) -> None:
    weights = shared / "weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx"
    pipeline = Camera2D(Camera2DParams(camera=CameraParams(weights=weights)))
    wide = replace(MODEL, size_wh=(2048, 618))
    pipeline.start(Rig({"front": LOOKING}, {"front": wide}), LOG)
    names = [f"{number:06d}.jpg" for number in range(57, 60)]
    held: list[set[int]] = []
    for index, name in enumerate(names):
        data = (shared / "data/astyx/camera_front" / name).read_bytes()
        output = pipeline.step(frame(index, replace(image("front", 0, data), size_wh=(2048, 618))))
        detections, tracks = boxes(output.detections), boxes(output.tracks)
        best = int(np.argmax(iou_2d(detections.xyxy_px[:1], tracks.xyxy_px)[0]))
        assert tracks.track_id is not None
        held.append({int(tracks.track_id[best])})
    assert held[0] == held[1] == held[2]
