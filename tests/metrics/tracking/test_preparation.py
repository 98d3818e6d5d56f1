"""What benchmarks excuse, box by box; and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fbench.metrics.profiles.motmetrics import MOTMETRICS
from fbench.metrics.profiles.trackeval.prepare import HALF, KITTI, MOT15, MOT17, MOT20, problems
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.sequences import Objects, Sequence, Steps

BIG, SMALL = (0, 0, 40, 40), (0, 0, 40, 25)


def objects(*rows, **columns) -> Objects:
    """All in step 0, each (label, box)."""
    num = len(rows)
    return Objects(
        step=np.zeros(num, np.int64),
        label=np.array([row[0] for row in rows], np.str_),
        track_id=np.arange(num),
        score=np.ones(num),
        xyxy_px=np.array([row[1] for row in rows], float).reshape(-1, 4),
        **columns,
    )


def left(truth, estimates, preparation=KITTI):
    """Truth rows and estimate rows that count, of the first class."""
    one = next(problems(Sequence("s", Steps.of_one_stream(1), truth, estimates), preparation, HALF))
    return one.truth_row.tolist(), one.estimate_row.tolist()


def test_vans_and_hard_cars_excuse_results_and_are_no_misses():
    car = objects(("car", BIG))
    assert left(objects(("car", BIG)), car) == ([0], [0])
    assert left(objects(("van", BIG)), car) == ([], [])
    assert left(objects(("cyclist", BIG)), car) == ([], [0])
    one = np.array([1.0])
    assert left(objects(("car", BIG), truncation=one), car) == ([], [])
    assert left(objects(("car", BIG), truncation=0.9 * one), car) == ([0], [0])  # levels are whole numbers there
    assert left(objects(("car", BIG), occlusion=3 * one), car) == ([], [])
    assert left(objects(("car", BIG), occlusion=2 * one), car) == ([0], [0])
    assert left(objects(("car", BIG), occlusion=np.nan * one), car) == ([0], [0])


def test_small_results_are_excused_where_nothing_matches():
    assert left(objects(("car", BIG)), objects(("car", SMALL))) == ([0], [0])  # matches
    assert left(objects(), objects(("car", SMALL))) == ([], [])
    assert left(objects(), objects(("car", (0, 0, 40, 25.5)))) == ([], [0])


def test_results_upside_down_or_without_rectangle_have_no_height():
    """Trackers in 3D write -1 -1 -1 -1; TrackEval takes that for a box without height."""
    none = (np.nan,) * 4
    for box in ((0, 40, 40, 0), (40, 40, 0, 0), none):
        assert left(objects(("car", BIG)), objects(("car", box))) == ([0], [])
        assert left(objects(("pedestrian", BIG)), objects(("pedestrian", box)), MOT17) == ([0], [0])


def test_car_2_is_a_car():
    """TrackEval's table of classes has it."""
    assert left(objects(("car", BIG)), objects(("car_2", BIG))) == ([0], [0])


def test_regions_excuse_what_lies_in_one_of_them_to_more_than_half():
    region = (0, 0, 30, 40)
    assert left(objects(("dontcare", region)), objects(("car", (0, 0, 40, 40)))) == ([], [])
    assert left(objects(("dontcare", region)), objects(("car", (0, 0, 60, 40)))) == ([], [0])  # a half
    two = objects(("dontcare", (0, 0, 20, 40)), ("dontcare", (20, 0, 40, 40)))
    assert left(two, objects(("car", (0, 0, 40, 40)))) == ([], [0])  # a half in each
    assert left(objects(("car", (0, 0, 40, 40)), ("dontcare", region)), objects(("car", BIG))) == ([0], [0])


def test_each_class_has_its_own_results():
    truth, estimates = objects(("car", BIG), ("pedestrian", BIG)), objects(("pedestrian", BIG), ("car", BIG))
    of_car, of_people = problems(Sequence("s", Steps.of_one_stream(1), truth, estimates), KITTI, HALF)
    assert (of_car.truth_row.tolist(), of_car.estimate_row.tolist()) == ([0], [1])
    assert (of_people.truth_row.tolist(), of_people.estimate_row.tolist()) == ([1], [0])


def test_mot_excuses_distractors_but_not_other_classes_or_marked_people():
    person = objects(("pedestrian", BIG))
    assert left(objects(("static person", BIG)), person, MOT17) == ([], [])
    assert left(objects(("car", BIG)), person, MOT17) == ([], [0])
    marked = objects(("pedestrian", BIG), ignore=np.array([True]))
    assert left(marked, person, MOT17) == ([], [0])
    assert left(objects(("non motorized vehicle", BIG)), person, MOT17) == ([], [0])
    assert left(objects(("non motorized vehicle", BIG)), person, MOT20) == ([], [])
    assert left(objects(("static person", BIG)), person, MOT15) == ([0], [0])


def test_results_of_another_class_are_refused_by_mot():
    with pytest.raises(MetricError, match=r"s, frame 0: results of class 'car', expected"):
        left(objects(), objects(("car", BIG)), MOT17)
    with pytest.raises(MetricError, match=r"s, frame 0: truth of class 'bus'"):
        left(objects(("bus", BIG)), objects(), MOT17)


def test_an_id_twice_in_a_frame_is_refused():
    double = replace(objects(("car", BIG), ("car", (100, 0, 140, 40))), track_id=np.array([7, 7]))
    for truth, estimates in ((double, objects()), (objects(), double)):
        with pytest.raises(MetricError, match=r"s, frame 0: \w+ have id 7 twice") as raised:
            TRACKEVAL_KITTI.measure(Sequence("s", Steps.of_one_stream(1), truth, estimates))
        assert raised.value.code == "GT003"


def test_each_class_has_its_own_ids():
    both = replace(objects(("car", BIG), ("pedestrian", BIG)), track_id=np.array([7, 7]))
    found = TRACKEVAL_KITTI.measure(Sequence("s", Steps.of_one_stream(1), both, both)).classes
    assert [found[name].clear.tp for name in ("car", "pedestrian")] == [1, 1]


def test_boxes_without_id_are_left_out_by_kitti_and_refused_by_others():
    nameless = replace(objects(("car", BIG)), track_id=np.array([-1]))
    assert left(nameless, nameless) == ([], [])
    with pytest.raises(MetricError, match="results without an id"):
        MOTMETRICS.measure(Sequence("s", Steps.of_one_stream(1), objects(), nameless))


def test_truth_that_counts_for_nothing_needs_no_id():
    region = replace(objects(("dontcare", BIG)), track_id=np.array([-1]), ignore=np.array([True]))
    assert left(region, objects(), MOT15) == ([], [])
    with pytest.raises(MetricError, match="truth without an id"):
        left(replace(region, ignore=np.array([False])), objects(), MOT15)


@pytest.mark.parametrize("box", [(np.nan, 0, 1, 1), (0, 0, np.inf, 40), (40, 0, 0, 40)])
def test_results_that_are_no_boxes_are_false_alarms(box):
    one = Sequence("s", Steps.of_one_stream(1), objects(("car", BIG)), objects(("car", box)))
    clear = MOTMETRICS.measure(one).classes["object"].clear
    assert (clear.tp, clear.fn, clear.fp) == (0, 1, 1)
    counts = TRACKEVAL_KITTI.measure(one).classes["car"]
    assert (counts.clear.fp, counts.hota.fp[0], counts.identity.fp) == (1, 1, 1)
