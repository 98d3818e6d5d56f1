import hashlib

import numpy as np
import pytest

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import CityRequest
from fbench.pipelines.sensors.camera.detector import (
    CITY_WEIGHTS,
    CameraDetector,
    CameraParams,
    Thresholds,
    builtin_identity,
    thresholds,
    use_builtin,
)
from fbench.replay.contracts.errors import ModelError
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, Truth
from fbench.replay.data.rig import LogInfo
from fbench.replay.geometry.iou import iou_2d

SIMULATED = LogInfo("city", "city-1", {"simulated": "2"})
REAL = LogInfo("drive", "drive-1", {})


def test_it_is_the_default_on_simulated_logs_only(tmp_path):
    named = CameraParams(weights=tmp_path / "mine.onnx")
    own = {"front": CameraParams(), "left": CameraParams(weights=None), "rear": named}
    assert use_builtin(own, REAL) == own
    assert use_builtin(own, SIMULATED) == {**own, "front": CameraParams(weights=CITY_WEIGHTS)}


def test_the_manifest_tells_which_it_was():
    own = use_builtin({"front": CameraParams()}, SIMULATED)
    said = builtin_identity(own, CameraParams())
    sha256 = hashlib.sha256(CITY_WEIGHTS.read_bytes()).hexdigest()
    assert said == {"camera.weights": {"file": "city.onnx", "sha256": sha256}}
    assert builtin_identity(use_builtin({"front": CameraParams()}, REAL), CameraParams()) == {}
    some = use_builtin({"front": CameraParams(), "rear": CameraParams(weights=None)}, SIMULATED)
    assert builtin_identity(some, CameraParams()).keys() == {"camera.weights"}
    assert builtin_identity(some, CameraParams(weights=None)).keys() == {"front.weights"}
    assert builtin_identity({"front": CameraParams(CITY_WEIGHTS)}, CameraParams(CITY_WEIGHTS)) == {}


def test_it_is_small():
    assert CITY_WEIGHTS.stat().st_size <= 4_000_000


def test_what_is_asked_for_goes_before_what_the_weights_say():
    said = {"min_score": "0.3", "nms_iou": "0.7"}
    assert thresholds({"min_score": None, "nms_iou": None}, said) == Thresholds(0.3, 0.7, 0.9)
    assert thresholds({"min_score": 0.0, "nms_iou": None}, said) == Thresholds(0.0, 0.7, 0.9)
    assert thresholds({}, {}) == Thresholds(0.6, 0.5, 0.9)


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "-0.1", "1.5"])
def test_metadata_that_arent_shares_are_refused(text):
    with pytest.raises(ModelError, match="'min_score': expected a number between 0 and 1"):
        thresholds({}, {"min_score": text})


@pytest.mark.slow
def test_it_finds_near_vehicles_on_a_drive_that_it_never_saw():
    """The figures are in docs/detector.md; here a short drive of a test seed."""
    settings = ["camera.rate_hz=1.0"]
    spec = CityRequest("urban", seconds=8.0, seed=9001, sensors=["camera"], settings=settings).spec()
    detector = CameraDetector(CameraParams(CITY_WEIGHTS))
    items = list(CityRecording(spec, "test").items())
    truths = {item.stamp_ns: item.boxes2d for item in items if isinstance(item, Truth)}
    found = missed = 0
    for image in (item for item in items if isinstance(item, Image)):
        truth = truths[image.stamp_ns]
        near = np.isin(truth.label, VEHICLES) & (truth.distance_m < 40) & (truth.visibility > 0.7) & ~truth.ignore
        boxes = detector.infer(detector.prepare(decode(image))).xyxy_px
        hit = (iou_2d(truth.xyxy_px[near], boxes) > 0.5).any(axis=1) if len(boxes) else np.zeros(near.sum(), bool)
        found, missed = found + hit.sum(), missed + (~hit).sum()
    assert found + missed >= 15
    assert found >= 0.75 * (found + missed)
