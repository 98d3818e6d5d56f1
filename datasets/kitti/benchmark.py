"""One log of a benchmark, made of numbered frames: what tracking and object benchmark share."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from fbench.datasets.importing.files import find_runs, format_counts, format_list, format_runs, read_floats, read_image
from fbench.datasets.kitti.frames import ObjectFrames, TrackingFrames
from fbench.datasets.kitti.labels import CLASSES, boxes_3d
from fbench.datasets.kitti.sensors import LIDAR
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import Imported, ImportRequest, OtherResult, log_id
from fbench.replay.data.messages import Image, PointCloud, Pose, Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.formats.kitti import DONT_CARE
from fbench.replay.formats.objects import to_boxes2d
from fbench.replay.formats.text import digest_of
from fbench.replay.logs.coordinate_frames import BODY

_LISTED = 20


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

    def __init__(self, frames: TrackingFrames | ObjectFrames, request: ImportRequest) -> None:
        self.name, self._frames, self._request = frames.name, frames, request
        self._classes: Counter[str] = Counter()  # Of labels, as they were read
        self._tracks: set[int] = set()
        self._num_unlabeled = self._num_empty = self._num_with_results = 0  # Frames
        self._num_results: Counter[str] = Counter()

    @property
    def rig(self) -> Rig:
        """Sensors that have files, and the camera that the labels belong to."""
        return self._frames.rig

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the benchmark."""
        frames, results = self._frames, self._frames.results
        facts = [
            frames.benchmark,
            *frames.facts,
            *(f"{path.name} {digest_of(path)}" for path in (results.files if results else ())),
        ]
        metadata = {
            "dataset": f"KITTI {frames.benchmark} benchmark", "benchmark": frames.benchmark,
            "frames": str(len(frames.numbers)), **FACTS, **frames.metadata,
        }  # fmt: skip
        if frames.files:  # the sensor with the most frames, the first of several
            metadata["reference"] = max(frames.files, key=lambda sensor: len(frames.files[sensor]))
        return LogInfo(self.name, log_id("kitti", facts, self._request.frames), metadata)

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
                self._request.bad.report(error)
                continue
            if changed := now.list_changes(rig):
                yield RigChange(stamp_ns, now, changed)
                rig = now
            yield from messages
            yield from self._boxes(number, stamp_ns)

    def _messages(self, number: int, stamp_ns: int) -> Iterator[Image | PointCloud | Pose]:
        present = ((sensor, paths[number]) for sensor, paths in self._frames.files.items() if number in paths)
        for sensor, path in present:
            try:
                if sensor != LIDAR:
                    size_wh = self._frames.image_size(sensor)
                    yield read_image(path, sensor, stamp_ns, size_wh, frame_number=number)
                    continue
                points = read_floats(path, 4)
            except LogError as error:
                self._request.bad.report(error)
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
            self._request.bad.report(error)
        self._num_unlabeled += objects is None
        self._num_empty += objects is not None and not objects
        self._classes.update(row.source_label for row in objects or ())
        ids = (row.track_id for row in objects or () if row.track_id is not None)
        self._tracks.update(id_ for id_ in ids if id_ >= 0)
        if objects is not None:
            yield Truth(stamp_ns, stamp_ns, boxes_3d(objects), to_boxes2d(objects), number)
        try:
            boxes = None if self._frames.results is None else self._frames.results.boxes(number)
        except LogError as error:
            self._request.bad.report(error)
        if boxes is not None:
            self._num_with_results += 1
            for kind, own in zip(("3D", "2D"), boxes, strict=True):
                self._num_results[kind] += 0 if own is None else len(own)
            yield OtherResult(Truth(stamp_ns, stamp_ns, *boxes, number))

    def summary(self) -> Sequence[str]:
        """A line about each thing that was found or is odd."""
        numbers, files = self._frames.numbers, self._frames.files
        lines = [f"frames: {len(numbers)}" + (f", {numbers[0]} to {numbers[-1]}" if numbers else "")]
        counts = ", ".join(f"{name} {len(paths)}" for name, paths in files.items())
        lines.append(f"files: {counts or 'none of sensors'}")
        for name, paths in files.items():
            if lost := [number for number in numbers if number not in paths]:
                lines.append(f"missing files: {name} {len(lost)} (frames {format_runs(find_runs(lost), _LISTED)})")
        lines += self._label_lines(len(numbers))
        if self._num_with_results:
            counts = ", ".join(f"{num} in {kind}" for kind, num in self._num_results.items() if num) or "none"
            lines.append(f"detections: {counts}, for {self._num_with_results} frames")
        return [*lines, *self._frames.notes]

    def _label_lines(self, num_frames: int) -> Iterator[str]:
        if self._num_unlabeled == num_frames:
            yield "boxes: no labels"
            return
        tracks = f", {len(self._tracks)} tracks" if self._tracks else ", without track ids"
        classes = Counter({name: num for name, num in self._classes.items() if name != DONT_CARE})
        yield f"boxes: {classes.total()}{tracks}; {self._classes[DONT_CARE]} DontCare regions"
        yield f"classes: {format_counts(classes) or 'none'}"
        yield f"frames without boxes: {self._num_empty}"
        if self._num_unlabeled:
            yield f"unlabeled frames: {self._num_unlabeled}"
        if unknown := sorted(name for name in self._classes if name not in CLASSES):
            yield f"classes that the benchmark lacks, taken by their names: {format_list(unknown, _LISTED)}"
