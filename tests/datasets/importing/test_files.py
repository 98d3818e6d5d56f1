"""Files of datasets, sensors from published matrices, and how summaries list things."""

from collections import Counter

import numpy as np
import pytest
from pydantic import BaseModel

from fbench.datasets.importing.files import (
    BODY_T_OPTICAL,
    entries,
    find_numbered,
    find_runs,
    format_counts,
    format_list,
    format_runs,
    is_pinhole,
    is_rotation,
    mount_of,
    read_json,
)
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange
from fbench.replay.geometry.transforms import pose_matrix


def test_files_are_taken_by_number_and_suffix(tmp_path):
    for name in ("0010.txt", "0002.txt", "0002.bin", "2.txt", "00003.txt", "x004.txt", "٠٠٠١.txt"):
        (tmp_path / name).touch()
    assert {number: path.name for number, path in find_numbered(tmp_path, (".txt",), 4).items()} == {
        2: "0002.txt", 10: "0010.txt"
    }  # fmt: skip
    assert list(find_numbered(tmp_path, (".txt",), 4)) == [2, 10]
    assert list(find_numbered(tmp_path, (".txt",), 4, FrameRange(3))) == [10]


def test_nothing_is_in_a_folder_that_is_not_there(tmp_path):
    assert entries(tmp_path / "none") == []
    assert find_numbered(tmp_path / "none", (".txt",), 4) == {}


def test_entries_are_sorted_by_name(tmp_path):
    for name in ("b", "a", "A", "10", "9"):
        (tmp_path / name).touch()
    assert [path.name for path in entries(tmp_path)] == ["10", "9", "A", "a", "b"]


class Box(BaseModel):
    size: tuple[float, float]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"x.json: Invalid JSON: EOF"),
        ('[{"size": [1, 2]}, {"size": [1', r"x.json: Invalid JSON"),
        ("{}", r"x.json: Input should be a valid array$"),
        ('[{"size": [1, 2]}, {}]', r"x.json: 1.size: Field required$"),
        ('[{"size": [1, "a"]}]', r"x.json: 0.size.1: Input should be a valid number"),
        ("[" * 100_000, r"x.json: Invalid JSON: recursion limit"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_field(tmp_path, text, message):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(LogError, match=message):
        read_json(tmp_path / "x.json", list[Box])


def test_content_comes_as_its_model(tmp_path):
    (tmp_path / "x.json").write_text('[{"size": [1, 2], "other": 3}]')
    assert read_json(tmp_path / "x.json", list[Box]) == [Box(size=(1, 2))]


TURN = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])


def test_a_mount_is_the_pose_that_it_was_made_of():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN, (1, 2, 3)
    mount = mount_of("lidar", pose)
    assert mount.kind == "lidar"
    np.testing.assert_allclose(pose_matrix(mount.translation_m, mount.rotation_xyzw), pose, atol=1e-12)


def test_optical_axes_are_right_down_forward():
    right, down, forward = BODY_T_OPTICAL[:3, :3].T.tolist()
    assert (right, down, forward) == ([0, -1, 0], [0, 0, -1], [1, 0, 0])


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (np.eye(3), True),
        (TURN + np.diag([4e-4, 0, 0]), True),
        (TURN + 2e-3, False),
        (np.diag([1.0, 1, -1]), False),
        (np.zeros((3, 3)), False),
        (np.full((3, 3), np.nan), False),
        (np.full((3, 3), 1e300), False),
    ],
)
def test_rotations(matrix, expected):
    assert is_rotation(matrix) is expected


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        ((0, 1), 0.5, True),
        ((1, 0), 0.5, False),
        ((2, 2), 2, False),
        ((2, 0), 1e-9, False),
        ((0, 0), -700, False),
        ((1, 1), 0, False),
        ((0, 0), np.nan, False),
    ],
)
def test_pinholes(place, value, expected):
    K = np.array([[700.0, 0, 600], [0, 700, 200], [0, 0, 1]])
    K[place] = value
    assert is_pinhole(K) is expected


@pytest.mark.parametrize(
    ("things", "text"),
    [([], ""), ([7], "7"), ([1, 2, 3], "1, 2, 3"), ([1, 2, 3, 4], "1, 2, 3 and 1 more"), (["a", "b"], "a, b")],
)
def test_long_lists_end_with_how_many_more_there_are(things, text):
    assert format_list(things, 3) == text


@pytest.mark.parametrize(
    ("numbers", "text"),
    [([], ""), ([4], "4"), ([4, 5], "4 to 5"), ([0, 1, 2, 9], "0 to 2, 9"), ([1, 3, 5, 7, 8], "1, 3 and 2 more")],
)
def test_numbers_that_follow_one_another_are_one_run(numbers, text):
    assert format_runs(find_runs(numbers), 2) == text
    assert [number for run in find_runs(numbers) for number in run] == numbers


def test_counts_go_from_the_largest_and_then_by_name():
    assert format_counts(Counter({"Van": 1, "Car": 3, "Bus": 1})) == "Car 3, Bus 1, Van 1"
    assert format_counts(Counter()) == ""
