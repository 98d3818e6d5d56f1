"""Answers that are larger than any perception stack gives; `tests/hostile` damages some."""

import pytest

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.messages import to_output
from fbench.replay.contracts.errors import DataError


def boxes(num=1, **fields):
    return schema.Boxes3D(center_m=[1, 2, 3] * num, size_lwh_m=[4, 2, 1] * num, yaw_rad=[0] * num, **fields)


def output(detections=None, tracks=None, **fields):
    return schema.Output(in_3d=schema.Results3D(detections=detections or boxes(0), tracks=tracks or boxes(0)), **fields)


def test_one_long_text_among_many_does_not_take_its_room_for_all():
    with pytest.raises(DataError, match="a text has 3000000 characters"):
        to_output(output(boxes(2000, label=["L" * 3_000_000] + ["car"] * 1999)))


def test_more_boxes_than_a_frame_has_are_refused():
    with pytest.raises(DataError, match="detections: expected at most 10000 boxes, got 10001"):
        to_output(output(boxes(10_001)))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"missing": {f"m{i}": "" for i in range(257)}}, "missing: expected at most 512, got 514"),
        ({"missing": {"lidar": "x" * 201}}, "missing: a text has 201 characters"),
        ({"stages": [schema.Stage(name="x" * 201, duration_ns=1)]}, "stages: a text has 201 characters"),
    ],
)
def test_what_is_kept_of_each_frame_is_bounded(fields, match):
    with pytest.raises(DataError, match=match):
        to_output(output(**fields))


def test_one_id_twice_is_a_fault_of_the_frame():
    with pytest.raises(DataError, match="tracks: id 5 is there twice"):
        to_output(output(tracks=boxes(2, track_id=[5, 5])))
