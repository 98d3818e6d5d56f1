"""What must hold of any sequence."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.metrics.profiles.motmetrics import MOTMETRICS
from fbench.metrics.profiles.trackeval.prepare import EVERYTHING
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI, TRACKEVAL_MOT
from fbench.replay.data.sequences import Objects, Sequence, Steps

NUM_STEPS = 8
PROFILES = [TRACKEVAL_KITTI, TRACKEVAL_MOT, MOTMETRICS]
BY_CONTENT = replace(TRACKEVAL_MOT, preparation=replace(EVERYTHING, order="by content"))
seeds = st.integers(0, 10**6)
some = settings(max_examples=25)


def rng_of(seed):
    return np.random.Generator(np.random.Philox(seed))


def made(rng, label, num_ids=5, grid=0.0) -> Objects:
    """Boxes that crowd, on a grid if equal ones are wanted."""
    rows = [(s, i) for s in range(NUM_STEPS) for i in range(num_ids) if rng.random() < 0.7]
    corner, size = rng.uniform(0, 60, (len(rows), 2)), rng.uniform(30, 50, (len(rows), 2))
    box = np.concatenate([corner, corner + size], axis=1)
    return Objects(
        step=np.array([row[0] for row in rows], np.int64),
        label=np.full(len(rows), label),
        track_id=np.array([row[1] for row in rows], np.int64),
        score=np.ones(len(rows)),
        xyxy_px=np.round(box / grid) * grid if grid else box,
    )


def sequence(rng, profile, grid=0.0) -> Sequence:
    label = "car" if profile is TRACKEVAL_KITTI else "pedestrian"
    return Sequence("s", Steps.of_one_stream(NUM_STEPS), made(rng, label, grid=grid), made(rng, label, grid=grid))


def shuffled(objects: Objects, rng) -> Objects:
    """Rows in another order within steps, other ids."""
    order = np.lexsort((rng.random(len(objects)), objects.step))
    names = rng.permutation(50)
    return replace(objects[order], track_id=names[objects.track_id[order]])


def values(profile, one):
    return profile.scores(profile.measure(one), "all")


@pytest.mark.parametrize("profile", PROFILES)
@given(seeds)
@some
def test_truth_as_result_scores_1(profile, seed):
    truth = sequence(rng_of(seed), profile).truth
    rows = values(profile, Sequence("s", Steps.of_one_stream(NUM_STEPS), truth, shuffled(truth, rng_of(seed))))
    perfect = {"hota", "deta", "assa", "loca", "mota", "idf1", "clr_f1", "recall", "precision", "mota_no_fp", "idp"}
    found = [row for row in rows if row.metric in perfect and row.value is not None]
    assert found
    assert all(row.value == pytest.approx(1) for row in found)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@given(seeds)
@some
def test_order_of_boxes_and_names_of_ids_change_nothing(profile, seed):
    rng = rng_of(seed)
    one = sequence(rng, profile)
    other = replace(one, truth=shuffled(one.truth, rng), estimates=shuffled(one.estimates, rng))
    for a, b in zip(values(profile, one), values(profile, other), strict=True):
        assert (a.metric, a.slice, a.reason) == (b.metric, b.slice, b.reason)
        assert a.value == pytest.approx(b.value, abs=1e-12)


@given(seeds)
@some
def test_by_content_that_holds_for_equal_boxes_too(seed):
    rng = rng_of(seed)
    one = sequence(rng, BY_CONTENT, grid=25.0)
    other = replace(one, truth=shuffled(one.truth, rng), estimates=shuffled(one.estimates, rng))
    assert values(BY_CONTENT, one) == values(BY_CONTENT, other)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@given(seeds)
@some
def test_a_false_alarm_never_raises_mota(profile, seed):
    rng = rng_of(seed)
    one = sequence(rng, profile)
    step = int(rng.integers(0, NUM_STEPS))
    at = int(np.searchsorted(one.estimates.step, step))
    columns = {"step": step, "label": one.estimates.label[0], "track_id": 99, "score": 1.0}
    added = {name: np.insert(getattr(one.estimates, name), at, value) for name, value in columns.items()}
    box = np.insert(one.estimates.xyxy_px, at, [900, 0, 990, 90], axis=0)
    more = replace(one, estimates=Objects(**added, xyxy_px=box))
    for a, b in zip(values(profile, one), values(profile, more), strict=True):
        if a.metric == "mota" and a.value is not None:
            assert b.value < a.value
        if a.metric in ("mota_no_fp", "recall", "clr_re"):
            assert b.value == a.value


@pytest.mark.parametrize("profile", PROFILES)
@given(st.lists(seeds, min_size=3, max_size=5), st.randoms(use_true_random=False))
@settings(max_examples=10)
def test_sums_are_bit_equal_in_any_order_and_grouping(profile, chosen, random):
    counts = [profile.measure(sequence(rng_of(seed), profile)) for seed in chosen]
    whole = counts[0]
    for other in counts[1:]:
        whole += other
    while len(counts) > 1:
        random.shuffle(counts)
        counts.append(counts.pop() + counts.pop())
    assert counts[0] == whole
    assert profile.scores(counts[0], "all") == profile.scores(whole, "all")
