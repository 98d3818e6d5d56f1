"""What the import of a sequence met, for its summary."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from fbench.datasets.radiate.files import CARTESIAN, FOLDERS, GPS, POLAR, Due, SequenceFiles
from fbench.datasets.radiate.labels import LABELS
from fbench.datasets.radiate.params import RadiateParams
from fbench.datasets.radiate.radar import SENSOR as RADAR
from fbench.replay.data import VEHICLES, Boxes3D, Message, RadarScan
from fbench.replay.imports.words import counted, listed, listed_runs, runs

_LISTED = 5
_LATE_S = 0.5
"""Sensors that start or end so much later or earlier than the radar are told of."""


@dataclass
class Findings:
    """Counts what was imported."""

    messages: Counter[str] = field(default_factory=Counter)
    """By sensor."""
    radar_points: int = 0
    classes: Counter[str] = field(default_factory=Counter)
    tracks: set[int] = field(default_factory=set)
    hits: list[int] = field(default_factory=list)
    """Radar points on each labelled vehicle whose scan is there."""
    unlabelled: int = 0
    wide: int = 0
    """Boxes that are wider than long."""

    def add(self, message: Message) -> None:
        """Count a message."""
        self.messages[message.sensor] += 1
        if isinstance(message, RadarScan):
            self.radar_points += len(message.xyz)

    def add_boxes(self, boxes: Boxes3D) -> None:
        """Count what was labelled at one instant."""
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
        yield from _file_lines(files)
        yield from _time_lines(files)
        yield from _pose_lines(files, dues, self.messages[GPS], params)
        yield from self._label_lines(files, num_slots)
        yield from self._radar_lines()
        yield "stamps: as recorded, times of arrival; `fbench log check` looks for offsets between sensors"

    def _label_lines(self, files: SequenceFiles, num_slots: int | None) -> Iterator[str]:
        if num_slots is None:
            yield "boxes: no labels"
            return
        classes = counted(self.classes)
        yield f"boxes: {self.classes.total()}{f' ({classes})' if classes else ''}, {len(self.tracks)} tracks"
        last = max([*files.streams[RADAR].stamps, *files.streams[RADAR].no_file])
        if num_slots != last:
            yield f"labels: slots for {num_slots} radar frames, there are {last}; slot k belongs to frame k + 1"
        if self.unlabelled:
            yield f"unlabelled radar frames: {self.unlabelled}, beyond the slots of the labels"
        if unknown := sorted(self.classes.keys() - LABELS.keys()):
            yield f"classes that the set lacks, taken as 'other': {listed(unknown, _LISTED)}"
        if self.wide:
            yield f"boxes wider than long: {self.wide}, as labelled"
        yield "boxes: heights and where they stand are assumed, labels are from above"

    def _radar_lines(self) -> Iterator[str]:
        if num := self.messages[RADAR]:
            yield f"radar: {self.radar_points / num:.0f} points a scan by CFAR, without Doppler; rcs is a grey value"
        if self.hits:
            one, three = (sum(hit >= least for hit in self.hits) for least in (1, 3))
            of = f"of {len(self.hits)} labelled vehicles"
            share = (
                f"{one} ({one / len(self.hits):.1%}) have a radar point, {three} ({three / len(self.hits):.1%}) three"
            )
            yield f"radar: {of} {share} or more"


def _file_lines(files: SequenceFiles) -> Iterator[str]:
    for sensor, stream in files.streams.items():
        table = f"{FOLDERS[sensor]}.txt"
        if stream.no_file:
            yield f"left out, without a file: {len(stream.no_file)} times of {table} ({_frames(stream.no_file)})"
        if stream.no_stamp:
            num = len(stream.no_stamp)
            yield f"left out, without a time in {table}: {num} files ({_frames(stream.no_stamp)})"
    polar = files.streams[RADAR].stamps
    other = sum(files.cartesian.get(number, stamp) != stamp for number, stamp in polar.items())
    if other:
        yield f"times of {POLAR}.txt are not those of {CARTESIAN}.txt: {other} frames; the former were taken"


def _time_lines(files: SequenceFiles) -> Iterator[str]:
    radar = files.streams[RADAR].stamps.values()
    for sensor, stream in files.streams.items():
        stamps = list(stream.stamps.values())
        if not stamps:
            yield f"{sensor}: no file with a time"
            continue
        if back := sum(b < a for a, b in pairwise(stamps)):
            yield f"{sensor}: time runs backwards before {back} of {len(stamps)} files, which were put in order"
        if sensor != GPS:
            late_s, early_s = (min(stamps) - min(radar)) / 1e9, (max(radar) - max(stamps)) / 1e9
            if abs(late_s) > _LATE_S:
                yield f"{sensor}: starts {_apart(late_s, 'after')} the radar does"
            if abs(early_s) > _LATE_S:
                yield f"{sensor}: ends {_apart(early_s, 'before')} the radar does"


def _pose_lines(files: SequenceFiles, dues: Sequence[Due], num: int, params: RadiateParams) -> Iterator[str]:
    if GPS not in files.streams or not files.streams[GPS].stamps:
        return
    stamps = files.streams[GPS].stamps.values()
    unique = len(set(stamps))
    if unique < len(stamps):
        yield f"{GPS}: {len(stamps) - unique} of {len(stamps)} fixes repeat a time, left out"
    chosen = sum(due.sensor == GPS for due in dues)
    if chosen < unique:
        first_s = (min(stamps) - min(files.streams[RADAR].stamps.values())) / 1e9 + params.gps_offset_s
        yield (
            f"{GPS}: {unique - chosen} fixes left out, taken over 2 s away from what is imported (they start "
            f"{_apart(first_s, 'after')} the radar does); --set gps_offset_s=SECONDS moves them"
        )
    if num < chosen:
        yield f"{GPS}: {chosen - num} fixes without a heading or unreadable, left out"


def _apart(seconds: float, late: str) -> str:
    other = {"after": "before", "before": "after"}[late]
    return f"{abs(seconds):.2f} s {late if seconds >= 0 else other}"


def _frames(numbers: Sequence[int]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {listed_runs(runs(numbers), _LISTED)}"
