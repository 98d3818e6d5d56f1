"""Rows of tracks: hand values, missing ids, sums in any grouping, and what false alarms cost."""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.slices import VEHICLE, ScoreKey
from fbench.metrics.tracking.scores import TrackingCounts, tracking_counts, tracking_rows
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

MATCH = Match("bev", 2.0)
HEAD = ScoreKey("vehicle", "all", "bev 2 m", None, 1)


def rows(counts: TrackingCounts) -> dict[str, Score]:
    return {row.metric: row for row in tracking_rows(counts, HEAD, "m") if row.slice == "all"}


def values(whole: Sequence) -> dict[str, float | None]:
    return {name: row.value for name, row in rows(tracking_counts(whole, VEHICLE, MATCH)).items()}


def line(ids: str, x: float = 10.0, first: int = 0) -> list[Box]:
    """An object that stands still, a letter a step: its id, or `?` where it has none; `.` where it isn't there."""
    return [Box(first + i, x, id=-1 if c == "?" else int(c)) for i, c in enumerate(ids) if c != "."]


def test_a_track_that_changes_its_id_in_the_middle() -> None:
    """IDF1: the longer half is the object: 2 IDTP of 4. HOTA: DetA = 1, AssA = mean of 1/2 each (TPA 2, FNA 2)."""
    found = values(sequence(line("1111"), line("5566"), 4))
    assert found["mota"] == 0.75
    assert (found["idf1"], found["idp"], found["idr"]) == (0.5, 0.5, 0.5)
    assert (found["deta"], found["assa"], found["hota"]) == (1.0, pytest.approx(0.5), pytest.approx(0.5**0.5))
    assert (found["loca"], found["motp"]) == (1.0, 0.0)
    assert (found["idsw"], found["frag"]) == (1.0, 0.0)


def test_interruptions_and_lives() -> None:
    """Found in 4 of 5 boxes, 1 of 5, 0 of 5 and 5 of 5; the first is interrupted once."""
    truth = line("11111") + line("22222", 20) + line("33333", 30) + line("44444", 40)
    found = values(sequence(truth, line("55.55") + line("6....", 20) + line("88888", 40), 5))
    assert found["frag"] == 1.0
    # Mostly tracked above 80 %, mostly lost below 20 % (TrackEval).
    assert (found["mt"], found["pt"], found["ml"]) == (1.0, 2.0, 1.0)


def test_hota_depends_on_how_near_matches_are() -> None:
    """1 m of 2 m is a similarity of 0.5: found at the thresholds 0.05 to 0.5, 10 of 19."""
    found = values(sequence(line("1"), line("5", 11.0), 1))
    assert (found["hota"], found["deta"], found["assa"]) == (pytest.approx(10 / 19),) * 3
    assert (found["loca"], found["motp"]) == (pytest.approx(0.5), 1.0)


def test_tracks_that_are_truth_score_one() -> None:
    truth = line("11.11") + line("22222", 20)
    found = values(sequence(truth, truth, 5))
    ones = ("mota", "mota_no_fp", "idf1", "idp", "idr", "hota", "deta", "assa", "loca", "occlusion_survival")
    assert {name: found[name] for name in ones} == dict.fromkeys(ones, 1.0)
    assert (found["idsw"], found["ml"], found["pt"]) == (0.0, 0.0, 0.0)


class TestMissingIds:
    def test_a_box_without_id_is_a_track_of_its_own(self) -> None:
        found = values(sequence(line("1111"), line("5?55"), 4))
        assert (found["mota"], found["idsw"]) == (1.0, 0.0)  # it is no switch: nobody said that it is another
        assert found["idf1"] == pytest.approx(0.75)

    def test_switches_are_between_ids_that_are_there(self) -> None:
        assert values(sequence(line("1111"), line("5??6"), 4))["idsw"] == 1.0
        assert values(sequence(line("1111"), line("?5?5"), 4))["idsw"] == 0.0

    def test_truth_in_two_streams_is_two_tracks(self) -> None:
        whole = sequence(line("1111"), line("5?66"), 4, [0, 0, 1, 1])
        assert values(whole)["idsw"] == 0.0

    def test_truth_without_id_has_no_switches(self) -> None:
        assert values(sequence(line("1?1"), line("566"), 3))["idsw"] == 1.0
        assert values(sequence(line("1??"), line("567"), 3))["idsw"] == 0.0

    def test_without_any_id_there_are_no_tracks_to_judge(self) -> None:
        found = rows(tracking_counts(sequence(line("11"), line("??"), 2), VEHICLE, MATCH))
        assert (found["mota"].value, found["mota"].reason) == (None, "tracks have no ids")
        assert found["motp"].value == 0.0
        assert rows(tracking_counts(sequence(line("??"), line("11"), 2), VEHICLE, MATCH))["hota"].reason == (
            "truth has no track ids"
        )


