"""Lists of radar returns as drivers define them: by name of the type, by fields, and one return a message."""

import numpy as np
import pytest
from rosbags.typesys import Stores
from tests.replay.logs.codecs.ros.builders import ORIGIN, STAMP_NS, Ros

from fbench.replay.logs.assembly import count_parts
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.container import Channel, Schema

HEADER = "std_msgs/Header header\n"
POSE, TWIST = "geometry_msgs/PoseWithCovariance", "geometry_msgs/TwistWithCovariance"
ARS = {
    "ars_40x/msg/Cluster": f"uint8 id\n{POSE} position\n{TWIST} relative_velocity\nint8 dynamic\nfloat64 rcs\n",
    "ars_40x/msg/ClusterList": f"{HEADER}ars_40x/Cluster[] clusters\n",
}
WORDS = {
    "conti": ("uint8 ID", "float64 Object_DistLong", "float64 Object_DistLat", "float64 Object_VrelLong",
              "float64 Object_VrelLat", "int32 Object_DynProp", "float64 Object_RCS"),
    "ars408": ("int32 id", "float64 distX", "float64 distY", "float64 vrelX", "float64 vrelY", "int32 classT",
               "float64 rcs"),
    "apollo": ("int32 obstacle_id", "float64 longitude_dist", "float64 lateral_dist", "float64 longitude_vel",
               "float64 lateral_vel", "int32 dynprop", "float64 rcs"),
}  # fmt: skip
PLACES, RATES = [[3, 4, 0], [10, 0, 0]], [(3 * 2 + 4 * 1) / 5, -2.5]


def ros_of(definitions, distro=Stores.ROS1_NOETIC):
    return Ros(distro, definitions)


def read(ros, message, codec=None):
    codec = codec or ros.codec(message.__msgtype__)
    assert codec.kinds == ("radar",)
    return codec.message("radar", ros.write(message), ORIGIN)


@pytest.mark.parametrize("words", WORDS.values(), ids=WORDS)
@pytest.mark.parametrize("distro", [Stores.ROS1_NOETIC, Stores.ROS2_JAZZY])
def test_lists_in_the_words_of_continental(words, distro):
    """Velocities are relative: their radial component is positive when receding."""
    ros = ros_of({"any/msg/One": "\n".join(words), "any/msg/Many": f"{HEADER}any/One[] things\n"}, distro)
    parts = [
        ros.make("any/msg/One", 1, 3.0, 4.0, 2.0, 1.0, 7, 12.5),
        ros.make("any/msg/One", 2, 10.0, 0.0, -2.5, 9.0, 7, -3),
    ]
    message = ros.make("any/msg/Many", ros.header("radar_front"), parts)
    assert ros.codec("any/msg/Many").probe(ros.write(message))[:2] == ("radar", "radar_front")
    scan = read(ros, message)
    assert (scan.sensor, scan.stamp_ns, scan.log_ns) == ("s", STAMP_NS, STAMP_NS + 5)
    np.testing.assert_allclose(scan.xyz, PLACES)
    np.testing.assert_allclose(scan.radial_velocity_mps, RATES)
    assert scan.rcs_dbsm.tolist() == [12.5, -3]
    assert scan.range_m is None


def test_clusters_of_ars_40x_are_poses_and_twists():
    ros = ros_of(ARS)

    def cluster(place, velocity):
        point, turn = ros.make("geometry_msgs/msg/Point", *place), ros.make("geometry_msgs/msg/Quaternion", 0, 0, 0, 1)
        linear, angular = (ros.make("geometry_msgs/msg/Vector3", *v) for v in (velocity, (0, 0, 0)))
        pose, twist = (
            ros.make("geometry_msgs/msg/Pose", point, turn),
            ros.make("geometry_msgs/msg/Twist", linear, angular),
        )
        zeros = np.zeros(36)
        return ros.make("ars_40x/msg/Cluster", 1, ros.make(f"{POSE[:13]}/msg{POSE[13:]}", pose, zeros),
                        ros.make(f"{TWIST[:13]}/msg{TWIST[13:]}", twist, zeros), 0, 5.0)  # fmt: skip

    parts = [cluster((3, 4, 0), (2, 1, 0)), cluster((10, 0, 0), (-2.5, 9, 0))]
    message = ros.make("ars_40x/msg/ClusterList", ros.header(), parts)
    definition = ros.schema(message.__msgtype__).data.replace(b"ars_40x/", b"ars_40X/")  # which rosbags can't parse
    codec = ros_codec(Channel("/clusters", "ros1", Schema("ars_40X/ClusterList", "ros1msg", definition)))
    scan = read(ros, message, codec)
    np.testing.assert_allclose(scan.xyz, PLACES)
    np.testing.assert_allclose(scan.radial_velocity_mps, RATES)
    assert scan.rcs_dbsm.tolist() == [5, 5]


def test_a_list_without_header_or_returns():
    definitions = {"any/msg/One": "\n".join(WORDS["ars408"]), "any/msg/Many": "any/One[] rps\n"}
    ros = ros_of(definitions)
    scan = read(ros, ros.make("any/msg/Many", []))
    assert (scan.stamp_ns, scan.xyz.shape, len(scan.radial_velocity_mps)) == (0, (0, 3), 0)


@pytest.mark.parametrize(
    "definition",
    [
        "float64 distX\nfloat64 distY\nfloat64 speed\n# not vrelX\n",
        "geometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n# relative_velocity isn't there\n",
        "float64 vrelX\nfloat64 vrelY\n",
    ],
)
def test_other_lists_are_no_radar(definition):
    ros = ros_of({"any/msg/One": definition, "any/msg/Many": f"{HEADER}any/One[] things\n"})
    assert ros.codec("any/msg/Many") is None


