"""Labels of RADIATE, boxes drawn on the Cartesian radar images, and findings of an import.

M. Sheeny, E. De Pellegrin, S. Mukherjee, A. Ahrabian, S. Wang and A. Wallace, "RADIATE: A Radar Dataset for Automotive
Perception in Bad Weather", ICRA 2021.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, StringConstraints

from fbench.datasets.importing.files import find_runs, format_counts, format_list, format_runs, read_json
from fbench.datasets.radiate.files import CARTESIAN, FOLDERS, GPS, POLAR, Due, SequenceFiles, Stream
from fbench.datasets.radiate.radar import RADAR, RANGE_STEP_M, RadiateParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput
from fbench.replay.data.arrays import Array, Bool, text_array
from fbench.replay.data.boxes import VEHICLES, Boxes3D
from fbench.replay.geometry.transforms import wrap_angle

CENTER_PX = 576  # Where the radar is in a Cartesian image, which has 1152 x 1152 px of one range step each; ahead is up

LABELS: Mapping[str, str] = {
    "car": "car", "van": "van", "truck": "truck", "bus": "bus", "motorbike": "motorcycle", "bicycle": "bicycle",
    "pedestrian": "pedestrian", "group_of_pedestrians": "pedestrian", "vehicle": "car",
}  # fmt: skip
"""Classes of the set; any other becomes `other`. The SDK draws `vehicle` as it draws `car`."""
GROUP = "group_of_pedestrians"  # One box around several people: neither a hit nor a miss
HEIGHTS_M: Mapping[str, float] = {
    "car": 1.5, "van": 2.0, "truck": 2.5, "bus": 3.0, "motorbike": 1.5, "bicycle": 1.5, "pedestrian": 1.8, GROUP: 1.8,
    "vehicle": 1.5,
}  # fmt: skip
"""Heights [m] with which the SDK draws boxes into camera images; labels have none."""
OTHER_HEIGHT_M = 1.5
_LISTED = 5
_LATE_S = 0.5  # Sensors that start or end so much later or earlier than the radar are reported
_Px = Annotated[float, Field(gt=-1e5, lt=1e5)]
_SizePx = Annotated[float, Field(gt=0, lt=1e5)]
_Nothing = Annotated[list[int], Field(max_length=0)]


class Box(BaseModel):
    """A box before it is turned about its middle: left, top, width, height [px], and the turn [deg]."""

    position: tuple[_Px, _Px, _SizePx, _SizePx]
    rotation: Annotated[float, Field(gt=-1e5, lt=1e5)]


class Object(BaseModel):
    """One object; slot k of `bboxes` is its box in radar frame k + 1, or an empty list."""

    id: Annotated[int, Field(ge=0, lt=2**62)]
    class_name: Annotated[str, StringConstraints(max_length=100)]
    bboxes: list[Box | _Nothing]


@dataclass(frozen=True)
class Annotations:
    """The objects of a sequence, each with an id of its own."""

    objects: Sequence[Object]

    @property
    def num_slots(self) -> int:
        """How many radar frames are labeled, from the first one on."""
        return max((len(o.bboxes) for o in self.objects), default=0)

    def boxes(self, number: int, radar_height_m: float) -> Boxes3D | None:
        """Return what was there in a radar frame (the first is 1), in body coordinates; `None` where it isn't labeled.

        Boxes stand on the road, `radar_height_m` below the radar; their heights are those of their classes. Length is
        along the box's height in the image: boxes of oncoming vehicles are turned by 180 degrees, which tells that the
        turn is that of the heading. It is counter-clockwise (SDK, `gen_boundingbox_rot`).
        """
        if not 1 <= number <= self.num_slots:
            return None
        slots = ((o, o.bboxes[number - 1]) for o in self.objects if number <= len(o.bboxes))
        found = [(o, box) for o, box in slots if isinstance(box, Box)]
        left, top, width, height = np.array([box.position for _, box in found], np.float64).reshape(-1, 4).T
        tall_m = np.array([HEIGHTS_M.get(o.class_name, OTHER_HEIGHT_M) for o, _ in found], np.float64)
        forward_m = (CENTER_PX - (top + height / 2)) * RANGE_STEP_M
        left_m = (CENTER_PX - (left + width / 2)) * RANGE_STEP_M
        return Boxes3D(
            center_m=np.stack([forward_m, left_m, tall_m / 2 - radar_height_m], axis=1),
            size_lwh_m=np.stack([height * RANGE_STEP_M, width * RANGE_STEP_M, tall_m], axis=1),
            yaw_rad=wrap_angle(np.radians(np.array([box.rotation for _, box in found], np.float64))),
            label=text_array([LABELS.get(o.class_name, "other") for o, _ in found]),
            track_id=np.array([o.id for o, _ in found], np.int64),
            ignore=np.array([o.class_name == GROUP for o, _ in found], np.bool_),
            source_label=text_array([o.class_name for o, _ in found]),
        )


def read_annotations(path: Path, bad: BadInput) -> Annotations:
    """Read `annotations.json`. Raises LogError naming object and field that are wrong, or ids that aren't unique."""
    by_id: dict[int, Object] = {}
    for i, o in enumerate(read_json(path, list[Object])):
        if o.id in by_id:
            bad.report(LogError(f"{path}: {i}: another object has the id {o.id} already"))
        else:
            by_id[o.id] = o
    return Annotations(list(by_id.values()))


