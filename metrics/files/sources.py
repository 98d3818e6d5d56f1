"""Files and folders of boxes by the names of their sequences, read one by one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fbench.metrics.files.side import Side, objects_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.formats.kitti import read_ab3dmot_columns, read_object_columns, read_tracking_columns
from fbench.replay.formats.mot import read_mot_columns, sequence_length
from fbench.replay.formats.text import frame_number

if TYPE_CHECKING:
    from fbench.metrics.files.nuscenes import Submission
    from fbench.metrics.files.table import Table


@dataclass(frozen=True, eq=False)
class Source:
    """Where the boxes of one side are."""

    path: Path  # As the user named it
    form: str  # One of `sequences.FORMS`
    names: tuple[str, ...]  # Of its sequences, in their order
    is_single: bool  # Whether it can't have but one sequence, whose name then says nothing
    read: Callable[[str], Side]  # Gives the boxes of one sequence, or LogError naming file, row and column
    submission: "Callable[[], Submission | None]" = lambda: None  # Of nuScenes: knows its samples
    faults: FaultLog = field(default_factory=FaultLog)  # Gets what is wrong with logs


def open_texts(path: Path, form: str, files: Mapping[str, Path], is_truth: bool, is_single: bool) -> Source:
    """Open texts of KITTI tracking, AB3DMOT or MOTChallenge, one a sequence."""

    def read(name: str) -> Side:
        file = files[name]
        if form == "mot":
            return Side(
                objects_of(read_mot_columns(file, is_truth))[0], num_frames=sequence_length(file), first_pixel=1
            )
        columns = read_tracking_columns(file) if form == "kitti-tracking" else read_ab3dmot_columns(file)
        return Side(objects_of(columns)[0], space="camera")

    return Source(path, form, tuple(files), is_single, read)


def open_images(path: Path, files: Mapping[str, Path]) -> Source:
    """Open files of KITTI's object benchmark: one sequence of unrelated images. LogError if not named by a number."""
    numbers = {frame_number(name, str(file)): file for name, file in files.items()}
    keys = np.array(sorted(numbers), np.int64)

    def read(name: str) -> Side:
        return Side(objects_of(read_object_columns(numbers))[0], keys, space="camera", lists_frames=True)

    return Source(path, "kitti", (path.stem if path.is_file() else path.resolve().name,), True, read)


def open_tables(path: Path, files: Mapping[str, Path]) -> Source:
    """Open tables: a file a sequence, or by a column `sequence`. Raises LogError where two have one sequence."""
    from fbench.metrics.files.table import open_table  # what reads tables takes a while to import

    found: dict[str, tuple[Table, str]] = {}
    for stem, file in files.items():
        table = open_table(file)
        for own in table.sequences or ("",):
            if (name := own or stem) in found:
                raise LogError(f"{path}: two tables have the sequence '{name}'")
            found[name] = table, own
    is_single = len(files) == 1 and path.is_file() and not next(iter(found.values()))[1]

    def read(name: str) -> Side:
        table, own = found[name]
        return table.read(own)

    return Source(path, "table", tuple(found), is_single, read)


def open_submissions(path: Path, like: Source | None) -> Source:
    """Open a submission; the truth, `like`, may tell its samples. Sequences are scenes; without any one as the file."""
    from fbench.metrics.files.nuscenes import open_submission  # what nuScenes needs takes a while to import

    submission = open_submission(path, None if like is None else like.submission())
    names, is_single = tuple(scene or path.stem for scene in submission.tokens), list(submission.tokens) == [""]

    def read(name: str) -> Side:
        return submission.read("" if is_single else name)

    return Source(path, "nuscenes", names, is_single, read, lambda: submission)