def random_sequence(seed: int, num: int = 6) -> Sequence:
    rng = np.random.Generator(np.random.PCG64(seed))

    def side(noise: float, miss: float) -> list[Box]:
        return [
            Box(s, 10.0 * k + float(rng.normal(0, noise)), id=int(k if rng.random() < 0.8 else k + 10),
                score=float(rng.random()), visibility=float(rng.random()))
            for s in range(num) for k in range(1, 4) if rng.random() > miss
        ]  # fmt: skip

    return sequence(side(0.0, 0.2), side(0.7, 0.3), num, sorted(rng.integers(0, 2, num).tolist()))


@settings(max_examples=25)
@given(st.lists(st.integers(0, 10_000), min_size=2, max_size=6), st.randoms(use_true_random=False))
def test_adding_in_any_grouping_gives_the_same_rows_bit_for_bit(seeds: list[int], random) -> None:  # type: ignore[no-untyped-def]
    parts = [tracking_counts(random_sequence(seed), VEHICLE, MATCH) for seed in seeds]
    whole = reduce(add, parts)
    random.shuffle(parts)
    cut = random.randint(1, len(parts) - 1)
    grouped = reduce(add, parts[:cut]) + reduce(add, parts[cut:])
    assert grouped == whole
    assert tracking_rows(grouped, HEAD, "m") == tracking_rows(whole, HEAD, "m")


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.floats(0, 40), st.integers(0, 5))
def test_a_false_alarm_never_raises_mota(seed: int, x: float, step: int) -> None:
    """A box more, of a new track, whether it is far from all truth or takes a place that was free."""
    whole = random_sequence(seed)
    before = tracking_counts(whole, VEHICLE, MATCH).clear
    extra = sequence([], [Box(step, x, y=100.0, id=99)], 6).estimates
    joined = np.argsort(np.concatenate([whole.estimates.step, extra.step]), kind="stable")
    both = {
        name: np.concatenate([getattr(whole.estimates, name), getattr(extra, name)])[joined]
        for name in ("step", "label", "track_id", "score", "center_m", "size_lwh_m", "yaw_rad")
    }
    empty = replace(whole.estimates[:0], visibility=None, distance_m=None, sources=None)
    after = tracking_counts(replace(whole, estimates=replace(empty, **both)), VEHICLE, MATCH).clear
    assert after.fp + after.fn + after.switches > before.fp + before.fn + before.switches
    assert after.fp == before.fp + 1


class TestInvalid:
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
    def test_a_track_that_isnt_finite_is_a_false_alarm_and_counted(self, bad: float) -> None:
        counts = tracking_counts(sequence(line("11"), [*line("55"), Box(0, bad, id=6)], 2), VEHICLE, MATCH)
        assert (counts.boxes.tp, counts.boxes.fp, counts.boxes.invalid) == (2, 1, 1)
        assert rows(counts)["mota"].value == 0.5

    def test_so_is_one_of_negative_size_or_without_a_score(self) -> None:
        whole = sequence(line("11"), line("55"), 2)
        size = np.array(whole.estimates.size_lwh_m)
        size[0, 1] = -1.0
        for estimates in (
            replace(whole.estimates, size_lwh_m=size),
            replace(whole.estimates, score=np.array([np.nan, 0.0])),
        ):
            counts = tracking_counts(replace(whole, estimates=estimates), VEHICLE, MATCH)
            assert (counts.boxes.tp, counts.boxes.fp, counts.boxes.fn, counts.boxes.invalid) == (1, 1, 1, 1)

    def test_truth_that_was_left_out_is_counted(self) -> None:
        whole = replace(sequence(line("11"), line("55"), 2), num_invalid_truth=3)
        assert rows(tracking_counts(whole, VEHICLE, MATCH))["mota"].counts["invalid_truth"] == 3


def test_what_loses_its_truth_outside_of_the_region_is_no_false_alarm() -> None:
    """Alone, step 1 would pair both; but 5 stays on the first object, and 6, outside, is near to nothing else."""
    truth = [Box(0, 10, id=1), Box(1, 10, id=1), Box(1, 13, id=2)]
    found = [Box(0, 10, id=5), Box(1, 11.5, id=5), Box(1, 8.5, id=6)]
    whole = sequence(truth, found, 2)
    for inside, expected in ((True, (2, 1, 1, 0)), (False, (2, 0, 1, 1))):
        kept = replace(whole, estimates=replace(whole.estimates, inside=np.array([True, True, inside])))
        counts = tracking_counts(kept, VEHICLE, MATCH)
        boxes = counts.boxes
        assert (boxes.tp, boxes.fp, boxes.fn, boxes.ignored) == expected
        assert counts.identity.fp == expected[1]