def inside_bev(boxes: Boxes3D, xyz: Array) -> Bool:
    """Tell which points (M, 3) are in which boxes (N,) from above: (N, M)."""
    x = xyz[None, :, 0] - boxes.center_m[:, 0, None]
    y = xyz[None, :, 1] - boxes.center_m[:, 1, None]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    half = boxes.size_lwh_m[:, :2, None] / 2
    inside: Bool = (np.abs(cos * x + sin * y) <= half[:, 0]) & (np.abs(cos * y - sin * x) <= half[:, 1])
    return inside


@dataclass
class Findings:
    """Counts what was imported."""

    messages: Counter[str] = field(default_factory=Counter)  # By sensor
    radar_points: int = 0
    classes: Counter[str] = field(default_factory=Counter)
    tracks: set[int] = field(default_factory=set)
    hits: list[int] = field(default_factory=list)  # Radar points on each labeled vehicle whose scan is there
    unlabeled: int = 0
    wide: int = 0  # Boxes that are wider than long

    def add_boxes(self, boxes: Boxes3D) -> None:
        """Count what was labeled at one instant."""
        if boxes.source_label is None or boxes.track_id is None or boxes.label is None:
            return
        self.classes.update(boxes.source_label.tolist())
        self.tracks.update(boxes.track_id.tolist())
        self.wide += int((boxes.size_lwh_m[:, 1] > boxes.size_lwh_m[:, 0]).sum())
        if boxes.num_radar_pts is not None:
            pairs = zip(boxes.label.tolist(), boxes.num_radar_pts.tolist(), strict=True)
            self.hits += [num for label, num in pairs if label in VEHICLES]

    def lines(
        self, files: SequenceFiles, dues: Sequence[Due], num_slots: int | None, params: RadiateParams
    ) -> Iterator[str]:
        """Yield a line about each thing that was found or is odd."""
        yield "messages: " + ", ".join(f"{name} {self.messages[name]}" for name in FOLDERS if self.messages[name])
        yield from _stream_lines(files)
        if GPS in files.streams and (fixes := list(files.streams[GPS].stamps.values())):
            late_s = (min(fixes) - min(files.streams[RADAR].stamps.values())) / 1e9 + params.gps_offset_s
            yield from self._pose_lines(len(fixes), len(set(fixes)), sum(due.sensor == GPS for due in dues), late_s)
        yield from self._label_lines(files.streams[RADAR], num_slots)
        if num := self.messages[RADAR]:
            yield f"radar: {self.radar_points / num:.0f} points a scan by CFAR, without Doppler; rcs is a grey value"
        if num := len(self.hits):
            one, three = (sum(hit >= least for hit in self.hits) for least in (1, 3))
            shares = f"{one} ({one / num:.1%}) have a radar point, {three} ({three / num:.1%}) three"
            yield f"radar: of {num} labeled vehicles {shares} or more"
        yield "stamps: as recorded, times of arrival; `fbench log check` looks for offsets between sensors"

    def _pose_lines(self, num: int, unique: int, chosen: int, late_s: float) -> Iterator[str]:
        """About so many fixes, with so many times, of which so many are imported."""
        if unique < num:
            yield f"{GPS}: {num - unique} of {num} fixes repeat a time, left out"
        if chosen < unique:
            left_out = f"{unique - chosen} fixes left out, taken over 2 s away from what is imported"
            start = f"they start {abs(late_s):.2f} s {'after' if late_s >= 0 else 'before'} the radar does"
            yield f"{GPS}: {left_out} ({start}); --set gps_offset_s=SECONDS moves them"
        if self.messages[GPS] < chosen:
            yield f"{GPS}: {chosen - self.messages[GPS]} fixes without a heading or unreadable, left out"

    def _label_lines(self, radar: Stream, num_slots: int | None) -> Iterator[str]:
        if num_slots is None:
            yield "boxes: no labels"
            return
        classes = format_counts(self.classes)
        yield f"boxes: {self.classes.total()}{f' ({classes})' if classes else ''}, {len(self.tracks)} tracks"
        if num_slots != (last := max([*radar.stamps, *radar.no_file])):
            yield f"labels: slots for {num_slots} radar frames, there are {last}; slot k belongs to frame k + 1"
        if self.unlabeled:
            yield f"unlabeled radar frames: {self.unlabeled}, beyond the slots of the labels"
        if unknown := sorted(self.classes.keys() - LABELS.keys()):
            yield f"classes that the set lacks, taken as 'other': {format_list(unknown, _LISTED)}"
        if self.wide:
            yield f"boxes wider than long: {self.wide}, as labelled"
        yield "boxes: heights and where they stand are assumed, labels are from above"


