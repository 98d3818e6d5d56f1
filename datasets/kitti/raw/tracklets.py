"""Tracklets of KITTI's raw drives: 3D boxes of objects over time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.kitti.raw.xml import Element, TrackletElement, TrackletsXml
from fbench.replay.arrays import Int64, text_array
from fbench.replay.boxes import Boxes3D
from fbench.replay.classes import label
from fbench.replay.data import Float64
from fbench.replay.errors import LogError
from fbench.replay.geometry.boxes import moved
from fbench.replay.imports.files import read_bytes

FILE = "tracklet_labels.xml"
STATES = {0: "", 1: "interpolated", 2: "labelled"}
"""`attribute` of boxes by <state>: whether a person placed the box, or it lies between two which one placed."""
_CLASSES = {"Person (sitting)": "Person_sitting"}
"""Names that other benchmarks of KITTI write differently."""
_UNKNOWN = -1
_MAX_BYTES = 2**26


@dataclass(frozen=True, eq=False)
class Tracklets:
    """All boxes of a drive, by frame."""

    boxes: Boxes3D
    """In body coordinates, those of one frame after those of another, in the order of the file."""
    frame: Int64
    """(N,) of each box, ascending."""
    num_tracks: int

    def of(self, frame: int) -> Boxes3D:
        """Return the boxes of a frame, none where it has none."""
        first, stop = np.searchsorted(self.frame, [frame, frame + 1])
        return self.boxes[int(first) : int(stop)]


@dataclass(frozen=True, eq=False)
class _Track:
    """One object; M boxes, one a frame."""

    source_label: str
    first_frame: int
    size_lwh_m: tuple[float, float, float]
    poses: Float64
    """(M, 9): position of the bottom's middle [m], rx, ry, rz [rad], state, occlusion, truncation."""


def read_tracklets(path: Path, body_T_velo: Float64, met: Callable[[LogError], None]) -> Tracklets:
    """Read a drive's boxes; `track_id` is the place of the tracklet in the file, from 0 on.

    Position and rotation R = Rz(rz) Ry(ry) Rx(rx) are in the LiDAR's coordinates. Occlusion (0 visible, 1 partly,
    2 fully) and truncation (0 in the image, 1 truncated, 2 outside of it, 99 behind it) keep KITTI's levels, -1
    becomes NaN; see `tracklets.h` of the raw devkit.

    Args:
        path: `tracklet_labels.xml`.
        body_T_velo: (4, 4).
        met: Is told what is wrong with single tracklets, which are left out.

    Raises:
        LogError: where the file can't be used at all.
    """
    tracks: dict[int, _Track] = {}
    for index, element in enumerate(TrackletsXml(path).tracklets(read_bytes(path, _MAX_BYTES))):
        try:
            tracks[index] = _track(element)
        except LogError as error:
            met(error)
    boxes, frame = _joined(tracks)
    order = np.argsort(frame, kind="stable")
    return Tracklets(moved(boxes[order], body_T_velo), frame[order], len(tracks))


def _track(element: TrackletElement) -> _Track:
    lwh = (element.real("l"), element.real("w"), element.real("h"))
    if min(lwh) <= 0:
        raise LogError(f"{element.where}: the box has no size (h {lwh[2]:g}, w {lwh[1]:g}, l {lwh[0]:g})")
    poses = np.array([_pose(pose) for pose in element.poses]).reshape(-1, 9)
    told = element.num_poses or Element(element.path, element.line, "poses")
    if (count := told.count("count")) != len(poses):
        raise LogError(f"{told.where}: <count> is {count}, but there are {len(poses)}")
    return _Track(element.text("objectType"), element.count("first_frame"), lwh, poses)


def _pose(element: Element) -> tuple[float, ...]:
    if (state := element.real("state")) not in STATES:
        raise LogError(f"{element.where}: <state> is {state:g}, expected one of {', '.join(map(str, STATES))}")
    names = ("tx", "ty", "tz", "rx", "ry", "rz", "state", "occlusion", "truncation")
    return tuple(element.real(name) for name in names)


def _joined(tracks: Mapping[int, _Track]) -> tuple[Boxes3D, Int64]:
    """Return the boxes in the LiDAR's coordinates, and their frames."""
    if not tracks:
        return Boxes3D.empty(), np.zeros(0, np.int64)
    rows = [len(track.poses) for track in tracks.values()]
    poses = np.concatenate([track.poses for track in tracks.values()])
    lwh = np.repeat([track.size_lwh_m for track in tracks.values()], rows, axis=0)
    names = [track.source_label for track in tracks.values()]
    boxes = Boxes3D(
        _centers(poses, lwh[:, 2]),
        lwh,
        poses[:, 5],
        pitch_rad=poses[:, 4],
        roll_rad=poses[:, 3],
        label=np.repeat(np.array([label(_CLASSES.get(name, name)) for name in names], np.str_), rows),
        source_label=np.repeat(text_array(names), rows),
        track_id=np.repeat(np.array(list(tracks), np.int64), rows),
        occlusion=_levels(poses[:, 7]),
        truncation=_levels(poses[:, 8]),
        attribute=np.array([STATES[state] for state in poses[:, 6]], np.str_),
    )
    frames = [track.first_frame + np.arange(len(track.poses)) for track in tracks.values()]
    return boxes, np.concatenate(frames)


def _centers(poses: Float64, height_m: Float64) -> Float64:
    """Return the middles (N, 3), half a height above the bottoms, along the boxes' own axes."""
    up = np.zeros((len(poses), 3))
    up[:, 2] = height_m / 2
    turned: Float64 = Rotation.from_euler("ZYX", poses[:, [5, 4, 3]]).apply(up) if len(poses) else up
    return poses[:, :3] + turned


def _levels(values: Float64) -> Float64:
    return np.where(values == _UNKNOWN, np.nan, values)
