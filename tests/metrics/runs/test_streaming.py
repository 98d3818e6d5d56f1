"""Streaming scores, on constructed sequences and on objects of constant speed."""

from dataclasses import replace

import numpy as np
import pytest
from tests.metrics.conftest import NO_CAMERA, boxes2d, boxes3d, front_camera, make_manifest

from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.streaming import StreamedRun, measure_streaming, score_streaming
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import FORECAST, LOCKSTEP, STREAMING, ScoreOptions
from fbench.replay.engine.service_queue import pair_outputs
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import LatencyEntry

MS = 1_000_000
STEP = 100 * MS
LATENCY = LatencyEntry(service_ns=0, overload="newest", num_dropped=0)


def frame(index, ready_ns, done_ns, segment=0):
    start_ns = None if done_ns is None else ready_ns
    return FrameRecord(index, index, segment, None, {}, "", "", ready_ns=ready_ns, start_ns=start_ns, done_ns=done_ns)


def pair(*frames):
    return pair_outputs([frame(i, *values) for i, values in enumerate(frames)]).tolist()


def test_the_latest_finished_output_counts():
    """As sAP: the last output with a time up to the instant; a tie is in time; none is there at first."""
    assert pair((0, 30), (10, 40), (20, 50), (30, 60), (40, 70)) == [-1, -1, -1, 0, 1]
    assert pair((0, 31), (10, 41), (20, 51), (30, 61), (40, 71)) == [-1, -1, -1, -1, 0]
    assert pair((0, 15), (10, None), (20, 25), (30, None), (40, 45)) == [-1, -1, 0, 2, 2]


def test_without_latency_every_frame_has_its_own_output_also_where_several_are_ready_at_once():
    assert pair((0, 0), (10, 10), (10, 10), (10, 10), (20, 20)) == [0, 1, 2, 3, 4]


def test_a_segment_begins_without_an_output():
    assert pair((0, 5), (10, 15), (20, 25, 1), (30, 35, 1)) == [-1, 0, -1, 2]


def published_rule(frames, instants):
    """The rule as it is published: all outputs finished by the instant, of these the last."""
    for row, t in enumerate(instants):
        done = [i for i, (_, done) in enumerate(frames[: row + 1]) if done is not None and done <= t]
        yield max(done, default=-1)


def test_it_agrees_with_the_published_rule():
    random = np.random.default_rng(4)
    for _ in range(50):
        ready = np.cumsum(random.integers(0, 4, 40)).tolist()
        dropped = random.random(40) < 0.3
        ends = np.maximum.accumulate(np.array(ready) + random.integers(0, 9, 40)).tolist()
        frames = [(t, None if gone else end) for t, gone, end in zip(ready, dropped, ends, strict=True)]
        assert pair(*frames) == list(published_rule(frames, ready))


def moving(x_m, y_m=0.0, speed_mps=0.0, **fields):
    """A car with its velocity along x."""
    return replace(boxes3d((x_m, y_m), ids=[1], score=[0.9]), velocity_mps=np.array([[speed_mps, 0.0, 0.0]]), **fields)


def write(folder, outputs, truths, latency_ns, rig=NO_CAMERA, poses=None, has_tracks=True):
    """A run of frames at 10 Hz; each output is ready so much later. `outputs`: detections and tracks of each frame."""
    with RunWriter(folder) as writer:
        for i, (detections, tracks) in enumerate(outputs):
            times = {"ready_ns": i * STEP, "start_ns": i * STEP, "done_ns": i * STEP + latency_ns}
            writer.add_frame(FrameRecord(i, i * STEP, 0, None, {}, "", "", **times), {"total": 1})
            writer.add_boxes("detections", i, detections)
            writer.add_boxes("tracks", i, tracks)
            writer.label_frame(i, truths[i])
        if poses is not None:
            writer.set_poses(poses)
        return Run(writer.finish(make_manifest(rig, num_frames=len(outputs), latency=LATENCY, has_tracks=has_tracks)))


def drive(folder, latency_ns, speed_mps=10.0, num=12):
    """Cars that are found exactly where they are, at a constant speed."""
    boxes = [moving(speed_mps * 0.1 * i, 0.0, speed_mps) for i in range(num)]
    truths = [Truth(i * STEP, i * STEP, box) for i, box in enumerate(boxes)]
    return write(folder, [(box, box) for box in boxes], truths, latency_ns)


def scores(run):
    lockstep = score_run(run, ScoreOptions(), (Detection(), Tracking()))
    rows = score_streaming(run, ScoreOptions(), lockstep)
    return {(row.metric, row.slice): row for row in rows if not row.matching.startswith("iou")}


