from pathlib import Path

import numpy as np

from fbench.pipelines.sensors.camera.detector import CameraDetector, CameraParams, look
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.frames import Fault
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image


def image(data: bytes) -> Image:
    return Image("front", 7, 9, data, "jpeg", (120, 100))


def test_an_image_is_decoded_prepared_and_looked_at(one_car: Path) -> None:
    clock, faults = StageClock(), list[Fault]()
    jpeg = encode_jpeg(np.zeros((100, 120, 3), np.uint8))
    found = look(CameraDetector(CameraParams(weights=one_car)), image(jpeg), clock, faults)
    assert found.label.tolist() == ["car", "pedestrian"]
    assert list(clock.stage_ns) == ["decode", "preprocess", "detect.camera"]
    assert faults == []


def test_a_corrupt_image_is_a_fault_with_its_place(one_car: Path) -> None:
    clock, faults = StageClock(), list[Fault]()
    assert look(CameraDetector(CameraParams(weights=one_car)), image(b"\xff\xd8broken"), clock, faults) is None
    assert faults == [Fault("DEC002", "front at stamp 7")]
    assert list(clock.stage_ns) == ["decode"]
