"""Regular files are read at once, others row by row; both give the same columns and the same errors."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.files.side import objects_of
from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.formats import kitti, mot

DONT_CARE = "0 -1 DontCare -1 -1 -10 10 20 30 40 -1000 -1000 -1000 -10 -1 -1 -1"
CAR = "0 3 Car 0 2 -1.79 296.7 161.7 455.2 292.3 2.0 1.8 4.4 -4.5 1.8 13.4 -2.1"
FLAT = "1 7 Car -1.0 -1 -1 296.7 161.7 455.2 292.3 -1 -1 -1 -1 -1 -1 -1 -1 1 "
SOLID = "2 8 Cyclist 0 0 0.5 -1 -1 -1 -1 2.0 1.8 4.4 -4.5 1.8 13.4 -2.1"


sequence_by_row, images_by_row, mot_by_row = kitti.columns_by_row, kitti._object_columns_by_row, mot._columns_by_row


def read_tracking(path):
    return objects_of(kitti.read_tracking_columns(path))[0]


def read_tracking_rows(path):
    return objects_of(sequence_by_row(path, None, kitti.parse_tracking_row))[0]


def read_ab3dmot(path):
    return objects_of(kitti.read_ab3dmot_columns(path))[0]


def read_ab3dmot_rows(path):
    return objects_of(sequence_by_row(path, ",", kitti.parse_ab3dmot_row))[0]


def read_images(files):
    return objects_of(kitti.read_object_columns(files))[0]


def read_images_rows(files):
    return objects_of(images_by_row(files))[0]


def read_mot(path, is_truth):
    return objects_of(mot.read_mot_columns(path, is_truth))[0]


def read_mot_rows(path, is_truth):
    return objects_of(mot_by_row(path, is_truth))[0]


def same(one, other):
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert (a is None) == (b is None), field.name
        if a is not None:
            assert a.dtype.kind == b.dtype.kind
            np.testing.assert_array_equal(a, b, field.name)


@pytest.fixture
def fast_only(monkeypatch):
    """Fail where the careful reader is called."""

    def called(*args):
        raise AssertionError("not read at once")

    monkeypatch.setattr(kitti, "columns_by_row", called)
    monkeypatch.setattr(kitti, "_object_columns_by_row", called)
    monkeypatch.setattr(mot, "_columns_by_row", called)


@pytest.mark.parametrize("rows", [[DONT_CARE, CAR], [CAR, SOLID, DONT_CARE], [FLAT, FLAT.replace("7", "8")], [CAR]])
def test_kitti_rows(rows, write, fast_only):
    path = write("0000.txt", "\n".join(rows) + "\n")
    same(read_tracking(path), read_tracking_rows(path))


def test_what_kitti_rows_mean(write):
    found = read_tracking(write("0000.txt", f"{SOLID}\n{DONT_CARE}\n{CAR}\n"))
    assert found.step.tolist() == [0, 0, 2]
    assert found.label.tolist() == ["dontcare", "car", "cyclist"]
    assert found.track_id.tolist() == [-1, 3, 8]
    assert found.ignore.tolist() == [True, False, False]
    assert found.xyxy_px[1].tolist() == [296.7, 161.7, 455.2, 292.3]
    assert np.isnan(found.xyxy_px[2]).all()
    assert np.isnan(found.center_m[0]).all()
    np.testing.assert_array_equal(found.center_m[1], [13.4, 4.5, 2.0 / 2 - 1.8])
    assert found.size_lwh_m[1].tolist() == [4.4, 1.8, 2.0]
    assert found.yaw_rad[1] == pytest.approx(2.1 - np.pi / 2)
    assert (found.occlusion[1], found.truncation[1], found.alpha_rad[1]) == (2, 0, -1.79)
    assert np.isnan([found.occlusion[0], found.truncation[0], found.alpha_rad[0]]).all()


def test_irregular_files_are_read_row_by_row(write):
    regular = write("a.txt", f"{DONT_CARE}\n{CAR}\n")
    odd = write("b.txt", f"\ufeff  {DONT_CARE}\r\n\r\n{CAR.replace(' ', '   ')} 0\n")
    a, b = read_tracking(regular), read_tracking(odd)
    same(a, b)


def test_frames_may_be_written_as_numbers_with_a_point(write):
    path = write("0000.txt", f"{CAR.replace('0 3', '2.0 3.0', 1)}\n")
    odd = write("odd.txt", f"{CAR.replace('0 3', '2.0 3.0', 1)} nan\n")
    assert read_tracking(path).step.tolist() == read_tracking(odd).step.tolist() == [2]
    with pytest.raises(LogError, match=r"odd.txt line 1: frame is '2.5', expected a whole number"):
        read_tracking(write("odd.txt", f"{CAR.replace('0 3', '2.5 3', 1)}\n"))


@pytest.mark.parametrize("solid", ["0 0 0 0 0 0 0", "0 0 0 0 0 0 -10", "0 0 0 0 0 1 0", "1 0 0 0 0 0 0"])
def test_zeros_in_place_of_solids(solid, write):
    path = write("0000.txt", f"0 1 Car 0 0 -10 100 100 150 160 {solid}\n{CAR}\n")
    found = read_tracking(path)
    same(found, read_tracking_rows(path))
    assert np.isnan(found.center_m[0]).all() == ("1" not in solid.split())


def test_flags_of_truth_are_rounded_and_results_keep_their_scores(write):
    """Truth flagged 0.5 doesn't count in TrackEval; results with a class (8 or 9 columns) have a score."""
    path = write("a.txt", "1,1,10,20,30,40,0.5,1\n1,2,10,20,30,40,-1,1\n1,3,10,20,30,40,1,1\n")
    truth, results = read_mot(path, True), read_mot(path, False)
    same(truth, read_mot_rows(path, True))
    same(results, read_mot_rows(path, False))
    assert (truth.ignore.tolist(), truth.score.tolist()) == ([True, False, False], [0, 0, 0])
    assert (results.ignore, results.score.tolist()) == (None, [0.5, -1, 1])


