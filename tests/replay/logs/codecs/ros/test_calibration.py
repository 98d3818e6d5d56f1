import numpy as np
import pytest
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, Ros

from fbench.replay.contracts.errors import DecodeError

INFO = "sensor_msgs/msg/CameraInfo"
K = [700.0, 0.5, 320.0, 0.0, 710.0, 240.0, 0.0, 0.0, 1.0]


def info(ros, k=K, d=(0.1, -0.2), model="plumb_bob", size_wh=(640, 480), binning=(0, 0), region=(0, 0, 0, 0)):
    x, y, width, height = region
    roi = ros.make("sensor_msgs/msg/RegionOfInterest", x, y, height, width, False)
    numbers = [np.array(d, float), np.array(k, float), np.eye(3).ravel(), np.zeros(12)]
    return ros.write(
        ros.make(INFO, ros.header("cam"), size_wh[1], size_wh[0], model, *numbers, binning[0], binning[1], roi)
    )


def model(distro=DISTROS[1], **changes):
    ros = Ros(distro)
    return ros.codec(INFO).calibration(info(ros, **changes))


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("text", [False, True])
def test_calibration_of_all_distributions(distro, big, text):
    ros = Ros(distro, big=big)
    codec = ros.codec(INFO, text=text)
    data = info(ros)
    assert codec.kinds == ("calibration",)
    assert codec.probe(data)[:2] == ("calibration", "cam")
    frame, camera = codec.calibration(data)
    assert (frame, camera.size_wh, camera.distortion_model) == ("cam", (640, 480), "plumb_bob")
    np.testing.assert_array_equal(camera.K, np.reshape(K, (3, 3)))
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2])


def test_equidistant_is_called_fisheye():
    assert model(model="equidistant")[1].distortion_model == "fisheye"


def test_region_moves_the_center():
    camera = model(region=(100, 50, 200, 150))[1]
    assert camera.size_wh == (200, 150)
    assert (camera.K[0, 2], camera.K[1, 2], camera.K[0, 0], camera.K[0, 1]) == (220.0, 190.0, 700.0, 0.5)


def test_binning_scales_about_the_corner_of_the_image():
    camera = model(binning=(2, 4))[1]
    assert camera.size_wh == (320, 120)
    # Full-resolution pixel 0.5 (the border of pixels 0 and 1) is the center of the first of the binned ones.
    np.testing.assert_allclose(
        camera.K, [[350, 0.25, (320 - 0.5) / 2], [0, 710 / 4, (240 - 1.5) / 4], [0, 0, 1]], rtol=1e-15
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"k": [0.0] * 9}, "camera 'cam' isn't calibrated"),
        ({"k": [np.nan, *K[1:]]}, "no valid focal length"),
        ({"k": [-1.0, *K[1:]]}, "no valid focal length"),
        ({"d": (np.inf,)}, "no valid focal length"),
        ({"size_wh": (0, 480)}, "image size of 0x480"),
        ({"region": (600, 0, 100, 100)}, r"region of \(100, 100\) at \(600, 0\) outside its 640x480 px"),
        ({"binning": (1000, 1)}, "image size of 0x480"),
    ],
)
def test_cameras_that_cant_be_used(changes, message):
    with pytest.raises(DecodeError, match=message):
        model(**changes)


TF2, TF1 = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
TEXT = "geometry_msgs/TransformStamped[] transforms"


def transforms(ros, name, edges=(("/map", "/body"), ("body", "a"))):
    vector, rotation = ros.make("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 0.9)
    pose = ros.make("geometry_msgs/msg/Transform", vector, ros.make("geometry_msgs/msg/Quaternion", *rotation))
    stamped = "geometry_msgs/msg/TransformStamped"
    parts = [ros.make(stamped, ros.header(parent), child, pose) for parent, child in edges]
    return ros.write(ros.make(name, parts))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("distro", "name"), [(DISTROS[0], TF2), (DISTROS[1], TF2), (DISTROS[2], TF2), (DISTROS[2], TF1)]
)
def test_transforms(distro, name, text):
    ros = Ros(distro, {name: TEXT})
    codec, data = ros.codec(name, text=text), transforms(ros, name)
    assert codec.kinds == ("transform",)
    assert codec.probe(data)[:2] == ("transform", "")
    (first, edge), (second, other) = codec.transforms(data)
    assert (first, edge.parent, second, other.parent) == ("body", "map", "a", "body")
    np.testing.assert_array_equal(edge.translation_m, [1, 2, 3])
    np.testing.assert_array_equal(edge.rotation_xyzw, [0.1, 0.2, 0.3, 0.9])
    with pytest.raises(DecodeError, match="holds no measurement"):
        codec.message("lidar", data, ORIGIN)
