import numpy as np
import pytest
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP_NS, Ros

from fbench.replay.contracts.errors import DecodeError

SCAN, TRACKS, RETURN, TRACK = (f"radar_msgs/msg/Radar{name}" for name in ("Scan", "Tracks", "Return", "Track"))
SCANS = {
    RETURN: "float32 range # m\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n",
    SCAN: "std_msgs/Header header\n\nradar_msgs/RadarReturn[] returns\n",
}
CURRENT = {
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
    TRACK: (
        "uint16 NO_CLASSIFICATION=0\nuint16 STATIC=1\nunique_identifier_msgs/UUID uuid\ngeometry_msgs/Point position\n"
        "geometry_msgs/Vector3 velocity\ngeometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\n"
        "uint16 classification\nfloat32[6] position_covariance\nfloat32[6] velocity_covariance\n"
        "float32[6] acceleration_covariance\nfloat32[6] size_covariance"
    ),
    TRACKS: "std_msgs/Header header\nradar_msgs/RadarTrack[] tracks",
}
FIRST = {
    TRACK: (
        "uint16 track_id\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n"
        "geometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\nstring classification"
    ),
    TRACKS: CURRENT[TRACKS],
}


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_scans(distro, text):
    ros = Ros(distro, SCANS)
    returns = [ros.make(RETURN, *row) for row in ((10.0, 0.0, 0.0, -2.0, 30.0), (2.0, np.pi / 2, np.pi / 6, 1.0, -5.0))]
    data = ros.write(ros.make(SCAN, ros.header("radar"), returns))
    codec = ros.codec(SCAN, text=text)
    assert codec.kinds == ("radar",)
    assert codec.probe(data)[:2] == ("radar", "radar")
    scan = codec.message("radar", data, ORIGIN)
    assert (scan.sensor, scan.stamp_ns, scan.log_ns, scan.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    np.testing.assert_allclose(scan.xyz, [[10, 0, 0], [0, np.sqrt(3), 1]], atol=1e-6)
    np.testing.assert_array_equal(scan.radial_velocity_mps, [-2, 1])
    np.testing.assert_array_equal(scan.rcs_dbsm, [30, -5])
    np.testing.assert_array_equal(scan.range_m, [10, 2])
    np.testing.assert_array_equal(scan.azimuth_rad, np.float32([0, np.pi / 2]))
    np.testing.assert_array_equal(scan.altitude_rad, np.float32([0, np.pi / 6]))


def test_empty_scan():
    ros = Ros(DISTROS[0], SCANS)
    scan = ros.codec(SCAN).message("radar", ros.write(ros.make(SCAN, ros.header(), [])), ORIGIN)
    assert scan.xyz.shape == (0, 3)


def track(ros, first, classification, center=(1.0, 2.0, 3.0)):
    point = ros.make("geometry_msgs/msg/Point", *center)
    velocity, acceleration, size = (
        ros.make("geometry_msgs/msg/Vector3", *v) for v in ((4.0, 5.0, 0.0), (0.0, 0.0, 0.0), (4.5, 2.0, 1.5))
    )
    rest = [] if isinstance(first, int) else [np.zeros(6, np.float32)] * 4
    return ros.make(TRACK, first, point, velocity, acceleration, size, classification, *rest)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_tracks(distro, text):
    known = CURRENT if distro is DISTROS[2] else {name: CURRENT[name] for name in (TRACK, TRACKS)}
    ros = Ros(distro, known)
    uuid = ros.make("unique_identifier_msgs/msg/UUID", np.arange(16, dtype=np.uint8))
    data = ros.write(ros.make(TRACKS, ros.header("radar"), [track(ros, uuid, 32001), track(ros, uuid, 1)]))
    part = ros.codec(TRACKS, text=text).truth(data, ORIGIN)
    boxes = part.truth.boxes3d
    assert (part.is_2d, part.frame_id, part.truth.stamp_ns) == (False, "radar", STAMP_NS)
    np.testing.assert_array_equal(boxes.center_m, [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(boxes.size_lwh_m, [[4.5, 2, 1.5]] * 2)
    np.testing.assert_array_equal(boxes.velocity_mps, [[4, 5, 0]] * 2)
    np.testing.assert_array_equal(boxes.yaw_rad, [0, 0])
    assert boxes.label.tolist() == ["car", "other"]
    assert boxes.source_label.tolist() == ["32001", "1"]
    assert boxes.track_id is None


def test_tracks_of_the_first_generation():
    ros = Ros(DISTROS[2], FIRST)
    data = ros.write(ros.make(TRACKS, ros.header("radar"), [track(ros, 17, "Person")]))
    boxes = ros.codec(TRACKS).truth(data, ORIGIN).truth.boxes3d
    assert (boxes.track_id.tolist(), boxes.label.tolist()) == ([17], ["pedestrian"])


def test_tracks_that_arent_finite():
    ros = Ros(DISTROS[2], FIRST)
    data = ros.write(ros.make(TRACKS, ros.header("radar"), [track(ros, 17, "", (np.nan, 0.0, 0.0))]))
    with pytest.raises(DecodeError, match="box 0 isn't finite"):
        ros.codec(TRACKS).truth(data, ORIGIN)
