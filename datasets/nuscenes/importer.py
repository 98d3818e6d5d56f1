"""Importer of nuScenes: six cameras, a LiDAR, five radars, ego poses and 3D boxes.

H. Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020. Layout of the tables:
https://github.com/nutonomy/nuscenes-devkit, `docs/schema_nuscenes.md`.
"""

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fbench.datasets.importing.files import format_counts, format_list, read_floats, read_image
from fbench.datasets.nuscenes.opened import Excerpt, NuScenesSet, read_scenes
from fbench.datasets.nuscenes.rows import Scene
from fbench.datasets.nuscenes.sensors import read_scan, rigs_of
from fbench.datasets.nuscenes.tables import TABLES, DataRow, PoseRow, open_folder
from fbench.datasets.nuscenes.truth import LABELS, SceneTruth
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, describe_params, file_facts, log_id
from fbench.replay.data.messages import Message, PointCloud, Pose, Truth
from fbench.replay.data.rig import KINDS, LogInfo, Rig, RigChange
from fbench.replay.geometry.transforms import pose_matrix

REFERENCE = "LIDAR_TOP"
EGO = "ego"  # Name of the stream of poses
_LISTED = 10
_POSE, _MEASURED, _TRUTH = range(3)  # Ranks of what has equal stamps
TIMEOUT_MS = 100
"""How long frames wait: cameras measure up to 50 ms before the LiDAR's sweep ends, radars up to 80 ms away from it."""


@dataclass(frozen=True)
class NuScenesParams:
    """Parameters of `NuScenes`."""

    version: str = ""
    """Folder with the tables, such as v1.0-mini; needed where there are several."""
    sweeps: bool = True
    """Also import what was measured between keyframes; those messages have no frame number and no truth."""
    radar_filter: bool = True
    """Drop radar echoes as nuscenes-devkit does by default; see `radar.is_kept`."""


class NuScenes:
    """Reads `v1.0-NAME/*.json`, the tables, and the files that they name: `samples/SENSOR/*`, `sweeps/SENSOR/*`.

    The folder may also be the one with the tables, beside `samples/` and `sweeps/`. One scene becomes one log, named
    as the scene is. Messages of keyframes and their truth have the number of their sample within the scene, from 0 on,
    as frame number; `--frames` counts the same. Body coordinates are those of the ego vehicle.
    """

    def __init__(self, params: NuScenesParams = NuScenesParams()) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """Names of the scenes, sorted; see `Importer`."""
        return tuple(read_scenes(open_folder(source, self._params.version)))

    def recordings(self, source: Path, request: ImportRequest) -> Iterator["NuScenesRecording"]:
        """Open the scenes; the large tables are read once, when the first scene needs them; see `Importer`."""
        with closing(NuScenesSet(open_folder(source, self._params.version), self._params.sweeps, request)) as opened:
            for name in request.names:
                yield NuScenesRecording(opened, opened.scene(name), self._params, request)


class _Event(NamedTuple):
    """One item before its file is read."""

    stamp_us: int
    rank: int
    name: str
    frame_number: int | None
    row: DataRow | PoseRow


Keyframes = Mapping[tuple[int, str], tuple[DataRow, PoseRow | None]]  # By sample and sensor


