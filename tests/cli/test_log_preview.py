"""`fbench log preview`."""

import hashlib
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from tests.cli.conftest import FORWARD, MS, UPRIGHT, messages, rig, truths, write_log
from tests.replay.logs.codecs.ros.builders import cloud, structured
from tests.replay.setup import drive as d

from fbench.replay.data.messages import Image, PointCloud, Pose
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log


class Sheet(HTMLParser):
    """What a page shows."""

    def __init__(self, folder):
        super().__init__()
        self.tags, self.pictures, self.text = [], [], ""
        self.source = (folder / "index.html").read_text()
        self.feed(self.source)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.pictures.append(dict(attrs)["src"])

    def handle_data(self, data):
        self.text += data


def digests(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


@pytest.mark.slow
def test_a_preview_shows_all_sensors(fbench, log, tmp_path):
    result = fbench("log", "preview", log)
    assert result.code == 0, result.err
    folder = tmp_path / "car-preview"
    sheet = Sheet(folder)
    for text in ("camera", "lidar", "radar", "Instants by", "alignment", "doppler"):
        assert text in sheet.text
    assert sorted(sheet.pictures) == sorted(p.name for p in folder.glob("*.png"))
    assert {"000000-0-camera-lidar.png", "000000-0-camera-radar.png", "000000-above.png"} <= set(sheet.pictures)
    assert {"rig.png", "times.png", "doppler-2-radar.png", "edges-0-camera.png"} <= set(sheet.pictures)
    assert "script" not in sheet.tags
    assert "default-src 'none'" in sheet.source
    assert "http" not in sheet.source.replace("http-equiv", "")
    assert "preview: car-preview/index.html (6 frames" in result.out


@pytest.mark.slow
def test_radar_is_red_where_it_recedes(fbench, log, tmp_path):
    """The test's car recedes at 10 m/s, 10 m ahead in the first frame: u = 39.5 + 60 * 0.2 / 10, twelvefold."""
    fbench("log", "preview", log)
    picture = cv2.imread(str(tmp_path / "car-preview" / "000000-0-camera-radar.png"))
    v = 29.5 + 60 * 0.5 / 10  # the camera is at 1 m, the points at 0.5 m
    for y in (-0.2, 0.2):
        u = 39.5 - 60 * y / 10
        assert picture[round((v + 0.5) * 12 - 0.5), round((u + 0.5) * 12 - 0.5)].tolist() == [0, 0, 255]


@pytest.mark.slow
def test_equal_logs_give_equal_bytes(fbench, log, tmp_path):
    for name in ("a", "b"):
        assert fbench("log", "preview", log, "-o", name, "--num", 2).code == 0
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


@pytest.mark.slow
def test_an_existing_folder_is_kept(fbench, log, tmp_path):
    assert fbench("log", "preview", log, "--num", 1).code == 0
    before = digests(tmp_path / "car-preview")
    again = fbench("log", "preview", log)
    assert again.code == 2
    assert "car-preview: exists already" in again.err
    assert digests(tmp_path / "car-preview") == before
    assert fbench("log", "preview", log, "--num", 2, "--overwrite").code == 0
    assert digests(tmp_path / "car-preview") != before


def test_other_folders_are_never_overwritten(fbench, log, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.png").write_bytes(b"x")
    result = fbench("log", "preview", log, "-o", "photos", "--overwrite")
    assert result.code == 2
    assert "isn't a preview" in result.err
    assert (tmp_path / "photos" / "holiday.png").exists()


@pytest.mark.slow
def test_frames_can_be_chosen(fbench, log):
    content = fbench("log", "preview", log, "--frames", "2:5", "--num", 2, "--json").json()
    assert content["frames"] == [2, 4]
    assert {s["name"]: s["kind"] for s in content["sensors"]} == {
        "camera": "camera", "lidar": "lidar", "radar": "radar",
    }  # fmt: skip
    assert fbench("log", "preview", log, "--frames", "90:95", "-o", "x").code == 3
    assert fbench("log", "preview", log, "--reference", "lidr", "-o", "x").code == 2
    assert fbench("log", "preview", log, "--offset", "lidr=5", "-o", "x").code == 2


@pytest.mark.slow
def test_an_offset_is_seen(fbench, log, tmp_path):
    plain = fbench("log", "preview", log, "-o", "plain", "--json").json()
    moved = fbench("log", "preview", log, "-o", "moved", "--offset", "lidar=200", "--json").json()
    assert not [v for v in plain["verdicts"] if v["what"] == "time"]
    (verdict,) = [v for v in moved["verdicts"] if v["what"] == "time"]
    assert "before its own stamp" in verdict["text"]
    assert digests(tmp_path / "plain")["times.png"] != digests(tmp_path / "moved")["times.png"]
    # the car is 2 m farther in the images that now go with the LiDAR's frames
    assert digests(tmp_path / "plain")["000000-above.png"] != digests(tmp_path / "moved")["000000-above.png"]


@pytest.mark.slow
def test_a_wrong_sign_is_told(fbench, tmp_path):
    azimuth = np.radians(np.linspace(-50, 50, 101))
    xyz = np.stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), 0 * azimuth], axis=1).astype(np.float32)

    def driven(sign):
        for m in messages(camera=False):
            yield replace(m, xyz=xyz, radial_velocity_mps=(-9 * sign * np.cos(azimuth)).astype(np.float32),
                          rcs_dbsm=None) if m.sensor == "radar" else m  # fmt: skip

    for name, sign in (("right", 1), ("wrong", -1)):
        write_log(tmp_path / f"{name}.mcap", driven(sign), rig(camera=False))
    right = fbench("log", "preview", "right.mcap", "--json").json()
    wrong = fbench("log", "preview", "wrong.mcap", "--json").json()
    assert [v["is_bad"] for v in right["verdicts"] if v["what"] == "doppler"] == [False]
    assert [v["is_bad"] for v in wrong["verdicts"] if v["what"] == "doppler"] == [True]