def test_a_damaged_definition_of_an_unknown_type_is_left_alone():
    assert ros_codec(Channel("/t", "ros1", Schema("any/msg/Many", "ros1msg", b"vrelX ][\nany/Gone[] x"))) is None


ARS548 = (
    "float32 azimuth_angle\nfloat32 azimuth_angle_std\nbool invalid_distance\nbool invalid_distance_std\n"
    "bool invalid_azimuth\nbool invalid_azimuth_std\nbool invalid_elevation\nbool invalid_elevation_std\n"
    "bool invalid_range_rate\nbool invalid_range_rate_std\nfloat32 elevation_angle\nfloat32 elevation_angle_std\n"
    "float32 range\nfloat32 range_std\nfloat32 range_rate\nfloat32 range_rate_std\nint8 rcs\n"
)


def test_detections_of_an_ars548_are_polar():
    name = "continental_msgs/msg/ContinentalArs548Detection"
    ros = ros_of({name: ARS548, f"{name}List": f"{HEADER}uint8 status\n{name}[] detections\n"}, Stores.ROS2_JAZZY)

    def detection(azimuth, *, is_invalid, elevation, distance):
        return ros.make(name, azimuth, 0.0, False, False, False, False, is_invalid, False, False, False,
                        elevation, 0.0, distance, 0.0, -1.5, 0.0, -4)  # fmt: skip

    parts = [
        detection(np.pi / 2, is_invalid=False, elevation=np.pi / 6, distance=2.0),
        detection(0.0, is_invalid=True, elevation=0.0, distance=9.0),
    ]
    scan = read(ros, ros.make(f"{name}List", ros.header("ars"), 0, parts))
    np.testing.assert_allclose(scan.xyz, [[0, np.sqrt(3), 1]], atol=1e-6)
    assert (scan.radial_velocity_mps.tolist(), scan.rcs_dbsm.tolist(), scan.range_m.tolist()) == ([-1.5], [-4], [2])
    np.testing.assert_allclose(scan.altitude_rad, [np.pi / 6], rtol=1e-6)


ESR = "delphi_esr_msgs/msg/EsrTrack"
TRACK = (
    f"{HEADER}string canmsg\nuint8 id\nfloat32 lat_rate\nbool grouping_changed\nbool oncoming\nuint8 status\n"
    "float32 angle\nfloat32 range\nbool bridge_object\nbool rolling_count\nfloat32 width\nfloat32 range_accel\n"
    "uint8 med_range_mode\nfloat32 range_rate\n"
)


def esr_track(ros, id_, distance, status=3, angle=90.0):
    values = ("500", id_, 0.0, False, False, status, angle, distance, False, False, 0.0, 0.0, 0, -6.0)
    return ros.write(ros.make(ESR, ros.header("esr"), *values))


def assemble(ros, tracks):
    """Numbers of points, and log times, of the scans that tracks make."""
    assembler = ros.codec(ESR).assembler()
    found = [assembler.take(esr_track(ros, *track), Origin("s", i, i)) for i, track in enumerate(tracks)]
    return [(len(scan.xyz), scan.log_ns) for scan in found if scan is not None]


def test_tracks_of_an_esr_are_one_scan():
    """Its angles are in degrees, to the right; tracks without target are no points."""
    ros = ros_of({ESR: TRACK})
    assembler = ros.codec(ESR).assembler()
    tracks = [(id_, float(id_), 3 if id_ % 2 else 0) for id_ in range(1, 65)]
    *none, scan = [assembler.take(esr_track(ros, *track), ORIGIN) for track in tracks]
    assert none == [None] * 63
    assert len(scan.xyz) == 32
    np.testing.assert_allclose(scan.xyz[:2], [[0, -1, 0], [0, -3, 0]], atol=1e-5)
    assert set(scan.radial_velocity_mps.tolist()) == {-6}
    assert (scan.rcs_dbsm, scan.stamp_ns) == (None, STAMP_NS)
    messages = [(esr_track(ros, *track), ORIGIN) for track in tracks * 3]
    assert count_parts(ros.codec(ESR).assembler(), messages) == 64


@pytest.mark.parametrize(
    ("tracks", "scans"),
    [
        ([(1, 5.0), (9, 5.0), (2, 5.0), (64, 5.0), (1, 5.0)], [(2, 2), (2, 3)]),
        ([(64, 5.0), (64, 0.0), (64, 5.0)], [(1, 0), (0, 1), (1, 2)]),
        ([(1, 5.0), (2, 5.0)], []),
    ],
)
def test_scans_of_which_tracks_are_missing(tracks, scans):
    """A scan is whole when the next one begins; the end of the log says nothing."""
    assert assemble(ros_of({ESR: TRACK}), tracks) == scans


def test_returns_of_an_esr_over_ethernet():
    name = "delphi_esr_msgs/msg/EsrEthTx"
    fields = "".join(f"float32[64] target_report_{n}\n" for n in ("range", "range_rate", "theta", "amplitude"))
    ros = ros_of({name: f"{HEADER}uint8 target_report_count\n{fields}"})
    columns = [np.full(64, value, np.float32) for value in (2.0, 1.0, 90.0, 7.0)]
    scan = read(ros, ros.make(name, ros.header(), 3, *columns))
    np.testing.assert_allclose(scan.xyz, [[0, -2, 0]] * 3, atol=1e-6)
    assert (scan.radial_velocity_mps.tolist(), scan.rcs_dbsm.tolist()) == ([1] * 3, [7] * 3)
