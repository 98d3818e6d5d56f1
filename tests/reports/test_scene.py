"""The data that the page draws, by hand."""

import base64
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.engine.test_run import play
from tests.replay.fakes import drive
from tests.reports.conftest import FORWARD, RIG, Page, Plan, boxes2d, boxes3d, media

from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.engine.service_queue import LatencyModel
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame, Points
from fbench.reports.html.latency import frame_times
from fbench.reports.html.overview import overview
from fbench.reports.html.records import brief, island, number, round_floats, visible
from fbench.reports.html.scene import MAX_POINTS, box_rows, scenes

MakeRun = Callable[[Plan], Run]
Write = Callable[..., Page]
PLAIN = st.text() | st.integers() | st.booleans() | st.none()
JSON = st.recursive(PLAIN, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


def cloud(data: Any, frame: dict[str, Any], sensor: str) -> list[list[int]]:
    number = next(c["cloud"] for c in frame["clouds"] if c["sensor"] == sensor)
    table = np.frombuffer(base64.b64decode(data["clouds"][number]), "<i2").reshape(-1, 4)
    return [[int(v) for v in row] for row in table]


def test_box_3d_by_hand() -> None:
    (row,) = box_rows(boxes3d(), RIG, ["cam"])
    assert row["distance"] == 10.0
    assert row["speed"] == 5.0
    assert row["velocity"] == [3.0, 4.0]
    assert row["corners"][:3] == [12.0, 1.0, 1.0]
    assert row["corners"][-3:] == [8.0, -1.0, -1.0]
    assert (row["id"], row["label"], row["score"], row["sources"]) == (7, "car", 0.875, 6)
    # The near face is 8 m away and reaches 1 m to each side: 100 / 8 = 12.5 px around (79.5, 59.5).
    assert row["seen"]["cam"]["rect"] == [67.0, 47.0, 92.0, 72.0]
    assert row["seen"]["cam"]["wire"][-2:] == [92.0, 72.0]


def test_box_behind_the_camera_is_not_outlined() -> None:
    box = Boxes3D(np.array([[-10.0, 0, 0]]), np.ones((1, 3)), np.zeros(1))
    assert box_rows(box, RIG, ["cam"])[0]["seen"] == {}


def test_box_around_the_camera_has_no_wire_frame() -> None:
    box = Boxes3D(np.array([[1.0, 0, 0]]), np.full((1, 3), 4.0), np.zeros(1))
    seen = box_rows(box, RIG, ["cam"])[0]["seen"]["cam"]
    assert seen == {"rect": [-0.5, -0.5, 159.5, 119.5], "wire": None}


def bent(model: str, *coefficients: float) -> Rig:
    return Rig(RIG.mounts, {"cam": CameraModel(RIG.cameras["cam"].K, (160, 120), model, np.array(coefficients))})


def test_camera_with_unsupported_distortion_is_left_out() -> None:
    rig = bent("omni", 0.1)
    assert box_rows(boxes3d(), rig, ["cam"])[0]["seen"] == {}
    assert "place" not in box_rows(boxes2d(), rig, ["cam"])[0]


def test_edges_are_curves_where_a_lens_bends_them() -> None:
    seen = box_rows(boxes3d(), bent("plumb_bob", -2.0, 0, 0, 0), ["cam"])[0]["seen"]["cam"]
    assert len(seen["wire"]) == 16
    assert [len(edge) for edge in seen["curves"]] == [18] * 12
    # The near face reaches to 1/8 in both directions: 12.5 (1 - 2 * 2/64) = 11.7 px to its corners, and in the middle
    # of its edges to 12.5 (1 - 2/64) = 12.1 px.
    assert seen["wire"][-2:] == [91.2, 71.2]
    assert seen["rect"] == [67.4, 47.4, 91.6, 71.6]
    assert seen["curves"][-1][-2:] == seen["wire"][-2:]
    assert "curves" not in box_rows(boxes3d(), RIG, ["cam"])[0]["seen"]["cam"]


def test_box_2d_is_placed_on_a_bent_ray() -> None:
    # 100 r (1 - 0.2 r2) = 47.5 px to the left of (79.5, 59.5) for r = 0.5: the ray is (1, 0.5, 0).
    one = replace(boxes2d(), xyxy_px=np.array([[22.0, 49.5, 42.0, 69.5]]))
    (row,) = box_rows(one, bent("plumb_bob", -0.2, 0, 0, 0), ["cam"])
    assert row["place"] == pytest.approx([25 / 1.25**0.5, 12.5 / 1.25**0.5, 0], abs=1e-6)
    unreachable = replace(boxes2d(), xyxy_px=np.array([[-500.0, 49.5, -450.0, 69.5]]))
    assert "place" not in box_rows(unreachable, bent("plumb_bob", -0.2, 0, 0, 0), ["cam"])[0]


def test_box_2d_by_hand() -> None:
    (row,) = box_rows(boxes2d(), RIG, ["cam"])
    assert row["seen"] == {"cam": {"rect": [10.0, 20.0, 50.0, 60.0], "wire": None}}
    assert (row["distance"], row["speed"], row["id"]) == (25.0, -1.5, 3)
    assert "corners" not in row


def test_box_2d_with_a_distance_is_placed_on_its_ray() -> None:
    # Its middle (29.5, 39.5) lies 50 px left of and 20 px above the principal point: the ray is (1, 0.5, 0.2) forward,
    # left and up, of length sqrt(1.29); 25 m along it, since camera and body share their origin.
    (row,) = box_rows(replace(boxes2d(), xyxy_px=np.array([[19.5, 29.5, 39.5, 49.5]])), RIG, ["cam"])
    assert row["place"] == pytest.approx([25 / 1.29**0.5, 12.5 / 1.29**0.5, 5 / 1.29**0.5])
    assert row["velocity"] == pytest.approx([-1.5 / 1.29**0.5, -0.75 / 1.29**0.5])


def test_placed_box_has_its_distance_from_the_body_not_from_the_camera() -> None:
    mounts = {"cam": Mount("camera", np.array([2.0, 0, 1]), FORWARD)}
    (row,) = box_rows(boxes2d(), Rig(mounts, RIG.cameras), ["cam"])
    assert np.linalg.norm(row["place"]) == pytest.approx(25)
    unknown = replace(boxes2d(), camera=np.array(["other"]))
    assert "place" not in box_rows(unknown, RIG, [])[0]
    assert "place" not in box_rows(replace(boxes2d(), distance_m=np.array([np.nan])), RIG, ["cam"])[0]
    assert "place" not in box_rows(replace(boxes2d(), distance_m=np.array([0.5])), Rig(mounts, RIG.cameras), [])[0]


def test_boxes_without_optional_fields() -> None:
    flat = Boxes2D(np.array(["cam"]), np.zeros((1, 4)), track_id=np.array([-1]))
    (row,) = box_rows(flat, RIG, ["cam"])
    assert (row["label"], row["id"], row["score"], row["sources"], row["distance"]) == ("", None, None, 0, None)
    assert box_rows(None, RIG, ["cam"]) == []
    assert box_rows(Boxes3D.empty(), RIG, ["cam"]) == []


BAD = (np.nan, np.inf, -np.inf, 1e9, 1e308)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("field", ["center_m", "size_lwh_m", "yaw_rad"])
def test_damaged_box_3d_is_listed_and_has_no_geometry(bad: float, field: str) -> None:
    two = concatenate([boxes3d("car"), boxes3d("van")])
    values = getattr(two, field).copy()
    values[0, ...] = bad
    damaged, sound = box_rows(replace(two, **{field: values}), RIG, ["cam"])
    assert (damaged["label"], damaged["invalid"], damaged["seen"], damaged["distance"]) == ("car", True, {}, None)
    assert not {"corners", "velocity", "place"} & set(damaged)
    assert sound == box_rows(boxes3d("van"), RIG, ["cam"])[0]
    assert "invalid" not in sound


@pytest.mark.parametrize("bad", BAD)
def test_damaged_box_2d_is_listed_and_has_no_outline(bad: float) -> None:
    rect = np.array([[10.0, 20, bad, 60]])
    (row,) = box_rows(replace(boxes2d(), xyxy_px=rect), RIG, ["cam"])
    assert (row["invalid"], row["seen"], row["distance"], row["speed"]) == (True, {}, None, None)


@pytest.mark.parametrize("distance", [*BAD, 0.0, -5.0])
def test_box_2d_at_an_impossible_distance_has_no_place(distance: float) -> None:
    (row,) = box_rows(replace(boxes2d(), distance_m=np.array([distance])), RIG, ["cam"])
    assert "place" not in row
    is_invalid = abs(distance) >= 1e9  # NaN: unknown
    assert row["seen"] == ({} if is_invalid else {"cam": {"rect": [10.0, 20.0, 50.0, 60.0], "wire": None}})


def test_unknown_velocity_becomes_null(make_run: MakeRun, report: Write) -> None:
    def unknown(label: str) -> Boxes3D:
        return Boxes3D(np.array([[10.0, 0, 0]]), np.ones((1, 3)), np.zeros(1), velocity_mps=np.full((1, 3), np.nan))

    frame = report(make_run(Plan(make_boxes=unknown))).data["runs"][0]["frames"][0]
    assert frame["tracks"][0]["speed"] is None


def test_only_kept_frames_are_in_the_page(make_run: MakeRun, report: Write) -> None:
    frames = report(make_run(Plan())).data["runs"][0]["frames"]
    assert [frame["index"] for frame in frames] == [0, 2]
    assert [len(frame["truth"]) for frame in frames] == [1, 1]


def test_clouds_are_in_centimetres(make_run: MakeRun, report: Write) -> None:
    data = report(make_run(Plan())).data
    frame = data["runs"][0]["frames"][0]
    assert cloud(data, frame, "top") == [[100, -200, 50, -32768], [3000, 400, 100, -32768]]
    assert cloud(data, frame, "radar") == [[100, -200, 50, -525], [3000, 400, 100, 200]]
    assert [c["kind"] for c in frame["clouds"]] == ["radar", "lidar"]


def test_pictures_are_stored_once_for_all_runs(make_run: MakeRun, report: Write) -> None:
    data = report(make_run(Plan(name="a")), make_run(Plan(name="b"))).data
    assert len(data["pictures"]) == 2
    assert [frame["pictures"]["cam"] for run in data["runs"] for frame in run["frames"]] == [0, 1, 0, 1]
    assert base64.b64decode(data["pictures"][0]) == media(0).pictures["cam"].jpeg


def test_large_clouds_are_thinned_evenly(make_run: MakeRun, report: Write) -> None:
    run = make_run(Plan())
    xyz = np.zeros((3 * MAX_POINTS, 3), np.float32)
    xyz[:, 0] = np.arange(len(xyz)) / 100
    far = Points(xyz, np.full(len(xyz), np.nan, np.float32))
    vars(run)["media"] = (MediaFrame(0, {}, {"top": far}),)
    data = report(run).data
    rows = cloud(data, data["runs"][0]["frames"][0], "top")
    assert len(rows) == MAX_POINTS
    assert [row[0] for row in rows[:3]] == [0, 3, 6]


def test_timeline_has_every_frame(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan(missing={"radar": "timeout"}, failed="ValueError: no points")))
    line = page.data["runs"][0]["timeline"]
    assert line["t"] == [0, 0.1, 5.2, 5.3]
    assert line["segment"] == [0, 0, 1, 1]
    assert line["truth"] == [1, 1, 1, 1]
    assert line["detections"] == [1, 1, 0, 1]
    assert line["missing"] == [[1, "radar", "timeout"]]
    assert line["failed"] == [[2, "ValueError: no points"]]
    assert json.loads(page.islands["times"]) == [{"budget": 100.0, "total": [75.0] * 4, "warm_up": 0}]


