"""The pipeline from two images to tracks, and rigs that it can't use."""

import numpy as np
import pytest
from tests.pipelines.frames import UPRIGHT, assert_equal, fields
from tests.pipelines.sensors.stereo.pairs import SIZE, K, car, frame, image, rig, road, wall

from fbench.pipelines.sensors.stereo.depth import choose_pair
from fbench.pipelines.variants.stereo3d import Stereo3D, Stereo3DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.stereo_pairs import Pair

LOG = LogInfo("drive", "id")
FULL = ("stereo.disparity.shrink=1",)
SCENE = [road(), wall(30.0), *car(9.0, 1.0)]


def started(sensors=None, *settings) -> Stereo3D:
    pipeline = Stereo3D(apply_settings(Stereo3DParams(), [*FULL, *settings]))
    pipeline.start(rig() if sensors is None else sensors, LOG)
    return pipeline


def test_a_car_is_found_where_it_is():
    output = started().step(frame(rig(), SCENE))
    assert len(output.detections) == 1
    assert output.detections.center_m[0, :2] == pytest.approx([11.1, 1.0], abs=0.5)
    assert output.detections.center_m[0, 2] == pytest.approx(0.8, abs=0.2)
    assert output.detections.sources.tolist() == [8]
    assert output.detections.label is None
    assert np.isnan(output.detections.velocity_mps).all()
    assert len(output.tracks) == 1
    assert not output.missing
    assert list(output.stage_ns) == ["decode", "preprocess", "detect.stereo", "calibrate", "track"]


def test_again_gives_the_same():
    pipeline = started()
    first = pipeline.step(frame(rig(), SCENE))
    pipeline.reset("again")
    assert_equal(first.detections, pipeline.step(frame(rig(), SCENE)).detections)


def test_noise_switches_stereo_off_and_says_so():
    pipeline = started()
    full = pipeline.step(frame(rig(), SCENE))
    output = pipeline.step(frame(rig(), SCENE, noise=30.0, index=1))
    assert output.missing == {"left": "stereo depth is noise", "right": "stereo depth is noise"}
    assert len(output.detections) == 0
    assert fields(output.detections) == fields(full.detections)
    assert output.tracks.predicted.all()


@pytest.mark.parametrize("kept", [(), ("left",), ("right",)])
def test_a_missing_image_degrades(kept):
    pipeline = started()
    full = pipeline.step(frame(rig(), SCENE))
    whole = frame(rig(), SCENE, index=1)
    output = pipeline.step(Frame(1, whole.stamp_ns, 0, {name: whole.messages[name] for name in kept}))
    assert len(output.detections) == 0
    assert fields(output.detections) == fields(full.detections)
    assert not output.faults
    assert output.tracks.predicted.all()


def test_a_corrupt_image_is_a_fault():
    messages = dict(frame(rig(), SCENE).messages)
    messages["right"] = image("right", np.zeros((2, 2), np.uint8), SIZE)
    output = started().step(Frame(0, 0, 0, messages))
    assert [fault.code for fault in output.faults] == ["DEC002"]
    assert len(output.detections) == 0


def test_an_image_of_another_size_is_a_fault():
    messages = dict(frame(rig(), SCENE).messages)
    messages["left"] = image("left", np.zeros((100, 100), np.uint8))
    assert [fault.code for fault in started().step(Frame(0, 0, 0, messages)).faults] == ["LIM003"]


def test_of_several_pairs_the_longest_baseline_counts():
    sensors = rig()
    middle = Mount("camera", np.array([0, 0, 1.2]), sensors.mounts["left"].rotation_xyzw)
    three = Rig({**sensors.mounts, "camera": middle}, {**sensors.cameras, "camera": sensors.cameras["left"]})
    assert_equal(started(three).step(frame(three, SCENE)).detections, started().step(frame(rig(), SCENE)).detections)
    assert choose_pair(three, "drive", None, None) == Pair("left", "right", 0.4)
    assert choose_pair(three, "drive", None, "camera") == Pair("left", "camera", 0.2)
    assert choose_pair(three, "drive", "camera", None) == Pair("camera", "right", 0.2)


def no_pair() -> dict[str, Rig]:
    sensors = rig()
    small = CameraModel(K, (100, 100))
    aside = Mount("camera", np.array([0, -0.2, 1.2]), UPRIGHT)
    return {
        "no cameras": Rig({"lidar": Mount("lidar", np.zeros(3), UPRIGHT)}, {}),
        "left 400x300": Rig({"left": sensors.mounts["left"]}, {"left": sensors.cameras["left"]}),
        "left 400x300, right 100x100": Rig(sensors.mounts, {**sensors.cameras, "right": small}),
        "left 400x300, right 400x300": Rig({**sensors.mounts, "right": aside}, sensors.cameras),
        "left, right": Rig(sensors.mounts, {}),
    }


@pytest.mark.parametrize("present", list(no_pair()))
def test_a_rig_without_a_pair_is_refused(present):
    with pytest.raises(LogError) as error:
        started(no_pair()[present])
    text = str(error.value)
    assert text.startswith("log 'drive': a stereo pair needs two cameras of one size with calibration, parallel")
    assert text.endswith(f"the log has: {present}")


def test_named_cameras_that_are_no_pair():
    with pytest.raises(ConfigError, match=r"^stereo\.left=lfet: no such camera; did you mean 'left'\?$"):
        started(None, "stereo.left=lfet")
    with pytest.raises(LogError, match=r"\(stereo\.left=right, stereo\.right=any\); the log has: left 400x300"):
        started(None, "stereo.left=right")


def test_lenses_that_are_not_modeled_are_refused():
    sensors = rig()
    odd = CameraModel(K, SIZE, "double_sphere", np.ones(6))
    with pytest.raises(LogError, match=r"camera 'left'.*rectify the images"):
        started(Rig(sensors.mounts, dict.fromkeys(sensors.cameras, odd)))


@pytest.mark.parametrize("setting", ["objects.least_top_m=0.5,0.9", "objects.cluster.eps_m=0", "min_score=2"])
def test_settings_that_make_no_sense(setting):
    with pytest.raises(ConfigError, match=setting.partition("=")[0].replace(".", r"\.")):
        apply_settings(Stereo3DParams(), [setting])
