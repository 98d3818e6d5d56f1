"""Run folders: written under a temporary name and renamed when whole; read back as `Run`."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, get_args

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.files import Draft
from fbench.replay.data.frames import ClockName
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import Score, load_scores
from fbench.replay.runs.columns import column_array, number_column, row_column, text_column
from fbench.replay.runs.manifest import Manifest, load_manifest, save_manifest
from fbench.replay.runs.media import MediaFrame, read_media, write_media
from fbench.replay.runs.tables import BoxTable, BoxWriter, read_boxes, read_table, write_table
from fbench.replay.runs.timings import Timings, TimingsWriter

B = TypeVar("B", Boxes2D, Boxes3D)
_FRAMES_AT_ONCE = 256
_STAGES = "stages"
_MAPPINGS = ("missing", _STAGES)  # Fields of frames that are kept as JSON
_CONTENT = ("num_points", "num_pixels")
_OF_LATENCY = ("ready_ns", "start_ns", "done_ns")  # Fields of frames that runs in lockstep don't have
FRAMES, POSE = "frames.parquet", "pose"  # The table of frames; its column that is there where the log has poses


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One frame of a run."""

    index: int
    stamp_ns: int
    segment: int
    frame_number: int | None
    missing: Mapping[str, str]  # Why a sensor was missing, by its name
    digest: str
    chain: str
    failed: str | None = None  # Why the pipeline gave nothing
    truth_stamp_ns: int | None = None
    """Stamp of the truth that belongs to the frame, or its own where that lies between truths; `None`: not labeled,
    and so not scored.
    """
    truth_spaces: str = ""  # What is labeled: `3d`, `2d` or `3d 2d`
    stages: Mapping[str, str] = field(default_factory=dict)  # Digests of what single stages gave, in their order
    ready_ns: int | None = None
    """Log time at which the frame was there; `None`, as the next two, in a run in lockstep."""
    start_ns: int | None = None  # Log time at which the pipeline began with it
    done_ns: int | None = None
    """Log time at which the pipeline was done with it; `None`: it was dropped."""
    num_points: int | None = None  # Of LiDAR and radar that the frame held; `None`, as the next: the run doesn't say
    num_pixels: int | None = None  # Of all images that the frame held

    @property
    def is_dropped(self) -> bool:
        """Whether the pipeline was too busy to get it."""
        return self.ready_ns is not None and self.done_ns is None


class RunWriter:
    """Writes one run folder; nothing appears under its name before `finish`."""

    def __init__(self, folder: Path, overwrite: bool = False) -> None:
        self.folder, self._draft = folder.resolve(), Draft(folder, is_folder=True)
        try:
            if folder.exists() and not overwrite:
                raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
            if folder.exists():
                load_manifest(folder / "manifest.json")
        except BaseException as error:
            self._draft.discard()
            if isinstance(error, RunError):
                why = f"{folder}: exists and isn't a run folder, so --overwrite doesn't touch it"
                raise ConfigError(why) from None
            raise
        self.partial = self._draft.path
        self._records: list[FrameRecord] = []
        self._rows: dict[int, int] = {}
        self.timings = TimingsWriter()
        self._writers: dict[str, BoxWriter] = {}
        self._poses: Float64 | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for writer in self._writers.values():
            with suppress(OSError):  # on a full disk what is pending has no place, and nobody wants it any more
                writer.close()
        self._draft.discard()

    @property
    def records(self) -> Sequence[FrameRecord]:
        """The frames added so far."""
        return self._records

    def add_frame(
        self,
        record: FrameRecord,
        stage_ns: Mapping[str, int],
        clock: ClockName = "host",
        compiled: bool = False,
        cpu_ns: Mapping[str, int] | None = None,
    ) -> None:
        """Append one frame and its times, see `TimingsWriter.add`."""
        self._rows[record.index] = len(self._records)
        self._records.append(record)
        self.timings.add(record.index, stage_ns, clock, compiled, cpu_ns)

    def add_boxes(self, table: str, frame: int, boxes: Boxes) -> None:
        """Append the boxes of one frame to `detections`, `tracks`, `truth` or `truth_2d`."""
        if table not in self._writers:
            self._writers[table] = BoxWriter(self.partial / f"{table}.parquet", type(boxes))
        self._writers[table].add(frame, boxes)

    def explain_missing(self, explain: Callable[[FrameRecord], FrameRecord]) -> None:
        """Replace each frame's record, when the whole log is known."""
        self._records = [explain(record) for record in self._records]

    def label_frame(self, index: int, truth: Truth) -> None:
        """Attach truth to frame `index`."""
        row = self._rows[index]
        self._records[row] = with_truth(self._records[row], truth)
        if truth.boxes3d is not None:
            self.add_boxes("truth", index, truth.boxes3d)
        if truth.boxes2d is not None:
            self.add_boxes("truth_2d", index, truth.boxes2d)

    def set_poses(self, poses: Float64) -> None:
        """Say where the body was: position [m] and quaternion x, y, z, w (N, 7) of all frames of the log by index, NaN
        where unknown.
        """
        self._poses = poses

    def write_json(self, name: str, content: object) -> None:
        """Write a JSON file into the folder."""
        (self.partial / name).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")

    def write_media(self, frames: Sequence[MediaFrame]) -> None:
        """Keep images and points of chosen frames."""
        write_media(self.partial / "media.parquet", frames)

    def finish(self, manifest: Manifest, complete: Callable[[Path], None] = lambda folder: None) -> Path:
        """Write the rest, let `complete` add to the folder, give it its name, and return it."""
        for writer in self._writers.values():
            writer.close()
        self._writers = {}
        rows = [record.index for record in self._records]
        write_frames(self.partial / FRAMES, self._records, None if self._poses is None else self._poses[rows])
        self.timings.write(self.partial / "timings.parquet")
        save_manifest(self.partial / "manifest.json", manifest)
        complete(self.partial)
        self._draft.publish()
        return self.folder