def test_no_latency_equals_lockstep_exactly(tmp_path):
    rows = scores(drive(tmp_path / "run", 0))
    metrics = {metric for metric, part in rows if part == LOCKSTEP}
    assert metrics == {"f1", "precision", "recall", "ap", "mota", "idf1", "hota"}
    for metric in metrics:
        lockstep = rows[metric, LOCKSTEP]
        assert lockstep.value == 1
        for part in (STREAMING, FORECAST):
            assert replace(rows[metric, part], slice=LOCKSTEP) == lockstep
    assert rows["staleness", STREAMING].value == 0


def test_latency_above_the_length_of_the_log_finds_nothing(tmp_path):
    rows = scores(drive(tmp_path / "run", 5_000 * MS))
    for part in (STREAMING, FORECAST):
        assert [rows[metric, part].value for metric in ("recall", "mota", "hota")] == [0, 0, 0]
    age = rows["staleness", STREAMING]
    assert (age.value, age.reason) == (None, "no output was ready at any instant")
    assert age.counts == {"age_ns": 0, "frames": 0, "without_output": 12}


@pytest.mark.parametrize("speed_mps", [7.0, 12.0])
def test_accuracy_falls_with_latency_as_geometry_predicts(tmp_path, speed_mps):
    """An output k frames old is speed * k * 0.1 s off: a hit up to 2 m; the first k frames have none."""
    recalls = []
    for k in range(5):
        rows = scores(drive(tmp_path / f"{k}", k * STEP, speed_mps, num=10))
        off_m = speed_mps * 0.1 * k
        hits = 10 - k if off_m <= 2.0 else 0
        assert rows["recall", STREAMING].counts["tp"] == hits
        assert rows["mota", STREAMING].value == pytest.approx((hits - (10 - k - hits)) / 10)
        assert rows["recall", FORECAST].value == rows["mota", FORECAST].value == (10 - k) / 10
        assert rows["staleness", STREAMING].value == (100 * k)
        recalls.append(rows["recall", STREAMING].value)
    assert recalls == sorted(recalls, reverse=True)


def test_several_runs_together_are_their_counts_added(tmp_path):
    """12 frames of which 1 and 3 have no output: 20 of 24 are found with a forecast; ages are 100 and 300 ms."""
    tables = []
    for name, k in (("a", 1), ("b", 3)):
        run = drive(tmp_path / name, k * STEP, 30.0)
        tables.append(measure_streaming(run, run, ScoreOptions()))
        alone = {(row.metric, row.slice): row.value for row in tables[-1].rows() if not row.matching.startswith("iou")}
        assert alone == {key: row.value for key, row in scores(run).items()}
    rows = {(row.metric, row.slice): row for row in (tables[0] + tables[1]).rows() if row.matching[:3] != "iou"}
    assert rows["recall", LOCKSTEP].counts["tp"] == 24
    assert (rows["recall", FORECAST].counts["tp"], rows["mota", FORECAST].value) == (20, pytest.approx(20 / 24))
    assert rows["recall", STREAMING].counts["tp"] == 0
    assert rows["staleness", STREAMING].value == pytest.approx((11 * 100 + 9 * 300) / 20)
    assert rows["staleness", STREAMING].counts["without_output"] == 4


def test_latency_between_two_frames_counts_as_the_next_frame(tmp_path):
    for name, latency_ns, age_ms in (("a", 100 * MS, 100), ("b", 100 * MS + 1, 200), ("c", 1, 100)):
        assert scores(drive(tmp_path / name, latency_ns))["staleness", STREAMING].value == age_ms


def streamed(run, has_forecast=True):
    return StreamedRun(run.folder, run, pair_outputs(run.frames), has_forecast)


def test_a_forecast_is_seen_from_where_the_body_is_then(tmp_path):
    """The body drives 1 m a frame along x and turns left by 90 deg at frame 2; a car stands at (20, 0) in the world."""
    half = np.sqrt(0.5)
    poses = np.array([[0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, half, half]])
    seen = [moving(20.0), moving(19.0), moving(0.0, -18.0, yaw_rad=np.array([-np.pi / 2]))]
    truths = [Truth(i * STEP, i * STEP, box) for i, box in enumerate(seen)]
    run = write(tmp_path / "run", [(box, box) for box in seen], truths, 2 * STEP, poses=poses)
    assert streamed(run).tracks.frames.tolist() == [2]
    np.testing.assert_allclose(streamed(run).tracks.at(2).center_m, [[0, -18, 0]], atol=1e-9)
    np.testing.assert_allclose(streamed(run).tracks.at(2).yaw_rad, [-np.pi / 2])
    assert streamed(run, has_forecast=False).tracks.at(2).center_m.tolist() == [[20, 0, 0]]


