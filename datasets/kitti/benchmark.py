"""One log of a benchmark, made of numbered frames: what tracking and object benchmark share."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import find_runs, format_counts, format_list, format_runs, read_floats, read_image
from fbench.datasets.kitti.frames import ObjectFrames, TrackingFrames
from fbench.datasets.kitti.labels import CLASSES, boxes_3d
from fbench.datasets.kitti.sensors import LIDAR
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import Imported, ImportWish, OtherResult, log_id
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose, Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.formats.kitti import DONT_CARE
from fbench.replay.formats.objects import LabeledObject, to_boxes2d
from fbench.replay.logs.coordinate_frames import BODY

_LISTED = 20


class Findings:
    """Counts labels and results."""

    def __init__(self) -> None:
        self._classes: Counter[str] = Counter()
        self._tracks: set[int] = set()
        self._unlabeled = self._empty = 0
        self._num_results: Counter[str] = Counter()
        self._frames_with_results = 0

    def add_labels(self, objects: Sequence[LabeledObject] | None) -> None:
        """Count the objects of a frame, or a frame that isn't labeled."""
        self._unlabeled += objects is None
        self._empty += objects is not None and not objects
        for row in objects or ():
            self._classes[row.source_label] += 1
            if row.track_id is not None and row.track_id >= 0:
                self._tracks.add(row.track_id)

    def add_results(self, boxes3d: Boxes3D | None, boxes2d: Boxes2D | None) -> None:
        """Count another system's boxes of a frame."""
        self._frames_with_results += 1
        self._num_results["3D"] += 0 if boxes3d is None else len(boxes3d)
        self._num_results["2D"] += 0 if boxes2d is None else len(boxes2d)

    def lines(self, numbers: Sequence[int], files: Mapping[str, Mapping[int, Path]]) -> Iterator[str]:
        """Yield a line about each thing that was found or is odd."""
        yield f"frames: {len(numbers)}" + (f", {numbers[0]} to {numbers[-1]}" if numbers else "")
        yield "files: " + (", ".join(f"{name} {len(paths)}" for name, paths in files.items()) or "none of sensors")
        for name, paths in files.items():
            if lost := [number for number in numbers if number not in paths]:
                yield f"missing files: {name} {len(lost)} (frames {format_runs(find_runs(lost), _LISTED)})"
        yield from self._label_lines(len(numbers))
        if self._frames_with_results:
            counts = ", ".join(f"{num} in {kind}" for kind, num in self._num_results.items() if num) or "none"
            yield f"detections: {counts}, for {self._frames_with_results} frames"

    def _label_lines(self, num_frames: int) -> Iterator[str]:
        if self._unlabeled == num_frames:
            yield "boxes: no labels"
            return
        num = self._classes.total() - self._classes[DONT_CARE]
        tracks = f", {len(self._tracks)} tracks" if self._tracks else ", without track ids"
        yield f"boxes: {num}{tracks}; {self._classes[DONT_CARE]} DontCare regions"
        classes = Counter({name: num for name, num in self._classes.items() if name != DONT_CARE})
        yield f"classes: {format_counts(classes) or 'none'}"
        yield f"frames without boxes: {self._empty}"
        if self._unlabeled:
            yield f"unlabeled frames: {self._unlabeled}"
        if unknown := sorted(name for name in self._classes if name not in CLASSES):
            yield f"classes that the benchmark lacks, taken by their names: {format_list(unknown, _LISTED)}"


FACTS = {
    CAMERA0: BODY,
    "licence": "CC BY-NC-SA 3.0",
    "truth.coordinates": "3D boxes in rectified camera 0, its axes turned: x forward, y left, z up",
    "truth.occlusion": "0 fully visible, 1 partly occluded, 2 largely occluded, 3 unknown",
    "truth.attribute": "alpha of 2D boxes as it was written: the observation angle [rad]",
}
"""Metadata of both benchmarks."""


class BenchmarkRecording:
    """See `Recording`. The made-up stamp of all items of frame N is N + 1 periods, as 0 is taken for one not set."""

    def __init__(self, frames: TrackingFrames | ObjectFrames, wish: ImportWish) -> None:
        self.name, self._frames, self._wish = frames.name, frames, wish
        self._findings = Findings()

    @property
    def rig(self) -> Rig:
        """Sensors that have files, and the camera that the labels belong to."""
        return self._frames.rig

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the benchmark."""
        frames, results = self._frames, self._frames.results
        facts = [frames.benchmark, *frames.facts, *(() if results is None else results.facts)]
        metadata = {
            "dataset": f"KITTI {frames.benchmark} benchmark", "benchmark": frames.benchmark,
            "frames": str(len(frames.numbers)), **FACTS, **frames.metadata,
        }  # fmt: skip
        if frames.files:  # the sensor with the most frames, the first of several
            metadata["reference"] = max(frames.files, key=lambda sensor: len(frames.files[sensor]))
        return LogInfo(self.name, log_id("kitti", facts, self._wish.frames), metadata)

    @property
    def num_items(self) -> int:
        """About an item a file, and two of boxes a frame."""
        return sum(map(len, self._frames.files.values())) + 2 * len(self._frames.numbers)

    def items(self) -> Iterator[Imported]:
        """All frames."""
        rig = self.rig
        for number in self._frames.numbers:
            stamp_ns = (number + 1) * self._frames.period_ns
            messages = list(self._messages(number, stamp_ns))
            sizes_wh = {message.sensor: message.size_wh for message in messages if isinstance(message, Image)}
            try:
                now = self._frames.rig_at(number, sizes_wh)
            except LogError as error:  # nothing of a frame can be used that can't be placed
                self._wish.bad.report(error)
                continue
            if changed := now.changed_since(rig):
                yield RigChange(stamp_ns, now, changed)
                rig = now
            yield from messages
            yield from self._boxes(number, stamp_ns)

    def _messages(self, number: int, stamp_ns: int) -> Iterator[Image | PointCloud | Pose]:
        present = ((sensor, paths[number]) for sensor, paths in self._frames.files.items() if number in paths)
        for sensor, path in present:
            try:
                if sensor != LIDAR:
                    size_wh = self._frames.expected_size(sensor)
                    yield read_image(path, sensor, stamp_ns, size_wh, frame_number=number)
                    continue
                points = read_floats(path, 4)
            except LogError as error:
                self._wish.bad.report(error)
                continue
            xyz, intensity = np.ascontiguousarray(points[:, :3]), np.ascontiguousarray(points[:, 3])
            yield PointCloud(sensor, stamp_ns, stamp_ns, xyz, intensity, frame_number=number)
        if (pose := self._frames.pose(number, stamp_ns)) is not None:
            yield pose

    def _boxes(self, number: int, stamp_ns: int) -> Iterator[Truth | OtherResult]:
        objects = boxes = None
        try:
            objects = self._frames.labels(number)
        except LogError as error:
            self._wish.bad.report(error)
        self._findings.add_labels(objects)
        if objects is not None:
            yield Truth(stamp_ns, stamp_ns, boxes_3d(objects), to_boxes2d(objects), number)
        try:
            boxes = None if self._frames.results is None else self._frames.results.boxes(number)
        except LogError as error:
            self._wish.bad.report(error)
        if boxes is not None:
            self._findings.add_results(*boxes)
            yield OtherResult(Truth(stamp_ns, stamp_ns, *boxes, number))

    def summary(self) -> Sequence[str]:
        """What was found."""
        frames = self._frames
        return [*self._findings.lines(frames.numbers, frames.files), *frames.notes]
