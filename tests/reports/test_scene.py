"""The data that the page draws, by hand."""

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
from fbench.replay.data.details import Details, ObjectTrack, Span, save_details
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.engine.service_queue import LatencyModel
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame, Points
from fbench.replay.runs.outcomes import save_outcomes
from fbench.reports.boxes import box_rows
from fbench.reports.html.latency import frame_times
from fbench.reports.html.overview import overview
from fbench.reports.html.records import brief, island, number, round_floats, visible
from fbench.reports.html.scene import scenes

MakeRun = Callable[[Plan], Run]
Write = Callable[..., Page]
PLAIN = st.text() | st.integers() | st.booleans() | st.none()
JSON = st.recursive(PLAIN, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


def cloud(page: Page, frame: dict[str, Any], sensor: str) -> list[list[int]]:
    number = next(c["cloud"] for c in frame["clouds"] if c["sensor"] == sensor)
    return np.frombuffer(page.inflate(number), "<i2").reshape(4, -1).T.tolist()


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


def test_unknown_velocity_is_left_out(make_run: MakeRun, report: Write) -> None:
    def unknown(label: str) -> Boxes3D:
        return Boxes3D(np.array([[10.0, 0, 0]]), np.ones((1, 3)), np.zeros(1), velocity_mps=np.full((1, 3), np.nan))

    frame = report(make_run(Plan(make_boxes=unknown))).frames()[0]
    assert "speed" not in frame["tracks"][0]


def test_boxes_of_all_frames_are_in_the_page(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan(failed="ValueError: no points")))
    frames = page.frames()
    assert [frame["index"] for frame in frames] == [0, 1, 2, 3]
    assert [len(frame["truth"]) for frame in frames] == [1, 1, 1, 1]
    assert [len(frame["tracks"]) for frame in frames] == [1, 1, 0, 1]
    assert [row for row, _ in page.data["runs"][0]["media"]] == [0, 2]
    box = frames[1]["tracks"][0]
    assert box["box"] == [10, 0, 0, 4, 2, 2, 0, 0, 0]
    assert (box["id"], box["label"], box["score"], box["distance"], box["speed"]) == (7, "car", 0.875, 10, 5)
    assert box["seen"]["cam"][-2:] == [92, 72]


def test_clouds_are_in_centimeters(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan()))
    frame = page.frames()[0]
    assert cloud(page, frame, "top") == [[100, -200, 50, -32768], [3000, 400, 100, -32768]]
    assert cloud(page, frame, "radar") == [[100, -200, 50, -525], [3000, 400, 100, 200]]
    assert [c["kind"] for c in frame["clouds"]] == ["radar", "lidar"]


def test_what_runs_share_is_stored_once(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan(name="a")), make_run(Plan(name="b", pipeline="other")))
    a, b = page.data["runs"]
    assert a["media"] == b["media"]
    assert a["chunks"] == b["chunks"]
    assert page.content(a["media"][0][1]["pictures"]["cam"]) == media(0).pictures["cam"].jpeg


def with_errors(run: Run) -> Run:
    """Two missed boxes in frame 3, and a false alarm in 1."""
    save_outcomes(run.folder, {
        "truth": {(0, ""): "hit", (1, ""): "hit", (2, ""): "hit", (3, ""): "missed"},
        "detections": {(0, ""): "hit", (1, ""): "false alarm", (2, ""): "ignored", (3, ""): "hit"},
    })  # fmt: skip
    return run


def test_boxes_have_their_outcomes(make_run: MakeRun, report: Write) -> None:
    page = report(with_errors(make_run(Plan())))
    errors = page.data["runs"][0]["timeline"]["errors"]
    none = [0, 0, 0, 0]
    assert errors == {"missed": [0, 0, 0, 1], "alarms": [0, 1, 0, 0], "false_tracks": none, "switches": none}
    assert [frame["outcomes"] for frame in page.frames()] == [["hit"], ["hit"], ["hit"], ["missed"]]
    assert [frame["detections"][0]["outcome"] for frame in page.frames()] == ["hit", "false alarm", "ignored", "hit"]
    assert report(make_run(Plan(name="unscored"))).data["runs"][0]["timeline"]["errors"] is None


