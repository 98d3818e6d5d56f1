"""How summaries tell lists and counts."""

from collections import Counter

import pytest

from fbench.datasets.importing.files import counted, listed, listed_runs, runs


@pytest.mark.parametrize(
    ("things", "text"),
    [([], ""), ([7], "7"), ([1, 2, 3], "1, 2, 3"), ([1, 2, 3, 4], "1, 2, 3 and 1 more"), (["a", "b"], "a, b")],
)
def test_long_lists_end_with_how_many_more_there_are(things, text):
    assert listed(things, 3) == text


@pytest.mark.parametrize(
    ("numbers", "text"),
    [([], ""), ([4], "4"), ([4, 5], "4 to 5"), ([0, 1, 2, 9], "0 to 2, 9"), ([1, 3, 5, 7, 8], "1, 3 and 2 more")],
)
def test_numbers_that_follow_one_another_are_one_run(numbers, text):
    assert listed_runs(runs(numbers), 2) == text
    assert [number for run in runs(numbers) for number in run] == numbers


def test_counts_go_from_the_largest_and_then_by_name():
    assert counted(Counter({"Van": 1, "Car": 3, "Bus": 1})) == "Car 3, Bus 1, Van 1"
    assert counted(Counter()) == ""
