"""A log of stereo, LiDAR and radar points from a few seconds of RADIATE, whose calibration is `default-calib.yaml`.

Left camera and LiDAR are placed by their `T` there (x right, y forward, z up), the right camera by `stereo_calib`.
"""

from pathlib import Path

import cv2
import numpy as np
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.transforms import inverse, quaternion
from fbench.replay.logs.containers.mcap.write import McapWriter

BODY_R_RADIATE = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
BODY_R_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
LIDAR_OFFSET_NS = 300_000_000
"""LiDAR points fit radar and truth best when they are taken as measured so much later than stamped."""


def radiate_rig(source: Path) -> Rig:
    calib = YAML(typ="safe").load((source / "default-calib.yaml").read_text())
    mounts = {"radar": Mount("radar", np.zeros(3), quaternion(np.eye(3)))}
    lidar, left, stereo = calib["lidar_calib"], calib["left_cam_calib"], calib["stereo_calib"]
    mounts["lidar"] = Mount("lidar", BODY_R_RADIATE @ lidar["T"], quaternion(BODY_R_RADIATE))
    body_T_left = np.eye(4)
    body_T_left[:3, :3] = BODY_R_CAMERA @ Rotation.from_euler("xyz", left["R"], degrees=True).as_matrix().T
    body_T_left[:3, 3] = BODY_R_RADIATE @ left["T"]
    right_T_left = np.eye(4)
    right_T_left[:3, :3] = Rotation.from_matrix(stereo["R"]).as_matrix()
    right_T_left[:3, 3] = np.array([stereo["TX"], stereo["TY"], stereo["TZ"]]) / 1000
    body_T_right = body_T_left @ inverse(right_T_left)
    for name, matrix in (("left", body_T_left), ("right", body_T_right)):
        mounts[name] = Mount("camera", matrix[:3, 3], quaternion(matrix[:3, :3]))
    return Rig(mounts, {"left": _camera(left), "right": _camera(calib["right_cam_calib"])})


def write_radiate(source: Path, path: Path, seconds: float = 1.5) -> Path:
    """Write messages of the first seconds; the radar's Cartesian image becomes points without velocity."""
    with McapWriter(path, LogInfo(path.stem, "radiate", {"reference": "radar"}), radiate_rig(source)) as writer:
        for message in sorted(_messages(source, seconds), key=lambda m: (m.log_ns, m.sensor)):
            writer.write(message)
    return path


def _camera(values):
    K = np.array([[values["fx"], 0, values["cx"]], [0, values["fy"], values["cy"]], [0, 0, 1]])
    lens = np.array([values[name] for name in ("k1", "k2", "p1", "p2", "k3")], np.float64)
    return CameraModel(K, tuple(values["res"]), "plumb_bob", lens)


def _stamps(source, name):
    for line in (source / f"{name}.txt").read_text().splitlines():
        _, frame, _, time = line.split()
        seconds, _, fraction = time.partition(".")
        yield frame, int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9])


def _messages(source, seconds):
    start = dict(_stamps(source, "zed_left"))["000001"]
    for frame, stamp in _stamps(source, "zed_left"):
        right = source / "zed_right" / f"{frame}.png"
        if stamp < start + seconds * 1e9 and right.is_file():
            for name, file in (("left", source / "zed_left" / f"{frame}.png"), ("right", right)):
                yield Image(name, stamp, stamp + 2_000_000, file.read_bytes(), "png", (672, 376))
    for frame, stamp in _stamps(source, "velo_lidar"):
        shifted = stamp + LIDAR_OFFSET_NS
        if start - 1e8 < shifted < start + seconds * 1e9:
            table = np.loadtxt(source / "velo_lidar" / f"{frame}.csv", delimiter=",", dtype=np.float32)
            near = np.sum(table[:, :3] ** 2, axis=1) > 1.5**2  # what is nearer is the vehicle itself
            yield PointCloud("lidar", shifted, shifted + 5_000_000, table[near, :3])
    for frame, stamp in _stamps(source, "Navtech_Cartesian"):
        if start - 1e8 < stamp < start + seconds * 1e9:
            yield RadarScan(
                "radar", stamp, stamp + 8_000_000, _radar_points(source / "Navtech_Cartesian" / f"{frame}.png")
            )


def _radar_points(file):
    """Local maxima of a radar image of 1152 x 1152 pixels and 100 m to each side; up is forward."""
    pixels = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    peaks = (pixels == cv2.dilate(pixels, np.ones((9, 9), np.uint8))) & (pixels > 90)
    rows, columns = np.nonzero(peaks)
    scale = 100 / 576
    xyz = np.stack([(575.5 - rows) * scale, (575.5 - columns) * scale, np.zeros(len(rows))], axis=1)
    return xyz.astype(np.float32)
