"""Logs of other writers with Foxglove schemas, and fbench's logs in other readers."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField as Field
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from tests.replay.logs import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.logs.partial_rig import partial_rig

HALF = 2**-0.5
JPEG = encode_jpeg(np.zeros((6, 8, 3), np.uint8))
K = [500.0, 0, 4, 0, 500, 3, 0, 0, 1]


def log(tmp_path, *items):
    """Write (topic, message) pairs one nanosecond apart, as another program would."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as file, Writer(file) as writer:
        for i, (topic, message) in enumerate(items):
            writer.write_message(topic, message, log_time=i, publish_time=i)
    return b.read(path)


def packed(dtype, rows, frame="lidar", **more):
    types = {"u1": Field.UINT8, "u2": Field.UINT16, "u4": Field.UINT32, "f4": Field.FLOAT32, "f8": Field.FLOAT64}
    dtype = np.dtype(dtype)
    proto = CloudProto(frame_id=frame, point_stride=dtype.itemsize, data=np.array(rows, dtype).tobytes(), **more)
    for name in dtype.names:
        kind, offset = dtype.fields[name][:2]
        proto.fields.add(name=name, offset=offset, type=types[kind.str[1:]])
    return proto


def edge(parent, child, xyz=(0, 0, 0), xyzw=(0, 0, 0, 1)):
    x, y, z, w = xyzw
    return FrameTransform(
        parent_frame_id=parent, child_frame_id=child, translation=Vector3(x=xyz[0], y=xyz[1], z=xyz[2]),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )  # fmt: skip


def calibration(frame="cam"):
    return CameraCalibration(frame_id=frame, width=8, height=6, K=K, distortion_model="plumb_bob", D=[0.1, 0.2])


def test_points_of_any_type_order_and_offset(tmp_path):
    dtype = {
        "names": ["z", "ring", "x", "y", "intensity"], "formats": ["<f8", "<u1", "<f4", "<f4", "<u2"],
        "offsets": [0, 8, 12, 16, 20], "itemsize": 24,
    }  # fmt: skip
    reader, faults = log(tmp_path, ("/points", packed(dtype, [(3, 7, 1, 2, 500), (6, 8, 4, 5, 1000)])))
    [cloud] = reader.messages()
    assert isinstance(cloud, PointCloud)
    assert cloud.sensor == "lidar"
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.intensity.tolist() == [500, 1000]
    assert cloud.ring.tolist() == [7, 8]
    assert cloud.offset_ns is None
    assert not faults.counts


def test_pose_of_the_cloud_is_applied(tmp_path):
    pose = PoseProto(position=Vector3(x=1), orientation=Quaternion(z=HALF, w=HALF))
    xyz = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    reader, _ = log(tmp_path, ("/points", packed(xyz, [(2, 0, 5)], pose=pose)))
    [cloud] = reader.messages()
    assert cloud.xyz == pytest.approx(np.array([[1, 2, 5]]))


def test_planar_scan(tmp_path):
    pose = PoseProto(position=Vector3(x=1), orientation=Quaternion(z=HALF, w=HALF))
    scan = LaserScan(
        timestamp=Timestamp(seconds=3), frame_id="laser", pose=pose, start_angle=-np.pi / 2, end_angle=np.pi / 2,
        ranges=[2, 0, np.inf, 3], intensities=[5, 6, 7, 8],
    )  # fmt: skip
    reader, faults = log(tmp_path, ("/scan", scan))
    [cloud] = reader.messages()
    assert isinstance(cloud, PointCloud)
    assert (cloud.sensor, cloud.stamp_ns) == ("laser", 3_000_000_000)
    assert cloud.xyz == pytest.approx(np.array([[3, 0, 0], [-2, 0, 0]]), abs=1e-6)
    assert cloud.intensity.tolist() == [5, 8]
    assert not faults.counts


@pytest.mark.parametrize("name", ["velocity", "doppler"])
def test_cloud_with_velocities_is_a_radar_scan(tmp_path, name):
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, "<f4"), ("rcs", "<f4")]
    reader, _ = log(tmp_path, ("/points", packed(dtype, [(1, 2, 3, -4, 10)], "front")))
    [scan] = reader.messages()
    assert isinstance(scan, RadarScan)
    assert scan.radial_velocity_mps.tolist() == [-4]
    assert scan.rcs_dbsm.tolist() == [10]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"point_stride": 0}, "points of 0 bytes"),
        ({"point_stride": 5}, "12 bytes aren't a multiple of the point stride 5"),
        ({"point_stride": 6}, "field 'z' lies outside the points of 6 bytes"),
    ],
)
def test_broken_clouds_are_counted(tmp_path, change, text):
    proto = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    for field, value in change.items():
        setattr(proto, field, value)
    reader, faults = log(tmp_path, ("/points", proto))
    assert list(reader.messages()) == []
    assert faults.places["DEC003"] == [f"log.mcap: /points at 0: {text}"]