numbers = st.floats(-1e6, 1e6, allow_nan=False) | st.integers(-1, 3)


@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(-1, 9), st.lists(numbers, min_size=15, max_size=15)), max_size=6)
)
def test_any_numbers(tmp_path_factory, rows):
    text = "\n".join(f"{f} {i} Car {' '.join(map(repr, values))}" for f, i, values in rows)
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_text(text)
    same(read_tracking(path), read_tracking_rows(path))


def test_ab3dmot_rows(write, fast_only):
    row = "{},2,786.7,180.1,1241.0,374.0,12.2,1.5,1.6,4.4,2.9,1.6,6.4,-1.5,-2.0"
    path = write("0001.txt", f"{row.format(1)}\n{row.format(0)}\n{row.format(1).replace(',2,', ',9,', 1)}\n")
    found = read_ab3dmot(path)
    same(found, read_ab3dmot_rows(path))
    assert found.label.tolist() == ["car", "car", "9"]
    assert found.score.tolist() == [12.2] * 3


@pytest.mark.parametrize("is_truth", [True, False])
@pytest.mark.parametrize(
    "rows",
    [
        ["1,2,912,484,97,109,0,7,1", "2,2,912,484,97,109,1,1,0.5", "2,-1,1.5,2,3,4,1,99,0"],
        ["3,1,794.2,247.5,71.2,174.8,0.9,-1,-1,-1", "1,1,794.2,247.5,71.2,174.8,0,-1,-1,-1"],
        ["1,1,10,20,30,40"],
        ["1,1,10,20,30,40,0.5,-1,-1,-1,"],
    ],
)
def test_mot_rows(rows, is_truth, write, fast_only):
    path = write("gt.txt", "\n".join(rows) + "\n")
    same(read_mot(path, is_truth), read_mot_rows(path, is_truth))