def test_a_switch_is_where_the_next_track_begins(make_run: MakeRun, report: Write) -> None:
    """A track that comes back after a gap is no switch."""
    ends = [(0, 0, 5), (1, 1, None), (2, 2, 5), (3, 3, 8)]
    spans = tuple(Span(first, last, track) for first, last, track in ends)
    run = with_errors(make_run(Plan()))
    save_details(run.folder, Details(objects=(ObjectTrack("car", 7, "", 4, 1, 1, 1, 10.0, spans),)))
    page = report(run)
    assert page.data["runs"][0]["timeline"]["errors"]["switches"] == [0, 0, 0, 1]
    assert [frame["switched"] for frame in page.frames()] == [[], [], [], [7]]


def test_budget_keeps_the_frames_with_errors(make_run: MakeRun) -> None:
    def wide(index: int) -> MediaFrame:
        xyz = np.random.default_rng(index).normal(0, 20, (9000, 3)).astype(np.float32)
        return MediaFrame(index, {}, {"top": Points(xyz, np.full(9000, np.nan, np.float32))})

    run = make_run(Plan(num_frames=40))
    save_outcomes(run.folder, {"truth": {(33, ""): "missed"}})
    vars(run)["media"] = ()
    budgets = (25e6, 2e6, 0.5e6, float(scenes([run], ["a"]).store.num_bytes), 0.0)
    vars(run)["media"] = tuple(wide(index) for index in range(40))
    sizes = [scenes([run], ["a"], budget) for budget in budgets]
    assert [s.num_shown for s in sizes[:3]] == [40, 40, 40]
    assert sizes[0].num_without_media == sizes[1].num_without_media == 0
    assert sizes[1].store.num_bytes < 2e6 < sizes[0].store.num_bytes  # the clouds are thinned
    kept = [row for row, _ in sizes[2].content["runs"][0]["media"]]
    assert {*range(28, 39)} <= {*kept}
    assert 0 < sizes[2].num_without_media == 40 - len(kept)
    few = sizes[3].content["runs"][0]["frames"]
    assert 33 in few
    assert 0 < len(few) < 40
    assert sizes[3].num_left_out == 40 - len(few)
    assert sizes[4].num_shown == 0
    assert all(s.store.num_bytes <= budget for s, budget in zip(sizes, budgets, strict=True))


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
    assert data["runs"][0]["timeline"]["errors"] is None


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


def test_a_dropped_frame_shows_the_output_that_counts_then(tmp_path, report):
    """With 250 ms, frames 0, 2, 5 and 7 run; at the instant of 3 output 0 is ready, and at that of 6 output 2."""
    run = play(drive(8), tmp_path / "run", latency=LatencyModel(250_000_000), num_media=8)
    (shown,) = scenes([run], ["echo"]).content["runs"]
    line = shown["timeline"]
    assert line["dropped"] == [[1, None], [3, 0], [4, 0], [6, 2]]
    assert [num is None for num in line["tracks"]] == [i in (1, 3, 4, 6) for i in range(8)]
    boxes = {frame["index"]: [box["id"] for box in frame["tracks"]] for frame in report(run).frames()}
    assert boxes == {0: [1], 1: [], 2: [2], 3: [1], 4: [1], 5: [3], 6: [2], 7: [4]}
    times = frame_times(run)
    assert [ms is None for ms in times] == [i in (1, 3, 4, 6) for i in range(8)]
    assert overview(run, "echo").dropped == 4
    lockstep = play(drive(2), tmp_path / "lockstep")
    assert scenes([lockstep], ["echo"]).content["runs"][0]["timeline"]["dropped"] == []
    assert overview(lockstep, "echo").dropped is None
