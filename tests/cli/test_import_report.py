"""What an import of many sequences says at its end."""

from pathlib import Path

from fbench.cli.import_lines import join_lines
from fbench.datasets.importing.run import ImportedLog


def joined(*lines):
    """Lines of sequences s0, s1 and so on, each given as a list."""
    return list(join_lines([ImportedLog(f"s{i}", Path("x"), "written", lines=own) for i, own in enumerate(lines)]))


def test_equal_lines_are_one():
    assert joined(["a: b"], ["a: b"]) == ["a: b"]


def test_numbers_become_ranges():
    lines = [[f"frames: {n} in 1 stretch, {n / 10} s, from {-n} of scene-0001 on"] for n in (3, 1, 2)]
    assert joined(*lines) == ["frames: 1..3 in 1 stretch, 0.1..0.3 s, from -3..-1 of scene-0001 on"]
    assert joined(["x: 100"], ["x: 20"]) == ["x: 20..100"]


def test_names_with_numbers_stay_apart():
    assert joined(["at: scene-0001"], ["at: scene-0002"]) == [
        "at: scene-0001 [1 of 2: s0]",
        "at: scene-0002 [1 of 2: s1]",
    ]


def test_counts_by_name_are_summed_up():
    assert joined(["classes: Car 3, Van 1"], ["classes: Bus 9, Car 4"], ["classes: none"]) == [
        "classes: none [1 of 3: s2]", "classes, in all: Bus 9, Car 7, Van 1"
    ]  # fmt: skip
    assert joined(["files: image_02 3, velodyne 2"], ["files: image_02 1"]) == ["files, in all: image_02 4, velodyne 2"]
    assert joined(["boxes: 4 (vehicle.car 4), 2 tracks"], ["boxes: 3 (vehicle.car 1, animal 2), 1 tracks"]) == [
        "boxes: 3..4, 1..2 tracks", "boxes, in all: vehicle.car 5, animal 2"
    ]  # fmt: skip
    assert joined(["seen: 4 (100.0%) of 4"], ["seen: 1 (50.0%) of 2"]) == ["seen: 1..4 (50.0..100.0%) of 2..4"]


def test_what_some_have_names_them():
    lines = [["odd: clock"] if i % 2 else ["even: 1"] for i in range(10)]
    assert joined(*lines) == [
        "even: 1 [5 of 10: s0, s2, s4 and 2 more]", "odd: clock [5 of 10: s1, s3, s5 and 2 more]"
    ]  # fmt: skip


def test_many_forms_of_a_line_are_cut():
    lines = [["gaps: none"], ["gaps: none"], *([f"gaps: {'x' * i}"] for i in range(1, 7))]
    assert joined(*lines) == [
        "gaps: none [2 of 8: s0, s1]", "gaps: x [1 of 8: s2]", "gaps: xx [1 of 8: s3]",
        "gaps: otherwise in 4 of 8, see --json",
    ]  # fmt: skip


def test_nothing_is_said_of_what_was_there():
    assert list(join_lines([ImportedLog("s0", Path("x"), "there"), ImportedLog("s1", Path("x"), "failed")])) == []
