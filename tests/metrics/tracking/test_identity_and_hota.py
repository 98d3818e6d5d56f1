"""Identity against its dense definition, HOTA by hand."""

import math

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from tests.metrics.tracking.problems_by_hand import sequence, track

from fbench.metrics.profiles.trackeval.fields import alpha_fields, identity_fields, mean_fields
from fbench.metrics.profiles.trackeval.prepare import EVERYTHING, HALF, problems
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI
from fbench.metrics.tracking.hota import ALPHAS, hota_counts
from fbench.metrics.tracking.identity import IdentityCounts, identity_counts
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Objects, Sequence, Steps


def problem(truth, estimates):
    return next(problems(sequence(truth, estimates), EVERYTHING, HALF))


def hota(truth, estimates, a=0):
    counts = hota_counts(problem(truth, estimates))
    return {field.metric: field.value for field in alpha_fields(counts, a)}


def dense(one, floor):
    """The definition: a square matrix in which each track may stay alone (Ristani et al. 2016)."""
    g, e = one.num_truth_ids, one.num_estimate_ids
    common = np.zeros((g, e))
    for step in range(len(one.stream)):
        rows = slice(*one.pairs.row_start[step : step + 2])
        columns = slice(*one.pairs.column_start[step : step + 2])
        for i, j in zip(*np.nonzero(one.pairs.block(step) >= floor), strict=True):
            common[one.truth_id[rows][i], one.estimate_id[columns][j]] += 1
    sizes = np.bincount(one.truth_id, minlength=g), np.bincount(one.estimate_id, minlength=e)
    cost = np.full((g + e, g + e), 1e9)
    cost[:g, :e] = sizes[0][:, None] + sizes[1][None] - 2 * common
    cost[range(g), range(e, e + g)] = sizes[0]
    cost[range(g, g + e), range(e)] = sizes[1]
    cost[g:, e:] = 0
    num_truth, num_estimates = one.pairs.shape
    tp = (num_truth + num_estimates - cost[linear_sum_assignment(cost)].sum()) / 2
    return IdentityCounts(int(tp), num_truth - int(tp), num_estimates - int(tp))


def test_identity_is_the_best_global_assignment():
    rng = np.random.Generator(np.random.Philox(5))
    for _ in range(60):
        rows = [
            [(step, id_, rng.uniform(0, 60)) for step in range(6) for id_ in range(5) if rng.random() < 0.7]
            for _ in range(2)
        ]
        one = problem(*rows)
        assert identity_counts(one, 0.3) == dense(one, 0.3)


def test_idf1_takes_one_track_for_each():
    """Two halves under two ids: the longer one counts."""
    counts = identity_counts(problem(track(1, range(10)), [*track(5, range(6)), *track(6, range(6, 10))]), 0.5)
    assert (counts.tp, counts.fn, counts.fp) == (6, 4, 4)
    assert {f.metric: f.value for f in identity_fields(counts)}["idf1"] == pytest.approx(6 / (6 + 2 + 2))


def test_hota_of_a_track_in_two_halves():
    """Each match has TPA 5, FNA 5, FPA 0; detection is perfect."""
    found = hota(track(1, range(10)), [*track(5, range(5)), *track(6, range(5, 10))])
    assert (found["deta"], found["assa"], found["assre"], found["asspr"]) == (1, 0.5, 0.5, 1)
    assert found["hota"] == pytest.approx(math.sqrt(0.5))
    assert found["loca"] == 1


def test_hota_s_matches_follow_the_tracks_not_the_frame():
    """In step 3 another estimate is nearer, but the track that fits over time is taken."""
    found = [*track(5, range(6), 1.0), (3, 6, 0.0)]
    assert hota(track(1, range(6)), found)["assa"] == 1


def test_thresholds_are_19_and_a_match_passes_those_up_to_its_similarity():
    one = hota_counts(problem(track(1, range(4)), track(5, range(4), 3.0)))  # IoU 7/13
    assert len(ALPHAS) == 19
    assert one.tp == (4,) * 10 + (0,) * 9
    fields = {f.metric: f.value for f in mean_fields([alpha_fields(one, a) for a in range(19)])}
    assert fields["deta"] == pytest.approx(10 / 19)
    assert fields["loca"] == pytest.approx((10 * 7 / 13 + 9) / 19)  # TrackEval takes 1 where nothing matches


def test_without_match_hota_is_0_and_its_association_undefined():
    found = hota(track(1, range(4)), track(5, range(4), 300.0))
    assert (found["hota"], found["deta"], found["assa"], found["loca"]) == (0, 0, None, None)
    assert hota([], [])["hota"] is None


def solid(x, label="car"):
    """Boxes in space only, one a step."""
    num = len(x)
    return Objects(
        step=np.arange(num),
        label=np.full(num, label),
        track_id=np.zeros(num, np.int64),
        score=np.ones(num),
        center_m=np.stack([np.array(x, float), np.zeros(num), np.zeros(num)], axis=1),
        size_lwh_m=np.tile([4.0, 2.0, 1.5], (num, 1)),
        yaw_rad=np.zeros(num),
    )


def test_distances_rate_by_how_far_below_the_threshold_they_are():
    one = Sequence("s", Steps.of_one_stream(3), solid([0, 0, 0]), solid([0, 1, 3]))
    match = Match("bev", 2)
    (first, _) = problems(one, TRACKEVAL_KITTI.preparation, match)
    assert first.overlaps(match).pairs.values.tolist() == [1, 0.5, 0]
    rows = TRACKEVAL_KITTI.with_match(match).scores(TRACKEVAL_KITTI.with_match(match).measure(one), "all")
    found = {(r.metric, r.slice): r for r in rows if r.class_ == "car"}
    assert found["motp", "all"].value == 0.5
    assert found["motp", "all"].unit == "m"
    assert (found["clr_tp", "all"].value, found["clr_fp", "all"].value) == (2, 1)
    assert found["hota_tp", "alpha 0.50"].value == 2
    assert found["hota_tp", "alpha 0.55"].value == 1
    assert found["clr_tp", "all"].matching == "bev 2 m"
    assert found["smota", "all"].value is None


def test_boxes_in_space_match_by_overlap_too():
    one = Sequence("s", Steps.of_one_stream(2), solid([0, 0]), solid([0, 2]))
    counts = TRACKEVAL_KITTI.with_match(Match("iou3d", 0.25)).measure(one).classes["car"]
    assert counts.clear.tp == 2
    assert float(counts.clear.similarity) == pytest.approx(1 + 1 / 3)
