"""Order by content: what is written where, and what tracks are called, decides nothing."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.metrics.standard.made import Box, objects, sequence

from fbench.metrics.core.ordering import content_order
from fbench.metrics.profiles.default import DefaultProfile
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects


def in_order(boxes: Objects) -> Objects:
    return boxes[content_order(boxes)]


def test_by_place_then_score_then_class() -> None:
    boxes = [Box(1, 1), Box(0, 5, label="car"), Box(0, 5, label="bus"), Box(0, 3), Box(0, 5, score=-1.0)]
    found = in_order(objects(boxes))
    assert found.center_m is not None
    assert found.step.tolist() == [0, 0, 0, 0, 1]
    assert found.center_m[:, 0].tolist() == [3, 5, 5, 5, 1]
    assert found.label.tolist()[1:4] == ["car", "bus", "car"]
    assert len(in_order(found[:0])) == 0


def test_equal_boxes_go_by_the_lives_of_their_tracks() -> None:
    """Two boxes in one place at first; then one of them is nearer."""
    for here, there in ((1, 2), (2, 1)):
        boxes = [Box(0, 5, id=there), Box(0, 5, id=here), Box(1, 9, id=there), Box(1, 7, id=here)]
        assert in_order(objects(boxes)).track_id.tolist() == [here, there, here, there]


def rows(truth: list[Box], found: list[Box]) -> list[Score]:
    profile = DefaultProfile()
    return profile.scores(profile.measure(sequence(truth, found, 4)), "all")


def crowded(rng: np.random.Generator) -> list[Box]:
    """Many that are as near, as good, or the same; NaN among them."""
    return [
        Box(step, float(rng.choice([0, 1, 2, 3, np.nan], p=[0.24, 0.24, 0.24, 0.24, 0.04])), float(rng.integers(0, 2)),
            id=int(number), score=float(rng.integers(0, 2)), label=str(rng.choice(["car", "bus", "pedestrian"])))
        for step in range(4) for number in rng.permutation(6)[: rng.integers(0, 5)]
    ]  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_order_of_rows_and_names_of_tracks_change_nothing(seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    sides = [[box for box in crowded(rng) if side or not np.isnan(box.x)] for side in range(2)]
    names = rng.permutation(100)
    mixed = [[replace(side[i], id=int(names[side[i].id])) for i in rng.permutation(len(side))] for side in sides]
    assert rows(*sides) == rows(*mixed)


def test_it_keeps_every_box() -> None:
    boxes = objects([Box(0, 1, id=3), Box(0, 1, id=4), Box(0, np.nan, id=5), Box(0, np.nan, id=6)])
    found: Objects = in_order(boxes)
    assert sorted(found.track_id.tolist()) == [3, 4, 5, 6]
