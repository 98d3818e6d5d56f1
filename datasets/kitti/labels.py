"""Labels of the object and tracking benchmarks, and results of other systems on their sequences and frames."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from fbench.datasets.importing.files import find_numbered
from fbench.datasets.kitti.sensors import camera_name, read_bounded_lines
from fbench.replay.contracts.errors import ConfigError, LimitError, LogError
from fbench.replay.contracts.importing import BadInput, FrameRange
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes2D, Boxes3D
from fbench.replay.formats.documents import head_of
from fbench.replay.formats.export_request import TABLES
from fbench.replay.formats.kitti import DONT_CARE, parse_ab3dmot_row, parse_object_row, parse_tracking_row
from fbench.replay.formats.objects import LabeledObject, to_boxes2d, to_boxes3d
from fbench.replay.formats.recognition import recognize
from fbench.replay.formats.text import Line, frame_number

CAMERA = camera_name(2)  # Whose image labels and results belong to
CLASSES = (*TABLES["kitti"].own, DONT_CARE)
MAX_FRAMES = 200_000  # No sequence has more frames

Parse = Callable[[Line], LabeledObject]


@dataclass(frozen=True, eq=False)
class SequenceRows:
    """Rows of one sequence."""

    frames: Mapping[int, Sequence[LabeledObject]]  # In the order of the file; frames without rows are absent
    num_frames: int  # One more than the last frame of any row


def tracking_label(line: Line) -> LabeledObject:
    """Return the object of a row of `label_02`, its alpha as attribute. Raises LogError naming the column."""
    return _keep_alpha(parse_tracking_row(line, CAMERA), line.fields[2:])


def object_label(line: Line) -> LabeledObject:
    """Return the object of a row of `label_2`, its alpha as attribute. Raises LogError naming the column."""
    return _keep_alpha(parse_object_row(line, line.fields, CAMERA, None), line.fields)


def _keep_alpha(row: LabeledObject, fields: Sequence[str]) -> LabeledObject:
    """Keep the observation angle as it is written: it doesn't follow from the box, as it was labeled separately."""
    return row if row.source_label == DONT_CARE else replace(row, attribute=f"alpha={fields[3]}")


def sequence_rows(path: Path, parse: Parse, frames: FrameRange, bad: BadInput, comma: bool = False) -> SequenceRows:
    """Read the file of a sequence; rows of other frames are only counted. LogError names a bad row unless skipped."""
    found: dict[int, list[LabeledObject]] = {}
    ids: set[tuple[int, int]] = set()
    num_frames = 0
    for line in read_bounded_lines(path, comma):
        try:
            frame = frame_number(line.fields[0], line.where)
            if frame >= MAX_FRAMES:
                raise LimitError(f"{line.where}: frame is {frame}, expected less than {MAX_FRAMES}")
            num_frames = max(num_frames, frame + 1)
            if frame in frames:
                found.setdefault(frame, []).append(_check(parse(line), line, frame, ids))
        except LogError as error:
            bad.report(error)
    return SequenceRows(found, num_frames)


def frame_rows(path: Path, parse: Parse, bad: BadInput) -> list[LabeledObject]:
    """Read the file of one frame. Raises LogError naming the row that can't be used, unless such are skipped."""
    objects: list[LabeledObject] = []
    for line in read_bounded_lines(path):
        try:
            objects.append(_check(parse(line), line, 0, set()))
        except LogError as error:
            bad.report(error)
    return objects


def boxes_3d(objects: Sequence[LabeledObject]) -> Boxes3D:
    """Return the 3D boxes in the order of the rows: body coordinates are those of camera 0, turned upright."""
    return to_boxes3d([replace(row, attribute=None) for row in objects])


def _check(row: LabeledObject, line: Line, frame: int, ids: set[tuple[int, int]]) -> LabeledObject:
    """Refuse what no box can be, and ids that were met before in the frame."""
    numbers = [value for value in (row.score, row.occlusion, row.truncation) if value is not None]
    if row.flat is not None:
        numbers += row.flat.xyxy_px
    if row.solid is not None:
        numbers += (*row.solid.center_m, *row.solid.size_lwh_m, *row.solid.yaw_pitch_roll_rad)
    if not all(abs(value) < MAX_MAGNITUDE for value in numbers):  # also refuses NaN
        raise LogError(f"{line.where}: a number isn't finite, or is beyond all reason")
    if row.track_id is not None and row.track_id >= 0:
        if (frame, row.track_id) in ids:
            raise LogError(f"{line.where}: id {row.track_id} twice in frame {frame}; an id names one object")
        ids.add((frame, row.track_id))
    return row


