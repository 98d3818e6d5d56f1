"""Objects of Autoware, derived_object_msgs, markers and scenes, written by rosbags from embedded definitions."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP_NS, Ros

from fbench.replay.contracts.errors import DecodeError

UUID = "unique_identifier_msgs/msg/UUID"
TURNED = (0.0, 0.0, np.sin(0.25), np.cos(0.25))
"""Yaw 0.5."""


def autoware(package):
    return {
        UUID: "uint8[16] uuid",
        f"{package}/msg/ObjectClassification": "uint8 CAR=1\nuint8 label\nfloat32 probability",
        f"{package}/msg/Shape": ("uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions"),
        f"{package}/msg/PredictedPath": (
            "geometry_msgs/Pose[] path\nbuiltin_interfaces/Duration time_step\nfloat32 confidence"
        ),
        f"{package}/msg/DetectedObjectKinematics": (
            "geometry_msgs/PoseWithCovariance pose_with_covariance\nbool has_position_covariance\n"
            "uint8 orientation_availability\ngeometry_msgs/TwistWithCovariance twist_with_covariance\nbool has_twist\n"
            "bool has_twist_covariance"
        ),
        f"{package}/msg/TrackedObjectKinematics": (
            "geometry_msgs/PoseWithCovariance pose_with_covariance\nuint8 orientation_availability\n"
            "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
            "geometry_msgs/AccelWithCovariance acceleration_with_covariance\nbool is_stationary"
        ),
        f"{package}/msg/PredictedObjectKinematics": (
            "geometry_msgs/PoseWithCovariance initial_pose_with_covariance\n"
            "geometry_msgs/TwistWithCovariance initial_twist_with_covariance\n"
            "geometry_msgs/AccelWithCovariance initial_acceleration_with_covariance\nPredictedPath[] predicted_paths"
        ),
        **{
            f"{package}/msg/{kind}Object": (
                ("" if kind == "Detected" else "unique_identifier_msgs/UUID object_id\n")
                + f"float32 existence_probability\nObjectClassification[] classification\n{kind}ObjectKinematics "
                "kinematics\nShape shape"
            )
            for kind in ("Detected", "Tracked", "Predicted")
        },
        **{
            f"{package}/msg/{kind}Objects": f"std_msgs/Header header\n{kind}Object[] objects"
            for kind in ("Detected", "Tracked", "Predicted")
        },
    }


def pose(ros, xyz, xyzw):
    point = ros.make("geometry_msgs/msg/Point", *map(float, xyz))
    return ros.make("geometry_msgs/msg/Pose", point, ros.make("geometry_msgs/msg/Quaternion", *map(float, xyzw)))


def vector(ros, *xyz):
    return ros.make("geometry_msgs/msg/Vector3", *map(float, xyz))


def twist(ros, *xyz):
    return ros.make("geometry_msgs/msg/Twist", vector(ros, *xyz), vector(ros, 0, 0, 0))


def aware(ros, package, kind, rows, frame_id="map"):
    """Rows of uuid, classes, pose, velocity, shape (type, corners, sizes)."""

    def made(name, *args):
        return ros.make(f"{package}/msg/{name}", *args)

    still = ros.make(
        "geometry_msgs/msg/AccelWithCovariance",
        ros.make("geometry_msgs/msg/Accel", vector(ros, 0, 0, 0), vector(ros, 0, 0, 0)), np.zeros(36),
    )  # fmt: skip
    objects = []
    for uuid, classes, at, speed, (shape, corners, sizes) in rows:
        where = ros.make("geometry_msgs/msg/PoseWithCovariance", pose(ros, *at), np.zeros(36))
        motion = ros.make("geometry_msgs/msg/TwistWithCovariance", twist(ros, *speed), np.zeros(36))
        motions = {
            "Detected": (where, True, 0, motion, speed[0] != 99, True),
            "Tracked": (where, 0, motion, still, False),
            "Predicted": (where, motion, still, [
                made("PredictedPath", [pose(ros, (9, 9, 9), (0, 0, 0, 1))],
                     ros.make("builtin_interfaces/msg/Duration", 1, 0), 0.5)]),
        }  # fmt: skip
        points = [ros.make("geometry_msgs/msg/Point32", *map(float, corner), 0.0) for corner in corners]
        ids = () if kind == "Detected" else (ros.make(UUID, np.array(uuid, np.uint8)),)
        objects.append(made(
            f"{kind}Object", *ids, 0.75, [made("ObjectClassification", *c) for c in classes],
            made(f"{kind}ObjectKinematics", *motions[kind]),
            made("Shape", shape, ros.make("geometry_msgs/msg/Polygon", points), vector(ros, *sizes)),
        ))  # fmt: skip
    return ros.write(made(f"{kind}Objects", ros.header(frame_id), objects))


ROWS = [
    ([1] * 16, [(7, 0.25), (1, 0.75)], ((1, 2, 3), TURNED), (2, 0, 0), (0, [], (4, 2, 1.5))),
    # A polygon from -1 to 3 along the object and -1 to 1 across: its middle lies 1 m ahead of the pose.
    ([2] * 16, [(2, 1.0)], ((0, 0, 1), (0, 0, 2**-0.5, 2**-0.5)), (0, 1, 0),
     (2, [(-1, -1), (3, -1), (3, 1), (-1, 1)], (0, 0, 3))),
]  # fmt: skip


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
@pytest.mark.parametrize("kind", ["Detected", "Tracked", "Predicted"])
def test_autoware(package, kind):
    ros = Ros(DISTROS[1], autoware(package))
    name = f"{package}/msg/{kind}Objects"
    codec = ros.codec(name)
    assert codec.kinds == ("truth",)
    part = codec.truth(aware(ros, package, kind, ROWS), ORIGIN)
    boxes = part.truth.boxes3d
    assert (part.frame_id, part.frame_ids, part.truth.stamp_ns) == ("map", (), STAMP_NS)
    np.testing.assert_allclose(boxes.center_m, [[1, 2, 3], [0, 1, 1]], atol=1e-12)
    np.testing.assert_allclose(boxes.size_lwh_m, [[4, 2, 1.5], [4, 2, 3]])
    np.testing.assert_allclose(boxes.yaw_rad, [0.5, np.pi / 2])
    np.testing.assert_allclose(boxes.velocity_mps, [[2 * np.cos(0.5), 2 * np.sin(0.5), 0], [-1, 0, 0]], atol=1e-12)
    assert boxes.label.tolist() == ["car", "truck"]
    assert boxes.source_label.tolist() == ["car", "truck"]
    assert boxes.score.tolist() == [0.75, 0.75]
    if kind == "Detected":
        assert boxes.track_id is None
    else:
        again = codec.truth(aware(ros, package, kind, ROWS[::-1]), ORIGIN).truth.boxes3d
        assert again.track_id.tolist() == boxes.track_id.tolist()[::-1]
        assert len(set(boxes.track_id.tolist())) == 2
        assert min(boxes.track_id.tolist()) >= 0


def test_autoware_without_twist_classes_or_objects():
    package, kind = "autoware_perception_msgs", "Detected"
    ros = Ros(DISTROS[1], autoware(package))
    codec = ros.codec(f"{package}/msg/DetectedObjects")
    rows: list[Any] = [([0] * 16, [], ((0, 0, 0), (0, 0, 0, 1)), (99, 0, 0), (0, [], (1, 1, 1)))]
    boxes = codec.truth(aware(ros, package, kind, rows), ORIGIN).truth.boxes3d
    assert np.isnan(boxes.velocity_mps).all()
    assert (boxes.label.tolist(), boxes.source_label.tolist()) == (["other"], ["unknown"])
    assert len(codec.truth(aware(ros, package, kind, []), ORIGIN).truth.boxes3d) == 0
    rows[0] = ([0] * 16, [], ((np.nan, 0, 0), (0, 0, 0, 1)), (0, 0, 0), (0, [], (1, 1, 1)))
    with pytest.raises(DecodeError, match="box 0 isn't finite"):
        codec.truth(aware(ros, package, kind, rows), ORIGIN)


@pytest.mark.parametrize(
    "name", ["autoware_perception_msgs/msg/TrackedObjects", "derived_object_msgs/msg/ObjectArray",
             "foxglove_msgs/msg/SceneUpdate"],
)  # fmt: skip
def test_without_a_definition_the_type_is_one_of_many_that_arent_read(name):
    assert Ros(DISTROS[1]).codec(name, text=False) is None


DERIVED = {
    "derived_object_msgs/msg/Object": (
        "std_msgs/Header header\nuint32 id\nuint8 detection_level\nbool object_classified\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Twist twist\ngeometry_msgs/Accel accel\ngeometry_msgs/Polygon polygon\n"
        "derived_object_msgs/Solid shape\nuint8 classification\nuint8 classification_certainty\n"
        "uint32 classification_age"
    ),
    "derived_object_msgs/msg/Solid": "uint8 type\nfloat64[] dimensions",
    "derived_object_msgs/msg/ObjectArray": "std_msgs/Header header\nObject[] objects",
}


def derived(ros, rows):
    """Rows of id, frame, class and shape."""
    accel = ros.make("geometry_msgs/msg/Accel", vector(ros, 0, 0, 0), vector(ros, 0, 0, 0))
    objects = [
        ros.make(
            "derived_object_msgs/msg/Object", ros.header(frame_id), id_, 0, True, pose(ros, (id_, 0, 0), TURNED),
            twist(ros, 1, 2, 3), accel, ros.make("geometry_msgs/msg/Polygon", []),
            ros.make("derived_object_msgs/msg/Solid", shape[0], np.array(shape[1], np.float64)), label, 51, 0,
        )
        for id_, frame_id, label, shape in rows
    ]  # fmt: skip
    return ros.write(ros.make("derived_object_msgs/msg/ObjectArray", ros.header("map"), objects))


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_derived_objects(distro):
    ros = Ros(distro, DERIVED)
    rows = [(5, "", 6, (1, [4, 2, 1.5])), (6, "lidar", 4, (3, [1.75, 0.25])), (7, "", 5, (2, [0.5]))]
    part = ros.codec("derived_object_msgs/msg/ObjectArray").truth(derived(ros, rows), ORIGIN)
    boxes = part.truth.boxes3d
    assert (part.frame_id, part.frame_ids) == ("map", ("map", "lidar", "map"))
    assert boxes.center_m[:, 0].tolist() == [5, 6, 7]
    assert boxes.size_lwh_m.tolist() == [[4, 2, 1.5], [0.5, 0.5, 1.75], [1, 1, 1]]
    assert boxes.velocity_mps.tolist() == [[1, 2, 3]] * 3
    assert boxes.label.tolist() == ["car", "pedestrian", "bicycle"]
    assert boxes.score.tolist() == [0.2] * 3
    assert boxes.track_id.tolist() == [5, 6, 7]


COVARIANCE = {
    name.replace("Object", "ObjectWithCovariance"): text.replace("_msgs/Pose ", "_msgs/PoseWithCovariance ")
    .replace("_msgs/Twist ", "_msgs/TwistWithCovariance ").replace("_msgs/Accel ", "_msgs/AccelWithCovariance ")
    .replace("Solid shape", "SolidPrimitiveWithCovariance shape").replace("\nObject[]", "\nObjectWithCovariance[]")
    for name, text in DERIVED.items() if "Solid" not in name
}  # fmt: skip
COVARIANCE["derived_object_msgs/msg/SolidPrimitiveWithCovariance"] = (
    "uint8 type\nfloat64[] dimensions\nfloat64[] covariance"
)


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_derived_objects_with_covariance(distro):
    ros, zeros, package = Ros(distro, COVARIANCE), np.zeros(36), "derived_object_msgs/msg"
    accel = ros.make("geometry_msgs/msg/Accel", vector(ros, 0, 0, 0), vector(ros, 0, 0, 0))
    parts = [
        ros.make(f"geometry_msgs/msg/{name}WithCovariance", part, zeros)
        for name, part in (("Pose", pose(ros, (5, 6, 7), TURNED)), ("Twist", twist(ros, 1, 2, 3)), ("Accel", accel))
    ]
    shape = ros.make(f"{package}/SolidPrimitiveWithCovariance", 1, np.array([4.0, 2, 1.5]), np.zeros(9))
    object_ = ros.make(f"{package}/ObjectWithCovariance", ros.header("radar"), 9, 1, True, *parts,
                       ros.make("geometry_msgs/msg/Polygon", []), shape, 7, 255, 3)  # fmt: skip
    data = ros.write(ros.make(f"{package}/ObjectWithCovarianceArray", ros.header("radar"), [object_]))
    boxes = ros.codec(f"{package}/ObjectWithCovarianceArray").truth(data, ORIGIN).truth.boxes3d
    assert (boxes.center_m.tolist(), boxes.size_lwh_m.tolist()) == ([[5, 6, 7]], [[4, 2, 1.5]])
    assert (boxes.velocity_mps.tolist(), boxes.label.tolist(), boxes.score.tolist()) == ([[1, 2, 3]], ["truck"], [1])
    np.testing.assert_allclose(boxes.yaw_rad, [0.5])


def test_derived_objects_of_other_shapes():
    ros = Ros(DISTROS[1], DERIVED)
    with pytest.raises(DecodeError, match="shape 4 of 2 sizes isn't a box, sphere or cylinder"):
        ros.codec("derived_object_msgs/msg/ObjectArray").truth(derived(ros, [(1, "", 6, (4, [1, 2]))]), ORIGIN)


def marker(ros, id_, kind=1, action=0, text="", ns="cars", frame_id="map"):
    name = "visualization_msgs/msg/Marker"
    fields = {f: None for f, _ in ros.store.fielddefs[name][1]}
    ros1 = ros.encoding == "ros1"
    duration = ros.make("builtin_interfaces/msg/Duration", 0, 0)
    values = {
        "header": ros.header(frame_id), "ns": ns, "id": id_, "type": kind, "action": action,
        "pose": pose(ros, (id_, 2, 3), TURNED), "scale": vector(ros, 4, 2, 1.5),
        "color": ros.make("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 1.0), "lifetime": duration, "frame_locked": False,
        "points": [], "colors": [], "text": text, "mesh_resource": "", "mesh_use_embedded_materials": False,
    }  # fmt: skip
    if not ros1 and "texture_resource" in fields:
        values |= {
            "texture_resource": "",
            "texture": ros.make("sensor_msgs/msg/CompressedImage", ros.header(), "", np.zeros(0, np.uint8)),
            "uv_coordinates": [],
            "mesh_file": ros.make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8)),
        }
    return ros.make(name, **values)


@pytest.mark.slow
@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_markers(distro, text):
    ros = Ros(distro)
    codec = ros.codec("visualization_msgs/msg/MarkerArray", text=text)
    assert codec.kinds == ("detections",)
    markers = [marker(ros, 3, text="Truck"), marker(ros, 4, ns="car"), marker(ros, 5, kind=9), marker(ros, 6, action=2)]
    part = codec.truth(ros.write(ros.make("visualization_msgs/msg/MarkerArray", markers)), ORIGIN)
    boxes = part.truth.boxes3d
    assert (part.frame_id, part.truth.stamp_ns) == ("map", STAMP_NS)
    assert boxes.center_m.tolist() == [[3, 2, 3], [4, 2, 3]]
    assert boxes.size_lwh_m.tolist() == [[4, 2, 1.5]] * 2
    np.testing.assert_allclose(boxes.yaw_rad, [0.5, 0.5])
    assert boxes.label.tolist() == ["truck", "car"]
    assert boxes.track_id.tolist() == [3, 4]
    same = ros.write(ros.make("visualization_msgs/msg/MarkerArray", [marker(ros, 1, ns="a"), marker(ros, 1, ns="b")]))
    assert codec.truth(same, ORIGIN).truth.boxes3d.track_id is None
    empty = codec.truth(ros.write(ros.make("visualization_msgs/msg/MarkerArray", [])), ORIGIN).truth
    assert (len(empty.boxes3d), empty.stamp_ns) == (0, 0)


POSE_TYPES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize("name", POSE_TYPES)
def test_poses(distro, name):
    ros = Ros(distro)
    plain = pose(ros, (1, 2, 3), TURNED)
    spread = ros.make("geometry_msgs/msg/PoseWithCovariance", plain, np.zeros(36))
    motion = ros.make("geometry_msgs/msg/TwistWithCovariance", twist(ros, 0, 0, 0), np.zeros(36))
    parts = {POSE_TYPES[0]: ("base_link", spread, motion), POSE_TYPES[1]: (plain,), POSE_TYPES[2]: (spread,)}[name]
    data = ros.write(ros.make(name, ros.header("odom"), *parts))
    codec = ros.codec(name)
    assert codec.kinds == ("odometry",)
    assert codec.probe(data)[:3] == ("odometry", "base_link" if name == POSE_TYPES[0] else "", "odom")
    found = codec.message("pose", data, ORIGIN)
    assert (found.sensor, found.stamp_ns, found.log_ns, found.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    assert found.translation_m.tolist() == [1, 2, 3]
    assert found.rotation_xyzw.tolist() == list(TURNED)
    np.testing.assert_allclose(found.world_T_body[:3, :3], Rotation.from_euler("z", 0.5).as_matrix(), atol=1e-15)


def test_stamps_of_transforms():
    ros = Ros(DISTROS[0])
    transform = ros.make(
        "geometry_msgs/msg/Transform", vector(ros, 1, 2, 3), ros.make("geometry_msgs/msg/Quaternion", *TURNED)
    )
    parts = [
        ros.make("geometry_msgs/msg/TransformStamped", ros.header("odom", stamp), "base_link", transform)
        for stamp in ((5, 6), (0, 0))
    ]
    data = ros.write(ros.make("tf2_msgs/msg/TFMessage", parts))
    assert ros.codec("tf2_msgs/msg/TFMessage").stamps(data) == [5_000_000_006, 0]
