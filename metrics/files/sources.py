"""Files and folders of boxes by the names of their sequences, read one by one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from fbench.metrics.files.logs import LogTruth
from fbench.metrics.files.nuscenes import Submission, open_submission
from fbench.metrics.files.side import Side, objects_of
from fbench.metrics.files.table import Table, open_table
from fbench.replay.contracts.errors import LogError
from fbench.replay.formats.kitti import read_ab3dmot_columns, read_object_columns, read_tracking_columns
from fbench.replay.formats.mot import read_mot_columns, sequence_length
from fbench.replay.formats.objects import Columns
from fbench.replay.formats.text import frame_number


class Source(Protocol):
    """Where the boxes of one side are."""

    @property
    def path(self) -> Path:
        """As the user named it."""
        ...

    @property
    def form(self) -> str:
        """One of `forms.FORMS`."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Of its sequences, in their order."""
        ...

    @property
    def is_single(self) -> bool:
        """Whether it can't have but one sequence, whose name then says nothing."""
        ...

    def read(self, name: str) -> Side:
        """Return the boxes of one sequence.

        Raises:
            LogError: naming file, row and column of what can't be read.
        """
        ...


@dataclass(frozen=True)
class TextSource:
    """A text a sequence."""

    path: Path
    form: str
    files: Mapping[str, Path]
    """By sequence."""
    reader: Callable[[Path], Columns]
    is_single: bool

    @property
    def names(self) -> tuple[str, ...]:
        """In the order of files."""
        return tuple(self.files)

    def read(self, name: str) -> Side:
        """Read its file; `seqinfo.ini` near it tells the length."""
        file = self.files[name]
        is_mot = self.form == "mot"
        return Side(
            objects_of(self.reader(file))[0],
            num_frames=sequence_length(file) if is_mot else None,
            space="" if is_mot else "camera",
            first_pixel=1 if is_mot else 0,
        )


@dataclass(frozen=True)
class ImageSource:
    """A text an image: all of them are one sequence of images that have nothing to do with each other."""

    path: Path
    form: str
    files: Mapping[int, Path]
    is_single: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """The name of the folder."""
        return (self.path.stem if self.path.is_file() else self.path.resolve().name,)

    def read(self, name: str) -> Side:
        """Read all files."""
        keys = np.array(sorted(self.files), np.int64)
        return Side(objects_of(read_object_columns(self.files))[0], keys, space="camera", lists_frames=True)


@dataclass(frozen=True)
class TableSource:
    """Tables: a file a sequence, or a file whose column `sequence` tells them apart."""

    path: Path
    tables: Mapping[str, tuple[Table, str]]
    """Table and its own name for the sequence."""
    is_single: bool
    form: str = "table"

    @property
    def names(self) -> tuple[str, ...]:
        """In the order of files, then of rows."""
        return tuple(self.tables)

    def read(self, name: str) -> Side:
        """Read its rows."""
        table, own = self.tables[name]
        return table.read(own)


@dataclass(frozen=True)
class SubmissionSource:
    """A nuScenes submission."""

    submission: Submission
    form: str = "nuscenes"

    @property
    def path(self) -> Path:
        """The JSON file."""
        return self.submission.path

    @property
    def names(self) -> tuple[str, ...]:
        """Scenes; the file's name where there is one that has none."""
        return tuple(scene or self.path.stem for scene in self.submission.scenes)

    @property
    def is_single(self) -> bool:
        """Where no scenes are told."""
        return self.submission.scenes == ("",)

    def read(self, name: str) -> Side:
        """Read its samples."""
        return self.submission.read("" if self.is_single else name)


def texts(path: Path, form: str, files: Mapping[str, Path], is_truth: bool, is_single: bool) -> TextSource:
    """Return texts of KITTI tracking, AB3DMOT or MOTChallenge."""
    readers: dict[str, Callable[[Path], Columns]] = {
        "kitti-tracking": read_tracking_columns,
        "ab3dmot": read_ab3dmot_columns,
        "mot": lambda file: read_mot_columns(file, is_truth),
    }
    return TextSource(path, form, files, readers[form], is_single)


def images(path: Path, files: Mapping[str, Path]) -> ImageSource:
    """Return the files of KITTI's object benchmark.

    Raises:
        LogError: where one isn't named by a number.
    """
    return ImageSource(path, "kitti", {frame_number(name, str(file)): file for name, file in files.items()})


def tables(path: Path, files: Mapping[str, Path]) -> TableSource:
    """Return tables by sequence.

    Raises:
        LogError: where one can't be read, or two have one sequence.
    """
    found: dict[str, tuple[Table, str]] = {}
    for stem, file in files.items():
        table = open_table(file)
        for own in table.sequences or ("",):
            if (name := own or stem) in found:
                raise LogError(f"{path}: two tables have the sequence '{name}'")
            found[name] = table, own
    is_single = len(files) == 1 and path.is_file() and not next(iter(found.values()))[1]
    return TableSource(path, found, is_single)


def submission(path: Path, like: Source | None) -> SubmissionSource:
    """Return a submission whose samples those of the truth, `like`, may tell."""
    known = like.submission if isinstance(like, SubmissionSource | LogTruth) else None
    return SubmissionSource(open_submission(path, known))