def _stream_lines(files: SequenceFiles) -> Iterator[str]:
    radar = files.streams[RADAR].stamps
    for sensor, stream in files.streams.items():
        table = f"{FOLDERS[sensor]}.txt"
        if num := len(stream.no_file):
            yield f"left out, without a file: {num} times of {table} ({_frames(stream.no_file)})"
        if num := len(stream.no_stamp):
            yield f"left out, without a time in {table}: {num} files ({_frames(stream.no_stamp)})"
    if other := sum(files.cartesian.get(number, stamp) != stamp for number, stamp in radar.items()):
        yield f"times of {POLAR}.txt are not those of {CARTESIAN}.txt: {other} frames; the former were taken"
    first_ns, last_ns = min(radar.values()), max(radar.values())
    for sensor, stream in files.streams.items():
        stamps = list(stream.stamps.values())
        if not stamps:
            yield f"{sensor}: no file with a time"
            continue
        if back := sum(b < a for a, b in pairwise(stamps)):
            yield f"{sensor}: time runs backwards before {back} of {len(stamps)} files, which were put in order"
        late_s, early_s = (min(stamps) - first_ns) / 1e9, (last_ns - max(stamps)) / 1e9
        if sensor != GPS and abs(late_s) > _LATE_S:
            yield f"{sensor}: starts {abs(late_s):.2f} s {'after' if late_s >= 0 else 'before'} the radar does"
        if sensor != GPS and abs(early_s) > _LATE_S:
            yield f"{sensor}: ends {abs(early_s):.2f} s {'before' if early_s >= 0 else 'after'} the radar does"


def _frames(numbers: Sequence[int]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {format_runs(find_runs(numbers), _LISTED)}"
