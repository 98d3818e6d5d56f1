from pathlib import Path

import numpy as np
import pytest

from fbench.pipelines.models.samples import CLASSES, samples
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Truth
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter

K = np.array([[40.0, 0, 31.5], [0, 40.0, 23.5], [0, 0, 1]])
RIG = Rig(
    {name: Mount("camera", np.zeros(3), np.array([0, 0, 0, 1.0])) for name in ("front", "rear")},
    {name: CameraModel(K, (64, 48)) for name in ("front", "rear")},
)


def write(path: Path, truth_ns: tuple[int, ...], rows: slice = slice(None), simulated: bool = False) -> Path:
    info = LogInfo("made", log_id="made-1", metadata={SIMULATED: "city 1"} if simulated else {})
    with McapWriter(path, info, RIG) as log:
        for stamp_ns in (100, 200):
            for camera in ("front", "rear"):
                pixels = np.zeros((48, 64, 3), np.uint8)
                log.write(Image(camera, stamp_ns, stamp_ns, encode_jpeg(pixels), "jpeg", (64, 48)))
            if stamp_ns in truth_ns:
                log.write(Truth(stamp_ns, stamp_ns, boxes2d=boxes()[rows]))
    return path


def boxes() -> Boxes2D:
    return Boxes2D(
        camera=np.array(["front", "rear", "front", "front"]),
        xyxy_px=np.array([[10.0, 20, 30, 40], [1, 2, 3, 4], [5, 5, 9, 9], [0, 0, 7, 7]]),
        label=np.array(["bus", "car", "car", "trailer"]),
        ignore=np.array([False, False, True, False]),
    )


def test_images_come_with_the_boxes_of_their_camera(tmp_path):
    first, second, *rest = samples([write(tmp_path / "a.mcap", (100, 200))], FaultLog())
    assert len(rest) == 2
    assert (first.image.sensor, second.image.sensor) == ("front", "rear")
    assert first.class_id.tolist() == [CLASSES.index("bus"), -1, -1], "ignored, and a class that isn't learned"
    assert first.xyxy[0].tolist() == [10.5, 20.5, 30.5, 40.5], "from pixel centers to the upper left corner"
    assert second.class_id.tolist() == [CLASSES.index("car")]
    assert second.is_ignored.tolist() == [False]


def test_images_without_truth_teach_nothing(tmp_path):
    found = samples([write(tmp_path / "a.mcap", (200,))], FaultLog())
    assert [sample.image.stamp_ns for sample in found] == [200, 200]


def test_logs_without_any_are_refused(tmp_path):
    with pytest.raises(LogError, match="nothing to learn from"):
        samples([write(tmp_path / "a.mcap", ())], FaultLog())


def test_recordings_and_simulated_logs_are_told_apart(tmp_path):
    logs = [write(tmp_path / "a.mcap", (100,), simulated=True), write(tmp_path / "b.mcap", (100, 200))]
    assert [sample.is_recorded for sample in samples(logs, FaultLog())] == [False] * 2 + [True] * 4


def test_recordings_without_objects_arent_hidden_by_simulated_logs(tmp_path):
    logs = [write(tmp_path / "a.mcap", (100,), simulated=True), write(tmp_path / "b.mcap", (100,), slice(2, None))]
    with pytest.raises(LogError, match=r"no box in the recordings has one of the labels .*: nothing to learn from$"):
        samples(logs, FaultLog())


def test_corrupt_images_are_left_out_and_counted(tmp_path):
    whole = encode_jpeg(np.zeros((48, 64, 3), np.uint8))
    with McapWriter(tmp_path / "a.mcap", LogInfo("made", log_id="made-1"), RIG) as log:
        for stamp_ns, data in ((100, whole), (200, whole[:30])):
            log.write(Image("front", stamp_ns, stamp_ns, data, "jpeg", (64, 48)))
            log.write(Truth(stamp_ns, stamp_ns, boxes2d=boxes()))
    faults = FaultLog()
    found = samples([tmp_path / "a.mcap"], faults)
    assert [sample.image.stamp_ns for sample in found] == [100]
    assert faults.places == {"DEC002": ["a.mcap: front at stamp 200"]}


def test_what_is_wrong_with_a_log_is_counted(tmp_path):
    path, faults = write(tmp_path / "a.mcap", (100, 200)), FaultLog()
    path.write_bytes(path.read_bytes()[:-40])
    samples([path], faults)
    assert faults.counts["LOG002"] == 1


def test_a_configuration_beside_the_log_counts(tmp_path):
    (tmp_path / "fbench.toml").write_text('version = 1\n[truth]\nfile = "none.json"\n')
    with pytest.raises(ConfigError, match=r"'none\.json': no such file"):
        samples([write(tmp_path / "a.mcap", (100,))], FaultLog())


def test_a_camera_that_nobody_labeled_is_no_background(tmp_path):
    found = samples([write(tmp_path / "a.mcap", (100, 200), slice(0, 1))], FaultLog())
    assert [(sample.image.sensor, sample.image.stamp_ns) for sample in found] == [("front", 100), ("front", 200)]


def test_logs_with_nothing_to_be_found_are_refused(tmp_path):
    with pytest.raises(LogError, match="no box in these logs has one of the labels car, van"):
        samples([write(tmp_path / "a.mcap", (100,), slice(2, 4))], FaultLog())


def test_a_log_made_anew_is_another_one(tmp_path):
    assert samples([write(tmp_path / "a.mcap", (100,))], FaultLog())[0].name == "a made-1 front 100"
