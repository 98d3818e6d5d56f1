"""CLEAR by hand: what counts as a switch, a fragment, a kept pair; and the traps of its formulas."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from tests.metrics.tracking.problems_by_hand import sequence, track

from fbench.metrics.profiles.motmetrics import MOTMETRICS, MOTMETRICS_RULES
from fbench.metrics.profiles.trackeval.fields import clear_fields
from fbench.metrics.profiles.trackeval.prepare import EVERYTHING, HALF, problems
from fbench.metrics.tracking.clear import TRACKEVAL_RULES, ClearCounts, ClearRules, clear_counts, clear_pairs
from fbench.metrics.tracking.clear_events import START, SWITCH
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Steps

FAR = 500.0


def problem(truth, estimates, num=None, stream=None):
    one = sequence(truth, estimates, num)
    if stream is not None:
        steps = Steps(one.steps.frame, one.steps.stamp_ns, np.array(stream, np.int64))
        one = replace(one, steps=steps)
    return next(problems(one, EVERYTHING, HALF))


def count(truth, estimates, rules=TRACKEVAL_RULES, num=None, stream=None):
    return clear_counts(problem(truth, estimates, num, stream), rules)


def numbers(counts, is_distance=False):
    return {field.metric: field.value for field in clear_fields(counts, is_distance)}


def test_mota_counts_false_alarms_and_the_number_without_them_has_another_name():
    truth = track(1, range(100))
    found = [*track(10, range(30)), *track(11, range(30, 60)), *track(12, range(60, 80))]
    alarms = [(step, 100 + step, FAR) for step in range(60)]
    counts = count(truth, found + alarms)
    assert (counts.num_truth, counts.fn, counts.fp, counts.switches) == (100, 20, 60, 2)
    assert numbers(counts)["mota"] == pytest.approx(0.18)
    assert numbers(counts)["mota_no_fp"] == pytest.approx(0.78)


def test_mota_is_not_clipped():
    counts = count(track(1, range(2)), [(0, k, FAR + 20 * k) for k in range(7)])
    assert numbers(counts)["mota"] == pytest.approx(1 - (2 + 7) / 2)


def test_sequences_are_added_before_dividing():
    one = count(track(1, range(10)), track(5, range(10)))
    other = count(track(1, range(2)), [])
    assert numbers(one + other)["mota"] == pytest.approx(10 / 12)
    assert (numbers(one)["mota"], numbers(other)["mota"]) == (1, 0)


@pytest.mark.parametrize("rules", [ClearRules(), MOTMETRICS_RULES])
def test_a_switch_counts_after_any_gap(rules):
    truth = track(1, range(20))
    assert count(truth, [*track(10, range(3)), *track(11, range(15, 20))], rules).switches == 1
    assert count(truth, [*track(10, range(3)), *track(10, range(15, 20))], rules).switches == 0


def test_switch_back_and_forth_counts_each_time():
    found = [(step, 10 + step % 2, 0.0) for step in range(6)]
    assert count(track(1, range(6)), found).switches == 5


@pytest.mark.parametrize("rules", [ClearRules(), MOTMETRICS_RULES])
def test_the_previous_pair_is_kept_though_another_estimate_is_nearer(rules):
    truth = track(1, range(2))
    found = [(0, 10, 0.0), (1, 10, 3.0), (1, 11, 0.0)]
    counts = count(truth, found, rules)
    assert (counts.switches, counts.tp, float(counts.similarity)) == (0, 2, 1 + 7 / 13)
    beyond = [(0, 10, 0.0), (1, 10, 4.0), (1, 11, 0.0)]  # IoU 6/14, below the threshold
    assert count(truth, beyond, rules).switches == 1


def test_memories_differ_after_a_miss():
    """After a miss TrackEval takes the nearest, py-motmetrics the one of before."""
    truth, found = track(1, range(3)), [(0, 10, 0.0), (1, 99, FAR), (2, 10, 3.0), (2, 11, 0.0)]
    assert count(truth, found).switches == 1
    assert count(truth, found, MOTMETRICS_RULES).switches == 0


def test_a_step_without_any_estimate_leaves_trackeval_s_memory_as_it_is():
    truth, found = track(1, range(3)), [(0, 10, 0.0), (2, 10, 3.0), (2, 11, 0.0)]
    counts = count(truth, found)
    assert (counts.switches, counts.fragmentations) == (0, 0)
    assert count(truth, found, MOTMETRICS_RULES).fragmentations == 1


def test_fragments_where_truth_was_away():
    truth = [*track(1, (0, 1, 3, 4)), *track(2, range(5), FAR)]
    found = [*track(10, (0, 1, 3, 4)), *track(11, range(5), FAR)]
    assert count(truth, found).fragmentations == 1
    assert count(truth, found, MOTMETRICS_RULES).fragmentations == 0


def test_eighty_percent_is_mostly_tracked_for_one_and_not_for_the_other():
    truth, found = track(1, range(10)), track(10, range(8))
    ours = count(truth, found)
    assert (ours.mostly_tracked, ours.partly_tracked, ours.mostly_lost) == (0, 1, 0)
    assert count(truth, found, MOTMETRICS_RULES).mostly_tracked == 1
    assert count(truth, track(10, range(2))).partly_tracked == 1
    assert count(truth, track(10, range(1))).mostly_lost == 1


@pytest.mark.parametrize("rules", [ClearRules(), MOTMETRICS_RULES])
@pytest.mark.parametrize("stream", [[0, 0, 1, 1], [0, 1, 0, 1]])
def test_memory_does_not_cross_streams(rules, stream):
    """The same ids in another stream are other tracks, also where steps of streams alternate."""
    found = [(step, 10 + of, 0.0) for step, of in enumerate(stream)]
    counts = count(track(1, range(4)), found, rules, stream=stream)
    assert (counts.switches, counts.fragmentations, counts.num_tracks) == (0, 0, 2)


def test_alternating_streams_keep_their_own_previous_step():
    """The nearer estimate of the other id isn't taken, since the last step of the same stream matched otherwise."""
    found = [(0, 10, 0.0), (1, 10, 0.0), (2, 10, 3.0), (2, 11, 0.0), (3, 10, 0.0)]
    assert count(track(1, range(4)), found, stream=[0, 1, 0, 1]).switches == 0


