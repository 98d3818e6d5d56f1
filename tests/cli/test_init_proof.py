"""`fbench init` tries what it writes: the file works at once, or says why not."""

import tomllib
from dataclasses import dataclass, field

import pytest
from tests.pipelines.conftest import constant_model, one_car  # noqa: F401 - fixtures
from tests.replay.setup import drive as d

from fbench.replay.setup.configuration import Config

UPTIME = 5_000 * 1000 * d.MS
S = 1000 * d.MS
HERE = (0, 0, 1.8), (0, 0, 0, 1)


def moving(ns):
    return (ns - d.START_NS) / 1e9 * 8.0


def lidar(log, num=30, topic="/lidar/points", frame="lidar", shift=0, delay=10 * d.MS):
    for i, ns in d.steps(num, 100):
        log.add(topic, ns + delay, d.points(frame, max(0, ns + shift), 200 + i))


def radar(log, num=30, shift=0, frame="radar", delay=15 * d.MS):
    for _, ns in d.steps(num, 100):
        log.add("/radar/points", ns + delay, d.radar_points(frame, ns + shift, 8.0))


def odometry(log, topic="/odom", num=150, shift=0, step_ms=20):
    for _, ns in d.steps(num, step_ms):
        log.add(topic, ns + 1 * d.MS, d.odometry(ns + shift, moving(ns)))


def transforms(log, *edges):
    log.add("/tf_static", d.START_NS, d.transforms([(*edge, *HERE) for edge in edges]))


def made(*parts):
    log = d.Drive()
    for part in parts:
        part(log)
    return log


@dataclass(frozen=True)
class Shape:
    """A log, and what its file must be."""

    log: d.Drive
    pipelines: tuple[str, ...] = ("lidar3d",)
    sensors: tuple[str, ...] = ("lidar",)
    pose: str = ""
    said: tuple[str, ...] = ()
    offsets_ms: dict[str, float] = field(default_factory=dict)


