"""Images without any calibration: camera2d works from end to end, others say what is missing."""

import pytest
from tests.pipelines.conftest import constant_model, one_car  # noqa: F401 - fixtures
from tests.replay.setup import drive as d

NUM = 12


def images(path, **sensors):
    """Images of one camera at 10 Hz, without calibration or transforms; `lidar`: whether a LiDAR has its place."""
    log = d.Drive()
    if "lidar" in sensors:
        edges = [("base_link", "lidar", (0, 0, 1.8), (0, 0, 0, 1))]
        log.add(
            "/tf_static", d.START_NS, d.transforms(edges if sensors["lidar"] else [("base_link", "imu", *edges[0][2:])])
        )
    for _, ns in d.steps(NUM, 100):
        log.add("/camera/image_raw/compressed", ns + 5 * d.MS, d.jpeg("optical", ns))
        if "lidar" in sensors:
            log.add("/lidar/points", ns + 8 * d.MS, d.points("lidar", ns))
    return log.write(path)


@pytest.fixture
def labels(tmp_path):
    rows = [f"{i},optical,9.5,19.5,49.5,59.5,car,4\n" for i in range(NUM)]
    path = tmp_path / "labels.csv"
    path.write_text("".join(["frame,camera,left,top,right,bottom,label,track_id\n", *rows]))
    return path


def test_camera2d_from_end_to_end(fbench, tmp_path, labels, one_car):  # noqa: F811
    log, weights = images(tmp_path / "drive.mcap"), ("--set", f"camera.weights={one_car}")
    result = fbench("replay", log, "-p", "camera2d", *weights, "--truth", labels, "-o", "run", "--report", "--json")
    assert result.code == 0, result.err
    rows = {row["metric"]: row for row in result.json()["scores"] if (row["class"], row["slice"]) == ("vehicle", "all")}
    assert (rows["f1"]["value"], rows["mota"]["value"]) == (1.0, 1.0)
    assert rows["f1"]["matching"] == "iou 0.5"
    manifest = result.json()["manifest"]
    assert (manifest["mounts"], manifest["cameras"], manifest["images"]) == ({}, {}, {"optical": [80, 60]})
    assert '"optical":[80,60]' in (tmp_path / "run/report.html").read_text().replace(" ", "")
    assert fbench("score", "run").code == 0
    for profile in ("coco", "motmetrics"):
        assert fbench("score", "run", "--profile", profile).code == 0
    assert fbench("log", "preview", log).code == 0
    assert fbench("log", "info", log).code == 0
    assert fbench("replay", log, "-p", "camera2d", *weights, "-o", "bare").code == 0
    assert "no truth" in fbench("score", "bare").err


@pytest.mark.slow
def test_replays_of_images_alone_are_equal(fbench, tmp_path, one_car, circumstances):  # noqa: F811
    circumstances("2 threads")
    log = images(tmp_path / "drive.mcap")
    result = fbench("verify", log, "-p", "camera2d", "--set", f"camera.weights={one_car}", "--quick")
    assert result.code == 0, result.out + result.err


def test_a_converted_log_still_says_that_nothing_is_known(fbench, tmp_path, one_car):  # noqa: F811
    log = images(tmp_path / "drive.mcap")
    for name in ("own.mcap", "own.parquet"):
        assert fbench("log", "convert", log, "-o", name, "--decode").code == 0
        result = fbench("replay", name, "-p", "camera2d", "--set", f"camera.weights={one_car}", "-o", f"run-{name}")
        assert result.code == 0, result.err
        said = fbench("replay", name, "-p", "lidar3d")
        assert said.err == "fbench: log 'own': lidar3d needs a LiDAR; the log has: camera optical [CFG001]\n"


OTHERS = {
    "lidar2d": "lidar2d can't project into camera 'optical': no transform places it on the body; add it with --rig",
    "late2d": "late2d can't project into camera 'optical': no transform places it on the body; add it with --rig",
    "stereo3d": "a stereo pair needs two cameras of one size with calibration",
    "radar3d": "radar3d needs a radar; the log has: lidar lidar, camera optical",
}


@pytest.mark.parametrize(("pipeline", "line"), OTHERS.items())
def test_others_say_what_is_missing(fbench, tmp_path, pipeline, line):
    result = fbench("replay", images(tmp_path / "drive.mcap", lidar=True), "-p", pipeline)
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert line in result.err


def test_fusions_need_calibration_where_they_use_images(fbench, tmp_path, one_car):  # noqa: F811
    log = images(tmp_path / "drive.mcap", lidar=True)
    for pipeline in ("late3d", "early3d"):
        used = fbench("replay", log, "-p", pipeline, "--set", f"camera.weights={one_car}")
        line = "fbench: camera 'optical' has no transform to the body; add it with --rig [CAL001]\n"
        assert (used.code, used.err) == (3, line)
        assert fbench("replay", log, "-p", pipeline, "-o", f"run-{pipeline}").code == 0
    assert fbench("replay", log, "-p", "lidar3d", "-o", "lidar").code == 0


def test_points_without_a_place_are_an_error_as_ever(fbench, tmp_path):
    result = fbench("replay", images(tmp_path / "drive.mcap", lidar=False), "-p", "lidar3d")
    assert result.code == 3
    assert "sensor 'lidar' has no transform to the body" in result.err
