"""A log's coordinate frames, and reading a file with them."""

from pathlib import Path

import numpy as np

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.formats.open import open_boxes
from fbench.replay.logs.coordinate_frames import CoordinateFrames, tree_of
from fbench.replay.logs.setup import BoxSource

UPRIGHT = np.array([0.0, 0, 0, 1])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
LEFT = np.array([0.0, 0, np.sqrt(0.5), np.sqrt(0.5)])
S = 1_000_000_000


def coordinates(*cameras: str) -> CoordinateFrames:
    """A LiDAR 1 m ahead and 2 m up, turned to the left, and cameras at the origin that look ahead."""
    mounts = {"lidar": Mount("lidar", np.array([1.0, 0, 2]), LEFT)}
    mounts |= {name: Mount("camera", np.zeros(3), FORWARD) for name in cameras}
    rig = Rig(mounts, {name: CameraModel(np.eye(3), (1242, 375)) for name in cameras})
    return CoordinateFrames(rig, tree_of(rig), "base_link", {"lidar_frame": "lidar", "/cam/image": "cam"})


def read(path: Path, *cameras: str, faults: FaultLog | None = None, **source: str) -> list[Truth]:
    """All that a file holds, by default with one camera `cam`."""
    known = coordinates(*(cameras or ("cam",)))
    return list(open_boxes(BoxSource(path, **source), known, faults or FaultLog()).truths())


def form(path: Path) -> str:
    """What a file is taken for."""
    return open_boxes(BoxSource(path), coordinates("cam"), FaultLog()).format
