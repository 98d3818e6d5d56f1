"""What an import of a benchmark met, for its summary."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from fbench.datasets.kitti.labels import CLASSES
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.boxfiles.kitti_rows import DONT_CARE
from fbench.replay.boxfiles.rows import Labelled
from fbench.replay.imports.words import counted, listed, listed_runs, runs

_LISTED = 20


class Findings:
    """Counts labels and results."""

    def __init__(self) -> None:
        self._classes: Counter[str] = Counter()
        self._tracks: set[int] = set()
        self._unlabelled = self._empty = 0
        self._num_results: Counter[str] = Counter()
        self._frames_with_results = 0

    def add_labels(self, objects: Sequence[Labelled] | None) -> None:
        """Count the objects of a frame, or a frame that isn't labelled."""
        self._unlabelled += objects is None
        self._empty += objects is not None and not objects
        for row in objects or ():
            self._classes[row.source_label] += 1
            if row.track_id is not None and row.track_id >= 0:
                self._tracks.add(row.track_id)

    def add_results(self, boxes3d: Boxes3D | None, boxes2d: Boxes2D | None) -> None:
        """Count another system's boxes of a frame."""
        self._frames_with_results += 1
        self._num_results.update({"3D": 0 if boxes3d is None else len(boxes3d)})
        self._num_results.update({"2D": 0 if boxes2d is None else len(boxes2d)})

    def lines(self, numbers: Sequence[int], files: Mapping[str, Mapping[int, Path]]) -> Iterator[str]:
        """Yield a line about each thing that was found or is odd."""
        yield f"frames: {len(numbers)}" + (f", {numbers[0]} to {numbers[-1]}" if numbers else "")
        yield "files: " + (", ".join(f"{name} {len(paths)}" for name, paths in files.items()) or "none of sensors")
        for name, paths in files.items():
            if lost := [number for number in numbers if number not in paths]:
                yield f"missing files: {name} {len(lost)} (frames {listed_runs(runs(lost), _LISTED)})"
        yield from self._label_lines(len(numbers))
        if self._frames_with_results:
            counts = ", ".join(f"{num} in {kind}" for kind, num in self._num_results.items() if num) or "none"
            yield f"detections: {counts}, for {self._frames_with_results} frames"

    def _label_lines(self, num_frames: int) -> Iterator[str]:
        if self._unlabelled == num_frames:
            yield "boxes: no labels"
            return
        num = self._classes.total() - self._classes[DONT_CARE]
        tracks = f", {len(self._tracks)} tracks" if self._tracks else ", without track ids"
        yield f"boxes: {num}{tracks}; {self._classes[DONT_CARE]} DontCare regions"
        classes = Counter({name: num for name, num in self._classes.items() if name != DONT_CARE})
        yield f"classes: {counted(classes) or 'none'}"
        yield f"frames without boxes: {self._empty}"
        if self._unlabelled:
            yield f"unlabelled frames: {self._unlabelled}"
        if unknown := sorted(name for name in self._classes if name not in CLASSES):
            yield f"classes that the benchmark lacks, taken by their names: {listed(unknown, _LISTED)}"