def test_images(tmp_path):
    padded = RawImage(frame_id="raw", width=1, height=2, encoding="8UC3", step=4, data=bytes(range(8)))
    compressed = CompressedImage(timestamp=Timestamp(seconds=2, nanos=5), frame_id="cam", data=JPEG, format="jpg")
    reader, _ = log(tmp_path, ("/b", padded), ("/a", compressed))
    raw, jpeg = reader.messages()
    assert isinstance(raw, Image)
    assert (raw.sensor, raw.encoding, raw.size_wh, raw.data) == ("raw", "bgr8", (1, 2), bytes([0, 1, 2, 4, 5, 6]))
    assert raw.stamp_ns == 0  # no stamp of its own: the container's
    assert (jpeg.sensor, jpeg.encoding, jpeg.size_wh, jpeg.stamp_ns) == ("cam", "jpeg", (8, 6), 2_000_000_005)


def test_image_with_a_damaged_header_is_counted(tmp_path):
    reader, faults = log(tmp_path, ("/a", CompressedImage(frame_id="cam", data=b"junk", format="jpeg")))
    assert list(reader.messages()) == []
    assert faults.places["DEC001"] == ["log.mcap: /a at 0: neither a JPEG nor a PNG nor a WebP image"]


def test_topics_that_share_a_coordinate_frame_are_told_apart(tmp_path):
    image = CompressedImage(frame_id="cam", data=JPEG, format="jpeg")
    reader, _ = log(tmp_path, ("/cam/raw", image), ("/cam/rectified", image))
    assert [m.sensor for m in reader.messages()] == ["cam/raw", "cam/rectified"]