@pytest.mark.parametrize("num_clear", [1, 20])
def test_init_and_preview_agree_about_the_motion_of_a_radar(fbench, tmp_path, num_clear):
    """A radar that sees noise in all scans but the first ones, which stand still while poses say that it drives."""
    log, rng = d.Drive(), np.random.Generator(np.random.Philox(7))
    log.add("/tf_static", d.START_NS, d.transforms([("base_link", "radar", (0, 0, 0.5), (0, 0, 0, 1))]))
    azimuth = np.linspace(-0.8, 0.8, 60)
    for i, ns in d.steps(20, 100):
        noise = rng.uniform(-25, 25, 60) if i >= num_clear else np.zeros(60)
        rows = structured(x=(20 * np.cos(azimuth)).astype("f4"), y=(20 * np.sin(azimuth)).astype("f4"),
                          z=np.zeros(60, "f4"), velocity=noise.astype("f4"))  # fmt: skip
        log.add("/radar/points", ns + 5 * d.MS, cloud(d.ROS, rows, frame_id="radar", stamp=d.stamp(ns)))
        for part in range(4):
            at = ns + part * 25 * d.MS
            log.add("/odom", at, d.odometry(at, 10.0 * (at - d.START_NS) / 1e9))
    path = log.write(tmp_path / "log.mcap")
    assert fbench("init", path).code == 0
    said = (tmp_path / "fbench.toml").read_text().partition("ego_motion = ")[2].partition("\n")[0]
    preview = fbench("log", "preview", path, "-o", "sheet", "--frames", "0:20", "--json").json()
    (verdict,) = [v["text"] for v in preview["verdicts"] if v["what"] == "doppler"]
    if num_clear == 1:
        assert said.startswith('"included"  # guess: unknown, none of 20 scans shows a motion clearly; set "removed"')
        assert verdict.startswith("no speed of the vehicle explains the points")
    else:
        assert said == '"removed"  # 20 of 20 scans show no motion while other sensors say that the vehicle moves'
        assert verdict.startswith("the vehicle's own motion is removed, as said")


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        (("lidar",), ["no camera", "no radar", "no frame has truth"]),
        (("camera",), ["no LiDAR", "no radar"]),
        (("radar",), ["no camera", "no LiDAR"]),
    ],
)
def test_what_is_missing_is_said(fbench, tmp_path, kept, said):
    whole = rig()
    part = whole.without([name for name in whole.mounts if name not in kept])
    write_log(tmp_path / "part.mcap", [m for m in messages() if m.sensor in kept], part)
    result = fbench("log", "preview", "part.mcap", "--json")
    assert result.code == 0, result.err
    for text in said:
        assert any(text in gap for gap in result.json()["gaps"])
    assert result.json()["pictures"]


def test_sensors_without_calibration_are_shown_on_their_own(fbench, tmp_path, foreign_log):
    """A LiDAR without transform and a camera without intrinsics still have pictures."""
    result = fbench("log", "preview", foreign_log, "--json")
    assert result.code == 0, result.err
    files = {p["file"] for p in result.json()["pictures"]}
    assert any(name.endswith("-own.png") for name in files)
    assert any("cam" in name and name.startswith("000000") for name in files)
    assert len([gap for gap in result.json()["gaps"] if "is shown on its own" in gap]) == 2


