"""A clean log, and how to make it worse."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.replay.logs.builders import INFO, write

from fbench.replay.check.findings import Finding
from fbench.replay.check.log_check import CheckOptions, CheckResult, check_log
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

MS = 1_000_000
S = 1000 * MS
START = 1_700_000_000 * S
UPRIGHT = np.array([0.0, 0, 0, 1])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
JPEG = encode_jpeg(np.full((60, 80, 3), 90, np.uint8))
RIG = Rig(
    {
        "cam": Mount("camera", np.zeros(3), FORWARD),
        "lidar": Mount("lidar", np.zeros(3), UPRIGHT),
        "radar": Mount("radar", np.zeros(3), UPRIGHT),
    },
    {"cam": CameraModel(np.array([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]]), (80, 60))},
)

Items = list[Message | Truth]


def box(x: float, **fields: object) -> Boxes3D:
    one = {"center_m": np.array([[x, 0, 0]]), "size_lwh_m": np.array([[4.0, 2, 1.5]]), "yaw_rad": np.zeros(1)}
    return Boxes3D(**{**one, "track_id": np.array([1]), **fields})


def cloud(i: int, stamp_ns: int, late_ns: int = 10 * MS) -> PointCloud:
    return PointCloud("lidar", stamp_ns, stamp_ns + late_ns, np.full((5, 3), i + 1, np.float32))


def image(i: int, stamp_ns: int, data: bytes = JPEG) -> Image:
    return Image("cam", stamp_ns, stamp_ns + 5 * MS, data + bytes([i % 251]), "jpeg", (80, 60))


def scan(i: int, stamp_ns: int, late_ns: int = 2 * MS) -> RadarScan:
    return RadarScan("radar", stamp_ns, stamp_ns + late_ns, np.full((2, 3), i + 1, np.float32))


def clean(num: int = 20) -> Items:
    """LiDAR, camera, radar, poses and truth at 10 Hz."""
    items: Items = []
    for i in range(num):
        t = START + i * 100 * MS
        pose = Pose("gnss", t, t, np.array([float(i), 0, 0]), UPRIGHT)
        items += [cloud(i, t), image(i, t), scan(i, t), pose, Truth(t, t, box(10.0 + i))]
    return items


def changed(change: Callable[[Message | Truth], Message | Truth | None], items: Items) -> Items:
    """Apply `change` to all items; `None` drops one."""
    return [new for item in items if (new := change(item)) is not None]


def checked(
    path: Path, items: Iterable[Message | Truth] | None = None, rig: Rig = RIG, **options: object
) -> CheckResult:
    """Write the items in the order in which they were recorded, and check the log."""
    if items is not None:
        write(path, sorted(items, key=lambda m: m.log_ns), rig)
    faults = FaultLog()
    return check_log(open_log(path, faults), faults, CheckOptions(**options))


def write_moving(path: Path, at: int, items: Items) -> None:
    """Write a log whose radar is moved just before the item of this index, in the order of recording."""
    moved = replace(RIG.mounts["radar"], translation_m=np.array([0.1, 0, 0]))
    later = Rig({**RIG.mounts, "radar": moved}, RIG.cameras)
    with McapWriter(path, INFO, RIG) as writer:
        for i, item in enumerate(sorted(items, key=lambda m: m.log_ns)):
            if i == at:
                writer.write_rig(item.log_ns, later)
            writer.write(item)


def problems(result: CheckResult) -> list[tuple[str, str]]:
    return [(f.code, f.source) for f in result.findings if f.severity != "info"]


def found(result: CheckResult, code: str) -> Finding:
    (one,) = [f for f in result.findings if f.code == code]
    return one
