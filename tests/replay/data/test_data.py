import numpy as np
import pytest

from fbench.replay.contracts.errors import DataError
from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.frames import Output
from fbench.replay.data.messages import PointCloud, Pose, RadarScan
from fbench.replay.data.rig import Mount, Rig


def boxes(n, **fields):
    return Boxes3D(np.zeros((n, 3)), np.ones((n, 3)), np.zeros(n), **fields)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: PointCloud("l", 0, 0, np.zeros((3, 2), np.float32)),
            r"PointCloud.xyz: expected float32 \(N, 3\), got float32 \(3, 2\)",
        ),
        (lambda: PointCloud("l", 0, 0, np.zeros((3, 3))), r"PointCloud.xyz: expected float32 \(N, 3\), got float64"),
        (
            lambda: PointCloud("l", 0, 0, np.zeros((3, 3), np.float32), np.zeros(2, np.float32)),
            r"PointCloud.intensity: expected float32 \(3\)",
        ),
        (
            lambda: PointCloud("l", 0, 0, np.zeros((3, 3), np.float32), offset_ns=np.zeros(3, np.int64)),
            r"offset_ns: expected int32",
        ),
        (
            lambda: RadarScan("r", 0, 0, np.zeros((1, 3), np.float32), np.zeros(2, np.float32)),
            "RadarScan.radial_velocity_mps",
        ),
        (lambda: boxes(2, score=np.zeros(3)), "Boxes3D.score"),
        (lambda: boxes(2, label=np.array([1, 2])), "Boxes3D.label"),
        (lambda: Boxes2D(np.array(["c"]), np.zeros((2, 4))), "Boxes2D.xyxy_px"),
        (
            lambda: Pose("p", 0, 0, np.zeros(3), np.zeros(3)),
            r"Pose.rotation_xyzw: expected float64 \(4\), got float64 \(3,\)",
        ),
        (lambda: Output(boxes(0), Boxes2D.empty(), {}), "Output.tracks: expected Boxes3D, got Boxes2D"),
    ],
)
def test_shapes_and_types_are_checked(make, message):
    with pytest.raises(DataError, match=message):
        make()


def test_casts_that_lose_nothing_are_made():
    cloud = PointCloud("l", 0, 0, np.zeros((2, 3), np.float32), offset_ns=np.array([1, 2], np.int16))
    assert cloud.offset_ns.dtype == np.int32
    assert boxes(2, score=[1, 2]).score.dtype == np.float64


def test_arrays_are_read_only_and_the_callers_stay_writable():
    xyz = np.zeros((2, 3), np.float32)
    cloud = PointCloud("l", 0, 0, xyz)
    with pytest.raises(ValueError, match="read-only"):
        cloud.xyz[0] = 1
    xyz[0] = 1


def test_rows_are_selected_in_all_fields():
    all_boxes = boxes(3, score=np.array([0.1, 0.2, 0.3]), label=np.array(["car", "bus", "car"]))
    some = all_boxes[all_boxes.label == "car"]
    assert some.score.tolist() == [0.1, 0.3]
    assert len(some) == 2
    assert some.velocity_mps is None
    assert len(all_boxes[:0]) == 0


def test_concatenate():
    joined = concatenate([boxes(1, score=np.ones(1)), boxes(0), boxes(2, score=np.zeros(2))])
    assert joined.score.tolist() == [1, 0, 0]
    assert len(concatenate([boxes(0), boxes(0)])) == 0
    with pytest.raises(DataError, match=r"Boxes3D.score: expected in all 2 parts, absent in 1"):
        concatenate([boxes(1, score=np.ones(1)), boxes(1)])


def test_rig_gives_matrices():
    turn = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])  # 90 degrees about z
    rig = Rig({"b": Mount("radar", np.array([1.0, 2, 3]), turn), "a": Mount("lidar", np.zeros(3), turn)}, {})
    np.testing.assert_allclose(rig.body_T_sensor("b") @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-15)
    assert rig.sensors("lidar", "radar") == ("a", "b")
    assert rig.sensors("camera") == ()
