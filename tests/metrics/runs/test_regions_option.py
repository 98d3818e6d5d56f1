"""Regions of a log as region of interest, and as slices."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import NO_CAMERA, Case, boxes2d, boxes3d, front_camera, make_manifest

from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.places import ground_height
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.messages import Truth
from fbench.replay.data.metadata import Region, regions_text
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import ScoreOptions, region_kinds
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import LogEntry

ROAD = Region("road", np.array([[100.0, -5], [130, -5], [130, 5], [100, 5]]))
WALK = Region("sidewalk", np.array([[100.0, 5], [130, 5], [130, 15], [100, 15]]))
EAST = np.array([100.0, 0, 0, 0, 0, 0, 1])
NORTH = np.array([110.0, -10, 0, 0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)])
"""Poses: at (100, 0) towards x, and at (110, -10) towards y."""


def regional_run(folder: Path, cases: list[Case], poses: list[np.ndarray], rig: Rig = NO_CAMERA) -> Run:
    metadata = {"regions": regions_text([ROAD, WALK])}
    with RunWriter(folder) as writer:
        for i, case in enumerate(cases):
            writer.add_frame(FrameRecord(i, i * 100, 0, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", i, case.estimates)
            writer.add_boxes("tracks", i, case.estimates)
            writer.label_frame(i, Truth(i * 100, i * 100, case.truth, case.truth2d))
        writer.set_poses(np.array(poses))
        log = LogEntry(name="log", log_id="id", digest="d" * 32, metadata=metadata)
        return Run(writer.finish(make_manifest(rig, log=log)))


def counts(run: Run, options: ScoreOptions, slice_: str = "all", space: str = "bev") -> tuple[float, ...]:
    rows = score_run(run, options, (Detection(), Tracking()))
    c = next(r for r in rows if (r.metric, r.slice) == ("f1", slice_) and r.matching.startswith(space)).counts
    return c["tp"], c["fp"], c["fn"], c["ignored"]


# In the world at x = 110: on the road, on the sidewalk, on neither.
TRUTH = boxes3d((10, 0), (10, 10), (10, 20), label="car", ids=[1, 2, 3])
FOUND = boxes3d((10, 0), (10, 12.5), (10, 24), (20, -20), ids=[1, 2, 3, 4])


def test_only_boxes_in_the_regions_count(tmp_path: Path) -> None:
    run = regional_run(tmp_path / "run", [Case(FOUND, TRUTH)], [EAST])
    assert counts(run, ScoreOptions()) == (1, 3, 2, 0)
    assert counts(run, ScoreOptions(regions=("road",))) == (1, 0, 0, 3)
    assert counts(run, ScoreOptions(regions=("sidewalk",))) == (0, 1, 1, 3)
    assert counts(run, ScoreOptions(regions=("sidewalk", "road"))) == (1, 1, 1, 2)


def test_slices_count_as_the_option_does(tmp_path: Path) -> None:
    run = regional_run(tmp_path / "run", [Case(FOUND, TRUTH)] * 2, [EAST, NORTH])
    for kind in ("road", "sidewalk"):
        assert counts(run, ScoreOptions(), f"region {kind}") == counts(run, ScoreOptions(regions=(kind,)))


def test_boxes_are_moved_and_turned_into_the_world(tmp_path: Path) -> None:
    """10 m ahead of (110, -10) towards y is (110, 0): on the road; 10 m to its left is x = 100."""
    ahead, left = boxes3d((10, 0), label="car"), boxes3d((10, 12), label="car")
    options = ScoreOptions(regions=("road",))
    assert counts(regional_run(tmp_path / "a", [Case(ahead, ahead)], [NORTH]), options) == (1, 0, 0, 0)
    assert counts(regional_run(tmp_path / "b", [Case(left, left)], [NORTH]), options) == (0, 0, 0, 1)


def test_the_matching_text_names_them(tmp_path: Path) -> None:
    run = regional_run(tmp_path / "run", [Case(FOUND, TRUTH)], [EAST], front_camera())
    rows = score_run(run, ScoreOptions(regions=("sidewalk", "road")), (Detection(), Tracking()))
    assert {row.matching for row in rows} == {
        "bev 2 m, within 50 m, in view, in region road or sidewalk",
        "iou 0.5, truth projected from 3D, within 50 m, in view, in region road or sidewalk",
    }


def test_projected_boxes_are_in_regions_too(tmp_path: Path) -> None:
    truth = boxes3d((20, 0), (20, 10), label="car")
    run = regional_run(tmp_path / "run", [Case(truth, truth)], [EAST], front_camera())
    assert counts(run, ScoreOptions(regions=("road",)), space="iou") == (1, 0, 0, 1)


def test_2d_results_arent_blamed_for_what_is_elsewhere(tmp_path: Path) -> None:
    """Nobody knows where they are; on projected truth beside the road they are excused."""
    truth = boxes3d((10, 0), (10, 8), label="car")
    # Front faces at x = 8 m: 400 / 8 = 50 px a meter; the second from y = 7 to 9 m, its image ends at u = -0.5.
    found = boxes2d((349.5, 262, 449.5, 337), (-0.5, 262, 49.5, 337))
    run = regional_run(tmp_path / "run", [Case(found, truth)], [EAST], front_camera())
    tp, fp, fn, _ = counts(run, ScoreOptions(regions=("road",)), space="iou")
    assert (tp, fn) == (1, 0)
    assert fp == 0


def test_truth_in_images_is_where_its_box_in_space_is(tmp_path: Path) -> None:
    """Both outlines touch the road; by their ids, one object is on it and one far beside it."""
    truth = boxes3d((10, 0), (10, 20), label="car", ids=[1, 2])
    truth2d = boxes2d((349.5, 262, 449.5, 337), (500, 262, 560, 337), label="car", ids=[1, 2])
    run = regional_run(tmp_path / "run", [Case(truth2d, truth, truth2d)], [EAST], front_camera())
    assert counts(run, ScoreOptions(), space="iou") == (2, 0, 0, 0)
    assert counts(run, ScoreOptions(regions=("road",)), space="iou") == (1, 0, 0, 1)


def test_false_alarms_in_images_are_where_they_touch_the_ground_or_as_far_as_measured(tmp_path: Path) -> None:
    """A lower edge 75 px below the horizon of a camera 1.5 m high, f 400 px, is 8 m ahead; the second, 300 px to the
    left, is 6 m to the left, on the sidewalk. The third ends above the horizon, so it is nowhere.
    With distances, the first is 31 m away, behind the end of the road at 30 m, and the third 20 m away, over the road.
    """
    low = front_camera()
    rig = replace(low, mounts={"front": replace(low.mounts["front"], translation_m=np.array([0, 0, 1.5]))})
    found = boxes2d((389.5, 344.5, 409.5, 374.5), (89.5, 344.5, 109.5, 374.5), (389.5, 100, 409.5, 200))
    run = regional_run(tmp_path / "a", [Case(found, boxes3d((20, 0), label="car"))], [EAST], rig)
    assert counts(run, ScoreOptions(regions=("road",)), space="iou")[1] == 1
    assert counts(run, ScoreOptions(regions=("sidewalk",)), space="iou")[1] == 1
    assert counts(run, ScoreOptions(regions=("road", "sidewalk")), space="iou")[1] == 2
    far = replace(found, distance_m=np.array([31.0, np.nan, 20.0]))
    run = regional_run(tmp_path / "b", [Case(far, boxes3d((20, 0), label="car"))], [EAST], rig)
    assert counts(run, ScoreOptions(regions=("road",)), space="iou")[1] == 1


def test_the_ground_is_where_near_road_users_stand(tmp_path: Path) -> None:
    """The body's origin is 0.5 m above the road, the camera 1.5 m above that: 2 m * 400 px / 22 px is 36 m ahead, where
    the road has ended at 30 m. At z = 0 it would be 27 m. A sign and a car on a far hill say nothing, and
    one box that floats doesn't matter.
    """
    low = front_camera()
    rig = replace(low, mounts={"front": replace(low.mounts["front"], translation_m=np.array([0, 0, 1.5]))})
    found = boxes2d((389.5, 291.5, 409.5, 321.5))
    truth = boxes3d((5, 0), (10, 3), (15, -3), (6, 6), (45, 0), label="car")
    height = truth.size_lwh_m[:, 2]
    center = np.column_stack([truth.center_m[:, :2], height / 2 + [-0.5, -0.5, 4.0, 2.0, 3.0]])
    truth = replace(truth, center_m=center, label=np.array(["car", "car", "car", "other", "car"]))
    run = regional_run(tmp_path / "a", [Case(found, truth)], [EAST], rig)
    assert ground_height(run) == -0.5
    assert counts(run, ScoreOptions(regions=("road",)), space="iou")[1] == 0
    level = replace(truth, center_m=center + np.array([0, 0, 0.5]))
    run = regional_run(tmp_path / "b", [Case(found, level)], [EAST], rig)
    assert counts(run, ScoreOptions(regions=("road",)), space="iou")[1] == 1
    assert ground_height(regional_run(tmp_path / "c", [Case(found, truth[:0])], [EAST], rig)) == 0.0


def test_unknown_kinds_and_missing_poses_are_refused(tmp_path: Path) -> None:
    run = regional_run(tmp_path / "a", [Case(FOUND, TRUTH)], [EAST])
    with pytest.raises(ConfigError, match="no region 'raod'; did you mean 'road'"):
        counts(run, ScoreOptions(regions=("raod",)))
    lost = regional_run(tmp_path / "b", [Case(FOUND, TRUTH)] * 2, [EAST, np.full(7, np.nan)])
    with pytest.raises(ConfigError, match="doesn't tell where the body was"):
        counts(lost, ScoreOptions(regions=("road",)))
    assert counts(lost, ScoreOptions()) == (2, 6, 4, 0)


def test_kinds_are_read_with_commas_between() -> None:
    assert region_kinds(None) == ()
    assert region_kinds("road, sidewalk,road") == ("road", "sidewalk")
    with pytest.raises(ConfigError, match="has no name"):
        ScoreOptions(regions=region_kinds("road,"))
