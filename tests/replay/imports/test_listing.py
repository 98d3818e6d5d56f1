"""Finding the files of datasets."""

from fbench.datasets.importing.files import entries, numbered
from fbench.replay.contracts.importing import FrameRange


def test_files_are_taken_by_number_and_suffix(tmp_path):
    for name in ("0010.txt", "0002.txt", "0002.bin", "2.txt", "00003.txt", "x004.txt", "٠٠٠١.txt"):
        (tmp_path / name).touch()
    assert {number: path.name for number, path in numbered(tmp_path, (".txt",), 4).items()} == {
        2: "0002.txt", 10: "0010.txt"
    }  # fmt: skip
    assert list(numbered(tmp_path, (".txt",), 4)) == [2, 10]
    assert list(numbered(tmp_path, (".txt",), 4, FrameRange(3))) == [10]


def test_nothing_is_in_a_folder_that_is_not_there(tmp_path):
    assert entries(tmp_path / "none") == []
    assert numbered(tmp_path / "none", (".txt",), 4) == {}


def test_entries_are_sorted_by_name(tmp_path):
    for name in ("b", "a", "A", "10", "9"):
        (tmp_path / name).touch()
    assert [path.name for path in entries(tmp_path)] == ["10", "9", "A", "a", "b"]
