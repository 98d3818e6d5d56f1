"""Labels of the object and tracking benchmarks, and results of other systems on their sequences and frames."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Protocol

from fbench.datasets.importing.files import numbered
from fbench.datasets.kitti.sensors import bounded_lines, camera_name
from fbench.replay.contracts.errors import ConfigError, LimitError, LogError
from fbench.replay.contracts.importing import BadInput, FrameRange
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes2D, Boxes3D
from fbench.replay.formats.documents import head_of
from fbench.replay.formats.kitti import DONT_CARE, parse_ab3dmot_row, parse_object_row, parse_tracking_row
from fbench.replay.formats.objects import Labelled, flats, solids
from fbench.replay.formats.open import recognised
from fbench.replay.formats.text import Line, digest_of, frame_number

CAMERA = camera_name(2)
"""Whose image labels and results belong to."""
CLASSES = frozenset(
    ("Car", "Van", "Truck", "Pedestrian", "Person", "Person_sitting", "Cyclist", "Tram", "Misc", DONT_CARE)
)
_ALPHA = 3
"""Column behind the class."""
MAX_FRAMES = 200_000
"""No sequence has more frames."""

Parse = Callable[[Line], Labelled]


@dataclass(frozen=True, eq=False)
class SequenceRows:
    """Rows of one sequence."""

    frames: Mapping[int, Sequence[Labelled]]
    """In the order of the file; frames without rows are absent."""
    num_frames: int
    """One more than the last frame of any row."""


def tracking_label(line: Line) -> Labelled:
    """Return the object of a row of `label_02`, its alpha as attribute.

    Raises:
        LogError: naming the column.
    """
    return _keep_alpha(parse_tracking_row(line, CAMERA), line.fields[2:])


def object_label(line: Line) -> Labelled:
    """Return the object of a row of `label_2`, its alpha as attribute.

    Raises:
        LogError: naming the column.
    """
    return _keep_alpha(parse_object_row(line, line.fields, CAMERA, None), line.fields)


def _keep_alpha(row: Labelled, fields: Sequence[str]) -> Labelled:
    """Keep the observation angle as it is written: it doesn't follow from the box, as it was labeled separately."""
    return row if row.source_label == DONT_CARE else replace(row, attribute=f"alpha={fields[_ALPHA]}")


def sequence_rows(path: Path, parse: Parse, frames: FrameRange, bad: BadInput, comma: bool = False) -> SequenceRows:
    """Read the file of one sequence; rows of frames that aren't asked for are counted only.

    Raises:
        LogError: naming the row that can't be used, unless such are skipped.
    """
    found: dict[int, list[Labelled]] = {}
    ids: set[tuple[int, int]] = set()
    num_frames = 0
    for line in bounded_lines(path, comma):
        try:
            frame = frame_number(line.fields[0], line.where)
            if frame >= MAX_FRAMES:
                raise LimitError(f"{line.where}: frame is {frame}, expected less than {MAX_FRAMES}")
            num_frames = max(num_frames, frame + 1)
            if frame in frames:
                found.setdefault(frame, []).append(_check(parse(line), line, frame, ids))
        except LogError as error:
            bad.met(error)
    return SequenceRows(found, num_frames)


def frame_rows(path: Path, parse: Parse, bad: BadInput) -> list[Labelled]:
    """Read the file of one frame.

    Raises:
        LogError: naming the row that can't be used, unless such are skipped.
    """
    objects: list[Labelled] = []
    for line in bounded_lines(path):
        try:
            objects.append(_check(parse(line), line, 0, set()))
        except LogError as error:
            bad.met(error)
    return objects


def boxes_3d(objects: Sequence[Labelled]) -> Boxes3D:
    """Return the 3D boxes in the order of the rows: body coordinates are those of camera 0, turned upright."""
    return solids([replace(row, attribute=None) for row in objects])


def _check(row: Labelled, line: Line, frame: int, ids: set[tuple[int, int]]) -> Labelled:
    """Refuse what no box can be, and ids that were met before in the frame."""
    if not all(abs(value) < MAX_MAGNITUDE for value in _numbers(row)):  # also refuses NaN
        raise LogError(f"{line.where}: a number isn't finite, or is beyond all reason")
    if row.track_id is not None and row.track_id >= 0:
        if (frame, row.track_id) in ids:
            raise LogError(f"{line.where}: id {row.track_id} twice in frame {frame}; an id names one object")
        ids.add((frame, row.track_id))
    return row


def _numbers(row: Labelled) -> Iterator[float]:
    if row.flat is not None:
        yield from row.flat.xyxy_px
    if row.solid is not None:
        yield from (*row.solid.center_m, *row.solid.size_lwh_m, *row.solid.yaw_pitch_roll_rad)
    yield from (value for value in (row.score, row.occlusion, row.truncation) if value is not None)


TRACKING_DIGITS, OBJECT_DIGITS = 4, 6