def test_a_detection_without_velocity_moves_with_the_track_near_it(tmp_path):
    detections = boxes3d((10, 0), (30, 5), score=[0.9, 0.8])
    tracks = moving(11.0, 0.0, 20.0)
    truth = [Truth(i * STEP, i * STEP, detections) for i in range(2)]
    run = write(tmp_path / "run", [(detections, tracks)] * 2, truth, STEP)
    np.testing.assert_allclose(streamed(run).detections.at(1).center_m, [[12, 0, 0], [30, 5, 0]])
    np.testing.assert_allclose(streamed(run).tracks.at(1).center_m, [[13, 0, 0]])


def test_a_radial_velocity_corrects_that_of_its_track(tmp_path):
    """Radar sees 13 m/s along (0.6, 0.8); the track believes (5, 0), of which 3 m/s are along it, so it gains 10."""
    radial = np.array([[0.6 * 13, 0.8 * 13, 0.0]])
    detections = replace(boxes3d((10, 0), (30, 0), score=[0.9, 0.8]), velocity_mps=np.vstack([radial, radial]))
    tracks = moving(10.5, 0.0, 5.0)
    truth = [Truth(i * STEP, i * STEP, detections) for i in range(2)]
    run = write(tmp_path / "run", [(detections, tracks)] * 2, truth, STEP)
    np.testing.assert_allclose(streamed(run).tracks.at(1).center_m, [[10.5 + 1.1, 0.8, 0]])
    # The other one is near no track, so that only the radial part is known.
    expected = [[10 + 1.1, 0.8, 0], [30 + 0.78, 1.04, 0]]
    np.testing.assert_allclose(streamed(run).detections.at(1).center_m, expected)


def test_a_detection_that_stands_still_says_no_direction(tmp_path):
    detections = replace(boxes3d((10, 0), score=[0.9]), velocity_mps=np.zeros((1, 3)))
    truth = [Truth(i * STEP, i * STEP, detections) for i in range(2)]
    run = write(tmp_path / "run", [(detections, moving(10.0, 0.0, 5.0))] * 2, truth, STEP)
    np.testing.assert_allclose(streamed(run).tracks.at(1).center_m, [[10.5, 0, 0]])


def test_boxes_in_images_go_on_as_their_tracks_moved(tmp_path):
    found = [boxes2d((10 * i, 100, 50 + 10 * i, 140 + 4 * i), ids=[3], score=[0.9]) for i in range(4)]
    bare = [replace(boxes, track_id=None) for boxes in found]
    truths = [Truth(i * STEP, i * STEP, None, boxes) for i, boxes in enumerate(found)]
    run = write(tmp_path / "run", list(zip(bare, found, strict=True)), truths, STEP, front_camera())
    for table in (streamed(run).tracks, streamed(run).detections):
        # Of the first output nobody knows yet how it moves.
        assert table.at(1).xyxy_px.tolist() == [[0, 100, 50, 140]]
        np.testing.assert_allclose(table.at(2).xyxy_px, found[2].xyxy_px)
        np.testing.assert_allclose(table.at(3).xyxy_px, found[3].xyxy_px)


def test_a_pipeline_without_tracks_has_no_scores_of_tracks(tmp_path):
    box, none = boxes3d((10, 0), score=[0.9]), boxes3d()
    truths = [Truth(i * STEP, i * STEP, box) for i in range(3)]
    run = write(tmp_path / "run", [(box, none)] * 3, truths, STEP, has_tracks=False)
    rows = {(row.metric, row.slice): row.value for row in score_streaming(run, ScoreOptions(), [])
            if not row.matching.startswith("iou")}  # fmt: skip
    assert rows["recall", STREAMING] == rows["recall", FORECAST] == pytest.approx(2 / 3)
    assert {rows.get((metric, part)) for metric in ("mota", "hota") for part in (STREAMING, FORECAST)} == {None}


def test_motion_in_images_is_a_least_squares_fit(tmp_path):
    """Left sides at 0, 10 and 26 px, 0.1 s apart: the slope is (26 - 0) / 0.2 s, so 39 px are next."""
    found = [boxes2d((x, 100, x + 50, 140), ids=[3], score=[0.9]) for x in (0, 10, 26, 40)]
    truths = [Truth(i * STEP, i * STEP, None, boxes) for i, boxes in enumerate(found)]
    run = write(tmp_path / "run", [(boxes, boxes) for boxes in found], truths, STEP, front_camera())
    np.testing.assert_allclose(streamed(run).tracks.at(3).xyxy_px, [[39, 100, 89, 140]])
