import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP_NS, Ros

from fbench.replay.contracts.errors import DecodeError

ARRAY3, ARRAY2 = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"
COMMON = {
    "vision_msgs/msg/BoundingBox3D": "# A box\ngeometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    ARRAY3: "std_msgs/Header header\nDetection3D[] detections\n",
    ARRAY2: "std_msgs/Header header\nDetection2D[] detections\n",
}
NEW = {
    **COMMON,
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id"
    ),
}


def old(id_type):
    return {
        **COMMON,
        "vision_msgs/msg/ObjectHypothesisWithPose": (
            f"{id_type} id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose"
        ),
        "vision_msgs/msg/BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
        "vision_msgs/msg/Detection3D": (
            "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
            "sensor_msgs/PointCloud2 source_cloud\nbool is_tracking\nstring tracking_id"
        ),
        "vision_msgs/msg/Detection2D": (
            "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\n"
            "sensor_msgs/Image source_img"
        ),
    }


def results(ros, pairs, generation):
    point = ros.make("geometry_msgs/msg/Point", 0.0, 0.0, 0.0)
    pose = ros.make("geometry_msgs/msg/Pose", point, ros.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    pose = ros.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    name = "vision_msgs/msg/ObjectHypothesisWithPose"
    if generation == "new":
        return [ros.make(name, ros.make("vision_msgs/msg/ObjectHypothesis", *pair), pose) for pair in pairs]
    return [ros.make(name, *pair, pose) for pair in pairs]


def box3d(ros, center=(1.0, 2.0, 3.0), xyzw=(0.0, 0.0, 0.0, 1.0), size=(4.0, 2.0, 1.5)):
    pose = ros.make(
        "geometry_msgs/msg/Pose",
        ros.make("geometry_msgs/msg/Point", *center), ros.make("geometry_msgs/msg/Quaternion", *xyzw),
    )  # fmt: skip
    return ros.make("vision_msgs/msg/BoundingBox3D", pose, ros.make("geometry_msgs/msg/Vector3", *size))


def array3(ros, rows, frame_id="lidar"):
    """Rows of results, box, frame and id."""
    parts = [
        ros.make("vision_msgs/msg/Detection3D", ros.header(frame), results(ros, pairs, "new"), box, id_)
        for pairs, box, frame, id_ in rows
    ]
    return ros.write(ros.make(ARRAY3, ros.header(frame_id), parts))


def truth(ros, name, data, *, text=True):
    part = ros.codec(name, text=text).truth(data, ORIGIN)
    assert (part.truth.stamp_ns, part.truth.log_ns, part.truth.frame_number) == (STAMP_NS, STAMP_NS + 5, 7)
    return part


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_boxes_of_the_current_generation(distro, text):
    ros = Ros(distro, NEW)
    yaw = (0.0, 0.0, np.sin(0.25), np.cos(0.25))
    rows = [
        ([("person", 0.25), ("Car", 0.75)], box3d(ros), "lidar", "12"),
        ([("ufo", 0.5)], box3d(ros, (-1.0, 0.0, 0.0), yaw), "", "-3"),
    ]
    part = truth(ros, ARRAY3, array3(ros, rows), text=text)
    boxes = part.truth.boxes3d
    assert (part.is_2d, part.frame_id, part.truth.boxes2d) == (False, "lidar", None)
    np.testing.assert_array_equal(boxes.center_m, [[1, 2, 3], [-1, 0, 0]])
    np.testing.assert_array_equal(boxes.size_lwh_m, [[4, 2, 1.5]] * 2)
    np.testing.assert_allclose(boxes.yaw_rad, [0, 0.5], atol=1e-15)
    assert boxes.roll_rad is None
    assert boxes.pitch_rad is None
    assert boxes.label.tolist() == ["car", "other"]
    assert boxes.source_label.tolist() == ["Car", "ufo"]
    assert boxes.score.tolist() == [0.75, 0.5]
    assert boxes.track_id.tolist() == [12, -3]


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize(("id_type", "id_"), [("string", "bus"), ("int64", 5)])
def test_boxes_of_the_old_generation(distro, id_type, id_):
    ros = Ros(distro, old(id_type))
    empty = ros.make("sensor_msgs/msg/PointCloud2", ros.header(), 0, 0, [], False, 0, 0, np.zeros(0, np.uint8), True)
    pairs = results(ros, [(id_, 0.5)], "old")
    detection = ros.make("vision_msgs/msg/Detection3D", ros.header("lidar"), pairs, box3d(ros), empty, True, "4")
    boxes = truth(ros, ARRAY3, ros.write(ros.make(ARRAY3, ros.header(""), [detection]))).truth.boxes3d
    assert boxes.label.tolist() == ["bus" if id_type == "string" else "other"]
    assert boxes.source_label.tolist() == [str(id_)]
    assert boxes.track_id.tolist() == [4]
    image = ros.make("sensor_msgs/msg/Image", ros.header(), 0, 0, "", 0, 0, np.zeros(0, np.uint8))
    box = ros.make("vision_msgs/msg/BoundingBox2D", ros.make("geometry_msgs/msg/Pose2D", 10.0, 20.0, 0.0), 4.0, 8.0)
    flat = ros.make("vision_msgs/msg/Detection2D", ros.header("cam"), pairs, box, image)
    part = truth(ros, ARRAY2, ros.write(ros.make(ARRAY2, ros.header(""), [flat])))
    assert (part.is_2d, part.frame_id) == (True, "cam")
    assert part.truth.boxes2d.xyxy_px.tolist() == [[8, 16, 12, 24]]
    assert part.truth.boxes2d.track_id is None


def flat_box(ros, theta=0.0):
    point = ros.make("vision_msgs/msg/Point2D", 10.0, 20.0)
    return ros.make("vision_msgs/msg/BoundingBox2D", ros.make("vision_msgs/msg/Pose2D", point, theta), 4.0, 8.0)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_boxes_in_images(distro, text):
    ros = Ros(distro, NEW)
    parts = [
        ros.make("vision_msgs/msg/Detection2D", ros.header(""), results(ros, pairs, "new"), flat_box(ros, theta), "")
        for pairs, theta in (([], 0.0), ([("Motorbike", 0.5)], np.pi / 2))
    ]
    part = truth(ros, ARRAY2, ros.write(ros.make(ARRAY2, ros.header("cam"), parts)), text=text)
    boxes = part.truth.boxes2d
    assert (part.is_2d, part.frame_id, part.truth.boxes3d) == (True, "cam", None)
    np.testing.assert_allclose(boxes.xyxy_px, [[8, 16, 12, 24], [6, 18, 14, 22]], atol=1e-12)
    assert boxes.camera.tolist() == ["cam", "cam"]
    assert boxes.label.tolist() == ["", "motorcycle"]
    assert boxes.score is None
    assert boxes.track_id is None


JAZZY = Ros(DISTROS[1], NEW)


def test_no_detections():
    boxes = truth(JAZZY, ARRAY3, array3(JAZZY, [])).truth.boxes3d
    assert len(boxes) == len(boxes.label) == len(boxes.track_id) == 0
    empty = JAZZY.write(JAZZY.make(ARRAY2, JAZZY.header("cam"), []))
    assert len(truth(JAZZY, ARRAY2, empty).truth.boxes2d) == 0


@pytest.mark.parametrize("ids", [("1", ""), ("1", "abc"), ("1", "1.5"), ("1", "²"), ("1", str(2**63))])
def test_ids_that_arent_all_integers_are_left_out(ids):
    rows = [([], box3d(JAZZY), "", id_) for id_ in ids]
    assert truth(JAZZY, ARRAY3, array3(JAZZY, rows)).truth.boxes3d.track_id is None


def test_names_with_a_number_are_ids():
    """Equal in every message, whatever comes before; a name without a number may be a class."""

    def of(*ids):
        rows = [([], box3d(JAZZY), "", id_) for id_ in ids]
        return truth(JAZZY, ARRAY3, array3(JAZZY, rows)).truth.boxes3d.track_id

    first = of("veh_11", "ped 2", "g199").tolist()
    assert len(set(first)) == 3
    assert of("g199", "veh_11").tolist() == [first[2], first[0]]
    assert min(first) >= 0
    for others in (("veh_11", "car"), ("veh_11", "veh_11"), ("veh_11", ""), ("veh_11", "x" * 10_000)):
        assert of(*others) is None


@pytest.mark.parametrize("seed", range(20))
def test_orientations_agree_with_scipy(seed):
    xyzw = np.random.Generator(np.random.Philox(seed)).normal(size=4) * 3
    boxes = truth(JAZZY, ARRAY3, array3(JAZZY, [([], box3d(JAZZY, xyzw=xyzw), "", "")])).truth.boxes3d
    expected = Rotation.from_quat(xyzw).as_euler("ZYX")
    np.testing.assert_allclose([boxes.yaw_rad[0], boxes.pitch_rad[0], boxes.roll_rad[0]], expected, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_upright_boxes_keep_their_orientation(pitch):
    given = Rotation.from_euler("ZYX", [0.5, pitch, 0.25])
    rows = [([], box3d(JAZZY, xyzw=given.as_quat()), "", "")]
    boxes = truth(JAZZY, ARRAY3, array3(JAZZY, rows)).truth.boxes3d
    angles = [boxes.yaw_rad[0], boxes.pitch_rad[0], boxes.roll_rad[0]]
    assert angles[2] == 0
    np.testing.assert_allclose(Rotation.from_euler("ZYX", angles).as_matrix(), given.as_matrix(), atol=1e-7)


def test_zero_orientation_is_none():
    boxes = truth(JAZZY, ARRAY3, array3(JAZZY, [([], box3d(JAZZY, xyzw=(0.0,) * 4), "", "")])).truth.boxes3d
    assert (boxes.yaw_rad[0], boxes.roll_rad) == (0, None)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (([], box3d(JAZZY, (np.nan, 0.0, 0.0)), "", ""), "box 0 isn't finite"),
        (([], box3d(JAZZY, xyzw=(np.inf, 0.0, 0.0, 0.0)), "", ""), "box 0 isn't finite"),
        (([("car", np.nan)], box3d(JAZZY), "", ""), "box 0 isn't finite"),
        (([], box3d(JAZZY), "other", ""), "several coordinate frames: lidar, other"),
    ],
)
def test_boxes_that_cant_be_used(row, message):
    with pytest.raises(DecodeError, match=message):
        truth(JAZZY, ARRAY3, array3(JAZZY, [row]))


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("car", "car"), ("CAR", "car"), ("person", "pedestrian"), ("motorbike", "motorcycle"), ("cyclist", "bicycle"),
        ("vehicle.car", "car"), ("Semi-Trailer", "trailer"), ("32007", "pedestrian"), ("", ""), ("tree", "other"),
    ],
)  # fmt: skip
def test_labels(name, label):
    boxes = truth(JAZZY, ARRAY3, array3(JAZZY, [([(name, 1.0)], box3d(JAZZY), "", "")])).truth.boxes3d
    assert (boxes.label[0], boxes.source_label[0]) == (label, name)