class NuScenesRecording:
    """One scene; see `Recording`."""

    def __init__(self, opened: NuScenesSet, scene: Scene, params: NuScenesParams, request: ImportRequest) -> None:
        self._opened, self._scene, self._params, self._bad, self._frames = (
            opened,
            scene,
            params,
            request.bad,
            request.frames,
        )
        self.name = scene.name
        self._num_keyframes: Counter[str] = Counter()  # By sensor
        self._num_sweeps: Counter[str] = Counter()
        self._gaps: dict[str, list[int]] = {}  # Samples that lack a keyframe, by sensor
        self._num_poses, self._num_echoes, self._num_dropped = 0, 0, 0
        self._categories: Counter[str] = Counter()
        self._tracks: set[int] = set()
        self._num_with_velocity, self._num_labeled = 0, 0  # Boxes, and samples with truth

    @cached_property
    def _excerpt(self) -> Excerpt:
        return self._opened.excerpt(self._scene)

    @cached_property
    def _rows(self) -> Sequence[tuple[DataRow, PoseRow | None]]:
        """What sensors measured, in the order of stamps."""
        if not (rows := tuple(self._opened.database.data(self._opened.number(self._scene)))):
            part = "" if self._frames.is_whole else f" in frames {self._frames}"
            raise LogError(f"{self._opened.folder.table('sample_data')}: nothing was measured in {self.name}{part}")
        return rows

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the scene, from small tables alone."""
        folder, scene, chain = self._opened.folder, self._scene, self._excerpt.chain
        facts = [scene.token, *file_facts(folder.root, [folder.table(name) for name in TABLES])]
        drive = self._opened.drive(scene)
        metadata = {
            "dataset": "nuScenes",
            "licence": "CC BY-NC-SA 4.0",
            "reference": REFERENCE,
            "timeout_ms": str(TIMEOUT_MS),
            "stamps": "LiDAR: end of the sweep; cameras: trigger of the exposure; truth: that of LIDAR_TOP",
            "radar.radial_velocity": "(vx, vy) as measured, along the line of sight",
            "truth.visibility": "middle of the set's bin: 0.2, 0.5, 0.7 or 0.9",
            "description": scene.description,
            "location": drive.location,
            "vehicle": drive.vehicle,
            "date": drive.date_captured,
            "nuscenes.version": folder.version,
            "nuscenes.scene": scene.token,
            "nuscenes.log": scene.log_token,
            "nuscenes.logfile": drive.logfile,
            "nuscenes.sample_tokens": " ".join(instant.token for instant in chain),
            **describe_params(self._params),
        }
        return LogInfo(scene.name, log_id("nuscenes", facts, self._frames, self._params), metadata)

    @cached_property
    def _rigs(self) -> list[tuple[int, Rig]]:
        """Those of the chosen part, each with the stamp [us] from which on it holds."""
        return rigs_of([row for row, _ in self._rows], self._opened.tables, self.name)

    @property
    def rig(self) -> Rig:
        """Sensors that measured something in the chosen part, and their calibration as it begins."""
        return self._rigs[0][1]

    @property
    def num_items(self) -> int:
        """Measurements, as many poses, and truth."""
        return 2 * len(self._rows) + len(self._excerpt.samples)

    def items(self) -> Iterator[Message | Truth | RigChange]:
        """Poses, measurements and truth by stamp; at equal stamps in this order, sensors by name. Before what a changed
        calibration holds for comes the rig.
        """
        boxes, truth = self._opened.database.annotations(self._opened.number(self._scene)), None
        if self._opened.is_labeled:
            truth = SceneTruth(boxes, self._excerpt.chain, self._opened.tables, self._bad)
        events = self._events(self._keyframes(), truth is not None)
        rig, later = self.rig, deque(self._rigs[1:])
        for event in sorted(events, key=lambda event: event[:3]):
            while later and event.stamp_us >= later[0][0]:
                stamp_us, new = later.popleft()
                yield RigChange(stamp_us * 1000, new, new.list_changes(rig))
                rig = new
            try:
                item = self._item(event, truth, rig)
            except LogError as error:
                self._bad.report(error)
                continue
            yield item

    def _keyframes(self) -> Keyframes:
        keys: dict[tuple[int, str], tuple[DataRow, PoseRow | None]] = {}
        path, chain = self._opened.folder.table("sample_data"), self._excerpt.chain
        for row, pose in self._rows:
            if row.is_key and keys.setdefault((row.sample, row.channel), (row, pose))[0] is not row:
                why = f"a second {row.channel} of sample '{chain[row.sample].token}'"
                self._bad.report(LogError(f"{path}: row with token '{row.token}': {why}"))
        for sample in self._excerpt.samples:
            for name in sorted({REFERENCE, *self.rig.mounts}):
                if (sample, name) not in keys:
                    self._gaps.setdefault(name, []).append(sample)
            if (sample, REFERENCE) not in keys:
                why = f"sample '{chain[sample].token}' has no keyframe of {REFERENCE}"
                self._bad.report(LogError(f"{path}: {why}"))
        return keys

    def _events(self, keys: Keyframes, is_labeled: bool) -> Iterator[_Event]:
        """A pose for each instant that has any, the LiDAR's before those of other sensors; messages; truth."""
        path = self._opened.folder.table("ego_pose")
        poses: dict[int, tuple[bool, DataRow, PoseRow]] = {}
        for row, pose in self._rows:
            if pose is None:
                why = f"no row with token '{row.pose}', which sample_data '{row.token}' names"
                self._bad.report(LogError(f"{path}: {why}"))
                continue
            is_reference = row.channel == REFERENCE
            if pose.stamp_us not in poses or (is_reference and not poses[pose.stamp_us][0]):
                poses[pose.stamp_us] = is_reference, row, pose
        for stamp_us, (is_reference, row, pose) in poses.items():
            yield _Event(stamp_us, _POSE, EGO, row.sample if is_reference and row.is_key else None, pose)
        for row, _ in self._rows:
            if not row.is_key or keys[row.sample, row.channel][0] == row:
                yield _Event(row.stamp_us, _MEASURED, row.channel, row.sample if row.is_key else None, row)
        for sample in self._excerpt.samples if is_labeled else ():
            key, pose = keys.get((sample, REFERENCE), (None, None))
            if key is not None and pose is not None:
                yield _Event(key.stamp_us, _TRUTH, "", sample, pose)

    def _item(self, event: _Event, truth: SceneTruth | None, rig: Rig) -> Message | Truth:
        row, stamp_ns, number = event.row, event.stamp_us * 1000, event.frame_number
        if isinstance(row, DataRow):
            message = self._message(row, stamp_ns, number, rig)
            (self._num_sweeps if number is None else self._num_keyframes)[event.name] += 1
            return message
        position_m, quaternion = np.array([row.x, row.y, row.z]), np.array([row.qx, row.qy, row.qz, row.qw])
        if event.rank == _POSE or truth is None or number is None:
            self._num_poses += 1
            return Pose(EGO, stamp_ns, stamp_ns, position_m, quaternion, number)
        boxes = truth.boxes(number, pose_matrix(position_m, quaternion))
        self._num_labeled += 1
        if boxes.source_label is not None and boxes.track_id is not None and boxes.velocity_mps is not None:
            self._categories.update(boxes.source_label.tolist())
            self._tracks.update(boxes.track_id.tolist())
            self._num_with_velocity += int(np.isfinite(boxes.velocity_mps).all(axis=1).sum())
        return Truth(stamp_ns, stamp_ns, boxes, frame_number=number)

    def _message(self, row: DataRow, stamp_ns: int, number: int | None, rig: Rig) -> Message:
        path, name, kind = self._opened.folder.file(row.filename), row.channel, rig.mounts[row.channel].kind
        if kind == "camera":
            return read_image(path, name, stamp_ns, rig.cameras[name].size_wh, frame_number=number)
        if kind == "lidar":
            table = read_floats(path, 5)
            ring = table[:, 4]
            # Other numbers also show that columns and bytes are in another order.
            if not np.all((ring >= 0) & (ring < 2**16) & (ring == np.floor(ring))):
                raise LogError(f"{path}: rings aren't numbers from 0 to 65535, expected x, y, z, intensity and ring")
            xyz, intensity = np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3])  # [m], 0 to 255
            return PointCloud(name, stamp_ns, stamp_ns, xyz, intensity, ring.astype(np.uint16), frame_number=number)
        scan, num_dropped = read_scan(path, name, stamp_ns, self._params.radar_filter, number)
        self._num_echoes += len(scan.xyz) + num_dropped
        self._num_dropped += num_dropped
        return scan

    def summary(self) -> Sequence[str]:
        """What was found and what was odd."""
        samples, chain = self._excerpt.samples, self._excerpt.chain
        seconds = (chain[samples[-1]].stamp_us - chain[samples[0]].stamp_us) / 1e6 if samples else 0.0
        lines = [f"scene: {self._scene.description or self.name}"]
        lines.append(f"samples: {len(samples)} of {len(chain)}, {seconds:.1f} s")
        for kind in KINDS:
            if names := self.rig.sensors(KINDS[kind]):
                keys, sweeps = (sum(num[name] for name in names) for num in (self._num_keyframes, self._num_sweeps))
                lines.append(f"{kind}: {len(names)} ({', '.join(names)}), {keys} keyframes, {sweeps} sweeps")
        lines.append(f"poses: {self._num_poses}")
        gaps = [f"{name} {format_list(numbers, _LISTED)}" for name, numbers in sorted(self._gaps.items())]
        lines.append(f"samples without a keyframe: {'; '.join(gaps) or 'none'}")
        if len(self._rigs) > 1:
            first_us = self._rows[0][0].stamp_us
            times = format_list((f"{(stamp_us - first_us) / 1e6:.1f} s" for stamp_us, _ in self._rigs[1:]), _LISTED)
            lines.append(f"calibration changes after {times}: a new segment begins there")
        if self.rig.sensors("radar") and self._params.radar_filter:
            dropped = f"dropped {self._num_dropped} of {self._num_echoes} echoes"
            lines.append(f"radar: the filter {dropped}; --set radar_filter=false keeps them")
        if not self._num_labeled:
            return [*lines, "boxes: none, the set isn't labelled"]
        counts, total = format_counts(self._categories), self._categories.total()
        facts = f"{len(self._tracks)} tracks, {self._num_with_velocity} with velocity"
        lines.append(f"boxes: {total}{f' ({counts})' if counts else ''}, {facts}")
        if unknown := sorted(self._categories.keys() - LABELS.keys()):
            lines.append(f"categories that nuScenes lacks, taken as 'other': {', '.join(unknown)}")
        return lines