def test_what_mot_rows_mean(write):
    found = read_mot(write("gt.txt", "1,2,912,484,97,109,0,7,0.25\n3,4,1,2,3,4,1,1,1\n"), is_truth=True)
    assert found.step.tolist() == [0, 2]
    assert found.label.tolist() == ["static person", "pedestrian"]
    assert found.ignore.tolist() == [True, False]
    assert found.visibility.tolist() == [0.25, 1]
    assert found.xyxy_px.tolist() == [[912, 484, 1009, 593], [1, 2, 4, 6]]
    results = read_mot(write("r.txt", "1,2,912,484,97,109,0.75,-1,-1,-1\n"), is_truth=False)
    assert (results.label.tolist(), results.score.tolist()) == (["pedestrian"], [0.75])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (CAR.replace("13.4", "far"), r"0000\.txt line 2: z is 'far', expected a number"),
        (CAR.rsplit(" ", 3)[0], r"line 2: 14 columns, expected 17, or 18 with a score"),
        ("-1" + CAR[1:], r"line 2: frame is -1, expected 0 to 9999999"),
        ("99999999" + CAR[1:], r"line 2: frame is 99999999, expected 0 to"),
        (CAR.replace(" 3 Car", " 3.5 Car"), r"line 2: track id is '3.5', expected a whole number"),
    ],
)
def test_wrong_rows_are_named(text, told, write):
    with pytest.raises((LogError, LimitError), match=told):
        read_tracking(write("0000.txt", f"{DONT_CARE}\n{text}\n"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0,1,1,1,1,1,1,1,1", "line 1: frame is 0, but MOTChallenge counts frames from 1"),
        ("1,1,1,1,1", "line 1: 5 columns, expected 6 to 10"),
        ("1,1,1,wide,1,1", "line 1: top is 'wide', expected a number"),
    ],
)
def test_wrong_mot_rows_are_named(text, told, write):
    with pytest.raises(LogError, match=told):
        read_mot(write("gt.txt", text + "\n"), is_truth=True)


def test_images(write, fast_only):
    rows = [row.split(" ", 2)[2] for row in (DONT_CARE, CAR, SOLID)]
    texts = {7: f"{rows[0]}\n{rows[1]}\n", 3: "", 12: f"{rows[2]}\n\n", 10: "\n"}
    files = {number: write(f"{number:06}.txt", text) for number, text in texts.items()}
    same(read_images(files), read_images_rows(files))
    assert read_images(files).step.tolist() == [7, 7, 12]
    assert len(read_images({3: files[3]})) == 0


def test_irregular_images(write):
    row = CAR.split(" ", 2)[2]
    files = {1: write("1.txt", f"{row}\n\n{row} 0.5\n"), 2: write("2.txt", row)}
    assert read_images(files).score.tolist() == [0, 0.5, 0]


def test_what_isnt_finite_is_kept_by_both(write):
    path = write("0000.txt", CAR.replace("13.4", "nan") + "\n")
    assert np.isnan(read_tracking(path).center_m[0, 0])


def test_empty_files(write):
    for text in ("", "\n \n"):
        path = write("0000.txt", text)
        for found in (read_tracking(path), read_mot(path, True), read_ab3dmot(path)):
            assert len(found) == 0
            assert found.center_m.shape == (0, 3)
            assert found.xyxy_px.shape == (0, 4)


def test_all_kitti_files_give_the_same(shared, fast_only):
    folder = shared / "data/kitti_tracking"
    files = [
        *sorted((folder / "label_02").glob("*.txt"))[:3],
        *sorted((folder / "trackers_2d/GT-SORT/data").glob("*"))[:3],
    ]
    for file in files:
        same(read_tracking(file), read_tracking_rows(file))
    for file in sorted((folder / "pointrcnn_car_val").glob("*.txt"))[:1]:
        same(read_ab3dmot(file), read_ab3dmot_rows(file))
