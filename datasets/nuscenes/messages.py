"""Messages of a scene's log in the order of time, and findings for the import's summary."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fbench.datasets.importing.files import format_counts, format_list, read_floats, read_image
from fbench.datasets.nuscenes.opened import Excerpt
from fbench.datasets.nuscenes.sensors import read_echoes
from fbench.datasets.nuscenes.tables import DataRow, Folder, Instant, PoseRow
from fbench.datasets.nuscenes.truth import LABELS, SceneTruth
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import KINDS, Rig
from fbench.replay.geometry.transforms import pose_matrix

_LISTED = 10


@dataclass
class Findings:
    """Counts of one scene."""

    keyframes: Counter[str] = field(default_factory=Counter)  # By sensor
    sweeps: Counter[str] = field(default_factory=Counter)
    gaps: dict[str, list[int]] = field(default_factory=dict)  # Samples that lack a keyframe, by sensor
    poses: int = 0
    echoes: int = 0
    dropped: int = 0  # Echoes that the filter dropped
    categories: Counter[str] = field(default_factory=Counter)
    tracks: set[int] = field(default_factory=set)
    with_velocity: int = 0
    labeled: int = 0  # Samples with truth

    def add_boxes(self, boxes: Boxes3D) -> None:
        """Count truth."""
        self.labeled += 1
        if boxes.source_label is not None and boxes.track_id is not None and boxes.velocity_mps is not None:
            self.categories.update(boxes.source_label.tolist())
            self.tracks.update(boxes.track_id.tolist())
            self.with_velocity += int(np.isfinite(boxes.velocity_mps).all(axis=1).sum())


def summary_lines(found: Findings, excerpt: Excerpt, rig: Rig, filtered: bool) -> list[str]:
    """Say what was found and what was odd."""
    lines = list(_sensor_lines(found, excerpt, rig))
    if rig.sensors("radar") and filtered:
        dropped = f"dropped {found.dropped} of {found.echoes} echoes"
        lines.append(f"radar: the filter {dropped}; --set radar_filter=false keeps them")
    if not found.labeled:
        return [*lines, "boxes: none, the set isn't labelled"]
    names, total = format_counts(found.categories), found.categories.total()
    facts = f"{len(found.tracks)} tracks, {found.with_velocity} with velocity"
    lines.append(f"boxes: {total}{f' ({names})' if names else ''}, {facts}")
    if unknown := sorted(name for name in found.categories if name not in LABELS):
        lines.append(f"categories that nuScenes lacks, taken as 'other': {', '.join(unknown)}")
    return lines


def _sensor_lines(found: Findings, excerpt: Excerpt, rig: Rig) -> Iterator[str]:
    samples, chain = excerpt.samples, excerpt.chain
    seconds = (chain[samples[-1]].stamp_us - chain[samples[0]].stamp_us) / 1e6 if samples else 0.0
    yield f"samples: {len(samples)} of {len(chain)}, {seconds:.1f} s"
    for kind in KINDS:
        names = rig.sensors(KINDS[kind])
        keys, sweeps = sum(found.keyframes[name] for name in names), sum(found.sweeps[name] for name in names)
        if names:
            yield f"{kind}: {len(names)} ({', '.join(names)}), {keys} keyframes, {sweeps} sweeps"
    yield f"poses: {found.poses}"
    gaps = [f"{name} {format_list(numbers, _LISTED)}" for name, numbers in sorted(found.gaps.items())]
    yield f"samples without a keyframe: {'; '.join(gaps) or 'none'}"


REFERENCE = "LIDAR_TOP"
EGO = "ego"  # Name of the stream of poses
Rows = Sequence[tuple[DataRow, PoseRow | None]]
Keyframes = Mapping[tuple[int, str], tuple[DataRow, PoseRow | None]]  # By sample and sensor
_US = 1000


@dataclass(frozen=True)
class Content:
    """Everything that the items of a scene come from."""

    folder: Folder
    rig: Rig
    chain: Sequence[Instant]
    samples: range
    rows: Rows  # What sensors measured, in the order of stamps
    truth: SceneTruth | None  # `None` where the set isn't labeled
    radar_filter: bool


class _Event(NamedTuple):
    """One item before its file is read."""

    stamp_us: int
    rank: int
    name: str
    frame_number: int | None
    row: DataRow | PoseRow


_POSE, _MEASURED, _TRUTH = range(3)  # Ranks


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
            bad.report(error)
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
            bad.report(LogError(f"{path}: row with token '{row.token}': a second {row.channel} of sample '{token}'"))
        else:
            keys[row.sample, row.channel] = row, pose
    for sample in content.samples:
        for name in sorted({REFERENCE, *content.rig.mounts}):
            if (sample, name) not in keys:
                found.gaps.setdefault(name, []).append(sample)
        if (sample, REFERENCE) not in keys:
            bad.report(LogError(f"{path}: sample '{content.chain[sample].token}' has no keyframe of {REFERENCE}"))
    return keys


def _poses(content: Content, bad: BadInput) -> Iterator[_Event]:
    """One for each instant that has any; the LiDAR's goes before those of other sensors."""
    path = content.folder.table("ego_pose")
    at: dict[int, tuple[bool, DataRow, PoseRow]] = {}
    for row, pose in content.rows:
        if pose is None:
            what = f"no row with token '{row.pose}', which sample_data '{row.token}' names"
            bad.report(LogError(f"{path}: {what}"))
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
    stamp_ns = event.stamp_us * _US
    position_m = np.array([event.row.x, event.row.y, event.row.z])
    quaternion = np.array([event.row.qx, event.row.qy, event.row.qz, event.row.qw])
    if event.rank == _TRUTH and content.truth is not None and event.frame_number is not None:
        boxes = content.truth.boxes(event.frame_number, pose_matrix(position_m, quaternion))
        found.add_boxes(boxes)
        return Truth(stamp_ns, stamp_ns, boxes, frame_number=event.frame_number)
    found.poses += 1
    return Pose(EGO, stamp_ns, stamp_ns, position_m, quaternion, event.frame_number)


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
