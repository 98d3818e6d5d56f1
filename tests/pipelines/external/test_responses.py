"""Outputs of the schema become outputs of fbench, field by field; what is wrong is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.messages import ProtocolError, parse_response, to_output
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.boxes import LABELS, Boxes2D, Boxes3D

FINITE = st.floats(-1e8, 1e8)


def optional(num, values):
    return st.just([]) | st.lists(values, min_size=num, max_size=num)


def exactly(num, values):
    return st.lists(values, min_size=num, max_size=num)


@st.composite
def boxes3d(draw):
    n = draw(st.integers(0, 4))
    return schema.Boxes3D(
        center_m=draw(exactly(3 * n, FINITE)),
        size_lwh_m=draw(exactly(3 * n, FINITE)),
        yaw_rad=draw(exactly(n, FINITE)),
        roll_rad=draw(optional(n, FINITE)),
        pitch_rad=draw(optional(n, FINITE)),
        velocity_mps=draw(optional(3 * n, FINITE | st.just(float("nan")))),
        **draw(common(n)),
    )


@st.composite
def boxes2d(draw):
    n = draw(st.integers(0, 4))
    return schema.Boxes2D(
        camera=draw(exactly(n, st.sampled_from(["front", "rear"]))),
        xyxy_px=draw(exactly(4 * n, FINITE)),
        visible_xyxy_px=draw(optional(4 * n, FINITE)),
        distance_m=draw(optional(n, FINITE | st.just(float("nan")))),
        range_rate_mps=draw(optional(n, FINITE)),
        **draw(common(n)),
    )


@st.composite
def common(draw, n):
    return {
        "label": draw(optional(n, st.sampled_from(["", *LABELS]))),
        "score": draw(optional(n, FINITE)),
        "track_id": draw(st.just([]) | st.lists(st.integers(-(2**63), 2**63 - 1), min_size=n, max_size=n, unique=True)),
        "sources": draw(optional(n, st.integers(0, 15))),
        "predicted": draw(optional(n, st.booleans())),
    }


def check(got, sent, kind):
    assert isinstance(got, kind)
    arrays = got.arrays()
    for field, values in sent.ListFields():
        np.testing.assert_array_equal(arrays.pop(field.name).ravel(), list(values))
    assert all(array.size == 0 for array in arrays.values())


@pytest.mark.slow
@given(boxes3d(), boxes3d())
def test_boxes_in_3d(detections, tracks):
    sent = schema.Output(in_3d=schema.Results3D(detections=detections, tracks=tracks))
    got = to_output(schema.Output.FromString(sent.SerializeToString()))
    check(got.detections, detections, Boxes3D)
    check(got.tracks, tracks, Boxes3D)


@pytest.mark.slow
@given(boxes2d(), boxes2d())
def test_boxes_in_2d(detections, tracks):
    sent = schema.Output(in_2d=schema.Results2D(detections=detections, tracks=tracks))
    got = to_output(schema.Output.FromString(sent.SerializeToString()))
    check(got.detections, detections, Boxes2D)
    check(got.tracks, tracks, Boxes2D)


def test_stages_keep_their_order_and_missing_is_passed_on():
    stages = [schema.Stage(name=name, duration_ns=ns) for name, ns in (("track", 5), ("decode", 2))]
    sent = schema.Output(in_3d=schema.Results3D(), stages=stages, missing={"radar": "not used", "cam": "dark"})
    got = to_output(sent)
    assert list(got.stage_ns.items()) == [("track", 5), ("decode", 2)]
    assert list(got.missing.items()) == [("cam", "dark"), ("radar", "not used")]


def test_boxes_in_2d_of_a_wrong_length():
    boxes = schema.Boxes2D(camera=["front"], xyxy_px=[1, 2, 3])
    with pytest.raises(DataError, match=r"tracks\.xyxy_px: expected 4 numbers a box, got 3 in all"):
        to_output(schema.Output(in_2d=schema.Results2D(tracks=boxes)))
    with pytest.raises(DataError, match=r"Boxes2D\.xyxy_px"):
        to_output(schema.Output(in_2d=schema.Results2D(tracks=schema.Boxes2D(camera=["a"], xyxy_px=range(8)))))


@given(st.binary(max_size=40))
def test_bytes_of_any_kind_are_a_response_or_refused(data):
    try:
        response = parse_response(data, 1)
    except ProtocolError:
        return
    assert response.sequence == 1


def test_fields_of_later_versions_are_read_over():
    data = schema.Response(sequence=1, done=schema.Done()).SerializeToString()
    later = bytes([100 << 3 & 0x7F | 0x80, 100 << 3 >> 7, 5]) + data
    assert parse_response(later, 1).WhichOneof("kind") == "done"


def test_tracks_that_are_not_set_are_none():
    detections = schema.Boxes3D(center_m=[1, 2, 3], size_lwh_m=[4, 2, 1], yaw_rad=[0])
    unset = to_output(schema.Output(in_3d=schema.Results3D(detections=detections)))
    assert (len(unset.detections), unset.tracks) == (1, None)
    empty = to_output(schema.Output(in_2d=schema.Results2D(tracks=schema.Boxes2D())))
    assert isinstance(empty.tracks, Boxes2D)
    assert len(empty.tracks) == 0


def test_faults_and_the_clock_of_an_output():
    faults = [schema.Fault(code="DEC002", where="front at stamp 5"), schema.Fault(code="DEC001", where="")]
    found = to_output(schema.Output(in_3d=schema.Results3D(), faults=faults, log_clock=True))
    assert [(fault.code, fault.where) for fault in found.faults] == [("DEC002", "front at stamp 5"), ("DEC001", "")]
    assert found.clock == "log"
    plain = to_output(schema.Output(in_3d=schema.Results3D()))
    assert (plain.faults, plain.clock) == ((), "host")
    with pytest.raises(DataError, match="faults"):
        to_output(schema.Output(in_3d=schema.Results3D(), faults=[faults[0]] * 1000))