BASE = ("base_link", "lidar"), ("base_link", "radar")
SHAPES = {
    "a LiDAR alone": Shape(made(lidar), said=("sensor 'lidar' is assumed at the body's origin",)),
    "a LiDAR that names no frame": Shape(
        made(lambda log: lidar(log, frame="")),
        said=('frame = "lidar"  # guess: its messages name no coordinate frame',),
    ),
    "two LiDARs that name no frame": Shape(
        made(lambda log: lidar(log, frame=""), lambda log: lidar(log, topic="/rear/lidar/points", frame="")),
        said=("Left out: sensor 'rear_lidar' has no transform to the body",),
    ),
    "a radar alone": Shape(made(radar), ("radar3d",), ("radar",), said=("sensor 'radar' is assumed at the body's",)),
    "poses of another clock": Shape(
        made(lidar, lambda log: odometry(log, shift=UPTIME - d.START_NS), lambda log: transforms(log, BASE[0])),
        said=('# pose = "/odom"  # left out: ',),
    ),
    "poses of another clock, and good ones": Shape(
        made(
            lidar, lambda log: odometry(log, shift=UPTIME - d.START_NS, num=300, step_ms=10),
            lambda log: odometry(log, topic="/good/odom"), lambda log: transforms(log, BASE[0]),
        ),
        pose="/good/odom", said=('# pose = "/odom"  # left out: ', "took /good/odom"),
    ),
    "poses that end at once": Shape(
        made(lidar, lambda log: odometry(log, num=10), lambda log: transforms(log, BASE[0])),
        said=("its stamps don't cover those of the sensors",),
    ),
    "poses that go on": Shape(made(lidar, odometry, lambda log: transforms(log, BASE[0])), pose="/odom"),
    "truth in a frame that nothing links": Shape(
        made(lidar, lambda log: [log.add("/truth", ns, d.boxes(ns, ["car"], "nowhere")) for _, ns in d.steps(30, 100)]),
        said=("/truth: boxes in 'nowhere', which no fixed transform links to 'lidar'",),
    ),
    "transforms in two parts": Shape(
        made(lidar, radar, lambda log: transforms(log, BASE[0], ("mast", "radar"))),
        said=("Left out: sensor 'radar' has no transform to the body",),
    ),
    "a radar with uptime for stamps": Shape(
        made(lidar, lambda log: radar(log, shift=UPTIME - d.START_NS), lambda log: transforms(log, *BASE)),
        ("lidar3d", "radar3d", "late3d"), ("lidar", "radar"),
    ),
    "a radar whose clock is 7 s behind": Shape(
        made(lidar, lambda log: radar(log, shift=-7 * S), lambda log: transforms(log, *BASE)),
        ("lidar3d", "radar3d", "late3d"), ("lidar", "radar"), said=("estimated from recording times",),
    ),
    "a radar that is 1.5 s late": Shape(
        made(lidar, lambda log: radar(log, delay=1500 * d.MS), lambda log: transforms(log, *BASE)),
        ("lidar3d", "radar3d"), ("lidar", "radar"), said=("timeout_ms = ",),
    ),
    "uptime for all stamps": Shape(
        made(
            lambda log: lidar(log, shift=UPTIME - d.START_NS), lambda log: odometry(log, shift=UPTIME - d.START_NS),
            lambda log: transforms(log, BASE[0]),
        ),
        pose="/odom",
    ),
    "no stamps": Shape(made(lambda log: lidar(log, shift=-d.START_NS * 2), lambda log: transforms(log, BASE[0]))),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_the_file_works_at_once(fbench, tmp_path, shape):
    log = shape.log.write(tmp_path / "drive.mcap")
    result = fbench("init", log)
    assert result.code == 0, result.out + result.err
    text = (tmp_path / "fbench.toml").read_text()
    config = Config.model_validate(tomllib.loads(text))
    assert (tuple(sorted(config.sensors)), config.body.pose) == (tuple(sorted(shape.sensors)), shape.pose)
    for line in shape.said:
        assert line in text
    ready = next(line for line in text.splitlines() if line.startswith("# Pipelines that can start: "))
    for pipeline in shape.pipelines:
        assert pipeline in ready
        run = fbench("replay", log, "-p", pipeline, "-o", f"run-{pipeline}")
        assert run.code == 0, run.out + run.err


def test_what_cannot_start_says_why(fbench, tmp_path):
    log = SHAPES["a LiDAR alone"].log.write(tmp_path / "drive.mcap")
    content = fbench("init", log, "--json").json()["proof"]
    assert (content["failure"], content["remarks"]) == ("", [])
    assert fbench("init", log, "--overwrite").out.splitlines()[-1] == "look at the guess in line 12"
    assert content["frames"] == "read 30 frames by lidar"
    for pipeline, why in content["pipelines"].items():
        run = fbench("replay", log, "-p", pipeline, "-o", f"run-{pipeline}")
        assert (run.code == 0) == (not why)
        assert why in run.err


def test_a_log_that_cannot_be_replayed_yet(fbench, tmp_path):
    log = made(lambda log: lidar(log, frame="a"), lambda log: transforms(log, ("b", "c"))).write(
        tmp_path / "drive.mcap"
    )
    result = fbench("init", log)
    assert (result.code, result.err.count("\n")) in ((0, 0), (1, 1))
    assert (tmp_path / "fbench.toml").is_file()


def test_a_calibrated_camera_without_a_place_is_used_alone(fbench, tmp_path, one_car):  # noqa: F811
    log = d.Drive()
    for _, ns in d.steps(12, 100):
        log.add("/camera/camera_info", ns, d.info("optical", ns))
        log.add("/camera/image_raw/compressed", ns + 5 * d.MS, d.jpeg("optical", ns))
    path = log.write(tmp_path / "drive.mcap")
    said = fbench("init", path)
    assert said.code == 0
    text = (tmp_path / "fbench.toml").read_text()
    assert "Left out" not in text
    assert "no guesses" in said.out
    assert "# Its images are used alone, by camera2d: sensor 'camera' has no transform to the body" in text
    assert Config.model_validate(tomllib.loads(text)).sensors["camera"].calibration == "/camera/camera_info"
    run = fbench("replay", path, "-p", "camera2d", "--set", f"camera.weights={one_car}", "-o", "run")
    assert (run.code, run.err) == (0, "")
    assert "found: 24 detections" in run.out
