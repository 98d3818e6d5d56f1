"""Which files an export consists of."""

import json
from collections.abc import Iterator
from types import TracebackType
from typing import Self

from fbench.replay.data import Kind
from fbench.replay.errors import LogError
from fbench.replay.export.image_rows import camera_of
from fbench.replay.export.kitti import kitti_rows
from fbench.replay.export.levels import coordinate_frame
from fbench.replay.export.mot import mot_rows, seqinfo
from fbench.replay.export.nuscenes import meta, nuscenes_samples
from fbench.replay.export.place import Draft
from fbench.replay.export.sequence import BoxSequence
from fbench.replay.export.wish import ExportWish, LeftOut


def view_of(sequence: BoxSequence, wish: ExportWish) -> str:
    """Say which image and coordinates the exported boxes of a sequence are in."""
    if wish.is_nuscenes:
        return "3D boxes in the world"
    camera = camera_of(sequence, wish.camera)
    has_solids = wish.format != "mot" and any(frame.boxes3d is not None for frame in sequence.frames)
    solids = f", 3D boxes in {coordinate_frame(sequence, wish.frame, camera)}" if has_solids else ""
    return f"2D boxes in {camera}{solids}"


class TextFiles:
    """Files of rows: of KITTI `NAME.txt`, or one for each frame; of MOTChallenge `NAME.txt`, or of truth
    `NAME/gt/gt.txt` and `NAME/seqinfo.ini`.
    """

    def __init__(self, draft: Draft, is_only: bool) -> None:
        """Begin; the files of a single sequence that has one for each frame lie in no folder of their own."""
        self._draft, self._is_only = draft, is_only

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def add(self, name: str, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[int]:
        """Write a sequence, and yield the number of rows of each frame."""
        if wish.format == "mot":
            return self._mot(name, sequence, wish, left)
        frames = kitti_rows(sequence, wish, left)
        if wish.format == "kitti":
            return self._frames(frames, "" if self._is_only else f"{name}/")
        return self._one((rows for _, rows in frames), f"{name}.txt")

    def _mot(self, name: str, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[int]:
        rows = mot_rows(sequence, wish, left)
        if not sequence.is_truth:
            return self._one(rows, f"{name}.txt")
        with self._draft.open(f"{name}/seqinfo.ini") as file:
            file.write(seqinfo(name, sequence, sequence.rig.cameras.get(camera_of(sequence, wish.camera))))
        return self._one(rows, f"{name}/gt/gt.txt")

    def _frames(self, frames: Iterator[tuple[int, list[str]]], folder: str) -> Iterator[int]:
        for number, rows in frames:
            with self._draft.open(f"{folder}{number:06d}.txt") as file:
                file.writelines(f"{row}\n" for row in rows)
            yield len(rows)

    def _one(self, frames: Iterator[list[str]], name: str) -> Iterator[int]:
        with self._draft.open(name) as file:
            for rows in frames:
                file.writelines(f"{row}\n" for row in rows)
                yield len(rows)


class Submission:
    """The one file of nuScenes, written sample by sample."""

    def __init__(self, draft: Draft) -> None:
        self._file = draft.open()
        self._owners: dict[str, str] = {}
        self._kinds: set[Kind] = set()

    def __enter__(self) -> Self:
        self._file.write('{"results": {')
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._file.write(f'\n}}, "meta": {json.dumps(meta(self._kinds))}}}\n')
        self._file.close()

    def add(self, name: str, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[int]:
        """Write the samples of a sequence, and yield the number of boxes of each.

        Raises:
            LogError: where a sample is another sequence's too.
        """
        self._kinds.update(sequence.kinds)
        for token, results in nuscenes_samples(sequence, wish, left):
            if token in self._owners:
                raise LogError(f"{sequence.where}: sample {token} is of {self._owners[token]} too")
            separator = "," if self._owners else ""
            self._owners[token] = sequence.where
            self._file.write(f"{separator}\n{json.dumps(token)}: {json.dumps(results, allow_nan=False)}")
            yield len(results)
