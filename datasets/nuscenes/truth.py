"""Boxes of a nuScenes scene: velocities, classes and visibility.

Rules: https://github.com/nutonomy/nuscenes-devkit, `NuScenes.box_velocity`, and `docs/schema_nuscenes.md`.
"""

import re
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.nuscenes.opened import Instant
from fbench.datasets.nuscenes.tables import AnnotationRow, Tables
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput
from fbench.replay.data.arrays import Float64, text_array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.classes import label as fbench_label
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse

_OTHERS = ("barrier", "debris", "pushable_pullable", "trafficcone")
_PEDESTRIANS = ("adult", "child", "construction_worker", "personal_mobility", "police_officer", "wheelchair")
LABELS = {
    **dict.fromkeys(("animal", "human.pedestrian.stroller", "static_object.bicycle_rack"), "other"),
    **{f"movable_object.{kind}": "other" for kind in _OTHERS},
    **{f"human.pedestrian.{kind}": "pedestrian" for kind in _PEDESTRIANS},
    **{f"vehicle.{kind}": kind for kind in ("bicycle", "car", "motorcycle", "trailer", "truck")},
    **dict.fromkeys(("vehicle.bus.bendy", "vehicle.bus.rigid"), "bus"),
    "vehicle.construction": "truck",
    "vehicle.emergency.ambulance": "van",
    "vehicle.emergency.police": "car",
}
"""All categories of the set; other sets in its layout may have plain names. Boxes of those on small vehicles and in
wheelchairs hold person and vehicle; a stroller is labeled beside whoever pushes it.
"""
IGNORED = frozenset({"static_object.bicycle_rack"})
"""Neither hit nor miss: the bicycles in a rack aren't labeled (the set's instructions for annotators)."""
MAX_STEP_US = 1_500_000
"""Positions farther apart in time give no velocity; twice this from the one before to the one after."""


class SceneTruth:
    """The boxes of one scene."""

    def __init__(self, rows: Iterable[AnnotationRow], chain: Sequence[Instant], tables: Tables, bad: BadInput) -> None:
        """Begin with all boxes of a scene, in the order of samples; those that can't be used go to `bad`."""
        self._chain, self._tables, self._bad = chain, tables, bad
        self._path = tables.folder.table("sample_annotation")
        self._by_token: dict[str, AnnotationRow] = {}
        self._by_sample: dict[int, list[AnnotationRow]] = {}
        self._tracks: dict[str, int] = {}
        for row in rows:
            if row.token in self._by_token:
                bad.report(LogError(f"{self._path}: two rows have the token '{row.token}'"))
                continue
            self._by_token[row.token] = row
            self._by_sample.setdefault(row.sample, []).append(row)
            self._tracks.setdefault(row.instance, len(self._tracks) + 1)

    def boxes(self, sample: int, world_T_body: Float64) -> Boxes3D:
        """Return the boxes of a sample in body coordinates, in the order of the table.

        `track_id` counts the scene's instances from 1 in the order in which they appear. `visibility` is the middle
        of the set's bin, 0.2, 0.5, 0.7 or 0.9, NaN where there is none. `velocity_mps` is over ground, NaN where the
        set gives none. Several attributes are separated by commas.
        """
        found, tables = [], self._tables
        for row in self._by_sample.get(sample, []):
            try:
                attributes = ",".join(tables.attributes[token].name for token in row.attributes.split())
                category = tables.categories[tables.instances[row.instance]].name
                found.append((row, category, attributes, self._velocity(row), self._visibility(row)))
            except LogError as error:
                self._bad.report(error)
        rows, categories = [own[0] for own in found], [own[1] for own in found]
        angles = np.zeros((0, 3))
        if rows:
            turns = Rotation.from_quat(np.array([(r.qx, r.qy, r.qz, r.qw) for r in rows]))
            angles = np.asarray(turns.as_euler("ZYX", suppress_warnings=True), np.float64)
        in_world = Boxes3D(
            center_m=np.array([(r.x, r.y, r.z) for r in rows]).reshape(-1, 3),
            size_lwh_m=np.array([(r.length, r.width, r.height) for r in rows]).reshape(-1, 3),
            yaw_rad=angles[:, 0],
            pitch_rad=angles[:, 1],
            roll_rad=angles[:, 2],
            velocity_mps=np.array([own[3] for own in found]).reshape(-1, 3),
            label=text_array([LABELS.get(name) or fbench_label(name) for name in categories]),
            track_id=np.array([self._tracks[row.instance] for row in rows], np.int64),
            visibility=np.array([own[4] for own in found]),
            attribute=text_array([own[2] for own in found]),
            num_lidar_pts=np.array([row.num_lidar_pts for row in rows], np.int64),
            num_radar_pts=np.array([row.num_radar_pts for row in rows], np.int64),
            ignore=np.array([name in IGNORED for name in categories], bool),
            source_label=text_array(categories),
        )
        return move_boxes(in_world, inverse(world_T_body))

    def _visibility(self, row: AnnotationRow) -> float:
        if not row.visibility:
            return np.nan
        level = self._tables.visibilities[row.visibility].level
        found = re.fullmatch(r"v([0-9]{1,3})-([0-9]{1,3})", level)
        if found is None or int(found[2]) > 100:
            raise LogError(f"{self._tables.folder.table('visibility')}: level '{level[:40]}' isn't such as v40-60")
        return (int(found[1]) + int(found[2])) / 200

    def _velocity(self, row: AnnotationRow) -> tuple[float, float, float]:
        """Central difference, or one to the only neighbor; NaN where there is none, or it is too far away in time."""
        before, after = self._neighbor(row, row.prev, is_next=False), self._neighbor(row, row.next, is_next=True)
        first, last = before or row, after or row
        step_us = self._chain[last.sample].stamp_us - self._chain[first.sample].stamp_us
        num_steps = (before is not None) + (after is not None)
        if num_steps == 0 or step_us > num_steps * MAX_STEP_US:
            return np.nan, np.nan, np.nan
        seconds = step_us / 1e6
        return (last.x - first.x) / seconds, (last.y - first.y) / seconds, (last.z - first.z) / seconds

    def _neighbor(self, row: AnnotationRow, token: str, is_next: bool) -> AnnotationRow | None:
        if not token:
            return None
        other = self._by_token.get(token)
        way = "next" if is_next else "prev"
        link = f"{self._path}: row with token '{row.token}': {way} is '{token}'"
        if other is None:
            raise LogError(f"{link}, which isn't in the scene")
        if other.instance != row.instance or (other.prev if is_next else other.next) != row.token:
            raise LogError(f"{link}, which doesn't link back, or is of another instance")
        if (other.sample > row.sample) != is_next or other.sample == row.sample:
            raise LogError(f"{link}, which isn't {'later' if is_next else 'earlier'}")
        return other
