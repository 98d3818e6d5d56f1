"""Results of other systems on KITTI's sequences and frames."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Protocol

from fbench.datasets.importing.files import numbered
from fbench.datasets.kitti.labels import (
    CAMERA,
    Parse,
    SequenceRows,
    boxes_3d,
    frame_rows,
    object_label,
    sequence_rows,
    tracking_label,
)
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.importing import BadInput, FrameRange
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.formats.documents import head_of
from fbench.replay.formats.kitti import parse_ab3dmot_row
from fbench.replay.formats.objects import Labelled, flats
from fbench.replay.formats.open import recognised
from fbench.replay.formats.text import digest_of

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
