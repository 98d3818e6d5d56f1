"""Truth at other stamps than the frames', the coverage of a run, and the gate on it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.city_log import write_city_log
from tests.cli.conftest import MS, messages, truths, write_log

from fbench.cli.run_summary import require_coverage
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.runs.folder import Run
from fbench.replay.runs.shares import Coverage


@pytest.fixture
def sparse(tmp_path):
    """A car that drives away at 10 m/s, labeled in frames 0, 2 and 5 of 6."""
    return write_log(tmp_path / "sparse.mcap", [*messages(), *(t for i, t in enumerate(truths()) if i in (0, 2, 5))])


def places(folder):
    run = Run(Path(folder))
    solid = {f.index: run.truth3d(f.index) for f in run.frames}
    return {index: boxes.center_m[0, 0] for index, boxes in solid.items() if boxes is not None}


def later(truth):
    """8 ms later, when the car is 80 mm farther away."""
    stamp_ns, center_m = truth.stamp_ns + 8 * MS, truth.boxes3d.center_m + np.array([0.08, 0, 0])
    return replace(truth, stamp_ns=stamp_ns, log_ns=stamp_ns, boxes3d=replace(truth.boxes3d, center_m=center_m))


def coverage_line(result):
    return next(line for line in result.out.splitlines() if line.startswith("truth: "))


@pytest.mark.slow
def test_frames_between_truths_are_labeled_where_that_is_wanted(fbench, sparse):
    result = fbench("replay", sparse, "-p", "lidar3d", "-o", "plain")
    assert coverage_line(result) == "truth: 50.0 % of outputs had truth (3 of 6 frames)"
    assert places("plain") == {0: 12, 2: 14, 5: 17}
    result = fbench("replay", sparse, "-p", "lidar3d", "-o", "filled", "--interpolate-truth", "200")
    assert coverage_line(result) == "truth: 66.7 % of outputs had truth (4 of 6 frames, 1 of them by interpolation)"
    assert places("filled") == {0: 12, 1: pytest.approx(13, abs=1e-9), 2: 14, 5: 17}
    result = fbench("replay", sparse, "-p", "lidar3d", "-o", "all", "--interpolate-truth", "300", "--json")
    assert places("all") == {i: pytest.approx(12 + i, abs=1e-9) for i in range(6)}
    assert result.json()["manifest"]["interpolation"] == {"max_gap_ns": 300 * MS, "num_frames": 3}
    whole, part = Run(Path("plain")), Run(Path("all"))
    assert part.manifest.digest == whole.manifest.digest
    assert part.manifest.log.digest == whole.manifest.log.digest


def test_too_little_truth(fbench, sparse):
    good = fbench("replay", sparse, "-p", "lidar3d", "-o", "run", "--min-coverage", "0.5")
    assert (good.code, "too little" in good.err) == (0, False)
    bad = fbench("replay", sparse, "-p", "lidar3d", "-o", "run", "--overwrite", "--min-coverage", "0.95")
    assert bad.code == 1
    assert bad.err.splitlines()[-1] == (
        "too little truth: 50.0 % of outputs had truth (3 of 6 frames), but --min-coverage requires 0.95"
    )
    assert require_coverage(Run(Path("run")), 0.95, EXIT_LOSSY) == EXIT_LOSSY
    assert require_coverage(Run(Path("run")), 0.5, EXIT_OK) == EXIT_OK
    assert fbench("replay", sparse, "-p", "lidar3d", "-o", "x", "--min-coverage", "95").code == 2
    assert fbench("replay", sparse, "-p", "lidar3d", "-o", "x", "--interpolate-truth", "nan").code == 2


def test_truth_beside_the_instants_is_moved_to_them(fbench, tmp_path):
    """At the instants the boxes are where the car was, but for the first, before which nothing is known."""
    write_log(tmp_path / "late.mcap", [*messages(), *map(later, truths())])
    assert fbench("replay", "late.mcap", "-p", "lidar3d", "-o", "run").code == 0
    assert places("run") == {0: 12.08, **{i: pytest.approx(12 + i, abs=1e-9) for i in range(1, 6)}}
    result = fbench("replay", "late.mcap", "-p", "lidar3d", "-o", "again", "--rate", "20", "--read-ahead", "0")
    assert result.code == 0
    assert Path("again/truth.parquet").read_bytes() == Path("run/truth.parquet").read_bytes()


def test_shares_are_only_100_where_all_is_there():
    told = [
        str(Coverage(*counts)).partition(" of")[0] for counts in ((176, 180), (0, 9), (9, 9), (9999, 10000), (1, 9999))
    ]
    assert told == ["97.8 %", "0 %", "100 %", "99.9 %", "0.1 %"]
    assert str(Coverage(1, 1)) == "100 % of outputs had truth (1 of 1 frame)"


def test_thinned_truth_of_the_city(fbench):
    """Every third frame's truth gives that of the frames between: cars brake and turn, so some centimetres off."""
    write_city_log(Path("city.mcap"), seconds=1.0)
    assert fbench("replay", "city.mcap", "-p", "lidar3d", "-o", "full").code == 0
    full = Run(Path("full"))
    rows = pd.read_parquet("full/truth.parquet").query("frame % 3 == 0")
    place = pd.DataFrame(rows["center_m"].tolist(), columns=["x", "y", "z"], index=rows.index)
    size = pd.DataFrame(rows["size_lwh_m"].tolist(), columns=["length", "width", "height"], index=rows.index)
    rest = rows[["frame", "yaw_rad", "label", "track_id"]].rename(columns={"yaw_rad": "yaw"})
    pd.concat([rest, place, size], axis=1).to_csv("thin.csv", index=False)
    options = ("-p", "lidar3d", "--truth", "thin.csv", "--interpolate-truth", "300")
    assert fbench("replay", "city.mcap", *options, "-o", "thin").code == 0
    thin, num = Run(Path("thin")), len(full.frames)
    assert thin.manifest.interpolation.num_frames == (num - 1) // 3 * 2
    off, turned = [], []
    for index in range((num - 1) // 3 * 3 + 1):
        known, found = full.truth3d(index), thin.truth3d(index)
        ids = {int(track): row for row, track in enumerate(known.track_id)}
        at = [ids[int(track)] for track in found.track_id]
        off += np.linalg.norm(known.center_m[at] - found.center_m, axis=1).tolist()
        turned += np.abs(np.angle(np.exp(1j * (known.yaw_rad[at] - found.yaw_rad)))).tolist()
    assert (len(off) > 50, max(off) < 0.15, np.median(off) < 0.01, max(turned) < 0.03) == (True,) * 4
    assert json.loads(Path("thin/manifest.json").read_text())["digest"] == full.manifest.digest