_SEQUENCE_FORMS: Mapping[str, tuple[Parse, bool]] = {
    "kitti-tracking": (tracking_label, False),
    "ab3dmot": (lambda line: parse_ab3dmot_row(line, CAMERA), True),
}
"""How a row is read, and whether commas part its columns."""


class Results(Protocol):
    """Results for one log."""

    @property
    def facts(self) -> Sequence[str]:
        """What tells them from others."""
        ...

    def boxes(self, number: int) -> tuple[Boxes3D | None, Boxes2D | None] | None:
        """Boxes of one frame; `None` where the frame has no results, one part where all have none of that kind."""
        ...


@dataclass(frozen=True)
class _Kinds:
    """Which kinds of boxes the results have at all."""

    has_3d: bool
    has_2d: bool

    def boxes(self, rows: Sequence[Labelled]) -> tuple[Boxes3D | None, Boxes2D | None]:
        return boxes_3d(rows) if self.has_3d else None, flats(rows) if self.has_2d else None


@dataclass(frozen=True, eq=False)
class SequenceResults:
    """Results of one sequence, all frames of which were looked at."""

    path: Path
    rows: SequenceRows
    kinds: _Kinds

    @property
    def facts(self) -> Sequence[str]:
        """Digest of the file."""
        return [f"{self.path.name} {digest_of(self.path)}"]

    def boxes(self, number: int) -> tuple[Boxes3D | None, Boxes2D | None] | None:
        """See `Results`."""
        return self.kinds.boxes(self.rows.frames.get(number, ()))


@dataclass(frozen=True, eq=False)
class FrameResults:
    """Results of single frames."""

    paths: Mapping[int, Path]
    kinds: _Kinds
    bad: BadInput

    @property
    def facts(self) -> Sequence[str]:
        """Digest of each file."""
        return [f"{path.name} {digest_of(path)}" for path in self.paths.values()]

    def boxes(self, number: int) -> tuple[Boxes3D | None, Boxes2D | None] | None:
        """See `Results`."""
        if number not in self.paths:
            return None
        return self.kinds.boxes(frame_rows(self.paths[number], object_label, self.bad))


def results_folder(folder: Path) -> Path:
    """Return where the files of results are: the folder, or its `data/`, where TrackEval has them.

    Raises:
        ConfigError: where there are none.
    """
    if not folder.is_dir():
        raise ConfigError(f"--detections {folder}: {'not a folder' if folder.exists() else 'no such folder'}")
    for inner in (folder, folder / "data"):
        if any(numbered(inner, (".txt",), digits) for digits in (TRACKING_DIGITS, OBJECT_DIGITS)):
            return inner
    raise ConfigError(f"--detections {folder}: no file like 0000.txt (a sequence) or 000000.txt (a frame)")


def sequence_results(folder: Path, sequence: str, frames: FrameRange, bad: BadInput) -> SequenceResults | None:
    """Read the results of a sequence; `None` where there is no file of its name.

    Raises:
        LogError: naming file and row, where they can't be used.
    """
    path = folder / f"{sequence}.txt"
    if not path.is_file():
        return None
    parse, comma = _form(path)
    rows = sequence_rows(path, parse, frames, bad, comma)
    return SequenceResults(path, rows, _kinds(chain.from_iterable(rows.frames.values())))


def frame_results(folder: Path, frames: FrameRange, bad: BadInput) -> FrameResults | None:
    """Find the results of single frames; `None` where there are none.

    Raises:
        LogError: naming file and row, where they can't be used.
    """
    paths = numbered(folder, (".txt",), OBJECT_DIGITS, frames)
    if not paths:
        return None
    quiet = BadInput(skip=True)  # what is wrong is told when the frames are read
    rows = chain.from_iterable(_quietly(path, quiet) for path in paths.values())
    return FrameResults(paths, _kinds(rows), bad)


def _quietly(path: Path, quiet: BadInput) -> Sequence[Labelled]:
    try:
        return frame_rows(path, object_label, quiet)
    except LogError:
        return []


def _form(path: Path) -> tuple[Parse, bool]:
    if not head_of(path).strip():
        return _SEQUENCE_FORMS["kitti-tracking"]
    try:
        return _SEQUENCE_FORMS[recognised(path)]
    except (KeyError, LogError) as error:
        raise LogError(
            f"{path}: no results of a sequence, expected KITTI's 17 or 18 columns (frame, id, class ...) or AB3DMOT's "
            "15 with commas between"
        ) from error


def _kinds(rows: Iterable[Labelled]) -> _Kinds:
    """Look until both kinds were met; without any row there may be both."""
    has_3d = has_2d = has_row = False
    for row in rows:
        has_row, has_3d, has_2d = True, has_3d or row.solid is not None, has_2d or row.flat is not None
        if has_3d and has_2d:
            break
    return _Kinds(has_3d or not has_row, has_2d or not has_row)
