"""A tiny raw drive of KITTI with known numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbench.datasets.importing.run import import_one
from fbench.datasets.kitti import Kitti
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.logs.open import open_log

DATE = "2011_09_26"
R_RECT = (
    "9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 7.402527e-03 4.351614e-03 "
    "9.999631e-01"
)
R_02 = (
    "9.999758e-01 -5.267463e-03 -4.552439e-03 5.251945e-03 9.999804e-01 -3.413835e-03 4.570332e-03 3.389843e-03 "
    "9.999838e-01"
)
R_VELO = (
    "7.533745e-03 -9.999714e-01 -6.166020e-04 1.480249e-02 7.280733e-04 -9.998902e-01 9.998621e-01 7.523790e-03 "
    "1.480755e-02"
)
R_IMU = (
    "9.999976e-01 7.553071e-04 -2.035826e-03 -7.854027e-04 9.998898e-01 -1.482298e-02 2.024406e-03 1.482454e-02 "
    "9.998881e-01"
)
CAM_TO_CAM = f"""calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_00: 8 6
K_00: 9.8e+00 0 4 0 9.7e+00 3 0 0 1
D_00: -0.3 0.2 0.001 -0.002 -0.07
R_00: 1 0 0 0 1 0 0 0 1
T_00: 2.573699e-16 -1.059758e-16 1.614870e-16
S_rect_00: 6 4
R_rect_00: {R_RECT}
P_rect_00: 7 0 3 0 0 7 2 0 0 0 1 0
S_02: 8 6
K_02: 9.6e+00 0 4.1 0 9.5e+00 2.9 0 0 1
D_02: -0.35 0.15 0.0005 0.0001 -0.05
R_02: {R_02}
T_02: 5.956621e-02 2.900141e-04 2.577209e-03
S_rect_02: 6 4
R_rect_02: {R_RECT}
P_rect_02: 7 0 3 4.485728e-01 0 7 2 2.163791e-03 0 0 1 2.745884e-03
"""
VELO_TO_CAM = f"""calib_time: 15-Mar-2012 11:37:16
R: {R_VELO}
T: -4.069766e-03 -7.631618e-02 -2.717806e-01
delta_f: 0 0
"""
IMU_TO_VELO = f"""calib_time: 25-May-2012 16:47:16
R: {R_IMU}
T: -8.086759e-01 3.195559e-01 -7.997231e-01
"""
FOLDERS = {"image_00": "png", "image_02": "png", "velodyne_points": "bin", "oxts": "txt"}
OFFSETS_NS = {"image_00": 964389445, "image_02": 964133952, "velodyne_points": 951199337, "oxts": 966389445}
"""Of the first stamp after 13:02:25; the others follow by 0.1 s."""
POSE = (
    "<item><tx>{}</tx><ty>{}</ty><tz>{}</tz><rx>0</rx><ry>0</ry><rz>{}</rz><state>{}</state><occlusion>{}</occlusion>"
    "<occlusion_kf>-1</occlusion_kf><truncation>{}</truncation><amt_occlusion>-1</amt_occlusion></item>\n"
)


def stamps(first_ns: int, num: int) -> str:
    times = [25 * 10**9 + first_ns + i * 10**8 for i in range(num)]
    return "".join(f"2011-09-26 13:02:{ns // 10**9:02d}.{ns % 10**9:09d}\n" for ns in times)


def oxts_row(lat: float = 49.015, lon: float = 8.434, alt: float = 116.4, yaw: float = 0.3) -> str:
    values = [f"{lat:.12f}", f"{lon:.12f}", f"{alt:.8f}", "0.035", "-0.0034", f"{yaw:.6f}", *["1.5"] * 19]
    return " ".join([*values, "4", "10", "4", "4", "0"])


def tracklet(poses: Sequence[str], kind: str = "Car", first: int = 0, hwl: str = "1.5 1.6 4.2") -> str:
    height, width, length = hwl.split()
    return (
        f"<item><objectType>{kind}</objectType><h>{height}</h><w>{width}</w>"
        f"<l>{length}</l><first_frame>{first}</first_frame>"
        f"<poses><count>{len(poses)}</count><item_version>2</item_version>{''.join(poses)}</poses>"
        "<finished>1</finished></item>"
    )


def tracklets(*items: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        f'<boost_serialization signature="serialization::archive" version="9">\n<tracklets class_id="0" '
        f'tracking_level="0" version="0">\n<count>{len(items)}</count><item_version>1</item_version>'
        f"{''.join(items)}</tracklets></boost_serialization>\n"
    )


@dataclass
class Imported:
    """What became of an import."""

    path: Path
    lines: Sequence[str]
    bad: BadInput

    def __post_init__(self) -> None:
        self.log = open_log(self.path, FaultLog())
        self.messages = list(self.log.messages())
        self.truths = list(self.log.truths())

    def of(self, sensor: str) -> list[Any]:
        return [message for message in self.messages if message.sensor == sensor]


class MadeDrive:
    """A drive on the disk, of which tests change files."""

    pose = POSE

    def __init__(self, root: Path, kind: str = "sync", num: int = 3) -> None:
        self.root, self.date = root, root / DATE
        self.folder = self.date / f"{DATE}_drive_0001_{kind}"
        size = (6, 4) if kind == "sync" else (8, 6)
        for name, ending in FOLDERS.items():
            data = self.folder / name / "data"
            data.mkdir(parents=True)
            (data.parent / "timestamps.txt").write_text(stamps(OFFSETS_NS[name], num))
            for i in range(num):
                path = data / f"{i:010d}.{'txt' if (name, kind) == ('velodyne_points', 'extract') else ending}"
                path.write_bytes(self.content(name, path.suffix, i, size))
        (self.date / "calib_cam_to_cam.txt").write_text(CAM_TO_CAM)
        (self.date / "calib_velo_to_cam.txt").write_text(VELO_TO_CAM)
        (self.date / "calib_imu_to_velo.txt").write_text(IMU_TO_VELO)

    def content(self, name: str, suffix: str, number: int, size_wh: tuple[int, int]) -> bytes:
        if suffix == ".png":
            import cv2

            return cv2.imencode(".png", np.full((size_wh[1], size_wh[0], 3), 10 * number % 256, np.uint8))[1].tobytes()
        if name == "oxts":
            return oxts_row(lon=8.434 + 1e-5 * number).encode() + b"\n"
        points = np.array([[10 + number, 1, -1.5, 0.25], [20.125, -3, 0, 0.5]], "<f4")
        if suffix == ".bin":
            return points.tobytes()
        return "".join(" ".join(map(str, row)) + "\n" for row in points.tolist()).encode()

    def file(self, sensor: str, number: int) -> Path:
        return next((self.folder / sensor / "data").glob(f"{number:010d}.*"))

    def stamps(self, sensor: str) -> Path:
        return self.folder / sensor / "timestamps.txt"

    def write_tracklets(self, *items: str) -> Path:
        path = self.folder / "tracklet_labels.xml"
        path.write_text(tracklets(*items))
        return path

    def imported(self, source: Path | None = None, skip: bool = False, frames: FrameRange | None = None) -> Imported:
        out, bad = self.root.parent / "out.mcap", BadInput(skip)
        asked = ImportRequest((self.folder.name,), frames or FrameRange(), bad)
        return Imported(out, import_one(Kitti(), source or self.root, out, asked).lines, bad)


@pytest.fixture
def drive(tmp_path: Path) -> MadeDrive:
    """Three frames of two cameras, LiDAR and IMU, synchronized and rectified."""
    return MadeDrive(tmp_path / "kitti")


@pytest.fixture
def extract(tmp_path: Path) -> MadeDrive:
    """Three files of each sensor, as recorded."""
    return MadeDrive(tmp_path / "kitti", "extract")


@pytest.fixture
def make_tracklet():
    """Makes the XML of one object."""
    return tracklet


@pytest.fixture
def make_oxts_row():
    """Makes a row of 30 values."""
    return oxts_row
