"""lidar2d, radar2d, early2d and late2d on the frames of a small drive, and on rigs and messages that lack something."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from tests.pipelines.frames import CAMERA, JPEG, MOUNTS, cloud, frame, image, rig, scan

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.sensors.image.params import LidarImageParams, RadarImageParams, far_radar
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.variants.early import Early2D, Early2DParams
from fbench.pipelines.variants.late import Late2D, Late2DParams
from fbench.pipelines.variants.lidar import Lidar2D, Lidar2DParams
from fbench.pipelines.variants.radar import Radar2D, Radar2DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import CameraModel, LogInfo, Rig

LOG = LogInfo("drive", "id")
SIMULATED_LOG = LogInfo("drive", "id", {SIMULATED: "1"})
ALL = "cam", "lidar", "radar"
FUSIONS: dict[str, Callable[[Path], Early2D | Late2D]] = {
    "early2d": lambda weights: Early2D(Early2DParams(camera=CameraParams(weights=weights))),
    "late2d": lambda weights: Late2D(Late2DParams(camera=CameraParams(weights=weights))),
}


@pytest.fixture(params=FUSIONS)
def fusion(request: pytest.FixtureRequest, one_car: Path) -> Early2D | Late2D:
    pipeline = FUSIONS[request.param](one_car)
    pipeline.start(rig(*ALL), LOG)
    return pipeline


def cars(boxes: object) -> Boxes2D:
    assert isinstance(boxes, Boxes2D)
    assert boxes.label is not None
    return boxes[boxes.label == "car"]


@pytest.mark.parametrize(
    ("log", "grouping", "xyxy_px"),
    [
        # Its back is 20 m ahead, 1.8 m wide, with points up to 1.2 m over ground, 1.6 m below the camera.
        (SIMULATED_LOG, None, [3.3, 25.6, 55.8, 59.5]),
        (LOG, "image", [3.3, 25.6, 55.8, 59.5]),
        # Completed to a car 1.6 m high: at 500 px of focal length 45 px wide and 40 px high, whatever its points show.
        (LOG, None, [7.0, 19.5, 52.0, 59.5]),
        (SIMULATED_LOG, "space", [7.0, 19.5, 52.0, 59.5]),
    ],
)
def test_a_lidar_sees_the_car_in_the_image(
    log: LogInfo, grouping: Literal["image", "space"] | None, xyxy_px: list[float]
):
    pipeline = Lidar2D(Lidar2DParams(lidar_image=LidarImageParams(grouping=grouping)))
    pipeline.start(rig("cam", "lidar"), log)
    output = pipeline.step(frame(0, cloud()))
    assert output.detections.xyxy_px[0] == pytest.approx(xyxy_px, abs=1.0)
    assert output.detections.distance_m[0] == pytest.approx(22.1, abs=0.1)
    assert output.detections.sources.tolist() == [2]
    assert output.detections.label is None
    assert list(output.stage_ns) == ["calibrate", "preprocess", "detect.lidar", "track"]


def test_a_sparse_radar_sees_the_car_and_that_it_approaches_the_own_one():
    pipeline = Radar2D(Radar2DParams(min_score=0.3))
    pipeline.start(rig("cam", "radar"), LOG)
    output = pipeline.step(frame(0, scan()))
    assert output.detections.range_rate_mps.tolist() == pytest.approx([3.0 - 8.0], abs=0.1)  # own 8 m/s, car 3 m/s
    assert output.detections.distance_m[0] == pytest.approx(21.5, abs=0.6)
    assert output.detections.sources.tolist() == [4]
    (warning,) = pipeline.warnings()
    assert (warning.code, "fewer than 5000 echoes in 1 of 1 frames" in warning.where) == ("PRD006", True)


def test_what_was_counted_stays_where_the_rig_changes_within_a_log():
    pipeline, sensors = Radar2D(), rig("cam", "radar")
    higher = replace(sensors, mounts={**sensors.mounts, "radar": replace(MOUNTS["radar"], translation_m=np.ones(3))})
    for log, mounted, num in ((LOG, sensors, 1), (LOG, higher, 2), (LogInfo("other", "id-2"), sensors, 1)):
        pipeline.start(mounted, log)
        pipeline.step(frame(0, scan()))
        (warning,) = pipeline.warnings()
        assert f"in {num} of {num} frames" in warning.where


def test_from_how_many_echoes_on_radars_outline_is_known_of_simulated_ones():
    simulated = Radar2D(Radar2DParams(min_score=0.3))
    simulated.start(rig("cam", "radar"), LogInfo("city", "id", {SIMULATED: "1"}))
    simulated.step(frame(0, scan()))
    (warning,) = simulated.warnings()
    assert "fewer than 1000 echoes in 1 of 1 frames" in warning.where
    asked = Radar2D(Radar2DParams(min_score=0.3, radar_image=RadarImageParams(min_echoes=1)))
    asked.start(rig("cam", "radar"), LOG)
    asked.step(frame(0, scan()))
    assert asked.warnings() == ()


def test_echoes_of_simulated_radars_count_more_the_farther_away():
    """As they do in space, see `radar.full_score_within_m`: 20 m unless another distance is named."""
    far = replace(scan(), xyz=scan().xyz + np.array([40, 0, 0], np.float32))
    scores = []
    for within_m in (None, 20.0, 10_000.0):
        pipeline = Radar2D(Radar2DParams(min_score=0.0, radar=replace(far_radar(), full_score_within_m=within_m)))
        pipeline.start(rig("cam", "radar"), LogInfo("city", "id", {SIMULATED: "1"}))
        scores.append(float(pipeline.step(frame(0, far)).detections.score[0]))
    assert scores[0] == scores[1] > scores[2] + 0.1


def test_three_sensors_see_one_car(fusion: Early2D | Late2D):
    output = fusion.step(frame(0, image(), cloud(), scan()))
    car = cars(output.detections)
    assert car.xyxy_px[0] == pytest.approx([9.5, 19.5, 49.5, 59.5], abs=2)  # the camera's, drawn to the points
    assert car.sources.tolist() == [7]
    assert car.distance_m[0] == pytest.approx(22.1, abs=0.3)
    assert car.range_rate_mps[0] == pytest.approx(-5.0, abs=0.1)
    alone = ["detect.lidar", "detect.radar"] if isinstance(fusion, Late2D) else []  # what detects by itself
    stages = ["decode", "preprocess", "detect.camera", "calibrate", *alone, "fuse", "track"]
    assert list(output.stage_ns) == stages


@pytest.mark.parametrize("present", [c for num in range(4) for c in combinations(ALL, num)], ids="-".join)
def test_any_subset_of_messages(fusion: Early2D | Late2D, present: tuple[str, ...]):
    full = fusion.step(frame(0, image(), cloud(), scan()))
    fusion.reset("again")
    messages = {"cam": image(), "lidar": cloud(), "radar": scan()}
    output = fusion.step(frame(0, *(messages[name] for name in present)))
    assert output.detections.arrays().keys() == full.detections.arrays().keys()
    assert output.tracks.arrays().keys() == full.tracks.arrays().keys()
    assert output.faults == ()
    if "cam" in present:
        bits = {"cam": 1, "lidar": 2, "radar": 4}
        assert cars(output.detections).sources.tolist() == [sum(bits[name] for name in present)]


def test_a_corrupt_image_is_a_fault_and_the_rest_goes_on(fusion: Early2D | Late2D):
    output = fusion.step(frame(0, image(JPEG[:50]), cloud(), scan()))
    assert [fault.code for fault in output.faults] == ["DEC002"]


@pytest.mark.parametrize("pipeline", [Early2D(), Late2D()], ids=["early2d", "late2d"])
def test_without_weights_lidar_and_radar_go_on(pipeline: Early2D | Late2D):
    pipeline.start(rig(*ALL), LOG)
    output = pipeline.step(frame(0, image(), cloud(), scan()))
    assert output.missing == {"cam": "no weights"}
    assert cars(output.detections).sources.tolist() == [6]


def test_the_order_of_points_changes_nothing(fusion: Early2D | Late2D):
    expected = fusion.step(frame(0, image(), cloud(), scan())).detections.arrays()
    for seed in range(3):
        fusion.reset("again")
        order = np.random.default_rng(seed)
        found = fusion.step(frame(0, image(), cloud(order), scan(order))).detections.arrays()
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize("num", [0, 1, 30])
def test_next_to_no_points(fusion: Early2D | Late2D, num: int):
    points = np.full((num, 3), 10.0, np.float32)
    same = PointCloud("lidar", 0, 0, points), RadarScan("radar", 0, 0, points, np.zeros(num, np.float32))
    output = fusion.step(frame(0, image(), *same))
    assert np.isfinite(output.detections.xyxy_px).all()


def test_between_detections_tracks_stand_for_them(one_car: Path):
    pipeline = Early2D(Early2DParams(camera=CameraParams(weights=one_car), detect_every=2))
    pipeline.start(rig(*ALL), LOG)
    pipeline.step(frame(0, image(), cloud(), scan()))
    between = pipeline.step(frame(1, image(), cloud(), scan()))
    assert list(between.stage_ns) == ["track"]
    assert between.detections.predicted.all()
    # Predicted by its range rate of -5 m/s over 0.1 s.
    assert cars(between.detections).distance_m[0] == pytest.approx(22.1 - 0.5, abs=0.3)


@pytest.mark.parametrize(
    ("pipeline", "names", "match"),
    [
        (Lidar2D(), ("cam", "radar"), "lidar2d needs a LiDAR; the log has: camera cam, radar radar"),
        (Radar2D(), ("cam", "lidar"), "radar2d needs a radar; the log has"),
        (Early2D(), ("cam",), "early2d needs a LiDAR, a radar or a stereo pair of cameras; the log has: camera cam"),
        (Late2D(), ("cam",), "late2d needs a LiDAR, a radar or a stereo pair of cameras; the log has: camera cam"),
        (Lidar2D(), ("lidar",), "lidar2d works in images, and the rig has no camera"),
        (Radar2D(), ("radar",), "radar2d works in images, and the rig has no camera"),
        (Early2D(), ("lidar", "radar"), "early2d works in images, and the rig has no camera"),
        (Late2D(), ("lidar",), "late2d works in images, and the rig has no camera"),
    ],
)
def test_rigs_that_lack_a_sensor(pipeline: Lidar2D | Radar2D | Early2D | Late2D, names: tuple[str, ...], match: str):
    with pytest.raises(LogError, match=f"log 'drive': {match}") as caught:
        pipeline.start(rig(*names), LOG)
    assert caught.value.code == "CFG001"


def test_cameras_that_cant_be_projected_into_are_left_out():
    blind = Rig({**{name: MOUNTS[name] for name in ALL}, "bare": MOUNTS["cam"]}, {"cam": CAMERA})
    pipeline = Lidar2D()
    pipeline.start(blind, LOG)
    assert set(pipeline.step(frame(0, cloud())).detections.camera.tolist()) == {"cam"}
    with pytest.raises(LogError, match="lidar2d can't project into camera 'cam': the log has no intrinsics of it"):
        pipeline.start(Rig({name: MOUNTS[name] for name in ALL}, {}), LOG)
    odd = CameraModel(CAMERA.K, CAMERA.size_wh, "unheard_of", np.ones(3))
    with pytest.raises(LogError, match="lidar2d can't project into camera 'cam'"):
        pipeline.start(Rig({name: MOUNTS[name] for name in ALL}, {"cam": odd}), LOG)


def test_wrong_parameters():
    for params in (Lidar2DParams, Radar2DParams, Early2DParams, Late2DParams):
        with pytest.raises(ConfigError, match="detect_every"):
            params(detect_every=0)
    with pytest.raises(ConfigError, match="min_score"):
        replace(Lidar2DParams(), min_score=2.0)


def test_what_remembers_is_forgotten_where_a_segment_begins(
    fusion: Early2D | Late2D, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = list[str]()
    monkeypatch.setattr(fusion._fusion._reliability, "reset", lambda: calls.append("reset"))
    fusion.reset("segment 1 begins")
    assert calls == ["reset"]


def test_a_network_that_detects_in_space_needs_grouping_there():
    lidar = LidarParams(detector="learned")
    with pytest.raises(ConfigError, match=r"lidar\.detector=learned: .* lidar_image\.grouping=space"):
        Lidar2D(Lidar2DParams(lidar=lidar)).start(rig(*ALL), SIMULATED_LOG)
    Lidar2D(Lidar2DParams(lidar=lidar)).start(rig(*ALL), LOG)
    Lidar2D(Lidar2DParams(lidar=lidar, lidar_image=LidarImageParams(grouping="space"))).start(rig(*ALL), SIMULATED_LOG)
