"""One log of a benchmark, made of numbered frames: what the tracking and the object benchmark have in common."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from fbench.datasets.kitti.findings import Findings
from fbench.datasets.kitti.labels import boxes_2d, boxes_3d
from fbench.datasets.kitti.results import Results
from fbench.datasets.kitti.rig import LIDAR
from fbench.replay.boxfiles.rows import Labelled
from fbench.replay.data import Image, LogInfo, PointCloud, Pose, Rig, RigChange, Truth
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_floats, read_image
from fbench.replay.imports.identity import log_id
from fbench.replay.imports.imported import Imported, OtherResult
from fbench.replay.imports.wish import ImportWish
from fbench.replay.log_keys import CAMERA0
from fbench.replay.logs.tree import BODY

FACTS = {
    CAMERA0: BODY,
    "licence": "CC BY-NC-SA 3.0",
    "truth.coordinates": "3D boxes in rectified camera 0, its axes turned: x forward, y left, z up",
    "truth.occlusion": "0 fully visible, 1 partly occluded, 2 largely occluded, 3 unknown",
    "truth.attribute": "alpha of 2D boxes as it was written: the observation angle [rad]",
}
"""Metadata of both benchmarks."""


class FrameSet(Protocol):
    """The frames of one log."""

    name: str
    benchmark: Literal["tracking", "object"]
    period_ns: int
    """Between the stamps of frames that follow one another: none were published. That of frame N is N + 1 periods, as a
    stamp of 0 is taken for one that wasn't set."""

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the frames that are asked for, ascending."""
        ...

    @property
    def files(self) -> Mapping[str, Mapping[int, Path]]:
        """Files of these frames by sensor; sensors without any are absent."""
        ...

    @property
    def rig(self) -> Rig:
        """Sensors at the first frame."""
        ...

    @property
    def results(self) -> Results | None:
        """What another system made of the frames."""
        ...

    @property
    def facts(self) -> Sequence[str]:
        """What tells these files from others."""
        ...

    @property
    def metadata(self) -> Mapping[str, str]:
        """The benchmark's own facts."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """Lines for the summary."""
        ...

    def expected_size(self, sensor: str) -> tuple[int, int] | None:
        """Size [px] that all images of a camera must have; `None` where each may have its own."""
        ...

    def rig_at(self, number: int, sizes_wh: Mapping[str, tuple[int, int]]) -> Rig:
        """Sensors at a frame whose images have these sizes [px]."""
        ...

    def labels(self, number: int) -> Sequence[Labelled] | None:
        """Labelled objects of a frame; `None` where it isn't labelled."""
        ...

    def pose(self, number: int, stamp_ns: int) -> Pose | None:
        """The body's pose at a frame, where it is known."""
        ...


class BenchmarkRecording:
    """See `Recording`. All items of a frame have the same made-up stamp."""

    def __init__(self, frames: FrameSet, wish: ImportWish) -> None:
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
        if (reference := _reference(frames.files)) is not None:
            metadata["reference"] = reference
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
                self._wish.bad.met(error)
                continue
            if changed := now.changed_since(rig):
                yield RigChange(stamp_ns, now, changed)
                rig = now
            yield from messages
            yield from self._boxes(number, stamp_ns)

    def _messages(self, number: int, stamp_ns: int) -> Iterator[Image | PointCloud | Pose]:
        for sensor, paths in self._frames.files.items():
            if number in paths:
                try:
                    yield self._message(sensor, paths[number], number, stamp_ns)
                except LogError as error:
                    self._wish.bad.met(error)
        if (pose := self._frames.pose(number, stamp_ns)) is not None:
            yield pose

    def _message(self, sensor: str, path: Path, number: int, stamp_ns: int) -> Image | PointCloud:
        if sensor != LIDAR:
            return read_image(path, sensor, stamp_ns, self._frames.expected_size(sensor), frame_number=number)
        points = read_floats(path, 4)
        xyz, intensity = np.ascontiguousarray(points[:, :3]), np.ascontiguousarray(points[:, 3])
        return PointCloud(sensor, stamp_ns, stamp_ns, xyz, intensity, frame_number=number)

    def _boxes(self, number: int, stamp_ns: int) -> Iterator[Truth | OtherResult]:
        try:
            objects = self._frames.labels(number)
        except LogError as error:
            self._wish.bad.met(error)
            objects = None
        self._findings.add_labels(objects)
        if objects is not None:
            yield Truth(stamp_ns, stamp_ns, boxes_3d(objects), boxes_2d(objects), number)
        yield from self._results(number, stamp_ns)

    def _results(self, number: int, stamp_ns: int) -> Iterator[OtherResult]:
        try:
            boxes = None if self._frames.results is None else self._frames.results.boxes(number)
        except LogError as error:
            self._wish.bad.met(error)
            return
        if boxes is not None:
            self._findings.add_results(*boxes)
            yield OtherResult(Truth(stamp_ns, stamp_ns, *boxes, number))

    def summary(self) -> Sequence[str]:
        """What was found."""
        frames = self._frames
        return [*self._findings.lines(frames.numbers, frames.files), *frames.notes]


def _reference(files: Mapping[str, Mapping[int, Path]]) -> str | None:
    """The sensor with the most frames, the first of several."""
    return max(files, key=lambda sensor: len(files[sensor]), default=None)