def with_truth(record: FrameRecord, truth: Truth | None) -> FrameRecord:
    """Return a frame with the stamp and kinds of its truth."""
    if truth is None:
        return replace(record, truth_stamp_ns=None, truth_spaces="")
    named = (("3d", truth.boxes3d), ("2d", truth.boxes2d))
    spaces = " ".join(name for name, boxes in named if boxes is not None)
    return replace(record, truth_stamp_ns=truth.stamp_ns, truth_spaces=spaces)


def write_frames(path: Path, records: Sequence[FrameRecord], poses: Float64 | None) -> None:
    """Write the table of frames. `path`: of the file; `records`: the frames; `poses`: (N, 7) where the body was at
    each: position [m] and quaternion x, y, z, w, NaN where unknown.
    """
    columns: dict[str, pa.Array] = {}
    is_timed = any(record.ready_ns is not None for record in records)
    for f in (f for f in fields(FrameRecord) if is_timed or f.name not in _OF_LATENCY):
        values = [getattr(record, f.name) for record in records]
        if f.name in _MAPPINGS:
            values = [json.dumps(dict(sorted(v.items()) if f.name == "missing" else v)) for v in values]
        if int in (f.type, *get_args(f.type)):
            missing = np.array([value is None for value in values], bool)
            columns[f.name] = number_column(np.array([v or 0 for v in values], np.int64), pa.int64(), missing)
        else:
            columns[f.name] = text_column(values)
    if poses is not None and (known := np.isfinite(poses).all(axis=1)).any():
        columns[POSE] = row_column(poses, np.logical_not(known))
    write_table(path, columns)