def test_partners_are_told_for_both_sides():
    one = problem([*track(1, range(3)), (0, 2, FAR)], [(0, 10, 0.0), (1, 11, 1.0), (1, 12, FAR), (2, 11, 1.0)])
    pairs = clear_pairs(one, ClearRules())
    assert pairs.estimate_of.tolist() == [0, -1, 1, 3]
    assert pairs.truth_of.tolist() == [0, 2, -1, 3]
    assert (pairs.event & SWITCH).tolist() == [0, 0, SWITCH, 0]
    assert (pairs.event & START).tolist() == [START, 0, 0, 0]


def test_most_pairs_go_before_the_best_sum_only_where_rules_say_so():
    """One pair of IoU 1, or two of 3/7: the one alone has the better sum."""
    truth, found = [(0, 1, 0.0), (0, 2, 4.0)], [(0, 10, 4.0), (0, 11, 8.0)]
    assert count(truth, found, ClearRules(floor=0.4)).tp == 1
    assert count(truth, found, ClearRules(floor=0.4, most_pairs=True)).tp == 2
    assert count(truth, found, replace(MOTMETRICS_RULES, floor=0.4)).tp == 2


def test_transfers_ascents_and_migrations_of_ids():
    truth = [(0, 1, 0.0), (1, 1, 0.0), (2, 1, 0.0), (2, 2, FAR), (3, 1, 0.0), (3, 2, FAR)]
    found = [(0, 10, 0.0), (1, 11, 0.0), (2, 11, 0.0), (2, 10, FAR), (3, 11, 0.0), (3, 10, FAR)]
    counts = count(truth, found, MOTMETRICS_RULES)
    assert (counts.switches, counts.ascends, counts.transfers, counts.migrations) == (1, 1, 1, 1)


def test_motp_of_distances_is_in_metres():
    counts = ClearCounts(tp=4, similarity=Fraction(-6))
    (motp,) = [field for field in clear_fields(counts, is_distance=True) if field.metric == "motp"]
    assert (motp.value, motp.unit) == (1.5, "m")
    assert Match("bev", 2).is_distance


def test_nothing_is_undefined_and_says_what_the_reference_prints():
    fields = {field.metric: field for field in clear_fields(ClearCounts(fp=3), is_distance=False)}
    assert fields["mota"].value is None
    assert fields["mota"].why == "no truth boxes (TrackEval prints 0 for one sequence, -3 for sums)"
    assert fields["clr_pr"].value == 0
    assert MOTMETRICS.scores(MOTMETRICS.measure(sequence([], [])), "all")[0].value is None
    why = "no frames of sequences with truth and results (TrackEval prints 0 for one sequence, 3 for sums)"
    assert fields["fp_per_frame"].why == why
