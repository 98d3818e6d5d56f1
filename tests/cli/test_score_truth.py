"""`fbench score --truth`: other truth for a finished run."""

import json

from tests.cli.conftest import messages as make_messages
from tests.cli.conftest import truths, write_log

SOLID = "x,y,z,length,width,height,yaw,label,track_id"


def rows(num=6, shift_ns=0):
    stamps = [1_000_000_000 + 100_000_000 * i + shift_ns for i in range(num)]
    lines = [f"{stamp},{12 + i},0,0.75,4,1.8,1.5,0,Car,a" for i, stamp in enumerate(stamps)]
    return f"stamp_ns,{SOLID}\n" + "\n".join(lines) + "\n"


def test_a_run_without_truth_is_scored_from_a_file(fbench, tmp_path):
    """The scores are those of the same boxes inside the log."""
    write_log(tmp_path / "bare.mcap", make_messages())
    write_log(tmp_path / "full.mcap", [*make_messages(), *truths()])
    assert fbench("replay", "bare.mcap", "-p", "lidar3d", "--all-around", "-o", "bare").code == 0
    assert fbench("replay", "full.mcap", "-p", "lidar3d", "--all-around", "-o", "full").code == 0
    (tmp_path / "truth.csv").write_text(rows())
    result = fbench("score", "bare", "--truth", "truth.csv", "--all-around")
    assert result.code == 0
    assert result.err == "truth: truth.csv has 6 instants and labels 6 of 6 frames\n"
    bare, full = (json.loads((tmp_path / name / "scores.json").read_text()) for name in ("bare", "full"))
    assert bare == full
    manifest = json.loads((tmp_path / "bare" / "manifest.json").read_text())
    assert (manifest["truth"]["name"], manifest["truth"]["format"]) == ("truth.csv", "table")
    assert fbench("score", "bare").code == 0


def test_what_doesnt_fit_is_one_line(fbench, tmp_path, log):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "run").code == 0
    (tmp_path / "late.csv").write_text(rows(shift_ns=5_000_000_000))
    result = fbench("score", "run", "--truth", "late.csv")
    assert result.code == 3
    assert "none of its 6 instants, 6000000000 to 6500000000 ns, belongs to a frame of the run" in result.err
    assert result.err.count("\n") == 1
    result = fbench("score", "run", "--truth", "none.csv")
    assert (result.code, result.err) == (2, "fbench: none.csv: no such file or folder\n")
    result = fbench("score", "run", "--truth", "late.csv", "--truth-format", "cocoo")
    assert result.code == 2
    assert "'cocoo' is no form of boxes; there are: ab3dmot, kitti," in result.err


def test_2d_truth_by_frame(fbench, tmp_path, log):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "run").code == 0
    (tmp_path / "gt.txt").write_text("1,1,20,20,10,10,1,3,1\n3,1,20,20,10,10,1,3,1\n")
    result = fbench("score", "run", "--truth", "gt.txt", "--truth-frame", "camera")
    assert result.code == 0
    assert "3 instants and labels 3 of 6 frames" in result.err
