"""Camchains of Kalibr."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.logs.coordinate_frames import TransformTree

CAM = """\
cam{num}:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.76e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam{num}/image_raw
"""


def cam(num, **matrices):
    lines = [CAM.format(num=num)]
    for key, matrix in matrices.items():
        rows = "".join(f"  - [{', '.join(repr(float(v)) for v in row)}]\n" for row in np.asarray(matrix))
        lines.append(f"  {key}:\n{rows}")
    return "".join(lines)


def at(x, y, z, rotation=(0, 0, 0, 1)):
    return pose_matrix([x, y, z], rotation)


def read(folder, text):
    path = folder / "camchain.yaml"
    path.write_text(text)
    return open_rig_file(path)


def test_a_chain_of_three(tmp_path):
    # cam1 is 0.1 m to the right of cam0; cam2 is 0.2 m behind cam1 and looks to the right of it.
    turned = Rotation.from_euler("y", 90, degrees=True).as_quat()
    cam0_T_cam1, cam1_T_cam2 = at(0.1, 0, 0), at(0, 0, -0.2, turned)
    text = cam(0) + cam(1, T_cn_cnm1=inverse(cam0_T_cam1)) + cam(2, T_cn_cnm1=inverse(cam1_T_cam2))
    patch = read(tmp_path, text)
    assert {n: e.parent for n, e in patch.edges.items()} == {"cam1": "cam0", "cam2": "cam1"}
    translation, rotation = TransformTree(dict(patch.edges)).pose("cam2", "cam0")
    np.testing.assert_allclose(translation, [0.1, 0, -0.2], atol=1e-12)
    np.testing.assert_allclose(pose_matrix(translation, rotation)[:3, 2], [1, 0, 0], atol=1e-12)
    assert patch.topics == {f"cam{i}": f"/cam{i}/image_raw" for i in range(3)}
    camera = patch.cameras["cam2"]
    assert camera.K.tolist() == [[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]]
    assert (camera.size_wh, camera.distortion_model) == ((752, 480), "plumb_bob")
    assert camera.distortion.tolist() == [-0.28, 0.07, 0.0002, 1.76e-05]


def test_with_an_imu_all_cameras_sit_on_it(tmp_path):
    imu_T_cam0 = at(0, 0, 1, Rotation.from_euler("xyz", [-90, 0, -90], degrees=True).as_quat())
    cam0_T_cam1 = at(0.1, 0, 0)
    text = cam(0, T_cam_imu=inverse(imu_T_cam0))
    text += cam(1, T_cam_imu=inverse(imu_T_cam0 @ cam0_T_cam1), T_cn_cnm1=inverse(cam0_T_cam1))
    patch = read(tmp_path, text)
    assert {edge.parent for edge in patch.edges.values()} == {"imu"}
    # Right of a camera that looks along x of the IMU is -y of it.
    np.testing.assert_allclose(patch.edges["cam1"].translation_m, [0, -0.1, 1], atol=1e-12)


def test_equidistant_and_none(tmp_path):
    patch = read(tmp_path, cam(0).replace("radtan", "equidistant"))
    assert patch.cameras["cam0"].distortion_model == "fisheye"
    plain = cam(0).replace("radtan", "none").replace("[-0.28, 0.07, 0.0002, 1.76e-05]", "[]")
    camera = read(tmp_path, plain).cameras["cam0"]
    assert (camera.distortion_model, camera.distortion.size) == ("", 0)


ONE = cam(0)
EYE = np.eye(4)
BAD = {
    "omni": (ONE.replace("pinhole", "omni"), "cam0.camera_model: 'omni' isn't supported; there is: pinhole"),
    "ds": (ONE.replace("pinhole", "ds"), "'ds' isn't supported"),
    "fov": (ONE.replace("radtan", "fov"), "cam0.distortion_model: 'fov' isn't supported; there are: plumb_bob"),
    "three": (ONE.replace("458.654, ", ""), "cam0.intrinsics: expected 4 numbers, got 3"),
    "NaN": (ONE.replace("458.654", ".nan"), r"cam0.intrinsics\[0\]: expected a finite number, got '.nan'"),
    "underscore": (ONE.replace("458.654", "4_58"), r"cam0.intrinsics\[0\]: expected a finite number"),
    "negative": (ONE.replace("458.654", "-1"), "cam0.intrinsics: expected positive focal lengths, got -1"),
    "size": (ONE.replace("752", "0"), r"cam0.resolution\[0\]: expected a whole number from 1"),
    "one size": (ONE.replace("752, ", ""), "cam0.resolution: expected width and height"),
    "coefficients": (ONE.replace("-0.28, ", ""), "cam0.distortion_coeffs: expected 4 numbers, got 3"),
    "no intrinsics": (ONE.replace("intrinsics", "intrinsic"), "cam0: no 'intrinsics'"),
    "not linked": (cam(0) + cam(1), "cam1: no 'T_cn_cnm1' and no 'T_cam_imu'"),
    "gap": (cam(0) + cam(2, T_cn_cnm1=EYE), "no 'cam1', though there are 2 cameras"),
    "no map": ("cam0: 3", "no 'cam0', though"),
    "3x3": (cam(0) + cam(1, T_cn_cnm1=np.eye(3)), "cam1.T_cn_cnm1: expected 4x4 numbers, got rows of .3, 3, 3."),
    "scaled": (cam(0) + cam(1, T_cn_cnm1=EYE * 1.1), "cam1.T_cn_cnm1: its rotation isn't orthonormal"),
    "mirrors": (cam(0) + cam(1, T_cn_cnm1=np.diag([1, 1, -1, 1])), "cam1.T_cn_cnm1: mirrors"),
    "two ways": (
        cam(0, T_cam_imu=EYE) + cam(1, T_cam_imu=EYE, T_cn_cnm1=at(0.1, 0, 0)),
        "cam1: 'T_cn_cnm1' and 'T_cam_imu' lead to poses that differ by 0.1; remove one",
    ),
    "IMU": ("imu0:\n  T_i_b: []\n", "is about an IMU, and holds no camera"),
    "IMU noise": ("accelerometer_noise_density: 0.01\n", "is about an IMU"),
    "unknown": ("a: b", "no calibration that is known; expected fbench's TOML"),
    "empty": ("", "no calibration that is known"),
    "a list": ("- a", "no calibration that is known"),
    "OpenCV": ("%YAML:1.0\n---\nK: !!opencv-matrix", "OpenCV FileStorage isn't read"),
    "twice": (ONE + ONE, "duplicate key"),
    "aliases": ("a: &a [x]\n" + "b: &b [*a, *a]\n", "line 1: YAML anchors and aliases aren't allowed"),
    "deep": ("cam0: " + "[" * 100000, "nested more than 32 deep"),
    "deep lists": ("- " * 40 + "x", "nested more than 32 deep"),
    "tag": ("cam0: !!python/object/apply:os.system [ls]", "no 'cam0', though"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "match"), BAD.values(), ids=BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, text, match):
    with pytest.raises(ConfigError, match=match) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path}/camchain.yaml: ")
    assert "\n" not in str(caught.value)
    assert caught.value.code in ("CFG003", "CAL001")
