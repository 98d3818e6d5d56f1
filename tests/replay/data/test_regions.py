import numpy as np
import pytest

from fbench.replay.contracts.errors import DataError, LogError
from fbench.replay.data.metadata import MAX_POINTS, REGIONS, Region, inside, regions_of, regions_text
from fbench.replay.data.rig import LogInfo

SQUARE = Region("road", np.array([[0.0, 0], [4, 0], [4, 3], [0, 3]]))
L_SHAPE = Region("sidewalk", np.array([[10.0, 0], [14, 0], [14, 1], [11, 1], [11, 5], [10, 5]]))


def test_regions_come_back_bit_for_bit_from_metadata():
    odd = Region("odd", np.array([[0.1, 1 / 3], [1e-17, 2.0], [-5.0, 1e9]]))
    info = LogInfo("a", "b", {REGIONS: regions_text([SQUARE, odd])})
    assert [(r.kind, r.points_m.tolist()) for r in info.regions] == [
        ("road", SQUARE.points_m.tolist()), ("odd", odd.points_m.tolist()),
    ]  # fmt: skip


def test_a_log_that_says_nothing_has_no_regions():
    assert regions_of({}) == ()
    assert LogInfo("a", "b").regions == ()


@pytest.mark.parametrize(
    "text",
    [
        "", "{", "[1]", "{}x", '[{"kind": "road"}]', '[{"kind": 1, "points": [[0,0],[1,0],[0,1]]}]', "[" * 100_000,
        '[{"kind": "road", "points": [[0, 0], [1, 0]]}]', '[{"kind": "road", "points": [[0, NaN], [1, 0], [1, 1]]}]',
        '[{"kind": "road", "points": [[0, 0, 0], [1, 0, 0], [1, 1, 0]]}]', '[{"kind": "road", "points": "abc"}]',
        '[{"kind": "road", "points": [[0, 0], [1, 0], [1]]}]',
    ],
)  # fmt: skip
def test_texts_that_are_no_outlines_are_one_error(text):
    with pytest.raises(LogError, match=r"the log's metadata 'regions' aren't outlines"):
        regions_of({REGIONS: text})


def test_too_many_points_are_refused():
    many = Region("road", np.tile(SQUARE.points_m, (MAX_POINTS // 4 + 1, 1)))
    with pytest.raises(LogError, match="more than 200000 points"):
        regions_of({REGIONS: regions_text([many])})


@pytest.mark.parametrize("points", [np.zeros((2, 2)), np.full((3, 2), np.inf), np.zeros((3, 3))])
def test_outlines_that_are_none_are_refused(points):
    with pytest.raises(DataError, match=r"Region\.points_m"):
        Region("road", points)


def test_points_are_inside_any_region():
    points = np.array([[2.0, 1.5], [5, 1], [10.5, 4], [12, 2], [13.9, 0.5], [-1, -1]])
    assert inside([SQUARE, L_SHAPE], points).tolist() == [True, False, True, False, True, False]
    assert inside([], points).tolist() == [False] * 6
    assert inside([SQUARE], np.zeros((0, 2))).tolist() == []


def test_the_order_of_corners_does_not_matter():
    turned = Region("road", SQUARE.points_m[::-1])
    points = np.random.default_rng(0).uniform(-1, 5, (500, 2))
    assert inside([SQUARE], points).tolist() == inside([turned], points).tolist()
    expected = (points > 0).all(axis=1) & (points[:, 0] < 4) & (points[:, 1] < 3)
    assert inside([SQUARE], points).tolist() == expected.tolist()
