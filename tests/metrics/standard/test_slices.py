"""Parts of a sequence against scoring what they hold alone."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.slices import VEHICLE, Part, by_range, by_source, by_visibility
from fbench.metrics.detection.outcomes import BoxCounts, Candidates, compare_class, judge_detections
from fbench.metrics.detection.scores import detection_counts
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Sequence

MATCH = Match("bev", 2.0)
C, L, R = 1, 2, 4


def box_counts(whole: Candidates, part: Part) -> BoxCounts:
    return judge_detections(whole.select(part)).counts


def counts(whole: Sequence, part: Part) -> tuple[int, int, int, int]:
    boxes = box_counts(compare_class(whole, VEHICLE, MATCH), part)
    return boxes.tp, boxes.fp, boxes.fn, boxes.ignored


def test_ranges_by_hand() -> None:
    truth = [Box(0, 5), Box(0, 15), Box(0, 19.5), Box(0, 25)]
    found = [Box(0, 5), Box(0, 20.5), Box(0, 28)]
    whole = sequence(truth, found, 1)
    parts = {part.name: counts(whole, part) for part in by_range(whole, 30)}
    assert parts == {
        "range 0-10 m": (1, 0, 0, 2),
        "range 10-20 m": (1, 0, 1, 2),  # found from beyond the border: a hit there, and no false alarm beyond
        "range 20-30 m": (0, 1, 1, 2),
    }


def test_ranges_end_with_the_region_and_include_its_border() -> None:
    whole = sequence([Box(0, 12.5)], [], 1)
    parts = list(by_range(whole, 12.5))
    assert [part.name for part in parts] == ["range 0-10 m", "range 10-12.5 m"]
    assert counts(whole, parts[1]) == (0, 0, 1, 0)
    assert [part.name for part in by_range(whole, 10)] == ["range 0-10 m"]
    assert [part.name for part in by_range(whole, np.inf)][-1] == "range 75-100 m"


def test_no_ranges_where_distances_arent_known() -> None:
    whole = sequence([Box(0, 5)], [Box(0, 5)], 1)
    assert not list(by_range(replace(whole, truth=replace(whole.truth, center_m=None, distance_m=None)), 50))


def test_visibility_is_of_truth_alone() -> None:
    truth = [Box(0, 5, visibility=0.3), Box(0, 15, visibility=0.4), Box(0, 25, visibility=1.0)]
    whole = sequence(truth, [Box(0, 15), Box(0, 40)], 1)
    parts = {part.name: counts(whole, part) for part in by_visibility(whole)}
    assert parts == {
        "visibility 0-40 %": (0, 0, 1, 2), "visibility 40-60 %": (1, 0, 0, 1), "visibility 60-80 %": (0, 0, 0, 2),
        "visibility 80-100 %": (0, 0, 1, 2),
    }  # fmt: skip
    assert not list(by_visibility(sequence([Box(0, 5, visibility=np.nan)], [], 1)))


def test_sources_are_against_all_truth() -> None:
    truth = [Box(0, 5), Box(0, 15), Box(0, 25)]
    whole = sequence(truth, [Box(0, 5, sources=C | L), Box(0, 15, sources=L), Box(0, 40, sources=R)], 1)
    parts = {part.name: counts(whole, part) for part in by_source(whole)}
    assert parts == {"source camera": (1, 0, 2, 0), "source lidar": (2, 0, 1, 0), "source radar": (0, 1, 3, 0)}


@given(st.integers(0, 10_000))
def test_a_part_counts_as_a_smaller_region_does(seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    truth, found = (
        [Box(int(s), float(x), score=float(c), label=str(label))
         for s, x, c, label in zip(rng.integers(0, 3, n), rng.integers(0, 30, n), rng.random(n),
                                   rng.choice(["car", "bus", "pedestrian", "", "other"], n), strict=True)]
        for n in rng.integers(0, 12, 2)
    )  # fmt: skip
    whole = sequence(truth, found, 3)
    part = Part("p", rng.random(len(truth)) < 0.5, rng.random(len(found)) < 0.5, rng.random(len(found)) < 0.8)
    given_rows = part.given if part.given is not None else np.ones(len(found), bool)
    alone = replace(
        whole,
        truth=replace(whole.truth, inside=part.truth),
        estimates=replace(whole.estimates, inside=part.estimates)[given_rows],
    )
    assert box_counts(compare_class(whole, VEHICLE, MATCH), part) == detection_counts(alone, VEHICLE, MATCH).boxes


@given(st.integers(0, 10_000))
def test_truth_of_all_ranges_is_all_truth(seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    truth, found = ([Box(0, float(x)) for x in rng.integers(0, 50, 8)] for _ in range(2))
    whole = sequence(truth, found, 1)
    pairs = compare_class(whole, VEHICLE, MATCH)
    total = sum((box_counts(pairs, part) for part in by_range(whole, 50)), BoxCounts())
    assert total.gt == len(truth)


def test_what_isnt_valid_is_a_false_alarm_where_it_is() -> None:
    """And where nobody can tell where it is, of the whole alone."""
    found = [Box(0, 5, score=np.nan), Box(0, 15), Box(0, np.nan)]
    whole = sequence([Box(0, 15)], found, 1)
    assert detection_counts(whole, VEHICLE, MATCH).boxes == BoxCounts(tp=1, fp=2, invalid=2)
    parts = {part.name: box_counts(compare_class(whole, VEHICLE, MATCH), part) for part in by_range(whole, 20)}
    assert parts == {
        "range 0-10 m": BoxCounts(fp=1, invalid=1, ignored=1), "range 10-20 m": BoxCounts(tp=1)
    }  # fmt: skip
