"""Relations: what they change, and that an honest pipeline gives the same once its results are changed back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.replay.check.relations import RELATIONS, RelatedPipeline
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.images import decode, encode_png
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.camera import project
from fbench.replay.geometry.transforms import inverse, transform

_TURNED = Rotation.from_euler("zyx", [0.5, 0.2, -0.1]).as_quat()
_CAMERA = Rotation.from_quat(_TURNED) * Rotation.from_quat([-0.5, 0.5, -0.5, 0.5])
RIG = Rig(
    {
        "lidar": Mount("lidar", np.array([1.0, 0.5, 1.9]), _TURNED),
        "radar": Mount("radar", np.array([2.0, -0.3, 0.5]), _TURNED),
        "camera": Mount("camera", np.array([0.5, 0.2, 1.2]), _CAMERA.as_quat()),
    },
    {
        "camera": CameraModel(
            np.array([[60.0, 0.5, 38.0], [0, 60, 29.5], [0, 0, 1]]), (80, 60), "plumb_bob",
            np.array([0.05, -0.01, 0.004, 0.003, 0.001]),
        )
    },
)  # fmt: skip
POINTS = np.array([[10, 3, 0], [12, -2, 0.5], [20, 6, 1]], np.float32)


class Points:
    """Gives a box for each point, by way of the world; what it gives depends on all that relations change."""

    def start(self, rig, log_info):
        self.rig = rig
        self.stamps = []

    def reset(self, reason):
        pass

    def step(self, frame):
        self.stamps.append(frame.stamp_ns)
        xyz = [transform(self.rig.body_T_sensor(n), frame.messages[n].xyz.astype(float)) for n in ("lidar", "radar")]
        center = np.concatenate(xyz)
        world_T_body = frame.messages["pose"].world_T_body
        center = transform(inverse(world_T_body), transform(world_T_body, center))
        turns = np.arctan2(center[:, 1], center[:, 0])
        size = np.tile([4.0, 2.0, 1.5], (len(center), 1))
        boxes = Boxes3D(center, size, turns, roll_rad=turns / 9, pitch_rad=np.ones(len(center)), velocity_mps=center)
        return Output(boxes, boxes, {})


def frame(index=0):
    pose = Pose("pose", 5, 5, np.array([100.0, 50, 1]), Rotation.from_euler("z", 0.7).as_quat())
    azimuth = np.arctan2(POINTS[:, 1], POINTS[:, 0])
    messages: list[Message] = [
        PointCloud("lidar", 5, 6, POINTS, ring=np.arange(3, dtype=np.uint16)),
        RadarScan("radar", 5, 7, POINTS[::-1] + 1, azimuth_rad=azimuth), pose,
    ]  # fmt: skip
    return Frame(index, 5, 0, {message.sensor: message for message in messages})


def start(name):
    inner = Points()
    related = RelatedPipeline(inner, RELATIONS[name][0]())
    related.start(RIG, LogInfo("log", "id"))
    return inner, related


@pytest.mark.parametrize("name", [name for name in RELATIONS if name != "thinned"])
def test_results_are_those_for_the_original(name):
    _, related = start(name)
    plain = Points()
    plain.start(RIG, LogInfo("log", "id"))
    one, two = (pipeline.step(frame(5)).detections for pipeline in (plain, related))
    for field, values in one.arrays().items():
        np.testing.assert_allclose(two.arrays()[field], values, atol=1e-5)


def test_each_changes_what_it_says():
    changed = {name: relation().frame(frame()) for name, (relation, _) in RELATIONS.items()}
    later = changed["clock"]
    assert {m.stamp_ns - 5 for m in later.messages.values()} == {later.stamp_ns - 5} == {3_600_000_000_000}
    assert changed["world"].messages["pose"].translation_m[0] != 100.0
    np.testing.assert_allclose(changed["mirror"].messages["lidar"].xyz[:, 1], -POINTS[:, 1])
    many = PointCloud("lidar", 5, 5, np.zeros((10_000, 3), np.float32), ring=np.arange(10_000, dtype=np.uint16))
    kept = RELATIONS["thinned"][0]().message(many)
    assert 8_800 < len(kept.xyz) < 9_200
    assert len(kept.ring) == len(kept.xyz)


@pytest.mark.parametrize(("index", "stamps"), [(4, [5]), (5, [5, 1_000_005])])
def test_one_of_ten_frames_comes_twice(index, stamps):
    inner, related = start("twice")
    related.step(frame(index))
    assert inner.stamps == stamps


def test_a_mirrored_camera_sees_the_mirrored_world():
    mirror = RELATIONS["mirror"][0]()
    rig = mirror.rig(RIG)
    body = np.array([[8.0, 5.0, 1.0], [9.0, 3.0, 0.5], [7.0, 4.5, 2.0]])
    pixels = [
        project(r.cameras["camera"], transform(inverse(r.body_T_sensor("camera")), points))[0]
        for r, points in ((RIG, body), (rig, body * [1, -1, 1]))
    ]  # fmt: skip
    np.testing.assert_allclose(pixels[1], pixels[0] * [-1, 1] + [79, 0], atol=1e-9)
    picture = np.arange(80 * 60 * 3, dtype=np.uint8).reshape(60, 80, 3)
    flipped = mirror.message(Image("camera", 0, 0, encode_png(picture), "png", (80, 60)))
    assert np.array_equal(decode(flipped), picture[:, ::-1])
    boxes = Boxes2D(np.array(["camera"]), np.array([[10.0, 5, 19, 9]]))
    np.testing.assert_allclose(mirror.boxes(boxes).xyxy_px, [[60, 5, 69, 9]])


def test_a_lens_that_nobody_can_mirror_is_refused():
    odd = replace(RIG.cameras["camera"], distortion_model="odd")
    with pytest.raises(LogError, match="camera 'camera' can't be mirrored"):
        RELATIONS["mirror"][0]().rig(replace(RIG, cameras={"camera": odd}))
