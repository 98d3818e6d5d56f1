"""MOTChallenge: ground truth and results (https://motchallenge.net/instructions)."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from fbench.replay.arrays import Bool
from fbench.replay.boxfiles.mot import SHIFT_PX
from fbench.replay.data import CameraModel
from fbench.replay.export.classes import MOT_NUMBERS, namer
from fbench.replay.export.ids import small_ids
from fbench.replay.export.image_rows import ImageRows, camera_of, image_rows, require_view
from fbench.replay.export.sequence import BoxSequence
from fbench.replay.export.wish import ExportWish, LeftOut

_DISTRACTOR = "distractor"
"""Class of what is neither a hit nor a miss."""
_SURE = 1.0
"""Confidence of results that have no score."""
_S = 1_000_000_000


def mot_rows(sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[list[str]]:
    """Yield the rows of each frame: `frame,id,left,top,width,height,` and then `confidence,-1,-1,-1` for results,
    `counts,class,visibility` for truth, as of MOT16. Frames and pixels count from 1; a frame's number is its place in
    the log.

    Raises:
        ConfigError: where a camera isn't known.
        LogError: where truth has no class, or boxes can't be projected.
    """
    camera = camera_of(sequence, wish.camera)
    require_view(sequence, camera)
    writer = _Writer(sequence, wish, left)
    for frame in sequence.frames:
        yield writer.texts(frame.index + 1, image_rows(frame, camera, left))


class _Writer:
    """Writes the rows of one sequence."""

    def __init__(self, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> None:
        self._is_truth, self._left = sequence.is_truth, left
        self._names = namer(wish, sequence.where)
        self._small = small_ids(sequence.boxes)
        self._free = 1 + max(
            (self._small(int(boxes.track_id.max())) for boxes in sequence.boxes if boxes.track_id is not None),
            default=0,
        )

    def texts(self, number: int, rows: ImageRows) -> list[str]:
        """Return the rows of a frame."""
        ignored: Bool = rows.column("ignore", False) if self._is_truth else np.zeros(len(rows), bool)
        known = ignored | (rows.column("track_id", -1) >= 0)
        self._left.add("without a track id", int(np.count_nonzero(~known)))
        rows, ignored = rows[known], ignored[known]
        if self._is_truth:
            names = self._classes(rows, ignored)
            has: Bool = names != ""
            self._left.add("of classes that MOTChallenge doesn't have", int(np.count_nonzero(~has)))
            rows, ends = rows[has], _truths(rows[has], names[has].tolist(), ignored[has])
        else:
            ends = _scores(rows)
        ids = [self._id(id_) for id_ in rows.column("track_id", -1).tolist()]
        corner, size = rows.xyxy_px[:, :2] + SHIFT_PX, rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]
        return [
            f"{number},{id_},{left:.4f},{top:.4f},{width:.4f},{height:.4f},{end}"
            for id_, (left, top), (width, height), end in zip(ids, corner.tolist(), size.tolist(), ends, strict=True)
        ]

    def _id(self, id_: int) -> int:
        """Regions that are ignored have ids there too, and no two rows of a frame the same."""
        if id_ >= 0:
            return self._small(id_)
        self._free += 1
        return self._free - 1

    def _classes(self, rows: ImageRows, ignored: Bool) -> "np.ndarray[Any, np.dtype[np.object_]]":
        """Class of each row (N,), empty where there is none for it."""
        names = np.full(len(rows), _DISTRACTOR, dtype=object)
        names[~ignored] = rows[~ignored].names(self._names)
        return names


def _truths(rows: ImageRows, names: Sequence[str], ignored: Bool) -> list[str]:
    visible = rows.column("visibility", np.nan).tolist()
    return [
        f"{0 if skip else 1},{MOT_NUMBERS[name]},{share if 0 <= share <= 1 else 1.0:.4f}"
        for skip, name, share in zip(ignored, names, visible, strict=True)
    ]


def _scores(rows: ImageRows) -> list[str]:
    scores = rows.column("score", np.nan).tolist()
    return [f"{_SURE if np.isnan(score) else score:.6f},-1,-1,-1" for score in scores]


def seqinfo(name: str, sequence: BoxSequence, camera: CameraModel | None) -> str:
    """Return the text of `seqinfo.ini`: the rate is that of the stamps' median distance, 0 where there is none; so is
    the size of an image that isn't known.
    """
    stamps = np.array([frame.stamp_ns for frame in sequence.frames], np.int64)
    indices = np.array([frame.index for frame in sequence.frames], np.int64)
    periods_ns = np.diff(stamps) / np.maximum(np.diff(indices), 1)
    period_ns = float(np.median(periods_ns)) if len(periods_ns) else 0.0
    width, height = (0, 0) if camera is None else camera.size_wh
    rate = round(_S / period_ns) if period_ns > 0 else 0
    lines = (
        "[Sequence]", f"name={name}", "imDir=img1", f"frameRate={rate}", f"seqLength={sequence.num_frames}",
        f"imWidth={width}", f"imHeight={height}", "imExt=.jpg",
    )  # fmt: skip
    return "".join(f"{line}\n" for line in lines)