TRACKING_DIGITS, OBJECT_DIGITS = 4, 6
_SEQUENCE_FORMS: Mapping[str, tuple[Parse, bool]] = {
    "kitti-tracking": (tracking_label, False),
    "ab3dmot": (lambda line: parse_ab3dmot_row(line, CAMERA), True),
}
"""How a row is read, and whether commas part its columns."""


@dataclass(frozen=True, eq=False)
class Results:
    """Results of another system for one log."""

    files: Sequence[Path]
    rows: Callable[[int], Sequence[LabeledObject] | None]  # Objects of a frame; `None` where it has no results
    has_3d: bool  # Whether there are 3D boxes at all
    has_2d: bool
    num_frames: int = 0  # Of a sequence: one more than the last frame of any row

    def boxes(self, number: int) -> tuple[Boxes3D | None, Boxes2D | None] | None:
        """Boxes of one frame; `None` where the frame has no results, one part where all have none of that kind."""
        rows = self.rows(number)
        if rows is None:
            return None
        return boxes_3d(rows) if self.has_3d else None, to_boxes2d(rows) if self.has_2d else None


def results_folder(folder: Path) -> Path:
    """Return the folder with files of results: this one, or its `data/` (TrackEval). ConfigError without any."""
    if not folder.is_dir():
        raise ConfigError(f"--detections {folder}: {'not a folder' if folder.exists() else 'no such folder'}")
    for inner in (folder, folder / "data"):
        if any(find_numbered(inner, (".txt",), digits) for digits in (TRACKING_DIGITS, OBJECT_DIGITS)):
            return inner
    raise ConfigError(f"--detections {folder}: no file like 0000.txt (a sequence) or 000000.txt (a frame)")


def sequence_results(folder: Path, sequence: str, frames: FrameRange, bad: BadInput) -> Results | None:
    """Read the results of a sequence; `None` where it has no file. LogError names file and row that can't be used."""
    path = folder / f"{sequence}.txt"
    if not path.is_file():
        return None
    is_empty = not head_of(path).strip()
    try:
        parse, comma = _SEQUENCE_FORMS["kitti-tracking" if is_empty else recognize(path)]
    except (KeyError, LogError) as error:
        forms = "KITTI's 17 or 18 columns (frame, id, class ...) or AB3DMOT's 15 with commas between"
        raise LogError(f"{path}: no results of a sequence, expected {forms}") from error
    found = sequence_rows(path, parse, frames, bad, comma)
    has_3d, has_2d = _find_kinds(chain.from_iterable(found.frames.values()))
    return Results([path], lambda number: found.frames.get(number, ()), has_3d, has_2d, found.num_frames)


def frame_results(paths: Mapping[int, Path], bad: BadInput) -> Results | None:
    """Open the results of single frames by their files; `None` without any. LogError names file and row, when read."""
    if not paths:
        return None

    def rows(number: int) -> Sequence[LabeledObject] | None:
        return frame_rows(paths[number], object_label, bad) if number in paths else None

    def quiet_rows() -> Iterator[LabeledObject]:
        for path in paths.values():
            with suppress(LogError):  # what is wrong is reported when the frames are read
                yield from frame_rows(path, object_label, BadInput(skip=True))

    has_3d, has_2d = _find_kinds(quiet_rows())
    return Results(list(paths.values()), rows, has_3d, has_2d)


def _find_kinds(rows: Iterable[LabeledObject]) -> tuple[bool, bool]:
    """Whether there are 3D boxes, and 2D ones, reading until both were met; without any row there may be both."""
    has_3d = has_2d = has_row = False
    for row in rows:
        has_row, has_3d, has_2d = True, has_3d or row.solid is not None, has_2d or row.flat is not None
        if has_3d and has_2d:
            break
    return has_3d or not has_row, has_2d or not has_row
