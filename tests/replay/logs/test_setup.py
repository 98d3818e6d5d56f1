"""What a user says about the topics of a log goes before what the log says."""

from dataclasses import replace

import numpy as np
import pytest

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.data.metadata import Outline
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.convert.run import ConvertRequest, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.coordinate_frames import Edge
from fbench.replay.logs.open import open_container, open_log
from fbench.replay.logs.rig_patch import RigPatch
from fbench.replay.logs.setup import SensorSetup, Setup

UPRIGHT = np.array([0.0, 0, 0, 1])
TURNED = np.array([0.0, 0, np.sqrt(0.5), np.sqrt(0.5)])
CAMERA = CameraModel(np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]]), (80, 60))
XYZ = np.array([[10.0, 0, 0], [12, 1, 0]], np.float32)


@pytest.fixture(params=["mcap", "parquet"])
def log(request, tmp_path):
    """A LiDAR, two radars, a camera and truth, in both of our own forms."""
    names = {"lidar": "lidar", "radar_a": "radar", "radar_b": "radar", "camera": "camera"}
    mounts = {name: Mount(kind, np.array([float(i), 0, 1]), UPRIGHT) for i, (name, kind) in enumerate(names.items())}
    path = tmp_path / "own.mcap"
    info = LogInfo("own", "id", {"radar.radar_a.velocity_period_mps": "7"})
    with McapWriter(path, info, Rig(mounts, {"camera": CAMERA})) as writer:
        for stamp in (10**9, 2 * 10**9):
            writer.write(Image("camera", stamp, stamp, encode_jpeg(np.zeros((60, 80, 3), np.uint8)), "jpeg", (80, 60)))
            writer.write(PointCloud("lidar", stamp, stamp, XYZ))
            for name in ("radar_a", "radar_b"):
                writer.write(RadarScan(name, stamp, stamp, XYZ, np.array([1.5, -2.0], np.float32)))
            car, auto = np.array(["car"]), np.array(["Auto"])
            place = np.array([[10.0, 0, 0]])
            boxes = Boxes3D(place, np.ones((1, 3)), np.zeros(1), label=car, source_label=auto)
            flat = Boxes2D(np.array(["camera"]), np.array([[1.0, 2, 3, 4]]), label=np.array(["car"]))
            writer.write(Truth(stamp, stamp, boxes, flat))
    if request.param == "mcap":
        return path
    target = tmp_path / "own.parquet"
    convert(open_container(path, FaultLog()), Target(target), ConvertRequest())
    return target


def topic(log, sensor):
    reader = open_log(log, FaultLog())
    return next(role.topic for role in reader.roles.values() if role.sensor == sensor and role.kind != "calibration")


def setup(log, **changes):
    sensors = {
        "top": SensorSetup(topic(log, "lidar"), "lidar"),
        "front": SensorSetup(topic(log, "radar_a"), "radar", doppler="approaching", ego_motion="removed"),
    }
    return Setup(sensors=sensors, source="fbench.toml", **changes)


def test_named_sensors_and_no_others_are_read(log):
    reader = open_log(log, FaultLog(), (), setup(log))
    assert sorted(reader.rig.mounts) == ["front", "top"]
    assert sorted({m.sensor for m in reader.messages()}) == ["front", "top"]
    assert dict(reader.num_messages) == {"front": 2, "top": 2}
    plain = open_log(log, FaultLog()).rig
    assert reader.rig.mounts["top"].equals(plain.mounts["lidar"])
    assert reader.rig.mounts["front"].equals(plain.mounts["radar_a"])


def test_a_renamed_camera_keeps_its_calibration(log):
    only = Setup(sensors={"eye": SensorSetup(topic(log, "camera"), "camera")})
    reader = open_log(log, FaultLog(), (), only)
    assert list(reader.rig.cameras) == ["eye"]
    assert reader.rig.cameras["eye"].equals(CAMERA)


def test_signs_are_turned_and_facts_told(log):
    reader = open_log(log, FaultLog(), (), setup(log))
    scans = [m for m in reader.messages() if isinstance(m, RadarScan)]
    np.testing.assert_array_equal(scans[0].radial_velocity_mps, [-1.5, 2.0])
    assert reader.info.metadata["radar.front.ego_motion"] == "removed"
    period = replace(setup(log).sensors["front"], velocity_period_mps=10.4)
    told = open_log(log, FaultLog(), (), Setup(sensors={"front": period})).info.metadata
    assert told["radar.front.velocity_period_mps"] == "10.4"


def test_the_outline_of_the_vehicle_is_told(log):
    info = open_log(log, FaultLog(), (), Setup(outline_m=(3.9, 1.0, 0.95))).info
    assert info.outline == Outline(3.9, 1.0, 0.95)


def test_what_fbench_wrote_about_a_renamed_radar_holds_for_its_new_name(log):
    told = open_log(log, FaultLog(), (), setup(log)).info.metadata
    assert told["radar.front.velocity_period_mps"] == "7"


def test_classes_get_the_labels_that_are_wanted(log):
    as_van = next(open_log(log, FaultLog(), (), Setup(classes={"Auto": "van"})).truths())
    assert as_van.boxes3d.label.tolist() == ["van"]
    ignored = next(open_log(log, FaultLog(), (), Setup(classes={"Auto": "ignore"})).truths())
    assert (ignored.boxes3d.label.tolist(), ignored.boxes3d.ignore.tolist()) == (["other"], [True])
    faults = FaultLog()
    assert next(open_log(log, faults).truths()).boxes3d.label.tolist() == ["car"]
    assert faults.counts["GT007"] == 0  # importers of fbench know what their classes mean


