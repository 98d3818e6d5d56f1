"""Rows of KITTI's label files by frame."""

from pathlib import Path

import pytest

from fbench.datasets.kitti.labels import sequence_rows, tracking_label
from fbench.replay.contracts.importing import BadInput, FrameRange

ROW = "{} 7 Car 0 0 -1.79 10 5 60 30 1.5 2 4 3 1.6 20 -0.5"


@pytest.mark.parametrize(("frames", "num"), [((), 0), ((0,), 1), ((0, 2), 3)])
def test_the_last_label_says_how_many_frames_there_are_at_least(tmp_path: Path, frames: tuple[int, ...], num: int):
    path = tmp_path / "0000.txt"
    path.write_text("".join(ROW.format(frame) + "\n" for frame in frames))
    found = sequence_rows(path, tracking_label, FrameRange(), BadInput())
    assert found.num_frames == num
    some = sequence_rows(path, tracking_label, FrameRange(1, 3), BadInput())
    assert list(some.frames) == [frame for frame in frames if 1 <= frame < 3]
