"""What is written by hand around the arrays is what the generated code would write: read back and compared."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.messages import frame_request, hello, small_request
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig

STAMPS = st.integers(0, 2**63 - 1)
NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
LENGTHS = st.one_of(st.integers(0, 5), st.integers(40, 50), st.just(6000))


def column(num, dtype):
    return st.none() | arrays(dtype, num)


@st.composite
def messages(draw):
    sensor, stamp, log = draw(NAMES), draw(STAMPS), draw(STAMPS)
    num, kind = draw(LENGTHS), draw(st.sampled_from(["image", "points", "radar", "pose"]))
    if kind == "image":
        return Image(sensor, stamp, log, draw(st.binary(max_size=300)), "jpeg", (draw(st.integers(1, 9000)), 7))
    if kind == "pose":
        return Pose(sensor, stamp, log, draw(arrays("f8", 3)), draw(arrays("f8", 4)))
    xyz = draw(arrays("f4", (num, 3)))
    if kind == "points":
        columns = [draw(column(num, dtype)) for dtype in ("f4", "u2", "i4")]
        return PointCloud(sensor, stamp, log, xyz, *columns)
    return RadarScan(sensor, stamp, log, xyz, *(draw(column(num, "f4")) for _ in range(5)))


@st.composite
def frames(draw):
    found = {m.sensor: m for m in draw(st.lists(messages(), max_size=4))}
    missing = draw(st.dictionaries(NAMES, NAMES, max_size=2))
    number = draw(st.none() | st.integers(-(2**63), 2**63 - 1))
    return Frame(draw(st.integers(0, 2**40)), draw(STAMPS), draw(st.integers(0, 1000)), found, missing, number)


def same(array, data, dtype):
    return data == (b"" if array is None else array.astype(dtype).tobytes())


@given(frames(), st.integers(1, 2**40))
def test_frames_arrive_as_they_are(frame, sequence):
    request = schema.Request.FromString(b"".join(frame_request(sequence, frame)))
    got = request.frame
    assert (request.sequence, request.WhichOneof("kind")) == (sequence, "frame")
    assert (got.index, got.stamp_ns, got.segment) == (frame.index, frame.stamp_ns, frame.segment)
    assert dict(got.missing) == frame.missing
    assert (got.frame_number if got.HasField("frame_number") else None) == frame.frame_number
    assert [m.sensor for m in got.messages] == sorted(frame.messages)
    for message in got.messages:
        original = frame.messages[message.sensor]
        assert (message.stamp_ns, message.log_ns) == (original.stamp_ns, original.log_ns)
        COMPARE[type(original)](original, message)


def compare_image(image, message):
    got = message.image
    assert (got.encoding, got.width_px, got.height_px, got.data) == (image.encoding, *image.size_wh, image.data)


def compare_points(cloud, message):
    got = message.points
    assert same(cloud.xyz, got.xyz, "<f4")
    for name, dtype in (("intensity", "<f4"), ("ring", "<u2"), ("offset_ns", "<i4")):
        array = getattr(cloud, name)
        assert got.HasField(name) == (array is not None)  # no points is another thing than not measured
        assert same(array, getattr(got, name), dtype)


def compare_radar(scan, message):
    got = message.radar
    assert same(scan.xyz, got.xyz, "<f4")
    for name in ("radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad", "altitude_rad"):
        array = getattr(scan, name)
        assert got.HasField(name) == (array is not None)
        assert same(array, getattr(got, name), "<f4")


def compare_pose(pose, message):
    np.testing.assert_array_equal(message.pose.translation_m, pose.translation_m)
    np.testing.assert_array_equal(message.pose.rotation_xyzw, pose.rotation_xyzw)


COMPARE = {Image: compare_image, PointCloud: compare_points, RadarScan: compare_radar, Pose: compare_pose}


def test_arrays_that_dont_lie_in_one_piece():
    wide = np.arange(40, dtype=np.float32).reshape(10, 4)
    cloud = PointCloud("lidar", 1, 2, wide[::2, :3], wide[::2, 3])
    got = schema.Request.FromString(b"".join(frame_request(1, Frame(0, 1, 0, {"lidar": cloud})))).frame
    np.testing.assert_array_equal(np.frombuffer(got.messages[0].points.xyz, "<f4").reshape(-1, 3), wide[::2, :3])
    np.testing.assert_array_equal(np.frombuffer(got.messages[0].points.intensity, "<f4"), wide[::2, 3])


def test_bulk_data_arent_copied():
    xyz = np.zeros((1000, 3), np.float32)
    pieces = frame_request(1, Frame(0, 1, 0, {"lidar": PointCloud("lidar", 1, 2, xyz)}))
    views = [np.frombuffer(piece, np.uint8) for piece in pieces if len(piece) == xyz.nbytes]
    assert len(views) == 1
    assert np.shares_memory(views[0], xyz)


def test_hello_holds_the_rig():
    mounts = {
        "front": Mount("camera", np.array([1.0, 2, 3]), np.array([0.5, -0.5, 0.5, -0.5])),
        "radar": Mount("radar", np.zeros(3), np.array([0, 0, 0, 1.0])),
    }
    model = CameraModel(np.arange(9.0).reshape(3, 3), (640, 480), "plumb_bob", np.array([0.1, 0.2, 0.3, 0.4, 0.5]))
    message = hello(Rig(mounts, {"front": model}), LogInfo("drive", "drive-1", {"b": "2", "a": "1"}))
    (data,) = small_request(7, message)
    request = schema.Request.FromString(data)
    got = request.hello
    assert (request.sequence, got.version, got.log_name, got.log_id) == (7, 1, "drive", "drive-1")
    assert dict(got.metadata) == {"a": "1", "b": "2"}
    front, radar = got.sensors
    assert (front.name, front.kind, list(front.translation_m)) == ("front", schema.SENSOR_KIND_CAMERA, [1, 2, 3])
    assert list(front.rotation_xyzw) == [0.5, -0.5, 0.5, -0.5]
    assert (list(front.camera.k), front.camera.width_px, front.camera.height_px) == (list(range(9)), 640, 480)
    assert (front.camera.distortion_model, list(front.camera.distortion)) == ("plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.5])
    assert (radar.kind, radar.HasField("camera")) == (schema.SENSOR_KIND_RADAR, False)
