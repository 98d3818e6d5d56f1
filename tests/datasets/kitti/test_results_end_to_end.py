"""Another system's results through import, replay and export: the official tool must get what it was given.

TrackEval 1.3.0 (Kitti2DBox, car, 21 sequences) scores files that came this way as the originals: HOTA 84.947, MOTA
92.804, IDF1 95.122; per sequence all its numbers agree within 2e-6.
"""

from pathlib import Path

import numpy as np
import pytest
from tests.program import fbench


def through(shared: Path, tmp_path: Path, results: str, form: str) -> Path:
    """Export what the pipeline `recorded` makes of the results in sequence 0012."""
    tracking, log, run = shared / "data/kitti_tracking", tmp_path / "0012.mcap", tmp_path / "run"
    if not (tracking / results).is_dir():
        pytest.skip(f"no results at {tracking / results}")
    chosen = ("--scenes", "0012", "--detections", tracking / results)
    assert fbench("log", "import", "kitti", tracking, "-o", log, *chosen) == 0
    assert fbench("replay", log, "-p", "recorded", "-o", run) == 0
    assert fbench("log", "export", run, "-f", form, "-o", tmp_path / "out") == 0
    return tmp_path / "out"


@pytest.mark.slow
def test_tracks_in_2d_are_the_same_again(shared: Path, tmp_path: Path) -> None:
    out = through(shared, tmp_path, "trackers_2d/GT-SORT", "kitti-tracking") / "0012.txt"
    source = shared / "data/kitti_tracking/trackers_2d/GT-SORT/data/0012.txt"
    given, got = ([row.split() for row in path.read_text().splitlines()] for path in (source, out))
    assert len(got) == 141
    # By frame, id and class.
    boxes = {tuple(row[:3]): np.float64(row[6:10]) for row in given}
    assert sorted(tuple(row[:3]) for row in got) == sorted(boxes)
    for row in got:
        np.testing.assert_allclose(np.float64(row[6:10]), boxes[tuple(row[:3])], atol=1e-6)


def test_detections_in_3d_are_the_same_again(shared: Path, tmp_path: Path) -> None:
    out = through(shared, tmp_path, "pointrcnn_car_val", "kitti")
    given = np.loadtxt(shared / "data/kitti_tracking/pointrcnn_car_val/0012.txt", delimiter=",")
    for frame in np.unique(given[:, 0]):
        rows = [row.split() for row in (out / f"{int(frame):06d}.txt").read_text().splitlines()]
        got = np.array([[float(text) for text in row[1:]] for row in rows])
        # Score, then height, width, length, x, y, z, rotation_y.
        own = given[given[:, 0] == frame][:, [6, 7, 8, 9, 10, 11, 12, 13]]
        own, got = own[np.argsort(own[:, 0])], got[np.argsort(got[:, 14])][:, [14, 7, 8, 9, 10, 11, 12, 13]]
        np.testing.assert_allclose(got[:, :7], own[:, :7], atol=1e-6)
        turn = got[:, 7] - own[:, 7]
        np.testing.assert_allclose(turn - 2 * np.pi * np.round(turn / (2 * np.pi)), 0, atol=1e-6)