def test_rig_from_a_chain_of_transforms(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    turn = (0, 0, HALF, HALF)
    transforms = FrameTransforms(transforms=[edge("mast", "lidar", (1, 0, 0)), edge("odom", "base_link", (9, 9, 9))])
    reader, _ = log(
        tmp_path, ("/points", cloud), ("/tf_static", transforms), ("/tf", edge("base_link", "mast", (0, 0, 2), turn)),
        ("/cam/image", CompressedImage(frame_id="cam_optical", data=JPEG, format="jpeg")),
        ("/cam/info", calibration("other")), ("/tf", edge("base_link", "cam_optical", (1 / 3, 0, 1))),
    )  # fmt: skip
    rig = reader.rig
    assert rig.mounts["lidar"].translation_m == pytest.approx(np.array([0, 1, 2]))
    assert rig.mounts["lidar"].rotation_xyzw == pytest.approx(np.array(turn))
    assert rig.mounts["cam_optical"].translation_m.tolist() == [1 / 3, 0, 1]
    camera = rig.cameras["cam_optical"]
    assert (camera.size_wh, camera.distortion_model, camera.distortion.tolist()) == ((8, 6), "plumb_bob", [0.1, 0.2])
    assert camera.K.ravel().tolist() == K


def test_root_of_the_tree_is_the_body_where_none_is_named(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    reader, _ = log(tmp_path, ("/points", cloud), ("/tf", edge("car", "lidar", (1, 2, 3))))
    assert reader.rig.mounts["lidar"].translation_m.tolist() == [1, 2, 3]


def test_incomplete_rigs_name_the_sensor(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    reader, _ = log(tmp_path, ("/points", cloud), ("/tf", edge("body", "other")))
    with pytest.raises(LogError, match=r"sensor 'lidar' has no transform to the body .*--topics '!lidar'$"):
        _ = reader.rig
    reader, _ = log(
        tmp_path, ("/points", cloud), ("/tf", edge("a", "lidar", (0, 0, 0), (0, 0, 0, 0))), ("/tf", edge("body", "a"))
    )
    with pytest.raises(LogError, match=r"sensor 'lidar': transform of 'lidar' has no valid rotation"):
        _ = reader.rig


def test_cameras_without_calibration_give_images_alone(tmp_path):
    image = CompressedImage(frame_id="cam", data=JPEG, format="jpeg")
    placed, _ = log(tmp_path, ("/image", image), ("/tf", edge("body", "cam")))
    assert (list(placed.rig.mounts), placed.rig.cameras, placed.rig.bare) == (["cam"], {}, frozenset())
    assert partial_rig(placed).problems["cam"].startswith("camera 'cam' has no calibration (CameraCalibration or")
    damaged, faults = log(
        tmp_path, ("/image", image), ("/tf", edge("body", "cam")), ("/k", CameraCalibration(frame_id="cam"))
    )
    assert (damaged.rig.sensors("camera"), damaged.rig.cameras) == (("cam",), {})
    assert faults.places["DEC001"] == ["log.mcap: /k at 2: camera 'cam' isn't calibrated (K has 0 values)"]
    calibration = CameraCalibration(frame_id="cam", width=8, height=6, K=K)
    alone, _ = log(tmp_path, ("/image", image), ("/k", calibration))
    assert (alone.rig.mounts, alone.rig.cameras, alone.rig.bare) == ({}, {}, frozenset({"cam"}))
    assert alone.rig.kinds == {"cam": "camera"}
    assert partial_rig(alone).problems["cam"].startswith("sensor 'cam' has no transform to the body")


def test_cameras_of_other_trees_do_not_keep_sensors_from_the_body(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    image = CompressedImage(frame_id="cam", data=JPEG, format="jpeg")
    reader, _ = log(
        tmp_path, ("/points", cloud), ("/image", image), ("/tf", edge("car", "lidar", (1, 2, 3))),
        ("/tf", edge("gimbal", "cam")),
    )  # fmt: skip
    assert reader.rig.mounts["lidar"].translation_m.tolist() == [1, 2, 3]
    assert reader.rig.bare == frozenset({"cam"})


def test_transforms_that_form_a_loop_are_an_error(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    reader, _ = log(
        tmp_path, ("/points", cloud), ("/tf", edge("a", "lidar", (1, 0, 0))), ("/tf", edge("lidar", "a", (2, 0, 0)))
    )
    with pytest.raises(LogError, match=r"log\.mcap: transforms form a loop: lidar → a → lidar; repair"):
        _ = reader.rig
    assert len(list(reader.messages())) == 1


def test_poses_and_scenes(tmp_path):
    pose = PoseInFrame(frame_id="map", pose=PoseProto(position=Vector3(x=1), orientation=Quaternion(w=1)))
    reader, faults = log(tmp_path, ("/ego", pose), ("/scene", SceneUpdate()))
    [found] = reader.messages()
    assert isinstance(found, Pose)
    assert (found.sensor, found.translation_m.tolist()) == ("ego", [1, 0, 0])
    assert list(reader.truths()) == []
    assert not faults.counts


def test_log_id_follows_from_the_content(tmp_path):
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    first = log(tmp_path, ("/points", cloud))[0].info
    again = log(tmp_path, ("/points", cloud))[0].info
    other = log(tmp_path, ("/points", cloud), ("/more", cloud))[0].info
    assert first == again
    assert len(first.log_id) == 32
    assert first.log_id != other.log_id


def test_other_readers_decode_every_message(tmp_path):
    path = b.write(tmp_path / "log.mcap", b.sequence(3), b.the_rig())
    with path.open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert sorted({(channel.topic, schema.name) for schema, channel, _, _ in decoded}) == [
        ("/cam/calibration", "foxglove.CameraCalibration"),
        ("/cam/image", "foxglove.CompressedImage"),
        ("/front/points", "foxglove.PointCloud"),
        ("/pose", "foxglove.PoseInFrame"),
        ("/tf", "foxglove.FrameTransform"),
        ("/top/points", "foxglove.PointCloud"),
        ("/truth/boxes", "foxglove.SceneUpdate"),
    ]
    assert len(decoded) == 4 + 5 * 3
    clouds = [(m, p) for _, c, m, p in decoded if c.topic == "/top/points"]
    assert [m.sequence for m, _ in clouds] == [0, 1, 2]
    assert all(p.timestamp.seconds * 10**9 + p.timestamp.nanos == m.publish_time for m, p in clouds)
    scenes = [p for _, c, _, p in decoded if c.topic == "/truth/boxes"]
    assert [len(e.cubes) for e in scenes[0].entities] == [0, 1, 1]
    assert all(schema.encoding == "protobuf" for schema, *_ in decoded)


def test_radar_with_velocity_vectors(tmp_path):
    """nuScenes: vx, vy in the sensor's coordinates as measured, vx_comp, vy_comp without the ego motion."""
    dtype = [(name, "<f4") for name in ("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp")]
    scan = packed(dtype, [(3, 4, 0, 7, 5, 10, 0, 0), (10, 0, 1, 8, -2, 9, 0, 0)], "RADAR_FRONT")
    reader, _ = log(tmp_path, ("/RADAR_FRONT", scan))
    [message] = reader.messages()
    assert isinstance(message, RadarScan)
    assert message.radial_velocity_mps.tolist() == [11, -2]  # (3 * 5 + 4 * 10) / 5
    assert message.rcs_dbsm.tolist() == [7, 8]


@pytest.mark.parametrize("name", ["Velocity", "doppler_velocity", "v_r"])
def test_doppler_under_common_names(tmp_path, name):
    dtype = [(column, "<f4") for column in ("x", "y", "z", name, "Power", "Range", "AzimuthAngle", "ElevationAngle")]
    reader, _ = log(tmp_path, ("/radar", packed(dtype, [(1, 2, 3, -4, 5, 6, 0.5, 0.25)], "radar")))
    [scan] = reader.messages()
    assert isinstance(scan, RadarScan)
    columns = (scan.radial_velocity_mps, scan.rcs_dbsm, scan.range_m, scan.azimuth_rad, scan.altitude_rad)
    assert [column.tolist() for column in columns] == [[-4], [5], [6], [0.5], [0.25]]


def test_points_have_rings_and_times_under_common_names(tmp_path):
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("Reflectivity", "<u2"), ("channel", "<f4"), ("t", "<u4")]
    reader, _ = log(tmp_path, ("/points", packed(dtype, [(1, 2, 3, 9, 31, 0), (1, 2, 3, 8, 30, 50_000_000)])))
    [sweep] = reader.messages()
    assert sweep.intensity.tolist() == [9, 8]
    assert (sweep.ring.dtype, sweep.ring.tolist()) == (np.uint16, [31, 30])
    assert (sweep.offset_ns.dtype, sweep.offset_ns.tolist()) == (np.int32, [0, 50_000_000])


def test_times_that_arent_understood_are_told_once(tmp_path):
    """Milliseconds of a sweep, in a field that is in seconds elsewhere."""
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4")]
    stamp = Timestamp(seconds=5)
    sweep = packed(dtype, [(1, 2, 3, 0), (1, 2, 3, 100)], timestamp=stamp)
    good = packed(dtype, [(1, 2, 3, 0), (1, 2, 3, 0.125)], "other", timestamp=stamp)
    reader, faults = log(tmp_path, *[("/points", sweep)] * 3, ("/others", good))
    *rest, other = reader.messages()
    assert [message.offset_ns for message in rest] == [None] * 3
    assert other.offset_ns.tolist() == [0, 125_000_000]
    assert faults.places["TIM013"] == ["log.mcap: topic '/points': its points have 'time'"]
    assert faults.counts["TIM013"] == 1


def test_poses_of_the_body_in_its_own_frame_say_nothing(tmp_path):
    """nuscenes2mcap publishes /pose as the identity in base_link, for viewers to follow."""
    own = PoseInFrame(frame_id="base_link", pose=PoseProto(orientation=Quaternion(w=1)))
    reader, faults = log(tmp_path, ("/pose", own), ("/odometry", PoseInFrame(frame_id="map", pose=own.pose)))
    assert [message.sensor for message in reader.messages()] == ["odometry"]
    assert dict(faults.counts) == {"LOG012": 1}
    assert "body" in faults.places["LOG012"][0]


def test_headers_without_stamps_are_told(tmp_path):
    """The time of recording is taken."""
    points = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)], timestamp=Timestamp())
    reader, faults = log(tmp_path, *[("/other", points)] * 3, *[("/points", points)] * 2)
    assert [(m.log_ns, m.stamp_ns) for m in reader.messages()] == [(i, i) for i in range(5)]
    assert faults.places["TIM011"] == ["log.mcap: /other at 1", "log.mcap: /points at 3"]


def test_sensors_in_the_frame_of_the_body_are_called_by_topic(tmp_path):
    """Joined clouds, as Autoware has them."""
    points = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)], "base_link")
    reader, _ = log(tmp_path, ("/lidar/concatenated", points))
    assert list(reader.rig.mounts) == ["lidar/concatenated"]


def test_sensor_without_any_transform_names_no_other_frame(tmp_path):
    points = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    reader, _ = log(tmp_path, ("/points", points))
    with pytest.raises(LogError, match=r"no transform to the body \('lidar' on /tf or /tf_static\)"):
        _ = reader.rig