@pytest.fixture
def foreign_log(tmp_path):
    """A log whose transforms and calibrations were lost: only messages are kept of what was written."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    source = write_log(
        tmp_path / "source.mcap", [m for m in messages() if m.sensor != "radar"], rig().without(["radar"])
    )
    out = tmp_path / "lost.mcap"
    with source.open("rb") as file, out.open("wb") as target:
        writer, channels = Writer(target), {}
        writer.start()
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic == "/tf" or channel.topic.endswith("calibration"):
                continue
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, dict(channel.metadata)
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return out


@pytest.mark.slow
def test_hostile_names_are_only_text(fbench, tmp_path):
    name = "<script>alert(1)</script>/../../x"
    hostile = Rig({name: Mount("lidar", np.zeros(3), UPRIGHT), "cam\x1b[31m": Mount("camera", np.zeros(3), FORWARD)},
                  {"cam\x1b[31m": rig().cameras["camera"]})  # fmt: skip
    items = [replace(m, sensor=name if m.sensor == "lidar" else "cam\x1b[31m") for m in messages()
             if m.sensor in ("lidar", "camera")]  # fmt: skip
    write_log(tmp_path / "hostile.mcap", items, hostile)
    result = fbench("log", "preview", "hostile.mcap")
    assert result.code == 0, result.err
    folder = tmp_path / "hostile-preview"
    sheet = Sheet(folder)
    assert "script" not in sheet.tags
    assert "<script>alert(1)</script>" in sheet.text  # as text
    assert "\x1b" not in sheet.source
    assert all(p.parent == folder for p in folder.rglob("*"))
    assert {p for p in sheet.pictures if "/" in p} == set()


@pytest.mark.slow
def test_poses_are_among_the_times(fbench, tmp_path):
    poses = [Pose("gps", s, s, np.array([10.0 * i, 0, 0]), UPRIGHT)
             for i, s in enumerate(range(1_000_000_000, 1_600_000_000, 100 * MS))]  # fmt: skip
    write_log(tmp_path / "posed.mcap", [*messages(), *poses, *truths()])
    content = fbench("log", "preview", "posed.mcap", "--json").json()
    assert {"name": "gps", "kind": "pose"}.items() <= next(s for s in content["sensors"] if s["name"] == "gps").items()


def test_a_folder_that_cannot_be_written_is_named(fbench, log, tmp_path):
    (tmp_path / "file").write_text("x")
    result = fbench("log", "preview", log, "-o", "file/below")
    assert result.code == 2
    assert "can't be written" in result.err


def test_nothing_is_left_behind_by_a_failure(fbench, tmp_path):
    (tmp_path / "bad.mcap").write_bytes(b"not a log")
    assert fbench("log", "preview", "bad.mcap").code == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.mcap"]


def turned(log, out, yaw_deg):
    """Write a log again with its LiDAR's extrinsics turned."""
    from scipy.spatial.transform import Rotation

    from fbench.replay.contracts.faults import FaultLog

    reader = open_log(log, FaultLog())
    (name,) = reader.rig.sensors("lidar")
    old = reader.rig.mounts[name]
    rotation = Rotation.from_euler("z", yaw_deg, degrees=True) * Rotation.from_quat(old.rotation_xyzw)
    wrong = Rig({**reader.rig.mounts, name: replace(old, rotation_xyzw=rotation.as_quat())}, reader.rig.cameras)
    with McapWriter(out, LogInfo(out.stem, "turned", reader.info.metadata), wrong) as writer:
        for message in reader.messages():
            if isinstance(message, PointCloud | Image):
                writer.write(message)
    return out


def alignment(fbench, log, out):
    content = fbench("log", "preview", log, "-o", out, "--num", 4, "--json").json()
    return next(v for v in content["verdicts"] if v["what"] == "alignment")


@pytest.mark.slow
def test_a_wrong_extrinsic_changes_the_verdict_on_a_real_drive(fbench, shared, tmp_path):
    real = shared / "data/mcap/kitti_raw_12frames_ros2.mcap"
    assert not alignment(fbench, real, "right")["is_bad"]
    found = alignment(fbench, turned(real, tmp_path / "turned.mcap", 3.0), "wrong")
    assert found["is_bad"]
    assert "turned by +3.0 deg about the camera's y axis" in found["text"] or "turned by +2.5 deg" in found["text"]
