"""What a scene's log holds, in the order of time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fbench.datasets.nuscenes.database import DataRow, PoseRow
from fbench.datasets.nuscenes.findings import Findings
from fbench.datasets.nuscenes.folder import Folder
from fbench.datasets.nuscenes.radar import read_echoes
from fbench.datasets.nuscenes.scenes import Instant
from fbench.datasets.nuscenes.truth import SceneTruth
from fbench.replay.arrays import Float64
from fbench.replay.data import Image, Message, PointCloud, Pose, RadarScan, Rig, Truth
from fbench.replay.errors import LogError
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.imports.files import read_floats, read_image
from fbench.replay.imports.wish import BadInput

REFERENCE = "LIDAR_TOP"
EGO = "ego"
"""Name of the stream of poses."""
Rows = Sequence[tuple[DataRow, PoseRow | None]]
Keyframes = Mapping[tuple[int, str], tuple[DataRow, PoseRow | None]]
"""By sample and sensor."""
_US = 1000


@dataclass(frozen=True)
class Content:
    """Everything that the items of a scene come from."""

    folder: Folder
    rig: Rig
    chain: Sequence[Instant]
    samples: range
    rows: Rows
    """What sensors measured, in the order of stamps."""
    truth: SceneTruth | None
    """`None` where the set isn't labelled."""
    radar_filter: bool


class _Event(NamedTuple):
    """One item before its file is read."""

    stamp_us: int
    rank: int
    name: str
    frame_number: int | None
    row: DataRow | PoseRow


_POSE, _MEASURED, _TRUTH = range(3)
"""Ranks."""


def items(content: Content, found: Findings, bad: BadInput) -> Iterator[Message | Truth]:
    """Yield poses, messages and truth by stamp; at equal stamps in this order, sensors by name.

    Files and rows that can't be used go to `bad`.
    """
    keys = _keyframes(content, found, bad)
    events = [*_poses(content, bad), *_measurements(content, keys), *_truths(content, keys)]
    for event in sorted(events, key=lambda event: event[:3]):
        try:
            item = _item(content, event, found)
        except LogError as error:
            bad.met(error)
            continue
        yield item


def _keyframes(content: Content, found: Findings, bad: BadInput) -> Keyframes:
    keys: dict[tuple[int, str], tuple[DataRow, PoseRow | None]] = {}
    path = content.folder.table("sample_data")
    for row, pose in content.rows:
        if not row.is_key:
            continue
        if (row.sample, row.channel) in keys:
            token = content.chain[row.sample].token
            bad.met(LogError(f"{path}: row with token '{row.token}': a second {row.channel} of sample '{token}'"))
        else:
            keys[row.sample, row.channel] = row, pose
    for sample in content.samples:
        for name in sorted({REFERENCE, *content.rig.mounts}):
            if (sample, name) not in keys:
                found.gaps.setdefault(name, []).append(sample)
        if (sample, REFERENCE) not in keys:
            bad.met(LogError(f"{path}: sample '{content.chain[sample].token}' has no keyframe of {REFERENCE}"))
    return keys


def _poses(content: Content, bad: BadInput) -> Iterator[_Event]:
    """One for each instant that has any; the LiDAR's goes before those of other sensors."""
    path = content.folder.table("ego_pose")
    at: dict[int, tuple[bool, DataRow, PoseRow]] = {}
    for row, pose in content.rows:
        if pose is None:
            what = f"no row with token '{row.pose}', which sample_data '{row.token}' names"
            bad.met(LogError(f"{path}: {what}"))
            continue
        is_reference = row.channel == REFERENCE
        if pose.stamp_us not in at or (is_reference and not at[pose.stamp_us][0]):
            at[pose.stamp_us] = is_reference, row, pose
    for stamp_us, (is_reference, row, pose) in at.items():
        yield _Event(stamp_us, _POSE, EGO, row.sample if is_reference and row.is_key else None, pose)


def _measurements(content: Content, keys: Keyframes) -> Iterator[_Event]:
    for row, _ in content.rows:
        if not row.is_key:
            yield _Event(row.stamp_us, _MEASURED, row.channel, None, row)
        elif keys[row.sample, row.channel][0] == row:
            yield _Event(row.stamp_us, _MEASURED, row.channel, row.sample, row)


def _truths(content: Content, keys: Keyframes) -> Iterator[_Event]:
    for sample in content.samples if content.truth is not None else ():
        row, pose = keys.get((sample, REFERENCE), (None, None))
        if row is not None and pose is not None:
            yield _Event(row.stamp_us, _TRUTH, "", sample, pose)


def _item(content: Content, event: _Event, found: Findings) -> Message | Truth:
    if isinstance(event.row, DataRow):
        message = _message(content, event.row, event.frame_number, found)
        (found.sweeps if event.frame_number is None else found.keyframes)[event.name] += 1
        return message
    if event.rank == _TRUTH and content.truth is not None and event.frame_number is not None:
        return _truth(content.truth, event.stamp_us * _US, event.frame_number, event.row, found)
    found.poses += 1
    stamp_ns = event.stamp_us * _US
    return Pose(EGO, stamp_ns, stamp_ns, *_placed(event.row), event.frame_number)


def _truth(truth: SceneTruth, stamp_ns: int, sample: int, pose: PoseRow, found: Findings) -> Truth:
    boxes = truth.boxes(sample, pose_matrix(*_placed(pose)))
    found.add_boxes(boxes)
    return Truth(stamp_ns, stamp_ns, boxes, frame_number=sample)


def _placed(pose: PoseRow) -> tuple[Float64, Float64]:
    """Position [m] and quaternion x, y, z, w."""
    return np.array([pose.x, pose.y, pose.z]), np.array([pose.qx, pose.qy, pose.qz, pose.qw])


def _message(
    content: Content, row: DataRow, frame_number: int | None, found: Findings
) -> Image | PointCloud | RadarScan:
    path, stamp_ns = content.folder.file(row.filename), row.stamp_us * _US
    kind = content.rig.mounts[row.channel].kind
    if kind == "camera":
        size_wh = content.rig.cameras[row.channel].size_wh
        return read_image(path, row.channel, stamp_ns, size_wh, frame_number=frame_number)
    if kind == "lidar":
        return _cloud(path, row.channel, stamp_ns, frame_number)
    echoes = read_echoes(path, content.radar_filter)
    found.echoes += len(echoes.xyz) + echoes.num_dropped
    found.dropped += echoes.num_dropped
    return RadarScan(
        row.channel, stamp_ns, stamp_ns, echoes.xyz, echoes.radial_velocity_mps, echoes.rcs_dbsm,
        frame_number=frame_number,
    )  # fmt: skip


def _cloud(path: Path, sensor: str, stamp_ns: int, frame_number: int | None) -> PointCloud:
    """Read x, y, z [m], intensity (0 to 255) and ring of each point."""
    table = read_floats(path, 5)
    ring = table[:, 4]
    # Other numbers also tell of columns and bytes in another order.
    if not np.all((ring >= 0) & (ring < 2**16) & (ring == np.floor(ring))):
        raise LogError(f"{path}: rings aren't numbers from 0 to 65535, expected x, y, z, intensity and ring")
    xyz, intensity = np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3])
    return PointCloud(sensor, stamp_ns, stamp_ns, xyz, intensity, ring.astype(np.uint16), frame_number=frame_number)