def test_calibration_from_elsewhere_goes_first(log):
    edge = Edge("body", np.array([5.0, 6, 7]), TURNED)
    patch = RigPatch({"lidar": edge}, {"camera": replace(CAMERA, size_wh=(40, 30))})
    reader = open_log(log, FaultLog(), (), Setup(rig=patch))
    plain = open_log(log, FaultLog()).rig
    np.testing.assert_array_equal(reader.rig.mounts["lidar"].translation_m, [5, 6, 7])
    np.testing.assert_array_equal(reader.rig.mounts["lidar"].rotation_xyzw, TURNED)
    assert reader.rig.cameras["camera"].size_wh == (40, 30)
    assert reader.rig.mounts["radar_a"].equals(plain.mounts["radar_a"])


def test_chains_are_composed_by_hand(log):
    mast = Edge("body", np.array([1.0, 0, 2]), TURNED)
    patch = RigPatch({"mast": mast, "top": Edge("mast", np.array([1.0, 0, 0]), UPRIGHT)})
    reader = open_log(log, FaultLog(), (), setup(log, rig=patch))
    np.testing.assert_allclose(reader.rig.mounts["top"].translation_m, [1, 1, 2], atol=1e-12)


def test_a_topic_finds_the_sensor_that_a_file_calls_otherwise(log):
    topics = {"cam0": topic(log, "lidar"), "cam1": topic(log, "camera")}
    patch = RigPatch({"cam1": Edge("cam0", np.array([0.5, 0, 0]), UPRIGHT)}, {}, topics)
    reader = open_log(log, FaultLog(), (), Setup(rig=patch))
    np.testing.assert_allclose(reader.rig.mounts["camera"].translation_m, [0.5, 0, 1])


def test_calibration_that_fits_nothing_is_refused(log):
    edge = Edge("body", np.zeros(3), UPRIGHT)
    with pytest.raises(ConfigError, match=r"rig\.urdf: names none of the log's sensors: camera \(frame 'camera'\)"):
        open_log(log, FaultLog(), (), Setup(rig=RigPatch({"velo": edge}, places={"velo": "rig.urdf"}))).rig  # noqa: B018
    two = RigPatch({}, {"front": CAMERA, "camera": CAMERA}, places={"front": "rig.toml"})
    with pytest.raises(ConfigError, match=r"rig\.toml: the log has no camera 'front'"):
        open_log(log, FaultLog(), (), Setup(rig=two)).rig  # noqa: B018


def test_a_file_about_one_camera_means_the_only_one(log):
    patch = RigPatch({}, {"narrow_stereo": replace(CAMERA, size_wh=(40, 30))})
    assert open_log(log, FaultLog(), (), Setup(rig=patch)).rig.cameras["camera"].size_wh == (40, 30)


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"a": SensorSetup("/nowhere", "lidar")}, "none of its topics is in own.* --config none"),
        ({n: SensorSetup(t, "lidar") for n, t in (("a", "/no"), ("b", "LIDAR"))}, "'a': the log has no topic '/no'"),
        ({n: SensorSetup("LIDAR", "lidar") for n in ("a", "b")}, "sensors 'a' and 'b' have one topic"),
        ({"a": SensorSetup("LIDAR", "camera")}, "holds lidar, not camera"),
        ({"a": SensorSetup("/truth/boxes", "lidar")}, "holds truth, not lidar"),
    ],
)  # fmt: skip
def test_sensors_that_dont_fit_are_refused(log, sensors, message):
    there = topic(log, "lidar")
    named = {n: replace(s, topic=there if s.topic == "LIDAR" else s.topic) for n, s in sensors.items()}
    with pytest.raises(ConfigError, match=message):
        open_log(log, FaultLog(), (), Setup(sensors=named, source="fbench.toml"))


def test_a_sensor_may_be_optional(log):
    sensors = {**setup(log).sensors, "rear": SensorSetup("/nowhere", "radar", optional=True)}
    assert sorted(open_log(log, FaultLog(), (), Setup(sensors=sensors)).rig.mounts) == ["front", "top"]


def test_boxes_are_truth_or_results_as_the_setup_says(log):
    results = Setup(truth_topics=(), source="fbench.toml")
    reader = open_log(log, FaultLog(), (), results)
    assert list(reader.truths()) == []
    assert [len(found.boxes3d) for found in reader.detections("/truth/boxes")] == [1, 1]
    with pytest.raises(
        ConfigError, match=r"truth\.topics: the log has no topic '/truth/box'; did you mean '/truth/boxes'"
    ):
        open_log(log, FaultLog(), (), Setup(truth_topics=("/truth/box",), source="fbench.toml"))
    with pytest.raises(ConfigError, match="both truth and results"):
        open_log(log, FaultLog(), (), Setup(truth_topics=("/a",), result_topics=("/a",), source="fbench.toml"))
    with pytest.raises(ConfigError, match="holds lidar"):
        open_log(log, FaultLog(), (), Setup(truth_topics=(topic(log, "lidar"),), source="fbench.toml"))


def test_results_must_be_named_where_there_are_several(log):
    reader = open_log(log, FaultLog(), (), Setup(truth_topics=()))
    with pytest.raises(LogError, match="which topic holds the results"):
        list(reader.detections(""))
    with pytest.raises(LogError, match="no topic '/tracks' with boxes"):
        list(reader.detections("/tracks"))


def test_our_own_logs_have_one_body(log):
    with pytest.raises(ConfigError, match=r"body\.frame: .* it is 'body'; if .* another log: --config none"):
        open_log(log, FaultLog(), (), Setup(body="radar_b", source="fbench.toml"))