@dataclass(frozen=True)
class Run:
    """A finished run, read from its folder; tables are read when first used."""

    folder: Path

    @cached_property
    def manifest(self) -> Manifest:
        """What ran."""
        return load_manifest(self.folder / "manifest.json")

    @cached_property
    def frames(self) -> tuple[FrameRecord, ...]:
        """All frames, in order."""
        path = self.folder / FRAMES
        table = read_table(path)
        names = [f.name for f in fields(FrameRecord)]
        if _OF_LATENCY[0] not in table.column_names:
            names = [name for name in names if name not in _OF_LATENCY]
        if _CONTENT[0] not in table.column_names:  # In runs of before they were counted
            names = [name for name in names if name not in _CONTENT]
        if _STAGES not in table.column_names:  # In runs of before there were digests of stages
            names.remove(_STAGES)
        if sorted(set(table.column_names) - {POSE}) != sorted(names):
            raise RunError(f"{path}: can't be read (not a table of frames)")
        # In small pieces: Python objects of whole columns would take more memory than all else.
        rows = (row for b in table.select(names).to_batches(max_chunksize=_FRAMES_AT_ONCE) for row in b.to_pylist())
        kept = [name for name in _MAPPINGS if name in names]
        return tuple(FrameRecord(**row | {name: json.loads(row[name]) for name in kept}) for row in rows)

    @cached_property
    def poses(self) -> Float64:
        """(N, 7) where the body was at each of `frames`: position [m] and quaternion x, y, z, w; NaN where unknown."""
        table = read_table(self.folder / FRAMES)
        if POSE not in table.column_names:
            return np.full((table.num_rows, 7), np.nan)
        return np.asarray(column_array(table.column(POSE)), np.float64)

    @cached_property
    def _spaces(self) -> dict[int, str]:
        """What is labeled, by frame index; a run of a part of a log doesn't begin with 0."""
        return {frame.index: frame.truth_spaces for frame in self.frames}

    @cached_property
    def detections(self) -> BoxTable:
        """Detections of all frames."""
        return read_boxes(self.folder / "detections.parquet")

    @cached_property
    def tracks(self) -> BoxTable:
        """Tracks of all frames."""
        return read_boxes(self.folder / "tracks.parquet")

    @cached_property
    def _truth3d(self) -> BoxTable | None:
        path = self.folder / "truth.parquet"
        return read_boxes(path) if path.is_file() else None

    @cached_property
    def _truth2d(self) -> BoxTable | None:
        path = self.folder / "truth_2d.parquet"
        return read_boxes(path) if path.is_file() else None

    def truth3d(self, index: int) -> Boxes3D | None:
        """3D truth of frame `index`; `None` where it isn't labeled."""
        return self._at(index, "3d", Boxes3D)

    def truth2d(self, index: int) -> Boxes2D | None:
        """Recorded 2D truth of frame `index`; `None` where it isn't labeled or has only 3D truth."""
        return self._at(index, "2d", Boxes2D)

    def truth_table(self, space: Literal["3d", "2d"]) -> BoxTable:
        """3D truth, or recorded 2D truth, of all frames that have it; empty where none has. Raises RunError where
        frames have such truth, but the file isn't there.
        """
        table, kind = (self._truth3d, Boxes3D) if space == "3d" else (self._truth2d, Boxes2D)
        if table is None:
            if any(space in spaces.split() for spaces in self._spaces.values()):
                name = "truth.parquet" if space == "3d" else "truth_2d.parquet"
                raise RunError(f"{self.folder / name}: can't be read (frames have truth, but it isn't there)")
            return BoxTable(np.zeros(0, np.int64), kind.empty())
        return table

    def _at(self, index: int, space: Literal["3d", "2d"], kind: type[B]) -> B | None:
        if space not in self._spaces.get(index, "").split():
            return None
        boxes = self.truth_table(space).at(index)
        if not isinstance(boxes, kind):
            raise RunError(f"{self.folder}: can't be read ({space} truth of another kind)")
        return boxes

    @cached_property
    def times(self) -> Timings:
        """How long stages and frames took."""
        return Timings(self.folder / "timings.parquet")

    @property
    def clock(self) -> ClockName:
        """Whose times `timings` are."""
        return self.times.clock

    @property
    def frame_times(self) -> dict[str, dict[int, int]]:
        """Time [ns] of each stage by frame, see `Timings.stages`."""
        return self.times.stages

    @property
    def timings(self) -> dict[str, list[int]]:
        """Times [ns] as in `frame_times`, without the frames."""
        return {stage: list(times.values()) for stage, times in self.frame_times.items()}

    @property
    def compiled_frames(self) -> frozenset[int]:
        """Frames during which code was compiled, or loaded as compiled before."""
        return self.times.compiled_frames

    @cached_property
    def media(self) -> tuple[MediaFrame, ...]:
        """Images and points of the frames that were kept for reports."""
        return read_media(self.folder / "media.parquet")

    @cached_property
    def scores(self) -> list[Score]:
        """What `fbench score` wrote."""
        return load_scores(self.folder / "scores.json")

    def json(self, name: str) -> Any:
        """Content of a JSON file of the folder: `faults.json`, `latency.json`, `host.json`."""
        path = self.folder / name
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise RunError(f"{path}: can't be read ({error})") from error
