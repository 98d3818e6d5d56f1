"""Labels of the object and tracking benchmarks, and truth made of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fbench.datasets.kitti.files import bounded_lines
from fbench.datasets.kitti.rig import camera_name
from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.importing import BadInput, FrameRange
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.formats.kitti import DONT_CARE, parse_object_row, parse_tracking_row
from fbench.replay.formats.objects import Labelled, solids
from fbench.replay.formats.text import Line, frame_number

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