def test_unlabelled_frames_have_no_truth_count(make_run: MakeRun, report: Write) -> None:
    data = report(make_run(Plan(truth=False))).data
    assert data["runs"][0]["timeline"]["truth"] == [None] * 4
    assert data["runs"][0]["frames"][0]["labelled"] is False


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.8571, 3, "0.857"),
        (-0.5, 2, "−0.50"),
        (-0.0001, 2, "0.00"),
        (1234567.0, 0, "1\u202f234\u202f567"),
        (None, 3, "–"),
        (float("nan"), 3, "–"),
        (float("inf"), 3, "–"),
    ],
)
def test_number(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_visible_shows_what_would_act_or_hide() -> None:
    assert visible("a\x1b[31mb\u202ec\u2028d\ud800") == "a\\x1b[31mb\\u202ec\\u2028d\\ud800"
    assert visible("Zürich\n东京 🚗") == "Zürich\n东京 🚗"
    assert brief("0123456789abcdef") == "0123456789ab"


def test_rounded() -> None:
    assert round_floats({"a": [1.23456, float("nan"), -0.0001, None, True, 2**60]}) == {
        "a": [1.235, None, 0, None, True, 2**60]
    }


@pytest.mark.slow
@given(JSON)
def test_island_keeps_data_and_ends_no_element(value: Any) -> None:
    text = island(value)
    assert not set("<>&'\u2028\u2029") & set(text)
    text.encode("utf-8")
    assert json.loads(text) == round_floats(value)


def test_a_dropped_frame_shows_the_output_that_counts_then(tmp_path):
    """With 250 ms, frames 0, 2, 5 and 7 run; at the instant of 3 output 0 is ready, and at that of 6 output 2."""
    run = play(drive(8), tmp_path / "run", latency=LatencyModel(250_000_000), num_media=8)
    (shown,) = scenes([run], ["echo"])["runs"]
    line = shown["timeline"]
    assert line["dropped"] == [[1, None], [3, 0], [4, 0], [6, 2]]
    assert [num is None for num in line["tracks"]] == [i in (1, 3, 4, 6) for i in range(8)]
    boxes = {frame["index"]: [box["id"] for box in frame["tracks"]] for frame in shown["frames"]}
    assert boxes == {0: [1], 1: [], 2: [2], 3: [1], 4: [1], 5: [3], 6: [2], 7: [4]}
    times = frame_times(run)
    assert [ms is None for ms in times] == [i in (1, 3, 4, 6) for i in range(8)]
    assert overview(run, "echo").dropped == 4
    lockstep = play(drive(2), tmp_path / "lockstep")
    assert scenes([lockstep], ["echo"])["runs"][0]["timeline"]["dropped"] == []
    assert overview(lockstep, "echo").dropped is None
