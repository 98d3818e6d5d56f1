"""MOTChallenge files by hand-checked values."""

import numpy as np
import pytest
from tests.replay.formats.box_files import form, read

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.formats.open import truth_entry
from fbench.replay.logs.setup import BoxSource

GT = "1,2,10,20,30,40,1,1,0.8\n3,2,11,20,30,40,0,12,0.1\n1,5,100,20,30,40,1,3,1\n"


def sequence(folder, text, inner="gt/gt.txt", info="[Sequence]\nname=MOT17-02\nseqLength=5\nimWidth=1920\n"):
    path = folder / inner
    path.parent.mkdir(parents=True)
    path.write_text(text)
    (folder / "seqinfo.ini").write_text(info)
    return folder


def test_ground_truth_by_hand(tmp_path):
    """Frames and pixels count from 1 there; frames of the sequence without rows are labeled, too."""
    path = sequence(tmp_path, GT)
    assert form(path) == form(path / "gt/gt.txt") == "mot"
    truths = read(path)
    assert [t.frame_index for t in truths] == [0, 1, 2, 3, 4]
    assert [len(t.boxes2d) for t in truths] == [2, 0, 1, 0, 0]
    first, third = truths[0].boxes2d, truths[2].boxes2d
    assert (truths[0].frame_number, truths[0].boxes3d) == (None, None)
    assert first.xyxy_px.tolist() == [[9, 19, 39, 59], [99, 19, 129, 59]]
    assert (first.label.tolist(), first.source_label.tolist()) == (["pedestrian", "car"], ["pedestrian", "car"])
    assert (first.track_id.tolist(), first.visibility.tolist(), first.score) == ([2, 5], [0.8, 1], None)
    assert (first.ignore.tolist(), third.ignore.tolist()) == ([False, False], [True])
    assert third.source_label.tolist() == ["reflection"]


def test_detections_and_results_have_scores(tmp_path):
    path = sequence(tmp_path, "1,-1,10,20,30,40,0.9,-1,-1,-1\n2,7,10.5,20,30,40,0.5,-1,-1,-1,\n", "det/det.txt")
    truths = read(path)
    assert len(truths) == 5
    assert truths[0].boxes2d.track_id.tolist() == [-1]
    assert (truths[1].boxes2d.score.tolist(), truths[1].boxes2d.ignore) == ([0.5], None)
    (tmp_path / "mine.txt").write_text("2, 7, 10.5, 20, 30, 40, 0.5, -1, -1, -1\n")
    truths = read(tmp_path / "mine.txt")
    assert len(truths) == 5
    np.testing.assert_allclose(truths[1].boxes2d.xyxy_px, [[9.5, 19, 39.5, 59]])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("1,2,10,20,30\n", "gt.txt line 1: 5 columns, expected 6 to 10"),
        ("1,2,10,20,30,x,1,1,1\n", "line 1: height is 'x', expected a number"),
        ("0,2,10,20,30,40,1,1,1\n", "line 1: frame is 0, but MOTChallenge counts frames from 1"),
        ("1.5,2,10,20,30,40,1,1,1\n", "line 1: frame is '1.5', expected a whole number"),
        ("1e300,2,10,20,30,40,1,1,1\n", "line 1: frame is '1e300', expected a whole number"),
        ("1,2,10,20,30,40,1,1,1\n1,2,10,20,30,40,1,1,1\n", "id 2 twice at frame 0"),
    ],
)
def test_bad_rows_name_the_line(tmp_path, text, match):
    with pytest.raises(FbenchError, match=match):
        read(sequence(tmp_path, text))


def test_bad_sequence_info(tmp_path):
    with pytest.raises(FbenchError, match=r"seqinfo.ini: no seqLength in \[Sequence\]"):
        read(sequence(tmp_path, GT, info="hello"))
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nseqLength=99999999999999\n")
    with pytest.raises(FbenchError, match="seqLength: frame is 99999999999999, expected 0 to"):
        read(tmp_path)


def test_the_length_of_the_sequence_is_part_of_the_digest(tmp_path):
    file = sequence(tmp_path, GT) / "gt/gt.txt"
    sources = BoxSource(file), BoxSource(tmp_path)
    before = [truth_entry(source).digest for source in sources]
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nseqLength=50\n")
    assert not set(before) & {truth_entry(source).digest for source in sources}
